# SPDX-License-Identifier: GPL-3.0-or-later
"""A photograph whose lit side is clipped, through the whole estimate: what is clipped was at least as bright."""

import json

import cv2
import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.cli import main
from btfsep_engine.imaging.srgb import linear_to_srgb
from btfsep_engine.light.files import read_lighting
from scripts.studies.stage import seen_normals
from tests.render.scenes import edited, looking_down, off_as_seen

LAMP = np.array([0.5, 0.4, 0.77]) / np.linalg.norm([0.5, 0.4, 0.77])
EVEN, STRENGTH = 0.4, np.array([3.0, 2.7, 2.2])  # radiance, and irradiance on what faces the lamp
ALBEDO = 0.8


def truth():
    """The light's coefficients, (9, 3)."""
    x = sh.evaluate(2, LAMP[None])[0][:, None] * STRENGTH
    x[0] += EVEN * np.sqrt(4 * np.pi)
    return x


def ball():
    """(96, 96, 3) radiance of the white ball under the lamp, 0 beside it, and where it is."""
    normals, there = seen_normals(looking_down())
    received = np.pi * EVEN + np.maximum(normals @ LAMP, 0)[..., None] * STRENGTH
    return np.where(there[..., None], ALBEDO / np.pi * received, 0), there


def estimated(folder, codes, capsys):
    """Coefficients of the light of an sRGB photo of 8 bits, and what result.json says."""
    cv2.imwrite(str(folder / "photo.png"), codes[..., ::-1])
    edited(folder, image="photo.png")
    command = ["estimate", str(folder), "--material", "reference/white-diffuse", "--preset", "draft", "--no-report"]
    assert main(command) == 0
    capsys.readouterr()
    result = json.loads((folder / "result" / "result.json").read_text())
    return read_lighting(folder / "result" / "lighting.json").coefficients, result


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_clipped_pixels_are_bounds_and_not_values(sphere_job_folder, capsys, share):
    """The brightest part of the ball is clipped; taken at face value it makes the lamp weaker than it is."""
    folder, _ = sphere_job_folder
    radiance, there = ball()
    white = np.quantile(radiance[there].max(-1), 1 - share)  # radiance of the largest code
    codes = np.round(255 * np.clip(linear_to_srgb(radiance / white), 0, 1)).astype(np.uint8)
    clipped = (codes == 255).any(-1)
    assert clipped[there].mean() == pytest.approx(share, abs=0.02)

    bounds, result = estimated(folder, codes, capsys)
    assert result["saturated_pixels"] == clipped.sum()
    (said,) = [each for each in result["warnings"] if "at least as bright" in each]
    percent, _ = said.split(" % of the pixels of object 'ball' are saturated")
    assert int(percent) == pytest.approx(100 * share, abs=2)
    values, result = estimated(folder, np.minimum(codes, 254), capsys)
    assert result["saturated_pixels"] == 0

    right = truth() / white
    few = share < 0.2  # of a ball without noise a tenth is made up for by the rest
    errors = off_as_seen(bounds, right), off_as_seen(values, right)
    assert errors[0] < 0.05 and errors[0] < max(0.5 * errors[1], 0.01 * few)
    facing = [float(sh.irradiance(x[:9], LAMP[None])[0].mean()) for x in (bounds, values, right)]
    assert facing[1] < (1 if few else 0.98) * facing[2] and facing[0] == pytest.approx(facing[2], rel=0.04)
