# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading ``.btf`` files that another writer made: every colour model, layout, scalar size and signature."""

import cv2
import numpy as np
import pytest

from btfsep_engine.btf import linear
from btfsep_engine.btf.formats.ubo2014 import open_btf
from btfsep_engine.errors import InputError
from tests.engine import btf_files

VIEWS = np.radians([[0.0, 0], [30, 45], [60, 170], [75, -120]])
LIGHTS = np.radians([[0.0, 0], [45, -90], [75, 100]])
PAIRS, WIDTH, HEIGHT = len(VIEWS) * len(LIGHTS), 5, 3
COMMON = {"views": VIEWS, "lights": LIGHTS, "width": WIDTH, "height": HEIGHT}
MODELS = (0, 1, 2, 3, 4, 9, 10, 11, 12)
MEAN, MATRIX = (0.25, 0.5, 0.125), np.array([[0.5, 0.25, 0.125], [-0.5, 0.75, 0.5], [0.25, 0.25, -0.5]])


def factors(rng, ks=(4, 3, 2), scale=0.6):
    return [rng.normal(0, scale, (PAIRS, k)) for k in ks], [rng.normal(0, scale, (WIDTH * HEIGHT, k)) for k in ks]


def expected(u, sxv, dtype, decode):
    """(texels, pairs, 3): every value by itself."""
    u, sxv = ([np.asarray(a, dtype).astype(float) for a in part] for part in (u, sxv))
    out = np.empty((WIDTH * HEIGHT, PAIRS, 3))
    for t, p in np.ndindex(out.shape[:2]):
        out[t, p] = decode([sxv[c][t] @ u[c][p] for c in range(3)])
    return out


