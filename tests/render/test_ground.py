# SPDX-License-Identifier: GPL-3.0-or-later
"""A table that the photo shows, as evidence: asked for by the job or the settings, its colour by its own pixels."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh

from btfsep_engine import sh
from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.conventions import fibonacci_sphere, pixel_directions, pixel_solid_angles
from btfsep_engine.fit.ground import SKY, WithGround
from btfsep_engine.fit.log_normal import LightSolver
from btfsep_engine.fit.stated import shown_error
from btfsep_engine.job.model import Occluder
from btfsep_engine.pipeline import ground_places
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.ground_places import places_of, tried_as_evidence, used_as_evidence
from btfsep_engine.pipeline.refine import ground
from btfsep_engine.pipeline.refine.seen_colour import AGREE, seen_colours, seen_places
from btfsep_engine.pipeline.settings import choose
from tests.render.scenes import as_mesh, ball, job_of, looking_down, positive_light, scene_of, with_photo

COLOUR = np.array([0.7, 0.3, 0.1])
LIGHT = positive_light(2)
DARK = Surface((0.05,) * 3, roughness=1.0, specular=0.0)  # a ball that sends next to nothing to the table


@cache
def _photographed():
    """The job of a dark ball on a table of `COLOUR` under `LIGHT`, seen from above: direct light alone."""
    plate = trimesh.creation.box([6, 6, 0.02]).apply_translation([0, 0, -1.02])
    job = job_of([ball()], looking_down(), occluders=[Occluder(as_mesh(plate, flat=True), None)])
    job = replace(job, objects=tuple(replace(o, surface=DARK) for o in job.objects))
    scene, image = scene_of(job), np.zeros((96, 96, 3), np.float32)
    rays = fibonacci_sphere(4000)
    sky = sh.series(LIGHT, rays) * (4 / 4000)
    for number, albedo in ((0, np.full(3, 0.05)), (1, COLOUR)):
        rows, columns = np.nonzero(scene.view.mesh == number)
        origins, directions = job.camera.rays(columns + 0.5, rows + 0.5)
        at = origins + scene.view.distance[rows, columns, None] * directions
        normal = at / np.linalg.norm(at, axis=1, keepdims=True) if number == 0 else np.tile([0, 0, 1.0], (len(at), 1))
        seen = scene.tracer.visible(at, normal, rays) * np.maximum(normal @ rays.T, 0)
        image[rows, columns] = albedo * (seen @ sky)
    return with_photo(job, image)


def photographed(*, evidence: bool):
    """The same job, which asks for its table as evidence or does not."""
    job = _photographed()
    return replace(job, occluders=tuple(replace(o, evidence=evidence) for o in job.occluders))


def estimated(job, **told):
    return estimate(scene_of(job), open_library(None), choose("draft", pixels=500, **told))


@cache
def plainly():
    """The estimate of a job that does not ask for its table."""
    return estimated(photographed(evidence=False))


def test_what_is_not_known_of_the_table_its_pixels_say():
    found = estimated(photographed(evidence=True))
    assert found.choice["ground"].startswith("used as evidence")
    problem = found.model.problems[0]
    ((colour, left),) = seen_colours(problem, seen_places(found.scene), LIGHT, found.settings).values()
    np.testing.assert_allclose(colour, COLOUR, rtol=0.03)
    scene = found.scene.with_colours({0: colour})
    assert np.array_equal(scene.occluder_albedos[0], colour) and not scene.has_unknown and found.scene.has_unknown
    assert left < 0.03


def test_a_ground_of_many_colours_is_left_out():
    job = photographed(evidence=True)
    image = job.photo.radiance * np.where(np.indices((96, 96)).sum(0)[..., None] // 24 % 2, 1, 0.2).astype(np.float32)
    image = np.where((scene_of(job).view.mesh == 1)[..., None], image, job.photo.radiance)
    found = estimated(replace(job, photo=replace(job.photo, radiance=image)))
    assert found.choice["ground"].startswith("not used as evidence: it is not of one colour")
    assert found.light.alone is None and found.fit.all_coefficients.shape == (100, 3)
    ((_, left),) = seen_colours(found.model.problems[0], seen_places(found.scene), LIGHT, found.settings).values()
    assert left > 2 * AGREE


def test_it_is_asked_for_and_else_changes_nothing():
    asked, not_asked = (photographed(evidence=e) for e in (True, False))
    never, plain = estimated(asked, evidence="never"), plainly()
    assert "ground" not in never.choice and "ground" not in plain.choice
    assert np.array_equal(never.fit.samples, plain.fit.samples) and not plain.scene.colours
    assert used_as_evidence(not_asked, choose(evidence="all")) == [0]


def by_itself(job, **told):
    """The estimate of a job that asks for no ground, with all refinements."""
    return estimate(scene_of(job), open_library(None), choose("balanced", pixels=500, align="never", **told))


@cache
def without_table(told=None):
    """The same by the ball alone; ``told`` : the table's surface, as the job has it."""
    job = photographed(evidence=False)
    return by_itself(replace(job, occluders=tuple(replace(o, surface=told) for o in job.occluders)), evidence="job")


