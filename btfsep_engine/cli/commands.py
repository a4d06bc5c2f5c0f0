# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands but `batch`, which runs them. Exit status 0: done; 2: the input is at fault; 1: a bug."""

import os
from pathlib import Path

import click

from btfsep_engine import __version__
from btfsep_engine.cli import words
from btfsep_engine.cli.chart import chart
from btfsep_engine.cli.command import INPUT_FAULT, LIBRARY, command, opened_library
from btfsep_engine.cli.library import library
from btfsep_engine.cli.parameters import NumberOrAuto
from btfsep_engine.cli.plan import plan
from btfsep_engine.cli.sequence import sequence
from btfsep_engine.errors import InputError


def estimate_options(function):
    """Options that every command with a job and a library shares."""
    for option in reversed(
        (
            LIBRARY,
            click.option("--preset", default="balanced", show_default=True, help="draft, balanced, accurate or paper."),
            click.option("--classifier", help="svm or nearest."),
            click.option(
                "--verify/--no-verify",
                default=None,
                help="Compare the likeliest materials with the photo under the light each implies.  [default: verify]",
            ),
            click.option("--seed", type=int, help="Seed of every random choice."),
        )
    ):
        function = option(function)
    return function


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
@click.option("--order", type=NumberOrAuto(), help="Order of the spherical harmonics, 0 to 9, or auto.")
@click.option("--estimator", help="map (natural light and lamps, by evidence) or least-squares (the paper's).")
@click.option("--colorspace", help="The photo's curve: auto, srgb, linear, or unknown (found).  [default: the job's]")
@click.option(
    "--robust/--no-robust", default=None, help="Leave out pixels that the light does not explain: things in front."
)
@click.option("--key-light", help="auto (lamps of a fifth of the light or more are told apart from the sky) or never.")
@click.option("--appearance", help="auto, mean (mean ABRDF) or textured (the BTF).")
@click.option("--pixels", type=int, help="Pixels used for the fit, 0: all.")
@click.option("--directions", type=NumberOrAuto(), help="Light directions per pixel; auto: 256.")
@click.option(
    "--bounces",
    type=NumberOrAuto(),
    help="Reflections followed; 1 leaves out light between surfaces; auto: as the estimate needs.",
)
@click.option("--transport", help="kernel, or reference (the paper's: one path-traced image for each basis light).")
@click.option("--samples", type=int, help="Paths per pixel and basis light of the reference.")
@click.option(
    "--with",
    "others",
    multiple=True,
    type=click.Path(path_type=Path),
    help="A further job under the same light, solved together; may be given again.",
)
@click.option("--report/--no-report", "with_report", default=True, help="Whether report.png is made.")
@estimate_options
@command
def estimate(*, job, library_folder, preset, material, out, with_report, others, reporter, **changes):
    """Recognises the material and estimates the light of JOB."""
    from btfsep_engine.pipeline.estimation import run_estimate
    from btfsep_engine.pipeline.settings import choose

    settings = choose(preset, **changes)
    result = run_estimate(
        job,
        opened_library(library_folder),
        settings,
        material=material,
        out=out,
        with_report=with_report,
        others=others,
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

    result = run_recognise(job, opened_library(library_folder), choose(preset, **changes), reporter=reporter)
    return result, words.recognise(result)


@cli.command()
@click.argument("job", type=click.Path(path_type=Path))
@estimate_options
@command
def train(*, job, library_folder, preset, reporter, **changes):
    """Renders the training data of JOB's objects and trains the recogniser, kept in the cache."""
    from btfsep_engine.pipeline.commands import run_train
    from btfsep_engine.pipeline.settings import choose

    result = run_train(job, opened_library(library_folder), choose(preset, **changes), reporter=reporter)
    return result, words.train(result)


@cli.command()
@click.argument("job", type=click.Path(path_type=Path))
@click.option("--lighting", required=True, type=click.Path(path_type=Path), help="lighting.json or an environment map.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Image to write, .exr or .png.")
@click.option("--material", help="The material of all objects.")
@click.option("--directions", type=NumberOrAuto(), help="Light directions per pixel; auto: 512.")
@click.option("--bounces", type=NumberOrAuto(), help="Reflections followed; auto: 8.")
@estimate_options
@command
def relight(*, job, library_folder, preset, lighting, out, material, reporter, **changes):
    """Renders JOB's objects under a lighting."""
    from btfsep_engine.pipeline.relighting import run_relight
    from btfsep_engine.pipeline.settings import choose

    result = run_relight(
        job,
        opened_library(library_folder),
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
@click.option(
    "--protocol",
    type=click.Choice(["three-spheres"]),
    help="Instead, the figures of published comparisons: Blender's mirror, matte silver and diffuse sphere.",
)
@command
def compare(*, a, b, job, order, library_folder, material, protocol, reporter):
    """Error measures between two lightings; B is the truth."""
    from btfsep_engine.pipeline.commands import run_compare, run_three_spheres

    if protocol and job:
        raise InputError("--protocol", "it goes without --job", "leave one of them out")
    if protocol:
        result = run_three_spheres(a, b)
        return result, words.compare(result)
    library = opened_library(library_folder) if job else None
    result = run_compare(a, b, order=order, job=job, library=library, material=material, reporter=reporter)
    return result, words.compare(result)


cli.add_command(chart)
cli.add_command(library)
cli.add_command(plan)
cli.add_command(sequence)


def main(arguments=None) -> int:
    """Runs a command; returns the exit status. Misuse of the command line is the input's fault (2)."""
    if arguments is None:  # the process is ours: no Python that it starts takes modules from the current folder
        os.environ["PYTHONSAFEPATH"] = "1"
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
