# SPDX-License-Identifier: GPL-3.0-or-later
"""The prior of natural light: its derivatives, its statistics by sampling, its symmetry; where its table is from."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.light import log_field, maps
from btfsep_engine.light.log_field import CHROMA, VIVID, as_vivid, coarse_field, even_field, natural_field
from scripts.studies.makers import learn_natural_light

BELOW = fibonacci_sphere(300)[:, 2] < -0.1


@pytest.mark.parametrize("hidden", [None, BELOW], ids=["all", "above"])
def test_the_jacobian_is_that_of_finite_differences(rng, hidden):
    field = replace(natural_field(), hidden=hidden)
    white = 0.5 * rng.normal(size=field.unknowns)
    rows = [rng.normal(size=(count, field.terms)) for count in (3, 5, 4)]

    def images(at):
        x = field.shown(field.radiance(at))
        return np.concatenate([r @ each for r, each in zip(rows, x, strict=True)])

    step = 1e-5 * np.eye(field.unknowns)
    numerical = np.stack([(images(white + s) - images(white - s)) / 2e-5 for s in step], 1)
    found = field.jacobian(field.by_direction(rows), field.radiance(white))
    np.testing.assert_allclose(found, numerical, atol=1e-6 * np.abs(numerical).max())


def test_slopes_of_many_lights_at_once_are_those_of_each(rng):
    field = coarse_field(8, 4, 49, 256)
    rows, whites = rng.normal(size=(5, 3, 4, 49)), 0.7 * rng.normal(size=(5, field.unknowns))
    radiance = field.radiance(whites)
    by_direction = np.array([field.by_direction(each) for each in rows])
    residual = rng.normal(size=(5, 3, 4))
    found, slopes = field.jacobians(by_direction, radiance), field.gradients(by_direction, radiance, residual)
    for i in range(5):
        one = field.jacobian(list(by_direction[i]), radiance[i])
        np.testing.assert_allclose(found[i], one, atol=1e-12 * np.abs(one).max())
        np.testing.assert_allclose(slopes[i], one.T @ residual[i].ravel(), atol=1e-10 * np.abs(slopes[i]).max())


def test_what_is_hidden_is_not_shown_and_what_is_not_is_shown_as_it_was(rng):
    field = replace(natural_field(), hidden=BELOW)
    up = field.reaching
    assert up[field.directions[:, 2] > 0].all() and not up[field.directions[:, 2] < -0.2].any()
    radiance = field.radiance(rng.normal(size=field.unknowns))
    other = np.where(up, radiance, 7 * radiance)
    np.testing.assert_array_equal(field.shown(other), field.shown(radiance))
    assert np.abs(field.coefficients(other) - field.coefficients(radiance)).max() > 1
    np.testing.assert_allclose(field.shown(np.where(up, radiance, 0)), field.coefficients(np.where(up, radiance, 0)))


def test_fields_drawn_have_the_variances_of_the_table(rng):
    """Addition theorem: a stationary field's variance is sum s_l^2 (2 l + 1) / (4 pi), everywhere."""
    table = json.loads(log_field.TABLE.read_text())
    field = natural_field()
    white = rng.normal(size=(1500, field.unknowns))
    white[:, 0] = 0  # the level is as good as unknown
    logs = np.stack([np.linalg.solve(CHROMA, field.logarithm(w)) for w in white])
    logs -= np.linalg.solve(CHROMA, np.log(field.radiance(np.zeros(field.unknowns))))
    for i, (name, order, gain) in enumerate((("luminance", 12, 1.4), ("red_blue", 6, 1.0), ("green", 6, 1.0))):
        l = np.arange(1, order + 1)
        power = (gain * table[name]["at_degree_1"] * l ** -table[name]["decline"]) ** 2
        stated = (power * (2 * l + 1)).sum() + (table[name]["level"] ** 2 if i else 0.0)
        assert logs[:, i].var() == pytest.approx(stated / (4 * np.pi), rel=0.06), name


