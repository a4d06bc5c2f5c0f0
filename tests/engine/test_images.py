# SPDX-License-Identifier: GPL-3.0-or-later
"""Every kind of image, written by OpenCV or OpenEXR, read by ours; and every way in which a file can be wrong."""

import itertools
import os
import struct
import subprocess
import sys
import zlib

import cv2
import numpy as np
import OpenEXR
import pytest

from btfsep_engine.errors import InputError
from btfsep_engine.imaging import image_headers, images
from btfsep_engine.imaging.srgb import linear_to_srgb, srgb_to_linear
from btfsep_engine.job import photograph
from btfsep_engine.job.camera import Camera


def srgb_curve(code):
    """IEC 61966-2-1, one value at a time, written out on its own."""
    return code / 12.92 if code <= 0.04045 else ((code + 0.055) / 1.055) ** 2.4


def codes(rng, dtype, channels=3):
    top = np.iinfo(dtype).max
    a = rng.integers(0, int(top * 0.99), (7, 9, channels)).astype(dtype)
    a[0, 0] = 0
    return a


def write_cv(path, rgb):
    bgr = np.concatenate([rgb[..., 2::-1], rgb[..., 3:]], -1) if rgb.shape[-1] >= 3 else rgb
    assert cv2.imwrite(str(path), bgr)


@pytest.mark.parametrize(
    ("suffix", "dtype"), [("png", np.uint8), ("png", np.uint16), ("tif", np.uint8), ("tif", np.uint16)]
)
def test_integer_formats_are_decoded_from_srgb_exactly(tmp_path, rng, suffix, dtype):
    a = codes(rng, dtype)
    write_cv(tmp_path / f"a.{suffix}", a)
    image = images.read_linear(tmp_path / f"a.{suffix}")
    top = np.iinfo(dtype).max
    expected = np.vectorize(srgb_curve)(a / top)
    np.testing.assert_allclose(image.pixels, expected, rtol=1e-6, atol=1e-9)
    assert image.pixels.dtype == np.float32 and image.usable.all() and not image.saturated.any()
    linear = images.read_linear(tmp_path / f"a.{suffix}", colorspace="linear")
    np.testing.assert_allclose(linear.pixels, a / top, rtol=1e-6)


@pytest.mark.parametrize("suffix", ["jpg", "webp"])
def test_lossy_formats_agree_within_their_loss(tmp_path, suffix):
    y, x = np.mgrid[0:32, 0:48]
    a = np.stack([40 + 3 * x, 60 + 4 * y, 200 - 2 * x], -1).astype(np.uint8)
    write_cv(tmp_path / f"a.{suffix}", a)
    got = linear_to_srgb(images.read_linear(tmp_path / f"a.{suffix}").pixels) * 255
    assert np.abs(got - a).mean() < 4
    assert np.abs(got - a).mean() < np.abs(got - a[..., ::-1]).mean() / 5  # the channels are not swapped


