# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lamps become suns."""

from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine.fit.stated import Lamp
from btfsep_engine.light.sun import Near
from btfsep_engine.pipeline.model import Model
from btfsep_engine.pipeline.refine.key_lights import key_lights
from btfsep_engine.pipeline.settings import FitSettings
from btfsep_engine.pipeline.together import SolvedLight
from tests.engine.half_sphere import FILL, SUN

MAP = FitSettings()


def of(share, degrees, direction=SUN) -> Lamp:
    return Lamp(direction, np.full(3, 5 * share), np.full(3, 0.1), degrees, share, 0.05)


def suns_of(lamps, settings=MAP, near=()):
    """The suns, and why, of a scene in centimetres."""
    light = SolvedLight(SimpleNamespace(lamps=lamps), None, [1.0], near=near)
    problem = SimpleNamespace(scene=SimpleNamespace(job=SimpleNamespace(metres_per_unit=0.01)))
    _, light, words = key_lights(Model(settings, {"mean": [problem]}), light)
    return light.suns, words["key_light"]


@pytest.mark.parametrize(
    ("share", "degrees", "is_sun"), [(0.21, 5, True), (0.19, 5, False), (0.9, 14, True), (0.9, 16, False)]
)
def test_a_sun_has_a_fifth_of_the_light_and_a_direction_that_is_known(share, degrees, is_sun):
    suns, why = suns_of((of(share, degrees),))
    assert len(suns) == is_sun
    assert f"{100 * share:.0f} %" in why and ("a key light is" in why) == is_sun
    if is_sun:
        np.testing.assert_allclose(suns[0].direction, SUN)
        np.testing.assert_allclose(suns[0].irradiance, 5 * share)
        assert (suns[0].share, suns[0].direction_stddev_degrees) == (share, degrees)


def test_several_keep_their_order_and_what_is_weak_stays_behind():
    suns, why = suns_of((of(0.5, 2), of(0.3, 3, FILL), of(0.1, 3, -FILL)))
    assert [s.share for s in suns] == [0.5, 0.3] and why.startswith("2 key lights")
    height = np.degrees(np.arcsin(SUN[2]))
    assert f"from {height:.0f} degrees above" in why


def test_how_near_a_lamp_stands_is_that_of_the_lamp_in_its_direction():
    near = Near(np.zeros(3), 80.0, 60.0, 100.0)
    turned = SUN + 0.1 * np.cross(SUN, FILL) / np.linalg.norm(np.cross(SUN, FILL))
    suns, why = suns_of((of(0.5, 2), of(0.3, 3, FILL)), near=((turned / np.linalg.norm(turned), near),))
    assert suns[0].near == near and suns[1].near is None and why.count("0.8 m away") == 1


def test_none_where_there_is_none_or_nobody_asked():
    assert suns_of(())[0] == ()
    for settings, word in (
        (FitSettings(key_light="never"), "--key-light never"),
        (FitSettings(estimator="least-squares"), "--estimator map"),
    ):
        suns, why = suns_of((of(0.9, 1),), settings)
        assert suns == () and word in why
