# SPDX-License-Identifier: GPL-3.0-or-later
"""The photo behind the camera, the report and the Rendered view."""

import json
import struct

import bpy
import numpy as np
import pytest

from blender_btfsep.basics.errors import InputError
from blender_btfsep.light import kept_light, light_picture, lighting_file
from blender_btfsep.photo import camera
from blender_btfsep.photo.photo import file_at, named
from blender_btfsep.run import request, runs
from blender_btfsep.window import blender_views, camera_look, icons, looking, mending, sequence_run, use_photo
from btfsep_engine.imaging import images
from btfsep_engine.job.load import load_job
from tests.blender.lit import LIGHTING
from tests.engine.profiles import tiff
from tests.engine.test_camera_curve import exif, with_exif
from tests.engine.test_image_kinds import turned


def photo(path, width, height, *, space=None):
    image = bpy.data.images.new("made", width, height, float_buffer=path.suffix == ".exr")
    if path.stem == "deep":  # of 16 bits, of which Blender makes floats
        saved = bpy.context.scene.render.image_settings
        saved.file_format, saved.color_depth = "PNG", "16"
        image.save_render(str(path))
        return bpy.data.images.load(str(path))
    image.filepath_raw = str(path)
    image.file_format = {".png": "PNG", ".exr": "OPEN_EXR"}[path.suffix]
    image.save()
    bpy.data.images.remove(image)
    image = bpy.data.images.load(str(path))
    if space:
        image.colorspace_settings.name = space
    return image


def test_one_click_puts_the_photo_behind_the_camera(photographed, tmp_path):
    render = photographed.render
    render.resolution_percentage, render.pixel_aspect_x = 50, 2
    photographed.btfsep.image = image = photo(tmp_path / "wide.png", 60, 20)
    assert camera.shown(photographed, image.size) is None
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.btfsep.use_photo() == {"FINISHED"}
    assert camera.render_size(photographed) == (60, 20) and render.pixel_aspect_x == render.pixel_aspect_y == 1
    background = photographed.camera.data.background_images[0]
    assert background.image == image and background.show_background_image and background.alpha == 1
    assert (background.scale, tuple(background.offset)) == (1, (0, 0)) and use_photo.is_behind(photographed)
    assert bpy.ops.btfsep.use_photo() == {"FINISHED"}
    assert len(photographed.camera.data.background_images) == 1  # once
    bpy.ops.ed.undo_push(message="used")
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert scene.render.resolution_percentage == 50 and not scene.camera.data.background_images


def test_the_cameras_background_is_taken_for_the_photo(photographed):
    image, photographed.btfsep.image = photographed.btfsep.image, None
    with pytest.raises(RuntimeError, match="Open the photo first"):
        bpy.ops.btfsep.use_photo()
    background = photographed.camera.data.background_images.new()
    background.image = image
    assert bpy.ops.btfsep.use_photo() == {"FINISHED"}
    assert photographed.btfsep.image == image and len(photographed.camera.data.background_images) == 1


def test_what_cannot_be_estimated_is_said_before_the_click(photographed, tmp_path):
    settings, said = photographed.btfsep, lambda: request.missing(bpy.context)
    assert said() == ""
    photographed.camera.data.type = "PANO"
    for operator in (bpy.ops.btfsep.use_photo, bpy.ops.btfsep.estimate):
        with pytest.raises(RuntimeError, match="is panoramic"):
            operator()
    photographed.camera.data.type = "ORTHO"
    settings.image = photo(tmp_path / "wide.png", 60, 20)
    assert "press Use Photo" in said()
    bpy.ops.btfsep.use_photo()
    assert said() == ""
    (tmp_path / "wide.png").unlink()
    settings.image.reload()
    assert said() == "The photo's file wide.png is not there: choose the photo again"
    settings.image = photo(tmp_path / "again.png", 60, 20)
    settings.objects[0].material = "wood/oka"
    assert said() == ""  # the library was not read yet
    runs.run_state().library.add().name = "wood/oak"
    assert said().startswith("The library has no material 'wood/oka'")
    runs.run_state().library.clear()


