# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes and job folders of the tests: what benchmarks look at (`scripts.studies.stage`), and photographs of it."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from btfsep_engine import sh
from btfsep_engine.btf.library import open_library
from btfsep_engine.cli import main
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.fit.stated import reaching_part
from btfsep_engine.job.model import Camera, Job, Photo, TriangleMesh
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.light.sun import Sun
from scripts.studies import stage
from scripts.studies.estimates import scene_of
from scripts.studies.stage import as_mesh, ball, bowl, plate, positive_light

__all__ = (
    "answer", "as_mesh", "ball", "ball_with_another", "bowl", "edited", "egg_and_pebble", "in_white", "job_of",
    "looking_down", "off_as_seen", "picture", "plate", "positive_light", "scene_of", "with_photo",
)  # fmt: skip
job_of = partial(stage.job_of, metres_per_unit=0.05)


def looking_down(size=96, focal=200.0) -> Camera:
    """A square camera on the +z axis that looks down at the origin."""
    return stage.looking_down(size, focal)


def egg_and_pebble(level: int = 4) -> TriangleMesh:
    """Two smooth things beside each other, of which no turn looks like another."""
    egg, pebble = (trimesh.creation.icosphere(level, 1.0) for _ in range(2))
    egg.apply_scale([0.5, 0.7, 0.45])
    pebble.apply_scale([0.3, 0.25, 0.35]).apply_translation([0.55, 0.4, 0.0])
    return as_mesh(trimesh.util.concatenate([egg, pebble]))


def ball_with_another(level: int = 4) -> TriangleMesh:
    """A ball with a smaller one before it, which casts its shadow on it."""
    ball, other = trimesh.creation.icosphere(level, 0.5), trimesh.creation.icosphere(level, 0.25)
    return as_mesh(trimesh.util.concatenate([ball, other.apply_translation((-0.45, 0.3, 0.4))]))


def picture(points, values, *, size: int = 96, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """(size, size, 3) float32: values (p, 3) at the pixels of points, with noise of so much of each; else black."""
    image = np.zeros((size, size, 3), np.float32)
    image[tuple(points.pixels.T)] = values * np.random.default_rng(seed).normal(1, noise, np.shape(values))
    return image


def in_white(mesh, *, noise: float = 0.02):
    """A mesh of white under light from above and a side: its scene, photo with a camera's noise, and light (9, 3)."""
    scene = scene_of(job_of([mesh], looking_down()))
    truth = np.zeros((9, 3))
    truth[0], truth[1], truth[2], truth[3], truth[6] = 3.0, 0.9, 1.2, -1.1, 0.5
    points = scene.points(0, region=scene.view.mesh == 0, textured=False)
    white = open_library(None).load("reference/white-diffuse")
    image = picture(points, scene.radiance(points, white, SHLighting(truth), directions=4096)[:, 0])
    return scene, image * np.random.default_rng(0).normal(1, noise, image.shape).astype(np.float32), truth


def lit_by_a_lamp(scene, seed: int):
    """A photo (96, 96, 3) of white matte things in the light of a lamp from a side, and little else; and that light."""
    direction = np.array([np.cos(seed), np.sin(seed), 0.7])
    sun = Sun(direction / np.linalg.norm(direction), np.full(3, 3.0), np.zeros(3))
    truth = sun.coefficients(2)
    truth[0] += 0.2
    points = scene.points(0, region=scene.view.mesh == 0, textured=False)
    white = open_library(None).load("reference/white-diffuse")
    even = SHLighting(np.array([[0.2] * 3]))
    seen = scene.sun_radiance(points, white, sun) + scene.radiance(points, white, even, directions=512)[:, 0]
    return picture(points, seen, noise=0.01), truth


def with_photo(job: Job, image, usable=None, **more) -> Job:
    """The job with another photograph (h, w, 3), all of it usable unless ``usable`` (h, w) says what."""
    usable = np.ones(image.shape[:2], bool) if usable is None else usable
    return replace(job, photo=Photo(np.asarray(image, np.float32), usable, int((~usable).sum()), **more))


def edited(folder: Path, *, camera=(), first=(), to: Path | None = None, **changes) -> dict:
    """Changes a folder's job.json, or writes the changed one into another folder; gives what is in it then.

    ``camera``, ``first`` : keys of the camera and of the first object; all else are keys of the job
    """
    tree = json.loads((folder / "job.json").read_text())
    tree["camera"] |= camera
    if first:
        tree["objects"][0] |= first
    tree |= changes
    ((to or folder) / "job.json").write_text(json.dumps(tree))
    return tree


def answer(capsys, *command) -> dict:
    """The result of a command."""
    assert main([*map(str, command), "--json"]) == 0
    return json.loads(capsys.readouterr().out.splitlines()[-1])["result"]


def off_as_reaching(fit, truth) -> float:
    """`off_as_seen` of a fit's light, and of the true one (terms, 3), without what does not reach the photo."""
    if fit.hidden is None:
        return off_as_seen(fit.coefficients, truth)
    order = sh.order_of(len(fit.all_coefficients))
    part, whole = reaching_part(fit.hidden, order), np.zeros_like(fit.all_coefficients)
    whole[: len(truth)] = truth
    return off_as_seen(part @ fit.all_coefficients, part @ whole)


def off_as_seen(x, truth) -> float:
    """Relative error of what faces a camera above receives from a light (terms, 3) against the true one's.

    What does not face it, the photo does not show: lights that differ in that alone are the same to it.
    """
    up = fibonacci_sphere(400)
    up = up[up[:, 2] > 0.3]
    found, right = (sh.irradiance(np.asarray(each)[:9], up) for each in (x, truth))
    return float(np.linalg.norm(found - right) / np.linalg.norm(right))
