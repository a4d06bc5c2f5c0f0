# SPDX-License-Identifier: GPL-3.0-or-later
"""The usual curve of cameras, against curves that were measured, and which files are read by it."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from btfsep_engine.fit.tone_curve import CAMERA, SRGB
from btfsep_engine.imaging import camera_curve, image_headers, images
from scripts.studies.cameras import MEASURED, response


@pytest.mark.parametrize("name", MEASURED)
def test_measured_cameras_are_met_twice_as_well_as_by_srgb_alone(name):
    r, y = np.geomspace(1e-3, 1, 2000), np.linspace(0.03, 0.9, 50)
    true = np.log(np.interp(y, response(name)(r), r))
    off = {s: (np.log(camera_curve.to_scene(y, s)) - true).std() for s in (0.0, camera_curve.USUAL)}
    assert off[1.0] < 0.11 and off[1.0] < off[0.0] / 1.8


@pytest.mark.parametrize("strength", [0.5, 1.0, 1.4])
def test_the_curve_its_inverse_and_its_slope_agree(strength):
    y = np.linspace(0, 1, 501)
    r = camera_curve.to_scene(y, strength)
    assert r[0] == 0 and r[-1] == 1 and (np.diff(r) > 0).all()
    np.testing.assert_allclose(camera_curve.to_display(r, strength), y, atol=1e-12)
    np.testing.assert_array_equal(camera_curve.to_scene(-y, strength), -r)
    inner, step = y[5:-5], 1e-6
    slope = np.subtract(*(camera_curve.to_scene(inner + d, strength) for d in (step, -step))) / (2 * step)
    np.testing.assert_allclose(camera_curve.log_slope(inner, strength), np.log(slope), atol=1e-5)


def test_without_strength_it_is_srgb():
    codes = np.linspace(0.02, 1, 99)
    none = CAMERA.__class__(0.0)
    np.testing.assert_allclose(none.decode(codes), SRGB.decode(codes), rtol=1e-12)
    np.testing.assert_allclose(none.log_slope(codes), SRGB.log_slope(codes), atol=1e-9)


def exif(maker: str, model: str, order: str = "<") -> bytes:
    """A block of EXIF with both names, as cameras write it."""
    texts, at, entries = b"", 8 + 2 + 2 * 12 + 4, b""
    for tag, text in ((271, maker), (272, model)):
        value = text.encode() + b"\0"
        inline = value.ljust(4, b"\0") if len(value) <= 4 else struct.pack(order + "I", at + len(texts))
        entries += struct.pack(order + "HHI", tag, 2, len(value)) + inline
        texts += value if len(value) > 4 else b""
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "IH", 8, 2)
    return head + entries + struct.pack(order + "I", 0) + texts


def with_exif(suffix: str, block: bytes, height: int = 6, width: int = 8) -> bytes:
    """A small picture of a kind with a block of EXIF."""
    picture = (np.arange(3 * height * width) % 256).astype(np.uint8).reshape(height, width, 3)
    data = cv2.imencode(suffix, picture)[1].tobytes()
    if suffix == ".jpg":
        return data[:2] + b"\xff\xe1" + struct.pack(">H", len(block) + 8) + b"Exif\0\0" + block + data[2:]
    if suffix == ".png":
        chunk = b"eXIf" + block
        return data[:33] + struct.pack(">I", len(block)) + chunk + struct.pack(">I", zlib.crc32(chunk)) + data[33:]
    return data + b"EXIF" + struct.pack("<I", len(block)) + block


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_the_camera_that_a_file_names(suffix, order, tmp_path):
    data = with_exif(suffix, exif("NIKON CORPORATION", "NIKON D750", order))
    assert image_headers.camera(data) == "NIKON CORPORATION NIKON D750"
    assert image_headers.camera(with_exif(suffix, exif("Canon", "Canon EOS 6D", order))) == "Canon EOS 6D"
    (tmp_path / f"a{suffix}").write_bytes(data)
    read = images.read_linear(tmp_path / f"a{suffix}", by_camera=True)
    assert read.camera == "NIKON CORPORATION NIKON D750"
    plain = images.read_linear(tmp_path / f"a{suffix}", colorspace="srgb").pixels
    np.testing.assert_allclose(read.pixels, camera_curve.to_scene(plain), rtol=1e-5, atol=1e-6)
    assert not np.allclose(read.pixels, plain, rtol=0.1)
    np.testing.assert_array_equal(images.read_linear(tmp_path / f"a{suffix}").pixels, plain)  # a texture is no photo
    stated = images.read_linear(tmp_path / f"a{suffix}", colorspace="camera").pixels
    np.testing.assert_array_equal(stated, read.pixels)


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".tif"])
def test_a_file_of_no_camera_is_sRGB(suffix, tmp_path):
    cv2.imwrite(str(tmp_path / f"a{suffix}"), np.full((6, 8, 3), 120, np.uint8))
    read = images.read_linear(tmp_path / f"a{suffix}", by_camera=True)
    assert read.camera == ""
    np.testing.assert_array_equal(read.pixels, images.read_linear(tmp_path / f"a{suffix}", colorspace="srgb").pixels)


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("code", "fired"), [(0x00, False), (0x01, True), (0x10, False), (0x1F, True), (0x20, False)])
def test_whether_a_flash_fired_is_what_the_file_says(suffix, order, code, fired, tmp_path):
    mark = {"<": b"II*\0", ">": b"MM\0*"}[order]
    at = struct.pack(order + "IHHHIII", 8, 1, 0x8769, 4, 1, 26, 0)  # a directory that names another
    block = mark + at + struct.pack(order + "HHHIHHI", 1, 0x9209, 3, 1, code, 0, 0)
    assert image_headers.flash_fired(with_exif(suffix, block)) is fired
    (tmp_path / f"a{suffix}").write_bytes(with_exif(suffix, block))
    assert images.read_linear(tmp_path / f"a{suffix}").flash is fired
    assert image_headers.flash_fired(with_exif(suffix, exif("Canon", "Canon EOS 6D", order))) is None
    for end in range(2, len(block)):  # cut anywhere
        image_headers.flash_fired(with_exif(suffix, block[:end]))
    nowhere = mark + struct.pack(order + "IHHHIII", 8, 1, 0x8769, 4, 1, 1 << 30, 0)
    assert image_headers.flash_fired(with_exif(suffix, nowhere)) is None


def test_a_header_that_lies_names_no_camera():
    block = exif("Canon", "Canon EOS 6D")
    whole = with_exif(".jpg", block)
    for end in range(2, len(block)):  # cut anywhere
        image_headers.camera(with_exif(".jpg", block[:end]))
        image_headers.camera(whole[:end])
    endless = block[:8] + b"\xff\xff" + block[10:]
    assert image_headers.camera(with_exif(".jpg", endless)) in ("", "Canon EOS 6D")
    far = block[:18] + struct.pack("<I", 1 << 30) + block[22:]
    assert image_headers.camera(with_exif(".jpg", far)) == "Canon EOS 6D"  # the maker is nowhere, the model is there
    control = exif("Ca\x1b[31mnon", "b")
    assert "\x1b" not in image_headers.camera(with_exif(".jpg", control))
    assert image_headers.camera(b"") == "" and image_headers.size(b"") is None
