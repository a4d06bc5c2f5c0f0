# SPDX-License-Identifier: GPL-3.0-or-later
"""How rough an object of given numbers is: photos made with one roughness, jobs that say another."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import GIVEN, Surface
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.materials import of_surface
from btfsep_engine.pipeline.refine import given, roughness
from btfsep_engine.render.homogeneous import homogeneous
from tests.render.given_things import LIGHT, SETTINGS, found_of, photo_maker
from tests.render.scenes import egg_and_pebble, job_of, looking_down, off_as_seen, picture, scene_of, with_photo

CLAY = Surface((0.5, 0.3, 0.2), roughness=0.9)


@pytest.fixture(scope="module")
def photographed():
    return photo_maker()


@pytest.mark.parametrize(("true", "said"), [(0.9, 0.5), (0.35, 0.8)])
def test_a_roughness_that_is_said_wrong_is_found_and_the_light_with_it(photographed, true, said):
    job = photographed(replace(CLAY, roughness=true))
    found, left = (
        found_of(job, replace(CLAY, roughness=said), departures=departures) for departures in ("auto", "never")
    )
    taken = found.materials[0].surface.roughness
    assert abs(taken - true) <= 0.16 and replace(found.materials[0].surface, roughness=0.9) == CLAY
    assert f"to have a roughness of {taken:.2f}, where its surface says {said:.2f}" in found.choice[roughness.OTHERWISE]
    assert found.choice[roughness.OTHERWISE] in found.scene.reporter.warnings
    assert found.model.departed[0].surface.roughness == taken == found.model.problems[0].materials[0].surface.roughness
    assert left.materials[0].surface is None and not {roughness.ROUGHNESS, roughness.OTHERWISE} & set(left.choice)
    assert found.fit.evidence > left.fit.evidence + roughness.CLEARLY
    wrong, right = (off_as_seen(each.lighting.coefficients, LIGHT) for each in (left, found))
    assert right < 0.6 * wrong


def test_of_an_object_with_an_image_of_its_colours_it_is_found_too():
    mesh = egg_and_pebble(3)
    mesh = replace(mesh, corner_uv=((mesh.vertices[:, :2] + 1) / 2.2)[mesh.faces])
    stripes = np.where(np.arange(64)[:, None] % 2, 1.0, 0.7) * np.array(CLAY.base_color)
    painted = replace(CLAY, image=np.broadcast_to(stripes, (64, 64, 3)).astype(np.float32))
    job = job_of([mesh], looking_down())
    job = replace(job, objects=(replace(job.objects[0], surface=painted, uv="mesh"),))
    scene = scene_of(job)
    points = scene.points(0, region=scene.view.mesh == 0, textured=True)
    material = of_surface(job.objects[0], job, SETTINGS)
    values = scene.radiance(points, material, SHLighting(LIGHT), directions=4096)[:, 0]
    job = with_photo(job, picture(points, values, noise=0.02))
    found = found_of(job, replace(painted, roughness=0.5))
    assert found.materials[0].surface.roughness >= 0.7 and found.materials[0].surface.image is painted.image
    assert off_as_seen(found.lighting.coefficients, LIGHT) < 0.03


@pytest.fixture(scope="module")
def said_right(photographed):
    """The estimate of a thing of the roughness that its job says."""
    return found_of(photographed(CLAY), CLAY)


def test_a_roughness_that_is_said_right_stays(said_right):
    found = said_right
    assert (
        not {roughness.ROUGHNESS, roughness.OTHERWISE} & set(found.choice)
        and found.materials[0].surface is None
        and not found.model.departed
    )


def test_a_roughness_near_what_is_said_is_no_doubt(photographed, monkeypatch):
    monkeypatch.setattr(roughness, "USUAL", 0.5)
    found = found_of(photographed(CLAY), replace(CLAY, roughness=0.5))
    assert found.choice["roughness"] not in found.scene.reporter.warnings and roughness.OTHERWISE not in found.choice


def test_what_explains_little_more_is_not_believed(photographed, monkeypatch):
    monkeypatch.setattr(roughness, "CLEARLY", np.inf)
    found = found_of(photographed(CLAY), replace(CLAY, roughness=0.5))
    assert not {roughness.ROUGHNESS, roughness.OTHERWISE} & set(found.choice) and not found.model.departed


def test_of_an_object_of_several_finishes_and_of_a_material_of_the_library_nothing_is_asked(photographed, monkeypatch):
    monkeypatch.setattr(roughness, "_hopeful", lambda *_: pytest.fail("asked"))
    finish = np.full((4, 4, 3), (0.5, 0.0, 0.5), np.float32)
    finish[:2, :, 0] = 0.3
    job = photographed(CLAY)
    estimate(scene_of(job), open_library(None), SETTINGS, material="reference/white-diffuse")
    found_of(job, replace(CLAY, roughness=0.5, finish=finish))


def test_on_a_few_pixels_another_surface_is_lit_as_on_all(said_right):
    """Light between surfaces aside, which stays what it was."""
    (problem,) = said_right.model.problems
    other = homogeneous(replace(CLAY, roughness=0.3), GIVEN)
    lit, made = given.relit(problem, 0, other, SETTINGS), problem.of_materials([other], SETTINGS)
    np.testing.assert_allclose(lit.basis[0], made.basis[0], atol=1e-5)
    assert lit.materials == [other] and not np.allclose(lit.basis[0], problem.basis[0], atol=1e-3)


def test_steps_go_on_while_they_gain_and_end_at_what_tables_hold(photographed, monkeypatch):
    found = found_of(photographed(CLAY), replace(CLAY, roughness=0.5), departures="never")
    monkeypatch.setattr(roughness, "_log_prior", lambda rough, said: -100 * abs(rough - 0.92))
    rough = roughness._hopeful(found.model, found.light, 0, 0.5)
    assert rough in (pytest.approx(0.95), 1.0)
    assert [roughness._clipped(r) for r in (-1, 0.1, 0.4, 2)] == [0.1, 0.1, 0.4, 1.0]


@pytest.fixture(scope="module")
def as_said(photographed):
    """Model and light of a thing whose roughness is said to be 0.8, and left so."""
    found = found_of(photographed(CLAY), replace(CLAY, roughness=0.8), departures="never")
    return found.model, found.light


def test_evidence_alone_makes_nothing_rougher(as_said, monkeypatch):
    """A light that is plainer is worth evidence, though it explains less of the photo."""
    model, light = as_said
    monkeypatch.setattr(roughness, "_hopeful", lambda *_: 0.9)

    def taken(grown: float):
        """Where all pixels give an answer that has much evidence, and leaves ``grown`` times as much over."""
        share = grown * light.share_left(model.problems)
        other = SimpleNamespace(fit=SimpleNamespace(evidence=light.fit.evidence + 1000), share_left=lambda _: share)
        monkeypatch.setattr(roughness, "on_all", lambda *_: (model, other))
        return roughness._rougher_or_smoother(model, light, 0, 0.8)

    assert taken(1.02) is None
    assert taken(1.0)[2] == 0.9 and taken(0.5)[2] == 0.9


def test_the_further_from_what_is_said_the_more_evidence_is_needed(as_said, monkeypatch):
    model, light = as_said
    share = light.share_left(model.problems)

    def is_taken(rough: float, gained: float) -> bool:
        other = SimpleNamespace(fit=SimpleNamespace(evidence=light.fit.evidence + gained), share_left=lambda _: share)
        monkeypatch.setattr(roughness, "_hopeful", lambda *_: rough)
        monkeypatch.setattr(roughness, "on_all", lambda *_: (model, other))
        return roughness._rougher_or_smoother(model, light, 0, 0.8) is not None

    far = roughness.CLEARLY + 0.5 * (0.4 / roughness.USUAL) ** 2  # of a normal distribution about what is said
    assert not is_taken(0.4, far - 0.1) and is_taken(0.4, far + 0.1)
    assert is_taken(0.75, far - 0.1) and not is_taken(0.75, roughness.CLEARLY - 0.1)


def test_a_gloss_of_a_photo_that_is_explained_becomes_no_rougher(photographed, monkeypatch):
    found = found_of(photographed(CLAY), replace(CLAY, roughness=0.2), departures="never")
    monkeypatch.setattr(roughness, "_log_prior", lambda rough, said: -1000 * abs(rough - 0.5))
    hopeful = {}
    for left in (0.09, 0.11):
        monkeypatch.setattr(type(found.light), "share_left", lambda self, _, left=left: left)
        hopeful[left] = [roughness._hopeful(found.model, found.light, 0, rough) for rough in (0.2, 0.36)]
    assert hopeful[0.09][0] is None and hopeful[0.11][0] == pytest.approx(0.5)
    assert hopeful[0.09][1] == hopeful[0.11][1] == pytest.approx(0.51)
