# SPDX-License-Identifier: GPL-3.0-or-later
"""Measuring a material from texture maps into a library folder."""

import hashlib
import json
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path

import numpy as np

from btfsep_engine import __version__
from btfsep_engine.btf.building import DEFAULT_SETTINGS, VERSION
from btfsep_engine.btf.directions import ubo2014_directions
from btfsep_engine.btf.importing import full_name
from btfsep_engine.btf.library import entries_of, file_sha256
from btfsep_engine.btf.linear import CLASSES
from btfsep_engine.btf.storing import add
from btfsep_engine.btf.texture_maps import TextureMaps, read_maps
from btfsep_engine.checkpoints import EVERY, Checkpoints
from btfsep_engine.errors import InputError
from btfsep_engine.progress import Reporter
from btfsep_engine.render.patch import measure

LIMITS = {"texels": (8, 1024), "samples": (1, 256), "components": (2, 64), "seed": (0, 2**31 - 1), "mesh": (4, 2048)}
TEXEL_MM, FEWEST_AND_MOST = 0.5, (80, 160)  # the grain of leather, 80 mm of it, is lost with 1 mm and seen with 0.5


@dataclass(frozen=True)
class MeasureSettings:
    """How a material is measured; see :func:`btfsep_engine.render.patch.measure`.

    Attributes
    ----------
    texels : along an edge; None: see :func:`default_texels`
    samples : paths a texel and view
    components : of the factorisation
    seed : of all random numbers
    mesh : vertices along an edge of a tile
    f0 : specular reflectance at normal incidence
    normal_convention : "auto", "opengl" or "directx"
    """

    texels: int | None = None
    samples: int = DEFAULT_SETTINGS["samples"]
    components: int = DEFAULT_SETTINGS["components"]
    seed: int = DEFAULT_SETTINGS["seed"]
    mesh: int = DEFAULT_SETTINGS["mesh"]
    f0: float = 0.04
    normal_convention: str = "auto"

    def checked(self, size_mm: float) -> "MeasureSettings":
        """Itself, the texels filled in. Raises InputError where a number is out of its range."""
        for key, (low, high) in LIMITS.items():
            value = getattr(self, key)
            if value is not None and not low <= value <= high:
                raise InputError(f"--{key} {value}", "it is out of range", f"give {low} to {high}")
        return self if self.texels else replace(self, texels=default_texels(size_mm))


def default_texels(size_mm: float) -> int:
    """Texels along an edge of about :data:`TEXEL_MM`, within :data:`FEWEST_AND_MOST` (time grows with the square)."""
    fewest, most = FEWEST_AND_MOST
    return int(min(max(fewest, np.ceil(np.nan_to_num(size_mm) / TEXEL_MM)), most))


