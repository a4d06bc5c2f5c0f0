# SPDX-License-Identifier: GPL-3.0-or-later
"""Lightings with Sun lamps, as the engine writes them."""

import numpy as np

from btfsep_engine import sh
from btfsep_engine.light.files import Lighting, write_lighting
from btfsep_engine.light.sun import Sun

DIRECTION = np.array([-0.6, -0.48, 0.64])
LAMPS = (
    Sun((0.8, 0.0, -0.6), (0.5, 1.0, 2.0), np.zeros(3), size_degrees=5.0),
    Sun((0.0, -1.0, 0.0), (1.0, 1.0, 1.0), np.zeros(3), size_degrees=1.0),
)


def write_sunny(path, *, order=4, direction=DIRECTION, irradiance=(3.0, 2.0, 1.0), size=0.5, sky=None, others=()):
    """A lighting.json as the engine writes it; gives its Lighting."""
    if sky is None:
        sky = np.random.default_rng(3).normal(size=(sh.term_count(order), 3)) * 0.05
        sky[0] = 1.0
    sun = Sun(direction, irradiance, np.zeros(3), size_degrees=size)
    x = sky + sum(s.coefficients(order) for s in (sun, *others))
    light = Lighting(order, x, np.zeros_like(x), np.ones(len(x), bool), 0.0, (sun, *others))
    write_lighting(path, light)
    return light
