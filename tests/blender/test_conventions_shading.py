# SPDX-License-Identifier: GPL-3.0-or-later
"""A white matte ball under a real, asymmetric map, rendered by Cycles, is the engine's own SH shading, to 1 %.

Three parties that share no code meet here: Cycles (map orientation, light transport), the engine's projection of
the map, and the engine's camera rays on an ideal ball.
"""

import bpy
import numpy as np
import pytest
from mathutils import Euler, Vector

from btfsep_engine import sh
from btfsep_engine.job.model import Camera
from scripts.cycles import materials, studio
from scripts.cycles.lights import true_lighting

ORDER = 10  # the irradiance of order 12 and above is below 0.2 % of its mean in these maps
ALBEDO = 0.8
CAMERA_AT, CAMERA_ROLL = (2.3, -3.1, 1.9), 0.4
TURNS = {"x": (0.9, 0, 0), "y": (0, -1.2, 0), "z": (0, 0, 2.1), "xyz": (-0.5, 0.8, 1.7)}


@pytest.fixture
def ball():
    """A white ball seen by a camera at no special place, rolled about its axis."""
    scene = studio.clear()
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.filter_width = 0.01  # through the pixel centres
    scene.render.resolution_x = scene.render.resolution_y = 48
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=6, radius=1.0)
    thing = bpy.context.object
    thing.data.shade_smooth()
    thing.data.materials.append(materials.white(ALBEDO))
    data = bpy.data.cameras.new("camera")
    camera = bpy.data.objects.new("camera", data)
    scene.collection.objects.link(camera)
    data.lens, data.sensor_width = 60.0, 36.0
    camera.location = CAMERA_AT
    look = (-Vector(CAMERA_AT)).to_track_quat("-Z", "Y")
    camera.rotation_mode = "QUATERNION"
    camera.rotation_quaternion = look @ Euler((0, 0, CAMERA_ROLL)).to_quaternion()
    scene.camera = camera
    bpy.context.view_layer.update()
    return scene


def normals_seen(scene):
    """(h, w) bool and (n, 3): the pixels whose centre meets the unit ball, well off its rim, and its normals there."""
    lens, (width, height) = scene.camera.data, (scene.render.resolution_x, scene.render.resolution_y)
    f = width * lens.lens / lens.sensor_width
    camera = Camera(width, height, f, f, width / 2, height / 2, np.array(scene.camera.matrix_world))
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    origin, direction = camera.rays(x.ravel(), y.ravel())
    b = (origin * direction).sum(1)
    inside = b * b - (origin * origin).sum(1) + 1
    hit = inside > 0.04
    point = origin[hit] + direction[hit] * (-b[hit] - np.sqrt(inside[hit]))[:, None]
    return hit.reshape(camera.height, camera.width), point


def shading_error(scene, coefficients, path, samples=256):
    """Root mean square difference of render and analytic shading, relative to the latter's, noise filtered out.

    What Cycles and the engine could disagree about is smooth over the ball (irradiance has hardly any order above 4);
    the path tracer's noise is not. So the difference is measured in its least-squares fit by harmonics of order 4.
    """
    scene.render.use_persistent_data = False
    seen, normals = normals_seen(scene)
    assert seen.sum() > 500
    expected = sh.irradiance(coefficients, normals) * ALBEDO / np.pi
    difference = studio.render_photo(scene, path, samples)[seen] - expected
    scale = np.sqrt((expected**2).mean())
    assert np.sqrt((difference**2).mean()) < 0.04 * scale  # noise, and nothing that the fit below would hide
    basis = sh.evaluate(4, normals)
    smooth = basis @ np.linalg.lstsq(basis, difference, rcond=None)[0]
    return np.sqrt((smooth**2).mean()) / scale


@pytest.mark.parametrize("light", ["courtyard", "sunset", "city"])
def test_real_lights(ball, light, small_light, tmp_path):
    light = small_light(light)
    ball.world = studio.make_world(light)
    truth = true_lighting(light, ORDER)
    assert shading_error(ball, truth, tmp_path / "ball.exr") < 0.01
    # the light is asymmetric enough for the test to mean something: any mirroring of it is far off
    for axis in range(3):
        mirror = np.eye(3)
        mirror[axis, axis] = -1
        _, normals = normals_seen(ball)
        mirrored = sh.irradiance(truth, normals @ mirror)
        straight = sh.irradiance(truth, normals)
        assert np.sqrt(((mirrored - straight) ** 2).mean() / (straight**2).mean()) > 0.03


@pytest.mark.parametrize("axis", TURNS)
def test_turned_world(ball, axis, small_light, tmp_path):
    """The light turned in Blender by R is the engine's coefficients turned by R."""
    light = small_light("sunset")
    ball.world = studio.make_world(light, rotation_euler=TURNS[axis])
    rotation = np.array(Euler(TURNS[axis]).to_matrix())
    turned = true_lighting(light, ORDER, rotation=rotation)
    assert shading_error(ball, turned, tmp_path / "ball.exr") < 0.01
    backwards = true_lighting(light, ORDER, rotation=rotation.T)
    _, normals = normals_seen(ball)
    assert np.abs(sh.irradiance(backwards, normals) / sh.irradiance(turned, normals) - 1).max() > 0.05
