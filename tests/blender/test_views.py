# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender saves by its view transforms is read as the light that it was, and known for a render."""

import bpy
import numpy as np
import pytest

from blender_btfsep.photo import photo_file
from blender_btfsep.window import blender_views as named
from btfsep_engine.imaging import image_headers, images
from btfsep_engine.imaging.blender_views import VIEWS
from scripts.cycles import studio


def relative(read, colours) -> np.ndarray:
    """How far off each colour is that was read."""
    return np.linalg.norm(read - colours, axis=-1)[4::8, 4::8] / np.linalg.norm(colours, axis=-1)[4::8, 4::8]


@pytest.mark.parametrize(("kind", "name"), [("PNG", name) for name in VIEWS] + [("JPEG", "agx")])
def test_a_picture_that_blender_saved_is_read_as_it_was(tmp_path, kind, name):
    scene = studio.clear()
    random, size = np.random.default_rng(0), 24
    colours = 2.0 ** random.uniform(-5, 1.5, (size, size, 1)) * random.uniform(0.15, 1, (size, size, 3))
    colours = np.repeat(np.repeat(colours, 8, 0), 8, 1).astype(np.float32)  # fields that JPEG leaves as they are
    image = bpy.data.images.new("light", 8 * size, 8 * size, float_buffer=True)
    image.pixels.foreach_set(np.dstack([colours[::-1], np.ones(colours.shape[:2], np.float32)]).ravel())
    scene.view_settings.view_transform, scene.view_settings.look = VIEWS[name].view, VIEWS[name].look
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth, settings.quality = kind, "8", 100
    path = tmp_path / f"render.{kind.lower()}"
    image.save_render(str(path), scene=scene)
    off = relative(images.read_linear(path, colorspace=name).pixels, colours)
    assert np.median(off) < 0.03 and np.percentile(off, 90) < (0.25 if name == "agx-punchy" else 0.1)
    for other in {"srgb", *VIEWS} - {name}:  # some take what another shows dark for bright
        assert np.median(relative(images.read_linear(path, colorspace=other).pixels, colours)) > 2 * np.median(off)
    assert not images.read_linear(path).is_render  # no time of a render in it: it may be anybody's picture


@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
def test_a_render_says_that_it_is_one_and_other_pictures_do_not(tmp_path, kind):
    scene = studio.clear()
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    scene.render.resolution_x = scene.render.resolution_y = 16
    scene.cycles.samples = 1
    scene.render.image_settings.file_format, scene.render.filepath = kind, str(tmp_path / "render")
    scene.render.use_file_extension = False
    with studio.quiet():
        bpy.ops.render.render(write_still=True)
    path = tmp_path / "render"
    assert images.read_linear(path).is_render and photo_file.facts_of(path) == (1, False, True, False)
    assert not images.read_linear(path).camera  # "Camera" is the scene's
    data = path.read_bytes()
    assert image_headers.is_render(data) and photo_file.facts_of(data).is_render
    for end in range(0, len(data), 7):
        assert image_headers.is_render(data[:end]) in (True, False)
    plain = tmp_path / f"plain.{kind.lower()}"
    bpy.data.images.new("painted", 16, 16).save_render(str(plain), scene=scene)
    assert not images.read_linear(plain).is_render and not photo_file.facts_of(plain).is_render
    assert photo_file.facts_of(tmp_path / "missing") == (1, False, False, False)


def test_both_sides_name_the_same_views_and_blender_has_them():
    assert {name: (v.view, v.look) for name, v in VIEWS.items()} == {name: tuple(v) for name, v in named.VIEWS.items()}
    view = studio.clear().view_settings
    for each in named.VIEWS.values():
        view.view_transform, view.look = each.transform, each.look
    assert all(named.FOUND.split("{")[0] + named.VIEWS[name].words == v.description for name, v in VIEWS.items())