def measure_maps(
    maps_folder,
    *,
    name: str,
    material_class: str,
    size_mm: float,
    library,
    height_mm: float | None = None,
    settings: MeasureSettings | None = None,
    replace_old: bool = False,
    reporter: Reporter | None = None,
    directions=None,
    every: int = EVERY,
) -> dict:
    """Measures the maps of a folder into a library folder.

    A run that was stopped goes on from its last kept views when it is started again with the same maps and settings,
    and gives the file that it would have given. What is in the library already, measured like this, stays.

    Parameters
    ----------
    maps_folder, size_mm, height_mm : see :func:`btfsep_engine.btf.texture_maps.read_maps`
    name, material_class : "class/name" in the library
    library : folder, made if it is not there
    settings : MeasureSettings
    replace_old : whether another material of this name is replaced
    reporter : told the progress; stages "maps", "measure", "writing"
    directions : (n, 3) float, unit, local, of lights and views; None: the 151 of UBO2014
    every : views from one checkpoint to the next

    Returns
    -------
    dict : name, class, library, file, size (bytes), relative_error, components, texels, texel_mm, relief_mm, maps (kind
        -> file name), normal_convention, measured (False: it was there already), speed (of this run: seconds, rays,
        rays_per_second; None: nothing was measured), warnings

    Raises
    ------
    InputError
        Maps, name, numbers or library folder that will not do; no working renderer.
    """
    settings, reporter = (settings or MeasureSettings()).checked(size_mm), reporter or Reporter()
    full = full_name(name, material_class)
    if material_class not in CLASSES:
        reporter.warn(
            f"'{material_class}' is none of the usual classes ({', '.join(CLASSES)}); it is a class of its own"
        )
    directions = ubo2014_directions() if directions is None else np.asarray(directions, np.float64)
    library = Path(library)
    with reporter.stage("maps"):
        read = read_maps(
            maps_folder,
            name=full,
            size_mm=size_mm,
            height_mm=height_mm,
            resolution=settings.mesh,
            f0=settings.f0,
            normal_convention=settings.normal_convention,
            reporter=reporter,
        )
    made_by = measurement_digest(read.maps, settings, directions)
    entry, was_there, speed = entries_of(library).get(full), False, None
    if entry is not None:
        was_there = entry.made_by == made_by and _holds(library / entry.file, entry.sha256)
        if not was_there and not replace_old:
            raise InputError(f"material '{full}'", "the library has one of this name", "use another name, or --replace")
    if not was_there:
        entry, speed = _measure_and_add(read, settings, directions, library, made_by, every, replace_old, reporter)
    return {
        "name": full,
        "class": material_class,
        "library": str(library),
        "file": entry.file,
        "size": entry.size,
        "relative_error": entry.relative_error,
        "components": entry.components,
        "texels": list(entry.texels),
        "texel_mm": entry.texel_mm,
        "relief_mm": round(read.relief_mm, 4),
        "maps": read.files,
        "normal_convention": read.normal_convention,
        "measured": not was_there,
        "speed": speed,
        "warnings": list(reporter.warnings),
    }


def _measure_and_add(read: TextureMaps, settings, directions, library, made_by, every, replace_old, reporter):
    maps = read.maps
    checkpoints = Checkpoints("measure", made_by, every=every, reporter=reporter)
    with reporter.stage("measure"):
        found = measure(
            maps,
            texels=settings.texels,
            samples=settings.samples,
            components=settings.components,
            lights=directions,
            views=directions,
            seed=settings.seed,
            reporter=reporter,
            checkpoints=checkpoints,
        )
    albedo = found.material.directional_albedo()
    if albedo.max() >= 1:
        reporter.warn(f"{maps.name}: from some views it reflects {albedo.max():.0%} of the light; take more --samples")
    with reporter.stage("writing"):
        entry = add(
            library,
            found.material,
            setup="virtual gonioreflectometer, displaced patch",
            layout="dfmf",  # what other programs read, pysmtb among them; it has no place for the height
            source="maps: " + ", ".join(read.files.values()),
            relative_error=found.relative_error,
            made_by=made_by,
            overwrite=replace_old,
        )
    checkpoints.remove()
    return entry, found.speed()


def measurement_digest(maps, settings: MeasureSettings, directions) -> str:
    """A hash of all that a measurement depends on: the maps to the last bit, settings, directions, versions."""
    versions = {package: metadata.version(package) for package in ("mitsuba", "drjit", "numpy")}
    facts = [VERSION, __version__, versions, maps.name, maps.size_mm, maps.f0]
    facts += [settings.texels, settings.samples, settings.components, settings.seed]
    sha = hashlib.sha256(json.dumps(facts, sort_keys=True).encode())
    for values in (maps.base_colour, maps.height_mm, maps.roughness, *maps.metal(), np.asarray(directions, np.float64)):
        sha.update(repr(values.shape).encode() + np.ascontiguousarray(values).tobytes())
    return sha.hexdigest()


def _holds(path: Path, sha256: str) -> bool:
    return path.is_file() and file_sha256(path) == sha256
