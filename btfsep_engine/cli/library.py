# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands of ``btfsep library``."""

import os

import click

from btfsep_engine.cli import words
from btfsep_engine.cli.command import command, opened_library
from btfsep_engine.cli.options import LIBRARY, PATH
from btfsep_engine.errors import InputError


class _Library(click.Group):
    """``measure`` is imported when it is asked for: its defaults come from a module that takes long to import."""

    def list_commands(self, context):
        return sorted([*super().list_commands(context), "measure"])

    def get_command(self, context, name):
        if name != "measure":
            return super().get_command(context, name)
        from btfsep_engine.cli.measure import measure

        return measure


@click.group(cls=_Library)
def library():
    """The material library."""


@library.command("list")
@LIBRARY
@click.option("--thumbnails", type=PATH, help="Also write a PNG of each material here.")
@click.option("--side", type=click.IntRange(16, 2048), default=160, show_default=True, help="Pixels of a thumbnail.")
@command
def library_list(*, library_folder, thumbnails, side, reporter):
    """The names and classes of all materials."""
    opened = opened_library(library_folder)
    materials = [_listed(opened, name) for name in opened.names()]
    if thumbnails is not None:
        from btfsep_engine.btf.thumbnail import render
        from btfsep_engine.imaging.images import write_png

        for number, material in enumerate(materials):
            reporter.progress("thumbnails", number / len(materials), material["name"])
            path = thumbnails / (material["name"].replace("/", "_") + ".png")
            found = opened.load(material["name"])
            write_png(path, render(found, side))
            material |= {"thumbnail": str(path), "albedo": [round(float(v), 4) for v in found.diffuse_albedo()]}
        reporter.progress("thumbnails", 1.0)
    return {"materials": materials}, "\n".join(m["name"] for m in materials)


def _listed(opened, name: str) -> dict:
    entry = opened.entries.get(name)
    if entry is None:
        return {"name": name, "class": name.split("/")[0]}
    kept = entry.model_dump(mode="json", include={"texels", "texel_mm", "components", "size", "source"})
    return {"name": name, "class": entry.material_class, **kept}


@library.command("show")
@click.argument("name")
@LIBRARY
@click.option("--maps", type=PATH, help="Also write the maps it was made from into this folder.")
@click.option(
    "--resolution", type=click.IntRange(16, 4096), default=512, show_default=True, help="Edge of the maps in pixels."
)
@command
def library_show(*, name, library_folder, maps, resolution, reporter):
    """What is known of one material."""
    opened = opened_library(library_folder)
    result = opened.show(name)
    if maps is not None:
        from btfsep_engine.btf.procedural import NAMES, export_maps

        if name not in NAMES:
            raise InputError(f"material '{name}'", "it was not made from procedural maps", "leave out --maps")
        export_maps(name, maps, resolution=resolution)
        result = {**result, "maps": str(maps)}
    return result, words.facts(result)


@library.command("build")
@click.argument("folder", type=PATH)
@click.option("--only", "names", multiple=True, help="A material to build; may be given several times.  [default: all]")
@command
def library_build(*, folder, names, reporter):
    """Builds all 42 materials into FOLDER by path-tracing displaced patches; resumes where it stopped."""
    from btfsep_engine.commands.measure import build

    nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    if not nearest.is_dir() or not os.access(nearest, os.W_OK):  # said before the work, not after
        raise InputError(f"cannot write to {folder}", f"{nearest} is no such folder", "choose one that can be written")
    with reporter.stage("library"):
        measured = []
        built = build(folder, names=list(names) or None, reporter=reporter, on_measured=measured.append)
    result = {"library": str(folder), "materials": list(built.entries), "measured": measured}
    lines = [f"{m['name']}: {m['seconds']:.1f} s, {m['rays'] / 1e6:.0f} M rays" for m in measured]
    return result, "\n".join([*lines, f"{len(result['materials'])} materials in {folder}"])


@library.command("import")
@click.argument("source", type=PATH)
@click.option("--name", required=True, help="Its name in the library.")
@click.option("--class", "material_class", required=True, help="Its class: carpet, fabric, felt, leather, stone, …")
@click.option("--library", "folder", required=True, type=PATH, help="Folder to add it to.")
@click.option("--size-mm", type=float, help="Width of the patch.  [default: as the file says]")
@click.option("--texel-mm", type=float, help="Edge of a texel, instead of --size-mm.")
@click.option(
    "--cosine",
    type=click.Choice(["auto", "included", "excluded", "header"]),
    default="auto",
    show_default=True,
    help="Whether cos(theta) of the light is in the data; auto asks reciprocity, then the file's header.",
)
@click.option("--components", type=int, help="Components kept.  [default: a linear FMF file's own, else 32]")
@click.option("--gamma", type=float, help="Of 8-bit images.  [default: sRGB]")
@click.option("--scale", type=float, default=1.0, show_default=True, help="Multiplies images.")
@click.option("--flip-v", is_flag=True, help="Turns the rows of texels over.")
@click.option("--replace", "replace_old", is_flag=True, help="Replaces a material of the same name.")
@command
def library_import(*, source, folder, reporter, **options):
    """Adds SOURCE: a UBO2014 .btf file, or a folder or zip of 81 x 81 images (UBO2003, ATRIUM, UTIA)."""
    from btfsep_engine.btf.importing import import_material

    with reporter.stage("import"):
        result = import_material(folder, source, reporter=reporter, **options)
    return {"library": str(folder), **result}, words.imported(result)


@library.command("check")
@click.argument("name", required=False)
@LIBRARY
@command
def library_check(*, name, library_folder, reporter):
    """Looks over NAME, or all: content against the index, finite, reciprocal, less light out than in."""
    from btfsep_engine.btf.checks import check

    opened, results = opened_library(library_folder), []
    names = [name] if name else opened.names()
    for number, one in enumerate(names):
        reporter.progress("check", number / len(names), one)
        results.append(check(opened, one))
        for problem in results[-1]["problems"]:
            reporter.warn(f"{one}: {problem}")
    reporter.progress("check", 1.0)
    result = {"library": str(opened.folder), "materials": results}
    bad = [r for r in results if not r["ok"]]
    if bad:
        first = f"{bad[0]['name']}: {bad[0]['problems'][0]}"
        raise InputError(
            f"library {opened.folder}",
            f"{len(bad)} of {len(results)} materials are bad ({first})",
            "import them again",
            result=result,
        )
    return result, words.checked(results)


@library.command("remove")
@click.argument("name")
@click.option("--library", "folder", required=True, type=PATH, help="Folder to take it out of.")
@command
def library_remove(*, name, folder, reporter):
    """Takes the material NAME out of a library folder, and its file."""
    from btfsep_engine.btf.storing import remove

    remove(folder, name)
    return {"library": str(folder), "removed": name}, f"removed {name} from {folder}"
