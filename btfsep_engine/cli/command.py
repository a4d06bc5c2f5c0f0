# SPDX-License-Identifier: GPL-3.0-or-later
"""What the commands share: ``--json``, ``--library``, errors and exit status."""

import functools
import sys
import traceback
from pathlib import Path

import click

from btfsep_engine.cli.output import JsonReporter, TextReporter
from btfsep_engine.errors import InputError

INPUT_FAULT, BUG = 2, 1
LIBRARY = click.option(
    "--library",
    "library_folder",
    type=click.Path(path_type=Path),
    envvar="BTFSEP_LIBRARY",
    help="Material library.  [default: $BTFSEP_LIBRARY, else the one that comes with BTFsep]",
)


def command(function):
    """A command with ``--json``: calls ``function(reporter=…, **options)``, which returns (result, words)."""

    @click.option("--json", "as_json", is_flag=True, help="One JSON object a line, for programs.")
    @functools.wraps(function)
    def run(as_json, **options):
        reporter = (JsonReporter if as_json else TextReporter)(command=function.__name__)
        try:
            result, text = function(reporter=reporter, **options)
        except InputError as error:
            reporter.failed(str(error), INPUT_FAULT, error.result)
            sys.exit(INPUT_FAULT)
        except MemoryError:
            reporter.failed("not enough memory; the scene or the picture is too large; use --preset draft", INPUT_FAULT)
            sys.exit(INPUT_FAULT)
        except (click.ClickException, click.Abort, KeyboardInterrupt):
            raise
        except Exception as error:
            traceback.print_exc()
            reporter.failed(f"a bug in BTFsep: {type(error).__name__}: {error}; please report it", BUG)
            sys.exit(BUG)
        reporter.done(result)
        if not as_json and text:
            click.echo(text.encode(errors="backslashreplace").decode())  # names of files need not be UTF-8

    return run


def opened_library(folder):
    """The library of ``--library``, None: the shipped one."""
    from btfsep_engine.btf.library import open_library

    return open_library(folder)
