# SPDX-License-Identifier: GPL-3.0-or-later
"""Means of like pixels: which are taken, of which photos, and what a light gains by it. The transport makes them."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter

from btfsep_engine.btf.library import open_library
from btfsep_engine.fit.tone_curve import SRGB
from btfsep_engine.job.model import Photo
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.like_pixels import (
    FEWEST,
    TEXTURED,
    as_seen_on_the_whole,
    glossiness,
    like_pixels_words,
    variation,
    with_like_pixels,
)
from btfsep_engine.pipeline.problem import make_problem
from btfsep_engine.pipeline.refine.curves import _read_by
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.together import fit_together, light_solver
from btfsep_engine.pipeline.tone import Curves, codes_of
from tests.render.scenes import (
    as_mesh,
    egg_and_pebble,
    job_of,
    looking_down,
    off_as_seen,
    picture,
    scene_of,
    with_photo,
)

SETTINGS = choose("draft", bounces=1, appearance="mean", order=2, align="never")
WHITE = open_library(None).load("reference/white-diffuse")
LIGHT = np.zeros((9, 3))
LIGHT[0], LIGHT[1], LIGHT[2], LIGHT[3], LIGHT[6] = 3.0, 0.9, 1.2, -1.1, 0.5


def of_mesh(mesh, *, texture: float, coarse=0.0, seed: int = 0, size: int = 256, focal: float = 666.0, **photo):
    """A Problem of a white mesh whose photo varies by chance from pixel to pixel; and the photo without that.

    ``coarse`` : pixels over which it varies, as textures do and noise does not
    """
    scene = scene_of(job_of([mesh], looking_down(size, focal)))
    all_points = scene.points(0, region=scene.view.mesh == 0, textured=False)
    clean = scene.radiance(all_points, WHITE, SHLighting(LIGHT), directions=256)[:, 0]
    chance = np.random.default_rng(seed).standard_normal(len(all_points))
    if coarse:
        chance = gaussian_filter(picture(all_points, np.repeat(chance[:, None], 3, 1), size=size)[..., 0], coarse)
        chance = chance[tuple(all_points.pixels.T)] / chance[tuple(all_points.pixels.T)].std()
    dark = np.exp(texture * chance - texture**2 / 2)
    image = picture(all_points, clean * dark[:, None], size=size)
    scene.job = with_photo(scene.job, image, **photo)
    points = scene.points(0, textured=False)
    chosen = points.take(np.arange(0, len(points), 3))
    return make_problem(scene, [WHITE], [chosen], SETTINGS), picture(all_points, clean, size=size)


def places(problem):
    """Rows and columns (p, k, 2, 2) of the pairs, and which there are (p, k)."""
    there = problem.around[..., 0] >= 0
    width = problem.scene.job.camera.width
    return np.stack(np.divmod(np.maximum(problem.around, 0), width), -1), there


def tilted_prism():
    """Of eight sides: its edges turn by 45 degrees and by 90."""
    turned = trimesh.transformations.rotation_matrix(0.7, (1, 0.4, 0.2))
    return as_mesh(trimesh.creation.cylinder(0.5, 0.8, sections=8).apply_transform(turned), flat=True)


@pytest.mark.parametrize("mesh", [egg_and_pebble, tilted_prism])
def test_pairs_lie_opposite_on_the_same_surface_and_are_all_there_are_of_them(mesh):
    problem = with_like_pixels(of_mesh(mesh(), texture=0.2)[0])
    at, there = places(problem)
    np.testing.assert_array_equal(
        (at.sum(2) / 2)[there], np.broadcast_to(problem.pixels[:, None], (*at.shape[:2], 2))[there]
    )
    every = problem.scene.points(0, textured=False)
    normals = np.zeros((260, 260, 3))  # with a margin, so that -2 and 257 are in it
    normals[tuple(every.pixels.T)] = every.normal
    found = 0
    for i, (row, column) in enumerate(problem.pixels):
        pairs = {frozenset(map(tuple, pair)) for pair in at[i][there[i]].tolist()}
        assert len(pairs) == there[i].sum()
        expected = set()
        for dr in range(-2, 3):
            for dc in range(-2, 3):
                pair = [(row + s * dr, column + s * dc) for s in (1, -1)]
                if (dr or dc) and all(normals[p] @ normals[row, column] > np.cos(np.radians(12)) for p in pair):
                    expected.add(frozenset((int(r), int(c)) for r, c in pair))
        assert pairs == expected
        found += len(pairs)
    assert 4 * len(problem.pixels) < found < 12 * len(problem.pixels)


def test_means_have_a_fifth_of_the_noise_of_single_pixels_and_next_to_no_bias():
    problem, clean = of_mesh(as_mesh(trimesh.creation.icosphere(5, radius=0.6)), texture=0.2)
    made = as_seen_on_the_whole(problem, SETTINGS)
    truth = problem.values_of(clean)
    single, mean = (values[:, 1] / truth[:, 1] - 1 for values in (problem.radiance(), made.radiance()))
    some = (made.around[..., 0] >= 0).all(1)  # all twelve pairs
    assert some.mean() > 0.5
    assert single[some].std() == pytest.approx(0.2, rel=0.1)
    assert mean[some].std() == pytest.approx(0.2 / 5, rel=0.15)
    flat = with_like_pixels(problem).means_of(clean)
    assert np.abs(flat / truth - 1).max() < 0.02 and np.abs((flat / truth - 1).mean()) < 0.003


def test_of_a_larger_picture_the_grid_is_wider():
    ball = as_mesh(trimesh.creation.icosphere(5, radius=0.6))
    each = (
        with_like_pixels(of_mesh(ball, texture=0.2, size=size, focal=3.9 * size)[0]) for size in (90, 180, 256, 576)
    )
    widths = [np.abs(at[there][:, 0] - at[there][:, 1]).max() for at, there in map(places, each)]
    assert widths == [2, 4, 4, 12]


def test_of_two_objects_each_has_its_own_grid_and_one_of_which_nothing_is_used_none():
    large, small = (
        as_mesh(trimesh.creation.icosphere(4, r).apply_translation((x, 0, 0))) for r, x in ((0.5, -0.1), (0.15, 0.65))
    )
    scene = scene_of(job_of([large, small], looking_down(384, 900.0)))
    points = [scene.points(i, textured=False) for i in range(2)]
    image = np.random.default_rng(0).lognormal(0, 0.3, (384, 384, 3)).astype(np.float32)
    scene.job = with_photo(scene.job, image)
    found = with_like_pixels(make_problem(scene, [WHITE, WHITE], points, SETTINGS))
    of_large, of_small = (a >= 0 for a in found.by_object(found.around))
    assert of_large.any((0, 2)).sum() == 12 and 0 < of_small.any((0, 2)).sum() <= 4
    owner = np.full((384, 384), -1)
    for i, p in enumerate(points):
        owner[tuple(p.pixels.T)] = i
    at, there = places(found)
    own = owner[tuple(found.pixels.T)]
    assert (owner[at[..., 0], at[..., 1]] == own[:, None, None])[there].all()
    none_of_it = with_like_pixels(make_problem(scene, [WHITE, WHITE], [points[0], points[1].take([])], SETTINGS))
    np.testing.assert_array_equal(none_of_it.around, found.by_object(found.around)[0])
    assert none_of_it.means_of(image).shape == (len(points[0]), 3)


def test_a_smooth_photo_is_left_as_it_is_and_so_are_others_that_have_no_use_of_it():
    ball = as_mesh(trimesh.creation.icosphere(5, radius=0.6))
    smooth, rough = (of_mesh(ball, texture=texture)[0] for texture in (0.01, 0.2))
    assert variation(with_like_pixels(smooth)) < TEXTURED < variation(with_like_pixels(rough))
    assert as_seen_on_the_whole(smooth, SETTINGS) is smooth and like_pixels_words([smooth]) is None
    assert as_seen_on_the_whole(rough, choose("paper")) is rough
    leather = open_library(None).load("leather/brown-grain")
    laid = replace(leather, laid_mean=leather.texels.mean((0, 1)))
    lined_up = replace(rough, materials=[laid])
    assert as_seen_on_the_whole(lined_up, SETTINGS) is lined_up
    assert "of up to 25 around it" in like_pixels_words([as_seen_on_the_whole(rough, SETTINGS)])


def test_means_of_gloss_count_for_less_and_leave_more_unknown():
    """All vary as much from pixel to pixel; what is told apart is how fast the basis images change."""
    settings = replace(SETTINGS, order=9)
    problem, _ = of_mesh(egg_and_pebble(), texture=0.2)
    made = []
    for name in ("reference/white-diffuse", "wood/oak-boards", "leather/brown-grain", "leather/black-nappa"):
        material = open_library(None).load(name).mean_material()
        alone = make_problem(problem.scene, [material], problem.points, settings)
        made.append(as_seen_on_the_whole(alone, settings))
        assert made[-1].around is not None and alone.coarsening == made[-1].of_single_pixels().coarsening == 1
    white, oak, grain, nappa = (each.coarsening for each in made)
    assert white == 1 < oak < 1.4 < grain == nappa == FEWEST
    fits = [fit_together([replace(made[3], coarsening=c)], settings).fit for c in (1.0, nappa)]
    sharp, plain = (fit.effective_degrees_of_freedom for fit in fits)
    assert plain < 0.95 * sharp
    of_two = light_solver([replace(made[3], coarsening=c) for c in (1.25, nappa)], settings)
    assert of_two.coarsening == nappa
    few = make_problem(problem.scene, [WHITE], problem.points, replace(settings, order=1, estimator="least-squares"))
    assert glossiness(few) == 0  # of few orders nothing is known


def test_clipped_and_unusable_pixels_are_in_no_mean():
    problem, _ = of_mesh(as_mesh(trimesh.creation.icosphere(5, radius=0.6)), texture=0.2)
    rows = np.arange(256)[:, None] + np.zeros((1, 256), int)
    bright = problem.scene.job.photo.radiance.copy()
    bright[110:114], bright[130:133] = 1e6, np.nan
    clipped = ((rows >= 110) & (rows < 114))[..., None] & np.array([True, False, False])
    photo = Photo(bright, ~((rows >= 130) & (rows < 133)), 0, clipped=clipped)
    problem.scene.job = replace(problem.scene.job, photo=photo)
    found = with_like_pixels(problem)
    at, there = places(found)
    row = at[..., 0][there]
    assert not (((row >= 110) & (row < 114)) | ((row >= 130) & (row < 133))).any()
    own = problem.pixels[:, 0]
    outside = (own < 110) | ((own >= 114) & (own < 130)) | (own >= 133)
    means = found.means_of(bright)
    assert np.isfinite(means[outside]).all() and means[outside].max() < 100
    np.testing.assert_array_equal(means[(own >= 110) & (own < 114)], 1e6)  # as it is: a lower bound


def test_another_photo_of_the_view_has_means_of_its_own():
    problem, _ = of_mesh(egg_and_pebble(), texture=0.2)
    made = as_seen_on_the_whole(problem, SETTINGS)
    other = scene_of(with_photo(made.scene.job, 3 * made.scene.job.photo.radiance[::-1, ::-1] + 0.5))
    again = made.again(other)
    np.testing.assert_allclose(again.radiance(), again.means_of(other.job.photo.radiance))
    assert np.abs(again.radiance() - problem.again(other).radiance()).max() > 0.1
    half = np.arange(len(made.pixels)) % 2 == 0
    np.testing.assert_array_equal(made.subset(half).means_of(other.job.photo.radiance), again.radiance()[half])


def test_a_curve_is_applied_before_the_mean_is_taken():
    problem, _ = of_mesh(egg_and_pebble(), texture=0.2)
    job = problem.scene.job
    codes = codes_of(replace(job, image_colorspace="srgb"), job.photo.radiance / job.photo.radiance.max())
    read = SRGB.decode(codes).astype(np.float32)
    problem.scene.job = with_photo(replace(job, image_colorspace="srgb"), read)
    problem.scene.curves = Curves(codes, (SRGB,), np.ones(1))
    made = as_seen_on_the_whole(problem, SETTINGS)
    np.testing.assert_allclose(_read_by(SRGB, made, codes).measured, made.radiance(), rtol=1e-4)
    of_codes = SRGB.decode(made.means_of(codes))
    assert np.abs(of_codes / made.radiance() - 1).max() > 0.005


def test_an_estimate_of_strong_texture_errs_less_and_states_less():
    errors, stated = [], []
    for seed in (0, 1, 2):
        problem, _ = of_mesh(egg_and_pebble(), texture=0.15, seed=seed)
        found = estimate(problem.scene, open_library(None), SETTINGS, material="reference/white-diffuse")
        assert "the mean of up to 25" in found.choice["pixels"]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("btfsep_engine.pipeline.like_pixels.TEXTURED", np.inf)
            before = estimate(problem.scene, open_library(None), SETTINGS, material="reference/white-diffuse")
        assert "pixels" not in before.choice
        errors.append([off_as_seen(e.fit.coefficients, LIGHT) for e in (before, found)])
        stated.append([np.linalg.norm(e.fit.stddev) for e in (before, found)])
    before, after = np.mean(errors, 0)
    assert after < 0.5 * before
    before, after = np.mean(stated, 0)
    assert after < 0.9 * before