def test_a_photo_of_the_render_region_lies_where_the_region_is(photographed, tmp_path):
    render = photographed.render
    render.resolution_x, render.resolution_y = 80, 40
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.5, 1.0, 0.25, 0.75
    photographed.btfsep.image = photo(tmp_path / "part.png", 400, 200)
    bpy.ops.btfsep.use_photo()
    assert camera.render_size(photographed) == (80, 40)  # as it was
    background = photographed.camera.data.background_images[0]
    assert background.scale == 0.5 and tuple(background.offset) == (0.25, 0)


def test_an_image_sequence_stands_behind_at_the_frames_of_its_numbers(photographed, tmp_path):
    for number in (7, 8, 9):
        image = photo(tmp_path / f"shot_{number:04}.png", 48, 32)
    image.source = "SEQUENCE"
    photographed.btfsep.image = image
    bpy.ops.btfsep.use_photo()
    user = photographed.camera.data.background_images[0].image_user
    assert (user.frame_start, user.frame_duration, user.frame_offset) == (7, 3, 6)
    assert sequence_run.start_of(image, photographed.camera, 7) == 7


def test_the_photo_of_a_sequence_is_the_one_behind_the_camera_at_the_frame(photographed, tmp_path):
    for number, shade in ((7, 0.2), (8, 0.5), (9, 0.8)):
        made = photo(tmp_path / f"shot_{number:04}.png", 48, 32)
        made.pixels.foreach_set(np.repeat(np.float32([[shade, shade, shade, 1]]), 48 * 32, 0).ravel())
        made.save()
        bpy.data.images.remove(made)
    image = bpy.data.images.load(str(tmp_path / "shot_0009.png"))
    image.source = "SEQUENCE"
    photographed.btfsep.image = image
    camera = photographed.camera
    assert file_at(image, camera, 7).name == "shot_0009.png"  # the one that was opened
    bpy.ops.btfsep.use_photo()
    for frame, number in ((7, 7), (8, 8), (9, 9), (30, 9), (-3, 7)):
        photographed.frame_set(frame)
        folder = request.write_job(bpy.context)
        assert (folder / "photo.png").read_bytes() == (tmp_path / f"shot_{number:04}.png").read_bytes()
        shown = light_picture.small(image, file_at(image, camera, frame))
        assert np.allclose(shown, {7: 0.2, 8: 0.5, 9: 0.8}[number], atol=0.01)
    (tmp_path / "shot_0008.png").unlink()
    photographed.frame_set(8)
    assert "shot_0008.png is not there" in request.missing(bpy.context)
    with pytest.raises(InputError, match=r"the photo shot_0008\.png; there is no such file"):
        request.write_job(bpy.context)


def test_a_movie_is_no_photo(photographed):
    """Blender gives the pixels of its first frame alone."""
    photographed.btfsep.image.source = "MOVIE"
    assert "is a movie: save it as an image sequence" in request.missing(bpy.context)
    with pytest.raises(InputError, match="it is a movie; save it"):
        request.write_job(bpy.context)


def test_a_photo_of_another_shape_than_the_region_is_one_of_the_whole_picture(photographed, tmp_path):
    render = photographed.render
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_max_x = 0.5, 0.9
    photographed.btfsep.image = photo(tmp_path / "wide.png", 90, 30)
    bpy.ops.btfsep.use_photo()
    assert camera.shown(photographed, (90, 30)) == (0, 0, 90, 30) and camera.render_region(photographed)[2:] == (90, 30)