def test_the_prior_knows_up_and_down_and_no_other_direction(rng):
    """Covariances depend on the angle between two directions alone; the mean does not change about the vertical."""
    field = natural_field()
    d = rng.normal(size=(20, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    harmonics = [sh.evaluate(field.order, np.array(t @ d.T).T) for t in (np.eye(3), Rotation.random(rng=5).as_matrix())]
    of_l = field.deviation[: sh.term_count(field.order)] ** 2
    before, after = ((y * of_l) @ y.T for y in harmonics)
    np.testing.assert_allclose(after, before, atol=1e-9 * before.max())
    nothing = np.zeros(field.unknowns)
    about = Rotation.from_rotvec([0, 0, 1.1]).as_matrix()
    np.testing.assert_allclose(field.at(nothing, d @ about.T), field.at(nothing, d), rtol=1e-9)
    up, down = field.at(nothing, np.array([[0, 0, 1.0], [0, 0, -1.0]]))
    assert (up > 1.5 * down).all()


def test_radiance_is_positive_the_same_by_both_ways_and_finite_on_the_way(rng):
    field = natural_field()
    white = 2 * rng.normal(size=field.unknowns)
    np.testing.assert_allclose(field.at(white, field.directions).T, field.radiance(white), rtol=1e-9)
    assert (field.radiance(white) > 0).all() and np.isfinite(field.radiance(1e3 * white)).all()


def test_coefficients_are_the_integrals_over_the_sphere():
    """Of even light, and of cos^2 about a slanted axis, whose integral has a closed form."""
    field = natural_field()
    axis = np.array([0.6, 0.0, 0.8])
    radiance = np.stack([np.ones(400), 2 * np.ones(400), (field.directions @ axis) ** 2])
    x = field.coefficients(radiance)
    even = np.eye(1, field.terms)[0] * np.sqrt(4 * np.pi)
    squared = sh.evaluate(2, axis[None])[0] * (8 * np.pi / 15)  # cos^2 = 1/3 + 2/3 P_2, the addition theorem
    squared[:4] = [np.sqrt(4 * np.pi) / 3, 0, 0, 0]
    np.testing.assert_allclose(x[:2], np.outer([1, 2], even), atol=0.02)
    np.testing.assert_allclose(x[2, :9], squared, atol=0.01)


def test_even_light_is_one_level_and_one_colour():
    field = even_field()
    assert field.unknowns == 3
    radiance = field.radiance(np.array([0.3, 1.0, -0.5]))
    assert np.ptp(radiance, axis=1).max() < 1e-12 and np.ptp(radiance[:, 0]) > 0.01


def test_vivid_light_varies_by_more_in_its_colours_and_by_as_much_in_its_brightness(rng):
    field, vivid = natural_field(), as_vivid(natural_field())
    white = rng.standard_normal((200, field.unknowns))
    usual, strong = (np.linalg.inv(CHROMA) @ f.logarithm(white) for f in (field, vivid))  # l, c1, c2
    varies = [(each - each.mean((0, 2), keepdims=True)).std((0, 2)) for each in (usual, strong)]
    times = varies[1] / varies[0]
    np.testing.assert_allclose(times, VIVID, rtol=2e-3)  # logarithms end at `LARGEST_LOG`
    assert (VIVID[1:] > 3).all()


def test_the_table_is_what_the_shipped_maps_teach():
    """`scripts/study learn-natural-light` again, with its file left alone."""
    files = sorted(maps.FOLDER.glob("*.exr"))
    table = json.loads(log_field.TABLE.read_text())
    assert table.pop("maps") == [f.stem for f in files]
    learned = learn_natural_light.learn(
        [learn_natural_light.expansions(np.asarray(maps.read_map(f), np.float64)) for f in files]
    )
    assert learned.keys() == table.keys()
    np.testing.assert_allclose(learned.pop("zonal_mean"), table.pop("zonal_mean"), rtol=1e-6)
    for name, each in table.items():
        assert learned[name] == pytest.approx(each, rel=1e-6)
