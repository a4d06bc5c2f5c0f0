# SPDX-License-Identifier: GPL-3.0-or-later
"""``btfsep library measure``."""

from pathlib import Path

import click

from btfsep_engine.btf.map_files import CONVENTIONS
from btfsep_engine.cli.command import command
from btfsep_engine.pipeline.measuring import DEFAULT_SETTINGS, MeasureSettings, measure_maps


def _number(name: str, words: str):
    return click.option(f"--{name}", type=int, default=DEFAULT_SETTINGS[name], show_default=True, help=words)


@click.command("measure")
@click.option("--maps", required=True, type=click.Path(path_type=Path), help="Folder with the texture maps.")
@click.option("--name", required=True, help="Its name in the library.")
@click.option("--class", "material_class", required=True, help="Its class: carpet, fabric, felt, leather, stone, …")
@click.option("--size-mm", required=True, type=float, help="What the (longer) edge of the maps spans on the material.")
@click.option("--height-mm", type=float, help="From black to white of the height map; not needed with normals alone.")
@click.option("--library", "folder", required=True, type=click.Path(path_type=Path), help="Folder to add it to.")
@click.option("--texels", type=int, help="Along an edge; time grows with their square.  [default: 2 a mm, 80 to 160]")
@_number("components", "Components of the factorisation.")
@_number("samples", "Paths a texel and view; the time grows with them.")
@_number("seed", "Of all random numbers; the same one gives the same file.")
@click.option("--f0", type=float, default=0.04, show_default=True, help="Specular reflectance at normal incidence.")
@click.option(
    "--normal-convention",
    type=click.Choice(CONVENTIONS),
    default="auto",
    show_default=True,
    help="Whether green of the normal map points up (OpenGL) or down (DirectX).",
)
@click.option("--replace", "replace_old", is_flag=True, help="Replaces a material of the same name.")
@command
def measure(
    *, maps, name, material_class, size_mm, height_mm, folder, replace_old, f0, normal_convention, reporter, **numbers
):
    """Measures a material from texture maps with a virtual gonioreflectometer; goes on where it was stopped."""
    result = measure_maps(
        maps,
        name=name,
        material_class=material_class,
        size_mm=size_mm,
        height_mm=height_mm,
        library=folder,
        settings=MeasureSettings(f0=f0, normal_convention=normal_convention, **numbers),
        replace_old=replace_old,
        reporter=reporter,
    )
    result["seconds"] = {stage: round(seconds, 2) for stage, seconds in reporter.seconds.items()}
    return result, _in_words(result)


def _in_words(result: dict) -> str:
    if not result["measured"]:
        return f"{result['name']} is in {result['library']} already, measured from the same maps in the same way"
    used = ", ".join(f"{kind}: {file}" for kind, file in result["maps"].items())
    return (
        f"measured {result['name']} in {sum(result['seconds'].values()):.0f} s ({used}; relief "
        f"{result['relief_mm']:.3g} mm)\n{Path(result['library']) / result['file']}: {result['size'] / 1e6:.1f} MB, "
        f"{result['components']} components, error {result['relative_error']:.2f}, the noise of single paths included; "
        f"{result['speed']['rays'] / 1e6:.0f} M rays, {result['speed']['rays_per_second'] / 1e6:.1f} M a second"
    )
