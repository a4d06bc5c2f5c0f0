# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels that show something in front: told from highlights by other places that reflect the same direction, and from
what the camera or the mesh is off by along outlines."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.pipeline.checks import gloss_doubts
from btfsep_engine.pipeline.model import Model
from btfsep_engine.pipeline.problem import Problem
from btfsep_engine.pipeline.refine import in_front, near
from btfsep_engine.pipeline.refine.highlights import highlights, shining
from btfsep_engine.pipeline.refine.in_front import without_things_in_front
from btfsep_engine.pipeline.refine.parted import with_others
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.together import fit_together
from btfsep_engine.progress import Reporter
from btfsep_engine.render.surface import SurfacePoints
from tests.engine.half_sphere import half_sphere, shown, side_light

MATTE, GLOSSY = 0.002, 0.1
BALL = 1000  # points


def two_balls(*gloss) -> SimpleNamespace:
    """Two equal balls side by side, of a gloss each: as far as highlights ask for it, a Problem."""
    normal = fibonacci_sphere(2 * BALL)
    normal = normal[np.argsort(-normal[:, 2])[:BALL]]  # the half that faces the camera
    basis = np.zeros((2 * len(normal), 100, 3), np.float32)
    basis[:, 0] = 1.0
    basis[:, 1:] = np.repeat(gloss, len(normal))[:, None, None]
    place = np.round(100 * normal[:, :2]).astype(int)
    eye = SimpleNamespace(to_eye=np.broadcast_to([0.0, 0.0, 1.0], (2 * len(normal), 3)))
    pixels = np.concatenate([place, place + np.array([0, 250])])
    return SimpleNamespace(basis=[basis], normals=np.concatenate([normal, normal]), points=[eye], pixels=pixels)


def test_a_bright_patch_on_one_of_two_glossy_balls_is_no_highlight():
    problem = two_balls(GLOSSY, GLOSSY)
    bright = problem.normals @ [0.4, 0.2, 0.9] > 0.98
    bright[BALL:] = False
    assert not highlights(problem, bright).any()


def test_a_highlight_shows_on_both():
    problem = two_balls(GLOSSY, GLOSSY)
    bright = problem.normals @ [0.4, 0.2, 0.9] > 0.98
    np.testing.assert_array_equal(highlights(problem, bright), bright)


def test_a_matte_ball_tells_nothing_of_what_a_glossy_one_shows():
    problem = two_balls(GLOSSY, MATTE)
    bright = problem.normals @ [0.4, 0.2, 0.9] > 0.98
    bright[BALL:] = False
    np.testing.assert_array_equal(highlights(problem, bright), bright)


def test_matte_objects_have_none():
    problem = two_balls(MATTE, MATTE)
    assert not highlights(problem, problem.normals[:, 2] > 0.9).any()


WHITE, GREEN, VIOLET = np.array([1.0, 1.0, 1.0]), np.array([0.1, 1.0, 0.1]), np.array([0.5, 0.01, 1.0])


def left_on_two_balls(there, colour) -> tuple:
    """The model, the light of all pixels and that of those which are not ``there`` (p,) bool, where ``colour`` (3,) is
    left over, of white light on two matte balls."""
    left = there[:, None] * colour + 0.001
    basis = SimpleNamespace(response=np.ones(3))
    fit = SimpleNamespace(all_coefficients=np.ones((1, 3)), residual=0.4)
    light = SimpleNamespace(left_over=lambda _: left, solver=SimpleNamespace(basis=basis), fit=fit)
    return SimpleNamespace(problems=[two_balls(MATTE, MATTE)]), light, light


def on_balls(first: bool, second: bool):
    """(p,) bool, a spot that is seen on the first of two balls, the second, or both."""
    spot = two_balls(MATTE, MATTE).normals @ [0.4, 0.2, 0.9] > 0.98
    return spot & np.repeat([first, second], BALL)


