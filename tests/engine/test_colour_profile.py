# SPDX-License-Identifier: GPL-3.0-or-later
"""What files say of their colours: profiles of phones, cameras and editors, the chunks of PNG, OpenEXR and EXIF."""

import struct
import zlib
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from btfsep_engine.errors import InputError
from btfsep_engine.fit.tone_curve import SRGB
from btfsep_engine.imaging import camera_curve, colour_profile, image_headers, images
from btfsep_engine.imaging.srgb import srgb_to_linear
from btfsep_engine.job.load import load_job
from btfsep_engine.pipeline.tone import Curves, codes_of, curve_read_by, radiance_of, read_by
from tests.engine.profiles import LINEAR_CURVE, SRGB_CURVE, chunk, icc, png, power, table, tiff, with_profile
from tests.engine.test_camera_curve import exif

TO_REC709 = {  # CSS Color 4, "Sample code for color conversions": published matrices, through XYZ
    "p3": [[1.2249401, -0.2249402, 0.0], [-0.0420569, 1.0420571, 0.0], [-0.0196376, -0.0786361, 1.0982735]],
    "adobe": [[1.3982832, -0.3982831, 0.0], [0.0, 1.0, 0.0], [0.0, -0.0429383, 1.0429383]],
    "prophoto": [[2.0342, -0.7274, -0.3068], [-0.2288, 1.2317, -0.0029], [-0.0086, -0.1533, 1.1619]],
    "rec2020": [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]],
    "acescg": [[1.7051, -0.6218, -0.0833], [-0.1303, 1.1408, -0.0105], [-0.0240, -0.1290, 1.1530]],
}
ROMM = 461 / 256  # what profiles have for 1.8
CURVES = {"p3": srgb_to_linear, "adobe": lambda v: v ** (563 / 256), "prophoto": lambda v: v**ROMM}
PROFILES = {
    "p3": icc("p3", SRGB_CURVE),
    "adobe": icc("adobe", power(563 / 256)),
    "prophoto": icc("prophoto", power(ROMM)),
}


@pytest.fixture
def picture(rng):
    return rng.integers(20, 236, (6, 8, 3)).astype(np.uint8)


def read(tmp_path, data: bytes, suffix: str = ".png", **how):
    (tmp_path / f"a{suffix}").write_bytes(data)
    return images.read_linear(tmp_path / f"a{suffix}", **how)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".webp"])
@pytest.mark.parametrize("name", PROFILES)
def test_a_profile_is_followed_in_every_kind_of_file(tmp_path, picture, name, suffix):
    image = read(tmp_path, with_profile(suffix, picture, PROFILES[name]), suffix)
    codes = picture / 255
    if suffix == ".jpg":
        codes = cv2.imread(str(tmp_path / "a.jpg"))[..., ::-1] / 255
    expected = CURVES[name](codes) @ np.transpose(TO_REC709[name])
    np.testing.assert_allclose(image.pixels, expected, atol=2e-3 if name == "prophoto" else 5e-4)
    assert np.abs(image.pixels - srgb_to_linear(codes)).max() > 0.05
    assert image.profile.name == {"p3": "Display P3", "adobe": "Adobe RGB", "prophoto": "ProPhoto RGB"}[name]
    grey = picture[..., :1].repeat(3, -1)
    pixels = read(tmp_path, with_profile(".png", grey, PROFILES[name])).pixels
    np.testing.assert_allclose(pixels, CURVES[name](grey / 255), atol=1e-6)  # grey stays grey


def test_16_bits_a_table_and_what_the_user_states(tmp_path, rng):
    deep = rng.integers(500, 65000, (6, 8, 3)).astype(np.uint16)
    data = tiff(deep, {34675: (7, len(PROFILES["p3"]), PROFILES["p3"])})
    image = read(tmp_path, data, ".tif")
    expected = srgb_to_linear(deep / 65535) @ np.transpose(TO_REC709["p3"])
    np.testing.assert_allclose(image.pixels, expected, atol=5e-4)
    tabled = icc("p3", table(lambda v: float(srgb_to_linear(v))))
    again = read(tmp_path, tiff(deep, {34675: (7, len(tabled), tabled)}), ".tif")
    np.testing.assert_allclose(again.pixels, image.pixels, atol=1e-6)
    stated = images.read_linear(tmp_path / "a.tif", primaries="rec709")
    np.testing.assert_allclose(stated.pixels, srgb_to_linear(deep / 65535), rtol=1e-6)
    assert stated.profile.to_rec709 is None
    linear = images.read_linear(tmp_path / "a.tif", colorspace="linear", primaries="display-p3")
    np.testing.assert_allclose(linear.pixels, deep / 65535 @ np.transpose(TO_REC709["p3"]), atol=5e-4)


