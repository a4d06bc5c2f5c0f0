# SPDX-License-Identifier: GPL-3.0-or-later
"""The objects drawn over the photo."""

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from blender_btfsep.run import runs
from blender_btfsep.scene import meshes
from blender_btfsep.window import outlines


def triangles(thing):
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return meshes.triangles_of_mesh(evaluated.to_mesh(), np.eye(4))


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_the_outline_of_a_ball_is_its_horizon(photographed, kind):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=1)
    ball, eye, parallel = bpy.context.object, np.array([0.0, -6, 2]), kind == "ORTHO"
    found = triangles(ball)
    p = found["positions"]
    normals = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    points, beside = outlines.edges_of(found)
    assert len(points) == 64 * 31 + 64 * 32 + 64 * 30  # rings, meridians, diagonals
    assert (beside[:, 0] != beside[:, 1]).all()  # it is closed
    line = outlines.silhouette(points, beside, normals, p.mean(1), eye, parallel=parallel)
    distance = np.linalg.norm(eye)
    height = line.reshape(-1, 3) @ eye / distance
    assert len(line) > 60 and np.abs(height - (0 if parallel else 1 / distance)).max() < 0.12


def test_an_instance_of_a_collection_is_drawn_where_it_stands(photographed):
    held = bpy.data.collections.new("Held")
    bpy.ops.mesh.primitive_cube_add(size=2, location=(3, 0, 0))
    cube = bpy.context.object
    held.objects.link(cube)
    photographed.collection.objects.unlink(cube)
    thing = bpy.data.objects.new("Instance", None)
    thing.instance_type, thing.instance_collection = "COLLECTION", held
    photographed.collection.objects.link(thing)
    thing.location, thing.scale = (0, 5, 0), (1, 1, 2)
    photographed.btfsep.objects.add().object = thing
    bpy.context.view_layer.update()
    outlines._shapes.clear()
    shape = outlines._shape(thing, bpy.context.evaluated_depsgraph_get())
    assert len(shape["positions"]) == 12 and not outlines.too_fine(photographed)
    assert np.allclose([shape["positions"].min((0, 1)), shape["positions"].max((0, 1))], [[2, -1, -1], [4, 1, 1]])
    cube.location.x = 7
    bpy.context.view_layer.update()
    moved = outlines._shape(thing, bpy.context.evaluated_depsgraph_get())
    assert np.allclose(moved["positions"].min((0, 1)), [6, -1, -1])


def test_an_open_mesh_has_its_border_and_split_vertices_have_none(photographed):
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=3, y_subdivisions=3)
    grid = triangles(bpy.context.object)
    points, beside = outlines.edges_of(grid)
    assert (beside[:, 0] == beside[:, 1]).sum() == 12
    p = grid["positions"]
    flat = np.tile([0.0, 0.0, 1.0], (len(p), 1))
    line = outlines.silhouette(points, beside, flat, p.mean(1), np.array([0.3, 0.2, 9.0]), parallel=False)
    assert len(line) == 12 and np.allclose(np.abs(line[..., :2]).max(-1), 1)  # all of it faces the camera
    split = {**grid, "vertex": np.arange(grid["vertex"].size).reshape(-1, 3)}  # as files with UV seams have them
    assert len(outlines.edges_of(split)[0]) == len(points)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_the_photo_is_drawn_where_the_camera_sees_it(photographed, kind):
    lens = photographed.camera.data
    lens.type, lens.shift_x, lens.sensor_fit = kind, 0.1, "VERTICAL"
    part = (12, 8, 24, 16)
    corners = outlines.photo_corners(photographed, photographed.camera, part)
    owner = photographed.camera
    seen = [world_to_camera_view(photographed, owner, owner.matrix_world @ Vector(corner)) for corner in corners]
    assert np.allclose(np.array(seen)[:, :2], [[0.25, 0.25], [0.75, 0.25], [0.75, 0.75], [0.25, 0.75]], atol=1e-5)
    assert all(lens.clip_start < each[2] < lens.clip_end for each in seen)


def test_shapes_are_forgotten_when_they_change(photographed):
    cube = photographed.btfsep.objects[0].object
    depsgraph = bpy.context.evaluated_depsgraph_get()
    first = outlines._shape(cube, depsgraph)
    assert outlines._shape(cube, depsgraph) is first and not outlines.too_fine(photographed)
    cube.location.x += 1
    bpy.context.view_layer.update()
    assert outlines._shape(cube, bpy.context.evaluated_depsgraph_get()) is first  # its own space moves along
    cube.data.vertices[0].co.x += 1
    cube.data.update()
    bpy.context.view_layer.update()
    assert outlines._shape(cube, bpy.context.evaluated_depsgraph_get()) is not first


def test_the_photo_is_as_bright_as_the_background_image():
    """Seen in windows of 4.3.2 and 5.2.2, pixel by pixel: a module of Blender draws nothing."""
    assert outlines.shader_of_photo((4, 3, 2)) == "IMAGE"
    assert outlines.shader_of_photo((5, 2, 2)) == "IMAGE_SCENE_LINEAR_TO_REC709_SRGB"


def test_the_overlay_is_off_at_first(addon):
    assert runs.run_state().overlay == "OFF"


def test_how_the_first_object_lies_over_the_photo_is_shown_at_once(photographed):
    state, settings = runs.run_state(), photographed.btfsep
    thing = settings.objects[0].object
    bpy.ops.btfsep.use_photo()
    assert state.overlay == "OUTLINE"
    state.overlay = "OFF"
    settings.objects.clear()
    bpy.ops.btfsep.use_photo()
    assert state.overlay == "OFF"  # there is nothing to draw
    thing.select_set(True)
    bpy.ops.btfsep.add_objects()
    assert state.overlay == "OUTLINE"
    state.overlay = "OFF"
    bpy.ops.mesh.primitive_monkey_add()
    bpy.ops.btfsep.add_objects()
    assert len(settings.objects) == 2 and state.overlay == "OFF"  # as the user has it
