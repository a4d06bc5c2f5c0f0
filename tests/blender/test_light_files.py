# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights from and for other programs: against the engine's own reading, closed forms, and Cycles."""

import json
import re
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from blender_btfsep import command
from blender_btfsep.basics import harmonics, pixels
from blender_btfsep.basics.errors import InputError
from blender_btfsep.light import light_files, sh_nodes, sun_lamp, world
from blender_btfsep.window import importer
from btfsep_engine import conventions, sh
from btfsep_engine.imaging import images
from btfsep_engine.light.files import Lighting, read_lighting, write_lighting
from btfsep_engine.light.sun import Near, Sun
from tests.blender.lit import look_around, positive_coefficients
from tests.blender.sunny import write_sunny

LAMP = {"direction": [0.6, -0.48, 0.64], "irradiance": [3.0, 2.0, 1.0], "size_degrees": 3.0}


def write_map(path, radiance):
    image = pixels.new("map", radiance[::-1])
    light_files._save_map(image, path)
    bpy.data.images.remove(image)


def changed(scene, tmp_path):
    """A scene with sky and lamp, turned, tinted, stronger; gives the map of its sky and its lamp as they have to be."""
    c = positive_coefficients(3, seed=8)
    path = tmp_path / "light.json"
    write_sunny(path, order=3, direction=LAMP["direction"], irradiance=LAMP["irradiance"], size=3.0, sky=c)
    world.apply_lighting(scene, light_files.read(path))
    inputs = sh_nodes.node_of(scene.world.node_tree).inputs
    inputs["Strength"].default_value, inputs["Rotation"].default_value = 2.0, 0.7
    inputs["Tint"].default_value = (1.0, 0.5, 0.25, 1)
    turn = np.array(Matrix.Rotation(0.7, 3, "Z"))
    sky = 2 * (sh.rotation_matrix(3, turn) @ c) * [1, 0.5, 0.25]
    return sky, LAMP | {"direction": (turn @ LAMP["direction"]).tolist()}


def test_what_was_changed_is_exported_and_comes_back(addon, scene, tmp_path):
    sky, lamp = changed(scene, tmp_path)
    out = tmp_path / "out.btfsep"
    assert bpy.ops.btfsep.export_lighting(filepath=str(out), order=3) == {"FINISHED"}
    light = read_lighting(out)  # the engine's: refuses what does not add up
    assert np.allclose(light.sky, sky, atol=5e-3 * np.abs(sky).max())
    (sun,) = light.suns
    assert np.allclose(sun.direction, lamp["direction"], atol=1e-5) and np.allclose(sun.irradiance, lamp["irradiance"])
    assert sun.size_degrees == pytest.approx(3)
    world.restore_previous(scene)
    assert bpy.ops.btfsep.import_lighting(filepath=str(out)) == {"FINISHED"}
    (made,) = sun_lamp.lamps(scene)
    bpy.context.view_layer.update()
    assert np.allclose(np.array(made.matrix_world)[:3, 2], lamp["direction"], atol=1e-5)


@pytest.mark.parametrize("suffix", [".exr", ".hdr"])
def test_a_map_has_the_sky_and_the_lamp(scene, tmp_path, suffix):
    sky, lamp = changed(scene, tmp_path)
    light_files.write(tmp_path / f"map{suffix}", scene)
    found = images.read_linear(tmp_path / f"map{suffix}").pixels
    truth = sh.to_map(sky, 256, 512)
    away = (conventions.pixel_directions(256, 512) @ lamp["direction"]) < 0.99
    assert np.abs(found - truth)[away].max() < (0.02 if suffix == ".hdr" else 2e-3) * truth.max()
    d, area = conventions.pixel_directions(256, 512), conventions.pixel_solid_angles(256, 512)[:, None]
    received = np.maximum(d @ lamp["direction"], 0) * area * ~away
    assert np.allclose(((found - truth) * received[..., None]).sum((0, 1)), lamp["irradiance"], rtol=0.02)