def test_srgb_by_any_name_is_srgb_to_the_bit(tmp_path, picture):
    plain = read(tmp_path, png(picture)).pixels
    primaries = struct.pack(">8I", 31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000)
    for chunks in (
        [chunk(b"iCCP", b"sRGB\0\0" + zlib.compress(icc("srgb", SRGB_CURVE)))],
        [chunk(b"sRGB", b"\0"), chunk(b"gAMA", struct.pack(">I", 100000))],
        [chunk(b"gAMA", struct.pack(">I", 45455)), chunk(b"cHRM", primaries)],
        [chunk(b"cICP", bytes((1, 13, 0, 1))), chunk(b"iCCP", b"any\0\0" + zlib.compress(PROFILES["p3"]))],
    ):
        image = read(tmp_path, png(picture, *chunks))
        assert image.profile is None
        np.testing.assert_array_equal(image.pixels, plain)


def test_the_chunks_of_png(tmp_path, picture):
    codes = picture / 255
    p3 = read(tmp_path, png(picture, chunk(b"cICP", bytes((12, 13, 0, 1))))).pixels
    np.testing.assert_allclose(p3, srgb_to_linear(codes) @ np.transpose(TO_REC709["p3"]), atol=5e-4)
    wide = read(tmp_path, png(picture, chunk(b"cICP", bytes((9, 8, 0, 1))))).pixels
    np.testing.assert_allclose(wide, codes @ np.transpose(TO_REC709["rec2020"]), atol=5e-4)
    linear = read(tmp_path, png(picture, chunk(b"gAMA", struct.pack(">I", 100000))), by_camera=True)
    np.testing.assert_allclose(linear.pixels, codes, atol=1e-6)
    wide = struct.pack(">8I", 31270, 32900, 64000, 33000, 21000, 71000, 15000, 6000)
    adobe = read(tmp_path, png(picture, chunk(b"cHRM", wide)))
    assert adobe.profile.name == "Adobe RGB"
    np.testing.assert_allclose(adobe.pixels, srgb_to_linear(codes) @ np.transpose(TO_REC709["adobe"]), atol=5e-4)
    for code, name in ((16, "PQ"), (18, "HLG")):
        with pytest.raises(InputError, match=rf"an HDR display \({name}\).*linear EXR"):
            read(tmp_path, png(picture, chunk(b"cICP", bytes((9, code, 0, 1)))))


def test_chromaticities_of_exr(tmp_path, rng, write_rgb_exr):
    a = rng.random((4, 5, 3)).astype(np.float32)
    ap1 = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
    write_rgb_exr(tmp_path / "a.exr", a, chromaticities=ap1)
    image = images.read_linear(tmp_path / "a.exr")
    np.testing.assert_allclose(image.pixels, a @ np.transpose(TO_REC709["acescg"]), atol=1e-3)
    assert image.profile.name == "ACEScg" and not image.profile.curves
    np.testing.assert_array_equal(images.read_linear(tmp_path / "a.exr", primaries="rec709").pixels, a)
    rec709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
    for numbers, followed in ((rec709, True), ((0.0,) * 8, False), ((float("nan"),) * 8, False), ((0.3,) * 8, False)):
        write_rgb_exr(tmp_path / "b.exr", a, chromaticities=numbers)
        other = images.read_linear(tmp_path / "b.exr")
        np.testing.assert_array_equal(other.pixels, a)
        assert (other.profile is None) == followed
    stated = images.read_linear(tmp_path / "b.exr", primaries="acescg").pixels
    np.testing.assert_allclose(stated, image.pixels, atol=1e-6)


def test_grey_files_and_grey_profiles(tmp_path, picture):
    grey, profile = picture[..., :1], icc("", power(ROMM), b"GRAY")
    image = read(tmp_path, with_profile(".png", grey, profile))
    np.testing.assert_allclose(image.pixels, np.repeat((grey / 255) ** ROMM, 3, -1), atol=1e-6)
    image = read(tmp_path, with_profile(".png", grey, PROFILES["p3"]))  # what is grey has no primaries
    np.testing.assert_allclose(image.pixels, np.repeat(srgb_to_linear(grey / 255), 3, -1), atol=1e-6)


def test_adobe_rgb_of_a_camera_without_a_profile(tmp_path, picture):
    data = exif_of_adobe()
    assert image_headers.coding(data).is_adobe
    jpeg = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    block = b"Exif\0\0" + data
    image = read(tmp_path, jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(block) + 2) + block + jpeg[2:], ".jpg")
    assert image.profile.name == "Adobe RGB" and len(image.profile.curves) == 1
    assert not image_headers.coding(exif("Canon", "Canon EOS 6D")).is_adobe


