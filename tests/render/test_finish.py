# SPDX-License-Identifier: GPL-3.0-or-later
"""A surface of the homogeneous family as rough and of the colour that the photo says: photos made with such ones."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.model import Lambertian
from btfsep_engine.btf.surfaces import SURFACES, Surface
from btfsep_engine.fit.colour import base_colour, split, tint_of
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.light_account import colour_doubts
from btfsep_engine.pipeline.materials import ObjectMaterial
from btfsep_engine.pipeline.model import Model
from btfsep_engine.pipeline.problem import make_problem
from btfsep_engine.pipeline.refine import finish
from btfsep_engine.pipeline.refine.finish import finished
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.together import fit_together
from btfsep_engine.progress import Reporter
from btfsep_engine.render.homogeneous import homogeneous
from tests.render.scenes import as_mesh, job_of, looking_down, picture, scene_of, with_photo
from tests.render.test_reflectance import WINDOW

SETTINGS = choose("draft", bounces=1, directions=512, appearance="mean", order=2)
PLASTIC, RED = "surface/plastic", (0.5, 0.04, 0.03)


def off(found, true) -> float:
    """Relative, each channel with a free scale: how bright the surface is, and its colour, nobody knows."""
    scaled = (found * true).sum(0) / np.square(found).sum(0) * found
    return float(np.linalg.norm(scaled - true) / np.linalg.norm(true))


def of_ball(surface, name=PLASTIC, light=WINDOW, **changes):
    """A Model with the library's surface of a ball that another made the photo of, its SolvedLight, the true light."""
    scene = scene_of(job_of([as_mesh(trimesh.creation.icosphere(4, radius=0.45))], looking_down()))
    points = scene.points(0, textured=False)
    values = scene.radiance(points, homogeneous(surface, "true"), SHLighting(light), directions=512)[:, 0]
    scene.job = with_photo(scene.job, picture(points, values, noise=0.005))
    made_of = homogeneous(SURFACES[name], name) if name in SURFACES else Lambertian(name, np.full(3, 0.5))
    problems = [make_problem(scene, [made_of], [points.take(np.arange(0, len(points), 2))], SETTINGS)]
    return Model(replace(SETTINGS, **changes), {"mean": problems}), fit_together(problems, SETTINGS), light


@pytest.mark.parametrize("name", [PLASTIC, "surface/matte", "reference/white-diffuse"])
def test_what_is_red_and_glossy_is_found_to_be_and_the_light_with_it(name):
    model, light, true = of_ball(Surface(RED, roughness=0.4), name)
    changed, found, words = finished(model, light)
    assert "a roughness of 0.4 and the base colour 0." in words["finish"]
    before, after = (off(each.fit.coefficients, true[:9]) for each in (light, found))
    assert after < 0.2 and (after < 0.6 * before or name != PLASTIC)
    assert found.fit.evidence > light.fit.evidence + 12
    (material,) = changed.problems[0].materials
    assert changed.departed == {0: material} and material.name == name
    np.testing.assert_allclose(base_colour(material.dye) @ [1, -1, 0], 1 - RED[1] / RED[0], atol=0.06)


def test_between_those_that_are_tried_a_walk_finds_a_better_one():
    """Of a base of 0.2, beside 0.6 and 0.25; a draft does not walk."""
    quick, light, true = of_ball(Surface((0.2,) * 3, roughness=0.3))
    _, drafted, _ = finished(quick, light)
    changed, found, _ = finished(replace(quick, settings=replace(quick.settings, refine="all")), light)
    assert found.fit.evidence > drafted.fit.evidence + 20
    before, after = (off(each.fit.coefficients, true[:9]) for each in (drafted, found))
    assert after < 0.3 * before
    assert changed.problems[0].materials[0].name == PLASTIC


