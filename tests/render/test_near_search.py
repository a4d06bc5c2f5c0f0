# SPDX-License-Identifier: GPL-3.0-or-later
"""Where lamps nearby are sought, how their places move, and when they are believed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.fit.near_lamp import Mound
from btfsep_engine.pipeline.refine import near, near_places, parted
from btfsep_engine.pipeline.refine.near_places import moved
from tests.render.near_balls import WHERE, balls, estimated, photographed
from tests.render.scenes import scene_of


@pytest.fixture(scope="module")
def far_answer():
    """The estimate of a photo of a lamp nearby that is taken to be far away."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(near, "speak_for_nearness", lambda scene, lamps: False)
        return estimated(photographed(2.5)[0])


@pytest.mark.parametrize("parts", [(1,), (1, -10), (-1, 2)])
def test_the_opposite_of_nearness_does_not_speak_for_it(far_answer, monkeypatch, parts):
    """Nearness does, of all that may be lamps, or of the brightest where that of the others explains nothing."""
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    lamps = near.bright_lamps(scene)
    added = scene.placed(lamps, fit, turns=1).correction
    explained = far_answer.light.solver.basis.predicted(fit.shown)
    for left, speaks in ((added, True), (-added, False)):  # what a photo leaves over that has so much of it
        scene.photo = explained + left
        scene.light = replace(scene.light, fit=scene.solve(0.0, fit))
        assert near.speak_for_nearness(scene, lamps) == speaks
        monkeypatch.setattr(scene, "nearness_of", lambda lamps, mounds, left=left: [part * left for part in parts])
        assert near.speak_for_nearness(scene, lamps)
        monkeypatch.setattr(scene, "nearness_of", lambda lamps, mounds, left=left: [-abs(p) * left for p in parts])
        assert not near.speak_for_nearness(scene, lamps)
        monkeypatch.undo()


def test_pixels_that_do_not_count_do_not_speak_against_nearness(far_answer):
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    added = scene.placed(near.bright_lamps(scene), fit, turns=1).correction
    scene.photo = far_answer.light.solver.basis.predicted(fit.shown) + added
    without = near.rest(scene, added)
    scene.photo[::2] += 0.5 * scene.photo.max()
    assert near.rest(scene, added) > 0.5 + without / 2
    scene.weights = np.ones_like(scene.photo)
    scene.weights[::2] = 0
    assert near.rest(scene, added) == pytest.approx(without, rel=0.05)


def test_what_is_taken_off_is_the_nearness_of_all_lamps_as_bright_as_the_fit_has_them(far_answer):
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    lamps = near_places.Lamp(4 * WHERE / np.linalg.norm(WHERE)), near_places.Lamp(np.array([0.0, 3.0, 0.0]))
    expected = 0.0
    for lamp, own in zip(lamps, scene.mounds(fit, lamps), strict=True):
        expected = expected + own.irradiance * scene.nearness(lamp.away, own.profile)
    np.testing.assert_allclose(scene.placed(lamps, fit, turns=1).correction, expected, atol=1e-12)
    assert np.abs(expected).max() > 0.01 * scene.photo.max()


def test_where_a_lamp_takes_all_of_a_photo_no_place_is(far_answer):
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    lamp = near_places.Lamp(1.2 * WHERE / np.linalg.norm(WHERE))
    scene.photo = 1e-6 * scene.photo
    assert scene.placed((lamp,), fit).evidence == -np.inf


def a_placed(lamps, start, *, better=0.0, middles=None):
    """Lamps that explain as much as ``start`` does, or ``better``."""
    middles = middles or [lamp.direction for lamp in lamps]
    own = tuple(Mound(np.ones(3), np.ones(10), middle, np.zeros(3)) for middle in middles)
    election = SimpleNamespace(evidence_of_photo=start.election.evidence_of_photo + better)
    return near_places.Placed(tuple(lamps), SimpleNamespace(election=election), None, own)


