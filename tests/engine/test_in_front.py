# SPDX-License-Identifier: GPL-3.0-or-later
"""Highlights are told from things in front by other places that reflect the same direction."""

from types import SimpleNamespace

import numpy as np

from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.pipeline.refine.in_front import highlights

MATTE, GLOSSY = 0.002, 0.1
BALL = 1000  # points


def two_balls(*gloss) -> SimpleNamespace:
    """Two equal balls side by side, of a gloss each: as far as highlights ask for it, a Problem."""
    normal = fibonacci_sphere(2 * BALL)
    normal = normal[np.argsort(-normal[:, 2])[:BALL]]  # the half that faces the camera
    basis = np.zeros((2 * len(normal), 100, 3), np.float32)
    basis[:, 0] = 1.0
    basis[:, 1:] = np.repeat(gloss, len(normal))[:, None, None]
    place = np.round(100 * normal[:, :2]).astype(int)
    eye = SimpleNamespace(to_eye=np.broadcast_to([0.0, 0.0, 1.0], (2 * len(normal), 3)))
    pixels = np.concatenate([place, place + np.array([0, 250])])
    return SimpleNamespace(basis=[basis], normals=np.concatenate([normal, normal]), points=[eye], pixels=pixels)


def test_a_bright_patch_on_one_of_two_glossy_balls_is_no_highlight():
    problem = two_balls(GLOSSY, GLOSSY)
    bright = problem.normals @ [0.4, 0.2, 0.9] > 0.98
    bright[BALL:] = False
    assert not highlights(problem, bright).any()


def test_a_highlight_shows_on_both():
    problem = two_balls(GLOSSY, GLOSSY)
    bright = problem.normals @ [0.4, 0.2, 0.9] > 0.98
    np.testing.assert_array_equal(highlights(problem, bright), bright)


def test_a_matte_ball_tells_nothing_of_what_a_glossy_one_shows():
    problem = two_balls(GLOSSY, MATTE)
    bright = problem.normals @ [0.4, 0.2, 0.9] > 0.98
    bright[BALL:] = False
    np.testing.assert_array_equal(highlights(problem, bright), bright)


def test_matte_objects_have_none():
    problem = two_balls(MATTE, MATTE)
    assert not highlights(problem, problem.normals[:, 2] > 0.9).any()
