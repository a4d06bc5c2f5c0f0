# SPDX-License-Identifier: GPL-3.0-or-later
"""Studies, benchmarks, checks and makers of data, each a module with a ``main(arguments)``: see ``scripts/study``."""

import argparse
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def parser(name: str, doc: str, **options) -> argparse.ArgumentParser:
    """The parser of ``scripts/study NAME``, its help the module's own."""
    how = argparse.RawDescriptionHelpFormatter
    return argparse.ArgumentParser(f"scripts/study {name}", description=doc, formatter_class=how, **options)