def test_what_is_unlikely_of_lamps(far_answer):
    """Elsewhere than the fit has them, farther away than the first one."""
    towards, aside = np.array([0.0, 0.0, 1.0]), np.array([np.sin(0.1), 0.0, np.cos(0.1)])
    likely = a_placed([near_places.Lamp(3 * towards)], far_answer.fit).evidence
    assert likely == far_answer.fit.election.evidence_of_photo
    beside = a_placed([near_places.Lamp(3 * towards)], far_answer.fit, middles=[aside])
    assert likely - beside.evidence == pytest.approx(0.5 * (0.1 / near_places.SPREADS[0]) ** 2, rel=0.01)
    there = moved(2 * towards, np.array([*beside.off[0], 0])) / 2  # where it ought to move
    np.testing.assert_allclose(there @ aside, 1, atol=1e-5)
    farther = a_placed([near_places.Lamp(3 * towards), near_places.Lamp(np.array([6.0, 0, 0]))], far_answer.fit)
    assert likely - farther.evidence == pytest.approx(0.5 * (np.log(2) / near_places.SPREADS[2]) ** 2)


@pytest.mark.parametrize(("better", "is_followed"), [(0.0, True), (-1.0, False)])
def test_a_place_that_explains_less_than_afar_is_not_followed(far_answer, monkeypatch, better, is_followed):
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    monkeypatch.setattr(scene, "placed", lambda lamps, start, *, turns=2: a_placed(lamps, fit, better=better))
    monkeypatch.setattr(near, "followed", lambda scene, at: "followed")
    assert (near.search(scene, [(near_places.Lamp(WHERE),)], fit) == "followed") is is_followed


def test_how_bright_a_lamp_is_is_settled_at_the_best_distance_alone(far_answer, monkeypatch):
    scene, fit, asked = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit, []

    def placed(lamps, start, *, turns=2):
        asked.append((round(lamps[-1].radii, 6), turns))
        return a_placed(lamps, fit, better={8.0: 3.0, 4.0: 2.0, 2.0: 5.0}[asked[-1][0]])  # worse at 4

    monkeypatch.setattr(scene, "placed", placed)
    monkeypatch.setattr(near, "followed", lambda scene, at: at)
    assert near.search(scene, [(near_places.Lamp(WHERE),)], fit).lamps[0].radii == pytest.approx(8)
    assert asked == [(8.0, 1), (4.0, 1), (8.0, 2)]


def test_a_lamp_that_explains_nothing_is_dropped_and_one_that_does_is_added(far_answer, monkeypatch):
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    lamps = [near_places.Lamp(3 * np.eye(3)[i]) for i in range(3)]
    worth = [30.0, near.FURTHER - 0.5, near.FURTHER + 0.5]

    def placed(lamps_there, start, *, turns=2):
        much = sum(w for w, lamp in zip(worth, lamps, strict=True) if any(lamp is other for other in lamps_there))
        return a_placed(lamps_there, fit, better=much)

    monkeypatch.setattr(scene, "placed", placed)
    monkeypatch.setattr(scene, "solve", lambda correction, start: None)
    monkeypatch.setattr(near, "followed", lambda scene, at: at)
    assert near.without_idle(scene, placed(tuple(lamps), fit)).lamps == (lamps[0], lamps[2])
    left = list(lamps[1:])
    monkeypatch.setattr(near, "too_dark", lambda scene, fit, lamps: lamps[-1] is None)
    monkeypatch.setattr(near, "brightest_left", lambda fit, lamps: np.eye(3)[0])
    monkeypatch.setattr(near, "Lamp", lambda away: left.pop(0) if left else None)
    assert near.with_further(scene, placed((lamps[0],), fit)).lamps == (lamps[0], lamps[2])


def test_what_may_be_a_lamp_is_apart_from_others_and_not_too_dark(far_answer, monkeypatch):
    scene = near_places.Photographed(far_answer.model, far_answer.light)
    towards = [np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.8, 0.6]), np.array([0.8, 0.0, -0.6])]
    light = sum(w * sh.evaluate(9, d) for w, d in zip((3, 2, 1), towards, strict=True))
    fit = SimpleNamespace(all_coefficients=np.repeat(light[:, None], 3, 1))
    found = ()
    for expected in towards:
        direction = near.brightest_left(fit, found)
        assert direction @ expected > np.cos(np.radians(8))
        found = (*found, near_places.Lamp(5 * direction))
    much = [Mound(np.full(3, m), np.ones(10), towards[0], np.zeros(3)) for m in (1.0, near.LEAST + 0.01)]
    monkeypatch.setattr(scene, "mounds", lambda fit, lamps: tuple(much))
    assert not near.too_dark(scene, fit, found[:2])
    much[1] = replace(much[1], irradiance=np.full(3, near.LEAST - 0.01))
    assert near.too_dark(scene, fit, found[:2])


