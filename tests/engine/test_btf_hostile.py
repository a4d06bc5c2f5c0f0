# SPDX-License-Identifier: GPL-3.0-or-later
"""Thousands of damaged files: an InputError in words or a valid material, never a crash, a hang, or memory run wild."""

import io
import struct
import tracemalloc
import zipfile
from datetime import timedelta

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from btfsep_engine.btf import linear
from btfsep_engine.btf.formats.archive import Members
from btfsep_engine.btf.formats.ubo2014 import open_btf
from btfsep_engine.errors import InputError
from tests.engine import btf_files

VIEWS = np.radians([[0.0, 0], [30, 45], [60, 170], [75, -120]])
LIGHTS = np.radians([[0.0, 0], [45, -90], [75, 100]])
SLACK = 1 << 20  # bytes: the interpreter's own, and blocks of a fixed size
HANG = timedelta(seconds=20)


def valid_files():
    """A small file of each kind."""
    rng = np.random.default_rng(3)
    common = {"views": VIEWS, "lights": LIGHTS, "width": 3, "height": 2}
    u, sxv = [rng.normal(0, 0.5, (12, k)) for k in (3, 2, 1)], [rng.normal(0, 0.5, (6, k)) for k in (3, 2, 1)]
    for model in (0, 1, 2, 3, 4, 9, 10, 11, 12):
        yield btf_files.dfmf(u, sxv, model=model, transposed=model in (4, 12), version=4 - model % 4, **common)
    one, shared = rng.normal(0, 0.5, (36, 2)), rng.normal(0, 0.5, (6, 2))
    yield btf_files.fmf(one, shared, reduced=1, height_map=np.ones((2, 3)), **common)
    yield btf_files.fmf(one, shared, reduced=0, dtype="<f4", xml=b"<x/>", **common)
    yield btf_files.fmf(one[:18], rng.normal(0, 0.5, (12, 2)), reduced=1, dtype="<f8", **common)
    yield btf_files.fmf(one, shared, signature=b"!FMF06FC", **common)


VALID = list(valid_files())
WORDS = [0, 1, 2, 3, 7, 255, 256, 1024, 1025, 65535, 2**16, 2**24, 2**31 - 1, 2**31, 2**32 - 2, 2**32 - 1]
FLOATS = [float("nan"), float("inf"), float("-inf"), 1e38, -1e38, 1e-45, 0.0, -1.0, 1.5707964, 3.5, 90.0, 700.0]
PATCHES = [struct.pack("<I", w) for w in WORDS] + [struct.pack("<f", f) for f in FLOATS]
PATCHES += [struct.pack("<e", h) for h in (float("nan"), float("inf"), 65504.0, -65504.0)] + [
    b"!DFMF08FCR",
    b"!PVF06FCR",
]


@st.composite
def damaged_file(draw):
    content = bytearray(draw(st.sampled_from(VALID)))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, 1 << 20)) * 7919 % max(len(content), 1)  # anywhere: small numbers are drawn too often
        kind = draw(st.sampled_from("bytes patch patch patch cut insert erase repeat".split()))
        if kind == "bytes" and content:
            content[at] = draw(st.integers(0, 255))
        elif kind == "patch":
            patch = draw(st.sampled_from(PATCHES))
            content[at : at + len(patch)] = patch
        elif kind == "cut":
            del content[at:]
        elif kind == "insert":
            content[at:at] = draw(st.binary(max_size=12))
        elif kind == "erase":
            del content[at : at + draw(st.integers(1, 12))]
        else:
            content[at:at] = content[at : at + draw(st.integers(1, 200))]
    return bytes(content)


def declared(file) -> int:
    """Bytes of the material that a file claims to be, as it is held in memory (float32)."""
    k = 2 * sum(file.components) + 2
    return 4 * k * (file.texels + 3 * file.pairs)


