# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos as people have them: turned by a tag, raw, of phones, for printing: read as stored, or refused in words."""

import struct
import subprocess
import sys

import cv2
import numpy as np
import pytest

from btfsep_engine.errors import InputError
from btfsep_engine.imaging import image_headers, images
from btfsep_engine.job.load import load_job
from tests.engine.profiles import tiff
from tests.engine.test_camera_curve import with_exif


def turned(number: int) -> bytes:
    """EXIF that says how a picture is to be turned."""
    return b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 274, 3, 1, number, 0, 0)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("number", [2, 3, 6, 8])
def test_a_tiff_is_taken_as_it_is_stored(tmp_path, rng, dtype, number):
    """OpenCV turns a TIFF by its tag; Blender turns none, and a camera in pixels refers to those that are stored."""
    picture = rng.integers(0, 250, (6, 8, 3)).astype(dtype)
    path = tmp_path / "a.tif"
    path.write_bytes(tiff(picture, {274: (3, 1, struct.pack("<H", number))}))
    image = images.read_linear(path, colorspace="linear")
    np.testing.assert_allclose(image.pixels, picture / np.iinfo(dtype).max, atol=1e-6)
    assert image.orientation == number and images.declared_size(path) == (8, 6)


@pytest.mark.parametrize(("shares", "order"), [((1, 1), "<"), ((2, 1), "<"), ((2, 2), ">")])
def test_a_png_of_a_jpeg_says_that_its_colours_are_coarse(shares, order):
    """By EXIF's YCbCrSubSampling, which says it of the codes, whatever file they are in now."""
    head = {"<": b"II*\0", ">": b"MM\0*"}[order]
    block = head + struct.pack(order + "IHHHIHHI", 8, 1, 530, 3, 2, *shares, 0)
    assert image_headers.has_coarse_chroma(with_exif(".png", block)) is (shares != (1, 1))
    assert image_headers.has_coarse_chroma(with_exif(".png", turned(6))) is False
    for end in range(len(block)):
        assert image_headers.has_coarse_chroma(with_exif(".png", block[:end])) in (True, False)


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
def test_a_photo_that_is_to_be_turned_is_taken_as_stored_and_said(job, suffix):
    plain, data = with_exif(suffix, turned(1), 8, 12), with_exif(suffix, turned(6), 8, 12)
    assert image_headers.orientation(plain) == 1 and image_headers.orientation(data) == 6
    (job.folder / f"photo{suffix}").write_bytes(data)
    found = load_job(job.write(job.copy() | {"image": f"photo{suffix}"}))
    (job.folder / f"photo{suffix}").write_bytes(plain)
    upright = load_job(job.folder)
    np.testing.assert_array_equal(found.photo.radiance, upright.photo.radiance)
    assert any("EXIF orientation 6" in w for w in found.warnings)
    assert not any("orientation" in w for w in upright.warnings)


def test_a_camera_of_the_turned_photo_is_told_why_it_does_not_fit(job):
    (job.folder / "photo.jpg").write_bytes(with_exif(".jpg", turned(6), 12, 8))
    with pytest.raises(InputError, match="8 x 12 pixels and the camera 12 x 8, as it is to be turned"):
        load_job(job.write(job.copy() | {"image": "photo.jpg"}))


def test_a_camera_of_the_data_window_is_told_why_it_does_not_fit(job, write_rgb_exr):
    windows = {"displayWindow": ((0, 0), (15, 9)), "dataWindow": ((2, 1), (13, 8))}
    corners = {name: tuple(np.array(c, np.int32) for c in window) for name, window in windows.items()}
    write_rgb_exr(job.folder / "photo.exr", job.pixels, **corners)
    with pytest.raises(InputError, match="16 x 10 pixels and the camera 12 x 8, the size of its data window"):
        load_job(job.write())


def four_channels(photometric: int) -> bytes:
    return tiff(np.full((6, 8, 4), 90, np.uint8), photometric=photometric)


