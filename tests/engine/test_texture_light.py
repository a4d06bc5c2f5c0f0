# SPDX-License-Identifier: GPL-3.0-or-later
"""Light in a texture: painted pieces on a sphere, whose irradiance is known in closed form, and clean textures."""

import warnings

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.conventions import REC709_LUMINANCE, fibonacci_sphere, luminance
from btfsep_engine.fit import texture_light as module
from btfsep_engine.fit.texture_light import BRIGHTEST, DARKEST, LEAST, PIECES, neighbours, texture_light

COUNT, ORDER = 2000, 4
PLACES = fibonacci_sphere(COUNT)  # and normals
IMAGES = sh.cosine_lobe(ORDER)[sh.degrees(ORDER)] * sh.evaluate(ORDER, PLACES)
OPEN = np.zeros(COUNT)


def light(*, tint=(1.2, 1.0, 0.8), side=-0.5):
    """Irradiance (COUNT, 3), 1 in the mean of each channel: more from above, of another colour there, and a side."""
    x = np.zeros((25, 3))
    x[0], x[1], x[2], x[3], x[6] = 3.0, 0.4, tint, side, 0.3
    irradiance = IMAGES @ x
    return irradiance / irradiance.mean(0)


def painted(pieces=30, seed=0, *, grey=False):
    """Base colours (COUNT, 3) of pieces that are each of one colour."""
    random = np.random.default_rng(seed)
    colours = random.uniform(0.2, 0.6, (pieces, 1 if grey else 3)) * np.ones(3)
    return colours[(PLACES @ random.normal(size=(pieces, 3)).T).argmax(1)]


def looked(base_color, images=IMAGES, closed=OPEN, places=PLACES):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return texture_light(base_color, images, closed, neighbours(places, places, base_color))


def off(found, irradiance) -> float:
    """The largest difference of logarithms, of light whose mean is 1."""
    return float(np.abs(found.logarithm - np.log(irradiance / irradiance.mean(0))).max())


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("pieces", "grey"), [(1, True), (5, False), (30, False), (30, True), (100, False)])
def test_the_light_on_painted_pieces_is_found_in_each_channel(pieces, grey, seed):
    true = light()
    found = looked(painted(pieces, seed, grey=grey) * true)
    assert off(found, true) < 0.03
    np.testing.assert_allclose(np.exp(found.logarithm).mean(0), 1, rtol=1e-9)
    assert np.ptp(found.logarithm, axis=0).argsort().tolist() == np.ptp(np.log(true), axis=0).argsort().tolist()
    assert found.contrast == pytest.approx((np.log(true) @ REC709_LUMINANCE).std(), rel=0.02)
    assert found.surely > module.SURELY and 0.02 < found.share <= 1


def test_light_of_which_only_the_colour_differs_from_place_to_place_is_told_by_channel():
    true = light(tint=(2.0, 0.2, -1.0))
    found = looked(painted(5) * true)
    assert off(found, true) < 0.03
    above = PLACES[:, 2] > 0.8
    red, _, blue = found.logarithm[above].mean(0)
    assert red > 0.2 and blue < -0.1


def bits(values):
    """As a file of 8 bits has them."""
    code = np.round(255 * np.clip(values, 0, 1) ** (1 / 2.2))
    return (code / 255) ** 2.2


@pytest.mark.parametrize("seed", range(4))
def test_clean_textures_have_none(seed):
    random = np.random.default_rng(seed)
    axis = random.normal(size=3) / 1.7
    waves = np.sin(35 * PLACES @ axis)[:, None] * np.ones(3)
    textures = {
        "pieces": painted(30, seed),
        "grey pieces": painted(30, seed, grey=True),
        "few pieces": painted(3, seed, grey=True),
        "speckles": painted(30, seed) * random.lognormal(0, 0.1, (COUNT, 1)),
        "noise alone": 0.4 * random.lognormal(0, 0.2, (COUNT, 3)),
        "stripes": 0.4 + 0.1 * waves,
        "hard stripes": np.where(waves > 0, 0.3, 0.5),
        "8 bits": bits(painted(30, seed)),
        "8 bits and noise": bits(0.4 * random.lognormal(0, 0.01, (COUNT, 1)) * np.ones(3)),
    }
    assert [name for name, each in textures.items() if looked(np.clip(each, 0, 0.97)) is not None] == []


@pytest.mark.parametrize("colour", [(0.5, 0.5, 0.5), (0.6, 0.3, 0.1)])
@pytest.mark.parametrize("rounding", [0.0, 1e-15, 1e-7, 1e-5])
def test_one_colour_has_no_light(colour, rounding):
    random = np.random.default_rng(0)
    assert looked(np.array(colour) * (1 + rounding * random.normal(size=(COUNT, 1)))) is None


def test_light_is_found_under_speckles_and_rounding_too():
    true, random = light(), np.random.default_rng(5)
    found = looked(bits(painted() * true * random.lognormal(0, 0.05, (COUNT, 1))))
    assert off(found, true) < 0.08


def test_places_that_are_clipped_are_left_out():
    true, random = light(), np.random.default_rng(2)
    base = painted() * true
    clipped = random.random(COUNT) < 0.2
    base[clipped] = np.where(random.random((clipped.sum(), 1)) < 0.5, DARKEST / 2, 1.0)
    one = int(np.flatnonzero(~clipped)[0])
    base[one] = 0.5, DARKEST / 2, 0.5  # a channel is enough
    other = int(np.flatnonzero(~clipped)[1])
    base[other] = 0.5, BRIGHTEST + 1e-3, 0.5
    pairs = neighbours(PLACES, PLACES, base).pairs
    assert not clipped[pairs].any() and not np.isin(pairs, [one, other]).any() and len(pairs) > COUNT
    assert off(looked(base), true) < 0.03


