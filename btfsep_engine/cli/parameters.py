# SPDX-License-Identifier: GPL-3.0-or-later
"""Kinds of values that options have."""

import click


class NumberOrAuto(click.ParamType):
    """A whole number, or "auto"."""

    name = "number or auto"

    def convert(self, value, param, ctx):
        """Click's hook: the text of the command line as an int or "auto"."""
        if value == "auto" or isinstance(value, int):
            return value
        try:
            return int(value)
        except ValueError:
            self.fail(f"'{value}' is neither a whole number nor 'auto'", param, ctx)
