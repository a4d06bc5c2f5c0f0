# SPDX-License-Identifier: GPL-3.0-or-later
"""What an object is made of: recognised, a colour, as in Blender, or a material of the library with its thumbnail."""

import json
import time

import bpy
import numpy as np
import pytest

from blender_btfsep import command
from blender_btfsep.basics.errors import InputError
from blender_btfsep.run import answer, request, runs
from blender_btfsep.scene import own_surface
from blender_btfsep.window import icons, library
from btfsep_engine.job.load import load_job

MATERIALS = [
    {"name": "wood/oak", "class": "wood"},
    {"name": "leather/black-nappa", "class": "leather", "albedo": [0.1, 0.2, 0.3]},
    {"name": "leather/brown", "class": "leather"},
]


def read_now():
    """Reads the library and waits for it."""
    while library._step() is not None:
        time.sleep(library.INTERVAL / 4)


@pytest.fixture
def cube(photographed):
    return photographed.btfsep.objects[0]


def job_of(scene, tmp_path):
    folder = request.write_job(scene, folder=tmp_path / "job")
    load_job(folder)  # the engine takes it
    return json.loads((folder / "job.json").read_text())["objects"][0]


def material(colour=(0.2, 0.4, 0.1, 1), **inputs):
    made = bpy.data.materials.new("Own")
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    for name, value in {"Base Color": colour, **inputs}.items():
        shader.inputs[name].default_value = value
    return made


def test_only_a_material_that_was_changed_tells_a_colour(cube):
    tells, thing = own_surface.tells_a_colour, cube.object
    thing.data.materials.clear()
    assert not tells(None) and not tells(thing)
    thing.data.materials.append(material((0.8, 0.8, 0.8, 1)))
    assert not tells(thing)
    thing.data.materials.append(None)
    thing.data.materials.append(coloured := material((0.8, 0.8, 0.7, 1)))
    assert tells(thing)
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", thing.users_collection[0]
    assert tells(instance)
    shader = coloured.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (0.8, 0.8, 0.8, 1)
    assert not tells(thing) and not tells(instance)
    image = coloured.node_tree.nodes.new("ShaderNodeTexImage")
    coloured.node_tree.links.new(image.outputs["Color"], shader.inputs["Base Color"])
    assert tells(thing)


def test_nothing_is_said_of_what_is_to_be_recognised(photographed, cube, tmp_path):
    cube.colour = (1, 0, 0)
    job = job_of(photographed, tmp_path)
    assert job["material"] is None and job["surface"] is None


def test_a_material_that_is_chosen_is_the_jobs(photographed, cube, tmp_path):
    cube.material = "wood/oak"
    assert cube.source == "LIBRARY" and job_of(photographed, tmp_path)["material"] == "wood/oak"
    cube.source = "RECOGNISE"
    assert job_of(photographed, tmp_path)["material"] is None
    cube.material = ""
    cube.source = "LIBRARY"
    with pytest.raises(RuntimeError, match="Choose the material of 'Cube'"):
        bpy.ops.btfsep.estimate()


def test_a_colour_is_a_surface(photographed, cube, tmp_path):
    cube.source, cube.colour, cube.roughness, cube.metallic = "COLOUR", (0.1, 0.5, 0.4), 0.25, 1
    job = job_of(photographed, tmp_path)
    assert job["material"] is None
    assert job["surface"] == {"base_color": [0.1, 0.5, 0.4], "roughness": 0.25, "metallic": 1}
    folder = request.write_job(photographed, folder=tmp_path / "other", material={"Cube": "wood/oak"})
    job = json.loads((folder / "job.json").read_text())["objects"][0]  # --material has the last word
    assert (job["material"], job["surface"]) == ("wood/oak", None)


def test_as_in_blender_is_what_its_material_says(photographed, cube, tmp_path):
    cube.source = "BLENDER"
    cube.object.data.materials.append(material(Roughness=0.3, Metallic=0.0))
    surface = job_of(photographed, tmp_path)["surface"]
    assert np.allclose(surface["base_color"], (0.2, 0.4, 0.1)) and surface["roughness"] == pytest.approx(0.3)
    assert surface["specular"] == pytest.approx(0.5, abs=0.01) and surface["metallic"] == 0