def test_a_walk_stays_among_surfaces_of_its_colour():
    near = finish._beside(Surface((0.8, 0.4, 0.2), roughness=0.25))
    assert [each.roughness for each in near] == [0.35, 0.2, 0.25, 0.25]
    np.testing.assert_allclose(
        [each.base_color for each in near[2:]], [[0.85, 0.425, 0.2125], [0.5714, 0.2857, 0.1429]]
    )
    dark = finish._beside(Surface((0.17, 0.0, 0.17), roughness=1.0))
    assert dark[0].roughness == 1.0 and dark[3].base_color == (0.17, 0.0, 0.17)


@pytest.mark.parametrize(("name", "is_asked"), [("reference/white-diffuse", False), ("surface/matte", True)])
def test_a_reference_is_asked_of_all_pixels_where_a_few_promise_enough(name, is_asked, monkeypatch):
    model, light, _ = of_ball(Surface(RED, roughness=0.4), name)
    needed, _ = finish.FROM_REFERENCE
    monkeypatch.setattr(finish, "FROM_REFERENCE", (needed, np.inf))
    _, found, words = finished(model, light)
    assert (found is not light) is is_asked
    assert ("no plain surface explains" in words["finish"]) is not is_asked


def test_that_the_colour_is_not_known_stays_said_and_stated():
    model, light, _ = of_ball(Surface(RED, roughness=0.4))
    _, found, _ = finished(model, light)
    assert light.fit.tint.unknown > 0.9 and found.fit.tint.unknown > 0.9
    (said,), (undyed,) = colour_doubts(found.fit), colour_doubts(light.fit)
    red, green, blue = (float(n) for n in re.search("reflect ([0-9.]+), ([0-9.]+), ([0-9.]+) times", said).groups())
    assert red > 5 * green and red > 5 * blue and said.partition("reflect")[0] == undyed.partition("reflect")[0]
    before, after = (np.linalg.det(each.fit.tint.covariance) for each in (light, found))
    assert after > 0.9 * before
    np.testing.assert_allclose(found.fit.tint.gain, 1, atol=0.1)  # light and colour agree


def test_a_tint_is_split_alike_wherever_the_colour_was_put():
    level, dye = np.array([1.0, 0.3, 0.2]), np.array([0.8, -0.3])
    left = level / base_colour(dye)  # of the light, where the object has that colour
    whole, part = split(level), split(left, dye)
    np.testing.assert_allclose(part.object_tint, whole.object_tint, atol=1e-9)
    np.testing.assert_allclose(part.covariance, whole.covariance, atol=1e-9)
    np.testing.assert_allclose(tint_of(left * part.gain), tint_of(level * whole.gain), atol=1e-9)


def test_a_grey_surface_gets_its_roughness_and_no_colour():
    model, light, true = of_ball(Surface((0.4, 0.4, 0.4), roughness=0.9))
    changed, found, words = finished(model, light)
    assert words["finish"] == "the surface was taken to have a roughness of 0.9 (by evidence)"
    assert changed.problems[0].materials[0].dye is None
    assert off(found.fit.coefficients, true[:9]) < off(light.fit.coefficients, true[:9])


@pytest.mark.parametrize("name", [PLASTIC, "surface/metal"])
def test_the_librarys_own_surface_stays_as_it_is(name):
    model, light, _ = of_ball(SURFACES[name], name)
    same, found, words = finished(model, light)
    assert same is model and found is light and words["finish"].startswith("as it is in the library")


@pytest.mark.parametrize("roughness", [0.45, 0.6])
def test_a_metal_gets_its_roughness_and_stays_a_metal(roughness):
    copper = Surface((0.95, 0.64, 0.54), roughness=roughness, metallic=1)
    model, light, true = of_ball(copper, "surface/metal")
    changed, found, words = finished(model, light)
    assert words["finish"] == f"the surface was taken to have a roughness of {roughness:g} (by evidence)"
    assert changed.problems[0].materials[0].dye is None
    assert off(found.fit.coefficients, true[:9]) < 0.7 * off(light.fit.coefficients, true[:9])
    assert found.fit.evidence > light.fit.evidence + 12


