# SPDX-License-Identifier: GPL-3.0-or-later
"""What the job says of the surfaces that stand around the objects, and what of the scene is no occluder at all."""

import json

import bpy
import numpy as np
import pytest
import trimesh

from blender_btfsep.light import card
from blender_btfsep.scene import export, surroundings
from scripts.cycles import materials
from tests.blender.found import lighting
from tests.blender.test_export import add_cube, make_photo


@pytest.fixture
def exported(scene, tmp_path, add_camera):
    """exported() -> (surface by the mesh's file name, warnings) of all that stands beside a cube."""
    camera = add_camera(scene, (0, -6, 2))
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    thing, photo = add_cube("Thing"), make_photo(tmp_path)

    def run():
        warnings = []
        bpy.context.view_layer.update()
        given = {"image_path": photo, "camera": camera, "objects": [thing], "warn": warnings.append}
        job = json.loads(export.export_job(scene, tmp_path / "job", **given).read_text())
        return {o["mesh"]: o.get("surface") for o in job["occluders"]}, warnings

    return run


def material(name, kind="ShaderNodeBsdfPrincipled", **inputs):
    return materials.shaded(name, kind, **inputs)[0]


def floor(*made_of, name="Floor", **transform):
    thing = add_cube(name, **{"location": (0, 0, -2), **transform})
    for each in made_of:
        thing.data.materials.append(each)
    return thing


def image_of(colours, colorspace="sRGB"):
    made = bpy.data.images.new("Paint", 4, 2)
    made.colorspace_settings.name = colorspace
    rgba = np.ones((2, 4, 4), np.float32)
    rgba[:, :2, :3], rgba[:, 2:, :3] = colours
    made.pixels.foreach_set(rgba.ravel())
    return made


def test_numbers_of_principled_and_of_no_material(exported):
    paint = material("Paint", Base_Color=(0.6, 0.3, 0.1, 1), Roughness=0.4, Metallic=0.2, Specular_IOR_Level=0.25)
    paint.diffuse_color = (0, 1, 0, 1)  # of the viewport: not looked at
    floor(paint)
    add_cube("Bare", location=(3, 0, 0))
    surfaces, warnings = exported()
    found = surfaces["Floor.ply"]
    assert found["base_color"] == pytest.approx([0.6, 0.3, 0.1]) and found["roughness"] == pytest.approx(0.4)
    assert found["metallic"] == pytest.approx(0.2) and found["specular"] == pytest.approx(0.25)
    assert surfaces["Bare.ply"]["base_color"] == [0.8] * 3 and surfaces["Bare.ply"]["specular"] == 0
    assert not warnings


@pytest.mark.parametrize(("colorspace", "mean"), [("sRGB", 0.5 * (0.2140411 + 0.0512695)), ("Non-Color", 0.375)])
def test_the_mean_of_an_image_is_that_of_its_light(exported, colorspace, mean):
    painted = material("Painted")
    tree = painted.node_tree
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = image_of((0.5, 0.25), colorspace)
    shader = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")
    tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    floor(painted)
    surfaces, warnings = exported()
    assert surfaces["Floor.ply"]["base_color"] == pytest.approx([mean] * 3, abs=0.003) and not warnings


def test_several_materials_are_weighed_by_area(exported):
    red, white = material("Red", Base_Color=(0.8, 0, 0, 1)), material("White", Base_Color=(0.4, 0.4, 0.4, 1))
    thing = floor(red, white, scale=(2, 1, 1))  # faces of 4 along z and y, of 2 along x; units of area
    normals = np.array([p.normal[:] for p in thing.data.polygons])
    for face, normal in zip(thing.data.polygons, normals, strict=True):
        face.material_index = int(normal[2] > 0.5)  # the top: 8 of 40
    surfaces, _ = exported()
    assert surfaces["Floor.ply"]["base_color"] == pytest.approx([0.8 * 0.8 + 0.2 * 0.4, 0.08, 0.08])