@pytest.mark.parametrize(
    ("name", "space", "curve", "words"),
    [
        ("a.png", None, "auto", "read as sRGB"),
        ("a.png", None, "camera", "read by the usual curve of cameras"),
        ("a.png", "Non-Color", "auto", "read as linear light"),
        ("a.png", "AgX Base sRGB", "auto", "read as AgX Base sRGB, as Blender shows it"),
        ("a.png", "Display P3", "auto", "read as Display P3"),
        ("a.png", None, "unknown", "its tone curve is found from the photo"),
        ("a.png", None, "blender", "its view transform is found from the photo"),
        ("a.png", None, "agx-punchy", "read as a render saved with AgX, Punchy"),
        ("a.png", None, "linear", "read as linear light"),
        ("a.exr", None, "srgb", "read as linear light (floats)"),
        ("deep.png", None, "auto", "read as sRGB"),
        ("deep.png", None, "linear", "read as linear light"),
    ],
)
def test_how_the_photo_is_read_is_what_the_job_says(photographed, tmp_path, name, space, curve, words):
    image = photo(tmp_path / name, 48, 32, space=space)
    assert use_photo.read_as(image, curve) == words
    photographed.btfsep.image, photographed.btfsep.curve = image, curve
    job = json.loads((request.write_job(photographed, folder=tmp_path / "job") / "job.json").read_text())
    linear = job["image_colorspace"] == "linear" or job["image"].endswith(".exr")
    coded = ("sRGB", "Display P3", "found", "of cameras", "AgX, Punchy")
    assert linear == all(each not in words.removeprefix("read as AgX Base sRGB") for each in coded)


def test_the_engine_calls_the_photo_by_its_own_name(addon, tmp_path):
    image = photo(tmp_path / "holiday.png", 8, 8)
    said = ["photo.png: 7 of 64 pixels are saturated", "object 'photo.png: x' is odd"]
    assert named(image, said) == ["holiday.png: 7 of 64 pixels are saturated", said[1]]
    assert named(None, said) == said


def test_another_photo_hides_the_one_before(photographed, tmp_path):
    first, second = (photo(tmp_path / name, 64, 48) for name in ("first.png", "second.png"))
    behind = photographed.camera.data.background_images
    for chosen, other in ((first, None), (second, first), (first, second)):
        photographed.btfsep.image = chosen
        said = use_photo.use(bpy.context)
        assert [b.image for b in behind if b.show_background_image] == [chosen]
        assert (other is None) or f"'{other.name}' behind it is hidden" in said
    assert len(behind) == 2
    behind[1].show_background_image, behind[1].display_depth = True, "FRONT"  # a reference picture of the user's
    use_photo.use(bpy.context)
    assert behind[1].show_background_image


def test_what_the_file_says_of_who_made_it_is_said(photographed, tmp_path):
    (tmp_path / "a.jpg").write_bytes(with_exif(".jpg", exif("Canon", "Canon EOS 6D", "<")))
    image = bpy.data.images.load(str(tmp_path / "a.jpg"))
    assert use_photo.read_as(image, "auto") == "read as sRGB and by the usual curve of cameras: the file names one"
    (tmp_path / "p.jpg").write_bytes(with_exif(".jpg", exif("Apple", "iPhone 13", "<")))
    image = bpy.data.images.load(str(tmp_path / "p.jpg"))
    assert use_photo.read_as(image, "auto") == "read as sRGB and as a phone's own picture: the file names one"
    data = (tmp_path / "a.jpg").read_bytes()
    marked = data[:2] + b"\xff\xfe" + (29 + 2).to_bytes(2, "big") + b"Blender:RenderTime:00:01.00\0\0" + data[2:]
    (tmp_path / "b.jpg").write_bytes(marked.replace(b"Exif", b"Exof"))
    image = bpy.data.images.load(str(tmp_path / "b.jpg"))
    assert use_photo.read_as(image, "auto") == (
        "the file says that Blender rendered it; its view transform is found from the photo"
    )
    assert images.read_linear(tmp_path / "b.jpg").is_render
    assert use_photo.read_as(image, "srgb") == "read as sRGB"


