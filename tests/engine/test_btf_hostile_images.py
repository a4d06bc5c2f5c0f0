# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged images of UBO2003, ATRIUM and UTIA sets, alone and in zips, with the address space limited."""

import io
import resource
import struct
import zipfile
from contextlib import contextmanager
from datetime import timedelta

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from btfsep_engine.btf.formats import image_set
from btfsep_engine.btf.formats.archive import Members
from btfsep_engine.btf.formats.image_set import MAX_PIXELS, find_images
from btfsep_engine.errors import InputError
from btfsep_engine.imaging.images import write_exr

HANG = timedelta(seconds=20)
DECLARED = 12 * MAX_PIXELS  # bytes: three float32 of each pixel of the largest image that is taken
SLACK = 64 << 20  # the decoders' own
NAME = "m tl000 pl000 tv015 pv060"


def valid_images():
    """Suffix and content of a small image of each kind."""
    rng = np.random.default_rng(4)
    code = rng.integers(0, 255, (6, 8, 3), np.uint8)
    for suffix, image in ((".jpg", code), (".png", code), (".tif", code), (".png", code.astype(np.uint16) * 257)):
        yield suffix, cv2.imencode(suffix, image)[1].tobytes()
    pixels = rng.integers(1, 255, (6, 8, 4), np.uint8).tobytes()
    for line in (b"+X 8 -Y 6", b"-Y 6 +X 8"):
        yield ".hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" + line + b"\n" + pixels


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    path = tmp_path_factory.mktemp("exr") / "a.exr"
    write_exr(path, np.random.default_rng(5).random((6, 8, 3)).astype(np.float32))
    return [*valid_images(), (".exr", path.read_bytes())]


@contextmanager
def address_space(more: int):
    """At most ``more`` bytes beyond what the process has mapped now: what asks for more gets a MemoryError."""
    with open("/proc/self/statm") as statm:
        mapped = int(statm.read().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (mapped + more, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


WORDS = [0, 1, 7, 8, 255, 1024, 1025, 60000, 65535, 2**16, 2**24, 2**31 - 1, 2**31, 2**32 - 1]
PATCHES = [struct.pack(o + "I", w) for w in WORDS for o in "<>"] + [b"\xff\xff", b"\0\0", b"99999", b"-Y", b"\n"]


def claimed(content: bytes, height: int, width: int) -> bytes:
    """The same with another size in its header, in whatever way its format says it."""
    for layout, first, second in ((">HH", (6, 8), (height, width)), (">II", (8, 6), (width, height))):
        content = content.replace(struct.pack(layout, *first), struct.pack(layout, *second), 1)
    for pattern in (b"+X %d -Y %d\n", b"-Y %d +X %d\n"):
        content = content.replace(pattern % ((8, 6) if pattern[1:2] == b"X" else (6, 8)), pattern % (height, width), 1)
    return content


def damage(draw, content: bytes) -> bytes:
    content = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, 1 << 20)) * 7919 % max(len(content), 1)
        if draw(st.booleans()):
            at %= 64  # the headers
        kind = draw(st.sampled_from("byte patch patch cut erase repeat".split()))
        if kind == "byte":
            content[at : at + 1] = bytes([draw(st.integers(0, 255))])
        elif kind == "patch":
            patch = draw(st.sampled_from(PATCHES))
            content[at : at + len(patch)] = patch
        elif kind == "cut":
            del content[at:]
        elif kind == "erase":
            del content[at : at + draw(st.integers(1, 12))]
        else:
            content[at:at] = content[at : at + draw(st.integers(1, 100))]
    return bytes(content)


def in_zip(name: str, content: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)
    return out.getvalue()


def read(source, scratch):
    """All images of a source, as an import reads them; each finite and no larger than may be, or refused."""
    with Members(source) as members:
        for name in members.names:
            pixels = image_set._Reader(members, scratch / "fixed.hdr", None).read(name)
            assert np.isfinite(pixels).all() and pixels.shape[-1] == 3 and pixels.size <= 3 * MAX_PIXELS


def test_what_is_damaged_below_is_read_whole(valid, tmp_path):
    for number, (suffix, content) in enumerate(valid):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / (NAME + suffix)).write_bytes(content)
        read(folder, tmp_path)


def test_claims_are_looked_at_before_anything_is_decoded(valid, tmp_path):
    """Whoever decodes 9 million pixels first and looks then needs more than is allowed here."""
    for suffix, content in valid[:2] + valid[3:6]:
        (tmp_path / (NAME + suffix)).write_bytes(claimed(content, 3000, 3000))
        with pytest.raises(InputError, match=f"3000 x 3000 pixels; .* {MAX_PIXELS} in all"), address_space(8 << 20):
            read(tmp_path, tmp_path)
        (tmp_path / (NAME + suffix)).unlink()


@settings(max_examples=1500, deadline=HANG, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_any_damage_to_an_image_is_told_or_harmless(valid, tmp_path_factory, data):
    suffix, content = data.draw(st.sampled_from(valid))
    if data.draw(st.integers(0, 3)) == 0:
        content = claimed(content, *(data.draw(st.sampled_from([1, 1000, 1025, 3000, 8000, 60000])) for _ in range(2)))
    content = damage(data.draw, content)
    base = tmp_path_factory.getbasetemp()
    if data.draw(st.booleans()):
        source = base / "hostile-images.zip"
        source.unlink(missing_ok=True)
        content = in_zip(NAME + suffix, content)
        source.write_bytes(damage(data.draw, content) if data.draw(st.booleans()) else content)
    else:
        source = base / "hostile-images"
        source.mkdir(exist_ok=True)
        for old in source.iterdir():
            old.unlink()
        (source / (NAME + suffix)).write_bytes(content)
    with address_space(2 * DECLARED + SLACK):
        try:
            read(source, base)
        except InputError as error:
            assert error.what and error.got and error.do


NAMES = st.lists(
    st.text(st.sampled_from(list("tlpv0123456789 _-/.\\\0é")), max_size=30).map(lambda t: t + ".png") | st.just(NAME),
    max_size=6,
)


@settings(max_examples=300, deadline=HANG, suppress_health_check=list(HealthCheck))
@given(names=NAMES)
def test_whatever_the_names_in_a_zip_are(tmp_path_factory, names):
    path = tmp_path_factory.getbasetemp() / "hostile-names.zip"
    path.unlink(missing_ok=True)
    with zipfile.ZipFile(path, "w") as archive:
        for name in set(names):
            archive.writestr(zipfile.ZipInfo(name or "x"), b"x")
    with pytest.raises(InputError), Members(path) as members:
        find_images(members)
