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


def test_what_light_from_afar_spoke_against_is_modelled_beside_lamps_nearby(lit, monkeypatch):
    scene, truth = lit
    monkeypatch.setattr(interreflection, "contradicted", lambda *of: True)
    found = estimated(scene)
    assert found.light.near and found.model.bounces == 8
    assert found.choice["interreflections"].startswith("interreflections are modelled")
    assert "stands" in found.choice["near"] and found.model.problems[0].correction is not None
    monkeypatch.setattr(near_between, "own_light", lambda *of, **how: interreflection.OwnLight(False, 0.0))
    without = estimated(scene)
    assert without.light.near and without.model.bounces == 1
    assert without.choice["interreflections"] == interreflection.NOT_SO_BRIGHT
    assert found.fit.evidence > without.fit.evidence and off(found, truth) < 0.8 * off(without, truth)


@pytest.mark.parametrize(("near", "evidence"), [((), np.inf), (("a lamp",), -np.inf)])
def test_it_stays_left_out_where_lamps_beside_it_explain_less_or_stand_far_away(lit, monkeypatch, near, evidence):
    def found_beside_it(model, light):
        assert model.bounces == 8 and all(p.correction is None for p in model.problems)
        return model, SimpleNamespace(near=near, fit=SimpleNamespace(evidence=evidence)), {}

    monkeypatch.setattr(interreflection, "contradicted", lambda *of: True)
    monkeypatch.setattr(near_between, "near_lamps", found_beside_it)
    found = estimated(lit[0])
    assert found.light.near and found.model.bounces == 1
    assert found.choice["interreflections"] == interreflection.NOT_SO_BRIGHT


@pytest.mark.parametrize("changes", [{"bounces": 1}, {"bounces": 8}, {"refine": "quick"}])
def test_nothing_is_asked_where_it_was_said_or_no_lamp_is_near(lit, monkeypatch, changes):
    asked = []
    monkeypatch.setattr(near_between, "own_light", lambda *of, **how: asked.append(of))
    assert bool(estimated(lit[0], **changes).light.near) == (changes.get("refine") is None) and not asked
