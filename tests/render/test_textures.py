# SPDX-License-Identifier: GPL-3.0-or-later
"""A BTF's texture in the fit: taken where the photo shows it in its place, and what stands for it where it does not."""

from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine.btf.library import open_library
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.materials import materials_of_all
from btfsep_engine.pipeline.model import first_model
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.render.surface import as_gathered
from tests.render.scenes import egg_and_pebble, job_of, looking_down, off_as_seen, picture, scene_of, with_photo

SETTINGS = choose("draft", bounces=1, order=2, align="never")
LEATHER = "leather/brown-grain"
LIGHT = np.zeros((9, 3))
LIGHT[0], LIGHT[1], LIGHT[2], LIGHT[3], LIGHT[6] = 3.0, 0.9, 1.2, -1.1, 0.5
SIZE = 192


def photographed(material, *, noise=0.02):
    """A scene of leather whose mesh has a UV map, photographed in ``material``."""
    mesh = egg_and_pebble(5)
    mesh = replace(mesh, corner_uv=mesh.vertices[:, :2][mesh.faces])
    job = job_of([mesh], looking_down(SIZE, 400.0))
    job = replace(job, objects=(replace(job.objects[0], uv="mesh"),))
    scene = scene_of(job)
    points = as_gathered(scene.points(0, region=scene.view.mesh == 0, textured=True))
    values = scene.radiance(points, material, SHLighting(LIGHT), directions=256)[:, 0]
    return scene_of(with_photo(job, picture(points, values, size=SIZE, noise=noise)))


@pytest.fixture(scope="module")
def leather():
    return open_library(None).load(LEATHER)


@pytest.fixture(scope="module")
def elsewhere(leather):
    """The same, its texels in other places."""
    return photographed(replace(leather, texels=np.roll(leather.texels, (31, 17), (0, 1))))


def light_of(scene, **settings):
    return estimate(scene, open_library(None), replace(SETTINGS, **settings), material=LEATHER)


def test_a_texture_that_lines_up_is_taken_and_tells_more_of_the_light(leather):
    scene = photographed(leather)
    found, without = light_of(scene), light_of(scene, appearance="mean")
    assert found.model.appearance == "textured" and found.choice["appearance"].startswith("with the texture")
    assert "pixels" not in found.choice and "the mean of up to 25" in without.choice["pixels"]
    np.testing.assert_array_equal(
        found.model.problems[0].radiance(), found.model.problems[0].values_of(scene.job.photo.radiance)
    )
    off, other = (off_as_seen(each.fit.coefficients, LIGHT) for each in (found, without))
    assert off < 0.6 * other
    assert found.photos[0].residuals[0] < 0.05


def test_one_that_does_not_is_left_out_and_the_light_is_that_of_means_of_like_pixels(elsewhere):
    found, without = light_of(elsewhere), light_of(elsewhere, appearance="mean")
    assert found.model.appearance == "mean" and found.model.untried is None
    assert found.choice["appearance"].startswith("without the texture")
    assert found.choice["pixels"] == without.choice["pixels"]
    # but for how the mean ABRDF is turned, which the texture's place says
    np.testing.assert_allclose(found.fit.coefficients, without.fit.coefficients, atol=0.03)
    asked = light_of(elsewhere, appearance="textured")
    off, wrong = (off_as_seen(each.fit.coefficients, LIGHT) for each in (found, asked))
    assert off < 0.5 * wrong


def test_least_squares_are_held_against_each_other_too(leather, elsewhere):
    taken = [light_of(s, estimator="least-squares", order=2).model for s in (photographed(leather), elsewhere)]
    assert [model.appearance for model in taken] == ["textured", "mean"]


def test_grain_is_left_to_means_which_lose_nothing_by_it(leather):
    """Of 25 pixels they have a fifth of it."""
    scene = photographed(leather, noise=0.12)
    found, asked = light_of(scene), light_of(scene, appearance="textured")
    assert found.model.appearance == "mean"
    off, other = (off_as_seen(each.fit.coefficients, LIGHT) for each in (found, asked))
    assert off < 1.1 * other


def test_both_looks_are_of_the_same_points_and_each_of_its_own_values(elsewhere):
    materials = materials_of_all([elsewhere], open_library(None), SETTINGS, name=LEATHER)
    model = first_model([elsewhere], materials, SETTINGS)
    (mean,), (textured,) = (model.looks[look] for look in ("mean", "textured"))
    np.testing.assert_array_equal(mean.pixels, textured.pixels)
    photo = elsewhere.job.photo.radiance
    np.testing.assert_array_equal(textured.radiance(), textured.values_of(photo))
    np.testing.assert_allclose(mean.radiance(), mean.means_of(photo))
    assert np.abs(mean.radiance() / textured.radiance() - 1).mean() > 0.03
    np.testing.assert_array_equal(mean.of_single_pixels().radiance(), textured.radiance())
    assert textured.of_single_pixels() is textured
    clipped = replace(mean, measured=np.where(np.arange(3) == 1, 7.0, mean.measured))
    elsewhere_clipped = np.zeros(photo.shape, bool)
    elsewhere_clipped[..., 1] = True
    scene = scene_of(replace(elsewhere.job, photo=replace(elsewhere.job.photo, clipped=elsewhere_clipped)))
    kept = replace(clipped, scene=scene).of_single_pixels().radiance()
    assert (kept[:, 1] == 7).all()
    np.testing.assert_array_equal(kept[:, ::2], textured.radiance()[:, ::2])


def test_a_pixel_gathers_from_beyond_its_square(elsewhere):
    """The fit's points have as much of the surface as a photo's pixels: 0.38 pixels of spread, a square has 0.29."""
    materials = materials_of_all([elsewhere], open_library(None), SETTINGS, name=LEATHER)
    points = first_model([elsewhere], materials, SETTINGS).problems[0].points[0]
    bare = elsewhere.points(0, textured=False)
    own = {tuple(p): f for p, f in zip(bare.pixels.tolist(), bare.footprint, strict=True)}
    ratio = points.footprint / [own[tuple(p)] for p in points.pixels.tolist()]
    np.testing.assert_allclose(ratio / np.sqrt(12), 0.375, atol=0.01)
