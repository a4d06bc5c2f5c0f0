# SPDX-License-Identifier: GPL-3.0-or-later
"""A render that looks as a camera's photo does: through the curve that the engine undoes."""

import bpy
import numpy as np

from blender_btfsep.window import camera_look
from btfsep_engine.fit.tone_curve import CAMERA
from btfsep_engine.imaging import camera_curve, images
from scripts.cycles import studio


def test_the_curve_is_the_engines():
    radiance = np.linspace(0, 1, 99)
    np.testing.assert_allclose(camera_look.shown(radiance), camera_curve.to_display(radiance), rtol=1e-12)
    assert camera_look.READ_BY == CAMERA.description


def test_what_is_saved_through_it_is_read_as_the_light_that_it_was(tmp_path):
    scene = studio.clear()
    light = np.repeat(np.geomspace(0.004, 0.97, 64)[None, :, None], 3, -1) * np.array([1, 0.8, 0.5])
    image = bpy.data.images.new("light", 64, 8, float_buffer=True)
    image.pixels.foreach_set(np.dstack([np.repeat(light, 8, 0), np.ones((8, 64, 1))]).astype(np.float32).ravel())
    view = scene.view_settings
    view.view_transform, view.look, view.exposure, view.gamma = "Standard", "None", 0, 1
    camera_look.set_curve(view)
    assert camera_look.is_set(view)
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "PNG", "16"
    image.save_render(str(tmp_path / "shown.png"), scene=scene)
    read = images.read_linear(tmp_path / "shown.png", colorspace="camera").pixels[4]
    bright = light[0] > 0.02
    assert np.abs(np.log(read / light[0]))[bright].max() < 0.03
    assert np.abs(np.log(read / light[0])).max() < 0.35  # the curve's table has 256 entries
    as_srgb = images.read_linear(tmp_path / "shown.png", colorspace="srgb").pixels[4]
    assert np.abs(np.log(as_srgb / light[0]))[bright].max() > 0.5
    view.curve_mapping.curves[3].points[4].location[1] += 0.05
    assert not camera_look.is_set(view)