def test_float_formats_are_linear_and_never_saturated(tmp_path, rng, write_rgb_exr):
    a = rng.gamma(0.5, 4, (7, 9, 3)).astype(np.float32)
    a[3, 4] = 5e4
    # OpenCV would store LogLuv, which rounds
    assert cv2.imwrite(str(tmp_path / "a.tif"), a[..., ::-1], [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    write_cv(tmp_path / "a.hdr", a)
    write_rgb_exr(tmp_path / "a.exr", a)
    write_rgb_exr(tmp_path / "h.exr", a.astype(np.float16))
    for name, tolerance in (("a.tif", 0), ("a.exr", 0), ("h.exr", 2**-10), ("a.hdr", 2**-6)):
        image = images.read_linear(tmp_path / name)
        assert (np.abs(image.pixels - a) <= tolerance * a.max(-1, keepdims=True)).all()  # RGBE shares an exponent
        assert not image.saturated.any() and image.usable.all()
    coded = images.read_linear(tmp_path / "a.exr", colorspace="srgb").pixels
    np.testing.assert_allclose(coded, np.vectorize(srgb_curve)(a), rtol=1e-5)


@pytest.mark.parametrize(("dtype", "just_below"), [(np.uint8, 254), (np.uint16, 65469)])
def test_saturated_is_any_channel_at_the_largest_code(tmp_path, dtype, just_below):
    top = np.iinfo(dtype).max
    a = np.full((3, 4, 3), 100, dtype)
    a[0, 1, 2] = top
    a[2, 3] = just_below
    write_cv(tmp_path / "a.png", a)
    image = images.read_linear(tmp_path / "a.png")
    assert np.argwhere(image.saturated).tolist() == [[0, 1]]
    assert np.argwhere(~image.usable).tolist() == [[0, 1]]


def test_pixels_that_are_not_opaque_are_not_usable(tmp_path, write_rgb_exr):
    a = np.full((3, 4, 4), 200, np.uint8)
    a[..., 3] = 255
    a[1, 2, 3], a[2, 0, 3] = 0, 128
    write_cv(tmp_path / "a.png", a)
    f = a.astype(np.float32) / 255
    write_rgb_exr(tmp_path / "a.exr", f, "RGBA")
    for name in ("a.png", "a.exr"):
        image = images.read_linear(tmp_path / name)
        assert np.argwhere(~image.usable).tolist() == [[1, 2], [2, 0]]
        assert image.pixels.shape == (3, 4, 3)


def test_grey_becomes_three_channels(tmp_path, rng, write_rgb_exr):
    grey = codes(rng, np.uint8, 1)
    write_cv(tmp_path / "a.png", grey)
    write_rgb_exr(tmp_path / "a.exr", grey.astype(np.float32), "Y")
    for name in ("a.png", "a.exr"):
        p = images.read_linear(tmp_path / name, colorspace="linear").pixels
        assert p.shape == (7, 9, 3)
        assert (p == p[..., :1]).all()
    np.testing.assert_allclose(p, np.repeat(grey, 3, -1))


def test_exr_first_part_with_colours(tmp_path, rng):
    z, a, b = rng.random((4, 5)), rng.random((4, 5, 3)), rng.random((4, 5, 3))
    parts = [
        OpenEXR.Part({}, {"Z": z.astype("f")}, "depth"),
        OpenEXR.Part({}, {c: np.ascontiguousarray(a[..., i].astype("f")) for i, c in enumerate("RGB")}, "beauty"),
        OpenEXR.Part({}, {c: np.ascontiguousarray(b[..., i].astype("f")) for i, c in enumerate("RGB")}, "other"),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    np.testing.assert_allclose(images.read_linear(tmp_path / "a.exr").pixels, a, rtol=1e-6)
    np.testing.assert_allclose(images.read_depth(tmp_path / "a.exr"), z, rtol=1e-6)


def test_exr_layers_prefer_the_combined_one(tmp_path, rng):
    a = rng.random((4, 5, 7)).astype(np.float32)
    names = [
        "View.A.R",
        "View.A.G",
        "View.A.B",
        "View.Combined.R",
        "View.Combined.G",
        "View.Combined.B",
        "View.Depth.Z",
    ]
    planes = {n: np.ascontiguousarray(a[..., i]) for i, n in enumerate(names)}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, planes).write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(images.read_linear(tmp_path / "a.exr").pixels, a[..., 3:6])
    np.testing.assert_array_equal(images.read_depth(tmp_path / "a.exr"), a[..., 6])


@pytest.mark.parametrize(
    ("parts", "read", "said"),
    [
        ([("", ["albedo", "shaded"])], 0, ["albedo", "shaded"]),
        ([("", ["albedo", "Beauty"])], 1, []),
        ([("", ["beauty_pass", "View.Combined"])], 1, []),
        ([("", ["", "spec"])], 0, []),
        ([("", ["spec"])], 0, []),
        ([("albedo", [""]), ("shaded", [""])], 0, ["albedo", "shaded"]),
        ([("rgba_main", [""]), ("albedo", [""])], 0, []),
    ],
)
def test_exr_layers_that_no_name_tells_apart_are_told(tmp_path, parts, read, said):
    path, n = tmp_path / "a.exr", itertools.count()
    made = []
    for name, layers in parts:
        planes = {}
        for layer in layers:
            value = np.full((4, 5), next(n), np.float32)
            planes |= {f"{layer}.{c}".lstrip("."): value for c in "RGB"}
        made.append(OpenEXR.Part({"type": OpenEXR.scanlineimage} | ({"name": name} if name else {}), planes))
    OpenEXR.File(made).write(str(path))
    assert (images.read_linear(path).pixels == read).all()
    assert images.layers(path) == said
    notes = []
    photograph.read_photo(path, Camera(5, 4, 5.0, 5.0, 2.5, 2.0, np.eye(4)), notes=notes)
    assert [f"'{name}'" in note for note in notes for name in said] == [True] * len(said)


def test_exr_data_window_is_placed_in_the_display_window(tmp_path, rng):
    a = rng.random((3, 4, 3)).astype(np.float32)
    planes = {c: np.ascontiguousarray(a[..., i]) for i, c in enumerate("RGB")}
    header = {
        "type": OpenEXR.scanlineimage,
        "dataWindow": (np.array([2, 1], np.int32), np.array([5, 3], np.int32)),
        "displayWindow": (np.array([0, 0], np.int32), np.array([4, 5], np.int32)),
    }
    OpenEXR.File(header, planes).write(str(tmp_path / "a.exr"))
    image = images.read_linear(tmp_path / "a.exr")
    assert image.pixels.shape == (6, 5, 3)
    np.testing.assert_array_equal(image.pixels[1:4, 2:5], a[:, :3])
    inside = np.zeros((6, 5), bool)
    inside[1:4, 2:5] = True
    np.testing.assert_array_equal(image.usable, inside)


def test_not_finite_pixels_are_handed_on(tmp_path, write_rgb_exr):
    a = np.ones((3, 4, 3), np.float32)
    a[1, 2, 0], a[2, 2, 1] = np.nan, np.inf
    write_rgb_exr(tmp_path / "a.exr", a)
    np.testing.assert_array_equal(images.read_linear(tmp_path / "a.exr").pixels, a)


def test_masks(tmp_path, write_rgb_exr):
    m = np.zeros((5, 6, 1), np.uint8)
    m[1, 2], m[4, 5] = 1, 255
    write_cv(tmp_path / "grey.png", m)
    write_cv(tmp_path / "rgb.png", np.concatenate([m, 0 * m, 0 * m], -1))
    rgba = np.concatenate([m, m, m, 0 * m + 255], -1)
    rgba[1, 2, 3] = 0
    write_cv(tmp_path / "rgba.png", rgba)
    write_rgb_exr(tmp_path / "m.exr", m.astype(np.float32), "Y")
    for name, wanted in (
        ("grey.png", [[1, 2], [4, 5]]),
        ("rgb.png", [[1, 2], [4, 5]]),
        ("rgba.png", [[4, 5]]),
        ("m.exr", [[1, 2], [4, 5]]),
    ):
        assert np.argwhere(images.read_mask(tmp_path / name)).tolist() == wanted


def test_what_we_write_others_read(tmp_path, rng):
    a = rng.random((6, 5, 3)).astype(np.float32)
    images.write_exr(tmp_path / "a.exr", a)
    read = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).channels()
    np.testing.assert_array_equal(np.stack([read[c].pixels for c in "RGB"], -1), a)
    images.write_png(tmp_path / "a.png", a)
    got = cv2.imread(str(tmp_path / "a.png"))[..., ::-1] / 255.0
    np.testing.assert_allclose(np.vectorize(srgb_curve)(got), a, atol=0.005)
    images.write_png(tmp_path / "m.png", a[..., 0] > 0.5)
    assert set(np.unique(cv2.imread(str(tmp_path / "m.png")))) == {0, 255}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.exr", "a.png", "m.png"]


def test_curves_are_inverse_of_each_other():
    v = np.linspace(0, 4, 4001)
    np.testing.assert_allclose(srgb_to_linear(linear_to_srgb(v)), v, atol=1e-7)


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "webp", "hdr", "exr"])
@pytest.mark.parametrize("kept", [0.6, 0.98])
def test_truncated_files(tmp_path, rng, suffix, kept, write_rgb_exr):
    path = tmp_path / f"a.{suffix}"
    a = codes(rng, np.uint8).repeat(20, 0).repeat(20, 1)
    if suffix == "exr":
        write_rgb_exr(path, rng.random((64, 64, 3)).astype(np.float32))
    else:
        write_cv(path, a if suffix != "hdr" else rng.random((64, 64, 3)).astype(np.float32))
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * kept)])
    with pytest.raises(InputError, match="truncated or damaged"):
        images.read_linear(path)


