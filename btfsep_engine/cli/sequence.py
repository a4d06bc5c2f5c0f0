# SPDX-License-Identifier: GPL-3.0-or-later
"""``btfsep sequence``: the light of every picture that a standing camera took."""

from pathlib import Path

import click

from btfsep_engine.cli.command import LIBRARY, command, opened_library
from btfsep_engine.cli.parameters import NumberOrAuto


@click.command()
@click.argument("job", type=click.Path(path_type=Path))
@click.option("--images", "frames", required=True, help="Pattern of the frames, in quotes: 'frames/*.exr'.")
@click.option("--material", help="The material of all objects, instead of recognition in the first frame.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the results.  [default: JOB/sequence]")
@click.option("--exr/--no-exr", "with_exr", default=False, help="Whether each light is written as a map, too.")
@click.option("--order", type=int, help="Order of the spherical harmonics, 0 to 9.")
@click.option("--appearance", help="mean (mean ABRDF) or textured (the BTF).")
@click.option("--pixels", type=int, help="Pixels used for the fit, 0: all.")
@click.option("--directions", type=NumberOrAuto(), help="Light directions per pixel; auto: the usual number.")
@click.option("--bounces", type=NumberOrAuto(), help="Reflections followed, 1: no light between surfaces; auto: 8.")
@click.option("--preset", default="balanced", show_default=True, help="draft, balanced or accurate.")
@click.option("--seed", type=int, help="Seed of every random choice.")
@LIBRARY
@command
def sequence(*, job, frames, material, out, with_exr, preset, library_folder, reporter, **changes):
    """The light of every frame: JOB's camera, objects and materials stand still, only the light changes."""
    from btfsep_engine.pipeline.sequence import run_sequence
    from btfsep_engine.pipeline.settings import choose

    result = run_sequence(
        job,
        opened_library(library_folder),
        choose(preset, **{**changes, "estimator": "map"}),
        frames=frames,
        material=material,
        out=out,
        with_exr=with_exr,
        reporter=reporter,
    )
    return result, words(result)


def words(result: dict) -> str:
    """What a sequence gave."""
    lines = [f"{o['name']}: {o['material']}" for o in result["objects"]]
    lines += [f"{f['image']}: residual {f['residual']:.3f}, {f['determined']}" for f in result["frames"]]
    lines.append(
        f"{len(result['frames'])} lights of order {result['order']}, "
        f"{result['median_milliseconds_per_further_frame']:.1f} ms for a further one, "
        f"{result['seconds']['total']:.1f} s in all"
    )
    lines.append(f"results in {result['out']}")
    return "\n".join(lines)
