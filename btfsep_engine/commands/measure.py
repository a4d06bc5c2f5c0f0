# SPDX-License-Identifier: GPL-3.0-or-later
"""Measuring materials into a library folder: those of a user's texture maps, and the procedural ones."""

import hashlib
import json
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path

import numpy as np

from btfsep_engine import __version__
from btfsep_engine.btf import procedural
from btfsep_engine.btf.directions import ubo2014_directions
from btfsep_engine.btf.importing import full_name
from btfsep_engine.btf.library import Library, entries_of, is_whole, open_library, unknown_material
from btfsep_engine.btf.linear import CLASSES
from btfsep_engine.btf.map_files import CONVENTIONS
from btfsep_engine.btf.storing import add
from btfsep_engine.btf.texture_maps import read_maps
from btfsep_engine.errors import InputError
from btfsep_engine.pipeline.settings import changed, setting
from btfsep_engine.progress import Reporter
from btfsep_engine.render.patch import measure
from btfsep_engine.storage.cache import digest
from btfsep_engine.storage.checkpoints import EVERY, Checkpoints

VERSION = 2  # of the measurement; another one when the same maps would give another material
# what the default library is measured with; the time and size that follow are in docs/library.md
DEFAULT_SETTINGS = {"mesh": 512, "texels": 80, "samples": 1, "components": 8, "seed": 0}
SETUP = "virtual gonioreflectometer, displaced patch"
TEXEL_MM, FEWEST_AND_MOST = 0.5, (80, 160)  # the grain of leather, 80 mm of it, is lost with 1 mm and seen with 0.5


@dataclass(frozen=True)
class MeasureSettings:
    """How a material is measured; see :func:`btfsep_engine.render.patch.measure`."""

    texels: int | None = setting(
        None, "Along an edge; time grows with their square; by default 2 a mm, 80 to 160", kind=int, low=8, high=1024
    )
    components: int = setting(DEFAULT_SETTINGS["components"], "Components of the factorisation", low=2, high=64)
    samples: int = setting(
        DEFAULT_SETTINGS["samples"], "Paths a texel and view; the time grows with them", low=1, high=256
    )
    seed: int = setting(
        DEFAULT_SETTINGS["seed"], "Of all random numbers; the same one gives the same file", low=0, high=2**31 - 1
    )
    mesh: int = setting(DEFAULT_SETTINGS["mesh"], "Vertices along an edge of a tile", low=4, high=2048)
    f0: float = setting(0.04, "Specular reflectance at normal incidence", low=0, high=0.2)
    normal_convention: str = setting(
        "auto", "Whether green of the normal map points up (OpenGL) or down (DirectX)", choices=CONVENTIONS
    )

    def checked(self, size_mm: float) -> "MeasureSettings":
        """Itself, the texels filled in. Raises InputError where a number is out of its range."""
        within = changed(self, **vars(self))
        return within if within.texels else replace(within, texels=default_texels(size_mm))


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
        was_there = entry.made_by == made_by and is_whole(library, entry)
        if not was_there and not replace_old:
            raise InputError(f"material '{full}'", "the library has one of this name", "use another name, or --replace")
    if not was_there:
        checkpoints = Checkpoints("measure", made_by, every=every, reporter=reporter)
        with reporter.stage("measure"):
            found = _measured(
                read.maps, settings, lights=directions, views=directions, reporter=reporter, checkpoints=checkpoints
            )
        albedo = found.material.directional_albedo()
        if albedo.max() >= 1:
            reporter.warn(f"{full}: from some views it reflects {albedo.max():.0%} of the light; take more --samples")
        with reporter.stage("writing"):
            entry = add(
                library,
                found.material,
                setup=SETUP,
                layout="dfmf",  # what other programs read, pysmtb among them; it has no place for the height
                source="maps: " + ", ".join(read.files.values()),
                relative_error=found.relative_error,
                made_by=made_by,
                overwrite=replace_old,
            )
        checkpoints.remove()
        speed = found.speed()
    of_run = {"measured": not was_there, "speed": speed, "warnings": list(reporter.warnings)}
    return {"name": full, "class": material_class, "library": str(library)} | _record(entry, read) | of_run


