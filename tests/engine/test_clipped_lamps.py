# SPDX-License-Identifier: GPL-3.0-or-later
"""How bright clipped lamps are, as a rule and as a table has it: the numbers alone."""

from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine.conventions import fibonacci_sphere, pixel_directions, pixel_solid_angles
from btfsep_engine.fit.ground import SKY
from btfsep_engine.pipeline import clipped_lamps
from btfsep_engine.pipeline.clipped_lamps import (
    ALIKE,
    EACH,
    LACKS,
    Asked,
    Lamps,
    as_a_rule,
    of_one_colour,
    patch_of,
    whitened,
)
from btfsep_engine.pipeline.ground_places import Places
from scripts.studies import clipped as clipped_study

CELLS = 600
COLOUR = np.array([0.6, 0.4, 0.2])


def clipped(random, count=40):
    """A light (CELLS, 3), and what of it is clipped: all of it, in the brightest cells."""
    light = np.exp(random.normal(size=(CELLS, 3)))
    lost = np.zeros_like(light)
    brightest = np.argsort(light.sum(1))[-count:]
    lost[brightest] = light[brightest]
    return light, lost


def test_as_a_rule_all_of_it_lacks_what_natural_light_does(rng):
    light, lost = clipped(rng)
    lamps = as_a_rule(light, lost, 0.03)
    added = lamps.parts(lost)
    assert added.sum() == pytest.approx(np.exp(LACKS[0]) * 0.03 ** LACKS[1] * light.sum())
    np.testing.assert_allclose(added.sum(0) / added.sum(), lost / lost.sum(), atol=1e-12)
    of_patch = [np.unique(patch_of(fibonacci_sphere(CELLS)[part.any(1)])) for part in added]
    assert [list(each) for each in of_patch] == [[k] for k in lamps.patches]


def test_each_patch_is_in_doubt_and_all_of_them(rng):
    lamps = as_a_rule(*clipped(rng), 0.03)
    covariance = lamps.doubt @ lamps.doubt.T
    k = len(lamps.patches)
    np.testing.assert_allclose(covariance, ALIKE**2 + EACH**2 * np.eye(k))


def test_nothing_clipped_nothing_added():
    lamps = as_a_rule(np.ones((CELLS, 3)), np.zeros((CELLS, 3)), 0.0)
    assert lamps.parts(np.zeros((CELLS, 3))).shape == (0, CELLS, 3) and lamps.doubt.shape[0] == 0
    assert not lamps.added_to(fibonacci_sphere(50)).any()


