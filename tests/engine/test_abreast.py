# SPDX-License-Identifier: GPL-3.0-or-later
"""Many lights at once are those that are found one by one, by other loops and other arrays."""

from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine.fit.abreast import near_lights, solve_abreast
from btfsep_engine.fit.election import rough_light
from btfsep_engine.fit.light_model import LightModel
from btfsep_engine.fit.products import Basis, Photograph
from btfsep_engine.fit.search import STEPS, solve
from btfsep_engine.light.log_field import natural_field
from btfsep_engine.pipeline import verification
from btfsep_engine.pipeline.verification import NEARBY, Verification, lights_from
from tests.engine.half_sphere import SUN, even, half_sphere, lamp, shown, side_light


@pytest.fixture
def photos(rng) -> list[Photograph]:
    """Three photographs, each of other pixels and of another light, with misfits; one shows little more than noise."""
    out = []
    for pixels, light, noise in (
        (300, side_light(), 0.05),
        (150, even() + lamp(SUN, (6, 4, 2)), 0.02),
        (40, even(), 0.8),
    ):
        basis, normals, _ = half_sphere(rng, pixels=pixels)
        out.append(Photograph(Basis(basis, normals), shown(basis, light, rng, noise), effective=1.5))
        rough_light(out[-1])
    return out


def same(found, wanted) -> None:
    assert found.evidence == pytest.approx(wanted.evidence, abs=0.1)  # where a search stops, rounding has a say
    assert abs(found.steps - wanted.steps) <= 1
    np.testing.assert_allclose(found.x, wanted.x, atol=5e-3 * np.abs(wanted.x).max())
    np.testing.assert_allclose(found.v, wanted.v, rtol=5e-3)
    assert found.slopes.shape == wanted.slopes.shape and found.small_factor.shape == wanted.small_factor.shape
    of_found, of_wanted = (each.slopes.T @ each.slopes for each in (found, wanted))  # in whatever order rows are
    assert np.linalg.norm(of_found - of_wanted) < 0.02 * np.linalg.norm(of_wanted)
    np.testing.assert_allclose(found.radiance.mean(1), wanted.radiance.mean(1), rtol=5e-3)


def test_lights_that_are_sought_together_are_those_of_each_alone(photos):
    model = LightModel(natural_field())
    together = solve_abreast(photos, model, white=np.zeros(model.unknowns))
    for photo, found in zip(photos, together, strict=True):
        same(found, solve(photo, model))
    assert len({found.steps for found in together}) > 1  # or that one waits for none is not tried


def test_each_search_begins_where_it_is_told_and_ends_by_its_own_rounds(photos, rng):
    model = LightModel(natural_field())
    white, v = 0.5 * rng.normal(size=(3, model.unknowns)), rng.uniform(0.01, 0.5, (3, 3))
    for found, photo, *start in zip(
        solve_abreast(photos, model, white=white, v=v, steps=(STEPS, STEPS)), photos, white, v, strict=True
    ):
        same(found, solve(photo, model, white=start[0], v=start[1], rounds=2))


def test_some_steps_from_another_basis_lead_as_far_as_a_search_of_so_many(photos):
    other = solve(photos[0], LightModel(natural_field()))
    white, v, x = near_lights(photos[1:], other, 2)
    for i, photo in enumerate(photos[1:]):
        wanted = solve(photo, other.model, white=other.white, v=other.v, rounds=1, steps=2)
        np.testing.assert_allclose(white[i], wanted.white, atol=2e-3 * np.abs(wanted.white).max())
        np.testing.assert_allclose(x[i], wanted.x, atol=2e-3 * np.abs(wanted.x).max())
        np.testing.assert_allclose(v[i], wanted.v)


def test_of_a_plain_kind_the_likelier_stands():
    rough, smooth = (SimpleNamespace(evidence=value, colour=np.ones(3)) for value in (-5.0, -3.0))
    kind = Verification.plain(None, "surface/metal", [("rough", rough), ("smooth", smooth)], None, None)
    assert (kind.material, kind.explained, kind.evidence) == ("smooth", smooth, -3.0)


def test_candidates_lights_are_those_that_are_found_one_after_the_other(photos, rng, monkeypatch):
    """Each candidate's misfit goes by its own light, a few steps from the first one's."""
    monkeypatch.setattr(verification, "SEARCHED", (STEPS, STEPS))
    other, candidates = solve(photos[0], LightModel(natural_field())), []
    for gloss in (0.1, 0.6):
        basis, normals, _ = half_sphere(rng, pixels=300, gloss=gloss)
        candidates.append(Photograph(Basis(basis, normals), shown(basis, side_light(), rng, 0.05), effective=1.5))
    for photo, found in zip(candidates, lights_from(other, candidates), strict=True):
        near = solve(photo, other.model, white=other.white, v=other.v, rounds=1, steps=NEARBY)
        photo.learn_from(near.x)
        wanted = solve(photo, other.model, white=near.white, v=near.v, rounds=2)
        assert found.evidence == pytest.approx(wanted.evidence, abs=0.1)
        np.testing.assert_allclose(found.x, wanted.x, atol=0.01 * np.abs(wanted.x).max())
    assert lights_from(other, []) == []
