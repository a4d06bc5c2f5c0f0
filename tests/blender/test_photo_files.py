# SPDX-License-Identifier: GPL-3.0-or-later
"""The photo's file, as people treat it: overwritten by another program, a movie, tiles; what is not taken is said."""

import bpy
import pytest

from blender_btfsep.basics.errors import InputError
from blender_btfsep.light import light_picture
from blender_btfsep.run import answer, reasons, request
from btfsep_engine.job.load import load_job


def written(path, width, height):
    """A PNG at ``path``, as another program writes it."""
    made = bpy.data.images.new("made", width, height)
    made.filepath_raw, made.file_format = str(path.with_suffix(".new")), "PNG"
    made.save()
    bpy.data.images.remove(made)
    path.with_suffix(".new").replace(path)
    return path


def test_a_photo_and_a_mask_that_another_program_wrote_anew_are_read_anew(photographed, tmp_path):
    settings, file = photographed.btfsep, tmp_path / "photo.png"
    mask = settings.objects[0].mask = bpy.data.images.load(str(written(tmp_path / "mask.png", 48, 32)))
    mask.pixels.foreach_set([1.0] * (4 * 48 * 32))
    mask.save()
    assert request.missing(bpy.context) == "" and list(settings.image.size) == [48, 32]
    request.write_job(bpy.context, folder=tmp_path / "job")
    before = light_picture.small(settings.image)
    written(file, 96, 64)
    settings.objects[0].mask = None
    request.write_job(bpy.context, folder=tmp_path / "job")
    assert load_job(tmp_path / "job").camera.width == 96 and list(settings.image.size) == [96, 64]
    assert light_picture.small(settings.image).shape == (64, 96, 3) and before.shape == (32, 48, 3)
    settings.objects[0].mask = mask
    written(tmp_path / "mask.png", 96, 64)
    with pytest.raises(InputError, match="it is black everywhere"):  # as it is now: of the right size
        request.write_job(bpy.context, folder=tmp_path / "job")
    written(file, 48, 96)
    with pytest.raises(InputError, match="it is 48 x 96, the scene renders 48 x 32"):
        request.write_job(bpy.context, folder=tmp_path / "job")


def test_what_blender_has_and_no_file_stays(photographed, tmp_path):
    """Strokes that are not saved, and what is packed, are the user's own."""
    image, file = photographed.btfsep.image, tmp_path / "photo.png"
    assert request.missing(bpy.context) == ""
    image.pixels.foreach_set([0.5] * (4 * 48 * 32))
    assert image.is_dirty
    written(file, 96, 64)
    request.write_job(bpy.context, folder=tmp_path / "job")
    assert list(image.size) == [48, 32] and image.pixels[0] == pytest.approx(0.5, abs=0.01)
    image.pack()
    written(file, 24, 16)
    request.write_job(bpy.context, folder=tmp_path / "job")
    assert list(image.size) == [48, 32]


@pytest.mark.parametrize("source", ["MOVIE", "TILED"])
def test_what_is_no_single_picture_is_not_taken_from_behind_the_camera(photographed, source):
    settings, behind = photographed.btfsep, photographed.camera.data.background_images.new()
    behind.image, settings.image = settings.image, None
    assert bpy.ops.btfsep.use_photo.poll()
    behind.image.source = source
    with pytest.raises(RuntimeError, match=r"is a movie: save|is made of tiles \(UDIM\): open"):
        bpy.ops.btfsep.use_photo()
    assert settings.image is None
    settings.image = behind.image
    assert reasons.no_single_picture(behind.image) == request.missing(bpy.context) != ""


def test_a_plain_surface_is_not_called_as_a_material_of_the_library(photographed):
    found = [{"name": "Cube", "material": "surface/matte", "unknown": True, "candidates": []}]
    assert answer.take_materials(photographed, found) == ["Cube: plain matte (unsure)"]
