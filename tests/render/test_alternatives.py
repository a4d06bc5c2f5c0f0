# SPDX-License-Identifier: GPL-3.0-or-later
"""A photo that fits two materials: the light is fitted with both, and what is stated covers both."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import REFERENCE
from btfsep_engine.btf.model import Lambertian
from btfsep_engine.commands.record import result_record
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline import recognition
from btfsep_engine.pipeline.alternatives import alternatives, combinations, mixture
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.materials import ObjectMaterial
from btfsep_engine.pipeline.model import first_model, solve_model
from btfsep_engine.pipeline.refine.look_alike import GUESSED
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.recognise.recogniser import Recognition
from btfsep_engine.storage.atomic import plain
from tests.render.scenes import as_mesh, job_of, looking_down, picture, positive_light, scene_of, with_photo

SETTINGS = choose("draft", bounces=1, directions=128, appearance="mean", order=2)
DARK = Lambertian("test/dark", np.full(3, 0.1))
SHINY = REFERENCE["reference/chrome"]
KNOWN = {"test/dark": DARK, "test/grey": Lambertian("test/grey", np.full(3, 0.4)), SHINY.name: SHINY}
BOTH = (("test/grey", 0.6), ("test/dark", 0.38), (SHINY.name, 0.02))


class Shelf:
    """A library of these."""

    def load(self, name):
        return KNOWN[name]


@pytest.fixture(scope="module")
def scene():
    """A dark ball."""
    ball = as_mesh(trimesh.creation.icosphere(subdivisions=4, radius=0.9))
    made = scene_of(job_of([ball], looking_down()))
    points = made.points(0, textured=False)
    values = made.radiance(points, DARK, SHLighting(positive_light(2)), directions=512)[:, 0]
    made.job = with_photo(made.job, picture(points, values, noise=0.02, seed=3))
    return made


def unsure(likely) -> ObjectMaterial:
    return ObjectMaterial(BOTH[0][0], KNOWN[BOTH[0][0]], False, BOTH, False, 0.5, likely)


def test_the_combinations_of_several_objects_begin_with_what_was_chosen():
    sure, two = unsure(("test/grey",)), unsure(("test/grey", "test/dark"))
    assert combinations([sure]) == [(("test/grey",), 1.0)]
    found = combinations([two, replace(two, likely=None), two])
    assert [names[1] for names, _ in found] == ["test/grey"] * 4 and found[0][0] == ("test/grey",) * 3
    assert [p for _, p in found] == pytest.approx(np.array([0.36, 0.228, 0.228, 0.1444]) / 0.9604)
    rare = replace(two, likely=("test/grey", SHINY.name))
    assert combinations([rare]) == [(("test/grey",), 1.0)]  # 3 % of the other: it would change nothing


def test_each_alternative_is_the_fit_with_its_material_and_the_mixture_covers_all(scene):
    model, light, _ = solve_model(first_model([scene], [[unsure(("test/grey", "test/dark"))]], SETTINGS))
    found = alternatives(model, light, Shelf())
    assert [a.names for a in found] == [("test/grey",), ("test/dark",)] and found[0].light is light
    assert sum(a.probability for a in found) == pytest.approx(1)
    known = ObjectMaterial("test/dark", DARK, True)
    _, as_dark, _ = solve_model(first_model([scene], [[known]], SETTINGS))
    one, other = found[0].light.fit, found[1].light.fit
    np.testing.assert_allclose(other.coefficients, as_dark.fit.coefficients, rtol=1e-6)
    both = mixture(found)
    np.testing.assert_array_equal(both.coefficients, one.coefficients)
    assert len(both.samples) == len(one.samples)
    share = (both.samples[:, 0].mean(1) > 0.5 * other.coefficients[0].mean()).mean()
    assert share == pytest.approx(0.38 / 0.98, abs=0.1)  # of the samples are lights as a dark ball asks for
    for fit in (one, other):
        mean = fit.coefficients[0]
        assert (both.interval[0][0] < mean).all() and (mean < both.interval[1][0]).all()
    np.testing.assert_array_equal(both.determined, one.determined)  # the two differ in how much they reflect alone
    truth = positive_light(2)[0]
    inside = [((f.interval[0][0] < truth) & (truth < f.interval[1][0])).sum() for f in (one, both)]
    assert inside == [0, 3]  # grey was wrong by more than it knew


def test_one_material_is_no_mixture(scene):
    for likely in (("test/grey",), None, ()):
        model, light, _ = solve_model(first_model([scene], [[unsure(likely)]], SETTINGS))
        assert alternatives(model, light, Shelf()) == []


def test_an_estimate_says_between_what_it_could_not_decide(scene, monkeypatch):
    answer = Recognition(BOTH[0][0], BOTH, False, 0.5, ("test/grey", "test/dark"))
    monkeypatch.setattr(recognition, "recognise_object", lambda *_: answer)
    found = estimate(scene, Shelf(), SETTINGS)
    record = plain(result_record(found))
    assert record["objects"][0]["likely"] == ["test/grey", "test/dark"]
    assert "test/grey (61 %) or test/dark (39 %)" in record["choice"]["materials"]
    assert (found.lighting.stddev[0] > 1.5 * found.light.fit.stddev[0]).all()
    assert found.photos[0].residuals[0] == pytest.approx(found.light.fit.residual, rel=0.01)  # of one material's fit


def test_where_none_may_be_what_the_photo_shows_every_alternative_is_known_as_little(scene):
    """Of a texture that looks like nothing of the library no light is stated to be surer than another."""
    two = unsure(("test/grey", "test/dark"))
    model, light, _ = solve_model(first_model([scene], [[two]], SETTINGS))
    textured = model.changed(lambda p: replace(p, around=np.full((len(p.pixels), 1, 2), -1, np.int32)))
    known, strange = (
        alternatives(replace(textured, materials=[[replace(two, unknown_score=score)]]), light, Shelf())[1].light.fit
        for score in (0.0, 1.0)
    )
    np.testing.assert_array_equal(strange.coefficients, known.coefficients)
    np.testing.assert_allclose(np.ptp(strange.interval, 0), GUESSED * np.ptp(known.interval, 0), rtol=1e-6)