@pytest.mark.parametrize("mode", ["NODES", "as in the file"])
def test_a_map_is_imported(addon, scene, render, tmp_path, mode):
    look_around(scene)
    c = positive_coefficients(4, seed=2)
    write_map(tmp_path / "sky.exr", sh.to_map(c, 128, 256))
    bpy.ops.btfsep.import_lighting(filepath=str(tmp_path / "sky.exr"), **({"mode": mode} if mode == "NODES" else {}))
    assert (coefficient_of(scene, 0) is None) == (mode != "NODES")
    truth = sh.to_map(c, 64, 128)
    assert np.abs(render(scene) - truth).max() < 0.02 * truth.max()
    if mode == "NODES":
        group = sh_nodes.node_of(scene.world.node_tree)
        found = np.array([group.inputs[harmonics_name(k)].default_value[:] for k in range(25)])
        assert np.allclose(found, sh.project_map(sh.to_map(c, 128, 256), 4), atol=1e-4 * np.abs(c).max())


def coefficient_of(scene, k):
    """The input of a coefficient in the World; None where it is a map."""
    return sh_nodes.node_of(scene.world.node_tree).inputs.get(harmonics_name(k))


def harmonics_name(k):
    l = int(np.sqrt(k))
    return sh_nodes.coefficient_name(l, k - l * l - l)


def test_what_cmgen_writes_for_a_shader(scene, tmp_path):
    """Radiance 1 + y, Y up, is an irradiance over pi of 1 + 2/3 y: the polynomial of Filament's shaders."""
    rows = [1, 2 / 3, 0, 0, 0, 0, 0, 0, 0]
    names = ["00", "1-1", "10", "11", "2-2", "2-1", "20", "21", "22"]
    text = "".join(
        f"({v}, {2 * v},  0.0); // L{n}, irradiance, pre-scaled base\n" for v, n in zip(rows, names, strict=True)
    )
    (tmp_path / "sh.txt").write_text(text)
    c = np.array(light_files.read(tmp_path / "sh.txt")["coefficients"])
    z = conventions.pixel_directions(32, 64)[..., 2:]
    assert np.allclose(sh.to_map(c, 32, 64), (1 + z) * [1, 2, 0], atol=1e-6)


@pytest.mark.parametrize("kind", ["", ", irradiance"])
def test_text_comes_back(scene, tmp_path, kind):
    c = positive_coefficients(2, seed=5)
    world.apply_lighting(scene, {"order": 2, "coefficients": c.tolist()})
    light_files.write(tmp_path / "sh.txt", scene, order=2)
    text = (tmp_path / "sh.txt").read_text()
    assert text.splitlines()[1].endswith("// L1-1")
    # +Y of the file is up: the coefficient of y there is that of z here, with the basis's other sign
    assert np.allclose([float(v) for v in text.splitlines()[1][1:].split(")")[0].split(",")], -c[2], atol=2e-3)
    if kind:
        over_pi = [1] + [2 / 3] * 3 + [1 / 4] * 5
        lines = [line.split(")") for line in text.splitlines()]
        (tmp_path / "sh.txt").write_text(
            "".join(
                "(" + ", ".join(str(f * float(v)) for v in a[1:].split(",")) + ")" + b + kind + "\n"
                for f, (a, b) in zip(over_pi, lines, strict=True)
            )
        )
    assert np.allclose(light_files.read(tmp_path / "sh.txt")["coefficients"], c, atol=2e-3 * np.abs(c).max())


