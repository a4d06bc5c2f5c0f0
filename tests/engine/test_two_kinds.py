# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels that a lamp lights or not, and pixels of two paints, told apart beside smooth light that nobody knows."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.fit.two_kinds import FARTHEST, FEW, MANY, TwoKinds, edges_of, in_between, neighbours, share_of

SIDE = 24  # pixels
TOWARDS = np.array([-0.45, 0.3, 0.84]) / np.linalg.norm([-0.45, 0.3, 0.84])
LAMP = np.array([3.0, 2.5, 2.0])
COUNTS = np.ones((SIDE**2, 3))


@pytest.fixture
def bumpy(rng):
    """Pixels of a matte surface that leans anywhere, a straight line across, and what a soft light makes of it."""
    normals = rng.normal(size=(SIDE**2, 3))
    normals *= np.sign(normals[:, 2:]) / np.linalg.norm(normals, axis=1, keepdims=True)
    pixels = np.stack(np.mgrid[:SIDE, :SIDE], -1).reshape(-1, 2)
    basis = np.repeat((sh.evaluate(9, normals) * sh.cosine_lobe(9)[sh.degrees(9)] / np.pi)[..., None], 3, 2)
    soft = np.einsum("ptc,tc->pc", basis[:, :4], np.array([[1.5], [0.3], [0.5], [-0.2]]) * [1.0, 0.9, 0.7])
    half, around = pixels @ [0.6, 0.8] > 0.7 * SIDE, neighbours(pixels)
    edge = np.abs(pixels @ [0.6, 0.8] - 0.7 * SIDE) < FARTHEST
    return SimpleNamespace(pixels=pixels, normals=normals, basis=basis, soft=soft, half=half, around=around, edge=edge)


def beams(normals, *directions):
    """(p, n, 3), what beams of irradiance 1 make of a white surface."""
    return np.repeat(np.maximum(normals @ np.array(directions).T, 0)[..., None] / np.pi, 3, 2)


def noisy(b, rng):
    return b * rng.normal(1, 0.01, b.shape)


def some_of(which, rng):
    """As ``which``, but for a third that says the contrary."""
    return which ^ (rng.random(which.shape) < 0.33)


def only_at_the_edge(found, there, edge):
    """Whether two sets of pixels are the same but for a few at the edge."""
    return not (found ^ there)[~edge].any() and (found ^ there).mean() < 0.03


@pytest.mark.parametrize("other", [False, True])
def test_of_many_lamps_the_one_that_half_of_the_pixels_see_is_found_and_which_do(bumpy, rng, other):
    there = bumpy.half ^ other
    lamps = np.concatenate([fibonacci_sphere(60), TOWARDS[None]])
    lamps = lamps[[*(lamps[:-1] @ TOWARDS < np.cos(np.radians(25))), True]]
    photo = noisy(bumpy.soft + there[:, None] * LAMP * beams(bumpy.normals, TOWARDS)[:, 0], rng)
    kinds = TwoKinds(bumpy.basis, photo, COUNTS, bumpy.around)
    for start in (kinds.brighter, some_of(there, rng)):
        lit, left = kinds.lit(beams(bumpy.normals, *lamps), start)
        assert lit.shape == (SIDE**2, len(lamps)) and left.argmin() == len(lamps) - 1
        assert left[-1] < 0.4 * left[:-1].min()
        assert only_at_the_edge(lit[:, -1], there, bumpy.edge)


def test_what_a_lamp_leaves_over_is_the_noise_that_neither_it_nor_the_light_explains(bumpy, rng):
    """Where no pixel lies at an edge: the halves are apart."""
    lamp, half = beams(bumpy.normals, TOWARDS), bumpy.half
    exact = bumpy.soft + half[:, None] * LAMP * lamp[:, 0]
    photo, unit = noisy(exact, rng), exact.mean(0)  # channels count by their means
    kinds = TwoKinds(bumpy.basis, photo, COUNTS, neighbours(bumpy.pixels + 100 * half[:, None]))
    lit, left = kinds.lit(lamp, kinds.brighter)
    np.testing.assert_array_equal(lit[:, 0], half)
    assert left[0] == pytest.approx(np.linalg.norm((photo - exact) / unit) / np.linalg.norm(photo / unit), rel=0.3)


