# SPDX-License-Identifier: GPL-3.0-or-later
"""Turn Upright: the engine reads of the upright copy what it reads of the photo's own file, turned."""

import struct
import zlib

import bpy
import cv2
import numpy as np
import pytest

from blender_btfsep import command
from blender_btfsep.basics.errors import InputError
from blender_btfsep.photo import camera, photo, photo_file, upright, upright_png
from blender_btfsep.run import request
from blender_btfsep.window import live_changes, use_photo
from btfsep_engine.imaging import images
from btfsep_engine.job.load import load_job
from tests.engine import profiles
from tests.engine.test_camera_curve import exif, with_exif

UPRIGHT = {  # of EXIF, by OpenCV
    2: lambda a: cv2.flip(a, 1),
    3: lambda a: cv2.rotate(a, cv2.ROTATE_180),
    4: lambda a: cv2.flip(a, 0),
    5: cv2.transpose,
    6: lambda a: cv2.rotate(a, cv2.ROTATE_90_CLOCKWISE),
    7: lambda a: cv2.flip(cv2.transpose(a), -1),
    8: lambda a: cv2.rotate(a, cv2.ROTATE_90_COUNTERCLOCKWISE),
}
KINDS = {"a.jpg": ".jpg", "grey.jpg": ".jpg", "a.png": ".png", "deep.png": ".png", "a.webp": ".webp", "a.tif": ".tif"}


def block(number: int, order: str = "<") -> bytes:
    """EXIF of a phone that asks for a turn."""
    old = exif("Apple", "iPhone 15", order)
    entries = old[10:34] + struct.pack(order + "HHIHH", 274, 3, 1, number, 0)
    return old[:4] + struct.pack(order + "I", len(old)) + old[8:] + struct.pack(order + "H", 3) + entries + bytes(4)


def lying(path, number: int, *, order: str = "<", profile: str = "p3"):
    """A photo of 30 x 20 pixels of a phone, in Display P3, whose file asks to be turned; some of it is clipped."""
    rng, suffix = np.random.default_rng(number), KINDS[path.name]
    deep, grey = path.stem == "deep" or suffix == ".tif", path.stem == "grey"
    picture = rng.integers(0, 65536 if deep else 256, (20, 30, 1 if grey else 3)).astype(
        np.uint16 if deep else np.uint8
    )
    picture[:8, :8] = np.iinfo(picture.dtype).max
    said = profiles.icc(profile, profiles.power(2.2) if grey else profiles.SRGB_CURVE, b"GRAY" if grey else b"RGB ")
    data = block(number, order)
    if suffix == ".tif":
        name = {271: (2, 6, b"Apple\0"), 272: (2, 10, b"iPhone 15\0"), 274: (3, 1, struct.pack("<H", number))}
        path.write_bytes(profiles.tiff(picture, name | {34675: (7, len(said), said)}))
    elif suffix == ".jpg":
        how = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422]  # its colours are coarse
        plain, half = cv2.imencode(suffix, picture, how)[1].tobytes(), len(said) // 2
        parts = segment(0xE2, b"ICC_PROFILE\0\2\2" + said[half:]), segment(0xE2, b"ICC_PROFILE\0\1\2" + said[:half])
        path.write_bytes(plain[:2] + segment(0xE1, b"Exif\0\0" + data) + b"".join(parts) + plain[2:])
    elif suffix == ".png":
        whole = profiles.with_profile(suffix, picture, said)
        path.write_bytes(whole[:33] + profiles.chunk(b"eXIf", data) + whole[33:])
    else:
        whole = profiles.with_profile(suffix, picture, said)
        path.write_bytes(whole + b"EXIF" + struct.pack("<I", len(data)) + data + bytes(len(data) % 2))
    return path


def segment(kind: int, content: bytes) -> bytes:
    """A segment of a JPEG."""
    return bytes((255, kind)) + struct.pack(">H", len(content) + 2) + content


def read(path):
    return images.read_linear(path, by_camera=True)


def same(found, own, turn):
    """That ``found`` is the Photo or Image ``own``, turned, to the last code."""
    for name in ("pixels", "usable", "clipped"):
        wanted = turn(np.ascontiguousarray(getattr(own, name)).astype(np.float32))
        np.testing.assert_array_equal(np.squeeze(getattr(found, name)), np.squeeze(wanted))
    assert own.camera == found.camera == "Apple iPhone 15" and own.bits == found.bits
    assert own.profile.name == found.profile.name and own.profile.followed and found.orientation == 1
    assert own.coarse_chroma == found.coarse_chroma


