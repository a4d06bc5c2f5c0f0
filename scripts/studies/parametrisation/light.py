# SPDX-License-Identifier: GPL-3.0-or-later
"""What a material with a grain loses by its parametrisation: radiance, and the light that is estimated from it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from scipy.spatial import cKDTree

from btfsep_engine.job.model import Camera, Job, Photo, TriangleMesh
from btfsep_engine.light.lightings import EnvironmentMaps
from btfsep_engine.light.maps import read_map
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.render.reference import Reference
from scripts.studies import stage
from scripts.studies.estimates import scene_of
from scripts.studies.measures import order2
from scripts.studies.parametrisation.quality import borders

SIZE = 176  # pixels, edge of a photo
SAMPLES = 128  # paths a pixel
NOISE = 0.01  # of a pixel's value
NEAR = 0.003  # metres of a border
DIRECTIONS = 1024
VIEW = np.array([0.75, -1.0, 0.7])
KINDS = ("frames", "texels")
MEAN = "mean ABRDF"  # no charts at all: what the engine takes where the texture explains nothing


def camera(size: int = SIZE) -> Camera:
    """Looks at the origin from `VIEW`, 0.6 m away; ``size`` x ``size`` pixels."""
    back = VIEW / np.linalg.norm(VIEW)
    right = np.cross([0, 0, 1.0], back)
    right /= np.linalg.norm(right)
    to_world = np.eye(4)
    to_world[:3, :3] = np.stack([right, np.cross(back, right), back], 1)
    to_world[:3, 3] = 0.6 * back
    return Camera(size, size, 3.2 * size, 3.2 * size, size / 2, size / 2, to_world)


def job_with(mesh: TriangleMesh, uv, *, size: int = SIZE) -> Job:
    """A job of one mesh with these texture coordinates, its photo black."""
    placed = replace(mesh, corner_uv=np.asarray(uv, np.float32))
    return stage.job_of([placed], camera(size), metres_per_unit=1.0, uv="mesh")


def turned(uv) -> np.ndarray:
    """The same coordinates with the grain crosswise."""
    return np.stack([-uv[..., 1], uv[..., 0]], -1)


def losses(mesh: TriangleMesh, mappings: dict, material, lights) -> dict:
    """What each mapping costs, and `MEAN`, on one shape with a grain in one direction.

    Parameters
    ----------
    mesh : TriangleMesh, metres
    mappings : name -> (f, 3, 2); "own" is how the material lies in the photograph
    material : btf.model.Material
    lights : paths of environment maps

    Returns
    -------
    {name: (away, near, {kind: errors of the estimated light up to order 2, one for each light})}; kinds: "frames",
    where photograph and fit have the mean ABRDF and nothing but the grain's direction differs, and "texels", where both
    have the textured BTF; away, near: relative root mean square difference of the mean ABRDF's radiance from that with
    the true grain, over the pixels more than `NEAR` from a border, and the others (nan: there are none)
    """
    scenes = {name: scene_of(job_with(mesh, uv)) for name, uv in mappings.items()}
    maps = [EnvironmentMaps(read_map(path)[None], ("light",)) for path in lights]
    true = scenes["own"]
    points = true.points(0, textured=True)
    mean = material.mean_material()

    def shown(scene, textured=True):
        some = scene.points(0, textured=textured)
        return scene.radiance(some, mean, maps[0], directions=DIRECTIONS)[:, 0].astype(np.float64)

    wanted = shown(true)
    photos = {
        kind: [photograph(true, points, laid, light) for light in maps]
        for kind, laid in zip(KINDS, (mean, material), strict=True)
    }
    out = {}
    for name in [*mappings, MEAN]:
        scene = scenes.get(name, true)
        off = shown(scene, textured=name != MEAN) - wanted
        close = np.zeros(len(points), bool) if name == MEAN else near_border(mesh, mappings[name], points.position)
        parts = [
            float(np.linalg.norm(off[part]) / np.linalg.norm(wanted[part])) if part.any() else np.nan
            for part in (~close, close)
        ]
        appearance = "mean" if name == MEAN else "textured"
        settings = choose("balanced", appearance=appearance, bounces=1, order=4, key_light="never")
        errors = {}
        for kind, taken in photos.items():
            held = SimpleNamespace(load=lambda _, kind=kind: mean if kind == "frames" else material)
            errors[kind] = []
            for light, photo in zip(maps, taken, strict=True):
                posed = scene_of(replace(scene.job, photo=photo))
                found = estimate(posed, held, settings, material=material.name).lighting.coefficients
                errors[kind].append(order2(found, light.coefficients(2)[0]))
        out[name] = *parts, errors
    return out


def photograph(scene: PreparedScene, points, material, light) -> Photo:
    """Path-traced by Mitsuba, with the material laid as the scene's own coordinates say, and noise."""
    traced = Reference(scene.job, scene.tracer, [material], bounces=1)
    values = traced.radiance(points.pixels, light, samples=SAMPLES, seed=5).radiance[:, 0]
    values = values * (1 + NOISE * np.random.default_rng(7).normal(size=values.shape).astype(np.float32))
    image = np.zeros((SIZE, SIZE, 3), np.float32)
    image[points.pixels[:, 0], points.pixels[:, 1]] = values
    return replace(scene.job.photo, radiance=image)


def near_border(mesh, uv, position) -> np.ndarray:
    """(n,) bool: which positions are within `NEAR` of a border between charts."""
    edges, _, _ = borders(mesh.vertices, mesh.faces, uv)
    if not len(edges):
        return np.zeros(len(position), bool)
    steps = np.linspace(0, 1, 5)[:, None, None]
    along = (edges[:, 0] * (1 - steps) + edges[:, 1] * steps).reshape(-1, 3)
    return cKDTree(along).query(position, distance_upper_bound=NEAR)[0] < np.inf
