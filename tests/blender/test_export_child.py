# SPDX-License-Identifier: GPL-3.0-or-later
"""The export in a Blender of its own: the same job, its words, its end; and when it is wanted."""

import json
import shutil
import time
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from tests.blender.test_addon_operators import FOUND


@pytest.fixture
def large(photographed, monkeypatch):
    """A scene that would hold a window up: smoothed in a render; something hidden; a second scene of the file."""
    from blender_btfsep.run import export_child

    cube = photographed.btfsep.objects[0].object
    modifier = cube.modifiers.new("Smooth", "SUBSURF")
    modifier.levels, modifier.render_levels = 0, 7
    bpy.ops.mesh.primitive_plane_add(size=9, location=(0, 0, -1))
    bpy.context.object.name = "Table"
    bpy.context.object.hide_set(True)
    photographed.btfsep.objects[0].material = "wood/oak"
    bpy.data.scenes.new("Another")
    monkeypatch.setattr(export_child, "wanted", export_child.is_large)  # as if there were a window to hold up
    return photographed


def files_of(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}


def test_a_second_blender_writes_the_same_job(large):
    from blender_btfsep.run import request

    here = files_of(request.write_job(bpy.context))
    shutil.rmtree(request.job_folder(large))
    slices = request.job_slices(bpy.context)
    count = 0
    while True:
        try:
            next(slices)
        except StopIteration as end:
            folder = end.value
            break
        count += 1
        time.sleep(0.02)
    there = files_of(folder)
    assert count > 1 and set(here) == set(there) == {"job.json", "photo.png", "Cube.ply", "Table.ply"}
    mine, its = (json.loads(files["job.json"]) for files in (here, there))
    assert np.allclose(mine["camera"].pop("to_world"), its["camera"].pop("to_world")) and mine == its
    assert all(here[name] == there[name] for name in ("photo.png", "Table.ply", "Cube.ply"))
    assert not list(folder.parent.glob("*-export.blend"))


def test_what_is_switched_on_stays_so(addon):
    """Blender 4.3 and later removes the wheels of extensions that factory settings switch off."""
    from blender_btfsep.run import export_child

    view = bpy.context.preferences.view
    splash, view.show_splash = view.show_splash, not view.show_splash
    bpy.ops.mesh.primitive_monkey_add()
    export_child.empty()
    assert not bpy.data.objects and "blender_btfsep" in bpy.context.preferences.addons
    assert bpy.context.preferences.view.show_splash != splash
    bpy.context.preferences.view.show_splash = splash


def test_its_faults_are_passed_on_and_nothing_is_left(large):
    from blender_btfsep.basics.errors import InputError
    from blender_btfsep.run import request, runs

    large.camera.data.type = "PANO"
    slices = request.job_slices(bpy.context)
    with pytest.raises(InputError, match="choose a perspective or orthographic camera"):
        for _ in slices:
            pass
    folder = request.job_folder(large)
    assert not list(folder.parent.glob("*-export.blend")) and not (folder / "job.json").exists()
    # given up in its midst
    large.camera.data.type = "PERSP"
    preparation = runs.Preparation(request.job_slices(bpy.context))
    assert not preparation.step() and not preparation.step()
    assert list(folder.parent.glob("*-export.blend"))
    preparation.kill()
    assert preparation.over and not list(folder.parent.glob("*-export.blend"))
    assert not (folder / "job.json").exists()


