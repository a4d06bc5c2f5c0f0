# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands. Exit status 0: done; 2: the input is at fault; 1: a bug."""

import functools
import sys
import traceback
from pathlib import Path

import click

from btfsep_engine import __version__
from btfsep_engine.cli import words
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
        reporter = JsonReporter() if as_json else TextReporter()
        try:
            result, text = function(reporter=reporter, **options)
        except InputError as error:
            reporter.failed(str(error), INPUT_FAULT)
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
            click.echo(text)

    return run


def estimate_options(function):
    """Options that every command with a job and a library shares."""
    for option in reversed(
        (
            LIBRARY,
            click.option("--preset", default="balanced", show_default=True, help="draft, balanced, accurate or paper."),
            click.option("--classifier", help="svm or nearest."),
            click.option("--seed", type=int, help="Seed of every random choice."),
        )
    ):
        function = option(function)
    return function


def _library(folder):
    from btfsep_engine.btf.library import open_library

    return open_library(folder)


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="btfsep")
def cli():
    """Illumination from one photograph, known geometry and a library of digitised materials."""


@cli.command()
@LIBRARY
@command
def doctor(*, library_folder, reporter):
    """What works on this machine: renderer, libraries, a test render."""
    from btfsep_engine.cli.doctor import examine

    result = examine(library_folder)
    if not result["ok"]:
        raise InputError("this machine", result["problem"], result["remedy"])
    return result, words.doctor(result)


@cli.command()
@click.argument("job", type=click.Path(path_type=Path))
@click.option("--material", help="The material of all objects, instead of recognition.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the results.  [default: JOB/result]")
@click.option("--order", type=int, help="Order of the spherical harmonics, 0 to 9.")
@click.option("--appearance", help="mean (mean ABRDF) or textured (the BTF).")
@click.option("--pixels", type=int, help="Pixels used for the fit, 0: all.")
@click.option("--directions", type=int, help="Light directions per pixel.")
@click.option("--bounces", type=int, help="Reflections followed; 1 leaves out light between surfaces.")
@click.option("--report/--no-report", "with_report", default=True, help="Whether report.png is made.")
@estimate_options
@command
def estimate(*, job, library_folder, preset, material, out, with_report, reporter, **changes):
    """Recognises the material and estimates the light of JOB."""
    from btfsep_engine.pipeline.estimation import run_estimate
    from btfsep_engine.pipeline.settings import choose

    settings = choose(preset, **changes)
    result = run_estimate(
        job,
        _library(library_folder),
        settings,
        material=material,
        out=out,
        with_report=with_report,
        reporter=reporter,
    )
    return result, words.estimate(result)


@cli.command()
@click.argument("job", type=click.Path(path_type=Path))
@estimate_options
@command
def recognise(*, job, library_folder, preset, reporter, **changes):
    """The material of each object of JOB, with scores."""
    from btfsep_engine.pipeline.commands import run_recognise
    from btfsep_engine.pipeline.settings import choose

    result = run_recognise(job, _library(library_folder), choose(preset, **changes), reporter=reporter)
    return result, words.recognise(result)


@cli.command()
@click.argument("job", type=click.Path(path_type=Path))
@estimate_options
@command
def train(*, job, library_folder, preset, reporter, **changes):
    """Renders the training data of JOB's objects and trains the recogniser, kept in the cache."""
    from btfsep_engine.pipeline.commands import run_train
    from btfsep_engine.pipeline.settings import choose

    result = run_train(job, _library(library_folder), choose(preset, **changes), reporter=reporter)
    return result, words.train(result)


@cli.command()
@click.argument("job", type=click.Path(path_type=Path))
@click.option("--lighting", required=True, type=click.Path(path_type=Path), help="lighting.json or an environment map.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Image to write, .exr or .png.")
@click.option("--material", help="The material of all objects.")
@click.option("--directions", type=int, help="Light directions per pixel.")
@click.option("--bounces", type=int, help="Reflections followed.")
@estimate_options
@command
def relight(*, job, library_folder, preset, lighting, out, material, reporter, **changes):
    """Renders JOB's objects under a lighting."""
    from btfsep_engine.pipeline.relighting import run_relight
    from btfsep_engine.pipeline.settings import choose

    result = run_relight(
        job,
        _library(library_folder),
        choose(preset, **changes),
        lighting=lighting,
        out=out,
        material=material,
        reporter=reporter,
    )
    return result, f"wrote {result['out']}"


@cli.command()
@click.argument("a", type=click.Path(path_type=Path))
@click.argument("b", type=click.Path(path_type=Path))
@click.option("--job", type=click.Path(path_type=Path), help="Also compare renderings of this job's objects.")
@click.option("--order", type=int, default=4, show_default=True, help="Order to which environment maps are projected.")
@LIBRARY
@click.option("--material", help="The material of all objects of --job.")
@command
def compare(*, a, b, job, order, library_folder, material, reporter):
    """Error measures between two lightings; B is the truth."""
    from btfsep_engine.pipeline.commands import run_compare

    library = _library(library_folder) if job else None
    result = run_compare(a, b, order=order, job=job, library=library, material=material, reporter=reporter)
    return result, words.compare(result)


@cli.group()
def library():
    """The material library."""


@library.command("list")
@LIBRARY
@command
def library_list(*, library_folder, reporter):
    """The names and classes of all materials."""
    opened = _library(library_folder)
    materials = [{"name": n, "class": n.split("/")[0]} for n in opened.names()]
    return {"materials": materials}, "\n".join(m["name"] for m in materials)


@library.command("show")
@click.argument("name")
@LIBRARY
@click.option("--maps", type=click.Path(path_type=Path), help="Also write the maps it was made from into this folder.")
@click.option("--resolution", type=int, default=512, show_default=True, help="Edge of the maps in pixels.")
@command
def library_show(*, name, library_folder, maps, resolution, reporter):
    """What is known of one material."""
    opened = _library(library_folder)
    result = opened.show(name)
    if maps is not None:
        opened.export_maps(name, maps, resolution=resolution)
        result = {**result, "maps": str(maps)}
    return result, words.facts(result)


@library.command("build")
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--only", "names", multiple=True, help="A material to build; may be given several times.  [default: all]")
@command
def library_build(*, folder, names, reporter):
    """Builds the default library into FOLDER by path-tracing displaced patches; resumes where it stopped."""
    from btfsep_engine.btf.library import build

    with reporter.stage("library"):
        built = build(folder, names=list(names) or None, reporter=reporter)
    result = {"library": str(folder), "materials": built.names()}
    return result, f"{len(result['materials'])} materials in {folder}"


def main(arguments=None) -> int:
    """Runs a command; returns the exit status. Misuse of the command line is the input's fault (2)."""
    try:
        cli.main(args=arguments, prog_name="btfsep", standalone_mode=False)
    except click.Abort:
        click.echo("error: stopped", err=True)
        return 130
    except KeyboardInterrupt:
        click.echo("error: stopped", err=True)
        return 130
    except click.ClickException as error:
        click.echo(f"error: {error.format_message()}", err=True)
        return INPUT_FAULT
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0