def test_each_of_several_materials_is_where_it_is(photographed, cube, tmp_path):
    cube.source, thing = "BLENDER", cube.object
    assert own_surface.material_words(thing) == "It has no material: white"
    thing.data.materials.append(material())
    assert own_surface.material_words(thing) == "'Own'"
    job_of(photographed, tmp_path)
    warnings = bpy.context.window_manager.btfsep.warnings
    assert not warnings
    other = material(colour=(0.6, 0.4, 0.5, 1), Roughness=0.9)
    thing.data.materials.append(other)
    for face in thing.data.polygons:
        face.material_index = int(face.normal.z > 0.5)  # its top
    thing.data.update()
    assert job_of(photographed, tmp_path)["surface"]["base_color"] == "colour_Cube.exr"
    job = load_job(tmp_path / "job")
    surface, mesh = job.objects[0].surface, job.objects[0].mesh
    corners = mesh.vertices[mesh.faces]
    up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    top = up[:, 2] > 0.9 * np.linalg.norm(up, axis=1)
    side = len(surface.image)
    for uv in (mesh.corner_uv.mean(1), *mesh.corner_uv.transpose(1, 0, 2)):  # of row 0 at the top
        row, column = ((1 - uv[:, 1]) * side).astype(int), (uv[:, 0] * side).astype(int)
        colours = surface.image[row, column]
        assert np.allclose(colours[top], (0.6, 0.4, 0.5), atol=1e-5) and top.sum() == 2
        assert np.allclose(colours[~top], (0.2, 0.4, 0.1), atol=1e-5)
        assert np.allclose(surface.finish[row, column, 0], np.where(top, 0.9, 0.5))
    assert not warnings
    assert own_surface.material_words(thing) == "'Own', 'Own.001', each where it is"
    holder = bpy.data.objects.new("Holder", None)
    holder.instance_type, holder.instance_collection = "COLLECTION", photographed.collection
    assert own_surface.material_words(holder) == "As what it instances" and own_surface.material_words(None).startswith(
        "It has no"
    )


def test_materials_of_one_colour_need_no_picture(photographed, cube, tmp_path):
    cube.source = "BLENDER"
    for _ in range(2):
        cube.object.data.materials.append(material())
    cube.object.data.polygons[0].material_index = 1
    cube.object.data.update()
    assert np.allclose(job_of(photographed, tmp_path)["surface"]["base_color"], (0.2, 0.4, 0.1))


