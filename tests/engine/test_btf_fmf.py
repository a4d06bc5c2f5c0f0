# SPDX-License-Identifier: GPL-3.0-or-later
"""``.btf`` files: against pysmtb, against a reader written here from the format's facts, and against bad files."""

import io
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from btfsep_engine.btf import linear
from btfsep_engine.btf.directions import ubo2014_angles, ubo2014_directions
from btfsep_engine.btf.formats import writing
from btfsep_engine.btf.formats.ubo2014 import open_btf
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.conventions import local_direction
from btfsep_engine.errors import InputError

VIEWS = local_direction(np.radians([0.0, 30, 60, 75]), np.radians([0.0, 45, 170, -120]))
LIGHTS = local_direction(np.radians([0.0, 45, 75]), np.radians([0.0, -90, 100]))


def material(k=4, views=VIEWS, lights=LIGHTS, shape=(5, 7), seed=0):
    rng = np.random.default_rng(seed)
    texels = rng.normal(0, 1, (*shape, k)).astype(np.float32)
    angular = rng.uniform(0.05, 1, (len(views), len(lights), 3, k)).astype(np.float32)
    return Tabulated("leather/x", "leather", texels, angular, views, lights, 0.3)


def values(m):
    """(h, w, views, lights, 3)"""
    return np.einsum("yxk,vlck->yxvlc", m.texels, m.angular)


def plain_reader(data):
    """value[y, x, v, l, c] and the flag of an ``!FMF12FCER`` file, read the slow way, straight from the layout."""
    f = io.BytesIO(data)

    def take(layout):
        return struct.unpack("<" + layout, f.read(struct.calcsize("<" + layout)))

    assert f.read(10) == b"!FMF12FCER"
    size, version = take("II")
    assert (size, version) == (291, 4)
    f.read(240)
    take("4f")
    flag, xml, channels = take("III")
    assert (xml, channels) == (0, 3)
    assert [f.read(take("I")[0]) for _ in range(3)] == [b"R", b"G", b"B"]
    assert f.tell() == 10 + 291
    for _ in range(take("I")[0]):
        take("2f")
        n_lights = take("I")[0]
        f.read(8 * n_lights)
    width, height, rotations = take("III")
    assert rotations == 0
    assert take("BI") == (2, 0)
    hm_width, hm_height = take("II")
    f.read(2 * hm_width * hm_height)
    _, scalar, k, rows, cols = take("IBIII")
    assert scalar == 2
    f.read(2 * k)
    u = np.frombuffer(f.read(2 * rows * k), "<f2").reshape(rows, k).astype(float)
    sxv = np.frombuffer(f.read(2 * cols * k), "<f2").reshape(cols, k).astype(float)
    assert f.read() == b""
    out = np.empty((height, width, len(VIEWS), n_lights, 3))
    for y, x, v, l, c in np.ndindex(out.shape):
        out[y, x, v, l, c] = u[(v * n_lights + l) * 3 + c] @ sxv[y * width + x]
    return out, flag


@pytest.mark.parametrize("cosine", [True, False])
def test_written_files_hold_the_values_and_the_cosine_once(tmp_path, cosine):
    m = material()
    writing.write(tmp_path / "a.btf", m, cosine=cosine, height_mm=np.ones((6, 2)))
    stored, flag = plain_reader((tmp_path / "a.btf").read_bytes())
    factor = LIGHTS[:, 2, None] if cosine else 1.0
    assert flag == cosine
    np.testing.assert_allclose(stored, values(m) * factor, atol=6e-3)
    again = linear.read(tmp_path / "a.btf")
    np.testing.assert_allclose(values(again), values(m), atol=2e-2)
    overridden = linear.read(tmp_path / "a.btf", cosine="excluded" if cosine else "included")
    back = LIGHTS[:, 2, None] if cosine else 1 / LIGHTS[:, 2, None]
    np.testing.assert_allclose(values(overridden), values(again) * back, rtol=1e-4, atol=1e-5)


def test_reading_keeps_geometry_names_and_height(tmp_path):
    m = material()
    height = np.arange(12.0).reshape(3, 4) / 8
    writing.write(tmp_path / "leather07_resampled.btf", m, height_mm=height, setup="a test")
    again = linear.read(tmp_path / "leather07_resampled.btf")
    assert (again.name, again.material_class) == ("leather07_resampled", "leather")
    assert again.texel_mm == pytest.approx(0.3)
    np.testing.assert_allclose(again.views, VIEWS, atol=1e-6)
    np.testing.assert_allclose(again.lights, LIGHTS, atol=1e-6)
    header = open_btf(tmp_path / "leather07_resampled.btf").header
    assert header.setup == "a test"
    np.testing.assert_array_equal(header.height_mm, height)
    flipped = linear.read(tmp_path / "leather07_resampled.btf", flip_v=True)
    np.testing.assert_array_equal(flipped.texels, again.texels[::-1])