@pytest.mark.parametrize(("name", "number"), [("a.jpg", n) for n in UPRIGHT] + [(n, 6) for n in KINDS if n != "a.jpg"])
def test_nothing_is_lost_of_a_photo_that_is_turned(addon, tmp_path, name, number):
    path = lying(tmp_path / name, number, order=">" if number == 8 else "<")
    image = bpy.data.images.load(str(path))
    assert upright.orientation_of(image) == number
    copy = upright.copy_of(image)
    assert upright.orientation_of(copy) == 1 and not copy.is_dirty and len(list(tmp_path.iterdir())) == 1
    put = photo.put_into_job(copy, tmp_path)
    assert (put.colorspace, put.primaries) == ("auto", "auto")
    own, found = read(path), read(tmp_path / put.name)
    assert put.size == found.pixels.shape[1::-1] == ((20, 30) if number > 4 else (30, 20))
    same(found, own, UPRIGHT[number])
    assert own.coarse_chroma == (name == "a.jpg") and found.clipped.any()


def test_alpha_and_chunks_of_a_png_come_along(addon, tmp_path):
    codes = np.random.default_rng(0).integers(0, 65536, (6, 8, 4)).astype(np.uint16)
    codes[0, 0, 3] = 65535
    data = cv2.imencode(".png", codes)[1].tobytes()
    chunks = profiles.chunk(b"gAMA", struct.pack(">I", 50000)) + profiles.chunk(b"eXIf", block(8))
    (tmp_path / "a.png").write_bytes(data[:33] + chunks + data[33:])
    image = bpy.data.images.load(str(tmp_path / "a.png"))
    image.alpha_mode = "NONE"  # as Blender is to show it
    copy = upright.copy_of(image)
    assert copy.alpha_mode == "NONE"
    (tmp_path / "b.png").write_bytes(copy.packed_file.data)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "b.png"), -1), UPRIGHT[8](codes))
    own, found = read(tmp_path / "a.png"), read(tmp_path / "b.png")
    np.testing.assert_array_equal(found.pixels, UPRIGHT[8](own.pixels))
    assert own.profile.name == found.profile.name and found.usable.sum() == own.usable.sum()


def test_one_button_turns_the_photo_and_uses_it(photographed, tmp_path, capfd):
    settings, path = photographed.btfsep, lying(tmp_path / "a.jpg", 6)
    image = settings.image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Display P3"
    photographed.render.resolution_x, photographed.render.resolution_y = 20, 30
    assert "renders 20 x 30: press Turn Upright" in request.missing(bpy.context)
    bpy.ops.btfsep.use_photo()
    assert "press Turn Upright" in capfd.readouterr().out and camera.render_size(photographed) == (30, 20)
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.btfsep.turn_upright() == {"FINISHED"}
    turned, behind = settings.image, photographed.camera.data.background_images
    assert turned != image and [b.image for b in behind] == [turned] and use_photo.is_behind(photographed)
    assert camera.render_size(photographed) == (20, 30) and request.missing(bpy.context) == ""
    assert turned.colorspace_settings.name == "Display P3" and "Turn Upright" not in capfd.readouterr().out
    assert live_changes.told(photographed) == live_changes.told(photographed)
    with pytest.raises(RuntimeError, match="does not ask"):
        bpy.ops.btfsep.turn_upright()
    own = images.read_linear(path, primaries="display-p3", by_camera=True)
    found = load_job(request.write_job(photographed, folder=tmp_path / "job")).photo
    np.testing.assert_array_equal(found.radiance, UPRIGHT[6](own.pixels))
    assert found.coarse_chroma and found.camera == "Apple iPhone 15"

    bpy.ops.ed.undo_push(message="turned")
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert scene.btfsep.image.name == "a.jpg" and camera.render_size(scene) == (30, 20)
    assert [b.image.name for b in scene.camera.data.background_images] == ["a.jpg"]
    bpy.ops.btfsep.turn_upright()
    path.unlink()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "kept.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "kept.blend"))
    scene = bpy.context.scene
    assert upright.orientation_of(scene.btfsep.image) == 1 and request.missing(bpy.context) == ""
    again = load_job(request.write_job(scene, folder=tmp_path / "again")).photo
    np.testing.assert_array_equal(again.radiance, found.radiance)


