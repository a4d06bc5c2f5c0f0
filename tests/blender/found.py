# SPDX-License-Identifier: GPL-3.0-or-later
"""What the engine is taken to have found, for the tests of cards and of lights that are kept."""

import numpy as np

from blender_btfsep.light import (
    card,
    light_words,
    lighting_file,
)
from btfsep_engine import sh
from tests.blender.lit import LIGHTING

SAID = {
    "objects": [{"name": "Cube", "material": "wood/oak", "unknown": False, "candidates": []}],
    "determined": "the photo determines 3 of 4 coefficients",
    "expected_error": {"order_1": None, "order_2": {"median": 0.124, "low": 0.08, "high": 0.2}},
    "choice": {"order": "the order is 4"},
}


def planck(kelvin):
    """Linear Rec.709 of a black body: Planck's law; the CIE 1931 observer as Wyman, Sloan and Shirley (2013) fit it."""
    nm = np.arange(380.0, 781.0)

    def lobe(mean, low, high):
        return np.exp(-0.5 * ((nm - mean) * np.where(nm < mean, low, high)) ** 2)

    x = 0.362 * lobe(442.0, 0.0624, 0.0374) + 1.056 * lobe(599.8, 0.0264, 0.0323) - 0.065 * lobe(501.1, 0.049, 0.0382)
    y = 0.821 * lobe(568.8, 0.0213, 0.0247) + 0.286 * lobe(530.9, 0.0613, 0.0322)
    z = 1.217 * lobe(437.0, 0.0845, 0.0278) + 0.681 * lobe(459.0, 0.0385, 0.0725)
    power = nm**-5 / np.expm1(1.4388e7 / (nm * kelvin))
    return np.linalg.inv(light_words.TO_XYZ) @ np.array([power @ x, power @ y, power @ z])


def coefficients(world):
    inputs = world.node_tree.nodes["BTFsep SH Lighting"].inputs
    return [tuple(s.default_value) for s in inputs if s.name.startswith("Y ")]


def lighting(**more):
    return lighting_file.validate(LIGHTING | more)


def sunny(size=0.5):
    """An even white sky of radiance one, and a warm sun in front, left, 45 degrees up."""
    sky = np.zeros((4, 3))
    sky[0] = np.sqrt(4 * np.pi)
    direction = np.array([-0.5, -0.5, np.sqrt(0.5)])
    power = 3 * planck(3500) / (planck(3500) @ card.LUMINANCE)
    whole = sky + sh.evaluate(1, direction)[:, None] * power
    lamp = {"direction": direction.tolist(), "irradiance": power.tolist(), "size_degrees": size}
    return lighting(coefficients=whole.tolist(), suns={"lamps": [lamp], "sky": sky.tolist()})