def test_pysmtb_reads_our_dfmf_files_and_we_read_them_alike(tmp_path):
    btf = pytest.importorskip("pysmtb.btf")
    directions = ubo2014_directions()
    m = material(k=3, views=directions, lights=directions, shape=(4, 6))
    path = tmp_path / "felt.btf"
    writing.write(path, m, layout="dfmf")
    meta, data = btf.read_ubo_btf_dfmf(str(path))
    assert (meta.width, meta.height, meta.num_views, meta.num_lights) == (6, 4, 151, 151)
    assert bool(meta.cosine_in_data) and meta.ppmm == pytest.approx(1 / 0.3)
    np.testing.assert_allclose(np.array(meta.views_3d).reshape(151, 3), directions, atol=1e-6)
    theirs = np.stack(
        [sxv.astype(np.float32) @ u.astype(np.float32).T for u, sxv in zip(data.U, data.SxV, strict=True)], -1
    )
    theirs = theirs.reshape(4, 6, 151, 151, 3) / directions[:, 2, None]
    np.testing.assert_allclose(values(linear.read(path)), theirs, atol=1e-4)
    np.testing.assert_allclose(theirs, values(m), atol=2e-2)
    angles = np.frombuffer(path.read_bytes()[301 + 4 + 12 :], "<f4", 302).reshape(151, 2)
    np.testing.assert_allclose(angles, ubo2014_angles(), atol=1e-6)


def damaged(data, at, layout, value):
    return data[:at] + struct.pack("<" + layout, value) + data[at + struct.calcsize(layout) :]


def offsets():
    """Byte positions in the file of :func:`material`: views, lights, width, FMF header, factors."""
    views = 301
    lights = views + 4 + 8
    width = views + 4 + len(VIEWS) * (12 + 8 * len(LIGHTS))
    extra = width + 12
    return {"views": views, "lights": lights, "width": width, "extra": extra, "factors": extra + 13}


@pytest.mark.parametrize(
    ("place", "skip", "layout", "value", "words"),
    [
        ("views", -301, "B", 0x20, "does not begin"),
        ("views", -291, "I", 290, "length does not agree"),
        ("views", 0, "I", 2**32 - 1, "view directions"),
        ("views", 0, "I", 1025, "view directions"),
        ("views", 4, "f", float("nan"), "not finite"),
        ("views", 4, "f", 1.6, "horizon"),
        ("lights", 0, "I", 2**32 - 1, "cut short"),
        ("lights", 0, "I", 0, "without lights"),
        ("lights", 4, "f", 0.25, "different light lists"),
        ("width", 0, "I", 0, "0 x 5 texels; 1 to"),
        ("width", 0, "I", 2**31, "texels"),
        ("width", 0, "I", 8, "do not fit"),
        ("width", 8, "I", 2**30, "cut short"),
        ("extra", 1, "I", 2, "dynamic range reduction 2"),
        ("extra", 5, "I", 0, "cut short"),
        ("factors", 4, "B", 3, "scalars have 3 bytes; 2, 4 and 8"),
        ("factors", 5, "I", 2**31, "cut short"),
        ("factors", 5, "I", 0, "no components"),
        ("factors", 9, "I", 2**31, "cut short"),
        ("factors", 17 + 8, "e", float("inf"), "NaN or infinite"),
    ],
)
def test_bad_files_are_told_in_words(tmp_path, place, skip, layout, value, words):
    path = tmp_path / "a.btf"
    writing.write(path, material())
    data = path.read_bytes()
    if words == "cut short" and (place, skip) == ("extra", 5):
        data = data[:-1]
    else:
        data = damaged(data, offsets()[place] + skip, layout, value)
    path.write_bytes(data)
    with pytest.raises(InputError, match=words):
        linear.read(path)


def test_missing_file_and_values_beyond_half_floats(tmp_path):
    with pytest.raises(InputError, match="cannot read"):
        linear.read(tmp_path / "none.btf")
    m = material()
    m.angular[0, 0, 0, 0] = 1e6
    with pytest.raises(InputError, match="half floats"):
        writing.write(tmp_path / "a.btf", m)
    assert list(tmp_path.iterdir()) == []


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_no_file_however_damaged_raises_anything_else(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("fuzz")
    path = folder / "a.btf"
    writing.write(path, material(k=1, shape=(2, 2)), layout=data.draw(st.sampled_from(["fmf", "dfmf"])))
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))] if data.draw(st.booleans()) else content)
    try:
        read = linear.read(path)
    except InputError:
        return
    assert np.isfinite(read.angular).all() and np.isfinite(read.texels).all()