def exif_of_adobe() -> bytes:
    """EXIF whose table of interoperability says R03."""
    entries = (0x8769, 4, 1, 26), (0xA005, 4, 1, 44), (1, 2, 4, int.from_bytes(b"R03\0", "little"))
    return b"II*\0\x08\0\0\0" + b"".join(struct.pack("<HHHIII", 1, *entry, 0) for entry in entries)


def test_the_curve_of_cameras_is_undone_in_the_files_own_primaries(job, picture, rng):
    picture = rng.integers(20, 236, (8, 12, 3)).astype(np.uint8)
    plain = with_profile(".tif", picture, PROFILES["adobe"])
    (job.folder / "photo.tif").write_bytes(plain)
    job.write(job.copy() | {"image": "photo.tif", "image_colorspace": "camera"})
    found = load_job(job.folder)
    scene = camera_curve.to_scene((picture / 255) ** (563 / 256))
    np.testing.assert_allclose(found.photo.radiance, scene @ np.transpose(TO_REC709["adobe"]), atol=5e-4)
    codes = codes_of(found)
    np.testing.assert_allclose(radiance_of(found, curve_read_by(found), codes), found.photo.radiance, atol=1e-5)
    np.testing.assert_allclose(srgb_to_linear(codes), (picture / 255) ** (563 / 256), atol=1e-5)  # as sRGB codes them
    curves = Curves(codes, (SRGB,), np.ones(1))
    again = read_by(SimpleNamespace(job=found), curves).job.photo  # the same codes by another curve
    expected = (picture / 255) ** (563 / 256) @ np.transpose(TO_REC709["adobe"])
    np.testing.assert_allclose(again.radiance, expected, atol=5e-4)
    stated = load_job(job.write(job.copy() | {"image": "photo.tif", "image_primaries": "rec709"})).photo
    np.testing.assert_allclose(stated.radiance, srgb_to_linear(picture / 255), atol=1e-6)


def test_a_linear_profile_outranks_the_camera_that_the_file_names(job, rng):
    picture = rng.integers(500, 65000, (8, 12, 3)).astype(np.uint16)
    profile = icc("srgb", LINEAR_CURVE)
    names = {271: (2, 6, b"Canon\0"), 272: (2, 13, b"Canon EOS 6D\0"), 34675: (7, len(profile), profile)}
    (job.folder / "photo.tif").write_bytes(tiff(picture, names))
    found = load_job(job.write(job.copy() | {"image": "photo.tif"}))
    assert found.photo.camera == "Canon EOS 6D"
    np.testing.assert_allclose(found.photo.radiance, picture / 65535, atol=2e-5)
    np.testing.assert_allclose(codes_of(found), picture / 65535, atol=2e-5)


def test_a_profile_of_tables_is_said_not_to_be_followed(job, picture):
    (job.folder / "photo.png").write_bytes(with_profile(".png", np.tile(picture, (2, 2, 1))[:8, :12], lut()))
    found = load_job(job.write(job.copy() | {"image": "photo.png"}))
    assert [w for w in found.warnings if "could not be followed" in w] == list(found.warnings) != []
    assert found.photo.profile.to_rec709 is None


def lut() -> bytes:
    """A profile whose colorants are called otherwise, as in one that has tables alone."""
    return PROFILES["p3"].replace(b"XYZ\0\0", b"QYZ\0\0").replace(b"rXYZ", b"A2B0")


def test_profiles_that_lie_are_not_followed_and_never_crash(picture, rng):
    whole = PROFILES["p3"]
    for end in range(0, len(whole), 3):
        colour_profile.of_file(with_profile(".png", picture, whole[:end]))
    for _ in range(400):
        broken = bytearray(whole)
        for at in rng.integers(0, len(whole), 4):
            broken[at] = rng.integers(256)
        found = colour_profile.of_file(with_profile(".png", picture, bytes(broken)))
        if found is not None and found.followed and not found.hdr:
            values = found.decode(picture / 255) if found.curves else picture
            matrix = np.eye(3) if found.to_rec709 is None else found.to_rec709
            assert np.isfinite(values).all() and np.isfinite(matrix).all() and np.abs(matrix).max() < 100
    for curve in (
        table(lambda v: 1 - v),  # falls
        power(1000 / 256 * 20),
        b"curv\0\0\0\0\xff\xff\xff\xff",
        b"para\0\0\0\0\0\3\0\0" + bytes(20),
        b"para\0\0\0\0\0\1\0\0" + b"\x7f\xff\xff\xff" * 3,
    ):
        assert not colour_profile.of_file(with_profile(".png", picture, icc("p3", curve))).followed


def test_a_bomb_of_a_profile_is_not_unpacked(picture):
    bomb = zlib.compress(bytes(1 << 28), 9)
    data = png(picture, chunk(b"iCCP", b"any\0\0" + bomb))
    assert len(image_headers.coding(data).icc) <= 1 << 22
    assert not colour_profile.of_file(data).followed