def test_a_plain_table_is_evidence_unasked_and_in_full_where_the_light_explains_all_of_it(monkeypatch):
    job = photographed(evidence=False)
    monkeypatch.setattr(WithGround, "alike", lambda *_: 1e9)  # nobody asks
    found, without = by_itself(job), without_table()
    assert found.choice["ground"].endswith("% (its colour is free)") and found.light.alone is not None
    assert "ground" not in without.choice and without.light.alone is None
    assert np.array_equal(found.light.alone.all_coefficients, without.fit.all_coefficients)
    scene, auto = scene_of(job), choose("balanced")
    assert tried_as_evidence(scene, auto) == [0] and tried_as_evidence(scene, choose("draft")) == []
    assert [tried_as_evidence(scene, choose("balanced", evidence=e)) for e in ("job", "all", "never")] == [[]] * 3


def test_of_what_nobody_asks_for_the_plain_one_that_is_seen_most_is_tried():
    job = photographed(evidence=False)
    far = Occluder(as_mesh(trimesh.creation.box([0.1, 0.1, 0.1]).apply_translation([2, 0, -0.95])), None)
    (table,) = job.occluders
    both = replace(job, occluders=(far, table))
    assert tried_as_evidence(scene_of(both), choose("balanced")) == [1]
    image = Surface(image=np.ones((2, 2, 3), np.float32))
    for surface, tried in ((image, 1), (Surface(metallic=1.0), 0), (Surface(coat=0.5), 0)):
        other = replace(both, occluders=(far, replace(table, surface=surface)))
        assert tried_as_evidence(scene_of(other), choose("balanced")) == [tried]
    stripes = Surface(image=np.array([[COLOUR, COLOUR / 2]] * 2, np.float32), roughness=0.3)
    looks = ground.looks_of(scene_of(replace(job, occluders=(replace(table, surface=stripes),))), 0)
    assert set(looks) == {ground.MATTE, ground.SATIN, 0.3}
    for look in (ground.SATIN, 0.3):
        assert looks[look].base_color == pytest.approx(0.75 * COLOUR) and looks[look].image is None


def striped(job):
    """The job with shadows on its table of things that it does not know: stripes a third of the picture apart."""
    band = 1 - 0.3 * (np.indices((96, 96))[1] % 32 < 8)[..., None].astype(np.float32)
    image = np.where((scene_of(job).view.mesh == 1)[..., None], band * job.photo.radiance, job.photo.radiance)
    return replace(job, photo=replace(job.photo, radiance=image))


def _off(found, true) -> float:
    """The relative error of what the photo shows, up to order 2, with one free scale."""
    x = found.fit.shown[:9]
    return float(np.linalg.norm(x * ((x * true).sum() / np.square(x).sum()) - true) / np.linalg.norm(true))


def test_a_table_that_shows_more_than_the_light_counts_for_less(monkeypatch):
    job, true = striped(photographed(evidence=False)), LIGHT[:9]
    found, without = by_itself(job), by_itself(job, evidence="job")
    monkeypatch.setattr(WithGround, "alike", lambda *_: 1.0)
    full = by_itself(job)
    assert found.choice["ground"].startswith("used as evidence") and found.light.alone is not None
    assert "places count as one" in found.choice["ground"] and "differs by" in found.choice["ground"]
    assert "places count as one" not in full.choice["ground"]
    error, of_full, of_none = (_off(each, true) for each in (found, full, without))
    assert error < 0.5 * of_full and error < 1.2 * of_none
    states, of_none = (shown_error(each.fit)["order_2"]["median"] for each in (found, without))
    assert states > 1.3 * of_none  # nobody knows that these are stripes


def test_a_table_that_speaks_against_the_objects_is_left_out(monkeypatch):
    job = photographed(evidence=False)
    monkeypatch.setattr(ground, "WORSE", 0.0)
    found, without = by_itself(job), without_table()
    assert found.choice["ground"].startswith("not used as evidence: it speaks against the objects")
    assert np.array_equal(found.fit.all_coefficients, without.fit.all_coefficients) and found.light.alone is None
    assert not any("does not go with the objects" in said for said in found.scene.reporter.warnings)


