# SPDX-License-Identifier: GPL-3.0-or-later
"""A ground with an object's shadow on it, as evidence beside the object: what it adds, and what it must not change."""

from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine.conventions import pixel_directions, pixel_solid_angles
from btfsep_engine.fit.ground import EVIDENCE, LOOKED_AT, NULL, SKY, Ground, WithGround, _drift
from btfsep_engine.fit.log_normal import LightSolver
from tests.engine.half_sphere import SUN, even, half_sphere, lamp, off, shown

BEHIND = np.array([0.25, 0.9, 0.35]) / np.linalg.norm([0.25, 0.9, 0.35])  # the ball is seen from -y
FACING = 0.5  # cosine from which on pixels of the ball are used: none of them is lit from behind
RAYS = pixel_directions(*SKY).reshape(-1, 3)


def white_under(directions, at) -> np.ndarray:
    """What a white ground z = -1 under the unit ball shows at places (p, 3) of beams from directions (n, 3): (p, n)."""
    along = at @ directions.T
    blocked = (along < 0) & (np.square(at).sum(1)[:, None] - along**2 < 1)
    return np.where(blocked, 0, np.maximum(directions[:, 2], 0)) / np.pi


def table(rng, light, *, colour=(0.5, 0.3, 0.2), noise=0.01, places=250) -> Ground:
    """The ground in front of the ball under ``light``: (direction, irradiance) of lamps, and even light's radiance."""
    beams, radiance = light
    at = np.concatenate([rng.uniform([-4, -5], [4, 0.5], (places, 2)), np.full((places, 1), -1.0)], 1)
    response = white_under(RAYS, at)
    area = np.repeat(pixel_solid_angles(*SKY), SKY[1])
    values = radiance * (response * area).sum(1)
    for direction, irradiance in beams:
        values = values + irradiance * white_under(direction[None], at)[:, 0]
    b = values[:, None] * np.asarray(colour) * (1 + noise * rng.normal(size=(places, 3)))
    return Ground(np.repeat(response[..., None], 3, 2).astype(np.float32), b, np.zeros(places, int), at[:, :2])


@pytest.fixture
def case(rng):
    """A photograph of the ball under a lamp in front and one behind, solved alone; and the light's coefficients."""
    light = ([(SUN, 2.0), (BEHIND, 3.0)], 0.1)
    x = even((0.1,) * 3) + lamp(SUN, [2.0] * 3) + lamp(BEHIND, [3.0] * 3)
    basis, normals, _ = half_sphere(rng, pixels=800, albedo=(0.5, 0.5, 0.5), gloss=0.0)
    front = normals[:, 1] < -FACING
    basis, normals = basis[front], normals[front]
    solver = LightSolver(basis, normals=normals, order=4)
    b = shown(basis, x, rng, 0.03)
    return light, x, solver, b, solver.solve(b)


def test_a_lamp_behind_the_object_is_found_by_its_shadow(case, rng):
    light, x, solver, b, alone = case
    fit = solver.beside_ground(b, alone, table(rng, light))
    assert off(alone, x) > 0.3 and off(fit, x) < 0.12
    nearest = max(lamp.direction @ BEHIND for lamp in fit.lamps)
    assert np.degrees(np.arccos(nearest)) < 5
    assert fit.all_coefficients.shape == alone.all_coefficients.shape and fit.samples.shape == alone.samples.shape


def test_the_colour_of_the_ground_is_free(case, rng):
    light, _, solver, b, alone = case
    seeds = (np.random.default_rng(3) for _ in range(2))
    one, other = (table(seed, light, colour=c) for seed, c in zip(seeds, ((0.5,) * 3, (0.9, 0.1, 0.02)), strict=True))
    first, second = (solver.beside_ground(b, alone, g).all_coefficients for g in (one, other))
    # the same but for where the search stops: mostly 1e-6, seldom a hundredth
    assert np.linalg.norm(first - second) < 0.02 * np.linalg.norm(first)


def test_through_a_texture_a_shadow_is_seen_and_a_ground_without_one_counts_for_little(case, rng):
    light, x, solver, b, alone = case
    ground = table(rng, light)
    texture = rng.uniform(0.2, 1, (250, 1))
    seen, unseen = (
        solver.beside_ground(b, alone, Ground(ground.response, shown, ground.surface, ground.at))
        for shown in (ground.radiance * texture, ground.radiance.mean() * np.repeat(texture, 3, 1))
    )
    assert off(seen, x) < 0.2 and off(unseen, x) < 1.1 * off(alone, x)