def test_places_move_together_as_long_as_the_evidence_rises(far_answer, monkeypatch):
    scene, fit, steps = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit, []
    lamps = near_places.Lamp(3 * WHERE / np.linalg.norm(WHERE)), near_places.Lamp(np.array([0.0, 4.0, 0.0]))

    def placed(lamps, start, *, turns=2):
        steps.append([lamp.radii for lamp in lamps])
        return a_placed(lamps, fit, better=10.0 if len(steps) == 1 else 0.0)

    monkeypatch.setattr(near_places, "SPREADS", near_places.SPREADS * np.inf)
    step = np.array([0, 0, np.log(1.2), 0, 0, -np.log(1.1)])
    monkeypatch.setattr(scene, "placed", placed)
    monkeypatch.setattr(scene, "next_step", lambda at: (step, None))
    after = near_places.followed(scene, a_placed(lamps, fit))
    np.testing.assert_allclose([lamp.radii for lamp in after.lamps], [3.6, 4 / 1.1])
    assert len(steps) == 3  # the second step is worse, and so is a third of it


def test_a_place_is_believed_where_the_evidence_is_clear_and_of_a_depth_clearer(far_answer, monkeypatch):
    assert near.clearly(far_answer.model.problems) == near.CLEARLY
    (problem,) = far_answer.model.problems
    scene = scene_of(problem.scene.job)
    scene.job = replace(scene.job, objects=(replace(scene.job.objects[0], unseen=balls()),))
    model = replace(far_answer.model, looks={"mean": [replace(problem, scene=scene)]})
    assert near.clearly(model.problems) == near.OF_A_DEPTH > near.CLEARLY
    monkeypatch.setattr(near, "CLEARLY", np.inf)
    monkeypatch.setattr(parted, "POOR", np.inf)  # without the place, a shadow explains some of it
    assert "no lamp nearby explains" in estimated(photographed(2.5)[0]).choice["near"]


def test_of_a_metal_no_place_is_sought(far_answer, monkeypatch):
    light, plain = far_answer.light, far_answer.model.materials[0][0]
    metal, wood = (replace(plain, material=replace(plain.material, material_class=c)) for c in ("metal", "wood"))
    assert near.is_metal(metal, None) and not near.is_metal(wood, None)
    grey = (0.5, 0.5, 0.5)
    assert near.is_metal(wood, Surface(grey, roughness=0.4, metallic=1.0))
    assert not near.is_metal(replace(metal, surface=Surface(grey, roughness=0.4)), None)  # what it was found to be
    monkeypatch.setattr(near, "has_own_images", lambda model: False)
    model = replace(far_answer.model, materials=[[metal]])
    assert "a metal shows lamps sharper" in near.near_lamps(model, light)[2]["near"]


@pytest.mark.parametrize(("looks", "leaves", "believed"), [(13, 1.01, 1), (13, 1.03, 0), (11, 0.99, 0), (11, 0.89, 1)])
def test_places_that_only_make_the_light_plainer_are_not_believed(far_answer, monkeypatch, looks, leaves, believed):
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    found = a_placed([near_places.Lamp(WHERE)], fit, better=near.CLEARLY + 1)
    found.fit.residual = leaves * fit.residual
    found = replace(found, correction=0.0)
    monkeypatch.setattr(near, "search", lambda scene, lamps, start: found)
    monkeypatch.setattr(scene, "placed", lambda lamps, start, *, turns=2: found)
    monkeypatch.setattr(scene, "solve", lambda correction, start: None)
    for name in ("followed", "with_further", "without_idle"):
        monkeypatch.setattr(near, name, lambda scene, at: at)
    monkeypatch.setattr(near, "looks_near", lambda scene, nearness: looks)
    assert (near.placed_lamps(scene, found.lamps) is not None) == bool(believed)