@pytest.mark.parametrize("told", [Surface((0.3,) * 3, 0.5), Surface((0.3,) * 3, 1.0, specular=0.0), None])
@pytest.mark.parametrize("glossy", [True, False])
def test_whether_a_ground_is_glossy_the_photo_says_and_not_the_job(told, glossy):
    """A table that shows what its own response makes of the light: matte, or as satin as a new Blender material."""
    found = without_table(told)
    problems, light, settings = found.model.problems, found.light, found.settings
    (matte, satin, *_) = ground.grounds_of(problems, light.exposures, settings, [[0]])
    assert len(ground.looks_of(problems[0].scene, 0)) == 2 and matte.response.shape == satin.response.shape
    sky = sh.series(LIGHT, pixel_directions(*SKY).reshape(-1, 3))
    sky = sky * np.repeat(pixel_solid_angles(*SKY), SKY[1])[:, None]
    shown = np.einsum("pnc,nc->pc", (satin if glossy else matte).response, sky)
    each = [replace(g, radiance=shown) for g in (matte, satin)]
    of = light.radiance(problems), light.fit
    assert int(np.argmax([light.solver.ground_evidence(*of, g) for g in each])) == glossy


def test_what_is_stated_is_as_much_as_a_table_that_is_left_out_speaks_for_another_light():
    light = without_table().light
    x, stated = light.fit.shown, shown_error(light.fit)["order_2"]["median"]
    assert ground._disagreed(light, replace(light.fit, seen=1.7 * x)) == (light, "")  # its brightness is not known
    other = x.copy()
    other[1] += 2 * stated * np.linalg.norm(x[:9], axis=0)
    wider, words = ground._disagreed(light, replace(light.fit, seen=other))
    assert shown_error(wider.fit)["order_2"]["median"] == pytest.approx(2 * stated, rel=0.25) and "differs by" in words
    assert np.array_equal(wider.fit.shown, x)


def test_places_are_means_of_blocks_of_what_shows_the_table(monkeypatch):
    job = photographed(evidence=True)
    scene = scene_of(job)
    points, radiance = places_of(scene, 0)
    assert 250 < len(points) < 900 and (points.position[:, 2] == pytest.approx(-1.01, abs=1e-6))
    here = job.photo.radiance[tuple(points.pixels.T)]
    assert np.abs(radiance / here - 1).mean() < 0.03
    monkeypatch.setattr(ground_places, "ENOUGH", 2)  # as of a large photo: not all pixels are read
    fewer, sparse = places_of(scene, 0)
    assert 200 < len(fewer) < 900 and sparse.mean(0) == pytest.approx(radiance.mean(0), rel=0.02)
    hidden = replace(job, photo=replace(job.photo, usable=scene.view.mesh == 0))
    assert places_of(scene_of(hidden), 0) is None


def test_light_of_any_strength_that_reaches_nothing_is_not_believed(monkeypatch):
    beside = LightSolver.beside_ground

    def run_away(solver, *given, **more):
        fit = beside(solver, *given, **more)
        return replace(fit, all_coefficients=4 * fit.all_coefficients)

    plain = plainly()
    monkeypatch.setattr(LightSolver, "beside_ground", run_away)
    found = estimated(photographed(evidence=True))
    assert found.choice["ground"].startswith("not used as evidence: its light would be 4 times")
    assert np.array_equal(found.fit.all_coefficients, plain.fit.all_coefficients) and found.light.alone is None


def test_a_light_farther_from_the_objects_own_than_was_expected_is_stated_wider(monkeypatch):
    job = photographed(evidence=False)
    found = by_itself(job)
    assert found.choice["ground"].endswith("(its colour is free)")
    expected = shown_error(found.light.alone)["order_2"]["median"]

    def where_it_lies(apart: float, far: float):
        monkeypatch.setattr(ground, "_apart", lambda *_: apart)
        monkeypatch.setattr(ground, "FAR", far)
        return by_itself(job)

    surprising = where_it_lies(2.5 * expected, expected)
    assert f"differs by {250 * expected:.0f} %" in surprising.choice["ground"]
    before, stated = (shown_error(each.fit)["order_2"]["median"] for each in (found, surprising))
    assert min(2.5 * expected, 4 * before) == pytest.approx(stated, rel=0.15)
    for usual in ((1.5 * expected, expected), (2.5 * expected, 3 * expected)):
        assert "differs by" not in where_it_lies(*usual).choice["ground"]
