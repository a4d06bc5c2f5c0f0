# SPDX-License-Identifier: GPL-3.0-or-later
"""Light from where none reaches the photo: as bright, beside the rest, as in the maps themselves; and one light."""

from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere, pixel_solid_angles
from btfsep_engine.fit.light_model import LightModel
from btfsep_engine.light import maps
from btfsep_engine.light.hidden_light import hidden_share, usual_brightness
from btfsep_engine.light.log_field import even_field, natural_field

DIRECTIONS = fibonacci_sphere(400)
BELOW = DIRECTIONS[:, 2] < 0
MANY = fibonacci_sphere(20_000)
LAMP = np.array([0.6, 0, 0.8])


def lights() -> list:
    return [np.asarray(maps.read_map(file), np.float64).mean(-1) for file in sorted(maps.FOLDER.glob("*.exr"))]


def test_what_is_below_is_as_bright_as_in_the_maps():
    each = []
    for light in lights():
        power = light * pixel_solid_angles(*light.shape)[:, None]
        above, below = np.split(power, 2)
        each.append(np.log(below.sum() / above.sum()))
    mean, stddev = usual_brightness(BELOW)
    assert mean == pytest.approx(np.mean(each), abs=0.15)  # the edge is soft
    assert stddev == pytest.approx(np.std(each, ddof=1), rel=0.3)


def test_a_side_may_be_any_side():
    """Of what a wall hides turns say little; seen from behind it, it is the other way round."""
    wall = DIRECTIONS[:, 0] > 0.3
    mean, stddev = usual_brightness(wall)
    back = usual_brightness(~wall)
    assert back == pytest.approx((-mean, stddev), abs=1e-9)
    assert abs(mean) < 0.6 and stddev > 0.5
    one_hidden = np.arange(400) == 7
    assert np.isfinite(usual_brightness(one_hidden)).all()


def test_the_share_is_soft_at_the_edge_and_whole_elsewhere():
    share = hidden_share(BELOW, MANY)
    assert (share[MANY[:, 2] < -0.3] > 0.999).all() and (share[MANY[:, 2] > 0.3] < 0.001).all()
    np.testing.assert_array_equal(hidden_share(BELOW, MANY.reshape(200, 100, 3)), share.reshape(200, 100))
    assert 0.4 < share[np.abs(MANY[:, 2]) < 0.02].mean() < 0.6
    order = np.argsort(MANY[:, 2])
    assert np.abs(np.diff(np.convolve(share[order], np.full(200, 1 / 200), "valid"))).max() < 0.01


@pytest.mark.parametrize("field", [natural_field(), even_field()], ids=["field", "even light"])
def test_all_of_a_light_is_one_light(rng, field):
    """Its coefficients, and its radiance in any direction, with what is hidden as bright as it usually is."""
    field = replace(field, hidden=BELOW)
    model = LightModel(field, (LAMP,))
    white = np.concatenate([0.7 * rng.normal(size=field.unknowns), [0, 0, 0.5, 0, 0]])
    whole = model.whole(white)
    radiance = model.radiance(white, MANY)
    of_sky = sh.evaluate(4, MANY).T @ radiance * (4 * np.pi / len(MANY))
    of_lamp = sh.evaluate(4, LAMP)[:, None] * model.lamp(0, model.parts(white)[1][0])[1]
    np.testing.assert_allclose((of_sky + of_lamp).T, whole[:, :25], atol=0.02 * whole.max())
    share = hidden_share(BELOW, MANY)
    elsewhere = model.whole(white, -100.0)[:, 0].sum()  # hidden light is black then
    ratio = (whole[:, 0].sum() / elsewhere - 1) * (1 - share.mean()) / share.mean()
    assert np.log(ratio) == pytest.approx(usual_brightness(BELOW)[0], abs=0.02)
    above = MANY[:, 2] > 0.3  # what is not hidden is as it was
    alone = LightModel(replace(field, hidden=None), (LAMP,))
    np.testing.assert_allclose(radiance[above], alone.radiance(white, MANY)[above], rtol=1e-3)
    as_a_map = model.radiance(white, MANY.reshape(200, 100, 3))
    np.testing.assert_allclose(as_a_map, radiance.reshape(200, 100, 3), rtol=1e-6)


def test_how_bright_it_is_scatters_as_natural_lights_do(rng):
    field = replace(natural_field(), hidden=BELOW)
    model, white = LightModel(field), 0.3 * rng.normal(size=field.unknowns)
    off = rng.normal(size=2000)
    each = model.whole(np.repeat(white[None], len(off), 0), off)[..., 0].sum(-1)
    none, middle = (model.whole(white, o)[..., 0].sum(-1) for o in (-100.0, 0.0))
    np.testing.assert_allclose((each - none) / (middle - none), np.exp(usual_brightness(BELOW)[1] * off), rtol=1e-6)