@pytest.mark.skipif(not bpy.app.build_options.usd, reason="this Blender has no USD")
def test_usd_is_the_same_light_when_blender_reads_it(scene, render, tmp_path):
    sky, lamp = changed(scene, tmp_path)
    before = {kind: len(getattr(bpy.data, kind)) for kind in ("worlds", "scenes", "images", "lights", "objects")}
    light_files.write(tmp_path / "light.usda", scene)
    assert before == {kind: len(getattr(bpy.data, kind)) for kind in before}
    bpy.ops.wm.read_factory_settings(use_empty=True)
    fresh = bpy.context.scene
    fresh.world = bpy.data.worlds.new("World")  # without one Blender makes none of a dome
    bpy.ops.wm.usd_import(filepath=str(tmp_path / "light.usda"), create_world_material=True)
    (sun,) = (o for o in fresh.objects if o.type == "LIGHT")
    assert np.allclose(np.array(sun.matrix_world)[:3, 2], lamp["direction"], atol=1e-4)
    assert np.allclose(sun.data.energy * np.array(sun.data.color), lamp["irradiance"], rtol=1e-3)
    bpy.data.objects.remove(sun)
    fresh.render.engine, fresh.cycles.device = "CYCLES", "CPU"
    fresh.render.image_settings.file_format = "OPEN_EXR"
    look_around(fresh)
    truth = sh.to_map(sky, 64, 128)
    away = (conventions.pixel_directions(64, 128) @ lamp["direction"]) < 0.98
    error = np.where(away[..., None], np.abs(render(fresh) - truth), 0)
    assert error[1:-1, 1:-1].max() < 0.04 * truth.max()  # at the seam and the poles the reader looks beside the map


@pytest.mark.skipif(not bpy.app.build_options.usd, reason="this Blender has no USD")
@pytest.mark.parametrize("size", [0.0, 8.0])
def test_a_lamp_nearby_is_a_sphere_light_at_its_place(scene, tmp_path, size):
    """It is where it stood, as strong by UsdLux's own formula, and as strong when Blender reads it."""
    centre, distance, direction = np.array([0.3, -0.2, 0.5]), 2.5, np.array(LAMP["direction"])
    strength = np.array(LAMP["irradiance"])
    known = Sun(direction, strength, np.zeros(3), size_degrees=size, near=Near(centre, distance, 2.0, 3.0))
    whole = positive_coefficients(3, seed=8) + known.coefficients(3)
    light = Lighting(3, whole, np.zeros_like(whole), np.ones(16, bool), 0.0, (known,))
    write_lighting(tmp_path / "near.json", light)
    world.apply_lighting(scene, light_files.read(tmp_path / "near.json"))
    scene.view_layers[0].update()
    light_files.write(tmp_path / "light.usda", scene)
    text = (tmp_path / "light.usda").read_text()
    assert text.count("def SphereLight") == 1 and "def DistantLight" not in text and "normalize = 1" in text
    written = text[text.index("def SphereLight") :]
    told = {k: float(re.search(rf"inputs:{k} = (\S+)", written)[1]) for k in ("intensity", "radius")}
    assert told["radius"] == pytest.approx(distance * max(np.tan(np.radians(size / 2)), 0.01), rel=1e-4)
    # UsdLux: radiance is intensity over the sphere's area; a sphere of it shines pi radius^2 / distance^2 of it
    radiance = told["intensity"] / (4 * np.pi * told["radius"] ** 2)
    assert radiance * np.pi * (told["radius"] / distance) ** 2 == pytest.approx(strength.max(), rel=1e-3)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=str(tmp_path / "light.usda"))
    (lamp,) = (o for o in bpy.context.scene.objects if o.type == "LIGHT")
    assert lamp.data.type == "POINT"
    assert np.allclose(lamp.matrix_world.translation, centre + distance * direction, atol=1e-4)
    found = lamp.data.energy * np.array(lamp.data.color) / (4 * np.pi * distance**2)
    assert np.allclose(found, strength, rtol=1e-3)


def test_faults_are_in_words(addon, scene, tmp_path):
    write_map(tmp_path / "square.exr", np.ones((8, 8, 3)))
    (tmp_path / "none.txt").write_text("nothing")
    (tmp_path / "half.txt").write_text("(1, 1, 1); // L00\n(1, 1, 1); // L1-1\n")
    (tmp_path / "high.txt").write_text("(1, 1, 1); // L30, irradiance\n")
    (tmp_path / "words.txt").write_text("(a, b, c); // L00\n")
    (tmp_path / "bad.exr").write_bytes(b"no picture")
    for name, words in {
        "square.exr": "twice as wide as high",
        "none.txt": "there are no lines as",
        "half.txt": "2 coefficients, not all of an order",
        "high.txt": "irradiance of order 3 says nothing",
        "words.txt": "are not three numbers",
        "bad.exr": "no pixels",
        "absent.txt": "No such file",
        "absent.hdr": "absent.hdr",
    }.items():
        with pytest.raises(RuntimeError, match=words):
            bpy.ops.btfsep.import_lighting(filepath=str(tmp_path / name))
    assert not bpy.data.worlds and not bpy.data.images
    assert not bpy.ops.btfsep.export_lighting.poll()
    with pytest.raises(InputError, match="none of BTFsep's"):
        light_files.write(tmp_path / "x.json", scene)
    with pytest.raises(InputError, match="no format has this suffix"):
        light_files.write(tmp_path / "x.jpg", scene)


