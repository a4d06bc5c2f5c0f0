# SPDX-License-Identifier: GPL-3.0-or-later
"""What a lamp lights in one place only is told from a thing in front, and a lamp's shadow from paint by its colour."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine.job.model import KnownLamp
from btfsep_engine.pipeline.estimation import Estimate, light_of
from btfsep_engine.pipeline.following import Follower
from btfsep_engine.pipeline.refine import parted
from btfsep_engine.pipeline.refine.in_front import without_things_in_front
from btfsep_engine.pipeline.refine.parted import (
    asked,
    coloured_as_light,
    in_parts,
    leaves_less,
    lit_otherwise,
    with_shadows_sought,
)
from btfsep_engine.pipeline.refine.pieces import Pieces
from btfsep_engine.pipeline.refine.pixels import Pixels
from btfsep_engine.pipeline.refine.shaded import BEST, RINGS, SHADOW, Shadows, rings_about
from tests.render.lit_things import TOWARDS, degrees_off, lit_things, off, photo_of, shaded, solved

WARM = np.array([1.3, 1.0, 0.75])  # beside skylight: a sun that stands low


@pytest.fixture(scope="module")
def things():
    return lit_things()


def spot(pixels):
    """(p,) bool, where a lamp comes through a gap."""
    return np.linalg.norm(pixels - np.array([50, 30]), axis=1) < 11


@pytest.fixture(scope="module")
def through_a_gap(things):
    """The model of a photo of which a lamp lights a spot, ten times as strong, and its light."""
    lit = spot(things.points.pixels)[:, None] * things.lamp
    return solved(things, photo_of(things, things.sky + 4 * lit))[:2]


@pytest.fixture(scope="module")
def covered(things):
    """The same of a photo with a bright disc in front there, of one colour."""
    values = things.sky + things.lamp
    disc = spot(things.points.pixels)[:, None]
    return solved(things, photo_of(things, np.where(disc, 4 * values.max(), values)))[:2]


@pytest.fixture(scope="module")
def plain(things):
    """The same of a photo that is as the job says."""
    return solved(things, photo_of(things, things.sky + things.lamp))[:2]


@pytest.fixture
def plain_pixels(plain):
    """Pixels of that, for a test to change."""
    return Pixels(*plain)


def apart(model):
    return spot(model.problems[0].pixels)


def test_what_a_lamp_lights_through_a_gap_is_no_thing_in_front(through_a_gap, monkeypatch):
    """The lamp is searched for once, whoever asks: the next refinement is told."""
    model, light = through_a_gap
    lit = lit_otherwise(model, light, apart(model))
    assert lit.looks is model.looks
    monkeypatch.setattr(parted.Shadows, "found", None)
    same, as_before, words = without_things_in_front(lit, light)
    assert same is lit and as_before is light and not words
    last, found, words = in_parts(same, light)
    assert SHADOW in words and "robust" not in words and degrees_off(found) < 6
    assert last.shaded is None


def test_shadows_are_sought_anew_under_another_light(through_a_gap, monkeypatch):
    model, light = through_a_gap
    monkeypatch.setattr(parted.Shadows, "found", lambda search: [search.pixels.light])
    once = with_shadows_sought(model, light)
    assert with_shadows_sought(once, light) is once and once.shaded == (light, [light])
    other = replace(light)
    assert with_shadows_sought(once, other).shaded[0] is other


def test_that_it_is_none_is_worth_the_lamp(through_a_gap, monkeypatch):
    """Left out, its pixels take all that is known of the lamp with them."""
    model, _ = through_a_gap
    monkeypatch.setattr("btfsep_engine.pipeline.refine.in_front.lit_otherwise", lambda *_: None)
    left = light_of(model, None, (without_things_in_front, in_parts))
    assert "robust" in left.choice and SHADOW not in left.choice


def test_a_disc_of_one_colour_is_a_thing_in_front(covered):
    model, light = covered
    assert not lit_otherwise(model, light, apart(model))
    freed, answer, words = without_things_in_front(model, light)
    assert "robust" in words and off(answer) < 0.3 * off(light)
    assert not apart(freed).any()


def shaded_by(rest, lamp=(1.0, 1.0, 1.0)):
    light = SimpleNamespace(irradiances=np.array([lamp]), x=np.ones((1, 3)))
    return SimpleNamespace(rest=rest, left=0.0, light=light)


def test_how_well_a_lamp_explains_is_asked_beside_one_colour(covered, monkeypatch):
    """And a lamp of a colour that no light has is none."""
    model, light = covered
    pixels, some = Pixels(model, light), apart(model)
    rest = pixels.b.copy()
    rest[some] = 0.1 * (pixels.b[some] - pixels.b[some].mean(0)) + 1e-9
    for factor, lamp, expected in ((1, np.ones(3), True), (9, np.ones(3), False), (1, np.array([1, 0.1, 0.1]), False)):
        one = shaded_by(factor * rest, lamp)
        monkeypatch.setattr(parted.Shadows, "found", lambda _, one=one: [one])
        assert (lit_otherwise(model, light, some) is not None) is expected
    monkeypatch.setattr(parted.Shadows, "found", lambda _: [])
    assert not lit_otherwise(model, light, some)


def test_each_part_that_stands_apart_has_a_colour_of_its_own(plain_pixels):
    """Two things in front may differ."""
    pixels = plain_pixels
    columns = pixels.at[:, 1]
    halves = (columns < np.quantile(columns, 0.3)) | (columns > np.quantile(columns, 0.7))
    pixels.b = np.where(columns[:, None] < columns.mean(), 1.0, 3.0) * np.ones(3)
    noise = np.random.default_rng(0).normal(0, 0.01, pixels.b.shape)
    pixels.b = pixels.b + noise
    assert pixels.unlike_the_rest(halves, noise[halves])
    assert not pixels.unlike_the_rest(halves, 0.1 * noise[halves])


def test_what_has_less_light_is_told_from_what_has_another_colour(plain_pixels):
    pixels = plain_pixels
    light = pixels.b.copy()
    for factor, expected in (((0.4, 0.4, 0.4), 1), ((0.45, 0.4, 0.35), 1), ((1.5, 1.5, 1.5), 0), ((0.7, 0.2, 0.6), 0)):
        pixels.b = light * np.array(factor)
        assert pixels.darker(light).mean() == pytest.approx(expected, abs=0.02)


def beneath(pixels):
    """(p,) bool, where the shadow of a thing there falls."""
    return np.linalg.norm(pixels - np.array([50, 52]), axis=1) < 14


@pytest.fixture(scope="module")
def beside_its_shadow(things):
    """What is seen of a thing of one colour and its shadow, and the model of that photo and its light."""
    pixels = things.points.pixels
    values = things.sky + np.where(beneath(pixels), 0, 1)[:, None] * things.lamp
    values = np.where(spot(pixels)[:, None], np.array([0.1, 0.5, 0.9]) * values.max(), values)
    return values, *solved(things, photo_of(things, values))[:2]


def test_a_things_shadow_stays_where_a_lamp_explains_it(beside_its_shadow):
    """The thing itself is left out."""
    _, model, light = beside_its_shadow
    freed, better, words = without_things_in_front(model, light)
    assert "robust" in words and SHADOW in words
    pixels, left = model.problems[0].pixels, freed.problems[0].pixels
    assert not spot(left).any() and (beneath(left) & ~spot(left)).sum() > 0.9 * (beneath(pixels) & ~spot(pixels)).sum()
    assert degrees_off(better) < 6 and off(better) < 0.4 * off(light)
    again, as_found, more = in_parts(freed, better)
    assert again is freed and as_found is better and not more  # it is not asked twice


def test_a_further_photo_is_without_the_thing_too_and_keeps_the_shadow(beside_its_shadow, things):
    values, model, light = beside_its_shadow
    found = Estimate(*without_things_in_front(model, light))
    again = Follower(found, None)._again(photo_of(things, values, seed=1))
    assert len(again.model.problems[0].pixels) == len(found.model.problems[0].pixels) < len(model.problems[0].pixels)
    assert off(again.light) == pytest.approx(off(found.light), abs=0.02)


def test_things_before_a_quarter_of_the_object_are_left_out(things):
    """No few pixels, that would stand apart from all others."""
    values, there = things.sky + things.lamp, things.points.pixels @ [0.6, -0.8] > 5
    assert 0.2 < there.mean() < 0.4
    model, light, _ = solved(things, photo_of(things, np.where(there[:, None], [0.9, 0.2, 0.4], values)))
    freed, better, words = without_things_in_front(model, light)
    assert "robust" in words and off(better) < 0.3 * off(light)
    assert (freed.problems[0].pixels @ [0.6, -0.8] > 5).mean() < 0.02


def test_where_lamps_are_given_nothing_is_lit_otherwise(things, monkeypatch):
    monkeypatch.setattr(parted, "Pixels", None)
    lit = spot(things.points.pixels)[:, None] * things.lamp
    photo = photo_of(things, things.sky + 4 * lit, known_lamps=(KnownLamp(TOWARDS, 1.0),))
    model, light, _ = solved(things, photo)
    assert not lit_otherwise(model, light, apart(model))


def test_what_has_been_found_is_not_asked_again(through_a_gap):
    model, light = through_a_gap
    ones = np.ones((len(model.problems[0].pixels), 3))
    assert asked(model, light)
    for found in ({"paint": ones}, {"correction": 0 * ones}):
        assert not asked(model.changed(lambda p, found=found: replace(p, **found)), light)


def of_colours(lamp, other):
    light = SimpleNamespace(irradiances=np.atleast_2d(lamp), x=np.atleast_2d(other))
    return coloured_as_light(SimpleNamespace(light=light))


def test_a_lamp_has_a_colour_that_lights_have():
    even = np.ones(3)
    assert of_colours(even, even) > 1.5
    assert of_colours(2 * even, even) == pytest.approx(of_colours(even, even))  # however bright
    assert of_colours(WARM, even) > 0 and of_colours(WARM, WARM + 1 / WARM) > 0
    assert of_colours(WARM, WARM) == pytest.approx(of_colours(even, even))  # whatever colour the other light has
    for strong in ([1.0, 0.3, 0.2], [0.3, 1.0, 0.3], [1.0, 0.4, 1.0]):
        assert of_colours(strong, even) < -1


def test_no_paint_reflects_more_than_all_light(things):
    """A half that is four times as light as the other would have to, of white things; of dark ones it is found."""
    values = (things.sky + things.lamp) * np.where(things.half, 1, 0.25)
    model, light, _ = solved(things, photo_of(things, values))
    pixels = Pixels(model, light)
    pieces = Pieces(pixels, model.modelled)
    found = pieces.found()
    assert found is not None and found.more.max() > 3
    lighter = pieces._albedo.max() * pixels.of_mean(1 + (found.more - 1) * found.other[:, None]).max()
    assert 0.4 < lighter < 1
    pieces._albedo = 2 * pieces._albedo
    assert pieces._too_light(found) and pieces.found() is None
    assert not pieces._too_light(replace(found, more=np.full(3, 1.01)))


@pytest.fixture(scope="module")
def in_the_dark(things):
    """The model of a photo with a shadow of what no job knows, and its light."""
    return solved(things, photo_of(things, shaded(things)))[:2]


def test_rings_are_so_far_from_what_they_are_about_and_all_around_it():
    around = rings_about(TOWARDS)
    angles = np.arccos(around @ TOWARDS).reshape(len(RINGS), -1)
    np.testing.assert_allclose(angles, np.repeat(RINGS[:, None], angles.shape[1], 1))
    for ring in around.reshape(len(RINGS), -1, 3):
        np.testing.assert_allclose(ring.mean(0), np.cos(np.arccos(ring[0] @ TOWARDS)) * TOWARDS, atol=1e-12)


def test_a_lamp_is_looked_for_around_the_best_until_none_there_is_better(in_the_dark, monkeypatch):
    """From a place from which no move is asked for, as where what sees it makes up for that."""
    search = Shadows(Pixels(*in_the_dark))
    best = search.found()[0]
    first = search._seen_from(best, rings_about(rings_about(TOWARDS)[8])[8])
    start = np.degrees(np.arccos(first.own.direction @ TOWARDS))
    assert start > 40 and first.left > 2 * best.left
    monkeypatch.setattr(search, "_onward", lambda one, _: one)
    each = search._beside([first])
    lefts = [one.left for one in each]
    assert lefts == sorted(lefts) and lefts[0] < 0.7 * first.left
    assert np.degrees(np.arccos(each[0].own.direction @ TOWARDS)) < start - 20


@pytest.mark.parametrize(("misfit", "asked_around"), [(0.2, True), (0.1, False)])
def test_around_a_lamp_that_promises_more_are_sought_and_no_more_kept_than_are_followed(
    misfit, asked_around, monkeypatch
):
    light = SimpleNamespace(solver=None, fit=SimpleNamespace(residual=misfit))
    search, added = Shadows(SimpleNamespace(light=light)), []

    def lamp(direction, left):
        return SimpleNamespace(own=SimpleNamespace(direction=direction), left=left)

    def beside(each):
        added.extend(lamp(direction, 0.101) for direction in rings_about(TOWARDS))
        return each + added

    stand_ins = {"_settled": lambda one: one, "_onward": lambda one, _: one, "_half_seen": lambda _: 0.0}
    stand_ins |= {"_likely": lambda: [lamp(TOWARDS, 0.1)], "_beside": beside}
    for name, stand_in in stand_ins.items():
        monkeypatch.setattr(search, name, stand_in)
    found = search.found()
    assert bool(added) is asked_around and found[0].left == 0.1
    assert len(found) == (BEST if asked_around else 1) < len(rings_about(TOWARDS))


@pytest.mark.parametrize(("lamp", "is_shadow"), [(0.24, True), (0.18, False)])
def test_a_lamp_nearby_that_explains_nearly_as_much_is_no_shadow(in_the_dark, monkeypatch, lamp, is_shadow):
    """It has fewer unknowns; but one that explains half as much, which imitates what it can, is no rival."""
    left = {"as it is": 0.4, "shadow": 0.15, "sharp": 0.4, "near": lamp}
    for name in ("sharp", "near"):
        monkeypatch.setattr(parted, f"{name}_lamps", lambda model, light, name=name: (name, light, {}))

    def left_over(_, tried):
        named = ["as it is", "shadow", *(what for what, _ in tried[2:])]
        return [left.get(what, 0.4) if isinstance(what, str) else 0.4 for what in named]

    monkeypatch.setattr(parted, "left_over", left_over)
    assert (SHADOW in in_parts(*in_the_dark)[2]) is is_shadow


@pytest.mark.parametrize(
    ("left", "patches", "gloss", "expected"),
    [
        ((0.4, 0.19), (0.2, 0.19), False, True),
        ((0.4, 0.21), (0.2, 0.05), False, False),
        ((0.4, 0.29), (0.2, 0.11), True, True),  # highlights leave as much with a shadow as without
        ((0.4, 0.29), (0.2, 0.13), True, False),
        ((0.4, 0.31), (0.2, 0.05), True, False),
    ],
)
def test_beside_highlights_a_shadow_explains_whole_parts(monkeypatch, left, patches, gloss, expected):
    monkeypatch.setattr(parted, "shines", lambda _: gloss)
    monkeypatch.setattr(parted, "patch_misfit", lambda problems, light: patches[light])
    model = SimpleNamespace(problems=None)
    assert leaves_less(left, [(model, 0), (model, 1)]) is expected