def test_a_tiff_of_floats_is_linear_light(photographed, tmp_path):
    """Blender takes its numbers for coded ones; developed from raw, as 32-bit TIFF, they are light."""
    light = np.random.default_rng(0).uniform(0.1, 2, (32, 48, 3)).astype(np.float32)
    path = tmp_path / "a.tif"
    path.write_bytes(tiff(light, {339: (3, 3, struct.pack("<3H", 3, 3, 3))}))
    image = photographed.btfsep.image = bpy.data.images.load(str(path))
    photographed.btfsep.curve = "srgb"
    assert use_photo.read_as(image, "srgb") == "read as linear light (floats)"
    photographed.render.resolution_x, photographed.render.resolution_y = 48, 32
    found = load_job(request.write_job(photographed, folder=tmp_path / "job")).photo
    np.testing.assert_array_equal(found.radiance, light)
    codes = tmp_path / "b.tif"
    codes.write_bytes(tiff((light * 30000).astype(np.uint16)))
    assert use_photo.read_as(bpy.data.images.load(str(codes)), "srgb") == "read as sRGB"


def test_a_photo_that_is_to_be_turned_lies_as_it_is_stored_and_that_is_said(photographed, tmp_path, capfd):
    for number in (1, 6):
        path = tmp_path / f"a{number}.jpg"
        path.write_bytes(with_exif(".jpg", turned(number), 30, 40))
        image = photographed.btfsep.image = bpy.data.images.load(str(path))
        assert tuple(image.size) == (40, 30)
        bpy.ops.btfsep.use_photo()
        assert camera.render_size(photographed) == (40, 30)
        assert (use_photo.PRESS in capfd.readouterr().out) == (number == 6)


def test_a_photo_is_looked_at_once_and_again_when_it_is_another(photographed, tmp_path):
    image = photo(tmp_path / "a.png", 1500, 30)
    first = light_picture.small(image)
    assert first.shape == (20, 1024, 3) and tuple(image.size) == (1500, 30)
    assert light_picture.small(image) is first
    assert light_picture.small(photo(tmp_path / "b.png", 60, 30)).shape == (30, 60, 3)
    painted = bpy.data.images.new("painted", 8, 8)
    before = light_picture.small(painted).mean()
    painted.pixels.foreach_set(np.ones(256, np.float32))
    assert light_picture.small(painted).mean() > before


@pytest.fixture
def lit(photographed, tmp_path):
    """A light is kept, with a report."""
    image = photo(tmp_path / "report.png", 40, 8)
    bpy.data.images.remove(image)
    kept_light.keep(photographed, lighting_file.validate(dict(LIGHTING)), {"out": str(tmp_path)})
    return photographed


def test_the_report_is_shown_in_an_image_editor(lit, tmp_path):
    (tmp_path / "report.png").unlink()  # it is in the file
    area = bpy.context.window_manager.windows[0].screen.areas[0]
    before, area.type = area.type, "IMAGE_EDITOR"
    try:
        assert bpy.ops.btfsep.show_report() == {"FINISHED"}
        assert area.spaces.active.image == lit.btfsep.light.report and tuple(area.spaces.active.image.size) == (40, 8)
    finally:
        area.type = before
    lit.btfsep.light.report = None
    with pytest.raises(RuntimeError, match="Estimate the light first"):
        bpy.ops.btfsep.show_report()


def test_the_rendered_view_has_the_photos_colours_and_says_what_it_changed(lit, capfd):
    view = lit.view_settings
    view.view_transform, view.exposure = "AgX", 1.5
    bpy.ops.btfsep.use_photo()
    state = runs.run_state()
    state.overlay = "OUTLINE"
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.btfsep.rendered_view() == {"FINISHED"}
    said = capfd.readouterr().out
    for words in ("View transform: Standard, was AgX", "Exposure: 0, was 1.5", "Film: transparent", "Photo: off"):
        assert words in said
    assert state.overlay == "OFF"
    assert (view.view_transform, view.exposure, lit.render.film_transparent) == ("Standard", 0, True)
    assert bpy.ops.btfsep.rendered_view() == {"FINISHED"} and "as the photo's already" in capfd.readouterr().out
    bpy.ops.ed.undo_push(message="looked")
    bpy.ops.ed.undo()
    assert bpy.context.scene.view_settings.view_transform == "AgX" and not bpy.context.scene.render.film_transparent