def _record(entry, read) -> dict:
    """What is said of a measured material: of its entry in the library, and of the maps that were read."""
    numbers = ("file", "size", "relative_error", "components", "texel_mm")
    return {key: getattr(entry, key) for key in numbers} | {
        "texels": list(entry.texels),
        "relief_mm": round(read.relief_mm, 4),
        "maps": read.files,
        "normal_convention": read.normal_convention,
    }


def _measured(maps: procedural.Maps, settings: MeasureSettings, **options):
    """:func:`btfsep_engine.render.patch.measure` with these settings."""
    numbers = {key: getattr(settings, key) for key in ("texels", "samples", "components", "seed")}
    return measure(maps, **numbers, **options)


def measurement_digest(maps: procedural.Maps, settings: MeasureSettings, directions) -> str:
    """A key of all that a measurement depends on: the maps to the last bit, settings, directions, versions."""
    versions = [metadata.version(package) for package in ("mitsuba", "drjit", "numpy")]
    numbers = [settings.texels, settings.samples, settings.components, settings.seed]
    return digest(VERSION, __version__, versions, maps, numbers, np.asarray(directions, np.float64))


def build(folder, *, names=None, reporter: Reporter | None = None, on_measured=None, **settings) -> Library:
    """Measures the procedural materials into ``folder``. What was built with the same settings is kept.

    Parameters
    ----------
    folder : made if it is not there
    names : some of :data:`btfsep_engine.btf.procedural.NAMES`; None: all 42. Other entries of the folder stay
    reporter : told the progress of each material
    on_measured : called with a dict of each material that was measured: name, seconds, rays, rays_per_second
    settings : mesh, texels, samples, components, seed in place of :data:`DEFAULT_SETTINGS`

    Raises
    ------
    InputError
        An unknown name; a folder that cannot be written; no working renderer.
    """
    settings = MeasureSettings(**DEFAULT_SETTINGS | settings)
    names = list(procedural.NAMES if names is None else names)
    for name in names:
        if name not in procedural.NAMES:
            raise unknown_material(name, procedural.NAMES)
    folder, reporter = Path(folder), reporter or Reporter()
    entries = entries_of(folder)
    for number, name in enumerate(names):
        reporter.progress("library", number / len(names), name)
        maps = procedural.maps(name, settings.mesh)
        made_by = build_digest(maps, settings)
        if name in entries and entries[name].made_by == made_by and is_whole(folder, entries[name]):
            continue
        found = _measured(maps, settings, reporter=reporter)
        if on_measured:
            on_measured({"name": name, **found.speed()})
        step = max(1, len(maps.height_mm) // settings.texels)  # the file keeps the height at the texels' resolution
        entries[name] = add(
            folder,
            found.material,
            height_mm=maps.height_mm[::step, ::step],
            setup=SETUP,
            relative_error=found.relative_error,
            made_by=made_by,
            overwrite=True,
        )
    reporter.progress("library", 1.0)
    return open_library(folder)


def build_digest(maps: procedural.Maps, settings: MeasureSettings) -> str:
    """The same for procedural maps, rounded: not for the last bit of a sine, nor for a version."""
    numbers = {key: getattr(settings, key) for key in DEFAULT_SETTINGS}
    sha = hashlib.sha256(json.dumps([VERSION, numbers, maps.size_mm, maps.f0], sort_keys=True).encode())
    sha.update(np.round(ubo2014_directions(), 6).tobytes())
    for values in (maps.base_colour, maps.height_mm, maps.roughness, *maps.metal()):
        sha.update(np.round(values, 3).tobytes())
    return sha.hexdigest()