def test_what_is_clear_or_is_not_understood_is_named(exported):
    floor(material("Pane", "ShaderNodeBsdfGlass"), name="Window", location=(3, 0, 0))
    floor(material("Clear", Transmission_Weight=1.0), name="Bottle", location=(-3, 0, 0))
    floor(material("Hair", "ShaderNodeBsdfHair"), name="Wig", location=(0, 0, 3))
    surfaces, warnings = exported()
    assert surfaces == {"Wig.ply": None}  # not known, not guessed
    for name, made_of in (("Window", "Pane"), ("Bottle", "Clear")):
        assert f"occluder '{name}' is left out, as light goes through material '{made_of}'" in warnings
    assert any("'Wig'" in w and "its colour is taken from the photo" in w for w in warnings) and len(warnings) == 3


def test_a_texture_that_is_gone_is_named(exported, tmp_path):
    own, shader = materials.shaded("Own", "ShaderNodeBsdfPrincipled")
    picture = own.node_tree.nodes.new("ShaderNodeTexImage")
    picture.image = bpy.data.images.new("planks", 4, 4)
    picture.image.source, picture.image.filepath = "FILE", str(tmp_path / "planks.png")
    own.node_tree.links.new(picture.outputs["Color"], shader.inputs["Base Color"])
    floor(own)
    surfaces, (warning,) = exported()
    assert surfaces == {"Floor.ply": None}
    assert warning.startswith("occluder 'Floor': the file of image 'planks' is not there; its colour is taken from the")


def test_of_an_image_of_tiles_all_count(exported, tmp_path):
    for number, value in ((1001, 0.0), (1002, 1.0)):
        tile = bpy.data.images.new("tile", 4, 4)
        tile.pixels.foreach_set([value, 0.0, 0.0, 1.0] * 16)
        tile.filepath_raw, tile.file_format = str(tmp_path / f"wall.{number}.png"), "PNG"
        tile.save()
        bpy.data.images.remove(tile)
    own, shader = materials.shaded("Own", "ShaderNodeBsdfPrincipled")
    picture = own.node_tree.nodes.new("ShaderNodeTexImage")
    picture.image = bpy.data.images.load(str(tmp_path / "wall.1001.png"))
    picture.image.source, picture.image.filepath = "TILED", str(tmp_path / "wall.<UDIM>.png")
    if len(picture.image.tiles) < 2:
        picture.image.tiles.new(1002)
    own.node_tree.links.new(picture.outputs["Color"], shader.inputs["Base Color"])
    floor(own)
    surfaces, warnings = exported()
    assert surfaces["Floor.ply"]["base_color"] == pytest.approx([0.5, 0, 0]) and not warnings
    assert len(bpy.data.images) == 1
    (tmp_path / "wall.1001.png").unlink()
    (tmp_path / "wall.1002.png").unlink()
    assert any("the file of image 'wall" in w for w in exported()[1])


def test_what_is_a_lamp_hides_no_light_and_what_glows_a_little_does(exported):
    """The light of a lamp comes from where it stands: the World has to have it there."""
    colours = {"Base_Color": (0.5, 0.5, 0.5, 1), "Emission_Color": (1, 0.5, 0.5, 1)}
    floor(material("Bright", Emission_Strength=5.0, **colours), name="Screen")
    floor(material("Tube", "ShaderNodeEmission"), name="Tube", location=(0, 3, 0))
    floor(material("Faint", Emission_Strength=0.2, **colours), name="Sign", location=(3, 0, 0))
    surfaces, warnings = exported()
    assert list(surfaces) == ["Sign.ply"] and surfaces["Sign.ply"]["base_color"] == pytest.approx([0.5] * 3)
    for name, made_of in (("Screen", "Bright"), ("Tube", "Tube")):
        assert any(w.startswith(f"occluder '{name}' is left out, as material '{made_of}' shines") for w in warnings)
    assert "occluder 'Sign': material 'Faint' shines, which is left out" in warnings and len(warnings) == 3


