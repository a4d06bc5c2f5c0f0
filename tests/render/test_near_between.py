# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene's own light where lamps stand near: left out beside light from afar, and asked for once more."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine.btf.library import open_library
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.refine import interreflection, near_between
from btfsep_engine.pipeline.refine.near_between import light_between_near_surfaces
from btfsep_engine.pipeline.settings import choose
from tests.render.near_balls import ALBEDO, off, photographed
from tests.render.scenes import picture, scene_of, with_photo

SETTINGS = choose("draft", refine="all", directions=1024, align="never")
WHITE = "reference/white-diffuse"


def estimated(scene, **changes):
    return estimate(scene, open_library(None), replace(SETTINGS, **changes), material=WHITE)


@pytest.fixture(scope="module")
def lit():
    """The scene and the light of two balls that light each other, under a lamp at 2.5 radii."""
    plain, _, _, _, truth = photographed(2.5)
    white = open_library(None).load(WHITE)
    points = plain.points(0, textured=False)
    indirect = plain.indirect([white], SHLighting(truth), SETTINGS, bounces=8)
    own = plain.received(0, points, white, indirect)[:, 0] * ALBEDO / white.diffuse_albedo()
    photo = plain.job.photo.radiance
    seen = photo[tuple(points.pixels.T)] + own
    assert 0.02 < np.linalg.norm(own) / np.linalg.norm(seen) < 0.5
    return scene_of(with_photo(plain.job, picture(points, seen, size=len(photo)))), truth


@pytest.fixture(scope="module")
def left_out(lit):
    """The estimate in which its own light is left out, beside lamps nearby, too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(interreflection, "contradicted", lambda *of: True)
        patch.setattr(near_between, "own_light", lambda *of, **how: interreflection.OwnLight(False, 0.0))
        return estimated(lit[0])


def test_what_light_from_afar_spoke_against_is_modelled_beside_lamps_nearby(lit, left_out, monkeypatch):
    scene, truth = lit
    monkeypatch.setattr(interreflection, "contradicted", lambda *of: True)
    found = estimated(scene)
    assert found.light.near and found.model.bounces == 8
    assert found.choice["interreflections"].startswith("interreflections are modelled")
    assert "stands" in found.choice["near"] and found.model.problems[0].correction is not None
    assert left_out.light.near and left_out.model.bounces == 1
    assert left_out.choice["interreflections"] == interreflection.NOT_SO_BRIGHT
    assert found.fit.evidence > left_out.fit.evidence and off(found, truth) < 0.8 * off(left_out, truth)


@pytest.mark.parametrize(("near", "evidence"), [((), np.inf), (("a lamp",), -np.inf)])
def test_it_stays_left_out_where_lamps_beside_it_explain_less_or_stand_far_away(left_out, monkeypatch, near, evidence):
    asked = []

    def found_beside_it(model, light):
        assert model.bounces == 8 and all(p.correction is None for p in model.problems)
        asked.append(model)
        return model, SimpleNamespace(near=near, fit=SimpleNamespace(evidence=evidence)), {}

    monkeypatch.setattr(near_between, "near_lamps", found_beside_it)
    model, light, words = light_between_near_surfaces(left_out.model, left_out.light)
    assert asked and model is left_out.model and light is left_out.light and not words


@pytest.mark.parametrize("bounces", [1, 8])
def test_nothing_is_asked_where_it_was_said(left_out, monkeypatch, bounces):
    monkeypatch.setattr(near_between, "own_light", None)
    model = replace(left_out.model, settings=replace(SETTINGS, bounces=bounces), bounces=bounces)
    assert left_out.light.near and light_between_near_surfaces(model, left_out.light) == (model, left_out.light, {})


def test_nothing_is_asked_where_no_lamp_is_near(lit, monkeypatch):
    monkeypatch.setattr(near_between, "own_light", None)
    assert not estimated(lit[0], refine="quick").light.near