def test_the_products_are_those_of_the_dense_model(case, rng):
    light, _, _, _, alone = case
    ground = table(rng, light, places=60)
    photo = WithGround(alone.election.photo, ground, alone.election.solution)
    v, x = np.array([2e-3, 3e-3, 4e-3, 1e-3, 2e-3, 3e-3]), rng.normal(size=(3, 100 + photo._columns.shape[2]))
    rows, own = photo.rows(v, 0.08), alone.election.photo.rows(v[:3], 0.08)
    wanted = np.square(own.residual(x[:, :100])).sum() + own.rest
    logs = own.log_determinant
    for c in range(3):
        left = photo._seen[c] - photo._columns[c] @ x[c, 100:]
        f, unit = photo._departures[c], v[3 + c] * photo._stiffness
        covariance = unit * np.eye(60) + f @ f.T
        wanted += left @ np.linalg.solve(covariance, left)
        logs += 0.5 * (np.linalg.slogdet(covariance)[1] - 60 * np.log(unit))
    assert np.square(rows.residual(x)).sum() + rows.rest == pytest.approx(wanted, rel=1e-3)
    assert rows.log_determinant == pytest.approx(logs)


def test_places_that_are_told_twice_count_as_once(case, rng):
    light, _, _, _, alone = case
    once, count = table(rng, light, places=60), 60
    twice = Ground(*(np.repeat(each, 2, 0) for each in (once.response, once.radiance, once.surface, once.at)))
    alike = 2 * (1 + count / EVIDENCE) / (1 + 2 * count / EVIDENCE)
    one, other = (
        WithGround(alone.election.photo, ground, alone.election.solution, alike=a)
        for ground, a in ((once, 1.0), (twice, alike))
    )
    v, x = np.full(6, 2e-3), rng.normal(size=(3, 100 + one._columns.shape[2]))
    x_other = x.copy()  # the same light, by the other's axes
    x_other[:, 100:] = x[:, 100:] @ one.ground.axes.T @ other.ground.axes
    rows, same = one.rows(v, 0.08), other.rows(v, 0.08)
    left, left_same = (np.square(r.residual(each)).sum() + r.rest for r, each in ((rows, x), (same, x_other)))
    assert left_same == pytest.approx(left, rel=1e-3) and same.log_determinant == pytest.approx(rows.log_determinant)
    np.testing.assert_allclose(other.noise_count, one.noise_count)
    full = WithGround(alone.election.photo, twice, alone.election.solution).rows(v, 0.08)
    assert np.square(full.residual(x_other)).sum() + full.rest > 1.3 * left


