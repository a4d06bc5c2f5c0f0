# SPDX-License-Identifier: GPL-3.0-or-later
"""Things under a lamp and a soft sky, for tests of what lights or paints a part of them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import trimesh

from btfsep_engine import sh
from btfsep_engine.btf.surfaces import GIVEN, Surface
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.light.sun import Sun
from btfsep_engine.pipeline.materials import ObjectMaterial
from btfsep_engine.pipeline.model import first_model, solve_model
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.render.homogeneous import homogeneous
from scripts.studies.measures import order2
from tests.render.scenes import as_mesh, job_of, looking_down, picture, scene_of, with_photo

SETTINGS = choose("draft", refine="all", bounces=1, directions=512)
TOWARDS = np.array([-0.45, 0.3, 0.84]) / np.linalg.norm([-0.45, 0.3, 0.84])
LAMP = 3.0  # irradiance
SKY = np.array([1.5, 0.3, 0.5, -0.2])
TRUTH = LAMP * sh.evaluate(9, TOWARDS)[:, None] * np.ones(3) + np.pad(SKY, (0, 96))[:, None]
MATTE = Surface((0.4, 0.4, 0.4), roughness=1.0, specular=0.0)


def beyond(pixels):
    """(p,) how many pixels they lie beyond a line across the picture."""
    return pixels @ [0.6, 0.8] - 67


def lit_things(surface=MATTE):
    """Balls on a larger one, of a surface, under a soft sky and a lamp: what either makes of it, and a half of it."""
    parts = [trimesh.creation.icosphere(4, 0.55)]
    for i, a in enumerate(2 * np.pi * np.arange(6) / 6):
        place = 0.5 * np.cos(a), 0.5 * np.sin(a), 0.25 + 0.05 * i
        parts.append(trimesh.creation.icosphere(3, 0.22).apply_translation(place))
    job = job_of([as_mesh(trimesh.util.concatenate(parts))], looking_down())
    scene = scene_of(replace(job, objects=(replace(job.objects[0], surface=surface),)))
    points, material = scene.points(0, region=scene.view.mesh == 0, textured=False), homogeneous(surface, GIVEN)
    sky = scene.radiance(points, material, SHLighting(np.repeat(SKY[:, None], 3, 1)), directions=4096)[:, 0]
    lamp = scene.sun_radiance(points, material, Sun(TOWARDS, np.full(3, LAMP), np.zeros(3)))
    half, known = beyond(points.pixels)[:, None] > 0, ObjectMaterial(GIVEN, material, True)
    return SimpleNamespace(scene=scene, points=points, known=known, sky=sky, lamp=lamp, half=half)


def photo_of(things, values, *, seed=0, noise=0.02, **more):
    """A scene whose photo shows values (p, 3), with a camera's noise."""
    job = with_photo(things.scene.job, picture(things.points, values, noise=noise, seed=seed))
    return scene_of(replace(job, **more))


def shaded(things):
    """What is seen where a straight edge keeps the lamp from a half of the objects."""
    return things.sky + things.half * things.lamp


def painted(things, colour):
    """What is seen where half of the objects reflects so much of what the other half does."""
    return (things.sky + things.lamp) * np.where(things.half, 1, colour)


def solved(things, *scenes, settings=SETTINGS):
    """The model of photographs, and its light, before anything is refined."""
    return solve_model(first_model(list(scenes), [[things.known]] * len(scenes), settings))


def off(light):
    return order2(light.fit.coefficients, TRUTH[:9])


def degrees_off(light):
    """Of the brightest lamp's direction."""
    brightest = max(light.fit.lamps, key=lambda lamp: lamp.irradiance.sum())
    return np.degrees(np.arccos(np.clip(brightest.direction @ TOWARDS, -1, 1)))
