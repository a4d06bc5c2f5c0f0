# SPDX-License-Identifier: GPL-3.0-or-later
"""A JPEG of a strongly coloured object before another background: what bleeds into its rim does not make the light."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.imaging import images
from btfsep_engine.imaging.srgb import linear_to_srgb
from btfsep_engine.pipeline.coarse_chroma import BESIDE, KAPPA, NEXT, chroma_weights
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.model import view_problem
from btfsep_engine.pipeline.refine import limb
from btfsep_engine.pipeline.settings import choose
from tests.render.scenes import as_mesh, in_white, off_as_seen, scene_of

WHITE = "reference/white-diffuse"
SETTINGS = choose("draft", bounces=1, directions=1024)
RED, LAWN = np.array([0.6, 0.04, 0.03]), np.array([0.05, 0.3, 0.05])


@pytest.fixture(scope="module")
def photographed():
    """An egg, its radiance as if white, no number beside it, and the light's coefficients."""
    egg = trimesh.creation.icosphere(4, 1.0)
    egg.apply_scale([0.6, 0.75, 0.5])
    scene, image, truth = in_white(as_mesh(egg), noise=0.0)
    image[scene.view.mesh != 0] = np.nan
    return scene, image, truth


def saved(scene, image, colour, background, path, how=()):
    """The scene with the egg's photo in a colour before a background, as a file of the path's kind has it."""
    shown = np.where(np.isfinite(image), image * colour, background)
    shown = 0.9 * shown / shown[scene.view.mesh == 0].max()
    codes = np.round(255 * np.clip(linear_to_srgb(shown), 0, 1)).astype(np.uint8)
    cv2.imwrite(str(path), codes[..., ::-1], list(how))
    read = images.read_linear(path)
    photo = replace(
        scene.job.photo, radiance=read.pixels, usable=read.usable, bits=read.bits, coarse_chroma=read.coarse_chroma
    )
    return scene_of(replace(scene.job, photo=photo))


def error(found, truth) -> float:
    """`off_as_seen`, each channel with a scale of its own: whose colour it is, is not asked here."""
    x = found.fit.coefficients[:9]
    return off_as_seen(x * (truth[0] / x[0]), truth)


def weights_of(scene):
    problem = view_problem(scene, [open_library(None).load(WHITE)], SETTINGS)
    return problem, chroma_weights(problem)


def test_the_light_of_a_red_object_is_that_of_a_file_without_loss(photographed, tmp_path, monkeypatch):
    monkeypatch.setattr(limb, "SPEAKS", np.inf)  # what the lawn adds to weak channels would pass for a brighter limb
    scene, image, truth = photographed

    def found(there):
        return error(estimate(there, open_library(None), SETTINGS, material=WHITE), truth)

    lossless = found(saved(scene, image, RED, LAWN, tmp_path / "a.png"))
    coarse = saved(scene, image, RED, LAWN, tmp_path / "a.jpg", [cv2.IMWRITE_JPEG_QUALITY, 92])
    photo = replace(coarse.job.photo, coarse_chroma=False)
    untold = scene_of(replace(coarse.job, photo=photo))
    mended, as_stored = found(coarse), found(untold)
    assert mended < 1.5 * lossless + 0.01 and as_stored > 2 * mended


def test_what_counts_less_are_weak_channels_near_outlines_before_another_colour(photographed, tmp_path):
    scene, image, _ = photographed
    sky = np.array([0.35, 0.5, 0.8])
    problem, weights = weights_of(saved(scene, image, RED, sky, tmp_path / "red.jpg"))
    rings = problem.rings
    assert (weights > 0).all() and (weights[rings >= len(KAPPA)] == 1).all()
    third = rings == NEXT
    assert np.median(weights[third][:, 2]) < 0.2 * np.median(weights[third][:, 0]) < 0.1
    assert (np.diff([np.median(weights[rings == r][:, 1]) for r in range(NEXT - 1, len(KAPPA) + 1)]) > 0).all()
    grey = np.full(3, 0.5)
    problem, weights = weights_of(saved(scene, image, grey, grey, tmp_path / "grey.jpg"))
    beside = problem.rings < NEXT
    assert weights[beside] == pytest.approx(BESIDE, rel=0.1) and weights[~beside] == pytest.approx(1, rel=0.1)


def test_a_file_without_loss_counts_alike_everywhere(photographed, tmp_path):
    scene, image, _ = photographed
    assert weights_of(saved(scene, image, RED, LAWN, tmp_path / "a.png"))[1] is None
