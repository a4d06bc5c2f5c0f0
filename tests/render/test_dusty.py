# SPDX-License-Identifier: GPL-3.0-or-later
"""Dust on things of one given colour: photos made with some, jobs that say nothing of it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine.btf.surfaces import GIVEN, Surface
from btfsep_engine.commands import report
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.refine import dusty
from btfsep_engine.render.homogeneous import homogeneous
from tests.render.given_things import LIGHT, found_of
from tests.render.scenes import egg_and_pebble, job_of, looking_down, off_as_seen, picture, scene_of, with_photo

TEAL = Surface((0.05, 0.35, 0.33), roughness=0.8)
FLOUR = (0.65, 0.6, 0.5)  # neither of the colours that are tried


@pytest.fixture(scope="module")
def photographed():
    """A function (Surface, share) -> the job of an egg and a pebble, from a share of whose steep sides flour lies."""
    scene = scene_of(job_of([egg_and_pebble()], looking_down()))
    points = scene.points(0, region=scene.view.mesh == 0, textured=False)

    def made(surface: Surface, share: float):
        def values(of):
            return scene.radiance(points, homogeneous(of, GIVEN), SHLighting(LIGHT), directions=4096)[:, 0]

        covered = share * np.clip((points.normal[:, 2:] - 0.3) / 0.7, 0, 1)  # another course than the engine's
        under = replace(surface, base_color=FLOUR, metallic=0.0)
        return with_photo(
            scene.job, picture(points, (1 - covered) * values(surface) + covered * values(under), noise=0.02)
        )

    return made


@pytest.fixture(autouse=True)
def all_are_asked(monkeypatch):
    monkeypatch.setattr(dusty, "LEFT", 0.0)


def test_dust_is_found_and_the_light_with_it(photographed):
    job = photographed(TEAL, 0.6)
    found, left = (found_of(job, TEAL, departures=departures) for departures in ("auto", "never"))
    said = found.choice[dusty.DUSTY]
    assert "object 'object 0' has another colour where it faces up" in said and said in found.scene.reporter.warnings
    assert dusty.DUSTY not in left.choice
    right, wrong = (off_as_seen(each.lighting.coefficients, LIGHT) for each in (found, left))
    assert right < 0.3 * wrong and right < 0.25
    assert found.photos[0].residuals[0] < 0.8 * left.photos[0].residuals[0]
    photo = job.photo.radiance
    clean = replace(found, model=replace(found.model, dust={}))
    shown, without = (report.pictures(each, found.scene)[0] for each in (found, clean))
    seen = np.isfinite(shown).all(-1)
    off, much = (np.linalg.norm((each - photo)[seen]) / np.linalg.norm(photo[seen]) for each in (shown, without))
    assert off < 0.1 and off < 0.7 * much


@pytest.mark.parametrize("surface", [TEAL, replace(TEAL, base_color=(0.5, 0.05, 0.04), roughness=0.4)])
def test_of_clean_things_none_is_said(photographed, surface):
    assert dusty.DUSTY not in found_of(photographed(surface, 0.0), surface).choice


@pytest.mark.parametrize("changes", [{"metallic": 1.0}, {"image": np.full((4, 4, 3), 0.3, np.float32)}])
def test_what_is_not_of_one_colour_or_explained_is_not_asked(photographed, monkeypatch, changes):
    monkeypatch.setattr(dusty, "_hopeful", lambda *_: pytest.fail("asked"))
    normals = np.random.default_rng(0).normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    round_thing, box = (
        SimpleNamespace(points=[SimpleNamespace(normal=n)]) for n in (normals, np.eye(3)[[0, 1, 2] * 50])
    )
    model = SimpleNamespace(problems=[round_thing])
    light = SimpleNamespace(share_left=lambda _: 0.5)
    monkeypatch.setattr(dusty, "surface_of", lambda *_: replace(TEAL, **changes))
    assert dusty._with_dust(model, light, 0) is None
    monkeypatch.setattr(dusty, "surface_of", lambda *_: TEAL)
    assert dusty._with_dust(SimpleNamespace(problems=[box]), light, 0) is None
    monkeypatch.setattr(dusty, "LEFT", 0.6)
    assert dusty._with_dust(model, light, 0) is None


def test_dust_lies_on_top_and_has_its_own_colour():
    normals = np.array([[0, 0, 1.0], [1, 0, 0], [0, 0, -1], [0.6, 0, 0.8]])
    factor = dusty.lighter(normals, (0.25, 0.5, 0.0), (0.5, 0.5, 0.5), 0.5)
    np.testing.assert_allclose(factor[0], [1.5, 1.0, 0.5 + 0.5 * 0.5 / dusty.DARKEST])
    np.testing.assert_array_equal(factor[1:3], 1)  # a side, and what faces down
    assert 1 < factor[3, 0] < factor[0, 0]


def test_basis_images_and_a_flashs_are_as_much_brighter_where_dust_lies(photographed):
    found = found_of(photographed(TEAL, 0.0), TEAL)
    (problem,) = found.model.problems
    factor = np.random.default_rng(0).uniform(1, 2, (len(problem.pixels), 3))
    flashed = replace(problem, of_flash=np.ones_like(factor))
    dusted = dusty.on_dust(flashed, factor)
    x = np.random.default_rng(1).normal(size=(9, 3))
    np.testing.assert_allclose(dusted.predicted(x), factor * problem.predicted(x), rtol=1e-4, atol=1e-5)
    np.testing.assert_array_equal(dusted.of_flash, factor)
    np.testing.assert_array_equal(dusted.radiance(), problem.radiance())
