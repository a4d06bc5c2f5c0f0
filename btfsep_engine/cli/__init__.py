# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: ``btfsep`` and ``python -P -m btfsep_engine``."""

from btfsep_engine.cli.commands import main

__all__ = ["main"]
