# SPDX-License-Identifier: GPL-3.0-or-later
"""What Cycles sees in a pixel is what the engine's camera says it sees: a picture of the world positions.

The picture is made as the *photo* of an exported job and read back by the engine's loader, so that the rows of the
image, the camera and the mesh of the job are tested together.
"""

import bpy
import numpy as np
import pytest
from mathutils import Euler, Vector

from blender_btfsep.scene.export import export_job
from btfsep_engine.job.load import load_job
from scripts.cycles import materials, studio

OFFSET = 10.0  # added to the positions, so that the picture has no negative values


def position_material():
    """Emits the world position plus OFFSET as its radiance."""
    material, emission = materials.shaded("position", "ShaderNodeEmission")
    tree = material.node_tree
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    add = tree.nodes.new("ShaderNodeVectorMath")
    add.inputs[1].default_value = (OFFSET,) * 3
    tree.links.new(geometry.outputs["Position"], add.inputs[0])
    tree.links.new(add.outputs[0], emission.inputs["Color"])
    return material


@pytest.mark.parametrize(
    ("size", "shift", "fit", "kind"),
    [
        ((96, 64), (0.0, 0.0), "AUTO", "PERSP"),
        ((56, 80), (0.08, -0.05), "HORIZONTAL", "PERSP"),
        ((96, 64), (0.03, -0.05), "AUTO", "ORTHO"),
        ((96, 64), (0.03, -0.05), "AUTO", "REGION"),
    ],
)
def test_positions_lie_on_the_rays(tmp_path, size, shift, fit, kind):
    scene = studio.clear()
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.filter_width = 0.01
    scene.render.resolution_x, scene.render.resolution_y = size
    bpy.ops.mesh.primitive_monkey_add(size=1.6, location=(0.3, -0.2, 0.5), rotation=(0.3, -0.4, 0.9))
    monkey = bpy.context.object
    monkey.data.materials.append(position_material())
    data = bpy.data.cameras.new("camera")
    camera = bpy.data.objects.new("camera", data)
    scene.collection.objects.link(camera)
    data.lens, data.sensor_fit = 55.0, fit
    data.shift_x, data.shift_y = shift
    if kind == "ORTHO":
        data.type, data.ortho_scale = "ORTHO", 2.6
    if kind == "REGION":
        render = scene.render
        render.resolution_percentage, render.use_border, render.use_crop_to_border = 150, True, True
        render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.23, 0.7, 0.21, 0.9
    place = Vector((1.6, -3.0, 2.2))
    look = (Vector((0.3, -0.2, 0.5)) - place).to_track_quat("-Z", "Y")
    camera.location, camera.rotation_mode = place, "QUATERNION"
    camera.rotation_quaternion = look @ Euler((0, 0, -0.7)).to_quaternion()
    scene.camera = camera
    bpy.context.view_layer.update()

    picture = tmp_path / "positions.exr"
    studio.render_photo(scene, picture, 1)
    export_job(scene, tmp_path / "job", image_path=picture, objects=[monkey])
    job = load_job(tmp_path / "job")

    y, x = np.nonzero(job.photo.radiance.min(-1) > 1)
    assert len(x) > 400
    positions = job.photo.radiance[y, x].astype(np.float64) - OFFSET
    origins, directions = job.camera.rays(x + 0.5, y + 0.5)
    to_point = positions - origins
    along = (to_point * directions).sum(1)
    off = np.linalg.norm(to_point - along[:, None] * directions, axis=1)
    assert along.min() > 0
    assert off.max() < 1e-3  # a pixel is 0.03 wide here

    # ... and on the mesh of the job: each position is on the plane of one of its triangles, within it
    triangle = job.objects[0].mesh.vertices[job.objects[0].mesh.faces]
    edge1, edge2 = triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0]
    normal = np.cross(edge1, edge2)
    doubled = np.linalg.norm(normal, axis=1)
    normal /= doubled[:, None]
    for point in positions[:: len(positions) // 100]:
        offset = point - triangle[:, 0]
        distance = np.abs((offset * normal).sum(1))
        b = (np.cross(offset, edge2) * normal).sum(1) / doubled
        c = (np.cross(edge1, offset) * normal).sum(1) / doubled
        inside = (b > -0.02) & (c > -0.02) & (b + c < 1.02)
        assert distance[inside].min() < 1e-4