def test_what_shines_on_both_balls_is_a_highlight_of_another_material(monkeypatch):
    monkeypatch.setattr(in_front, "sharp_lamps", None)  # are not asked for
    for balls, expected in (((True, True), True), ((True, False), False)):
        there = on_balls(*balls)
        model, light, _ = left_on_two_balls(there, WHITE)
        assert in_front.shine(model, light, there) == expected


@pytest.mark.parametrize(("lamps_leave", "expected"), [(0.1, True), (0.3, False)])
def test_what_shines_at_some_places_of_those_that_reflect_the_same_is_a_highlight_where_lamps_explain_it(
    lamps_leave, expected, monkeypatch
):
    explained = SimpleNamespace(fit=SimpleNamespace(residual=lamps_leave))
    monkeypatch.setattr(in_front, "sharp_lamps", lambda model, light: (model, explained, {}))
    there = on_balls(True, True)
    there[BALL:] &= two_balls(MATTE, MATTE).normals[BALL:, 0] > 0.45  # not the whole spot
    model, light, _ = left_on_two_balls(there, WHITE)
    assert in_front.shine(model, light, there) == expected


def test_what_is_brighter_by_the_lights_own_colour_may_be_of_the_object():
    there = on_balls(True, False)
    for colour, expected in ((WHITE, there), (GREEN, None), (-WHITE, None)):
        model, _, freed = left_on_two_balls(there, colour)
        np.testing.assert_equal(in_front.as_more_light(model, freed, there), expected)
    model, _, freed = left_on_two_balls(there, WHITE)
    freed.left_over(model.problems)[~there] = -0.001  # far more that is darker
    assert in_front.as_more_light(model, freed, np.ones(2 * BALL, bool)) is None