@pytest.mark.parametrize("read", [images.read_linear, images.read_mask, images.read_depth])
def test_what_is_no_image(tmp_path, read, capfd):
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "text.png").write_text("hello" * 100)
    (tmp_path / "head.exr").write_bytes(b"\x76\x2f\x31\x01\x02\0\0\0channels\0")
    (tmp_path / "folder.png").mkdir()
    for name, words in (
        ("none.png", "no such file"),
        ("empty.png", "empty"),
        ("text.png", "not an"),
        ("head.exr", "truncated or damaged"),
        ("folder.png", "it is a folder"),
    ):
        with pytest.raises(InputError, match=words) as caught:
            read(tmp_path / name)
        assert caught.value.what == name and caught.value.do
    assert capfd.readouterr().out == ""  # stdout belongs to the JSON lines


def png_that_claims(width, height):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"\0" * 100)) + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize(
    ("width", "height"), [(20001, 1), (1, 20001), (19000, 19000), (16385, 8193), (2**31 - 1, 2**31 - 1)]
)
def test_absurd_sizes_are_refused_before_anything_is_decoded(tmp_path, width, height):
    (tmp_path / "a.png").write_bytes(png_that_claims(width, height))
    with pytest.raises(InputError, match=f"{width} x {height} pixels"):
        images.read_linear(tmp_path / "a.png")