@pytest.mark.parametrize("side", [0.0, 0.5, 0.8])
def test_how_many_places_speak_as_one_is_how_many_share_what_is_left_over(case, rng, monkeypatch, side):
    """Of squares of which each has a colour of its own: the mean, over the places, of how many are in their square."""
    _, _, _, _, alone = case
    at = np.stack([a.ravel() for a in np.meshgrid(np.arange(24) / 8, np.arange(24) / 8)], 1)
    response = np.repeat(white_under(RAYS, np.concatenate([at, np.full((576, 1), -1.0)], 1))[..., None], 3, 2)
    surface = (at[:, 0] > 1.45).astype(int)
    ground = Ground(response.astype(np.float32), np.ones((576, 3)), surface, at)
    photo = WithGround(alone.election.photo, ground, alone.election.solution)
    square = np.unique((at // side).astype(int) @ [1, 100], return_inverse=True)[1] if side else np.arange(576)
    left, shared = rng.normal(size=(40, square.max() + 1)), np.bincount(square)[square].mean()
    found = []
    for each in left:  # a channel of its own each; the mean over many patterns, since one is by chance
        monkeypatch.setattr(photo, "_left_over", lambda x, v, each=each: np.tile(each[square], (3, 1)))
        found.append(photo.alike(alone.election.solution))
    assert np.mean(found) == pytest.approx(shared, rel=0.3) if side else 1 <= np.mean(found) < 2
    monkeypatch.setattr(photo, "_left_over", lambda x, v: np.tile(1.0 - 2 * surface, (3, 1)))
    apart = photo.alike(alone.election.solution)
    photo.ground = Ground(ground.response, ground.radiance, np.zeros(576, int), at)
    assert photo.alike(alone.election.solution) < apart  # nothing goes on from one surface to another


def test_the_map_of_beams_is_the_ground_under_a_light(case, rng):
    """Columns and axes of the decomposition, between the map's pixels, against the ground's own formula."""
    light, _, _, _, alone = case
    ground = table(rng, light)
    photo = WithGround(alone.election.photo, ground, alone.election.solution)
    found = photo._columns[0] @ photo.fields[0].of_beam(RAYS)[:, 100:].T
    assert np.sqrt(np.square(found - ground.response[..., 0]).mean()) < 0.01 * found.max()
    assert np.abs(found[:, RAYS[:, 2] < 0]).max() < 0.01 * found.max()  # nothing comes from behind it
    assert photo.shadowed(np.array([BEHIND, [0, 0, -1.0]])).tolist() == [True, False]


def test_whether_a_lamp_would_be_seen_does_not_depend_on_the_company_it_is_asked_in(case, rng):
    _, _, _, _, alone = case
    photo = WithGround(alone.election.photo, table(rng, case[0]), alone.election.solution)
    directions = photo.fields[0].directions
    seen = photo.shadowed(directions)
    assert 0 < seen.sum() < len(seen)
    faint = directions[~seen]
    assert not photo.shadowed(faint).any() and len(photo.shadowed(faint[:0])) == 0
    assert [bool(photo.shadowed(d[None])[0]) for d in directions[::40]] == seen[::40].tolist()


def test_of_a_lamp_that_lights_all_places_alike_the_ground_shows_nothing(case, rng):
    """However bright it is: shadows tell where a lamp stands, and not how much light there is."""
    _, _, _, _, alone = case
    at = np.concatenate([rng.uniform(50, 60, (40, 2)), np.full((40, 1), -1.0)], 1)  # beyond all shadows
    response = np.repeat(white_under(RAYS, at)[..., None], 3, 2).astype(np.float32)
    far = Ground(response, np.ones((40, 3)), np.zeros(40, int), at[:, :2])
    photo = WithGround(alone.election.photo, far, alone.election.solution)
    high = RAYS[RAYS[:, 2] > 0.5]
    assert photo._lit_by(high).min() > 0.1 and not photo.shadowed(high).any()


def test_what_a_ground_varies_by_is_as_much_lighter_as_darker_on_each_surface(rng):
    """Wherever in the picture it lies: its colour has a constant of its own, and other surfaces have theirs."""
    at, surface = rng.uniform([3, -5], [8, 1], (200, 2)), np.arange(200) % 2
    each = np.split(_drift(Ground(np.zeros((200, 1, 3)), np.zeros((200, 3)), surface, at)), 2, 1)
    for number, own in enumerate(each):
        constant, smooth = own[surface == number, :1], own[surface == number, 1:]
        assert np.ptp(constant) == 0 and not own[surface != number].any()
        assert (smooth.std(0) > 0).all()
        np.testing.assert_allclose(smooth.mean(0), 0, atol=1e-9)


@pytest.mark.parametrize("places", [60, 1000])
def test_the_axes_of_a_coloured_gloss_leave_out_no_more_than_those_of_all_channels(rng, places):
    """White highlights over a coloured base: each channel is another mixture of the two."""
    smooth = np.exp(-0.5 * np.square(np.subtract.outer(np.arange(1800), np.linspace(0, 1800, 90)) / 30))
    base, gloss = ((smooth @ np.abs(rng.normal(size=(90, places)))).T for _ in range(2))
    response = np.stack([share * base + 0.3 * gloss for share in (1.0, 0.4, 0.1)], 2).astype(np.float32)
    ground = Ground(response, np.zeros((places, 3)), np.zeros(places, int), np.zeros((places, 2)))
    seen = np.moveaxis(response, 2, 0).reshape(-1, 1800).astype(np.float64)
    axes, (squares, of_all) = ground.axes, np.linalg.eigh(seen.T @ seen)
    kept = of_all[:, squares > NULL**2 * squares[-1]]
    lost, least = (np.linalg.norm(seen - seen @ a @ a.T) for a in (axes, kept))
    assert lost < 1.05 * least + 1e-6 * np.linalg.norm(seen)
    assert axes.shape == kept.shape  # of two responses their mean and what is off it leave nothing out
    np.testing.assert_allclose(np.linalg.svd(axes.T @ kept, compute_uv=False), 1, atol=1e-4)
    np.testing.assert_allclose(axes.T @ axes, np.eye(axes.shape[1]), atol=1e-4)
    np.testing.assert_allclose(ground.columns, np.moveaxis(response, 2, 0) @ axes, rtol=1e-4, atol=1e-4)


def test_a_first_look_at_a_ground_has_enough_of_each_surface_and_what_is_small_whole(case, rng):
    light = case[0]
    small = table(rng, light, places=2 * LOOKED_AT - 1)
    assert len(small.thinned.radiance) == len(small.radiance)
    some = table(rng, light, places=4 * LOOKED_AT + 3)
    surface = np.repeat([0, 1], [4 * LOOKED_AT - 37, 40])
    some = replace(some, surface=surface, at=np.arange(len(surface))[:, None] * np.ones(2))
    few = some.thinned
    assert LOOKED_AT <= len(few.radiance) < 1.1 * LOOKED_AT and (np.bincount(few.surface) >= 9).all()
    which = few.at[:, 0].astype(int)
    for name in ("response", "radiance", "surface"):
        np.testing.assert_array_equal(getattr(few, name), getattr(some, name)[which])
    twenty = {name: np.concatenate([getattr(some, name)] * 20) for name in ("response", "radiance")}
    many = replace(some, **twenty)
    many = replace(many, surface=np.repeat([0, 1], [len(many.radiance) - 40, 40]), at=np.zeros((len(many.radiance), 2)))
    assert np.bincount(many.thinned.surface)[1] >= 2  # however little of all a surface is


def test_of_two_grounds_the_one_that_goes_with_the_objects_is_more_probable_at_a_first_look(case, rng):
    """What a first look has to say is which of several; a ground whose shadow lies elsewhere is none."""
    light, _, solver, b, alone = case
    right = table(rng, light, places=2 * LOOKED_AT)
    turned = replace(right, response=right.response[::-1])
    evidences = [solver.ground_evidence(b, alone, one) for one in (right, turned)]
    assert evidences[0] > evidences[1] + 10
