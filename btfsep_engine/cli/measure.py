# SPDX-License-Identifier: GPL-3.0-or-later
"""``btfsep library measure``."""

from pathlib import Path

import click

from btfsep_engine.btf.linear import CLASSES
from btfsep_engine.cli.command import command
from btfsep_engine.cli.options import PATH, field_options
from btfsep_engine.commands.measure import MeasureSettings, measure_maps
from btfsep_engine.pipeline.settings import changed, meanings

ASKED = {name: meaning for name, meaning in meanings(MeasureSettings).items() if name != "mesh"}


@click.command("measure")
@click.option("--maps", required=True, type=PATH, help="Folder with the texture maps.")
@click.option("--name", required=True, help="Its name in the library.")
@click.option("--class", "material_class", required=True, help=f"Its class: {', '.join(CLASSES)}.")
@click.option("--size-mm", required=True, type=float, help="What the (longer) edge of the maps spans on the material.")
@click.option("--height-mm", type=float, help="From black to white of the height map; not needed with normals alone.")
@click.option("--library", "folder", required=True, type=PATH, help="Folder to add it to.")
@field_options(ASKED, {"": MeasureSettings()})
@click.option("--replace", "replace_old", is_flag=True, help="Replaces a material of the same name.")
@command
def measure(*, maps, name, material_class, size_mm, height_mm, folder, replace_old, reporter, **numbers):
    """Measures a material from texture maps with a virtual gonioreflectometer; goes on where it was stopped."""
    result = measure_maps(
        maps,
        name=name,
        material_class=material_class,
        size_mm=size_mm,
        height_mm=height_mm,
        library=folder,
        settings=changed(MeasureSettings(), **numbers),
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
