# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender saves with its view transform AgX is read as the light that it was."""

import bpy
import numpy as np
import pytest

from btfsep_engine import images
from scripts.cycles import studio


@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
def test_a_picture_that_blender_saved_with_agx_is_read_as_it_was(tmp_path, kind):
    scene = studio.clear()
    random, size = np.random.default_rng(0), 24
    colours = 2.0 ** random.uniform(-5, 1.5, (size, size, 1)) * random.uniform(0.15, 1, (size, size, 3))
    colours = np.repeat(np.repeat(colours, 8, 0), 8, 1).astype(np.float32)  # fields that JPEG leaves as they are
    image = bpy.data.images.new("light", 8 * size, 8 * size, float_buffer=True)
    image.pixels.foreach_set(np.dstack([colours[::-1], np.ones(colours.shape[:2], np.float32)]).ravel())
    scene.view_settings.view_transform = "AgX"
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth, settings.quality = kind, "8", 100
    path = tmp_path / f"render.{kind.lower()}"
    image.save_render(str(path), scene=scene)
    read = images.read_linear(path, colorspace="agx").pixels
    off = np.linalg.norm(read - colours, axis=-1)[4::8, 4::8] / np.linalg.norm(colours, axis=-1)[4::8, 4::8]
    assert np.median(off) < 0.03 and np.percentile(off, 90) < 0.1
    as_srgb = images.read_linear(path).pixels
    assert np.median(np.linalg.norm(as_srgb - colours, axis=-1) / np.linalg.norm(colours, axis=-1)) > 0.15