def jpeg_of_four() -> bytes:
    """The header of a JPEG of four components, in the place of a picture's."""
    data = cv2.imencode(".jpg", np.zeros((6, 8, 3), np.uint8))[1].tobytes()
    at = data.index(b"\xff\xc0")
    frame = struct.pack(">HBHHB", 20, 8, 6, 8, 4) + bytes((1, 17, 0, 2, 17, 0, 3, 17, 0, 4, 17, 0))
    return data[:at] + b"\xff\xc0" + frame + data[at + 19 :]


READS = """
import sys
from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
for path in sys.argv[1:]:
    try:
        images.read_linear(path)
    except InputError as error:
        print(error)
"""


def test_pixels_of_other_kinds_are_said_to_be(tmp_path):
    """Half floats, whole numbers of 32 bits, a channel beside alpha: what editors write and OpenCV does not read."""
    kinds = {
        "half": tiff(np.ones((6, 8, 3), np.float16), {339: (3, 3, struct.pack("<3H", 3, 3, 3))}),
        "long": tiff(np.ones((6, 8, 3), np.uint32)),
        "five": tiff(np.ones((6, 8, 5), np.uint8), {338: (3, 2, struct.pack("<2H", 1, 0))}),
    }
    for name, data in kinds.items():
        (tmp_path / f"{name}.tif").write_bytes(data)
    paths = [str(tmp_path / f"{name}.tif") for name in kinds]
    # in a process of its own: OpenCV would say more, unless it is told to be silent before it is loaded
    done = subprocess.run([sys.executable, "-P", "-c", READS, *paths], capture_output=True, text=True, check=True)
    said = done.stdout.splitlines()
    assert len(said) == 3 and not done.stderr
    for name, line in zip(kinds, said, strict=True):
        assert f"{name}.tif" in line and "pixels are of a kind that is not read; save it as RGB of 8 or 16 bits" in line


GREY = np.full((6, 8, 3), 90, np.uint8)
KINDS = {
    "raw.dng": (tiff(GREY, {50706: (1, 4, b"\1\4\0\0")}), "raw file.*develop it"),
    "raw.nef": (tiff(GREY, {254: (4, 1, struct.pack("<I", 1))}), "raw file.*develop it"),
    "raw.cr2": (b"II*\0\x10\0\0\0CR\2\0" + bytes(99), "raw file.*develop it"),
    "raw.cr3": (b"\0\0\0\x18ftypcrx \0\0\0\1" + bytes(99), "raw file.*develop it"),
    "raw.raf": (b"FUJIFILMCCD-RAW 0201" + bytes(99), "raw file.*develop it"),
    "a.heic": (b"\0\0\0\x24ftypheic" + bytes(99), "HEIC.*JPEG"),
    "a.avif": (b"\0\0\0\x24ftypavif" + bytes(99), "AVIF.*JPEG"),
    "a.mov": (b"\0\0\0\x14ftypqt  " + bytes(99), "movie.*frames"),
    "a.jxl": (b"\0\0\0\x0cJXL \r\n\x87\n" + bytes(99), "JPEG XL.*JPEG"),
    "b.jxl": (b"\xff\x0a" + bytes(99), "JPEG XL.*JPEG"),
    "a.dpx": (b"SDPX" + bytes(99), "DPX.*EXR"),
    "a.psd": (b"8BPS\0\1" + bytes(99), "Photoshop.*EXR"),
    "a.gif": (b"GIF89a" + bytes(99), "GIF.*PNG"),
    "cmyk.tif": (four_channels(5), "CMYK.*RGB"),
    "lab.tif": (tiff(GREY, photometric=8), "CMYK or Lab.*RGB"),
    "cmyk.jpg": (jpeg_of_four(), "CMYK.*RGB"),
}


@pytest.mark.parametrize("name", KINDS)
def test_kinds_that_are_not_read_say_what_they_are_and_what_to_do(job, name):
    data, words = KINDS[name]
    (job.folder / name).write_bytes(data)
    with pytest.raises(InputError, match=words) as caught:
        load_job(job.write(job.copy() | {"image": name}))
    assert "the camera" not in str(caught.value)  # a raw file's preview is not of a wrong size
    for end in range(0, min(len(data), 200), 7):
        image_headers.refused(data[:end])
