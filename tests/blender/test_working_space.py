# SPDX-License-Identifier: GPL-3.0-or-later
"""A file whose working space is not linear Rec.709 (Blender 5): what goes out is Rec.709, what comes in its own."""

import bpy
import numpy as np
import pytest

from blender_btfsep.basics import pixels

RED = np.array([0.6131, 0.0702, 0.0206])  # of Rec.709, in ACEScg: the published matrix's first column
ORANGE = np.array([0.8, 0.2, 0.1])

pytestmark = pytest.mark.skipif(not hasattr(bpy.data, "colorspace"), reason="this Blender has one working space")


@pytest.fixture
def acescg(scene):
    bpy.ops.wm.set_working_color_space(working_space="ACEScg")
    assert bpy.data.colorspace.working_space == "ACEScg"
    yield scene
    bpy.ops.wm.read_factory_settings(use_empty=True)


def codes_of(path):
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    colour = pixels.colours(image)[0, 0].copy()
    bpy.data.images.remove(image)
    return colour


def test_world_and_lamps(acescg):
    from blender_btfsep.light import light_files, sh_nodes, sun_lamp, world

    suns = {"lamps": [{"direction": [0, 0, 1], "irradiance": [2.0, 0, 0], "size_degrees": 1.0}], "sky": [[1.0, 0, 0]]}
    world.apply_lighting(acescg, {"order": 0, "coefficients": [[2.0, 0, 0]], "suns": suns})
    node = sh_nodes.node_of(acescg.world.node_tree)
    assert np.allclose(node.inputs["Y 0 0"].default_value, RED, atol=1e-4)
    (lamp,) = sun_lamp.lamps(acescg)
    assert np.allclose(lamp.data.energy * np.array(lamp.data.color), 2 * RED, atol=1e-4)
    radiance, (found,) = light_files.of_world(acescg)
    assert np.allclose(radiance, np.array([0.2821, 0, 0]), atol=1e-3) and np.allclose(
        found["irradiance"], [2, 0, 0], atol=1e-3
    )


@pytest.mark.parametrize("kind", ["byte", "float"])
def test_a_packed_photo(acescg, tmp_path, kind):
    from blender_btfsep.basics import colour
    from blender_btfsep.photo import photo

    image = bpy.data.images.new("photo", 4, 2, float_buffer=kind == "float")
    image.pixels.foreach_set(np.tile(np.float32([*ORANGE, 1]), 8))
    image.pack()
    put = photo.put_into_job(image, tmp_path)
    known, stored = ("linear", colour.to_rec709(ORANGE)) if kind == "float" else ("auto", ORANGE)
    assert put.colorspace == known and np.allclose(codes_of(tmp_path / put.name), stored, atol=3e-3)


def test_colours_of_materials_and_maps(acescg, tmp_path):
    from blender_btfsep.light import light_files
    from blender_btfsep.scene import surroundings

    material = bpy.data.materials.new("Red")
    material.use_nodes = True
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = (*RED, 1)
    surface = surroundings.surface_of({material: 1.0}, lambda sentence: None)
    assert np.allclose(surface["base_color"], [1, 0, 0], atol=1e-3)
    image = pixels.new("map", np.full((8, 16, 3), ORANGE))
    light_files._save_map(image, tmp_path / "map.exr")
    assert np.allclose(codes_of(tmp_path / "map.exr"), ORANGE, atol=1e-4)
    assert np.allclose(light_files.read(tmp_path / "map.exr", 0)["map"], ORANGE, atol=2e-3)