def test_what_is_left_out_is_said_on_the_card_with_what_to_do(exported):
    floor(material("Tube", "ShaderNodeEmission"), name="Softbox", location=(0, 3, 0))
    floor(material("Pane", "ShaderNodeBsdfGlass"), name="Window", location=(3, 0, 0))
    floor(material("Hair", "ShaderNodeBsdfHair"), name="Wig", location=(0, 0, 3))
    bpy.ops.mesh.primitive_uv_sphere_add(radius=20)
    bpy.context.object.name = "Dome"
    _, warnings = exported()
    shown = card.card_of({}, lighting(), warnings=warnings)["warnings"]
    assert [(doubt["short"].split(":")[0], doubt["mend"]) for doubt in shown] == [
        ("Softbox shines, and the World has its light, too", "SELECT"),
        ("Dome stands around all", ""),
        ("'Wig'", ""),
        ("Window is see-through, and keeps no light away here", ""),
    ]
    assert shown[0]["object"] == "Softbox" and all("ccluder" not in doubt["short"] for doubt in shown)
    assert all("hide it from renders" in doubt["short"] for doubt in shown[:2])


def test_panes_and_bulbs_of_what_stands_around_hide_no_light(exported, tmp_path):
    house = floor(material("Wall"), material("Pane", "ShaderNodeBsdfGlass"), material("Bulb", "ShaderNodeEmission"))
    house.data.polygons[0].material_index, house.data.polygons[1].material_index = 1, 2
    surfaces, warnings = exported()
    assert surfaces["Floor.ply"]["base_color"] == pytest.approx([0.8] * 3)
    assert len(warnings) == 2 and all(w.startswith("part of occluder 'Floor' is left out, as ") for w in warnings)
    assert len(trimesh.load(tmp_path / "job" / "Floor.ply").faces) == 8


def test_a_dome_and_a_room_are_left_out_and_a_floor_and_a_box_beside_stay(exported):
    floor(scale=(20, 20, 0.1))
    add_cube("Room", scale=(30, 30, 30))
    add_cube("Beside", location=(3, 0, 0))
    bpy.ops.mesh.primitive_uv_sphere_add(radius=40, location=(0, 0, -2.5))
    dome = bpy.context.object
    dome.name = "Dome"
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.bisect(plane_co=(0, 0, -2.5), plane_no=(0, 0, 1), clear_inner=True)
    bpy.ops.object.mode_set(mode="OBJECT")
    surfaces, warnings = exported()
    assert sorted(surfaces) == ["Beside.ply", "Floor.ply"]
    assert len(warnings) == 2 and all("'Room'" in w or "'Dome'" in w for w in warnings)


@pytest.mark.parametrize(("width", "left"), [(0.4, True), (1.0, False)])
def test_a_room_with_windows_is_one_and_a_stage_is_not(width, left):
    """A box around everything; of the wall behind the camera a part is open, or all of it."""
    panes = []
    for axis in range(3):
        for side in (-1, 1):
            low, high = np.array([-3.0, -3.0, -1.0]), np.array([3.0, 3.0, 3.0])
            low[axis] = high[axis] = (low if side < 0 else high)[axis]
            a, b = (axis + 1) % 3, (axis + 2) % 3
            corners = np.tile(low, (4, 1))
            corners[1:3, a], corners[2:4, b] = high[a], high[b]
            if (axis, side) != (1, -1):
                panes.append(corners)
                continue
            for begin, end in ((-3, -3 * width), (3 * width, 3)):  # what is left of it beside the opening
                part = corners.copy()
                part[:, 0] = np.where(corners[:, 0] < 0, begin, end)
                panes.append(part)
    room = np.concatenate([pane[[[0, 1, 2], [0, 2, 3]]] for pane in panes])
    assert surroundings.encloses(room, (0, 0, 0), (0.3, -1, 0.5)) == left


def test_a_roof_over_the_objects_alone_is_no_room():
    roof = np.array([[[-9, -9, 2], [9, -9, 2], [9, 9, 2]], [[-9, -9, 2], [9, 9, 2], [-9, 9, 2]]], float)
    walls = np.concatenate([roof, roof - [0, 0, 4]])
    assert not surroundings.encloses(walls, (0, 0, 0), (0, 0, 1))  # light comes in from the sides
    assert not surroundings.encloses(walls, (0, 0, 0), (20, 0, 1))