@pytest.mark.parametrize("name", [PLASTIC, "surface/metal"])
def test_all_are_left_alone_where_nobody_asks(name):
    model, light, _ = of_ball(Surface(RED, roughness=0.4), name, departures="never")
    assert finished(model, light) == (model, light, {})


def test_a_grey_reference_is_no_coloured_one():
    model, light, _ = of_ball(Surface((0.5, 0.5, 0.5), roughness=0.4), "reference/white-diffuse")
    assert light.fit.tint.unknown < 0.5 and finished(model, light) == (model, light, {})


def test_an_estimate_says_it():
    class Library:
        def __contains__(self, name):
            return True

        def load(self, name):
            return homogeneous(SURFACES[name], name)

    model, _, true = of_ball(Surface(RED, roughness=0.4))
    scene = model.problems[0].scene
    scene.reporter = Reporter()
    found = estimate(scene, Library(), SETTINGS, material=PLASTIC)
    assert "a roughness of 0.4 and the base colour" in found.choice["finish"]
    assert off(found.lighting.coefficients[:9], true[:9]) < 0.2
    assert any("the object's colour is not known" in each for each in scene.reporter.warnings)


TEAL = Surface((0.05, 0.35, 0.33), roughness=0.9)


def taken_for(surface, true, *, is_given=False, plain=()):
    """What `finished` makes of a ball of a ``true`` surface that was taken for a library's material of another.

    ``plain`` : what recognition said of plain surfaces, (name, score) each
    """
    model, _, light = of_ball(true)
    felt = homogeneous(surface, "felt/teal")
    (problem,) = model.problems
    problems = [problem.of_materials([felt], SETTINGS)]
    one = ObjectMaterial(
        "felt/teal", felt, is_given, (("felt/teal", 0.6), ("felt/red", 0.4), *plain), likely=("felt/teal",)
    )
    model = replace(model, looks={"mean": problems}, materials=([one],))
    before = fit_together(problems, SETTINGS)
    return model, before, *finished(model, before), light


def test_what_is_recognised_gives_way_to_a_plain_surface_that_explains_far_more():
    model, before, changed, found, words, true = taken_for(TEAL, Surface(RED, roughness=0.4))
    ((one,),) = changed.materials
    assert (one.name, one.unknown, one.likely) == ("surface/plastic", True, ()) and one.record["recognised"]
    assert one.record["surface"]["roughness"] == 0.4 and max(one.record["surface"]["base_color"]) in (0.6, 0.25)
    assert one.record["candidates"][0]["name"] == "felt/teal" and "a roughness of 0.4" in words["finish"]
    assert found.fit.evidence > before.fit.evidence + 12
    assert off(found.fit.coefficients, true[:9]) < min(0.2, 0.8 * off(before.fit.coefficients, true[:9]))
    assert json.loads(json.dumps(one.record))["surface"]["metallic"] == 0
    (said,) = model.reporter.warnings
    assert "none of the library's materials after all" in said and "than the nearest, felt/teal" in said
    assert found.fit.tint.unknown > 0.9


def test_what_is_recognised_rightly_or_given_stays():
    model, before, same, found, words, _ = taken_for(TEAL, TEAL)
    assert same is model and found is before and words["finish"].startswith("as it is in the library")
    model, before, same, found, words, _ = taken_for(TEAL, Surface(RED, roughness=0.4), is_given=True)
    assert same is model and found is before and words == {}


@pytest.mark.parametrize(("score", "is_asked"), [(1e-2, True), (1e-5, False)])
def test_where_recognition_has_seen_a_texture_no_plain_surface_is_asked(score, is_asked):
    model, _, changed, _, words, _ = taken_for(TEAL, Surface(RED, roughness=0.4), plain=(("surface/matte", score),))
    assert (changed is not model) is is_asked
    assert ("recognition rules out" in words["finish"]) is not is_asked


