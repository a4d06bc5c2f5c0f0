# SPDX-License-Identifier: GPL-3.0-or-later
"""The default library: every procedural material drawn, measured and stored, resumable."""

import hashlib
import json
from pathlib import Path

import numpy as np

from btfsep_engine.btf import procedural
from btfsep_engine.btf.directions import ubo2014_directions
from btfsep_engine.btf.library import Library, entries_of, is_whole, open_library, unknown_material
from btfsep_engine.btf.storing import add
from btfsep_engine.progress import Reporter

# What the default library is measured with; the time and size that follow are in docs/library.md.
VERSION = 2  # of the measurement; another one when the same maps would give another material
DEFAULT_SETTINGS = {"mesh": 512, "texels": 80, "samples": 1, "components": 8, "seed": 0}


def build(
    folder,
    *,
    names=None,
    reporter: Reporter | None = None,
    told=None,
    **settings,
) -> Library:
    """Measures the procedural materials into ``folder``. What was built with the same settings is kept.

    Parameters
    ----------
    folder : made if it is not there
    names : some of :data:`btfsep_engine.btf.procedural.NAMES`; None: all 42. Other entries of the folder stay
    reporter : told the progress of each material
    told : called with a dict of each material that was measured: name, seconds, rays, rays_per_second
    settings : mesh, texels, samples, components, seed in place of :data:`DEFAULT_SETTINGS`

    Raises
    ------
    InputError
        An unknown name; a folder that cannot be written; no working renderer.
    """
    from btfsep_engine.render.patch import measure

    unknown = set(settings) - set(DEFAULT_SETTINGS)
    if unknown:
        raise ValueError(f"no such settings: {sorted(unknown)}")
    settings = DEFAULT_SETTINGS | settings
    names = list(procedural.NAMES if names is None else names)
    for name in names:
        if name not in procedural.NAMES:
            raise unknown_material(name, procedural.NAMES)
    folder, reporter = Path(folder), reporter or Reporter()
    entries = entries_of(folder)
    for number, name in enumerate(names):
        reporter.progress("library", number / len(names), name)
        maps = procedural.maps(name, settings["mesh"])
        made_by = digest(maps, settings)
        if name in entries and entries[name].made_by == made_by and is_whole(folder, entries[name]):
            continue
        rest = {key: value for key, value in settings.items() if key != "mesh"}
        measured = measure(maps, reporter=reporter, **rest)
        if told:
            told({"name": name, **measured.speed()})
        # the file keeps the height at the texels' own resolution
        step = max(1, len(maps.height_mm) // settings["texels"])
        entries[name] = add(
            folder,
            measured.material,
            height_mm=maps.height_mm[::step, ::step],
            setup="virtual gonioreflectometer, displaced patch",
            relative_error=measured.relative_error,
            made_by=made_by,
            overwrite=True,
        )
    reporter.progress("library", 1.0)
    return open_library(folder)


def export_maps(name: str, folder, resolution: int = 1024, variation: int = 0) -> procedural.Maps:
    """Writes ``basecolor.exr`` (linear RGB), ``height.exr`` (mm, mean 0), ``roughness.exr`` of a procedural material.

    The top row of a file is the largest v, as image textures are read (the maps in memory begin with the smallest).

    Returns
    -------
    Maps : what was written, with size_mm and f0

    Raises
    ------
    InputError
        An unknown name; a folder that cannot be written.
    """
    from btfsep_engine.images import write_exr

    maps = procedural.maps(name, resolution, variation=variation)
    for file, values in (("basecolor", maps.base_colour), ("height", maps.height_mm), ("roughness", maps.roughness)):
        write_exr(Path(folder) / f"{file}.exr", np.ascontiguousarray(values[::-1]))
    return maps


def digest(maps: procedural.Maps, settings: dict) -> str:
    sha = hashlib.sha256(json.dumps([VERSION, settings, maps.size_mm, maps.f0], sort_keys=True).encode())
    sha.update(np.round(ubo2014_directions(), 6).tobytes())
    for values in (maps.base_colour, maps.height_mm, maps.roughness, *maps.metal()):
        sha.update(np.round(values, 3).tobytes())  # rounded: not for the last bit of a sine
    return sha.hexdigest()