def test_only_files_of_our_own_are_claimed_when_dropped(addon):
    assert importer.BTFSEP_FH_lighting.bl_file_extensions == ".btfsep"


def test_the_name_without_a_suffix_gets_the_formats(addon, scene, tmp_path):
    world.apply_lighting(scene, {"order": 1, "coefficients": positive_coefficients(1).tolist()})
    assert bpy.ops.btfsep.export_lighting(filepath=str(tmp_path / "light"), format=".json") == {"FINISHED"}
    assert json.loads((tmp_path / "light.json").read_text())["order"] == 4
    assert harmonics.order_of(25) == 4
    kept = (tmp_path / "light.json").read_bytes()
    with pytest.raises(RuntimeError, match="it is there already"):  # nobody was asked: it may be the photo
        bpy.ops.btfsep.export_lighting(filepath=str(tmp_path / "light"), format=".json", order=1)
    assert (tmp_path / "light.json").read_bytes() == kept
    assert bpy.ops.btfsep.export_lighting(filepath=str(tmp_path / "light.json"), order=1) == {"FINISHED"}


def test_a_light_is_written_in_its_own_order_where_none_is_said(addon, scene, tmp_path):
    out = tmp_path / "light.json"

    def written(*options):
        assert command.main(["light", str(out), *options]) == 0
        return json.loads(out.read_text())["order"]

    world.apply_lighting(scene, {"order": 6, "coefficients": positive_coefficients(6).tolist()})
    assert written() == 6 and written("--order", "2") == 2
    assert bpy.ops.btfsep.export_lighting(filepath=str(out)) == {"FINISHED"}
    assert json.loads(out.read_text())["order"] == 6


def test_the_file_browser_shows_the_name_that_is_written(addon):
    """Else it cannot warn of a file that is there."""
    check, shown = importer.BTFSEP_OT_export_lighting.check, SimpleNamespace(filepath="/a/photo", format=".json")
    assert check(shown, None) and shown.filepath == "/a/photo.json" and not check(shown, None)
    shown.format = ".exr"
    assert check(shown, None) and shown.filepath == "/a/photo.exr"
    shown.filepath = "/a/light.v2.HDR"
    assert check(shown, None) and (shown.filepath, shown.format) == ("/a/light.v2.hdr", ".hdr")
    shown.filepath = "/a/light.v2"
    assert check(shown, None) and (shown.filepath, shown.format) == ("/a/light.v2.hdr", ".hdr")


def test_the_photo_is_not_written_over(photographed):
    world.apply_lighting(photographed, {"order": 1, "coefficients": positive_coefficients(1).tolist()})
    photo = photographed.btfsep.image
    photo.filepath_raw = photo.filepath_raw.replace(".png", ".exr")
    with pytest.raises(RuntimeError, match="it is the photo"):
        bpy.ops.btfsep.export_lighting(filepath=photo.filepath_raw)


def test_another_light_takes_what_the_last_run_said_from_the_panel(photographed, sunny):
    state = bpy.context.window_manager.btfsep
    steps = {
        "import": lambda: bpy.ops.btfsep.import_lighting(filepath=str(sunny[0])),
        "apply": bpy.ops.btfsep.apply,
        "restore": bpy.ops.btfsep.restore_world,
    }
    for step in steps.values():
        state.error, state.warnings.add().name = "the mask 'a'; it is black everywhere; paint it", "odd"
        assert step() == {"FINISHED"} and not state.error and not state.warnings
    state.error = "still true"
    with pytest.raises(RuntimeError):
        bpy.ops.btfsep.import_lighting(filepath="/nowhere.json")
    assert state.error == "still true"
