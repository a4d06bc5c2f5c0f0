# SPDX-License-Identifier: GPL-3.0-or-later
"""Painted things: the paint is found by evidence, and the light is better for it; elsewhere none is found."""

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter

from btfsep_engine.btf.library import open_library
from btfsep_engine.pipeline.estimation import REFINEMENTS, estimate
from btfsep_engine.pipeline.problem import Problem
from btfsep_engine.pipeline.refine import painted
from btfsep_engine.pipeline.refine.painted import painted_surfaces, pieces
from btfsep_engine.pipeline.settings import choose
from tests.render.scenes import (
    as_mesh,
    ball_with_another,
    egg_and_pebble,
    in_white,
    job_of,
    lit_by_a_lamp,
    looking_down,
    off_as_seen,
    scene_of,
    with_photo,
)

pytestmark = pytest.mark.usefixtures("no_parts_with_edges")
WHITE = "reference/white-diffuse"
SETTINGS = choose("draft", refine="all", bounces=1, directions=1024)
VARIES, ACROSS = 0.35, 7  # of the logarithm of the albedo; pixels


@pytest.fixture(scope="module")
def photographed():
    """A ball with another before it, its photo with a camera's noise, and the light."""
    return in_white(ball_with_another())


def painted_over(image, seed):
    """The photo of a surface that is stained, in pieces of some `ACROSS` pixels."""
    stains = gaussian_filter(np.random.default_rng(seed).standard_normal(image.shape[:2]), ACROSS)
    return image * np.exp(VARIES * stains / stains.std())[..., None].astype(np.float32)


def found_of(scene, image, **how):
    return estimate(scene_of(with_photo(scene.job, image)), open_library(None), SETTINGS, material=WHITE, **how)


@pytest.mark.parametrize("light", ["a lamp", "a sky"])
def test_paint_is_found_and_the_light_is_better_for_it(photographed, light):
    scene, without = photographed[0], [r for r in REFINEMENTS if r is not painted_surfaces]
    off = []
    for seed in range(4):
        image, truth = lit_by_a_lamp(scene, seed) if light == "a lamp" else photographed[1:]
        photo = painted_over(image, seed)
        found, plain = found_of(scene, photo), found_of(scene, photo, refinements=without)
        assert "in pieces" in found.choice["paint"] and "paint" not in plain.choice
        assert "uneven" not in found.choice  # as the pieces say, and not once more
        off.append([off_as_seen(each.fit.coefficients[:9], truth) for each in (found, plain)])
    with_paint, without_paint = np.mean(off, 0)
    assert with_paint < 0.9 * without_paint


def test_what_is_as_it_was_told_has_none(photographed):
    scene = photographed[0]
    image, _ = lit_by_a_lamp(scene, 1)
    found = found_of(scene, image)
    assert "paint" not in found.choice and found.model.problems[0].slopes is None


def test_what_explains_little_more_is_not_kept(photographed, monkeypatch):
    scene = photographed[0]
    photo = painted_over(lit_by_a_lamp(scene, 1)[0], 1)
    assert "paint" in found_of(scene, photo).choice
    monkeypatch.setattr(painted, "CLEARLY", 1e4)
    assert "paint" not in found_of(scene, photo).choice


def test_what_is_as_it_was_told_is_not_painted_even_where_that_is_asked(photographed, monkeypatch):
    monkeypatch.setattr(painted, "MUCH", 0.0)
    scene, image, _ = photographed
    assert "paint" not in found_of(scene, image).choice


@pytest.mark.parametrize(("painted_so", "trials"), [(False, 1), (True, 2)])
def test_much_paint_is_tried_where_a_little_explains_something(photographed, monkeypatch, painted_so, trials):
    asked, followed = [], painted.followed
    monkeypatch.setattr(painted, "MUCH", 0.0)
    monkeypatch.setattr(painted, "followed", lambda *how: asked.append(1) or followed(*how))
    scene, image, _ = photographed
    found_of(scene, painted_over(image, 0) if painted_so else image)
    assert len(asked) == trials


def test_each_of_several_objects_has_pieces_of_its_own():
    balls = [trimesh.creation.icosphere(3, r).apply_translation((x, 0, 0)) for r, x in ((0.45, -0.3), (0.25, 0.5))]
    scene = scene_of(job_of([as_mesh(ball) for ball in balls], looking_down()))
    problem = Problem(scene, [], [scene.points(i, textured=False) for i in range(2)], [], {})
    first, second = problem.by_object(pieces(problem))
    assert not ((first > 0).any(0) & (second > 0).any(0)).any()
    for share in (first, second):
        assert np.median(share.sum(1)) == pytest.approx(1)


def test_pieces_cover_each_object_and_no_other():
    scene, _, _ = in_white(egg_and_pebble())
    problem = found_of(scene, lit_by_a_lamp(scene, 0)[0]).model.problems[0]
    share = pieces(problem)
    assert len(share) == len(problem.pixels) and 20 < share.shape[1] <= (painted.PATCHES + 1) ** 2
    assert (share >= 0).all() and share.sum(1).max() < 1 + 1e-9 and np.median(share.sum(1)) == pytest.approx(1)
    where = np.einsum("pk,pa->ka", share, problem.pixels) / share.sum(0)[:, None]  # the pieces' middles
    assert len(np.unique(where.round(3), axis=0)) == share.shape[1]
    across = [np.ptp(problem.pixels[s > 0], 0).max() for s in share.T]
    assert max(across) <= 2 * np.ptp(problem.pixels, 0).max() / painted.PATCHES + 1
