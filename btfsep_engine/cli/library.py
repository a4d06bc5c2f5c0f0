# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands of ``btfsep library``."""

from pathlib import Path

import click

from btfsep_engine.cli import words
from btfsep_engine.cli.command import LIBRARY, command, opened_library


@click.group()
def library():
    """The material library."""


@library.command("list")
@LIBRARY
@command
def library_list(*, library_folder, reporter):
    """The names and classes of all materials."""
    opened = opened_library(library_folder)
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
    opened = opened_library(library_folder)
    result = opened.show(name)
    if maps is not None:
        from btfsep_engine.btf.library import export_maps

        export_maps(name, maps, resolution=resolution)
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