@pytest.mark.parametrize("transposed", [False, True])
@pytest.mark.parametrize("model", [m for m in MODELS if m != 2])
def test_every_colour_model_of_dfmf_against_an_independent_decode(tmp_path, rng, model, transposed):
    u, sxv = factors(rng)
    for dtype in ("<f2", "<f8"):
        data = btf_files.dfmf(
            u, sxv, model=model, mean=MEAN, matrix=MATRIX, dtype=dtype, transposed=transposed, **COMMON
        )
        (tmp_path / "a.btf").write_bytes(data)
        file = open_btf(tmp_path / "a.btf")
        truth = expected(u, sxv, dtype, lambda s: btf_files.rgb(model, s, MEAN, MATRIX))
        np.testing.assert_allclose(file.decode(slice(None), slice(None)), truth, rtol=1e-4, atol=1e-5)
        assert file.linear == (model in (0, 1, 3, 4)) and file.components == (4, 3, 2)
        texture, texel = file.decode(slice(None), [2 * len(LIGHTS) + 1]), file.decode([2 * WIDTH + 4], slice(None))
        np.testing.assert_allclose(texture[:, 0], truth[:, 2 * len(LIGHTS) + 1], rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(texel[0], truth[2 * WIDTH + 4], rtol=1e-4, atol=1e-5)


def test_cielab_against_opencv(tmp_path, rng):
    lab = np.stack([rng.uniform(5, 95, 40), rng.uniform(-60, 60, 40), rng.uniform(-60, 60, 40)], 1).astype(np.float32)
    u = [np.ones((PAIRS, 1))] * 3
    sxv = [lab[: WIDTH * HEIGHT, c : c + 1] for c in range(3)]
    (tmp_path / "a.btf").write_bytes(btf_files.dfmf(u, sxv, model=2, dtype="<f4", **COMMON))
    found = open_btf(tmp_path / "a.btf").decode(slice(None), [0])[:, 0]
    # OpenCV clips to the gamut: compare what lies within
    theirs = cv2.cvtColor(lab[None, : WIDTH * HEIGHT], cv2.COLOR_Lab2LRGB)[0]
    inside = (theirs > 1e-3).all(1) & (theirs < 0.999).all(1)
    assert inside.sum() >= 4
    np.testing.assert_allclose(found[inside], theirs[inside], atol=2e-3)


@pytest.mark.parametrize("signature", [b"!FMF12FCER", b"!FMF06FCR", b"!FMF06FC"])
@pytest.mark.parametrize("transposed", [False, True])
def test_both_layouts_and_all_signatures_of_fmf(tmp_path, rng, signature, transposed):
    reduced = signature == b"!FMF12FCER"
    spatial, angular = rng.normal(0, 0.6, (WIDTH * HEIGHT, 4)), rng.normal(0, 0.6, (PAIRS, 3, 4))
    truth = np.einsum("tk,pck->tpc", spatial.astype("<f4"), angular.astype("<f4"))
    if transposed:
        spatial, angular = rng.normal(0, 0.6, (WIDTH * HEIGHT, 3, 4)), rng.normal(0, 0.6, (PAIRS, 4))
        truth = np.einsum("tck,pk->tpc", spatial.astype("<f4"), angular.astype("<f4"))
    u, sxv = (spatial, angular) if transposed else (angular, spatial)
    data = btf_files.fmf(u.reshape(-1, 4), sxv, reduced=int(reduced), dtype="<f4", signature=signature, **COMMON)
    (tmp_path / "a.btf").write_bytes(data)
    file = open_btf(tmp_path / "a.btf")
    truth = np.exp(truth) - 1e-5 if reduced else truth
    np.testing.assert_allclose(file.decode(slice(None), slice(None)), truth, rtol=2e-5, atol=1e-5)
    assert file.linear != reduced and file.shared_spatial != transposed
    some = file.decode([1, 7], [3, 0, 11])
    np.testing.assert_allclose(some, truth[[1, 7]][:, [3, 0, 11]], rtol=2e-5, atol=1e-5)


@pytest.mark.parametrize("repeated", [False, True])
@pytest.mark.parametrize("model", [0, 1, 3, 4])
def test_linear_models_keep_their_factors_and_become_rgb(tmp_path, rng, model, repeated):
    u, sxv = factors(rng, (4, 4, 4) if repeated else (4, 3, 2))
    sxv = [sxv[0]] * 3 if repeated else sxv
    data = btf_files.dfmf(u, sxv, model=model, mean=MEAN, matrix=MATRIX, dtype="<f4", cosine=1, **COMMON)
    (tmp_path / "felt03_x.btf").write_bytes(data)
    material = linear.read(tmp_path / "felt03_x.btf")
    assert (material.name, material.material_class, material.texel_mm) == ("felt03_x", "felt", 0.25)
    truth = expected(u, sxv, "<f4", lambda s: btf_files.rgb(model, s, MEAN, MATRIX))
    truth = truth.reshape(HEIGHT, WIDTH, len(VIEWS), len(LIGHTS), 3) / np.cos(LIGHTS[:, 0])[:, None]
    found = np.einsum("yxk,vlck->yxvlc", material.texels, material.angular)
    np.testing.assert_allclose(found, truth, rtol=1e-4, atol=1e-5)
    assert material.texels.shape[2] == (4 if repeated and model != 3 else sum(len(a[0]) for a in u) + (model == 3))
    coarse = open_btf(tmp_path / "felt03_x.btf").truncated(2)
    assert coarse.components == (2, 2, 2)
    cut = expected(
        [a[:, :2] for a in u], [a[:, :2] for a in sxv], "<f4", lambda s: btf_files.rgb(model, s, MEAN, MATRIX)
    )
    np.testing.assert_allclose(coarse.decode(slice(None), slice(None)), cut, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("model", [9, 11, 12])
def test_log_domain_factors_become_linear_ones_and_are_cached(tmp_path, rng, monkeypatch, model):
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "cache"))
    u, sxv = factors(rng, (3, 2, 2), 0.4)
    (tmp_path / "a.btf").write_bytes(btf_files.dfmf(u, sxv, model=model, cosine=0, **COMMON))
    material = linear.read(tmp_path / "a.btf", components=15)
    truth = expected(u, sxv, "<f2", lambda s: btf_files.rgb(model, s)).reshape(
        HEIGHT, WIDTH, len(VIEWS), len(LIGHTS), 3
    )
    found = np.einsum("yxk,vlck->yxvlc", material.texels, material.angular)
    np.testing.assert_allclose(found, truth, rtol=2e-3, atol=2e-4)  # as many components as texels: exact
    assert material.texels.shape[2] <= 15
    (kept,) = (tmp_path / "cache" / "materials").iterdir()

    def forbidden(*_, **__):
        raise AssertionError("decoded again")

    monkeypatch.setattr(linear, "recompress", forbidden)
    again = linear.read(tmp_path / "a.btf", components=15)
    np.testing.assert_array_equal(again.angular, material.angular)
    with pytest.raises(AssertionError, match="decoded again"):
        linear.read(tmp_path / "a.btf", components=14)
    monkeypatch.undo()
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "cache"))
    kept.write_bytes(kept.read_bytes()[:200])  # damaged: made again
    np.testing.assert_array_equal(linear.read(tmp_path / "a.btf", components=15).angular, material.angular)
    assert len(kept.read_bytes()) > 200 and len(list(kept.parent.iterdir())) == 1


