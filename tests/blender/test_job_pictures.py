# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks and depths that the add-on puts into a job, as the engine reads them."""

import json
import os
import resource

import bpy
import numpy as np
import pytest

from blender_btfsep.basics.errors import InputError
from blender_btfsep.scene.export import SURFACE, export_job
from btfsep_engine.imaging.colour_profile import of_primaries
from btfsep_engine.job.load import load_job

WIDTH, HEIGHT = 48, 32


def make_image(name, rgba, *, save=None):
    """An image with ``rgba : (h, w, 4)``, row 0 at the top; saved to the file ``save`` and opened again if given."""
    height, width = rgba.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=True)
    image.pixels.foreach_set(np.ascontiguousarray(rgba[::-1], np.float32).ravel())
    if save is None:
        return image
    image.filepath_raw, image.file_format = str(save), "PNG"
    image.save()
    bpy.data.images.remove(image)
    return bpy.data.images.load(str(save))


@pytest.fixture
def ball(scene, add_camera, tmp_path):
    """A scene with a ball of radius 1 in the origin, its camera at a slant, and a photo that is grey everywhere."""
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32)
    ball = bpy.context.object
    ball.data.shade_smooth()
    add_camera(scene, (3, -4, 2))
    make_image("photo", np.full((HEIGHT, WIDTH, 4), [0.5, 0.5, 0.5, 1]), save=tmp_path / "photo.png")
    return ball


@pytest.mark.parametrize("kind", ["painted", "file", "alpha"])
def test_the_engine_reads_the_mask_where_it_was_painted(scene, ball, tmp_path, kind):
    inside = np.zeros((HEIGHT, WIDTH), bool)
    inside[3:20, 5:31] = True
    inside[10, 8] = False
    rgba = np.zeros((HEIGHT, WIDTH, 4))
    rgba[..., :3] = inside[..., None] * [0, 0.004, 0] if kind != "alpha" else 1  # one step of 255, one channel
    rgba[..., 3] = inside if kind == "alpha" else 1
    mask = make_image("mask", rgba, save=None if kind == "painted" else tmp_path / "mask.png")
    before = list(bpy.data.images)
    folder = export_job(
        scene,
        tmp_path / "job",
        image_path=tmp_path / "photo.png",
        objects=[ball],
        occluders=[],
        masks={ball.name: mask},
        exposure_ev=1.25,
    ).parent
    job = load_job(folder)
    assert np.array_equal(job.objects[0].mask, inside) and job.exposure_ev == 1.25
    assert list(bpy.data.images) == before  # nothing of the export's stays


def test_masks_that_make_no_sense_are_refused(scene, ball, tmp_path):
    given = {"image_path": tmp_path / "photo.png", "objects": [ball], "occluders": []}
    for size, words in (((HEIGHT, WIDTH), "black everywhere"), ((WIDTH, HEIGHT), "the photo 48 x 32")):
        mask = make_image("mask", np.zeros((*size, 4)))
        with pytest.raises(InputError, match=words):
            export_job(scene, tmp_path / "job", masks={ball.name: mask}, **given)
        assert not (tmp_path / "job" / "job.json").exists()


def test_the_surface_of_a_depth_by_cycles_lies_where_the_ball_is(scene, ball, tmp_path):
    """Cycles' Z pass, opened as an image, exported: the engine's surface is the ball's, in the world."""
    scene.view_layers[0].use_pass_z = True
    scene.cycles.samples, scene.cycles.filter_width = 1, 0.01
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):  # Blender 5
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.filepath = str(tmp_path / "z.exr")
    bpy.ops.render.render(write_still=True, scene=scene.name)
    depth = bpy.data.images.load(str(tmp_path / "z.exr"))
    given = {"image_path": tmp_path / "photo.png", "occluders": [], "materials": {SURFACE: "wood/oak"}}
    job = load_job(export_job(scene, tmp_path / "job", objects=[], depth=depth, **given).parent)
    assert [(o.name, o.material) for o in job.objects] == [(SURFACE, "wood/oak")]
    radius = np.linalg.norm(job.objects[0].mesh.vertices, axis=1)
    assert len(radius) > 150 and np.abs(radius - 1).max() < 0.01
    with pytest.raises(InputError, match="there is a depth, too"):
        export_job(scene, tmp_path / "job", objects=[ball], depth=depth, **given)


