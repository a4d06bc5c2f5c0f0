# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps of strong colours are found to have them; the colour of an object is not taken for theirs."""

from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.light.sun import Sun
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.refine import vivid
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.render.homogeneous import homogeneous
from scripts.studies.measures import order2
from tests.render.scenes import egg_and_pebble, job_of, looking_down, picture, scene_of, with_photo

GREY = Surface((0.3, 0.3, 0.3), roughness=0.6)
SETTINGS = choose("draft", bounces=1, directions=256, align="never")
FROM = np.array([[-0.6, 0.3, 0.74], [0.7, -0.2, 0.69]])
FROM /= np.linalg.norm(FROM, axis=1, keepdims=True)
RED, BLUE, WHITE = (1.0, 0.03, 0.02), (0.03, 0.06, 1.0), (1.0, 1.0, 1.0)
FAINT = 0.15


def photographed(colours, *, ambient=WHITE, true=GREY, said=GREY):
    """The scene of an object under lamps and even light, which is said to be of some surface; all of the light."""
    job = job_of([egg_and_pebble(4)], looking_down())
    job = replace(job, objects=tuple(replace(o, surface=said) for o in job.objects))
    scene = scene_of(job)
    points, material = scene.points(0, textured=False), homogeneous(true, "true")
    light = np.zeros((100, 3))
    light[0] = FAINT * np.array(ambient)
    seen = scene.radiance(points, material, SHLighting(light), directions=1024)[:, 0]
    suns = [Sun(d, 2 * np.array(c), np.zeros(3)) for d, c in zip(FROM, colours, strict=False)]
    seen = seen + scene.sun_radiance(points, material, *suns)
    scene.job = with_photo(scene.job, picture(points, seen, noise=0.01))
    return scene, light + sum(sun.coefficients(9) for sun in suns)


def found_in(scene):
    return estimate(scene, open_library(None), SETTINGS)


def colour_of(x):
    """Logarithms of red over blue and of green over both, of coefficients (terms, 3)."""
    r, g, b = np.log(np.maximum(x[0], 1e-9))
    return np.array([r - b, g - (r + b) / 2])


@pytest.mark.parametrize("colours", [(RED, BLUE), (RED,)], ids=["two lamps", "one lamp and white light"])
def test_lamps_have_the_colours_that_they_have(colours, monkeypatch):
    scene, truth = photographed(colours)
    found = found_in(scene)
    assert found.choice["colours"] == vivid.FOUND and found.fit.tint.unknown < 0.2
    error = order2(found.fit.coefficients, truth)
    assert error < 0.05
    assert not any("colour is not known" in said for said in scene.reporter.warnings)
    lamps = sorted(found.fit.lamps, key=lambda lamp: -lamp.share)[: len(colours)]
    for d, colour in zip(FROM, colours, strict=False):
        lamp = max(lamps, key=lambda lamp: lamp.direction @ d)
        assert lamp.direction @ d > np.cos(np.radians(5))
        np.testing.assert_allclose(lamp.irradiance / lamp.irradiance.max(), colour, atol=0.08)
    monkeypatch.setattr(vivid, "CLEARLY", np.inf)
    assert order2(found_in(photographed(colours)[0]).fit.coefficients, truth) > 5 * error


def test_white_lamps_are_no_vivid_light():
    scene, truth = photographed((WHITE, (1.0, 0.9, 0.75)))
    found = found_in(scene)
    assert "colours" not in found.choice and order2(found.fit.coefficients, truth) < 0.12


def test_the_colour_of_an_object_that_is_said_to_be_grey_is_no_vivid_light():
    teal = replace(GREY, base_color=(0.1, 0.5, 0.4))
    scene, _ = photographed((WHITE, WHITE), true=teal)
    found = found_in(scene)
    assert "colours" not in found.choice and found.fit.tint.unknown > 0.5
    assert np.abs(colour_of(found.fit.coefficients)).max() < 0.6  # the object's is 1.4
    assert any("the object's colour is not known" in said for said in scene.reporter.warnings)


def test_one_filter_over_all_light_may_be_the_objects_colour_and_that_is_said():
    magenta = (1.0, 0.03, 0.8)
    scene, truth = photographed((magenta,), ambient=magenta)
    found = found_in(scene)
    assert "colours" not in found.choice and found.fit.tint.filtered > 0.9
    np.testing.assert_allclose(colour_of(found.fit.coefficients), colour_of(truth), atol=0.5)
    assert any("has a colour that is seldom met" in said for said in scene.reporter.warnings)
    assert "strongly coloured" in found.choice["colour"]


def test_what_light_does_not_explain_is_no_vivid_light(monkeypatch):
    scene, _ = photographed((RED, BLUE))
    monkeypatch.setattr(vivid, "LITTLE", 0.0)
    assert "colours" not in found_in(scene).choice
