# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs by Cycles of displaced objects under Blender's own studio lights, which nothing was trained on.

scripts/study photos FOLDER                                    4 objects x 4 materials x 4 lights
scripts/study photos FOLDER --lights forest --resolution 192

Each is a job folder OBJECT_MATERIAL_LIGHT, which most studies take; what is there already stays. The displaced maps are
another instance of the material than the library's.
"""

import itertools
import json
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from btfsep_engine.errors import InputError
from scripts.cycles.lights import light_path, studio_lights, true_lighting
from scripts.studies import ROOT, parser

WHITE = "reference/white-diffuse"
PLAIN = "plain"  # folder in one of photographs of the library's materials, for those of others: no study meets them
MATERIALS = ("white", "leather/brown-grain", "fabric/denim-twill", "wood/walnut-lacquered")
OBJECTS = ("suzanne", "blob", "vase", "cloth")
LIGHTS = ("courtyard", "sunset", "city", "interior")
IN_BLENDER = """import bpy, runpy, sys  # bpy first: it brings bmesh
from btfsep_engine.errors import InputError
try:
    runpy.run_module(sys.argv[1], run_name="__main__")
except InputError as error:
    print(f"error: {error}", file=sys.stderr)
    sys.exit(2)
"""


@dataclass(frozen=True)
class Shot:
    """One photograph to take, as :mod:`scripts.cycles.shoot` reads it.

    Attributes
    ----------
    folder : of the job; ``name`` of the picture in it
    object, material, seed, variation, thickness, fill : of :func:`scripts.cycles.studio.make_scene`
    light : a studio light's name, the path of a map, or None: dark
    sun : None, or {direction, irradiance, degrees} of a Sun lamp
    ball, wall : None, or {place, radius, radiance}, {place, edge, colour} of what stands beside, in the object's radii
        (half the diagonal of its bounding box)
    table : None, or {edge, colour, checks} of what the object stands on; the job has it as an occluder
    maps : None, or {folder, size_mm, height_mm} of a texture set by others, which ``material`` then only names
    """

    folder: str
    object: str
    material: str
    light: str | None
    name: str = "rendered.exr"
    seed: int = 0
    variation: int = 1
    thickness: float = 1.0
    fill: float = 0.84
    sun: dict | None = None
    ball: dict | None = None
    wall: dict | None = None
    table: dict | None = None
    maps: dict | None = None


@dataclass(frozen=True)
class Photograph:
    """A job folder OBJECT_MATERIAL_LIGHT; ``shown`` is the material's part of its name, ``material`` the library's."""

    folder: Path
    object: str
    shown: str
    light: str

    @property
    def material(self) -> str:
        return library_name(self.shown)

    def truth(self, order: int) -> np.ndarray:
        """The light's coefficients ((order + 1)^2, 3)."""
        return true_lighting(self.light, order)


def library_name(material: str) -> str:
    """What the library calls a material of the studio, or of a folder's name."""
    return WHITE if material == "white" else material if "/" in material else material.replace("-", "/", 1)


def studio_name(material: str) -> str:
    """What the studio calls a material of the library."""
    return "white" if material == WHITE else material


def folder_name(object_name, material, light) -> str:
    """The folder of a photograph among others."""
    return f"{object_name}_{material.replace('/', '-')}_{Path(str(light)).stem}"


def shot(folder: Path, object_name, material, light, **more) -> Shot:
    """A photograph in its own folder in ``folder``."""
    return Shot(str(folder / folder_name(object_name, material, light)), object_name, material, str(light), **more)


def take(shots, *, resolution: int = 256, samples: int = 64, threads: int = 0, noise=None, denoise=False) -> None:
    """Takes the photographs that are not there yet, in a process of its own with Blender."""
    if not shots:
        return
    task = {"resolution": resolution, "samples": samples, "threads": threads, "noise": noise, "denoise": denoise}
    task["shots"] = [asdict(s) for s in shots]
    in_blender("scripts.cycles.shoot", task)


def in_blender(module: str, task) -> None:
    """Runs a module that needs Blender, with JSON on its standard input."""
    command = [sys.executable, "-c", IN_BLENDER, module]
    child = subprocess.run(command, input=json.dumps(task), text=True, cwd=ROOT, check=False)
    if child.returncode:
        raise SystemExit(child.returncode)


def photographs_in(folder: Path, *, objects=None, materials=None, lights=None) -> list[Photograph]:
    """The photographs in a folder, some of the objects, materials (as folders are named) and lights.

    Raises InputError where there are none.
    """
    names = [p for p in sorted(Path(folder).glob("*")) if (p / "job.json").exists() and p.name.count("_") == 2]
    every = [Photograph(p, *p.name.split("_")) for p in names]
    wanted = ((objects, "object"), (materials, "shown"), (lights, "light"))
    some = [p for p in every if all(not given or getattr(p, key) in given for given, key in wanted)]
    if not some:
        raise InputError(str(folder), "it has no such jobs OBJECT_MATERIAL_LIGHT", "make them by scripts/study photos")
    return some


def views(photographs) -> dict:
    """{(object, material's part of the name): [Photograph, one a light]}."""
    out: dict = {}
    for p in photographs:
        out.setdefault((p.object, p.shown), []).append(p)
    return out


def main(arguments) -> int:
    options = parser("photos", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--objects", nargs="+", default=OBJECTS)
    options.add_argument("--materials", nargs="+", default=MATERIALS)
    options.add_argument("--lights", nargs="+", default=LIGHTS, help=f"some of: {', '.join(studio_lights())}")
    options.add_argument("--resolution", type=int, default=256)
    options.add_argument("--samples", type=int, default=64, help="of Cycles, a pixel")
    given = options.parse_args(arguments)
    if unknown := [light for light in given.lights if not light_path(light).exists()]:
        known = ", ".join(studio_lights())
        options.error(f"no light is called {', '.join(unknown)}; choose from {known}, or name a map")
    # a material on an object under all lights: the displaced mesh is made once
    grid = itertools.product(given.objects, given.materials, given.lights)
    take([shot(given.folder.resolve(), *g) for g in grid], resolution=given.resolution, samples=given.samples)
    return 0