def test_depths_that_are_no_exr_file_are_refused(scene, ball, tmp_path):
    given = {"image_path": tmp_path / "photo.png", "objects": [], "occluders": []}
    cases = {
        "is no file": make_image("painted", np.ones((HEIGHT, WIDTH, 4))),
        "it is a .png file": make_image("png", np.ones((HEIGHT, WIDTH, 4)), save=tmp_path / "z.png"),
        "no such file": str(tmp_path / "absent.exr"),
    }
    for words, depth in cases.items():
        with pytest.raises(InputError, match=words):
            export_job(scene, tmp_path / "job", depth=depth, **given)
    with pytest.raises(InputError, match="none is chosen"):
        export_job(scene, tmp_path / "job", **given)


def decoded(codes):
    """IEC 61966-2-1: linear values of codes from 0 to 1."""
    return np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("space", ["sRGB", "Non-Color", "Linear Rec.709"])
@pytest.mark.parametrize("kind", ["path", "file", "packed", "sequence", "painted"])
def test_the_engine_sees_the_colours_that_blender_sees(scene, ball, tmp_path, kind, space):
    """A PNG however it is handed over and whatever colours it is said to hold."""
    codes = np.round(np.random.default_rng(0).uniform(0.1, 0.9, (HEIGHT, WIDTH, 4)) * 255) / 255
    codes[..., 3] = 1
    photo = make_image("ramp", codes, save=tmp_path / "ramp_0001.png")
    photo.colorspace_settings.name = space
    if kind == "sequence":
        photo.source = "SEQUENCE"
    if kind == "packed":
        photo.pack()
        (tmp_path / "ramp_0001.png").unlink()
    if kind == "painted":
        photo.pixels[0] = codes[-1, 0, 0]  # the same, but Blender cannot know
        assert photo.is_dirty
    given = photo if kind != "path" else tmp_path / "ramp_0001.png"
    folder = export_job(scene, tmp_path / "job", image_path=given, objects=[ball], occluders=[]).parent
    seen = load_job(folder).photo.radiance
    truth = decoded(codes[..., :3]) if space == "sRGB" or kind == "path" else codes[..., :3]
    assert np.abs(seen - truth).max() < 1e-3


@pytest.mark.parametrize("kind", ["painted", "scaled", "bmp", "tga"])
def test_codes_that_blender_holds_stay_codes(scene, ball, tmp_path, kind):
    """The brightest are known to be bounds, and what is transparent is left out, though no file is taken as it is."""
    codes = np.round(np.random.default_rng(0).uniform(0.1, 0.9, (2 * HEIGHT, 2 * WIDTH, 4)) * 255) / 255
    codes[..., 3], codes[:8, :8, 1], codes[40:, 60:, 3] = 1, 1, 0
    image = make_image("ramp", codes)
    if kind == "scaled":
        image.scale(WIDTH, HEIGHT)
    elif kind != "painted":
        image.filepath_raw, image.file_format = str(tmp_path / f"ramp.{kind}"), {"bmp": "BMP", "tga": "TARGA"}[kind]
        image.save()
        image = bpy.data.images.load(image.filepath_raw)
    scene.render.resolution_x, scene.render.resolution_y = image.size
    folder = export_job(scene, tmp_path / "job", image_path=image, objects=[ball], occluders=[]).parent
    photo = load_job(folder).photo
    assert photo.bits == 8 and photo.saturated >= 9 and photo.clipped[:3, :3, 1].all()
    last = np.s_[-8:, -8:]
    assert not photo.usable[last].any() and not photo.clipped[last].any() and photo.usable[12:18].all()
    if kind != "scaled":
        np.testing.assert_allclose(photo.radiance[:40], decoded(codes[:40, :, :3]), atol=1e-5)


CIE_XYZ = [[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]]
SPACES = {
    "ACEScg": "acescg",
    "ACES2065-1": "aces2065-1",
    "Linear Rec.2020": "rec2020",
    "Display P3": "display-p3",
    "Linear CIE-XYZ D65": None,
}