@pytest.mark.parametrize("is_enough", [True, False])
def test_all_pixels_are_asked_where_the_walk_promises_enough(is_enough, monkeypatch):
    model, light, _ = of_ball(Surface((0.2,) * 3, roughness=0.3))
    model = replace(model, settings=replace(model.settings, refine="all"))
    gained = finished(model, light)[1].fit.evidence - light.fit.evidence
    promised = 0.5 if is_enough else 2.0
    monkeypatch.setattr(finish, "PROMISES", promised * gained / finish.OF_FAMILY)  # a few pixels say about as much
    changed, found, words = finished(model, light)
    assert (changed is not model) is (found is not light) is is_enough
    assert ("no plain surface explains" in words["finish"]) is not is_enough


def test_the_light_of_a_coloured_surface_is_elected_with_its_last_colour():
    model, light, _ = of_ball(Surface(RED, roughness=0.4))
    changed, found, _ = finished(model, light)
    anew = fit_together(changed.problems, SETTINGS, beside=light.fit)
    np.testing.assert_array_equal(found.fit.all_coefficients, anew.fit.all_coefficients)


def test_some_plastic_gives_way_for_less_than_what_was_recognised(monkeypatch):
    model, light, true = of_ball(Surface((0.15, 0.15, 0.15), roughness=0.4))
    monkeypatch.setattr(finish, "FAR", np.inf)  # of the library's, and of those alone
    changed, found, words = finished(model, light)
    gain = found.fit.evidence - light.fit.evidence
    assert gain > finish.OF_FAMILY and "a roughness of 0.4" in words["finish"]
    assert changed.departed[0].name == PLASTIC and off(found.fit.coefficients, true[:9]) < off(
        light.fit.coefficients, true[:9]
    )
    monkeypatch.setattr(finish, "OF_FAMILY", gain + 0.1)
    same, as_before, words = finished(model, light)
    assert same is model and as_before is light and "as it is in the library" in words["finish"]


def test_a_texture_counts_as_seen_where_plain_surfaces_are_far_less_likely_than_what_was_recognised():
    felt = Lambertian("felt/teal", np.full(3, 0.3))

    def is_seen(likeliest: float, *plain, **doubt) -> bool:
        return finish._has_texture(ObjectMaterial(felt.name, felt, False, ((felt.name, likeliest), *plain), **doubt))

    rare, likely = (PLASTIC, 1e-5), ("surface/matte", 1e-2)
    assert is_seen(0.9, rare)
    assert not is_seen(0.9, rare, likely) and not is_seen(1e-3, rare)  # by the likeliest of each, whatever its score
    assert not is_seen(0.9)  # nothing is said of plain ones
    assert not is_seen(0.9, rare, unknown=True) and not is_seen(0.9, rare, unknown_score=1.0)  # it only looks like felt


def test_of_several_objects_none_gets_another_surface():
    """A tint is that of all light: it says of none of them what colour it has."""
    balls = [trimesh.creation.icosphere(3, radius=0.3).apply_translation((x, 0, 0)) for x in (-0.35, 0.35)]
    scene = scene_of(job_of([as_mesh(ball) for ball in balls], looking_down()))
    points = [scene.points(i, textured=False) for i in range(2)]
    red, light = homogeneous(Surface(RED, roughness=0.4), "true"), SHLighting(WINDOW)
    each = [picture(some, scene.radiance(some, red, light, directions=256)[:, 0], noise=0.005) for some in points]
    scene.job = with_photo(scene.job, np.sum(each, 0))
    few = [some.take(np.arange(0, len(some), 3)) for some in points]
    problems = [make_problem(scene, [homogeneous(SURFACES[PLASTIC], PLASTIC)] * 2, few, SETTINGS)]
    model, found = Model(SETTINGS, {"mean": problems}), fit_together(problems, SETTINGS)
    assert found.fit.tint.unknown > 0.9 and finished(model, found) == (model, found, {})
