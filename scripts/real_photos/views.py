# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles photographs with the basis images of their pixels, computed once and kept."""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import distance_transform_cdt

from btfsep_engine.fit.least_squares import block_labels
from btfsep_engine.job.load import load_job
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.progress import Reporter
from btfsep_engine.render.sampling import spread
from scripts.cycles import studio

MATERIALS = {
    "white": "reference/white-diffuse",
    "leather-brown-grain": "leather/brown-grain",
    "fabric-denim-twill": "fabric/denim-twill",
    "wood-walnut-lacquered": "wood/walnut-lacquered",
}
LIGHTS = ("courtyard", "sunset")
ORDER = 9
PIXELS = 2000
DIRECTIONS = 256
BOUNCES = 4
TEXTURES = {"aligned": "mesh", "not aligned": "xatlas"}


@dataclass(frozen=True)
class View:
    """One object and material: what does not change with the light.

    Attributes
    ----------
    name, material : of the folder
    pixels : (p, 2) row and column, spread over all that shows the object, silhouettes included
    depth : (p,) int, how many pixels inside the silhouette (1: at it)
    normals : (p, 3) unit, world
    basis : {"mean", "aligned", "not aligned"} -> (p, terms, 3) float32; textures only where the material has one
    photos : {light: (h, w, 3) float32}; truths : {light: (terms, 3)}
    region : (h, w) bool, all that shows the object
    """

    name: str
    material: str
    pixels: np.ndarray
    depth: np.ndarray
    normals: np.ndarray
    basis: dict
    photos: dict
    truths: dict
    region: np.ndarray

    @property
    def blocks(self) -> np.ndarray:
        """(p,) int."""
        return block_labels(self.pixels)

    def at(self, image) -> np.ndarray:
        """The pixels' values of an image (h, w, …)."""
        return image[self.pixels[:, 0], self.pixels[:, 1]]


def chosen_folders(photos: Path, lights, every: bool) -> dict:
    """{(object, material): {light: folder}} under any of ``lights``: two materials of each object, or all."""
    found: dict = {}
    for folder in sorted(p for p in Path(photos).iterdir() if (p / "job.json").exists()):
        name, material, light = folder.name.split("_")
        if light in lights and material in MATERIALS:
            found.setdefault(name, {}).setdefault(material, {})[light] = folder
    return {
        (name, material): lights
        for i, (name, materials) in enumerate(found.items())
        for j, (material, lights) in enumerate(materials.items())
        if every or (i + j) % 2 == 0
    }


def read_view(name: str, material: str, folders: dict, library, cache: Path) -> View:
    """The view, its basis images from ``cache`` where they are there."""
    jobs = {light: load_job(folder) for light, folder in folders.items()}
    job = next(iter(jobs.values()))
    photos = {light: each.photo.radiance for light, each in jobs.items()}
    truths = {light: studio.true_lighting(light, ORDER) for light in folders}
    texture = library.load(MATERIALS[material])
    key = hashlib.sha256(f"{job.digest} {PIXELS} {DIRECTIONS} {BOUNCES} {texture.name} normals".encode()).hexdigest()[
        :12
    ]
    path = Path(cache) / f"{name}_{material}_{key}.npz"
    if not path.exists():
        _compute(job, texture, path)
    with np.load(path) as kept:
        basis = {k[6:]: kept[k] for k in kept.files if k.startswith("basis ")}
        return View(
            name, material, kept["pixels"], kept["depth"], kept["normals"], basis, photos, truths, kept["region"]
        )


def _compute(job, material, path: Path) -> None:
    lights = SHBasis(ORDER)
    out = {}
    mean = material.mean_material()
    asked = {"mean": (mean, None)}
    if material.has_texture:
        asked |= {k: (material, uv) for k, uv in TEXTURES.items()}
    for key, (used, uv) in asked.items():
        own = replace(job, objects=(replace(job.objects[0], uv=uv or "mesh"),))
        scene = PreparedScene(own, Reporter())
        region = scene.view.mesh == 0
        points = scene.points(0, region=region, textured=uv is not None)
        points = points.take(spread(points, PIXELS, seed=0))
        indirect = scene.indirect([used], lights, Settings(), bounces=BOUNCES)
        out[f"basis {key}"] = scene.radiance(points, used, lights, directions=DIRECTIONS, indirect=indirect)
        out["pixels"], out["normals"] = points.pixels, points.normal
        inside = distance_transform_cdt(np.pad(region, 1), "chessboard")[1:-1, 1:-1]
        out["depth"], out["region"] = inside[points.pixels[:, 0], points.pixels[:, 1]], region
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part.npz")
    np.savez(part, **out)
    part.rename(path)
