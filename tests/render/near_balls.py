# SPDX-License-Identifier: GPL-3.0-or-later
"""Two white balls under a lamp nearby, shaded in closed form."""

from functools import cache

import numpy as np
import trimesh

from btfsep_engine import sh
from btfsep_engine.btf.library import open_library
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.settings import choose
from scripts.studies.measures import order2
from tests.render.scenes import as_mesh, job_of, looking_down, picture, scene_of, with_photo

ALBEDO, FIRST, SECOND = 0.8, np.array([-0.55, 0.1, 0.0]), np.array([0.5, -0.25, 0.15])
RADIUS = 0.42  # of each ball; a single one would do: its normal says where a point is
WHERE = np.array([-0.1, -0.8, 0.6])


def balls():
    two = [trimesh.creation.icosphere(4, RADIUS).apply_translation(at) for at in (FIRST, SECOND)]
    return as_mesh(trimesh.util.concatenate(two))


def photographed(distance: float, *, sky=0.25):
    """Two white balls under an even sky and a lamp at a distance from their middle, without their own reflections."""
    job = job_of([balls()], looking_down())
    scene = scene_of(job)
    points = scene.points(0, textured=False)
    low, high = job.objects[0].mesh.vertices.min(0), job.objects[0].mesh.vertices.max(0)
    centre, size = (low + high) / 2, np.linalg.norm(high - low) / 2
    direction = WHERE / np.linalg.norm(WHERE)
    to_lamp = centre + distance * size * direction - points.position
    away = np.linalg.norm(to_lamp, axis=1)
    cosine = np.maximum((points.normal * to_lamp).sum(1) / away, 0)
    seen = ALBEDO / np.pi * (np.pi * cosine * (distance * size / away) ** 2 + np.pi * sky)
    image = picture(points, seen[:, None], noise=0.02)
    truth = sh.evaluate(4, direction)[:, None] * np.full(3, np.pi)
    truth[0] += sky * np.sqrt(4 * np.pi)
    return scene_of(with_photo(job, image)), direction, centre, size, truth


def off(found, truth) -> float:
    return order2(found.fit.coefficients, truth)


def estimated(scene, others=()):
    settings = choose("draft", refine="all", bounces=1, directions=1024)
    return estimate(scene, open_library(None), settings, material="reference/white-diffuse", others=others)


@cache
def found_at(distance: float):
    """The estimate of `photographed`, and what that gives: found by the first test that asks."""
    photo = photographed(distance)
    return estimated(photo[0]), photo
