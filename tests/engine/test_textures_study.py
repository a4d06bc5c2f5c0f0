# SPDX-License-Identifier: GPL-3.0-or-later
"""The study of textures by others: what it reads of a folder of sets, and what its photographs are called."""

import json

import cv2
import numpy as np
import pytest

from btfsep_engine.errors import InputError
from scripts.studies import textures

SIZES = {"size_mm": 60, "height_mm": 2}


def test_sets_are_photographed_under_names_that_are_found_again(tmp_path):
    (tmp_path / "meta.json").write_text(json.dumps({"oak_floor_3": SIZES | {"class": "wood"}}))
    sets = textures.texture_sets(tmp_path)
    assert sets == {"oak-floor-3": {"folder": str(tmp_path / "oak_floor_3"), "size_mm": 60.0, "height_mm": 2.0}}
    (shot,) = textures.shots(tmp_path / "photos", sets, ["blob"], ["city"])
    assert shot.folder.endswith("blob_others-oak-floor-3_city") and shot.maps == sets["oak-floor-3"]


@pytest.mark.parametrize("told", [None, "{", "[1]", '{"oak": {"size_mm": 60}}', '{"oak": {"size_mm": "wide"}}'])
def test_sets_of_unknown_size_are_refused_in_a_sentence(tmp_path, told):
    if told is not None:
        (tmp_path / "meta.json").write_text(told)
    with pytest.raises(InputError, match="size_mm"):
        textures.texture_sets(tmp_path)


def test_the_numbers_of_a_set_are_its_mean_colour_and_roughness(tmp_path):
    halves = np.repeat([[60], [200]], 32, 0).repeat(64, 1).astype(np.uint8)
    for name, picture in (("color", np.dstack([halves] * 3)), ("height", 0 * halves), ("roughness", halves)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), picture)
    surface = textures.surface_of({"folder": str(tmp_path), **SIZES})
    assert surface.roughness == pytest.approx(np.mean([60, 200]) / 255, abs=0.01)
    linear = [((v / 255 + 0.055) / 1.055) ** 2.4 for v in (60, 200)]
    np.testing.assert_allclose(surface.base_color, np.mean(linear), atol=0.01)