def test_clipped_light_is_white_whatever_the_mirror_is():
    lost = np.array([[0.9, 1.5, 3.0], [2.0, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(whitened(lost), [[1.8, 1.8, 1.8], [2.0, 0, 0], [0, 0, 0]])


def test_what_is_seen_of_clipped_lamps_is_of_one_colour_and_as_bright(rng):
    directions, weights, over = fibonacci_sphere(300), rng.random(300), rng.random((300, 3)) > 0.5
    seen = 1 + rng.random((300, 3))
    even = of_one_colour(seen, over, directions, weights)
    np.testing.assert_allclose(even.sum(1), (seen * over).sum(1))
    for patch in (0, 40):
        some = even[(patch_of(directions) == patch) & over.any(1)]
        assert np.ptp(some / some.sum(1, keepdims=True), axis=0).max() < 1e-12


def test_it_has_the_colour_of_what_is_not_clipped_and_not_the_mirrors():
    up = np.tile([0.0, 0, 1], (2, 1))
    of_gold = of_one_colour(np.array([[1.0, 1.3, 3.0]] * 2), np.ones((2, 3), bool), up, np.ones(2))
    np.testing.assert_allclose(of_gold, 5.3 / 3)  # all clipped: white
    orange = of_one_colour(np.array([[1.0, 0.6, 0.2]] * 2), np.array([[True, False, False]] * 2), up, np.ones(2))
    np.testing.assert_allclose(orange, [[1 / 1.8, 0.6 / 1.8, 0.2 / 1.8]] * 2)
    assert not of_one_colour(np.ones((2, 3)), np.zeros((2, 3), bool), up, np.ones(2)).any()


def test_pixels_get_what_their_patch_lacks():
    lamps = Lamps(np.array([3, 70]), np.array([2.0, 5.0]), np.eye(2))
    directions = fibonacci_sphere(400)
    np.testing.assert_array_equal(
        lamps.added_to(directions), 2.0 * (patch_of(directions) == 3) + 5.0 * (patch_of(directions) == 70)
    )


def asked(random, factors, *, places=300, noise=0.0, colour=COLOUR, spread=0.3) -> Asked:
    """A table of `COLOUR` under lamps ``factors`` times as bright as a rule, each in a shadow of its own."""
    k = len(factors)
    straight = 1 + 0.2 * random.random((places, 1)) * np.ones(3)
    parts = 0.5 * (random.random((places, k, 1)) > 0.4) * (1 + 0.3 * random.random((1, k, 3)))
    shown = COLOUR * (straight + (parts * np.asarray(factors)[:, None]).sum(1))
    shown = shown * (1 + noise * random.normal(size=shown.shape))
    doubt = np.concatenate([np.full((k, 1), ALIKE), EACH * np.eye(k)], 1)
    return Asked(shown, straight, parts, doubt, np.broadcast_to(colour, 3), spread)


def test_shadows_tell_how_bright_each_lamp_is(rng):
    factors = np.array([8.0, 0.3, 2.0])
    table = asked(rng, factors, colour=COLOUR * [1.3, 0.8, 1.1])
    log_factors, root = table.most_probable()
    np.testing.assert_allclose(np.exp(log_factors), factors, rtol=0.05)
    assert table.left(log_factors) < 0.01 < 0.2 < table.left(np.zeros(3))
    assert (np.sqrt(np.diag(root @ root.T)) < 0.5 * np.hypot(ALIKE, EACH)).all()


def test_what_is_known_of_them_is_laplaces(rng):
    """At the maximum no unknown wants to move, and the covariance is that of the posterior's own curvature."""
    table = asked(rng, np.array([4.0, 0.5]), noise=0.1)
    per_value = np.full(3, 3.0)
    z, curvature = table._settled(np.zeros(6), per_value)
    at = table._chi2(z, per_value)[0]
    step = 1e-3
    for move in np.concatenate([step * np.eye(6), -step * np.eye(6)]):
        assert table._chi2(z + move, per_value)[0] > at
    numeric = np.empty((6, 6))
    for i, a in enumerate(step * np.eye(6)):
        for j, b in enumerate(step * np.eye(6)):
            corners = [table._chi2(z + p * a + q * b, per_value)[0] * p * q for p in (1, -1) for q in (1, -1)]
            numeric[i, j] = sum(corners) / (8 * step**2)
    np.testing.assert_allclose(curvature, numeric, atol=0.1 * np.abs(numeric).max())


def test_a_table_in_noise_tells_less(rng):
    spreads = []
    for noise in (0.03, 0.3):
        root = asked(np.random.default_rng(1), np.array([3.0, 1.0]), noise=noise).most_probable()[1]
        spreads.append(np.sqrt(np.diag(root @ root.T)))
    assert (spreads[1] > 2 * spreads[0]).all()


def test_a_colour_that_is_said_is_held_to(rng):
    """Lamps that no shadow shows are told from the colour by how bright the table is, as far as that is known."""
    straight, parts = np.ones((200, 3)), np.ones((200, 1, 3))
    doubt = np.array([[ALIKE, EACH]])
    found = []
    for spread in (0.01, 3.0):
        even = Asked(COLOUR * (straight + 4 * parts[:, 0]), straight, parts, doubt, COLOUR, spread)
        found.append(np.exp(even.most_probable()[0][0]))
    assert found[0] == pytest.approx(4, rel=0.1) and 1 < found[1] < 3


def table_showing(random, brighter: float, *, known=True):
    """A Table's stand-in whose lamps are ``brighter`` times as a rule, with what is clipped, and its photo."""
    light, lost = clipped(random)
    lamps = as_a_rule(light, lost, 0.03)
    directions = pixel_directions(*SKY).reshape(-1, 3)
    response = (random.random((200, 1)) + (random.random((200, len(directions))) > 0.5)) * np.maximum(
        directions[:, 2], 0
    )
    response = np.repeat(response[..., None], 3, 2).astype(np.float32)
    whole = light + brighter * lamps.parts(lost).sum(0)
    shown = COLOUR * clipped_lamps._under(response, whole[None])[:, 0]
    surface = object() if known else None
    occluder, job = SimpleNamespace(surface=surface), SimpleNamespace(occluders=[None, None])
    job.occluders[1] = occluder
    table = clipped_lamps.Table(SimpleNamespace(job=job, colours={}, occluder_albedos=[None, COLOUR]), [], None, 1)
    places = Places(np.arange(200), np.zeros(200, int), np.arange(200))
    vars(table)["_seen"] = (places, response)
    photo = SimpleNamespace(radiance=shown[:, None], usable=np.ones((200, 1), bool))
    return table, lamps, light, lost, photo


@pytest.mark.parametrize("known", [True, False])
def test_a_table_is_believed_where_it_asks_for_other_lamps(rng, known):
    table, lamps, *seen = table_showing(rng, 6.0, known=known)
    told = table.told(lamps, *seen)
    assert told.by_table and list(told.patches) == list(lamps.patches)
    total, before = (each.parts(seen[1]).sum() for each in (told, lamps))
    assert total == pytest.approx(6 * before, rel=0.35)
    assert np.trace(told.doubt @ told.doubt.T) < np.trace(lamps.doubt @ lamps.doubt.T)


def test_a_table_that_tells_nothing_changes_nothing(rng, monkeypatch):
    """Where the lamps as a rule leave as little over, where too little is seen of it, or what is seen is clipped."""
    table, lamps, *seen = table_showing(rng, 1.0)
    assert table.told(lamps, *seen) is lamps
    table, lamps, light, lost, photo = table_showing(rng, 6.0)
    photo.usable[:] = False
    assert table.told(lamps, light, lost, photo) is lamps
    vars(table)["_seen"] = None
    assert table.told(lamps, light, lost, photo) is lamps
    monkeypatch.setattr(clipped_lamps, "blocks_of", lambda *_: None)
    assert clipped_lamps.Table(None, [], None, 0)._seen is None


def test_of_a_photo_without_clipped_lamps_no_table_is_looked_at():
    """Not even at a scene: there is none."""
    nothing = np.zeros((CELLS, 3))
    lamps = as_a_rule(nothing + 1, nothing, 0.0)
    assert clipped_lamps.Table(None, [], None, 0).told(lamps, nothing + 1, nothing, None) is lamps


def test_the_study_cuts_a_map_off_and_holds_both_ways_against_the_same_truth(rng):
    radiance = np.ones((64, 128, 3)) + 0.1 * rng.random((64, 128, 3))
    radiance[10:14, 20:28] = 30.0  # half of a percent of the pixels
    cut = clipped_study.exposed(radiance, 99.7)
    area = np.repeat(pixel_solid_angles(64, 128), 128).reshape(64, 128)[10:14, 20:28].sum() / (4 * np.pi)
    assert cut["share"] == pytest.approx(area) and cut["true"].sum() == cut["light"].sum()  # cut at 30: nothing is lost
    cut = clipped_study.exposed(radiance, 99.0)
    most = np.percentile(radiance.max(-1), 99.0)
    lacking = (np.maximum(radiance - most, 0).mean(-1) * pixel_solid_angles(64, 128)[:, None]).sum() * 3
    assert cut["true"].sum() - cut["light"].sum() == pytest.approx(lacking) and lacking > 0
    rule, one = clipped_study.study("sun", radiance, 99.0, rng)
    assert rule["error"] == one["error"] and rule["stated"] > 0 and rule["lacking"] > 0.05
