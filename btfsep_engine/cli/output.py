# SPDX-License-Identifier: GPL-3.0-or-later
"""What a command says: a bar and words for people, one JSON object a line for programs."""

import json
import sys

import click

from btfsep_engine.progress import TITLES, Reporter
from btfsep_engine.storage.atomic import plain


class JsonReporter(Reporter):
    """One JSON object a line on standard output, flushed at once (the protocol of docs/formats.md)."""

    def progress(self, stage, fraction, message=""):
        self._line(
            type="progress",
            stage=stage,
            title=TITLES.get(stage, stage.capitalize()),
            fraction=round(float(fraction), 4),
            whole=round(self.advance(stage, float(fraction)), 4),
            message=message,
        )

    def warn(self, message):
        if message not in self.warnings:
            self.warnings.append(message)
            self._line(type="warning", message=message)

    def light(self, lighting):
        self._line(type="light", lighting=lighting)

    def done(self, result: dict):
        """The last line of a command that went well."""
        self._line(type="done", result=result)

    def failed(self, message: str, exit_code: int, result: dict | None = None):
        """The last line of a command that did not; ``result``: what it found out all the same."""
        self._line(type="failed", message=message, exit_code=exit_code, **({"result": result} if result else {}))

    @staticmethod
    def _line(**fields):
        sys.stdout.write(json.dumps(plain(fields), allow_nan=False) + "\n")
        sys.stdout.flush()


class TextReporter(Reporter):
    """A progress bar on standard error, where that is a terminal; warnings as they come."""

    def __init__(self, **fields):
        super().__init__(**fields)
        self._bar = None

    def progress(self, stage, fraction, message=""):
        if not sys.stderr.isatty():
            return
        if self._bar is None:
            from tqdm import tqdm  # takes as long to import as click, and programs see no bar

            self._bar = tqdm(
                total=100, file=sys.stderr, leave=False, bar_format="{desc:<32} {percentage:3.0f}% |{bar}|"
            )
        self._bar.set_description_str(f"{stage} {message}".strip()[:32], refresh=False)
        self._bar.n = round(100 * fraction)
        self._bar.refresh()

    def warn(self, message):
        if message not in self.warnings:
            self.warnings.append(message)
            self.close()
            click.echo(f"warning: {message}", err=True)

    def close(self):
        """Takes the bar off the screen."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def done(self, result: dict):
        """Nothing more to say: the command has printed its words."""
        self.close()

    def failed(self, message: str, exit_code: int, result: dict | None = None):
        """One line, as the contract has it."""
        self.close()
        click.echo(f"error: {message}", err=True)
