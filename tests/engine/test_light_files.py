# SPDX-License-Identifier: GPL-3.0-or-later
"""lighting.json and lighting.exr: what is written is what is read, by the contract's own words."""

import json

import numpy as np
import OpenEXR
import pytest

from btfsep_engine import sh
from btfsep_engine.conventions import pixel_directions
from btfsep_engine.errors import InputError
from btfsep_engine.light.files import (
    Lighting,
    exactly,
    read_any_lighting,
    read_lighting,
    write_lighting,
    write_lighting_exr,
)
from btfsep_engine.light.positivity import positive_radiance


@pytest.fixture
def lighting(rng):
    known = rng.random(9) < 0.7
    return Lighting(2, rng.normal(size=(9, 3)), rng.random((9, 3)), known, exposure_ev=-1.5)


def test_round_trip_is_exact(tmp_path, lighting):
    write_lighting(tmp_path / "lighting.json", lighting)
    read = read_lighting(tmp_path / "lighting.json")
    for key in ("coefficients", "stddev", "determined"):
        np.testing.assert_array_equal(getattr(read, key), getattr(lighting, key))
    assert (read.order, read.exposure_ev) == (2, -1.5)
    assert [p.name for p in tmp_path.iterdir()] == ["lighting.json"]


def test_the_file_is_the_contract(tmp_path, lighting):
    write_lighting(tmp_path / "lighting.json", lighting)
    tree = json.loads((tmp_path / "lighting.json").read_text())
    assert tree == {
        "format": "btfsep-lighting",
        "version": 1,
        "basis": "real-sh",
        "order": 2,
        "coefficients": lighting.coefficients.tolist(),
        "stddev": lighting.stddev.tolist(),
        "determined": lighting.determined.tolist(),
        "frame": "blender-z-up",
        "exposure_ev": -1.5,
    }


def test_a_light_without_uncertainty_counts_as_exact(tmp_path, lighting):
    write_lighting(tmp_path / "l.json", lighting)
    tree = json.loads((tmp_path / "l.json").read_text())
    del tree["stddev"], tree["determined"], tree["exposure_ev"]
    (tmp_path / "l.json").write_text(json.dumps(tree))
    read = read_lighting(tmp_path / "l.json")
    assert not read.stddev.any() and read.determined.all() and read.exposure_ev == 0


@pytest.mark.parametrize(("path", "value", "words"), [
    ("format", "btfsep-job", 'its format is "btfsep-job"'),
    ("version", 3, "use a newer BTFsep"),
    ("basis", "sh", "did you mean 'real-sh'?|choose one of 'real-sh'"),
    ("frame", "y-up", "frame"),
    ("order", 3, "it has 9 rows, and order 3 has 16"),
    ("order", -1, "at least 0"),
    ("order", 10**6, "at most 64"),
    ("coefficients", [[1, 2]] * 9, r"coefficients\[0\]; it has 2 entries"),
    ("coefficients", "none", "it has to be a list"),
    ("coefficients", [[1, 2, float("nan")]] * 9, r"coefficients\[0\]\[2\]"),
    ("stddev", [[1, 2, -3]] * 9, "negative"),
    ("stddev", [[1, 2, 3]] * 4, "it has 4 rows"),
    ("determined", [1] * 9, "it has to be true or false"),
    ("colour", 1, "this key is not known"),
])  # fmt: skip
def test_what_is_wrong_is_said(tmp_path, lighting, path, value, words):
    write_lighting(tmp_path / "l.json", lighting)
    tree = json.loads((tmp_path / "l.json").read_text())
    tree[path] = value
    (tmp_path / "l.json").write_text(json.dumps(tree))
    with pytest.raises(InputError, match=words):
        read_lighting(tmp_path / "l.json")


def test_no_file(tmp_path):
    for name in ("l.json", "l.exr"):
        with pytest.raises(InputError, match="no such file"):
            read_any_lighting(tmp_path / name)


def test_nothing_that_is_not_finite_is_ever_written(tmp_path):
    with pytest.raises(ValueError, match="finite"):
        write_lighting(tmp_path / "l.json", exactly(np.full((4, 3), np.nan)))
    assert not list(tmp_path.iterdir())


def test_shapes_have_to_agree():
    with pytest.raises(ValueError, match="shape"):
        Lighting(2, np.zeros((4, 3)), np.zeros((4, 3)), np.ones(4, bool))


def test_the_map_is_the_light(tmp_path, lighting):
    def written():
        write_lighting_exr(tmp_path / "l.exr", lighting, height=64, width=128)
        planes = OpenEXR.File(str(tmp_path / "l.exr"), separate_channels=True).channels()
        return np.stack([planes[c].pixels for c in "RGB"], -1)

    assert sh.to_map(lighting.coefficients, 64, 128).min() < 0
    positive = positive_radiance(lighting.coefficients, pixel_directions(64, 128))
    np.testing.assert_allclose(written(), positive, rtol=1e-5, atol=1e-6)
    lighting.coefficients[0] = 20
    np.testing.assert_allclose(written(), sh.to_map(lighting.coefficients, 64, 128), rtol=1e-5, atol=1e-6)
    back = read_any_lighting(tmp_path / "l.exr", 2)
    np.testing.assert_allclose(back.coefficients, lighting.coefficients, atol=5e-3)
    assert back.determined.all()


def test_the_default_map_is_512_by_256(tmp_path, lighting):
    write_lighting_exr(tmp_path / "l.exr", lighting)
    assert OpenEXR.File(str(tmp_path / "l.exr")).channels()["RGB"].pixels.shape == (256, 512, 3)


def test_maps_that_are_none(tmp_path, write_rgb_exr):
    write_rgb_exr(tmp_path / "square.exr", np.ones((8, 8, 3), np.float32))
    with pytest.raises(InputError, match="twice as wide as high"):
        read_any_lighting(tmp_path / "square.exr")
    a = np.ones((8, 16, 3), np.float32)
    a[2, 3] = np.inf
    write_rgb_exr(tmp_path / "inf.exr", a)
    with pytest.raises(InputError, match="1 pixels are NaN or infinite"):
        read_any_lighting(tmp_path / "inf.exr")