def test_a_plate_that_is_read_as_agx_is_looked_at_through_agx(lit, tmp_path):
    lit.btfsep.image, lit.btfsep.curve = bpy.data.images.new("plate", 8, 8), "agx"
    lit.view_settings.view_transform, lit.view_settings.exposure = "Standard", 0.5
    assert looking.look_of(lit) == {"view_transform": "AgX", "exposure": 0.0}
    lit.btfsep.image = photo(tmp_path / "deep.png", 8, 8)
    assert lit.btfsep.image.is_float and looking.look_of(lit) == {"view_transform": "AgX", "exposure": 0.0}
    lit.btfsep.image = bpy.data.images.new("floats", 8, 8, float_buffer=True)
    assert looking.look_of(lit) == {"exposure": 0.0}


def test_the_rendered_view_of_a_cameras_photo_has_its_curve_and_another_none(lit, tmp_path, capfd):
    view, lit.btfsep.curve = lit.view_settings, "camera"
    assert bpy.ops.btfsep.rendered_view() == {"FINISHED"} and "a camera's" in capfd.readouterr().out
    assert camera_look.is_set(view)
    assert bpy.ops.btfsep.rendered_view() == {"FINISHED"} and "curves" not in capfd.readouterr().out
    lit.btfsep.curve = "srgb"
    assert looking.curves(lit) == ["RGB curves: off, were on"] and not view.use_curve_mapping
    assert looking.curves(lit) == []


@pytest.mark.parametrize(("curve", "read", "view"), [
    ("auto", "the photo's tone curve is of what Blender saved by evidence Blender's view transform AgX, Punchy "
     "(probability 0.60); also possible: Blender's view transform AgX (probability 0.31)", ("AgX", "AgX - Punchy")),
    ("unknown", "the tone curve is by evidence Blender's view transform AgX (probability 0.9)", ("AgX", "None")),
    ("blender", "the photo's tone curve is of what Blender saved by evidence sRGB (probability 0.6); also possible: "
     "Blender's view transform Filmic (probability 0.3)", None),
    ("srgb", "the photo's tone curve is by evidence Blender's view transform AgX (probability 0.90)", None),
    ("agx-high-contrast", "", ("AgX", "AgX - High Contrast")),
])  # fmt: skip
def test_the_rendered_view_is_that_of_the_photo(lit, monkeypatch, curve, read, view):
    lit.btfsep.image, lit.btfsep.curve = bpy.data.images.new("plate", 8, 8), curve
    monkeypatch.setattr(blender_views.kept_light, "card", lambda light: {"details": ["AgX", read]})
    assert blender_views.of_photo(lit) == view
    lit.view_settings.view_transform = "Raw"
    wanted = looking.look_of(lit)
    assert (wanted["view_transform"], wanted.get("look", "None")) == (view or ("Standard", "None"))


@pytest.mark.parametrize(("curve", "read", "wanted"), [
    ("auto", "the photo's tone curve is a camera's usual curve, as the file is from Canon EOS 6D", True),
    ("auto", "the photo's tone curve is sRGB, as whole numbers are by default", False),
    ("srgb", "the photo's tone curve is a camera's usual curve, as the file is from Canon EOS 6D", False),
    ("camera", "", True),
])  # fmt: skip
def test_a_file_that_names_its_camera_is_known_by_what_the_engine_said(lit, monkeypatch, curve, read, wanted):
    lit.btfsep.curve = curve
    monkeypatch.setattr(camera_look.kept_light, "card", lambda light: {"details": [read]})
    assert camera_look.is_wanted(lit) == wanted


def test_icons_show_the_picture_that_is_kept(lit):
    picture = lit.btfsep.light.picture
    before = set(icons._previews)
    assert icons.of_image(picture) == icons.of_image(picture)
    (key,) = set(icons._previews) - before
    shown = np.array(icons._previews[key].image_pixels_float)
    assert np.allclose(shown, np.array(picture.pixels), atol=1 / 255) and np.ptp(shown) > 0.5
    for trust in ("GREEN", "AMBER", "RED", "other"):
        icons.light(trust)
    preview = icons._previews["GREEN"]
    middle = np.array(preview.image_pixels_float).reshape(*preview.image_size, 4)[16, 16]
    assert middle[1] > max(middle[0], middle[2]) and middle[3] == 1


