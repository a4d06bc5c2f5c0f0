# SPDX-License-Identifier: GPL-3.0-or-later
"""What the residual tells: shifts to the pixel, near light, missing reflections; silence where nothing is wrong."""

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from btfsep_engine.fit.diagnose import diagnose, has_few_faces
from btfsep_engine.fit.log_normal import LightSolver
from btfsep_engine.fit.misalignment import silhouette_shift
from btfsep_engine.pipeline.doubts import THRESHOLDS, alignment_doubt, clamped_share, structure_doubts
from tests.engine.half_sphere import half_sphere, shown, side_light


def ball(size=80, radius=24, background=0.05):
    """A shaded ball before a background, and where it is."""
    y, x = np.mgrid[:size, :size] - size // 2
    seen = x**2 + y**2 < radius**2
    shade = 0.5 + 0.4 * x / radius + 0.3 * y / radius
    return np.where(seen, np.maximum(shade, 0.02), background)[..., None] * [1.0, 0.9, 0.7], seen


@pytest.mark.parametrize("moved", [(0, 0), (2, 0), (0, -3), (-4, 5)])
def test_a_shift_is_found_to_the_pixel(moved):
    photo, seen = ball()
    shift = silhouette_shift(np.roll(photo, moved, (0, 1)), seen)
    assert abs(shift.rows - moved[0]) <= 1 and abs(shift.columns - moved[1]) <= 1
    doubt = alignment_doubt(shift)
    assert (doubt is not None) == (moved != (0, 0))
    if moved == (0, -3):
        assert "to the left" in doubt and "line up" in doubt


@pytest.mark.parametrize("lost", [(5, 5), (6, 2), (6, 0)])
def test_an_outline_that_has_lost_pixels_is_not_shifted(lost):
    """A depth without what is seen at a grazing angle, more of it to the right: its outline is not the object's."""
    photo, seen = ball()
    columns = np.arange(80)[None, :]
    kept = np.where(columns > 40, binary_erosion(seen, iterations=lost[0]), seen)
    kept = np.where(columns < 40, binary_erosion(seen, iterations=lost[1]), kept) if lost[1] else kept
    assert alignment_doubt(silhouette_shift(photo, kept.astype(bool), frayed=True)) is None
    for moved in ((0, 4), (-3, 0), (3, -4)):  # the whole outline of an object that is elsewhere is still told
        doubt = alignment_doubt(silhouette_shift(np.roll(photo, moved, (0, 1)), seen, frayed=True))
        assert "line up" in doubt


def test_without_an_outline_nothing_is_said(rng):
    photo, seen = ball()
    assert silhouette_shift(photo, np.ones_like(seen)) is None  # it fills the picture
    assert silhouette_shift(np.zeros_like(photo), seen) is None
    noise = silhouette_shift(rng.uniform(0.4, 0.6, photo.shape), seen)
    assert alignment_doubt(noise) is None


def effects(rng, change):
    """Effects of a photo that ``change(photo, place, open_share)`` made; two spheres stand side by side."""
    basis, n, blocks = half_sphere(rng)
    side = np.arange(len(n)) % 2
    place = n + 2.5 * side[:, None] * [1.0, 0.0, 0.0]
    opened = np.where(rng.random(len(n)) < 0.3, 0.4, 1.0)
    blocks = blocks * 2 + side
    b = change(shown(basis, side_light(), rng, 0.03), place, opened)
    solver = LightSolver(basis, normals=n, order=2)
    fit = solver.solve(b)
    found = diagnose(solver, fit, b, blocks=blocks, position=place, normal=n, open_share=opened)
    assert structure_doubts(found, residual=0.9 * THRESHOLDS.explained, names=["white"]) == []  # next to nothing left
    return found, structure_doubts(found, residual=fit.residual, names=["white"])


def test_a_right_model_is_not_doubted(rng):
    found, said = effects(rng, lambda b, place, opened: b)
    assert said == [] and found["near"].chi2 < 15 and found["blocked"].chi2 < 15


def test_light_nearby_is_seen(rng):
    """One of two equal spheres is darker: no light from far away does that."""
    found, said = effects(rng, lambda b, place, opened: b * (1 + 0.15 * place[:, :1]))
    assert found["near"].chi2 > THRESHOLDS.near and any("nearby" in text for text in said)
    assert found["near"].size[0] > 0.1  # along x
    of_mirrors = structure_doubts(found, residual=1.0, names=["white"], mirrored=True)
    assert not any("nearby" in text for text in of_mirrors)  # their picture was made as under light from far away


def test_missing_reflections_are_seen_and_missing_light_is_none(rng):
    found, said = effects(rng, lambda b, place, opened: b * (1 + 0.7 * (1 - opened))[:, None])
    assert found["blocked"].chi2 > THRESHOLDS.blocked and any("not modelled" in text for text in said)
    found, said = effects(rng, lambda b, place, opened: b * (1 + 0.35 * (1 - opened))[:, None])
    assert found["blocked"].chi2 > THRESHOLDS.blocked and 0.2 < found["blocked"].size[0] < THRESHOLDS.blocked_size
    assert not any("not modelled" in text for text in said)  # as much as is lost in narrow gaps
    found, said = effects(rng, lambda b, place, opened: b * (1 - 0.4 * (1 - opened))[:, None])
    assert found["blocked"].size[0] < 0 and not any("not modelled" in text for text in said)


def test_of_a_few_flat_faces_shading_says_nothing_of_the_material(rng):
    """Whatever is wrong on three faces looks like shading: as if lit by a lamp, say."""
    basis, n, blocks = half_sphere(rng)
    b = shown(basis, side_light(), rng, 0.01)
    b = b + 0.3 * b.mean() * np.maximum(n @ [0.8, 0.0, 0.6], 0)[:, None] ** 4
    solver = LightSolver(basis, normals=n, order=2)
    how = {"position": n, "open_share": np.ones(len(n))}
    boxes = np.eye(3)[np.abs(n).argmax(1)] * np.sign(np.take_along_axis(n, np.abs(n).argmax(1)[:, None], 1))
    found = diagnose(solver, solver.solve(b), b, blocks=blocks, normal=n, **how)
    of_boxes = diagnose(solver, solver.solve(b), b, blocks=blocks, normal=boxes, **how)
    assert found["diffuse"].chi2 > 0 and of_boxes["diffuse"].chi2 == 0 and not of_boxes["diffuse"].size.any()
    assert of_boxes["near"].chi2 == found["near"].chi2 > 0
    assert has_few_faces(boxes) and not has_few_faces(n)


@pytest.mark.parametrize("slope", [0.5, 1.0, 2.0, 3.0])
def test_the_negative_part_of_a_slanted_light_is_the_closed_form(slope):
    """L = 1 + slope cos(theta): the integrals over where it is below and above zero are parabolas' in cos(theta)."""
    x = np.zeros((4, 3))
    x[0], x[2] = np.sqrt(4 * np.pi), slope * np.sqrt(4 * np.pi / 3)
    below = (slope - 1) ** 2 / (2 * slope) if slope > 1 else 0.0
    assert clamped_share(x) == pytest.approx(below / (2 + below), abs=2e-3)