def test_a_lamp_takes_no_light_away(bumpy, rng):
    """What is darker than one light makes it, no lamp there explains; nor does one that nothing faces."""
    lamp = beams(bumpy.normals, TOWARDS)
    photo = noisy(bumpy.soft + LAMP * lamp[:, 0] * np.where(bumpy.half, 0.5, 1)[:, None], rng)
    kinds = TwoKinds(bumpy.basis, photo, COUNTS, bumpy.around)
    none, without = kinds.lit(np.zeros_like(lamp), bumpy.half)
    lit, left = kinds.lit(lamp, bumpy.half)
    assert not none.any() and not lit.any() and left[0] == pytest.approx(without[0])
    assert kinds.lit(lamp, ~bumpy.half)[1][0] < 0.3 * without[0]


@pytest.mark.parametrize("paint", [0.4, 2.5, (0.9, 0.4, 0.3), (1.0, 1.0, 2.0)])
def test_another_paint_is_found_be_it_lighter_or_darker_or_of_another_colour(bumpy, rng, paint):
    light = bumpy.soft + LAMP * beams(bumpy.normals, TOWARDS)[:, 0]
    photo = noisy(light * np.where(bumpy.half[:, None], paint, 1.0), rng)
    kinds = TwoKinds(bumpy.basis, photo, COUNTS, bumpy.around)
    assert only_at_the_edge(kinds.painted(some_of(bumpy.half, rng))[0], bumpy.half, bumpy.edge)
    lighter = bumpy.half ^ (np.mean(paint) < 1)
    assert only_at_the_edge(kinds.painted(kinds.brighter)[0], lighter, bumpy.edge)


def test_a_paint_that_reflects_as_much_is_told_by_its_colour(bumpy, rng):
    photo = noisy(bumpy.soft * np.where(bumpy.half[:, None], [1.5, 1.0, 0.65], 1.0), rng)
    kinds = TwoKinds(bumpy.basis, photo, COUNTS, bumpy.around)
    found, left = kinds.painted(some_of(bumpy.half, rng))
    assert only_at_the_edge(found, bumpy.half, bumpy.edge) and left < 0.5 * kinds.left


def test_what_is_left_over_is_relative_and_less_of_two_kinds_than_of_one_light(bumpy, rng):
    """Of stains that have no edges, no two paints leave much less."""
    for factor in (1.0, 1e-6):  # in any unit
        kinds = TwoKinds(bumpy.basis, factor * noisy(bumpy.soft, np.random.default_rng(1)), COUNTS, bumpy.around)
        assert kinds.left == pytest.approx(0.01, rel=0.3)  # the noise
    half = np.where(bumpy.half[:, None], 0.4, 1.0)
    waves = np.exp(0.5 * np.sin(bumpy.pixels @ [0.5, 0.4]))[:, None]
    stained, painted = (TwoKinds(bumpy.basis, noisy(bumpy.soft * f, rng), COUNTS, bumpy.around) for f in (waves, half))
    assert painted.painted(bumpy.half)[1] < 0.3 * painted.left
    assert 0.4 * stained.left < stained.painted(stained.brighter)[1] <= stained.left


def test_pixels_that_do_not_count_may_show_anything(bumpy, rng):
    lamp = beams(bumpy.normals, TOWARDS, [0.0, 0.0, 1.0])
    lit_photo = noisy(bumpy.soft + bumpy.half[:, None] * LAMP * lamp[:, 0], rng)
    painted_photo = noisy(bumpy.soft * np.where(bumpy.half, 0.4, 1)[:, None], rng)
    bad = rng.random(SIDE**2) < 0.1
    counts, start = COUNTS * ~bad[:, None], some_of(bumpy.half, rng)
    found = []
    for anything in (0.0, 1e4):
        of_lit, of_paint = (
            TwoKinds(bumpy.basis, np.where(bad[:, None], anything, photo), counts, bumpy.around)
            for photo in (lit_photo, painted_photo)
        )
        found.append([of_lit.brighter, *of_lit.lit(lamp, start), *of_paint.painted(start)])
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(np.asarray(one, float), np.asarray(other, float), rtol=1e-6)
    _, lit, left, painted, _ = found[0]
    assert left.argmin() == 0 and only_at_the_edge(lit[:, 0], bumpy.half, bumpy.edge)
    assert only_at_the_edge(painted, bumpy.half, bumpy.edge)