@pytest.mark.parametrize(
    ("coarsening", "many", "alone", "leaves", "number", "believed"),
    [
        (1.0, near.CLEARLY + 1, -9.0, 1.1, 2, 1),
        (1.0, near.CLEARLY - 1, 9.0, 0.9, 2, 0),
        (1.5, near.CLEARLY - 1, near.ALONE + 1, 0.99, 2, 1),  # its pixels count less, and so the evidence
        (1.5, near.CLEARLY / 1.5 - 1, near.ALONE + 1, 0.9, 2, 0),
        (1.5, near.CLEARLY + 9, near.ALONE - 1, 0.9, 2, 0),
        (1.5, near.CLEARLY + 9, near.ALONE + 9, 1.01, 2, 0),
        (1.5, near.CLEARLY + 9, -9.0, 1.1, 1, 1),  # one lamp is alone
    ],
)
def test_of_gloss_the_brightest_lamp_alone_has_to_explain_the_photo_better(
    far_answer, monkeypatch, coarsening, many, alone, leaves, number, believed
):
    model = far_answer.model.changed(lambda problem: replace(problem, coarsening=coarsening))
    scene, afar = near_places.Photographed(model, far_answer.light), far_answer.fit
    lamps = (near_places.Lamp(WHERE), near_places.Lamp(-WHERE))[:number]

    def search(scene, starts, fit):
        is_all = len(starts[0]) == number
        found = a_placed(starts[0], fit, better=many if is_all else alone)
        found.fit.residual = (0.5 if is_all else leaves) * fit.residual
        return replace(found, correction=0.0)

    monkeypatch.setattr(near, "search", search)
    monkeypatch.setattr(scene, "placed", lambda lamps, start, *, turns=2: search(scene, [lamps], afar))
    monkeypatch.setattr(scene, "solve", lambda correction, start: None)
    for name in ("followed", "with_further", "without_idle"):
        monkeypatch.setattr(near, name, lambda scene, at: at)
    assert (near.placed_lamps(scene, lamps) is not None) == bool(believed)


def test_what_is_left_over_may_look_like_a_lamps_nearness(far_answer):
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    added = scene.placed(near.bright_lamps(scene)[:1], fit, turns=1).correction
    explained = far_answer.light.solver.basis.predicted(fit.shown)
    scene.photo = explained + added
    assert near.looks_near(scene, added) > 4 and near.rest(scene, added) < 0.9  # 5.5 or more, by the processor
    scene.photo = explained - added
    assert near.looks_near(scene, added) == 0 and near.rest(scene, added) > 1.1


@pytest.mark.parametrize(
    ("looks", "left", "speak"), [((13, 0), (0.9, 1), 1), ((0, 13), (1, 0.9), 1), ((13, 11), (1, 0.9), 0)]
)
def test_nearness_speaks_where_the_misfit_both_looks_like_it_and_has_it(far_answer, monkeypatch, looks, left, speak):
    """Of all that may be lamps, or of the brightest."""
    scene = near_places.Photographed(far_answer.model, far_answer.light)
    monkeypatch.setattr(scene, "nearness_of", lambda lamps, mounds: [1, -1])  # whose sum is 0
    monkeypatch.setattr(near, "looks_near", lambda scene, nearness: looks[nearness])
    monkeypatch.setattr(near, "rest", lambda scene, nearness: left[nearness])
    assert near.speak_for_nearness(scene, near.bright_lamps(scene)) == bool(speak)


def test_a_place_is_turned_and_moved():
    away = np.array([0.0, 3.0, 4.0])
    turned = moved(away, np.array([0.01, -0.02, 0.0]))
    assert np.linalg.norm(turned) == pytest.approx(5)
    assert np.arccos(turned @ away / 25) == pytest.approx(np.hypot(0.01, 0.02), rel=1e-3)
    np.testing.assert_allclose(moved(away, np.array([0, 0, np.log(2)])), 2 * away)
