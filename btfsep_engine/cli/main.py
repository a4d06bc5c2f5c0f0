# SPDX-License-Identifier: GPL-3.0-or-later
"""All of the command line: the commands, and `batch`, which runs them in processes of its own."""

from btfsep_engine.cli.batch import batch_command
from btfsep_engine.cli.commands import cli, estimate, main

cli.add_command(batch_command(estimate))

__all__ = ["main"]