def test_neighbours_are_a_mean_of_what_is_near_in_any_unit(bumpy, rng):
    around = bumpy.around.toarray()
    np.testing.assert_allclose(around.sum(1), 1)
    distance = cdist(bumpy.pixels, bumpy.pixels)
    assert (around[distance <= FARTHEST] > 0).all() and not around[distance > FARTHEST].any()
    middle = around[SIDE * SIDE // 2 + SIDE // 2]
    row = middle[SIDE * SIDE // 2 + SIDE // 2 :][: int(FARTHEST) + 1]
    assert (np.diff(row) < 0).all()  # what is nearer counts for more
    np.testing.assert_allclose(neighbours(7 * bumpy.pixels + 3).toarray(), around, atol=1e-12)
    apart = neighbours(np.concatenate([bumpy.pixels, bumpy.pixels + np.array([0, 1 << 30])])).toarray()
    assert not apart[: SIDE**2, SIDE**2 :].any() and not apart[SIDE**2 :, : SIDE**2].any()
    np.testing.assert_allclose(apart[: SIDE**2, : SIDE**2], around, atol=1e-12)
    few = neighbours(bumpy.pixels, deviation=0.6, farthest=1.0).toarray()
    assert (few > 0).sum() < (around > 0).sum() and (few.diagonal() > around.diagonal()).all()


def test_a_pixel_has_all_of_an_image_or_nothing_but_at_edges(bumpy):
    image = np.abs(bumpy.soft)
    rows = bumpy.pixels[:, 0]
    edge = np.abs(rows - SIDE / 2 + 0.5) < FARTHEST
    there = (rows >= SIDE // 2).astype(float)
    found = share_of(there[:, None] * image, image, COUNTS, bumpy.around)
    np.testing.assert_array_equal(found[~edge], there[~edge])
    beside = (rows == SIDE // 2) | (rows == SIDE // 2 - 1)
    assert ((found > 0) & (found < 1))[beside].all()
    assert found[rows == SIDE // 2].min() > found[rows == SIDE // 2 - 1].max()


@pytest.mark.parametrize(("part", "expected"), [(-1.0, 0), (0.3, 0), (0.7, 1), (4.0, 1)])
def test_a_part_of_an_image_everywhere_is_all_of_it_or_nothing(bumpy, part, expected):
    """Less than nothing and more than all are these, too."""
    assert (share_of(part * bumpy.soft, bumpy.soft, COUNTS, bumpy.around) == expected).all()


def test_pixels_that_do_not_count_share_as_those_around_them(bumpy, rng):
    bad = rng.random(SIDE**2) < 0.1
    rest = np.where(bad[:, None], -50.0, bumpy.half[:, None] * bumpy.soft)
    found = share_of(rest, bumpy.soft, COUNTS * ~bad[:, None], bumpy.around)
    np.testing.assert_array_equal(found[~bumpy.edge], bumpy.half[~bumpy.edge])


def test_edges_are_where_a_share_differs_and_by_how_much(bumpy, rng):
    for level in (0.0, 0.3, 1.0):
        np.testing.assert_allclose(edges_of(np.full(SIDE**2, level), bumpy.around), 0, atol=1e-7)
    share = rng.random(SIDE**2)
    np.testing.assert_allclose(edges_of(3 * share + 1, bumpy.around), 3 * edges_of(share, bumpy.around), rtol=1e-6)
    weights = bumpy.around.toarray()[100]
    expected = np.sqrt(np.average(np.square(share - np.average(share, weights=weights)), weights=weights))
    assert edges_of(share, bumpy.around)[100] == pytest.approx(expected)
    at = np.abs(bumpy.pixels @ [0.6, 0.8] - 0.7 * SIDE)  # from the line
    edges = edges_of(bumpy.half.astype(float), bumpy.around)
    assert edges[at < 0.5].min() > 0.3 and edges[at > FARTHEST].max() < 1e-6


def with_a_thing(bumpy, colour, share):
    """What is seen where a thing of one colour is before so much of the pixels; and where."""
    there = np.argsort(np.argsort(bumpy.pixels @ [0.6, 0.8])) < share * len(bumpy.pixels)
    return np.where(there[:, None], np.array(colour) * bumpy.soft.mean(0), bumpy.soft), there


@pytest.mark.parametrize("colour", [(3.0, 1.0, 1.0), (0.2, 0.2, 0.2), (2.0, 2.0, 2.0), (1.0, 0.3, 1.5)])
@pytest.mark.parametrize("share", [0.1, 0.35])
def test_pixels_of_something_else_are_found_whatever_its_colour(bumpy, rng, colour, share):
    photo, there = with_a_thing(bumpy, colour, share)
    kinds = TwoKinds(bumpy.basis, noisy(photo, rng), COUNTS, neighbours(bumpy.pixels, deviation=0.6, farthest=1.8))
    starts = [np.zeros(SIDE**2, bool), *kinds.unlike()]
    apart, left = min((kinds.apart(start) for start in starts), key=lambda one: one[1])
    assert apart[there].mean() > 0.97 and apart[~there].mean() < 0.12  # those beside it go with it
    assert left < 0.05 < 0.15 < kinds.left


def test_where_light_explains_all_or_most_would_be_apart_none_are(bumpy, rng):
    kinds = TwoKinds(bumpy.basis, noisy(bumpy.soft, rng), COUNTS, bumpy.around)
    for start in (np.zeros(SIDE**2, bool), bumpy.half):
        apart, left = kinds.apart(start)
        assert not apart.any() and left == pytest.approx(kinds.left, rel=0.05)
    assert kinds.apart(np.ones(SIDE**2, bool))[1] == np.inf
    strange = rng.random((SIDE**2, 3)) * np.where(bumpy.pixels[:, :1] < 0.75 * SIDE, 1, 0) + 1e-3 * bumpy.soft
    assert TwoKinds(bumpy.basis, strange, COUNTS, bumpy.around).apart(bumpy.pixels[:, 0] < 0.75 * SIDE)[1] == np.inf


def test_nearer_ones_are_apart_if_asked(bumpy, rng):
    photo, there = with_a_thing(bumpy, (1.25, 1.0, 0.8), 0.2)
    kinds = TwoKinds(bumpy.basis, photo * rng.normal(1, 0.06, photo.shape), COUNTS, bumpy.around)
    far, near = (kinds.apart(there, off)[0] for off in (20, 1.5))
    assert not far.any() and near[there].mean() > 0.8


def test_groups_that_differ_alike_are_neither_few_nor_nearly_all(bumpy, rng):
    photo, there = with_a_thing(bumpy, (3.0, 1.0, 1.0), 0.3)
    groups = list(TwoKinds(bumpy.basis, noisy(photo, rng), COUNTS, bumpy.around).unlike())
    assert groups and all(FEW < group.mean() < MANY for group in groups)
    assert max((group == there).mean() for group in groups) > 0.9


def test_how_far_from_all_or_nothing_pixels_are_is_told_away_from_edges(bumpy):
    image = LAMP * beams(bumpy.normals, TOWARDS)[:, 0]
    share = bumpy.half.astype(float)[:, None]
    assert in_between(share * image, image, COUNTS, bumpy.around) < 0.01
    assert in_between(0.3 * image, image, COUNTS, bumpy.around) == pytest.approx(0.3, abs=1e-6)
    assert in_between(np.where(share > 0, 0.9, 0.2) * image, image, COUNTS, bumpy.around) == pytest.approx(
        0.15, abs=0.05
    )
    unseen = np.where(np.arange(SIDE**2)[:, None] % 2, image, 0)
    assert in_between(0 * unseen, unseen, COUNTS, bumpy.around) == 0


def test_a_pixel_alone_is_its_own_mean():
    assert neighbours(np.array([[3, 4]])).toarray() == [[1]]