def test_a_packed_photo_of_a_relative_path_is_turned_where_its_file_is_gone(photographed, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    path = lying(tmp_path / "a.jpg", 3)
    image = bpy.context.scene.btfsep.image = bpy.data.images.load(str(path))
    image.filepath = "//a.jpg"
    own = read(path)
    assert upright.orientation_of(image) == 3
    image.pack()
    path.unlink()
    assert upright.orientation_of(image) == 3
    bpy.ops.btfsep.turn_upright()
    scene = bpy.context.scene
    assert scene.btfsep.image.filepath == "//a upright.png"
    found = load_job(request.write_job(scene, folder=tmp_path / "job")).photo
    np.testing.assert_array_equal(found.radiance, UPRIGHT[3](own.pixels))


def test_what_is_not_turned_says_why_and_leaves_nothing(photographed, tmp_path, capfd):
    settings, before = photographed.btfsep, len(bpy.data.images)
    floats = {339: (3, 3, struct.pack("<3H", 3, 3, 3)), 274: (3, 1, struct.pack("<H", 6))}
    (tmp_path / "f.tif").write_bytes(profiles.tiff(np.ones((32, 48, 3), np.float32), floats))
    data = with_exif(".jpg", block(6))
    profile = b"ICC_PROFILE\0\1\1" + profiles.icc("p3", profiles.SRGB_CURVE).replace(b"RGB ", b"CMYK", 1)
    (tmp_path / "c.jpg").write_bytes(data[:2] + segment(0xE2, profile) + data[2:])
    for name, why in (("f.tif", "floating-point numbers"), ("c.jpg", "colours are not RGB")):
        image = settings.image = bpy.data.images.load(str(tmp_path / name))
        with pytest.raises(RuntimeError, match=f"the photo '{name}'; .*{why}"):
            bpy.ops.btfsep.turn_upright()
        assert settings.image == image
    assert len(bpy.data.images) == before + 2
    painted = settings.image = bpy.data.images.load(str(lying(tmp_path / "a.jpg", 6)))
    painted.pixels[0] = 0.5
    assert upright.orientation_of(painted) == 1
    bpy.ops.btfsep.use_photo()
    assert use_photo.TURNED in capfd.readouterr().out
    gone = settings.image = bpy.data.images.load(str(lying(tmp_path / "a.webp", 6)))
    (tmp_path / "a.webp").unlink()
    assert upright.orientation_of(gone) == upright.orientation_of(None) == 1


def test_without_a_window(photographed, tmp_path, capsys):
    path, settings = lying(tmp_path / "a.jpg", 6), photographed.btfsep
    photographed.render.resolution_x, photographed.render.resolution_y = 20, 30
    own, before = read(path), len(bpy.data.images)
    words = ["export", "--job", str(tmp_path / "job")]
    assert command.main([*words, "--image", str(path)]) == 2
    said = capsys.readouterr().err
    assert "which --upright does" in said and "it is 30 x 20, the scene renders 20 x 30" in said
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    for given in (str(path), "//a.jpg"):
        assert command.main([*words, "--upright", "--image", given]) == 0
        found = load_job(tmp_path / "job")
        np.testing.assert_array_equal(found.photo.radiance, UPRIGHT[6](own.pixels))
        assert "--upright" not in capsys.readouterr().err
        assert not any("to be turned" in warning for warning in found.warnings)
    assert len(bpy.data.images) == before and settings.image.name == "photo.png"
    assert command.main([*words, "--upright", "--image", str(tmp_path / "no.jpg")]) == 2
    settings.image = bpy.data.images.load(str(path))
    assert command.main([*words, "--upright"]) == 0 and settings.image.name == "a upright"
    np.testing.assert_array_equal(load_job(tmp_path / "job").photo.radiance, UPRIGHT[6](own.pixels))


@pytest.mark.parametrize("name", KINDS)
def test_broken_headers_lose_what_they_say_and_no_more(tmp_path, name):
    whole, rng = lying(tmp_path / name, 6).read_bytes(), np.random.default_rng(0)
    codes = rng.integers(0, 255, (4, 6, 4)).astype(np.uint8)
    for number in range(300):
        file = bytearray(whole if number % 2 else whole[: rng.integers(1, len(whole))])
        for place in rng.integers(0, len(file), 8 if number % 3 else 0):
            file[place] = rng.integers(256)
        try:
            data = upright_png.png_of(codes, bytes(file))
        except InputError:
            continue
        found = cv2.imdecode(np.frombuffer(data, np.uint8), -1)
        assert found.shape[:2] == (4, 6) and photo_file.facts_of(data).orientation == 1
        at = data.index(b"IHDR") - 4
        while at < len(data):
            (length,) = struct.unpack_from(">I", data, at)
            part = data[at + 4 : at + 8 + length]
            assert zlib.crc32(part) == int.from_bytes(data[at + 8 + length : at + 12 + length])
            at += 12 + length