def test_what_stands_around_is_selected_to_look_at_its_material(photographed):
    bpy.ops.mesh.primitive_plane_add()
    table = bpy.context.object
    table.name = "Table"
    bpy.ops.mesh.primitive_monkey_add()
    bpy.ops.object.mode_set(mode="EDIT")
    assert bpy.ops.btfsep.mend(how="SELECT", object="Gone\nTable") == {"FINISHED"}
    assert bpy.context.selected_objects == [table] and bpy.context.object == table and table.mode == "OBJECT"
    spaces = [area.spaces.active for screen in bpy.data.screens for area in screen.areas]
    shown = {space.context for space in spaces if space.type == "PROPERTIES" and space.id_data == bpy.context.screen}
    assert shown <= {"MATERIAL"}
    with pytest.raises(RuntimeError, match="'Gone'; no object of this view layer has that name"):
        bpy.ops.btfsep.mend(how="SELECT", object="Gone")


def test_a_ground_is_put_under_the_objects_as_a_render_shows_them(photographed):
    bpy.ops.mesh.primitive_cube_add(size=2, location=(3, 1, 5), rotation=(0, np.pi / 4, 0))
    photographed.btfsep.objects.clear()
    photographed.btfsep.objects.add().object = bpy.context.object
    photographed.btfsep.occluders = "NONE"
    assert bpy.ops.btfsep.mend(how="GROUND") == {"FINISHED"}
    ground = bpy.data.objects["Ground"]
    corners = np.array([ground.matrix_world @ vertex.co for vertex in ground.data.vertices])
    diagonal = 2 * np.sqrt(2)
    np.testing.assert_allclose(corners[:, 2], 5 - diagonal / 2, atol=1e-5)
    np.testing.assert_allclose(np.ptp(corners, axis=0)[:2], 8 * diagonal, rtol=1e-5)
    np.testing.assert_allclose(corners.mean(0)[:2], [3, 1], atol=1e-5)
    assert ground.is_shadow_catcher and photographed.btfsep.occluders == "OTHERS" and not ground.data.materials
    assert ground.data.polygons[0].normal.z > 0
    with pytest.raises(RuntimeError, match="'Ground' is in the scene already"):
        bpy.ops.btfsep.mend(how="GROUND")
    bpy.data.objects.remove(ground)
    photographed.btfsep.objects.clear()
    with pytest.raises(RuntimeError, match="none of them has faces"):
        bpy.ops.btfsep.mend(how="GROUND")


def test_textures_are_kept_as_they_are_and_one_undo_takes_it_back(photographed):
    assert photographed.btfsep.delight == "auto"
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.btfsep.mend("EXEC_DEFAULT", True, how="KEEP", object="Cube") == {"FINISHED"}
    scene = bpy.context.scene
    assert scene.btfsep.delight == "never"
    assert request.engine_arguments("estimate", "job", scene)[-2:] == ["--delight", "never"]
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert scene.btfsep.delight == "auto" and "--delight" not in request.engine_arguments("estimate", "job", scene)
    bpy.ops.ed.redo()
    assert bpy.context.scene.btfsep.delight == "never"


@pytest.mark.parametrize("how", ["COLOUR", "BLENDER", "MATERIAL", "CURVE", "AGX", "STANDARD", "CAMERA"])
def test_doubts_are_mended_where_they_arise(photographed, how):
    bpy.ops.mesh.primitive_monkey_add()
    photographed.btfsep.objects.add().object = bpy.context.object
    assert bpy.ops.btfsep.mend(how=how, object="Suzanne") == {"FINISHED"}
    if how in mending.READ_AS:
        assert photographed.btfsep.curve == mending.READ_AS[how]
        return
    assert photographed.btfsep.active_object == 1
    assert [e.source for e in photographed.btfsep.objects] == ["RECOGNISE", {"MATERIAL": "LIBRARY"}.get(how, how)]
    with pytest.raises(RuntimeError, match="'Gone'; it is not in the list"):
        bpy.ops.btfsep.mend(how=how, object="Gone")
