# SPDX-License-Identifier: GPL-3.0-or-later
"""An egg and a pebble of a surface by numbers, photographed, and estimates by jobs that say another surface."""

from dataclasses import replace

import numpy as np

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import GIVEN, Surface
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.render.homogeneous import homogeneous
from tests.engine.half_sphere import even, lamp
from tests.render.scenes import egg_and_pebble, job_of, looking_down, picture, scene_of, with_photo

SETTINGS = choose("draft", bounces=1)
DIRECTION = np.array([0.6, -0.2, 0.77]) / np.linalg.norm([0.6, -0.2, 0.77])
SOFT = np.repeat(np.exp(-0.02 * np.arange(10) ** 2), 2 * np.arange(10) + 1)[:, None]
LIGHT = even((0.5,) * 3) + lamp(DIRECTION, (3.0, 3.0, 3.0)) * SOFT


def photo_maker():
    """A function Surface -> the job of an egg and a pebble of it, with a camera's noise in the photo."""
    scene = scene_of(job_of([egg_and_pebble()], looking_down()))
    points = scene.points(0, region=scene.view.mesh == 0, textured=False)

    def made(surface: Surface):
        values = scene.radiance(points, homogeneous(surface, GIVEN), SHLighting(LIGHT), directions=4096)[:, 0]
        return with_photo(scene.job, picture(points, values, noise=0.02))

    return made


def found_of(job, surface: Surface, **changes):
    """The estimate of a job that says this surface; ``changes`` : of the settings."""
    told = replace(job, objects=(replace(job.objects[0], surface=surface),))
    return estimate(scene_of(told), open_library(None), replace(SETTINGS, **changes))