def test_pysmtb_and_we_read_the_files_of_a_third_writer_alike(tmp_path, rng):
    btf = pytest.importorskip("pysmtb.btf")
    u, sxv = factors(rng)
    data = btf_files.dfmf(u, sxv, model=11, mean=MEAN, matrix=MATRIX, xml=b"<a/>", cosine=0, **COMMON)
    (tmp_path / "a.btf").write_bytes(data)
    meta, theirs = btf.read_ubo_btf_dfmf(str(tmp_path / "a.btf"))
    file = open_btf(tmp_path / "a.btf")
    for c in range(3):
        np.testing.assert_array_equal(file.angular[c], theirs.U[c])
        np.testing.assert_array_equal(file.spatial[c], theirs.SxV[c])
    header = file.header
    assert (meta.width, meta.height, bool(meta.cosine_in_data)) == (header.width, header.height, header.cosine_in_data)
    np.testing.assert_allclose(np.array(meta.views_3d).reshape(-1, 3), header.views, atol=1e-6)
    assert (meta.color_model, header.xml, meta.xml) == (file.colour.model, "<a/>", b"<a/>")
    np.testing.assert_allclose(file.colour.mean, meta.color_mean)
    np.testing.assert_allclose(file.colour.matrix, meta.color_transformation_matrix)
    assert header.rgb_scale == meta.rgb_scale_factor == (1, 2, 3) and header.pixels_per_mm == meta.ppmm


@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_all_versions_of_the_header(tmp_path, rng, version):
    u, sxv = factors(rng)
    (tmp_path / "a.btf").write_bytes(btf_files.dfmf(u, sxv, version=version, cosine=1, **COMMON))
    header = open_btf(tmp_path / "a.btf").header
    assert header.cosine_in_data == (version > 1) and header.pixels_per_mm == 4 and header.setup == "test setup"


@pytest.mark.parametrize("signature", [b"!PVF06FCR", b"!PVF06FC", b"!BDIF06R2!"])
def test_kinds_that_are_not_supported_say_what_to_do(tmp_path, signature):
    (tmp_path / "a.btf").write_bytes(btf_files.header(signature, **COMMON))
    with pytest.raises(InputError, match=r"not supported; convert it to FMF or DFMF with .*btflib"):
        open_btf(tmp_path / "a.btf")


def test_values_that_are_not_finite_are_told_when_they_are_used(tmp_path, rng):
    u, sxv = factors(rng)
    sxv[1][7, 0] = np.nan
    u[0][3, 0] = 40000
    (tmp_path / "a.btf").write_bytes(btf_files.dfmf(u, sxv, model=12, **COMMON))
    file = open_btf(tmp_path / "a.btf")
    assert np.isfinite(file.decode([0, 1], [0, 1])).all()
    for texel, pair in ((7, 0), (0, 3)):
        with pytest.raises(InputError, match="NaN or infinite"):
            file.decode([texel], [pair])
