# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs by Cycles with their jobs, made once and kept: what the figures and studies estimate."""

from pathlib import Path

import numpy as np
from blender_btfsep.export import export_job

from scripts.cycles import studio
from scripts.cycles.demo import quiet

WHITE = "reference/white-diffuse"
COVERAGE = "coverage.npy"  # (h, w), how much of each pixel shows the object


def folder_name(object_name, material, light) -> str:
    """The folder of a photograph among others."""
    return f"{object_name}_{material.replace('/', '-')}_{Path(str(light)).stem}"


def library_name(material) -> str:
    """What the library calls the studio's ``material``."""
    return WHITE if material == "white" else material


def photograph(folder: Path, object_name, material, light, *, resolution: int, samples: int) -> None:
    """Renders one photo and exports its job (photo, base mesh, camera), unless both are there.

    Parameters
    ----------
    folder : made if it is not there; job.json is written last
    object_name, material, light : see :func:`scripts.cycles.studio.make_scene`
    resolution : pixels, of both edges
    samples : of Cycles, per pixel
    """
    if (folder / "job.json").exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    with quiet():
        scene, _, base, _ = studio.make_scene(object_name, material, light, resolution=resolution)
        studio.render_photo(scene, folder / "rendered.exr", samples)
        np.save(folder / COVERAGE, studio.object_mask(scene))
        export_job(scene, folder, image_path=folder / "rendered.exr", objects=[base], occluders=[])
