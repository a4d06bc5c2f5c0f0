# SPDX-License-Identifier: GPL-3.0-or-later
"""What the commands share: ``--json``, errors and exit status, the library."""

import functools
import sys
import traceback

import click

from btfsep_engine.cli.output import JsonReporter, TextReporter
from btfsep_engine.errors import InputError
from btfsep_engine.progress import Reporter

INPUT_FAULT, BUG, SOME_FAILED = 2, 1, 3


class SomeFailed(InputError):
    """A command over many things did its work, and some of them failed; ``result`` says how many."""


def command(function):
    """A command with ``--json``: calls ``function(reporter=…, **options)``, which returns (result, words)."""

    @click.option("--json", "as_json", is_flag=True, help="One JSON object a line, for programs.")
    @functools.wraps(function)
    def run(as_json, **options):
        given = click.get_current_context().obj
        if isinstance(given, Reporter):  # of a program that takes results and errors itself (`cli.serve`)
            given.command = function.__name__
            return function(reporter=given, **options)[0]
        reporter = (JsonReporter if as_json else TextReporter)(command=function.__name__)
        try:
            result, text = function(reporter=reporter, **options)
        except (click.ClickException, click.Abort):
            raise
        except Exception as error:
            message, exit_code = failure_of(error)
            reporter.failed(message, exit_code, getattr(error, "result", None))
            sys.exit(exit_code)
        reporter.done(result)
        if not as_json and text:
            click.echo(text.encode(errors="backslashreplace").decode())  # names of files need not be UTF-8

    return run


def failure_of(error: Exception) -> tuple[str, int]:
    """The sentence for people and the exit status; of a bug the traceback goes to standard error."""
    if isinstance(error, InputError):
        return str(error), SOME_FAILED if isinstance(error, SomeFailed) else INPUT_FAULT
    if isinstance(error, MemoryError):
        return "not enough memory; the scene or the picture is too large; use --preset draft", INPUT_FAULT
    traceback.print_exception(error)
    return f"a bug in BTFsep: {type(error).__name__}: {error}; please report it", BUG


def opened_library(folder):
    """The library of ``--library``, None: the shipped one."""
    from btfsep_engine.btf.library import open_library

    return open_library(folder)