def test_an_operator_waits_for_it(large, fake_engine, tmp_path):
    fake_engine(log=str(tmp_path / "log"), lines=[{"type": "done", "result": FOUND}])
    large.btfsep.objects[0].source = "RECOGNISE"
    assert bpy.ops.btfsep.recognise() == {"FINISHED"}
    folder = json.loads((tmp_path / "log").read_text())[1]
    assert "Cube" in [o["name"] for o in json.loads(open(f"{folder}/job.json").read())["objects"]]
    glass = bpy.data.materials.new("Glass")
    glass.use_nodes = True
    shader = next(node for node in glass.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Transmission Weight"].default_value = 1
    large.btfsep.objects[0].object.data.materials.append(glass)
    large.btfsep.objects[0].source = "BLENDER"  # which only the export finds out
    with pytest.raises(RuntimeError, match="light goes through material 'Glass'"):
        bpy.ops.btfsep.estimate()
    assert not bpy.context.window_manager.btfsep.running


def folder_of(slices):
    """What a generator of `request.job_slices` gives in the end."""
    while True:
        try:
            next(slices)
        except StopIteration as end:
            return end.value
        time.sleep(0.02)


def test_what_was_painted_and_not_saved_is_in_the_job(large):
    """A file has of a painted image only what was packed."""
    from blender_btfsep.run import export_child, request
    from scripts.cycles import studio

    mask = bpy.data.images.new("Mask", 48, 32)
    painted = np.ones((32, 48, 4), np.float32)
    mask.pixels.foreach_set(painted.ravel())
    mask.pack()
    painted[:, :24, :3] = 0
    mask.pixels.foreach_set(painted.ravel())
    mask.update()
    large.btfsep.objects[0].mask = mask
    assert mask.is_dirty and export_child.is_large(bpy.context, large.btfsep)
    folder = folder_of(request.job_slices(bpy.context))
    name = json.loads((folder / "job.json").read_text())["objects"][0]["mask"]
    assert np.array_equal(studio.read_image(folder / name)[..., 0] > 0.5, painted[..., 0] > 0.5)
    large.btfsep.objects[0].mask = loose = bpy.data.images.new("Loose", 48, 32)
    loose.pixels.foreach_set(painted.ravel())
    loose.update()
    assert loose.is_dirty and not export_child.is_large(bpy.context, large.btfsep)


def test_a_disk_without_room_is_said(large, monkeypatch):
    from blender_btfsep.basics.errors import InputError
    from blender_btfsep.run import export_child, request

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(export_child, "write", full)
    with pytest.raises(InputError, match="No space left on device; free space"):
        folder_of(request.job_slices(bpy.context))


def test_when_it_is_wanted(large):
    from blender_btfsep.run import export_child

    def asked():
        return export_child.is_large(bpy.context, large.btfsep)

    cube = large.btfsep.objects[0].object
    assert asked()
    cube.modifiers["Smooth"].render_levels = 2
    assert not asked()
    cube.modifiers["Smooth"].levels = 5  # the viewport's own is not the render's
    assert not asked()
    cube.modifiers["Smooth"].levels, cube.modifiers["Smooth"].render_levels = 0, 7
    cloth = cube.modifiers.new("Cloth", "CLOTH")  # what it has come to is in this Blender only
    assert not asked()
    cube.modifiers.remove(cloth)
    driver = cube.driver_add("location", 0).driver
    driver.expression = "frame * 0.1"
    assert asked()
    driver.expression = "my_function(frame)"  # of this Blender's name space
    assert not asked()


@pytest.mark.parametrize("levels", [(), (1,), (3,), (1, 2)])
def test_faces_of_what_is_subdivided_are_known_without_its_being_subdivided(addon, scene, levels):
    from blender_btfsep.run import export_child

    bpy.ops.mesh.primitive_cone_add(vertices=7)  # triangles, and one face of seven corners
    cone = bpy.context.object
    cone.modifiers.new("Bent", "SIMPLE_DEFORM")
    for level in levels:
        modifier = cone.modifiers.new("Smooth", "SUBSURF")
        modifier.levels, modifier.render_levels = level, level
    bpy.context.view_layer.update()
    evaluated = cone.evaluated_get(bpy.context.view_layer.depsgraph)
    in_render = len(evaluated.data.polygons)
    assert export_child._faces(SimpleNamespace(original=cone)) == in_render  # nothing evaluated is looked at
    cone.modifiers.new("Twice", "ARRAY")
    bpy.context.view_layer.update()
    assert export_child._faces(cone.evaluated_get(bpy.context.view_layer.depsgraph)) == 2 * in_render
