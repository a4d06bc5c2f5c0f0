# SPDX-License-Identifier: GPL-3.0-or-later
"""``btfsep plan``: what a job could determine, before its photo is looked at."""

from pathlib import Path

import click

from btfsep_engine.cli.command import LIBRARY, command, opened_library
from btfsep_engine.cli.parameters import NumberOrAuto


@click.command()
@click.argument("job", type=click.Path(path_type=Path))
@click.option("--material", help="The material of all objects, instead of the job's.")
@click.option("--noise", type=click.FloatRange(1e-4, 1.0), help="Expected misfit over the photo's root mean square.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the results.  [default: JOB/plan]")
@click.option("--order", type=int, help="Order of the spherical harmonics that would be reported, 0 to 9.")
@click.option("--appearance", help="mean (mean ABRDF) or textured (the BTF).")
@click.option("--pixels", type=int, help="Pixels that would be used, 0: all.")
@click.option("--directions", type=NumberOrAuto(), help="Light directions per pixel; auto: the usual number.")
@click.option("--bounces", type=NumberOrAuto(), help="Reflections followed, 1: no light between surfaces; auto: 8.")
@click.option("--preset", default="balanced", show_default=True, help="draft, balanced or accurate.")
@click.option("--seed", type=int, help="Seed of every random choice.")
@LIBRARY
@command
def plan(*, job, material, noise, out, preset, library_folder, reporter, **changes):
    """What the geometry, view and material of JOB could determine; its photo is not read."""
    from btfsep_engine.pipeline.plan import run_plan
    from btfsep_engine.pipeline.settings import choose

    changes = {**changes, "estimator": "map"}
    settings = choose(preset, **changes)
    result = run_plan(
        job, opened_library(library_folder), settings, material=material, noise=noise, out=out, reporter=reporter
    )
    return result, words(result)


def words(result: dict) -> str:
    """What a plan found."""
    lines = [f"{o['name']}: {o['material']}, {o['pixels']} pixels" for o in result["objects"]]
    text = result["determined"].replace("the photo", "a photo")
    lines.append(f"{text} ({result['effective_degrees_of_freedom']:.0f} effective degrees of freedom)")
    for key, error in result["expected_error"].items():
        lines.append(
            f"expected error up to {key.replace('_', ' ')}: {error['median']:.2f} "
            f"({error['low']:.2f} to {error['high']:.2f}), one free scale"
        )
    lines.append(
        f"condition number {result['condition_number']:.0f} at order {result['order']}, assumed misfit "
        f"{100 * result['assumed_noise']:.0f} %"
    )
    lines += [f"advice: {a}" for a in result["advice"]]
    lines.append(f"results in {result['out']}")
    return "\n".join(lines)
