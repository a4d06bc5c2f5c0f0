# SPDX-License-Identifier: GPL-3.0-or-later
"""Libraries: the index, loading, what goes wrong, and the shipped one."""

import json
from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine.btf import library, procedural, storing
from btfsep_engine.btf.directions import ubo2014_directions
from btfsep_engine.btf.model import Lambertian, Mirror, Tabulated
from btfsep_engine.commands import measure as measuring
from btfsep_engine.errors import InputError

DIRECTIONS = ubo2014_directions()[::5]


def constant(name, value):
    """A Lambertian of albedo ``value`` (3,), tabulated."""
    angular = np.broadcast_to(np.asarray(value, np.float32) / np.pi, (len(DIRECTIONS), len(DIRECTIONS), 3))[..., None]
    texels = np.ones((4, 6, 1), np.float32)
    return Tabulated(name, name.split("/")[0], texels, angular, DIRECTIONS, DIRECTIONS, 0.5)


@pytest.fixture
def folder(tmp_path):
    """A library of two materials, stored as the build stores them."""
    height = procedural.maps("felt/grey-melange", 16).height_mm
    for name, value in (("felt/one", (0.5, 0.25, 0.1)), ("wood/two", (0.2, 0.2, 0.6))):
        storing.add(tmp_path, constant(name, value), height_mm=height, relative_error=0.1)
    return tmp_path


def test_names_load_and_facts(folder):
    opened = library.open_library(folder)
    assert opened.names()[:2] == ["felt/one", "wood/two"]
    assert "reference/white-diffuse" in opened.names()
    assert isinstance(opened.load("reference/white-diffuse"), Lambertian)
    material = opened.load("felt/one")
    assert (material.name, material.material_class, material.texel_mm) == ("felt/one", "felt", 0.5)
    facts = opened.show("felt/one")
    np.testing.assert_allclose(facts["mean_albedo"], (0.5, 0.25, 0.1), atol=2e-3)
    assert facts["patch_mm"] == [2.0, 3.0]
    assert facts["components"] == 1
    assert opened.show("reference/grey18")["mean_albedo"] == [0.18] * 3


def test_unknown_names_suggest_the_nearest(folder):
    with pytest.raises(InputError, match="did you mean 'felt/one'"):
        library.open_library(folder).load("felt/on")
    with pytest.raises(InputError, match="did you mean 'leather/brown-grain'"):
        procedural.maps("leather/brown")
    with pytest.raises(InputError, match="did you mean 'wood/oak-boards'"):
        measuring.build(folder, names=["wood/oak"])


def test_digest_follows_content(folder):
    before = library.open_library(folder).digest
    assert library.open_library(folder).digest == before
    storing.add(folder, constant("felt/one", (0.5, 0.25, 0.2)), overwrite=True)
    assert library.open_library(folder).digest != before


def test_a_file_that_is_not_the_indexed_one_is_refused(folder):
    path = folder / "felt_one.btf"
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)
    with pytest.raises(InputError, match="not the file in the index"):
        library.open_library(folder).load("felt/one")
    path.unlink()
    with pytest.raises(InputError, match="No such file"):
        library.open_library(folder).load("felt/one")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"file": "../felt_one.btf"}, "materials.0.file"),
        ({"file": "/etc/x.btf"}, "materials.0.file"),
        ({"name": "no slash"}, "materials.0.name"),
        ({"texel_mm": 0}, "texel_mm"),
        ({"sha256": "00"}, "sha256"),
        ({"name": "wood/two"}, "same name"),
    ],
)
def test_bad_indexes_are_told_in_words(folder, change, words):
    index = json.loads((folder / "index.json").read_text())
    index["materials"][0] |= change
    (folder / "index.json").write_text(json.dumps(index))
    with pytest.raises(InputError, match=words):
        library.open_library(folder)


def test_no_library_no_json_and_another_version(tmp_path):
    with pytest.raises(InputError, match="btfsep library build"):
        library.open_library(tmp_path / "none")
    (tmp_path / "index.json").write_text("{")
    with pytest.raises(InputError, match="Invalid JSON"):
        library.open_library(tmp_path)
    (tmp_path / "index.json").write_text('{"format": "btfsep-library", "version": 2, "materials": []}')
    with pytest.raises(InputError, match="version"):
        library.open_library(tmp_path)


def test_exported_maps_have_v_upward(tmp_path):
    from btfsep_engine.imaging.images import read_linear

    maps = procedural.export_maps("wood/oak-boards", tmp_path, 64)
    stored = read_linear(tmp_path / "basecolor.exr").pixels
    np.testing.assert_allclose(stored, maps.base_colour[::-1], atol=1e-6)
    assert {p.name for p in tmp_path.iterdir()} == {"basecolor.exr", "height.exr", "roughness.exr"}


def test_the_shipped_library_is_whole():
    opened = library.open_library()
    assert set(opened.entries) <= set(procedural.NAMES)
    classes = [entry.material_class for entry in opened.entries.values()]
    assert all(classes.count(c) >= 2 for c in ("carpet", "fabric", "felt", "leather", "stone", "wallpaper", "wood"))
    assert sum(entry.size for entry in opened.entries.values()) < 35e6
    for name in opened.entries:
        material = opened.load(name)
        assert material.angular.shape[:3] == (151, 151, 3)
        albedo = material.diffuse_albedo()
        base = procedural.maps(name, 64).base_colour.reshape(-1, 3).mean(0)
        assert (albedo < 0.9).all()
        # shadows and interreflection take, the layer's gloss adds (0.09 over all directions; the values held beyond
        # 75 degrees make it more); the hue stays that of the base
        assert (albedo > 0.35 * base).all() and (albedo < base + 0.14).all(), (name, albedo, base)
        assert (np.argsort(albedo) == np.argsort(base)).all() or np.ptp(base) < 0.1


def test_the_shipped_materials_are_reciprocal_in_the_mean():
    opened = library.open_library()
    for name in opened.entries:
        f = opened.load(name).mean_abrdf.sum(-1)
        # values are means over a light's cell but at a view itself: gloss is reciprocal only so far (nappa: 0.017)
        assert np.median(np.abs(f - f.T) / (f + f.T)) < 0.02, name


def test_every_material_answers_the_same_questions():
    """A table of a constant, a Lambertian and a mirror of one albedo reflect as much of light from all sides."""
    value = np.array([0.5, 0.25, 0.1])
    table = constant("felt/one", value)
    for material in (table, Lambertian("l", value), Mirror("m", value)):
        np.testing.assert_allclose(material.diffuse_albedo(), value, rtol=1e-6)
        np.testing.assert_allclose(material.directional_albedo() - value, 0, atol=1e-6)
        mean = material.mean_material()
        assert not mean.has_texture and not mean.lines_up and not material.lines_up
        np.testing.assert_allclose(mean.diffuse_albedo(), value, rtol=1e-6)
    assert table.has_texture
    # laid once, on half of its texels: their mean counts, not that of all
    laid = replace(
        table, texels=np.arange(24, dtype=np.float32).reshape(4, 6, 1), laid_mean=np.full(1, 2.0, np.float32)
    )
    assert laid.lines_up and not laid.mean_material().lines_up
    for material in (laid, laid.mean_material()):
        np.testing.assert_allclose(material.diffuse_albedo(), 2 * value, rtol=1e-6)