def hollows():
    """How closed places are, and the irradiance images there; the light, (COUNT, 3); a texture under it."""
    closed = 0.7 * np.square(np.sin(4 * PLACES[:, 0]) * np.sin(4 * PLACES[:, 1] + 1))
    images, brightness = IMAGES * (1 - closed)[:, None], 0.45
    x = np.zeros((25, 3))
    x[0], x[2], x[3] = 1.0, 0.35, -0.1
    irradiance = images / np.median(images[:, 0]) @ x + brightness * closed[:, None]
    base = painted(30, 1) * irradiance
    return closed, images, irradiance, base * brightness / luminance(base).mean()


def test_hollows_are_darker_by_the_sky_they_miss_and_lit_by_the_object():
    closed, images, irradiance, base = hollows()
    found = looked(base, images, closed)
    assert off(found, irradiance) < 0.03
    assert np.corrcoef(found.logarithm[:, 1], closed)[0, 1] < -0.3
    without = looked(base, images, OPEN)
    assert without is None or off(without, irradiance) > 2 * off(found, irradiance)


def test_even_light_in_hollows_is_light():
    closed, images, *_ = hollows()
    irradiance = (1 - closed[:, None]) * np.ones(3)
    found = looked(painted(30, 2) * irradiance, images, OPEN)
    assert off(found, irradiance) < 0.02


def test_a_darker_print_of_the_texture_has_the_same_light():
    base = painted() * light()
    one, dark = looked(base), looked(base / 2)
    np.testing.assert_allclose(dark.logarithm, one.logarithm, atol=1e-9)
    assert dark.surely == pytest.approx(one.surely, rel=1e-6)
    brighter = looked(base, 7 * IMAGES)  # nor do the units of the images matter
    np.testing.assert_allclose(brighter.logarithm, one.logarithm, atol=1e-9)


def test_the_size_and_the_place_of_the_object_do_not_matter():
    base = painted() * light()
    one = looked(base).logarithm
    pairs = neighbours(1e-3 * PLACES + 1, PLACES, base)
    np.testing.assert_allclose(texture_light(base, IMAGES, OPEN, pairs).logarithm, one, atol=1e-4)


def test_it_is_the_same_each_time():
    base = painted() * light()
    one, again = looked(base), looked(base.copy())
    np.testing.assert_array_equal(one.logarithm, again.logarithm)
    assert (one.surely, one.share) == (again.surely, again.share)


@pytest.mark.parametrize("count", [1, 2, 5, 12])
def test_fewer_places_than_terms_say_nothing(count):
    base = (painted() * light())[:count]
    assert looked(base, IMAGES[:count], OPEN[:count], PLACES[:count]) is None


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_what_is_all_clipped_says_nothing(value):
    assert looked(np.full((COUNT, 3), value)) is None


def test_where_most_places_see_no_sky_nothing_is_said():
    inside = np.arange(COUNT) % 5 > 1
    images = np.where(inside[:, None], 0, IMAGES)
    assert looked(painted() * light(), images, inside.astype(float)) is None


def test_neighbours_lie_side_by_side_and_what_differs_in_hue_counts_little():
    base = painted(30)
    beside = neighbours(PLACES, PLACES, base)
    first, second = beside.pairs.T
    assert np.linalg.norm(PLACES[first] - PLACES[second], axis=1).max() < 0.2
    assert (first < second).all() and len(np.unique(beside.pairs, axis=0)) == len(beside.pairs)
    same = (base[first] == base[second]).all(1)
    assert (beside.weight[same] == 1).all() and beside.weight[~same].max() < 0.9 and np.median(beside.weight) == 1
    assert np.median(beside.weight[~same]) < 0.1
    grey = neighbours(PLACES, PLACES, painted(30, grey=True))
    np.testing.assert_allclose(grey.weight, 1)  # brightness alone does not tell paint from light
    assert set(beside.piece) == set(range(PIECES))
    np.testing.assert_array_equal(beside.between(base), base[first] - base[second])


def test_two_sheets_back_to_back_are_no_neighbours():
    """Places of a thin plate's two sides, which may be painted and lit otherwise."""
    grid = np.stack(np.meshgrid(np.linspace(0, 1, 20), np.linspace(0, 1, 20)), -1).reshape(-1, 2)
    places = np.concatenate([np.c_[grid, np.full(400, z)] for z in (0.0, 1e-3)])
    normal = np.repeat([[0, 0, -1.0], [0, 0, 1.0]], 400, axis=0)
    pairs = neighbours(places, normal, np.full((800, 3), 0.5)).pairs
    across = (pairs[:, 0] < 400) != (pairs[:, 1] < 400)
    assert across.mean() < 0.02


def test_light_is_never_darker_than_a_little_of_even_light():
    x = np.eye(1, 25)[0]
    x[2] = 30.0
    a = IMAGES / np.median(IMAGES[:, 0])
    lit = np.exp(module._logarithm(a, x))
    assert lit.min() == pytest.approx(LEAST) and lit.max() > 5


def test_that_it_is_light_has_to_be_sure(monkeypatch):
    base = painted(30, grey=True) * light()
    found = looked(base)
    monkeypatch.setattr(module, "SURELY", 1.01 * found.surely)
    assert looked(base) is None
