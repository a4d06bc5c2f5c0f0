# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands in the add-on and in the engine alike, since neither imports the other: held together here."""

import bpy
import numpy as np
import pytest

from blender_btfsep import command, engine_process, frames, lighting_file, measure, photo, properties, sh_nodes
from btfsep_engine.btf import linear, map_files
from btfsep_engine.cli import command as engine_command
from btfsep_engine.images import read_linear
from btfsep_engine.job.schema import JobSchema
from btfsep_engine.light import files
from btfsep_engine.light.sun import Sun
from btfsep_engine.pipeline import measuring, sequence, settings


@pytest.mark.parametrize("order", [0, files.MAX_ORDER])
def test_every_lighting_that_the_engine_writes_is_read(tmp_path, order):
    rng = np.random.default_rng(order)
    x = rng.normal(size=((order + 1) ** 2, 3))
    sun = Sun((0, 0.6, 0.8), (3, 2, 1), (0.1, 0.1, 0.1), size_degrees=0.5)
    lamp = Sun((0, 0, -1), (1, 1, 1), (0.1, 0.1, 0.1), size_degrees=5)
    light = files.Lighting(
        order, x, np.abs(x), rng.random(len(x)) < 0.5, exposure_ev=-1.5, suns=(lamp, sun), interval=(x - 1, x + 1)
    )
    files.write_lighting(tmp_path / "lighting.json", light)
    read = lighting_file.read(tmp_path / "lighting.json")
    assert np.array_equal(read["coefficients"], x) and np.array_equal(read["stddev"], np.abs(x))
    assert np.array_equal(read["determined"], light.determined) and read["exposure_ev"] == -1.5
    assert [s["size_degrees"] for s in read["suns"]["lamps"]] == [0.5, 5] and len(light.suns) == 2
    assert np.allclose(read["suns"]["lamps"][0]["direction"], sun.direction)
    assert np.array_equal(read["suns"]["sky"], light.sky)


def test_orders_and_lamps():
    assert (lighting_file.MAX_ORDER, lighting_file.MOST_LAMPS) == (files.MAX_ORDER, files.MOST_LAMPS)
    assert sh_nodes.MAX_NODE_ORDER >= settings.LARGEST_ORDER  # what is estimated can be nodes


def test_the_panel_offers_what_the_engine_takes(addon):
    panel = bpy.types.Scene.bl_rna.properties["btfsep"].fixed_type.properties
    assert panel["order"].hard_max == settings.LARGEST_ORDER
    assert [name for name, *_ in properties.PRESETS] == list(settings.PRESETS)
    for name, *_ in properties.APPEARANCES:
        assert settings.choose(appearance=name).appearance == name


def test_material_classes_and_the_limits_of_a_measurement(addon):
    assert measure.CLASSES_OF_MATERIAL == linear.CLASSES
    asked = bpy.ops.btfsep.measure_material.get_rna_type().properties
    for name in ("texels", "samples"):
        assert asked[name].hard_max == settings.meanings(measuring.MeasureSettings)[name].high


def test_the_files_of_photos(scene, tmp_path):
    """One list on both sides; and what Blender saves under each of its names, the engine reads."""
    assert frames.SUFFIXES == sequence.SUFFIXES and photo.READABLE == set(frames.SUFFIXES) == set(map_files.SUFFIXES)
    formats = {".exr": "OPEN_EXR", ".hdr": "HDR", ".png": "PNG", ".jpg": "JPEG", ".tif": "TIFF", ".webp": "WEBP"}
    for suffix, kind in formats.items():
        image = bpy.data.images.new("Made", 8, 4, float_buffer=suffix in photo.FLOAT)
        image.generated_color = (0.5, 0.5, 0.5, 1)  # sRGB, in a float image too
        image.filepath_raw, image.file_format = str(tmp_path / f"a{suffix}"), kind
        image.save()
        found = read_linear(tmp_path / f"a{suffix}").pixels
        assert found.shape == (4, 8, 3) and np.allclose(found, ((0.5 + 0.055) / 1.055) ** 2.4, atol=0.01), suffix


def test_the_words_of_the_contract():
    assert (lighting_file.FORMAT, lighting_file.VERSION) == tuple(
        files.LightingSchema.model_json_schema()["properties"][key]["const"] for key in ("format", "version")
    )
    assert engine_process.INPUT_FAULT == command.INPUT_FAULT == engine_command.INPUT_FAULT
    assert engine_process.BUG == command.BUG == engine_command.BUG
    spaces = JobSchema.model_json_schema()["properties"]["image_colorspace"]["enum"]
    assert {"auto", "linear"} <= set(spaces)  # what photo.put gives
    assert {name for name, *_ in properties.CURVES} == set(spaces)