@pytest.mark.parametrize("space", SPACES)
@pytest.mark.parametrize("kind", ["png", "exr"])
def test_colours_of_other_primaries_come_as_rec709(scene, ball, tmp_path, kind, space):
    """By Blender or by the engine, alike; and what is not opaque stays so."""
    codes = np.round(np.random.default_rng(0).uniform(0.2, 0.7, (HEIGHT, WIDTH, 4)) * 255) / 255
    codes[..., 3], codes[:5, :5, 3] = 1, 0
    image = bpy.data.images.new("wide", WIDTH, HEIGHT, alpha=True, float_buffer=kind == "exr", is_data=True)
    image.pixels.foreach_set(np.ascontiguousarray(codes[::-1], np.float32).ravel())
    image.filepath_raw, image.file_format = str(tmp_path / f"wide.{kind}"), {"png": "PNG", "exr": "OPEN_EXR"}[kind]
    image.save()
    image = bpy.data.images.load(image.filepath_raw)
    image.colorspace_settings.name = space
    folder = export_job(scene, tmp_path / "job", image_path=image, objects=[ball], occluders=[]).parent
    photo = load_job(folder).photo
    linear = decoded(codes[..., :3]) if space == "Display P3" else codes[..., :3]
    to_rec709 = np.array(CIE_XYZ) if SPACES[space] is None else of_primaries(SPACES[space]).to_rec709
    opaque = codes[..., 3] == 1
    assert np.abs(photo.radiance - linear @ to_rec709.T)[opaque].max() < 4e-3
    assert (photo.usable == opaque).all()


def test_images_that_are_not_one_picture_say_what_to_do(scene, ball, tmp_path):
    (tmp_path / "a.heic").write_bytes(b"\0\0\0\x24ftypheic" + bytes(99))
    (tmp_path / "a.nef").write_bytes(b"II*\0" + bytes(99))
    cases = {
        r"made of tiles \(UDIM\); open": bpy.data.images.new("tiles", WIDTH, HEIGHT, tiled=True),
        "HEIC picture.*; export it as JPEG": bpy.data.images.load(str(tmp_path / "a.heic")),
        "raw file; develop it": bpy.data.images.load(str(tmp_path / "a.nef")),
    }
    for words, image in cases.items():
        with pytest.raises(InputError, match=words):
            export_job(scene, tmp_path / "job", image_path=image, objects=[ball], occluders=[])


def listing(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_no_file_of_a_job_is_written_in_place(scene, ball, tmp_path):
    """A second name of each file of an earlier job keeps the earlier content: the new one is another file."""
    depth = tmp_path / "z.exr"
    image = bpy.data.images.new("z", WIDTH, HEIGHT, float_buffer=True)
    image.filepath_raw, image.file_format = str(depth), "OPEN_EXR"
    image.save()
    mask = make_image("mask", np.ones((HEIGHT, WIDTH, 4)))
    painted = bpy.data.images.new("painted", WIDTH, HEIGHT, float_buffer=True)
    jobs = [
        {"image_path": tmp_path / "photo.png", "objects": [ball], "masks": {ball.name: mask}},
        {"image_path": painted, "objects": [], "depth": str(depth)},
    ]
    for turn in range(2):
        for given in jobs:
            export_job(scene, tmp_path / "job", occluders=[], **given)
        if turn == 0:
            (tmp_path / "kept").mkdir()
            for path in (tmp_path / "job").iterdir():
                os.link(path, tmp_path / "kept" / path.name)
            before = listing(tmp_path / "kept")
            assert set(before) == {"job.json", "photo.png", "photo.exr", "depth.exr", f"mask_{ball.name}.png"} | {
                f"{ball.name}.ply"
            }
            ball.location.x = 0.5
            mask.pixels[:] = [0, 0, 0, 1] * (WIDTH * HEIGHT // 2) + [1] * (2 * WIDTH * HEIGHT)
            painted.pixels[:] = [0.5] * (4 * WIDTH * HEIGHT)
            for file in (tmp_path / "photo.png", depth):
                os.utime(file)
            bpy.context.view_layer.update()
    assert listing(tmp_path / "kept") == before
    same = [name for name in before if os.path.samefile(tmp_path / "job" / name, tmp_path / "kept" / name)]
    assert same == []


def test_a_job_for_which_the_disk_has_no_room_leaves_no_half_of_it(scene, ball, tmp_path):
    given = {"image_path": tmp_path / "photo.png", "objects": [ball], "occluders": []}
    folder = export_job(scene, tmp_path / "job", **given).parent
    job = json.loads((folder / "job.json").read_text())
    room = max(path.stat().st_size for path in folder.iterdir()) + 1000
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        with pytest.raises(InputError, match=r"cannot write .*job\.json; File too large"):
            export_job(scene, folder, **given, materials={ball.name: "x" * room})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert job["objects"] and sorted(listing(folder)) == sorted([job["image"], job["objects"][0]["mesh"]])