def photographed(rng, there, level, *, gloss=0.0) -> tuple:
    """The model and the light of a photo of half a ball in side light, on part of which something is in front.

    ``there`` : (across, down) in the ball's radii -> whether it is, (p,) bool; ``level`` : its radiance over the mean
    """
    basis, normal, _ = half_sphere(rng, pixels=800, gloss=gloss)
    b = shown(basis, side_light(), rng, 0.02)
    b[there(*normal[:, [0, 2]].T)] = level * b.mean()
    pixels, eye = np.round(100 + 90 * normal[:, [2, 0]]).astype(np.int32), np.broadcast_to([0.0, -1.0, 0.0], (800, 3))
    outlines = SimpleNamespace(rings_at=lambda at: ((90 - np.linalg.norm(at - 100, axis=1)) // 3).astype(int))
    thing = SimpleNamespace(name="thing", surface=None)
    job = SimpleNamespace(photo=SimpleNamespace(clipped=None), objects=(thing,), occluders=(), known_lamps=())
    scene = SimpleNamespace(job=job, outlines=outlines, reporter=Reporter(), mirrors=())
    points = SurfacePoints(pixels, normal, normal, normal, eye, np.zeros(800, np.int32), normal, np.ones(800))
    material = SimpleNamespace(name="one", dye=None)
    problem, settings = Problem(scene, [material], [points], [basis], {}, measured=b), choose(bounces=1, order=2)
    return Model(settings, {"mean": [problem]}), fit_together([problem], settings)


def patch(across, down):
    return np.hypot(across + 0.2, down - 0.1) < 0.2


def rim(across, down):
    return (np.hypot(across, down) > 0.93) & (across < 0)


@pytest.mark.parametrize(("level", "gloss"), [(4.0, 0.0), (0.02, 0.0), (0.02, 4.0), (20 * VIOLET, 4.0)])
def test_what_stands_apart_is_left_out_and_of_gloss_what_is_dark_or_of_a_colour_that_no_light_has(
    rng, level, gloss, monkeypatch
):
    """No highlight is darker than all around it: a dark thing need not be seen at two places, nor a violet one."""
    monkeypatch.setattr(in_front, "lit_otherwise", lambda *_: None)  # which traces rays
    model, light = photographed(rng, patch, level, gloss=gloss)
    assert shining(model.problems[0])[0].all() == (gloss > 0)
    freed, answer, words = without_things_in_front(model, light)
    (left,) = freed.problems
    assert not patch(*left.normals[:, [0, 2]].T).any() and left.left_out < 30 and "pixels" in words["robust"]
    assert answer.fit.residual < 0.3 * light.fit.residual


def test_what_stands_apart_along_an_outline_is_no_thing_in_front(rng):
    """The camera is off there, or the mesh; however well the light explains all else."""
    model, light = photographed(rng, rim, 4.0)
    assert without_things_in_front(model, light)[1] is light


def test_what_is_brighter_is_told_with_channels_that_count_alike(monkeypatch):
    """Of a red object most of what is left over is red, whatever the others say."""
    left = np.array([[-1.0, 0.5, 0.5], [1.0, -0.5, -0.5]])
    basis = SimpleNamespace(response=np.array([10.0, 1.0, 1.0]))
    fit = SimpleNamespace(all_coefficients=np.ones((1, 3)))
    how = {"left_over": lambda _: left, "radiance": lambda _: np.ones((2, 3)), "fit": fit}
    light = SimpleNamespace(solver=SimpleNamespace(basis=basis), **how)
    pixels = np.array([[0, 0], [50, 0]])
    model = SimpleNamespace(problems=[SimpleNamespace(pixels=pixels, points=[SimpleNamespace(pixels=pixels)])])
    monkeypatch.setattr(in_front, "highlights", lambda _, bright: bright)
    monkeypatch.setattr(in_front, "as_of_two_lights", lambda *_: 0.0)
    np.testing.assert_array_equal(in_front.without_highlights(model, light, np.ones(2, bool)), [False, True])


@pytest.mark.parametrize("level", [4.0, 0.02])
def test_what_may_be_a_highlight_is_left_out_with_the_light_of_all_pixels_as_the_other_half(rng, level, monkeypatch):
    """What is darker than the light explains is none."""
    monkeypatch.setattr(in_front, "lit_otherwise", lambda *_: None)
    model, light = photographed(rng, patch, level)
    freed, _, words = without_things_in_front(model, light)
    assert "robust" in words and freed.otherwise == (((light.fit, 0.5),) if level > 1 else ())


def test_of_what_shows_highlights_nothing_is_left_out_and_no_lamp_nearby_is_sought(rng, monkeypatch):
    model, light = photographed(rng, patch, 4.0)
    monkeypatch.setattr(in_front, "shine", lambda *_: True)
    same, answer, words = without_things_in_front(model, light)
    assert answer is light and same.highlights and same.problems[0].left_out is None and "highlights" in words
    made_of = SimpleNamespace(surface=None, material=SimpleNamespace(material_class="wood"))
    monkeypatch.setattr(near, "Photographed", None)  # the search begins with it
    assert "highlights" in near.near_lamps(replace(same, materials=((made_of,),)), answer)[2]["near"]


def of_photo_and_model(b, shown) -> tuple:
    """The model and the light of photographs (p, 3) that a light explains as ``shown`` (p, 3)."""
    row = SimpleNamespace(pixels=np.stack([np.zeros(len(b)), np.arange(len(b))], 1))
    model = SimpleNamespace(problems=[SimpleNamespace(points=[row])])
    return model, SimpleNamespace(radiance=lambda _: b, left_over=lambda _: b - shown)


def lobes(offset: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Radiance (p, 3) of a row of 200 points with a bright place, so many points off; and (p,) bool, where it is."""
    at = np.arange(200.0)
    level = 0.2 + 0.001 * at + 2 * np.exp(-(((at - 80 - offset) / 12) ** 2))
    return level[:, None] * [1.0, 0.8, 0.5], np.abs(at - 80) < 20


@pytest.mark.parametrize(("offset", "expected"), [(0.0, True), (4.0, True), (25.0, False)])
def test_light_a_little_beside_its_place_is_the_objects_own(offset, expected):
    """No light explains what lies elsewhere on the mesh than in the photo."""
    shown, lost = lobes()
    assert in_front.as_the_objects(*of_photo_and_model(lobes(offset)[0], shown), lost) is expected


@pytest.mark.parametrize("colour", [(1.0, 0.8, 0.5), (0.2, 0.2, 0.2)])
def test_what_is_the_same_all_over_is_a_thing_in_front(colour):
    shown, lost = lobes()
    b = np.where(lost[:, None], colour, shown)
    assert not in_front.as_the_objects(*of_photo_and_model(b, shown), lost)


def test_what_is_shaded_as_the_objects_by_another_colour_is_a_thing_in_front():
    shown, lost = lobes()
    tinted = np.where(lost[:, None], shown * [1.2, 1.0, 0.8], shown)
    assert not in_front.as_the_objects(*of_photo_and_model(tinted, shown), lost)
    elsewhere_too = shown * np.where(lost, 1.0, -1.0)[:, None] * [0.1, 0.0, -0.1] + shown
    assert in_front.as_the_objects(*of_photo_and_model(elsewhere_too, shown), lost)


@pytest.mark.filterwarnings("error")
def test_a_whole_object_that_is_not_explained_has_no_border_to_tell_it_by():
    (shown, lost), places = lobes(), np.stack([np.zeros(200), np.arange(200)], 1)
    model, light = of_photo_and_model(lobes(4.0)[0], shown)
    apart = [SimpleNamespace(pixels=places[some]) for some in (lost, ~lost)]
    order = np.concatenate([np.flatnonzero(lost), np.flatnonzero(~lost)])
    model.problems[0].points = apart
    b, left = (made(None)[order] for made in (light.radiance, light.left_over))
    assert not in_front.as_the_objects(model, of_photo_and_model(b, b - left)[1], lost[order])


def test_what_ends_where_the_objects_light_does_not_is_a_thing_in_front():
    shown, lost = lobes()
    lighter = shown + np.where(lost, 0.5, 0.0)[:, None] * [1.0, 0.8, 0.5]
    assert not in_front.as_the_objects(*of_photo_and_model(lighter, shown), lost)


def test_of_what_the_mesh_has_elsewhere_nothing_is_left_out_and_the_other_light_is_the_other_half(rng, monkeypatch):
    monkeypatch.setattr(in_front, "lit_otherwise", lambda *_: None)
    model, light = photographed(rng, patch, 0.02)
    left_out = without_things_in_front(model, light)[1]
    monkeypatch.setattr(in_front, "as_the_objects", lambda *_: True)
    same, answer, words = without_things_in_front(model, light)
    assert answer is light and same.problems is not None and same.problems[0].left_out is None
    ((other, share),) = same.otherwise
    assert share == 0.5 and words == {in_front.OTHER_SHAPE: in_front.MISPLACED}
    np.testing.assert_allclose(other.all_coefficients, left_out.fit.all_coefficients, rtol=1e-6)


def test_highlights_are_said_unless_lamps_have_images_that_explain_them():
    def estimate(highlights, correction=None):
        leather = SimpleNamespace(material=SimpleNamespace(name="leather"))
        problems, materials = [SimpleNamespace(correction=correction)], ((leather, leather),)
        return SimpleNamespace(model=SimpleNamespace(problems=problems, materials=materials, highlights=highlights))

    (said,) = gloss_doubts(estimate(True))
    assert "highlights that are not those of leather:" in said
    assert gloss_doubts(estimate(False)) == gloss_doubts(estimate(True, correction=np.zeros((1, 3)))) == []


def test_what_a_photo_may_show_already_is_less_probable_for_each_other_light():
    first, second = (SimpleNamespace(fit=name) for name in ("first", "second"))
    settings = choose()
    model = with_others(with_others(Model(settings, {}), [(("", first), 0.4)]), [(("", second), 0.5)])
    assert model.otherwise == (("first", 0.2), ("second", 0.5))
