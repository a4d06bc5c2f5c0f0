# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands. Exit status 0: done; 2: the input is at fault; 1: a bug."""

import importlib
import os
import signal

import click

from btfsep_engine import __version__
from btfsep_engine.cli import words
from btfsep_engine.cli.command import INPUT_FAULT, command, opened_library
from btfsep_engine.cli.options import (
    ESTIMATE,
    JOB,
    LIBRARY,
    MATERIAL,
    ONE_SOLVER,
    PATH,
    RECOGNITION,
    REPORT,
    SEQUENCE,
    out_option,
    takes_settings,
    together,
)
from btfsep_engine.errors import InputError
from btfsep_engine.loading import loading

BY_RECOGNITION = together(JOB, LIBRARY, command, takes_settings(*RECOGNITION))


class Commands(click.Group):
    """The commands of this file, and those of files that are read when they are asked for."""

    OTHERS = ("batch", "library", "serve")

    def list_commands(self, context):
        return sorted({*super().list_commands(context), *self.OTHERS})

    def get_command(self, context, name):
        if name in self.OTHERS and name not in self.commands:
            self.add_command(getattr(importlib.import_module(f"btfsep_engine.cli.{name}"), name))
        return super().get_command(context, name)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
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


@cli.command(name="cache")
@click.option("--clear", is_flag=True, help="Take all of it away; it is made again where it is needed.")
@command
def cache_command(*, clear, reporter):
    """What is kept of earlier runs: where, and how much."""
    from btfsep_engine.storage import cache

    freed = cache.clear() if clear else 0
    held = sum(path.stat().st_size for path in cache.entries())
    result = {"folder": str(cache.cache_folder()), "bytes": held, "freed": freed}
    if clear and held:
        reporter.warn(f"{held / 1e6:.1f} MB stay: in use, or not to be taken away by you; see {result['folder']}")
    more = f", {freed / 1e6:.0f} MB are free now" if clear else ""
    return result, f"{held / 1e6:.0f} MB in {result['folder']}{more}"


@cli.command()
@JOB
@MATERIAL
@out_option("JOB/result")
@click.option(
    "--with",
    "others",
    multiple=True,
    type=PATH,
    help="A further job under the same light, solved together; may be given again.",
)
@REPORT
@LIBRARY
@command
@takes_settings(*ESTIMATE)
def estimate(*, job, library_folder, settings, reporter, **options):
    """Recognises the material and estimates the light of JOB."""
    with reporter.stage("starting"), loading():  # said before the libraries are loaded
        from btfsep_engine.commands.estimate import run_estimate

    result = run_estimate(job, opened_library(library_folder), settings, reporter=reporter, **options)
    return result, words.estimate(result)


@cli.command()
@JOB
@out_option("JOB/aligned")
@command
def align(*, job, out, reporter):
    """Moves JOB's camera to where geometry and photo line up, if that is a clear gain: a copy of JOB."""
    from btfsep_engine.commands.align import run_align

    result = run_align(job, out=out, reporter=reporter)
    return result, words.align(result)


@cli.command()
@BY_RECOGNITION
def recognise(*, job, library_folder, settings, reporter):
    """The material of each object of JOB, with scores."""
    from btfsep_engine.commands.recognise import run_recognise

    result = run_recognise(job, opened_library(library_folder), settings, reporter=reporter)
    return result, words.recognise(result)


@cli.command()
@BY_RECOGNITION
def train(*, job, library_folder, settings, reporter):
    """Renders the training data of JOB's objects and trains the recogniser, kept in the cache."""
    from btfsep_engine.commands.recognise import run_train

    result = run_train(job, opened_library(library_folder), settings, reporter=reporter)
    return result, words.train(result)


@cli.command()
@JOB
@click.option("--lighting", required=True, type=PATH, help="lighting.json or an environment map.")
@click.option("--out", required=True, type=PATH, help="Image to write, .exr or .png.")
@MATERIAL
@LIBRARY
@command
@takes_settings("directions", "bounces", "delight", *RECOGNITION)
def relight(*, job, library_folder, settings, reporter, **options):
    """Renders JOB's objects under a lighting."""
    from btfsep_engine.commands.relight import run_relight

    result = run_relight(job, opened_library(library_folder), settings, reporter=reporter, **options)
    return result, f"wrote {result['out']}"