def test_as_in_blender_takes_the_texture_by_its_uv(photographed, cube, tmp_path):
    image = bpy.data.images.new("Checks", 4, 4)
    pixels = np.ones((4, 4, 4), np.float32)
    pixels[::2, :, 0] = 0
    image.pixels.foreach_set(pixels.ravel())
    image.filepath_raw, image.file_format = str(tmp_path / "checks.png"), "PNG"
    image.save()
    own = material()
    node = own.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = bpy.data.images.load(str(tmp_path / "checks.png"))
    own.node_tree.links.new(node.outputs["Color"], own.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    cube.object.data.materials.append(own)
    cube.source = "BLENDER"
    surface = job_of(photographed, tmp_path)["surface"]
    assert surface["base_color"] == "colour_Cube.png"
    assert (tmp_path / "job" / "colour_Cube.png").read_bytes() == (tmp_path / "checks.png").read_bytes()
    photographed.btfsep.mapping = "UNWRAP"  # its own UV map is not the mesh's then
    assert np.allclose(job_of(photographed, tmp_path)["surface"]["base_color"], (0.5, 1, 1))
    photographed.btfsep.mapping = "CHARTS"
    node.extension = "CLIP"  # beyond the image there is black: then it is baked
    assert job_of(photographed, tmp_path)["surface"]["base_color"] == "colour_Cube.exr"


def test_what_cannot_be_read_from_blender_is_refused_in_words(photographed, cube, tmp_path):
    cube.source = "BLENDER"
    glass = material(**{"Transmission Weight": 1.0})
    cube.object.data.materials.append(glass)
    with pytest.raises(RuntimeError, match="'Cube'; light goes through material 'Own'; give its colour"):
        bpy.ops.btfsep.estimate()
    tree = glass.node_tree
    tree.links.new(tree.nodes.new("ShaderNodeBsdfToon").outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    with pytest.raises(RuntimeError, match="is not known; give its colour"):
        bpy.ops.btfsep.estimate()


@pytest.mark.parametrize("by_nodes", [False, True])
def test_a_texture_whose_file_is_gone_is_said_before_the_click(photographed, cube, tmp_path, by_nodes):
    cube.source, own, file = "BLENDER", material(), tmp_path / "rust.png"
    cube.object.data.materials.append(own)
    image = bpy.data.images.new("rust", 8, 8)
    image.filepath_raw, image.file_format = str(file), "PNG"
    image.save()
    bpy.data.images.remove(image)
    tree = own.node_tree
    picture, group = tree.nodes.new("ShaderNodeTexImage"), bpy.data.node_groups.new("Paint", "ShaderNodeTree")
    picture.image = image = bpy.data.images.load(str(file))
    colour = picture.outputs["Color"]
    if by_nodes:  # then it is baked, and what is not there is pink
        group.interface.new_socket("Colour", in_out="OUTPUT", socket_type="NodeSocketColor")
        inner, end = group.nodes.new("ShaderNodeTexImage"), group.nodes.new("NodeGroupOutput")
        inner.image = image
        group.links.new(inner.outputs["Color"], end.inputs[0])
        painted = tree.nodes.new("ShaderNodeGroup")
        painted.node_tree = group
        colour = painted.outputs[0]
        tree.nodes.remove(picture)
    tree.links.new(colour, tree.nodes["Principled BSDF"].inputs["Base Color"])
    other = tree.nodes.new("ShaderNodeTexImage")  # nothing hangs on it
    other.image = bpy.data.images.new("elsewhere", 8, 8)
    other.image.source, other.image.filepath = "FILE", str(tmp_path / "elsewhere.png")
    assert request.missing(bpy.context) == "" and job_of(photographed, tmp_path)["surface"]
    file.unlink()
    assert request.missing(bpy.context).startswith("The file of image 'rust.png', of which 'Cube' is made, is not")
    with pytest.raises(InputError, match=r"'Cube'; the file of image 'rust\.png' is not there; find it"):
        job_of(photographed, tmp_path)
    image.source = "GENERATED"  # as good as a packed one
    assert request.missing(bpy.context) == "" and job_of(photographed, tmp_path)["surface"]


def test_the_command_line_takes_what_the_panel_says(photographed, cube, tmp_path):
    cube.source, cube.colour = "COLOUR", (0.1, 0.5, 0.4)
    assert command.main(["export", "--job", str(tmp_path / "job")]) == 0
    assert json.loads((tmp_path / "job" / "job.json").read_text())["objects"][0]["surface"]["metallic"] == 0


def test_what_was_given_is_called_so(photographed, cube):
    found = [{"name": "Cube", "material": "surface/given"}, {"name": "Else", "material": "wood/oak", "unknown": True}]
    cube.recognised = "leather/brown"
    assert answer.take_materials(photographed, found) == ["Cube: as given", "Else: wood/oak (unsure)"]
    assert not cube.recognised  # it is to be, where Made Of is set back to that


@pytest.fixture
def shelf(fake_engine, tmp_path):
    """A library of three materials, each with a thumbnail of its own grey; what the engine was told."""
    listed = []
    for number, entry in enumerate(MATERIALS):
        image = bpy.data.images.new("thumbnail", 8, 8)
        image.pixels.foreach_set(np.tile(np.float32([*[(number + 1) / 4] * 3, 1]), 64))
        image.filepath_raw, image.file_format = str(tmp_path / f"{number}.png"), "PNG"
        image.save()
        bpy.data.images.remove(image)
        listed.append(entry | {"thumbnail": str(tmp_path / f"{number}.png")})
    fake_engine(log=str(tmp_path / "arguments"), lines=[{"type": "done", "result": {"materials": listed}}])
    return tmp_path / "arguments"


def test_the_library_is_read_beside_blender_without_a_click(shelf):
    state = runs.run_state()
    library.ensure()
    library.ensure()
    assert bpy.app.timers.is_registered(library._step) and not state.library  # asked for, nothing waited for
    read_now()
    assert [(m.name, m.kind) for m in state.library] == [(m["name"], m["class"]) for m in MATERIALS]
    told = json.loads(shelf.read_text())
    assert told[:2] == ["library", "list"] and "--thumbnails" in told and library._reading is None
    bpy.app.timers.unregister(library._step)
    library.ensure()
    assert not bpy.app.timers.is_registered(library._step)  # it is read


def test_another_file_has_the_library_without_a_further_child(shelf, tmp_path):
    read_now()
    shelf.unlink()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    runs.run_state().library.clear()
    runs.run_state().property_unset("library_for")  # as a window's manager is anew
    library.ensure()
    assert bpy.app.timers.is_registered(library._step)
    read_now()
    assert len(runs.run_state().library) == 3 and not shelf.exists()
    library.forget()
    read_now()
    assert shelf.exists()
    bpy.app.timers.unregister(library._step)


def test_a_library_that_cannot_be_read_is_said_once(fake_engine):
    fake_engine(
        lines=[{"type": "failed", "message": "library /x; no such folder; choose another", "exit_code": 2}], exit=2
    )
    runs.run_state().library.add().name = "wood/oak"  # of a folder that was there
    read_now()
    assert runs.run_state().library_error == "library /x; no such folder; choose another"
    assert not runs.run_state().library
    library.ensure()
    assert not bpy.app.timers.is_registered(library._step)
    bpy.context.preferences.addons["blender_btfsep"].preferences.engine = "/absent/engine"
    read_now()
    assert "no such file" in runs.run_state().library_error


def test_materials_are_browsed_by_class_and_picture(photographed, cube, shelf):
    assert library.items(cube) == [("NONE", "Choose", "No material of the library is chosen", "MATERIAL", 0)]
    read_now()
    assert [c[0] for c in library.classes()] == ["ALL", "leather", "wood"]
    assert [i[0] for i in library.items(cube)] == ["NONE", "wood/oak", "leather/black-nappa", "leather/brown"]
    cube.browse = "leather/black-nappa"
    assert (cube.material, cube.source, cube.browse) == ("leather/black-nappa", "LIBRARY", "leather/black-nappa")
    runs.run_state().library_class = "wood"
    assert [i[0] for i in library.items(cube)] == ["wood/oak", "leather/black-nappa"]  # what is chosen stays
    runs.run_state().library_class = "ALL"
    for name, score in (("leather/brown", 0.7), ("wood/oak", 0.2)):
        candidate = cube.candidates.add()
        candidate.name, candidate.score = name, score
    assert [i[1] for i in library.items(cube)] == ["brown (70 %)", "oak (20 %)", "black nappa"]
    pictures = [np.array(icons._previews[m.thumbnail].image_pixels_float)[:3] for m in runs.run_state().library]
    assert np.allclose(pictures, [[0.25] * 3, [0.5] * 3, [0.75] * 3], atol=0.01)


def test_the_librarys_materials_are_assets_that_say_what_an_object_is_made_of(photographed, cube, shelf, tmp_path):
    with pytest.raises(RuntimeError, match="Read the library first"):
        bpy.ops.btfsep.library_assets()
    read_now()
    assert bpy.ops.btfsep.library_assets() == {"FINISHED"} == bpy.ops.btfsep.library_assets()
    assets = [m for m in bpy.data.materials if m.asset_data]
    assert [m.name for m in assets] == ["Black nappa", "Brown", "Oak"]  # once
    assert [t.name for t in assets[0].asset_data.tags] == ["leather"]
    shader = assets[0].node_tree.nodes["Principled BSDF"]
    assert np.allclose(shader.inputs["Base Color"].default_value[:3], (0.1, 0.2, 0.3))
    assert np.allclose(np.array(assets[0].preview.image_pixels_float)[:3], 0.5, atol=0.01)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    scene = bpy.context.scene
    entry, asset = scene.btfsep.objects[0], bpy.data.materials["Black nappa"]
    assert np.allclose(np.array(asset.preview.image_pixels_float)[:3], 0.5, atol=0.01)
    entry.object.data.materials.append(asset)
    entry.source = "BLENDER"
    job = job_of(scene, tmp_path)
    assert (job["material"], job["surface"]) == ("leather/black-nappa", None)
    entry.object.data.materials.append(bpy.data.materials["Oak"])  # of two kinds: then as it looks
    job = job_of(scene, tmp_path)
    assert job["material"] is None and np.allclose(job["surface"]["base_color"], (0.1, 0.2, 0.3))


def test_thumbnails_of_the_engine_itself(addon, tmp_path):
    read_now()
    state = runs.run_state()
    assert not state.library_error
    assert {"wood/oak-boards", "reference/chrome"} <= {m.name for m in state.library}
    assert state.library["reference/white-diffuse"].colour[0] > 0.7 > state.library["leather/black-nappa"].colour[0]
    assert all(icons.of_file(m.thumbnail) == icons.of_file(m.thumbnail) for m in state.library)
    assert all(tuple(icons._previews[m.thumbnail].image_size) == (96, 96) for m in state.library)