@pytest.mark.parametrize("first", ["btfsep_engine.imaging.images", "btfsep_engine.fit.settling"])
def test_what_does_not_say_its_size_is_bounded_by_opencv(first):
    """A bitmap of 15 bytes that claims 400 million pixels; whichever of our modules loads OpenCV."""
    code = f"""
import {first}, cv2, numpy
try:
    cv2.imdecode(numpy.frombuffer(b"P4 20000 20000\\n", numpy.uint8), -1)
except cv2.error as error:
    print(error)
"""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("OPENCV_")}
    run = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert "MAX_IMAGE_PIXELS" in run.stdout, run.stderr
    assert run.stderr == ""


def test_no_pixels(tmp_path):
    (tmp_path / "a.png").write_bytes(png_that_claims(0, 5))
    with pytest.raises(InputError, match="no pixels"):
        images.read_linear(tmp_path / "a.png")


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "webp", "hdr"])
def test_sizes_are_known_from_the_header_of_every_kind(tmp_path, suffix):
    a = np.zeros((21, 34, 3), np.float32 if suffix == "hdr" else np.uint8)
    write_cv(tmp_path / f"a.{suffix}", a)
    assert tuple(image_headers.size((tmp_path / f"a.{suffix}").read_bytes())) == (34, 21)


def test_random_damage_is_an_error_or_an_image_never_another_exception(tmp_path, rng, write_rgb_exr):
    for suffix in ("png", "jpg", "tif", "webp", "hdr", "exr"):
        path = tmp_path / f"a.{suffix}"
        if suffix in ("exr", "hdr"):
            f = rng.random((16, 16, 3)).astype(np.float32)
            write_rgb_exr(path, f) if suffix == "exr" else write_cv(path, f)
        else:
            write_cv(path, codes(rng, np.uint8))
        data = bytearray(path.read_bytes())
        for _ in range(40):
            broken = bytearray(data)
            for at in rng.integers(0, min(len(data), 400), 3):
                broken[at] = rng.integers(0, 256)
            path.write_bytes(broken)
            try:
                assert images.read_linear(path).pixels.ndim == 3
            except InputError as error:
                assert error.what == path.name


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may read everything")
def test_unreadable(tmp_path):
    write_cv(tmp_path / "a.png", np.zeros((2, 2, 3), np.uint8))
    (tmp_path / "a.png").chmod(0)
    with pytest.raises(InputError, match="cannot be read"):
        images.read_linear(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("name", "how", "coarse"),
    [
        ("a.jpg", [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420], True),
        ("a.jpg", [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422], True),
        ("a.jpg", [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444], False),
        ("a.jpg", [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], True),
        ("a.webp", [cv2.IMWRITE_WEBP_QUALITY, 90], True),
        ("a.webp", [cv2.IMWRITE_WEBP_QUALITY, 101], False),  # without loss
        ("a.png", [], False),
        ("a.tif", [], False),
    ],
)
def test_a_file_says_whether_its_colours_are_coarse(tmp_path, name, how, coarse):
    pixels = np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)
    assert cv2.imwrite(str(tmp_path / name), pixels, how)
    found = images.read_linear(tmp_path / name)
    assert found.coarse_chroma is coarse and found.is_jpeg is (name == "a.jpg")


def test_a_grey_jpeg_has_no_chroma(tmp_path):
    cv2.imwrite(str(tmp_path / "a.jpg"), np.full((16, 16), 90, np.uint8))
    assert images.read_linear(tmp_path / "a.jpg").coarse_chroma is False


@pytest.mark.parametrize(
    ("told", "fy", "warned"),
    [(2.0, 5.0, True), (2.0, 10.0, False), (1.0, 10.0, False), (2.01, 10.0, False)],
)
def test_pixels_that_are_not_the_cameras_are_told(tmp_path, told, fy, warned):
    header, notes = {"type": OpenEXR.scanlineimage, "pixelAspectRatio": told}, []
    OpenEXR.File(header, {"RGB": np.ones((4, 5, 3), np.float32)}).write(str(tmp_path / "a.exr"))
    photograph.read_photo(tmp_path / "a.exr", Camera(5, 4, 5.0, fy, 2.5, 2.0, np.eye(4)), notes=notes)
    assert [f"2 times as wide as high, and those of the camera are {fy / 5:.3g} times" in n for n in notes] == [
        True
    ] * warned
