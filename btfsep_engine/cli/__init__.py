# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: ``btfsep`` and ``python -P -m btfsep_engine``."""

import os

# pydantic would read files of every installed package for plugins, which takes longer than to read a job: none is ours
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")

from btfsep_engine.cli.commands import main

__all__ = ["main"]