def read_within_bounds(path):
    """Reads a file as ``library import`` does; returns the material, or None where it was refused."""
    limit = SLACK + 2 * path.stat().st_size
    tracemalloc.start()
    try:
        try:
            file = open_btf(path)
            limit += 2 * declared(file)
            return linear.read(path, cosine="included")
        except InputError as error:
            assert error.what and error.got and error.do
            return None
        finally:
            peak = tracemalloc.get_traced_memory()[1]
            assert peak < limit, (peak, limit)
    finally:
        tracemalloc.stop()


@settings(max_examples=4000, deadline=HANG, suppress_health_check=list(HealthCheck))
@given(content=damaged_file())
def test_any_damage_gives_an_error_in_words_or_a_valid_material(tmp_path_factory, content):
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.getbasetemp() / "hostile"
        folder.mkdir(exist_ok=True)
        patch.setenv("BTFSEP_CACHE", str(folder / "cache"))
        path = folder / "a.btf"
        path.unlink(missing_ok=True)
        path.write_bytes(content)
        material = read_within_bounds(path)
    if material is not None:
        assert np.isfinite(material.angular).all() and np.isfinite(material.texels).all()
        assert np.isfinite(material.views).all() and np.allclose(np.linalg.norm(material.views, axis=1), 1)
        h, w, k = material.texels.shape
        assert material.angular.shape == (len(material.views), len(material.lights), 3, k) and h * w > 0


@pytest.mark.parametrize("number", range(len(VALID)))
def test_every_kind_is_read_whole(tmp_path, own_cache, number):
    """What the fuzzing starts from; and cut at any byte it is refused."""
    path = tmp_path / "a.btf"
    path.write_bytes(VALID[number])
    assert read_within_bounds(path) is not None
    for length in range(0, len(VALID[number]), 7):
        path.unlink()
        path.write_bytes(VALID[number][:length])
        with pytest.raises(InputError):
            open_btf(path)


@pytest.mark.parametrize("reduced", [0, 1])
@pytest.mark.parametrize(("width", "height", "views"), [(1000, 1000, 4), (2, 2, 1000)])
def test_large_but_honest_files_stay_within_twice_their_size(tmp_path, own_cache, reduced, width, height, views):
    """One component: the smallest file for what it declares. Blocks of a fixed size are allowed besides."""
    rng = np.random.default_rng(0)
    v = np.stack([np.full(views, 0.5), np.linspace(0, 6, views)], 1)
    lights = VIEWS if views < 9 else v
    common = {"views": v, "lights": lights, "width": width, "height": height}
    u, sxv = rng.normal(0, 0.3, (len(v) * len(lights) * 3, 1)), rng.normal(0, 0.3, (width * height, 1))
    (tmp_path / "a.btf").write_bytes(btf_files.fmf(u, sxv, reduced=reduced, **common))
    fixed = 100 << 20 if reduced else SLACK
    file = open_btf(tmp_path / "a.btf")
    limit = fixed + 2 * 4 * (4 if reduced else 1) * (file.texels + 3 * file.pairs)
    del file
    tracemalloc.start()
    material = linear.read(tmp_path / "a.btf", components=4)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert material.texels.shape[:2] == (height, width) and peak < limit, (peak, limit)


def small_zip() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("m/00001 tl000 pl000 tv000 pv000.jpg", b"abcd" * 50)
        archive.writestr("m/b.txt", b"text")
    return out.getvalue()


@settings(max_examples=800, deadline=HANG, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_damaged_zips_give_an_error_in_words_or_their_content(tmp_path_factory, data):
    content = bytearray(small_zip())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        patch = data.draw(st.one_of(st.sampled_from(PATCHES), st.binary(min_size=1, max_size=2)))
        content[at : at + len(patch)] = patch
    path = tmp_path_factory.getbasetemp() / "hostile.zip"
    path.unlink(missing_ok=True)
    path.write_bytes(content)
    try:
        with Members(path) as members:
            for name in members.names:
                with members.file(name) as scratch:
                    assert scratch.stat().st_size < 1000
    except InputError as error:
        assert error.what and error.got and error.do
