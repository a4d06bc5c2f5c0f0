# SPDX-License-Identifier: GPL-3.0-or-later
"""The job's camera against Blender's own projection and Cycles' renders."""

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from blender_btfsep.camera import for_photo, intrinsics, render_size, to_world
from blender_btfsep.errors import InputError


def project(camera: dict, points):
    """Pixels of world points by the job's own definition, as a reader of the job would do it."""
    inverse = np.linalg.inv(np.array(camera["to_world"]))
    local = np.c_[points, np.ones(len(points))] @ inverse.T
    depth = -local[:, 2]
    return np.stack(
        [
            camera["fx"] * local[:, 0] / depth + camera["cx"],
            camera["cy"] - camera["fy"] * local[:, 1] / depth,
        ],
        -1,
    )


CAMERAS = {
    "landscape": {},
    "portrait": {"resolution": (60, 100)},
    "shifted": {"shift": (0.17, -0.23)},
    "shifted portrait": {"resolution": (60, 100), "shift": (-0.11, 0.12)},
    "horizontal fit of a portrait": {"resolution": (60, 100), "fit": "HORIZONTAL", "shift": (0.1, 0.2)},
    "vertical fit": {"fit": "VERTICAL", "shift": (0.1, 0.2)},
    "percentage": {"resolution": (200, 120), "percentage": 50, "shift": (0.1, 0.2)},
    "wide pixels": {"aspect": (2.0, 1.0), "shift": (0.1, 0.2)},
    "tall pixels": {"aspect": (1.0, 1.5), "shift": (-0.1, 0.2)},
    "tall pixels turn landscape into vertical fit": {"aspect": (1.0, 2.5), "shift": (0.3, 0.2)},
    "tall pixels, vertical": {"aspect": (1.0, 1.5), "fit": "VERTICAL", "shift": (-0.1, 0.2)},
    "field of view": {"angle": 1.1, "resolution": (80, 80)},
    "scaled camera": {"scale": (2.0, 0.5, 3.0)},
}


def set_up_camera(scene, add_camera, how):
    camera = add_camera(scene, (3.1, -4.2, 2.3), (0.2, 0.1, -0.1))
    camera.data.sensor_width, camera.data.sensor_height = 36.0, 20.0
    camera.data.lens = 43.0
    camera.data.shift_x, camera.data.shift_y = how.get("shift", (0, 0))
    camera.data.sensor_fit = how.get("fit", "AUTO")
    if "angle" in how:
        camera.data.angle = how["angle"]
    camera.scale = how.get("scale", (1, 1, 1))
    scene.render.resolution_x, scene.render.resolution_y = how.get("resolution", (100, 60))
    scene.render.resolution_percentage = how.get("percentage", 100)
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = how.get("aspect", (1, 1))
    bpy.context.view_layer.update()
    return camera


@pytest.mark.parametrize("name", CAMERAS)
def test_camera_projects_as_blender_does(scene, add_camera, name):
    camera = set_up_camera(scene, add_camera, CAMERAS[name])
    width, height = render_size(scene)
    job = intrinsics(scene, camera, width, height)
    job["to_world"] = to_world(camera)
    points = np.random.default_rng(0).uniform(-1, 1, (40, 3))
    view = np.array([world_to_camera_view(scene, camera, Vector(p)) for p in points])
    expected = np.stack([view[:, 0] * width, (1 - view[:, 1]) * height], -1)
    found = project(job, points)
    if "scale" in CAMERAS[name]:
        # world_to_camera_view takes the camera's scale along; a render does not (next test), so compare rays instead
        camera.scale = (1, 1, 1)
        bpy.context.view_layer.update()
        view = np.array([world_to_camera_view(scene, camera, Vector(p)) for p in points])
        expected = np.stack([view[:, 0] * width, (1 - view[:, 1]) * height], -1)
    assert np.abs(found - expected).max() < 1e-4


@pytest.mark.parametrize("name", ["shifted portrait", "tall pixels", "vertical fit", "scaled camera", "percentage"])
def test_camera_projects_as_cycles_renders(scene, add_camera, render, name):
    """A small bright ball must appear where the job says: the only judge of the pixel grid is a picture."""
    camera = set_up_camera(scene, add_camera, CAMERAS[name])
    centre = Vector((0.35, -0.2, 0.3))
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, radius=0.12, location=centre)
    glow = bpy.data.materials.new("Glow")
    glow.use_nodes = True
    glow.node_tree.nodes.clear()
    emission = glow.node_tree.nodes.new("ShaderNodeEmission")
    output = glow.node_tree.nodes.new("ShaderNodeOutputMaterial")
    glow.node_tree.links.new(emission.outputs[0], output.inputs["Surface"])
    bpy.context.object.data.materials.append(glow)
    picture = render(scene)[..., 0]
    job = for_photo(scene, camera, picture.shape[::-1])
    job["to_world"] = to_world(camera)
    y, x = np.indices(picture.shape) + 0.5
    seen = np.array([(picture * x).sum(), (picture * y).sum()]) / picture.sum()
    # The outline of a ball is not centred on the image of its centre: average the images of its points instead.
    offsets = np.random.default_rng(1).normal(size=(20000, 3))
    offsets *= 0.12 / np.linalg.norm(offsets, axis=1, keepdims=True)
    outline = project(job, np.array(centre) + offsets)
    middle = (outline.min(0) + outline.max(0)) / 2
    assert np.abs(seen - middle).max() < 0.06


def test_a_photo_of_another_size_scales_the_camera(scene, add_camera):
    camera = set_up_camera(scene, add_camera, CAMERAS["shifted"])
    small, large = for_photo(scene, camera, (100, 60)), for_photo(scene, camera, (300, 180))
    for key in ("fx", "fy", "cx", "cy"):
        assert large[key] == pytest.approx(3 * small[key])
    with pytest.raises(InputError, match="the scene renders 100 x 60"):
        for_photo(scene, camera, (100, 70))


@pytest.mark.parametrize("kind", ["ORTHO", "PANO"])
def test_cameras_that_are_no_pinholes_are_refused(scene, add_camera, kind):
    camera = add_camera(scene, (0, -5, 0))
    camera.data.type = kind
    with pytest.raises(InputError, match="choose a perspective camera"):
        intrinsics(scene, camera, 10, 10)


def test_a_mirrored_camera_is_refused(scene, add_camera):
    camera = add_camera(scene, (0, -5, 0))
    camera.scale = (-1, 1, 1)
    bpy.context.view_layer.update()
    with pytest.raises(InputError, match="negative"):
        to_world(camera)
