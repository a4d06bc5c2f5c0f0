# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands in the add-on and in the engine alike, since neither imports the other: held together here."""

import ast
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

import btfsep_engine
from blender_btfsep import command
from blender_btfsep.engine import engine_process, engine_settings
from blender_btfsep.light import advice, lighting_file, sh_nodes
from blender_btfsep.photo import frames, photo, photo_file
from blender_btfsep.run import request
from blender_btfsep.scene import ground_plane
from blender_btfsep.window import known_suns, mending, properties
from btfsep_engine.btf import linear
from btfsep_engine.cli import command as engine_command
from btfsep_engine.cli.commands import cli
from btfsep_engine.commands import measure as measuring
from btfsep_engine.commands import sequence
from btfsep_engine.imaging import images, local_tones
from btfsep_engine.imaging.colour_profile import PRIMARIES
from btfsep_engine.imaging.images import read_linear
from btfsep_engine.job.schema import MAX_KNOWN_LAMPS, JobSchema
from btfsep_engine.light import files
from btfsep_engine.light.sun import Sun
from btfsep_engine.pipeline import settings, standing
from tests.engine.profiles import tiff
from tests.engine.test_camera_curve import exif, with_exif
from tests.engine.test_image_kinds import turned


@pytest.mark.parametrize("order", [0, files.MAX_ORDER])
def test_every_lighting_that_the_engine_writes_is_read(tmp_path, order):
    rng = np.random.default_rng(order)
    x = rng.normal(size=((order + 1) ** 2, 3))
    sun = Sun((0, 0.6, 0.8), (3, 2, 1), (0.1, 0.1, 0.1), size_degrees=0.5)
    lamp = Sun((0, 0, -1), (1, 1, 1), (0.1, 0.1, 0.1), size_degrees=5)
    light = files.Lighting(
        order,
        x,
        np.abs(x),
        rng.random(len(x)) < 0.5,
        exposure_ev=-1.5,
        suns=(lamp, sun),
        interval=(x - 1, x + 1),
        pattern=(x - 1, x, x, x + 1),
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


TABLES = {**engine_settings.COMMANDS, "measure": engine_settings.MEASURE}
ROWS = [pytest.param(name, row, id=f"{name} {row.name}") for name, rows in TABLES.items() for row in rows]


def engine_option(command_name, row):
    """The engine's option that a row names."""
    command = cli.get_command(None, command_name) or cli.get_command(None, "library").get_command(None, command_name)
    return next(p for p in command.params if row.flag in p.opts)


@pytest.mark.parametrize(("command_name", "row"), ROWS)
def test_a_row_says_of_a_setting_what_the_engine_says(command_name, row):
    kind = measuring.MeasureSettings if command_name == "measure" else settings.Settings
    option, meaning = engine_option(command_name, row), settings.meanings(kind).get(row.name)
    assert option.is_flag == (row.kind is bool) and option.required == row.required
    if meaning is None:
        assert row.name in ("preset", "material_class", "size_mm", "replace")
        return
    assert [value for value, *_ in row.items] == list(meaning.choices) and (row.items or row.kind is meaning.kind)
    assert bool(row.auto) == ("auto" in (option.metavar or "")) or row.items
    if row.default is not None:
        assert row.default in (getattr(kind(), row.name), row.unsaid)
        assert row.high == meaning.high and row.low in (meaning.low, row.unsaid)


def said_by(tree):
    """The strings of a Python file, what stands in braces as {}."""
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


@pytest.mark.parametrize("known", advice.KNOWN, ids=lambda known: known.phrase)
def test_every_doubt_that_the_panel_knows_is_said_by_the_engine(known):
    files = sorted(Path(btfsep_engine.__file__).parent.rglob("*.py"))
    assert any(known.phrase in text for path in files for text in said_by(ast.parse(path.read_text())))
    assert (
        known.mend in {"", "ALIGN", "UPRIGHT", "MASK", "FREEZE", *(name for name, *_ in mending.MENDS)}
        and known.level in advice.LEVELS
    )
    assert advice.advice(f"object 'Cow' {known.phrase} and more").phrase == known.phrase


def test_presets_and_material_classes():
    assert [value for value, *_ in engine_settings.PRESETS] == list(settings.PRESETS)
    assert engine_settings.CLASSES_OF_MATERIAL == linear.CLASSES
    for size in (0.1, 40, 40.3, 66.6, 80, 10_000):
        assert engine_settings.default_texels(size) == measuring.default_texels(size)


def test_the_time_of_a_measurement_is_said_in_words():
    words = engine_settings.measuring_words
    assert words(30, 0, 1, 2) == "80 x 80 texels: about 20 seconds"
    assert words(30, 0, 1, 64) == "80 x 80 texels: about 10 seconds"
    assert words(100, 0, 4, 2) == "160 x 160 texels: about 5 minutes"
    assert words(100, 1024, 16, 2) == "1024 x 1024 texels: about 14.6 hours"


@pytest.mark.parametrize(("command_name", "row"), ROWS)
def test_every_row_is_a_property_and_an_option_and_reaches_the_engine(addon, command_name, row):
    panel = bpy.types.Scene.bl_rna.properties["btfsep"].fixed_type.properties
    owner = bpy.ops.btfsep.measure_material.get_rna_type().properties if command_name == "measure" else panel
    if row.default is not None:
        shown = owner[row.name]
        assert (shown.name, shown.description) == (row.label, row.description)
        assert [i.identifier for i in shown.enum_items] == [i[0] for i in row.items] if row.items else True
        assert row.high is None or (shown.hard_min, shown.hard_max) == (pytest.approx(row.low), row.high)
    value = row.items[-1][0] if row.items else str(row.high or 2)
    words = {r.name: (r.flag, r.items[0][0] if r.items else "2") for r in TABLES[command_name] if r.required}
    words[row.name] = (row.flag,) if row.kind is bool else (row.flag, value)
    options = command._parser().parse_args([command_name, *[word for pair in words.values() for word in pair]])
    told = [str(word) for word in engine_settings.engine_options([row], None, options)]
    assert told[0] == row.flag and (
        row.kind is bool or row.kind(told[1]) == row.kind(value) if not row.items else told[1] == value
    )


def test_a_ground_is_as_large_in_the_scene_as_in_the_engine():
    assert ground_plane.REACH == standing.REACH


def test_of_things_that_stand_alone_no_ground_is_looked_for(photographed):
    photographed.btfsep.occluders = "NONE"
    for name in ("estimate", "sequence"):
        assert request.engine_arguments(name, "job", photographed)[-2:] == ["--evidence", "job"]
    assert "--evidence" not in request.engine_arguments("recognise", "job", photographed)
    said = SimpleNamespace(evidence="all")
    assert request.engine_arguments("estimate", "job", photographed, options=said).count("--evidence") == 1
    photographed.btfsep.occluders = "OTHERS"
    assert "--evidence" not in request.engine_arguments("estimate", "job", photographed)
    told = request.engine_arguments("estimate", "job", photographed, options=SimpleNamespace(occluders="none"))
    assert told[-2:] == ["--evidence", "job"]


def test_what_the_panel_leaves_to_the_engine_is_not_said(photographed):
    panel = photographed.btfsep
    told = request.engine_arguments("estimate", "job", photographed)
    assert told == ["estimate", "job", "--preset", "balanced", "--order", 4]
    panel.preset, panel.auto_order, panel.appearance, panel.delight = "draft", True, "mean", "never"
    rest = ["--preset", "draft", "--order", "auto", "--appearance", "mean", "--delight", "never"]
    assert request.engine_arguments("estimate", "job", photographed) == ["estimate", "job", *rest]
    assert request.engine_arguments("sequence", "job", photographed)[-2:] == ["--delight", "never"]
    assert "auto" not in request.engine_arguments("sequence", "job", photographed)  # one order for all of its frames
    assert request.engine_arguments("recognise", "job", photographed)[2:] == ["--preset", "draft"]
    options = command._parser().parse_args(["estimate", "--appearance", "auto", "--order", "0", "--delight", "auto"])
    told = request.engine_arguments("estimate", "job", photographed, options=options)
    rest = ["--preset", "draft", "--order", 0, "--appearance", "auto", "--delight", "auto"]
    assert told[2:] == rest  # said where it was typed


def test_the_files_of_photos(scene, tmp_path):
    """One list on both sides; and what Blender saves under each of its names, the engine reads."""
    assert frames.SUFFIXES == images.SUFFIXES
    formats = {".exr": "OPEN_EXR", ".hdr": "HDR", ".png": "PNG", ".jpg": "JPEG", ".tif": "TIFF", ".webp": "WEBP"}
    for suffix, kind in formats.items():
        image = bpy.data.images.new("Made", 8, 4, float_buffer=suffix in photo.FLOAT)
        image.generated_color = (0.5, 0.5, 0.5, 1)  # sRGB, in a float image too
        image.filepath_raw, image.file_format = str(tmp_path / f"a{suffix}"), kind
        image.save()
        found = read_linear(tmp_path / f"a{suffix}").pixels
        assert found.shape == (4, 8, 3) and np.allclose(found, ((0.5 + 0.055) / 1.055) ** 2.4, atol=0.01), suffix


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".tif"])
def test_how_a_photo_is_to_be_turned(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    for number in (1, 3, 6, 8):
        tag = {274: (3, 1, number.to_bytes(2, "little"))}
        picture = np.full((6, 8, 3), 90, np.uint8)
        path.write_bytes(tiff(picture, tag) if suffix == ".tif" else with_exif(suffix, turned(number)))
        assert photo_file.facts_of(path).orientation == images.orientation(path) == number
        assert photo_file.facts_of(path.read_bytes()).orientation == number
    whole = path.read_bytes()
    for end in range(1, len(whole), 3):
        path.write_bytes(whole[:end])
        assert photo_file.facts_of(path).orientation in (1, 8) and images.orientation(path) in (1, 8)
    path.unlink()
    assert photo_file.facts_of(path).orientation == 1


def test_the_primaries_that_photos_have():
    assert {*photo.CODED.values()} - {"auto"} <= PRIMARIES.keys()


def test_the_frames_of_a_pattern_have_one_order(tmp_path):
    for name in (
        "b_2.exr",
        "a_10.exr",
        "a_9.png",
        "A 3.tiff",
        "a².hdr",
        "still.webp",
        "t12 1.jpg",
        "t2 5.jpeg",
        "a_9.txt",
    ):
        (tmp_path / name).touch()
    found = frames.matching(tmp_path / "*")
    assert found == sequence.frame_files(tmp_path / "*") and len(found) == 8
    assert [p.name for p in found if p.stem.startswith("a_")] == ["a_9.png", "a_10.exr"]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("maker", "model", "is_phone"), [
    ("Apple", "iPhone 13", True), ("samsung", "SM-G991B", True), ("SAMSUNG", "NX500", False), ("LGE", "G6", True),
    ("OnePlus", "ONEPLUS A6013", True), ("NIKON CORPORATION", "NIKON D750", False), ("Applesauce", "1", False),
    ("Canon", "Canon EOS 6D", False), ("HMD Global", "Nokia 7", True),
])  # fmt: skip
def test_a_phone_is_one_to_both(tmp_path, maker, model, is_phone, order):
    assert photo_file.PHONES == local_tones.MAKERS
    for suffix in (".jpg", ".png", ".webp"):
        path = tmp_path / f"a{suffix}"
        path.write_bytes(with_exif(suffix, exif(maker, model, order)))
        told = local_tones.is_phone(images.read_linear(path).camera)
        assert photo_file.facts_of(path).is_by_phone == told == is_phone
        assert photo_file.facts_of(path).is_by_camera


def test_the_words_of_the_contract():
    assert (lighting_file.FORMAT, lighting_file.VERSION) == tuple(
        files.LightingSchema.model_json_schema()["properties"][key]["const"] for key in ("format", "version")
    )
    assert engine_process.INPUT_FAULT == engine_command.INPUT_FAULT
    assert engine_process.BUG == engine_command.BUG
    assert known_suns.MOST == MAX_KNOWN_LAMPS
    spaces = JobSchema.model_json_schema()["properties"]["image_colorspace"]["enum"]
    assert {"auto", "linear"} <= set(spaces)  # what photo.put_into_job gives
    assert {name for name, *_ in properties.CURVES} == set(spaces)