@cli.command()
@JOB
@MATERIAL
@click.option("--noise", type=click.FloatRange(1e-4, 1.0), help="Expected misfit over the photo's root mean square.")
@out_option("JOB/plan")
@LIBRARY
@command
@takes_settings(*ONE_SOLVER, only_numbers=("order",), estimator="map")
def plan(*, job, library_folder, settings, reporter, **options):
    """What the geometry, view and material of JOB could determine; its photo is not read."""
    from btfsep_engine.commands.plan import run_plan

    result = run_plan(job, opened_library(library_folder), settings, reporter=reporter, **options)
    return result, words.plan(result)


@cli.command()
@JOB
@click.option("--images", "frames", required=True, help="Pattern of the frames, in quotes: 'frames/*.exr'.")
@MATERIAL
@out_option("JOB/sequence")
@click.option("--exr/--no-exr", "with_exr", default=False, help="Whether each light is written as a map, too.")
@click.option(
    "--poses", type=PATH, help="poses.json: where camera and objects are in each frame.  [default: as in JOB]"
)
@click.option(
    "--smooth",
    type=click.IntRange(0, 100),
    default=0,
    show_default=True,
    help="Frames on each side over which lights are smoothed, but for jumps.",
)
@LIBRARY
@command
@takes_settings(*SEQUENCE, only_numbers=("order",), estimator="map")
def sequence(*, job, library_folder, settings, reporter, **options):
    """The light of every frame: JOB's camera and objects stand still, or move as --poses says; the light changes."""
    from btfsep_engine.commands.sequence import run_sequence

    result = run_sequence(job, opened_library(library_folder), settings, reporter=reporter, **options)
    return result, words.sequence(result)


@cli.command()
@JOB
@LIBRARY
@MATERIAL
@click.option("--truth", type=PATH, help="The true light: lighting.json or an environment map.")
@out_option("JOB/result")
@click.option("--repeats", type=click.IntRange(1, 50), default=3, show_default=True, help="Timed runs of each setting.")
@click.option(
    "--paper-samples",
    type=click.IntRange(0, 65536),
    default=64,
    show_default=True,
    help="Paths per pixel of the paper's path-traced basis images; 0 leaves them out.",
)
@click.option("--quick", is_flag=True, help="Fewer settings.")
@command
def chart(*, job, library_folder, reporter, **options):
    """Charts speed against accuracy of JOB: every setting that trades one for the other, with the Pareto front."""
    from btfsep_engine.commands.chart import run_chart

    result = run_chart(job, opened_library(library_folder), reporter=reporter, **options)
    return result, words.chart(result)


@cli.command()
@click.argument("a", type=PATH)
@click.argument("b", type=PATH)
@click.option("--job", type=PATH, help="Also compare renderings of this job's objects.")
@click.option(
    "--order",
    type=click.IntRange(1, 64),
    default=4,
    show_default=True,
    help="Order to which environment maps are projected.",
)
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
    from btfsep_engine.commands.compare import run_compare, run_three_spheres

    if protocol and job:
        raise InputError("--protocol", "it goes without --job", "leave one of them out")
    if protocol:
        result = run_three_spheres(a, b)
    else:
        library = opened_library(library_folder) if job else None
        result = run_compare(a, b, order=order, job=job, library=library, material=material, reporter=reporter)
    return result, words.compare(result)


def main(arguments=None) -> int:
    """Runs a command; returns the exit status. Misuse of the command line is the input's fault (2)."""
    if arguments is None:  # the process is ours: no Python that it starts takes modules from the current folder
        os.environ["PYTHONSAFEPATH"] = "1"
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does, and cleans up
    try:
        cli.main(args=arguments, prog_name="btfsep", standalone_mode=False)
    except (click.Abort, KeyboardInterrupt):
        click.echo("error: stopped", err=True)
        return 130
    except click.ClickException as error:
        click.echo(f"error: {error.format_message()}", err=True)
        return INPUT_FAULT
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0
