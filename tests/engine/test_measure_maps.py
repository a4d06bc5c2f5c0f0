# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture maps as a patch: names, sizes, bit depths, conventions, normals to heights against closed forms, errors."""

import cv2
import numpy as np
import pytest

from btfsep_engine.btf import normal_maps, procedural
from btfsep_engine.btf.map_files import find_maps, kind_of
from btfsep_engine.btf.procedural import export_maps
from btfsep_engine.btf.texture_maps import read_maps, resample, seam, smooth_steps
from btfsep_engine.errors import InputError
from btfsep_engine.imaging.images import write_exr
from btfsep_engine.imaging.srgb import linear_to_srgb
from btfsep_engine.progress import Reporter

N = 64


def hills(n=N):
    """A periodic height in [0, 1] that is neither symmetric nor separable; row 0 is the smallest v."""
    u, v = np.meshgrid(*[(np.arange(n) + 0.5) / n * 2 * np.pi] * 2)
    h = np.sin(u) + 0.6 * np.cos(2 * u + v) + 0.4 * np.sin(3 * v - u) + 0.3 * np.cos(v)
    return (h - h.min()) / (h.max() - h.min())


def slopes_of_hills(scale, n=N):
    """dh/du and dh/dv of ``scale * hills`` for a tile of edge 1, by the derivative's own formula."""
    u, v = np.meshgrid(*[(np.arange(n) + 0.5) / n * 2 * np.pi] * 2)
    h = np.sin(u) + 0.6 * np.cos(2 * u + v) + 0.4 * np.sin(3 * v - u) + 0.3 * np.cos(v)
    du = np.cos(u) - 1.2 * np.sin(2 * u + v) - 0.4 * np.cos(3 * v - u)
    dv = -0.6 * np.sin(2 * u + v) + 1.2 * np.cos(3 * v - u) - 0.3 * np.sin(v)
    return np.stack([du, dv], -1) * (2 * np.pi * scale / (h.max() - h.min()))


def normals(slope, directx=False):
    """(n, n, 3) in [0, 1], row 0 the smallest v, as a normal map codes them."""
    n = np.stack([-slope[..., 0], -slope[..., 1] * (-1 if directx else 1), np.ones(slope.shape[:2])], -1)
    return n / np.linalg.norm(n, axis=-1, keepdims=True) / 2 + 0.5


def save(path, a, bits=8):
    """A PNG or TIFF of ``a`` in [0, 1], row 0 at the bottom."""
    codes = np.round(np.asarray(a)[::-1] * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)
    assert cv2.imwrite(str(path), codes[..., ::-1] if codes.ndim == 3 else codes)


def folder_of(tmp_path, **maps):
    """A folder with base colour and roughness, and what else is given: name with suffix "_" for "." -> array."""
    folder = tmp_path / "maps"
    folder.mkdir()
    rng = np.random.default_rng(1)
    maps = {"basecolor_png": rng.uniform(0.3, 0.6, (N, N, 3)), "roughness_png": np.full((N, N), 0.5)} | maps
    for name, a in maps.items():
        if a is not None:
            save(folder / ".".join(name.rsplit("_", 1)), a)
    return folder


def read(folder, reporter=None, **options):
    options = {"name": "leather/x", "size_mm": 20.0, "height_mm": 1.5, "resolution": N} | options
    return read_maps(folder, reporter=reporter, **options)


@pytest.mark.parametrize(
    ("stem", "kind"),
    [
        ("basecolor", "base colour"),
        ("Leather008_2K-PNG_Color", "base colour"),
        ("T_Wall_BaseColor", "base colour"),
        ("rough_wood_diff_4k", "base colour"),
        ("wall_base_color", "base colour"),
        ("stone-albedo", "base colour"),
        ("COL_VAR1", "base colour"),
        ("Leather008_2K-PNG_Displacement", "height"),
        ("knit_disp_2k", "height"),
        ("BumpMap", "height"),
        ("rough_plaster_rough_1k", "roughness"),
        ("WoodRoughness", "roughness"),
        ("metal_gloss", "gloss"),
        ("Metal032_2K-PNG_Metalness", "metallic"),
        ("rusty_metal_1k", "metallic"),
        ("metal_plate_diff_1k", "base colour"),
        ("plaster_nor_gl_2k", "normal"),
        ("Bricks_NormalDX", "normal"),
        ("leather_nrm", "normal"),
        ("leather_ao_2k", "other"),
        ("leather_color_preview", "other"),
        ("AmbientOcclusion", "other"),
        ("leather", None),
        ("collar", None),
    ],
)
def test_names(stem, kind):
    assert kind_of(stem) == kind


def test_pictures_become_the_maps_they_show(tmp_path):
    """8-bit sRGB colour, 16-bit height: linear, the right way up, in millimetres."""
    rng = np.random.default_rng(0)
    colour = rng.uniform(0.05, 0.8, (N, N, 3))
    rough = rng.uniform(0.2, 0.9, (N, N))
    folder = folder_of(tmp_path, basecolor_png=linear_to_srgb(colour), roughness_png=rough)
    save(folder / "height.tif", hills(), bits=16)
    found = read(folder, f0=0.05)
    np.testing.assert_allclose(found.maps.base_colour, colour, atol=6e-3)
    np.testing.assert_allclose(found.maps.roughness, rough, atol=2.1e-3)
    truth = 1.5 * (hills() - hills().mean())
    np.testing.assert_allclose(found.maps.height_mm, truth, atol=5e-5)
    assert found.relief_mm == pytest.approx(np.ptp(np.percentile(truth, [1, 99])), abs=1e-3)
    assert (found.maps.name, found.maps.size_mm, found.maps.f0) == ("leather/x", 20.0, 0.05)
    assert found.files == {"base colour": "basecolor.png", "height": "height.tif", "roughness": "roughness.png"}


def test_what_export_maps_writes_is_read_back(tmp_path):
    """Linear EXR, heights in mm, negative ones too: value times 1 mm."""
    maps = export_maps("leather/brown-grain", tmp_path, resolution=N)
    again = read(tmp_path, size_mm=maps.size_mm, height_mm=1.0).maps
    np.testing.assert_allclose(again.base_colour, maps.base_colour, atol=1e-6)
    np.testing.assert_allclose(again.height_mm, maps.height_mm, atol=1e-6)
    np.testing.assert_allclose(again.roughness, maps.roughness, atol=1e-6)


def test_gloss_is_the_inverse_of_roughness_and_yields_to_it(tmp_path):
    gloss = np.linspace(0.1, 0.7, N * N).reshape(N, N)
    folder = folder_of(tmp_path, roughness_png=None, gloss_png=gloss, height_png=hills())
    np.testing.assert_allclose(read(folder).maps.roughness, 1 - gloss, atol=2.1e-3)
    save(folder / "rough.png", np.full((N, N), 0.6))
    np.testing.assert_allclose(read(folder).maps.roughness, 0.6, atol=2.1e-3)


def test_maps_of_different_sizes_are_resampled_in_register(tmp_path):
    """A smooth pattern in each size is the same pattern afterwards; its mean stays."""
    folder = folder_of(tmp_path, roughness_png=0.2 + 0.7 * hills(256))
    save(folder / "height.png", hills(96), bits=16)
    found = read(folder).maps
    np.testing.assert_allclose(found.roughness, 0.2 + 0.7 * hills(), atol=5e-3)
    np.testing.assert_allclose(found.height_mm, 1.5 * (hills() - hills().mean()), atol=5e-3)


@pytest.mark.parametrize(("m", "n"), [(64, 16), (100, 24), (16, 64), (30, 30)])
def test_resampling_is_periodic_keeps_the_mean_and_a_wave(m, n):
    rng = np.random.default_rng(0)
    noise = rng.uniform(size=(m, m, 2))
    np.testing.assert_allclose(resample(noise, n).mean((0, 1)), noise.mean((0, 1)), atol=0.02)
    np.testing.assert_allclose(resample(np.full((m, m, 1), 0.3), n), 0.3, atol=1e-12)
    phase = [(np.arange(k) + 0.5) / k * 2 * np.pi + 0.4 for k in (m, n)]
    waves = [np.sin(p)[:, None, None] + np.cos(2 * p)[None, :, None] for p in phase]
    np.testing.assert_allclose(resample(waves[0], n), waves[1], atol=0.04)
    assert resample(waves[0], n).shape == (n, n, 1)


def test_an_elongated_map_is_repeated_across(tmp_path):
    colour = np.random.default_rng(0).uniform(0.3, 0.6, (N // 2, N, 3))
    height, rough = np.tile(hills()[:1], (N // 2, 1)), np.full((N // 2, N), 0.5)
    found = read(folder_of(tmp_path, basecolor_png=colour, height_png=height, roughness_png=rough)).maps
    np.testing.assert_allclose(found.base_colour[: N // 2], found.base_colour[N // 2 :], atol=1e-6)
    assert found.base_colour[: N // 2].std() > 0.03


@pytest.mark.parametrize("directx", [False, True])
@pytest.mark.parametrize("bits", [8, 16])
def test_normals_become_the_height_whose_slopes_they_are(tmp_path, directx, bits):
    """Slopes in closed form, 2 mm high over 20 mm; the convention is found out from the curl."""
    folder = folder_of(tmp_path)
    save(folder / "normal.png", normals(slopes_of_hills(2.0 / 20.0), directx), bits)
    found = read(folder, height_mm=None)
    assert found.normal_convention == ("directx" if directx else "opengl")
    truth = 2.0 * (hills() - hills().mean())
    np.testing.assert_allclose(found.maps.height_mm, truth, atol=0.02 if bits == 8 else 2e-3)
    scaled = read(folder, height_mm=3.0).maps.height_mm
    assert np.ptp(scaled) == pytest.approx(3.0, rel=1e-5)


def test_a_signed_normal_map_and_the_name_of_its_convention(tmp_path):
    folder = folder_of(tmp_path)
    n = 2 * normals(slopes_of_hills(0.1)) - 1
    write_exr(folder / "normal_dx.exr", n[::-1])
    wrong = read(folder, height_mm=None)
    assert wrong.normal_convention == "directx"  # the name counts, not what is in it
    right = read(folder, height_mm=None, normal_convention="opengl").maps.height_mm
    truth = 2.0 * (hills() - hills().mean())
    np.testing.assert_allclose(right, truth, atol=1e-4)
    assert np.abs(wrong.maps.height_mm - truth).max() > 0.3


def test_of_two_normal_maps_the_named_convention_is_taken(tmp_path):
    folder = folder_of(tmp_path)
    save(folder / "x_NormalGL.png", normals(slopes_of_hills(0.1)))
    save(folder / "x_NormalDX.png", normals(slopes_of_hills(0.1), directx=True))
    assert find_maps(folder).normal.name == "x_NormalGL.png"
    dx = find_maps(folder, normal_convention="directx")
    assert dx.normal.name == "x_NormalDX.png"
    first, second = (read(folder, height_mm=None, normal_convention=c).maps.height_mm for c in ("opengl", "directx"))
    np.testing.assert_allclose(first, second, atol=5e-3)


def test_what_does_not_tell_its_convention_is_said(tmp_path):
    """Grooves along u: turned over, they are grooves as well."""
    v = (np.arange(N) + 0.5) / N * 2 * np.pi
    slope = np.zeros((N, N, 2))
    slope[..., 1] = 0.4 * np.cos(3 * v)[:, None]
    folder, reporter = folder_of(tmp_path, normal_png=normals(slope)), Reporter()
    read(folder, reporter, height_mm=None)
    assert any("OpenGL is taken" in w for w in reporter.warnings)


def test_beside_a_height_the_normal_map_gives_its_fine_detail(tmp_path):
    """A coarse height and a normal map, twice as strong as it should be: the height's amplitude, the map's detail."""
    n = 256
    u, v = np.meshgrid(*[(np.arange(n) + 0.5) / n * 2 * np.pi] * 2)
    ripples = 0.02 * np.sin(40 * u + 20 * v)
    ripple_slope = 0.02 * 2 * np.pi * np.cos(40 * u + 20 * v)[..., None] * [40, 20]
    height_mm, size = 1.0, 20.0
    slope = 2 * (slopes_of_hills(height_mm / size, n) + ripple_slope * height_mm / size)
    folder, reporter = folder_of(tmp_path, normal_png=normals(slope, directx=True)), Reporter()
    save(folder / "height.png", hills(n) * 0.9 + 0.05, bits=16)
    found = read(folder, reporter, height_mm=height_mm / 0.9, size_mm=size, resolution=n)
    assert found.normal_convention == "directx" and not reporter.warnings
    truth = hills(n) + ripples
    error = found.maps.height_mm - (truth - truth.mean())
    assert np.sqrt((error**2).mean()) < 0.25 * np.sqrt((ripples**2).mean())


def test_a_normal_map_of_something_else_is_left_out(tmp_path):
    u, v = np.meshgrid(*[(np.arange(N) + 0.5) / N * 2 * np.pi] * 2)
    other = 0.1 * np.cos(2 * u - 4 * v)[..., None] * [2, -4]
    folder, reporter = folder_of(tmp_path, height_png=hills(), normal_png=normals(other)), Reporter()
    found = read(folder, reporter)
    assert any("do not show the same surface" in w for w in reporter.warnings)
    (folder / "normal.png").unlink()
    np.testing.assert_array_equal(found.maps.height_mm, read(folder).maps.height_mm)


def test_integration_leaves_only_the_curl():
    rng = np.random.default_rng(0)
    slope = slopes_of_hills(0.1)
    np.testing.assert_allclose(normal_maps.gradient(normal_maps.integrate(slope)), slope, atol=1e-10)
    assert normal_maps.curl_share(slope) < 1e-10
    assert normal_maps.curl_share(slope * [1, -1]) > 0.2
    assert normal_maps.curl_share(rng.normal(size=(N, N, 2))) == pytest.approx(0.5, abs=0.1)
    for shape in ((7, 12), (12, 7), (1, 8)):
        normal_maps.gradient(normal_maps.integrate(rng.normal(size=(*shape, 2))))


def test_terraces_of_8_bits_are_smoothed_within_a_step():
    truth = 0.2 + 0.1 * hills(256)  # 25 steps
    coded = np.round(truth * 255) / 255
    smooth = smooth_steps(coded)
    assert np.abs(smooth - coded).max() <= 0.5001 / 255
    error = [np.diff(a, axis=1) - np.diff(truth, axis=1) for a in (smooth, coded)]
    assert np.std(error[0]) < 0.2 * np.std(error[1])
    fine = np.round(truth * 65535) / 65535
    np.testing.assert_array_equal(smooth_steps(fine), fine)


def test_seams_are_seen_and_told(tmp_path):
    tiling = hills(128)
    cut = tiling[:, :90]
    assert max(seam(tiling[..., None], 0), seam(tiling[..., None], 1)) < 0.7
    assert seam(cut[..., None], 1) > 1.5 and seam(cut[..., None], 0) < 0.7
    noise = np.random.default_rng(0).uniform(size=(N, N, 1))  # differs everywhere: no seam to be seen
    assert max(seam(noise, 0), seam(noise, 1)) < 0.7
    stripes = np.tile((np.arange(N) // 16 % 2)[None, :, None].astype(float), (N, 1, 1))  # joints, one at the border
    assert seam(stripes, 1) < 1
    reporter = Reporter()
    read(folder_of(tmp_path, height_png=cut[:90, :90]), reporter)
    told = [w for w in reporter.warnings if "does not tile" in w]
    assert len(told) == 2 and all(w.startswith("height.png") for w in told)


def test_what_cannot_be_measured_is_told(tmp_path):
    white = np.ones((N, N, 3))
    folder = folder_of(tmp_path, basecolor_png=white, roughness_png=np.zeros((N, N)), height_png=hills())
    reporter = Reporter()
    found = read(folder, reporter).maps
    assert found.base_colour.max() == np.float32(procedural.MAX_ALBEDO) and found.roughness.min() == np.float32(0.15)
    assert found.metallic is None
    said = " ".join(reporter.warnings)
    assert "brighter than 0.85" in said and "smoother than roughness 0.15" in said


def test_metal_is_measured_and_may_be_brighter(tmp_path):
    """Left metal, right not; the same colour, brighter than any diffuse base may be."""
    metal = np.zeros((N, N))
    metal[:, : N // 2] = 1
    colour = linear_to_srgb(np.broadcast_to([0.94, 0.7, 0.3], (N, N, 3)))
    folder = folder_of(tmp_path, basecolor_png=colour, height_png=hills(), rusty_Metalness_png=metal)
    reporter = Reporter()
    found = read(folder, reporter)
    assert found.files["metallic"] == "rusty_Metalness.png"
    np.testing.assert_allclose(found.maps.metallic[N // 4, [N // 4, 3 * N // 4]], [1, 0], atol=1e-3)
    at = found.maps.base_colour[N // 4]
    np.testing.assert_allclose(at[N // 4], [0.94, 0.7, 0.3], atol=6e-3)
    np.testing.assert_allclose(at[3 * N // 4], [procedural.MAX_ALBEDO, 0.7, 0.3], atol=6e-3)
    assert any("0.98 where it is metal" in w for w in reporter.warnings)
    save(folder / "rusty_Metalness.png", metal * 0)
    assert read(folder).maps.metal() == ()
    save(folder / "metal.png", metal)
    with pytest.raises(InputError, match="2 files could be the metallic map"):
        read(folder)


def change(folder, name):
    """Breaks a good folder of maps; gives options and the words that must be said."""
    if name == "no base colour":
        (folder / "basecolor.png").unlink()
        return {}, "no map is named as base colour"
    if name == "no height":
        (folder / "height.png").unlink()
        return {}, "height (named like height, displacement or bump) or normal"
    if name == "two heights":
        save(folder / "bump.png", hills())
        return {}, "2 files could be the height map: bump.png, height.png"
    if name == "empty":
        for path in folder.iterdir():
            path.unlink()
        return {}, "it holds no images"
    if name == "no folder":
        return {"folder": folder / "absent"}, "No such file"
    if name == "shape":
        save(folder / "height.png", hills()[: N // 2])
        return {}, "is not that of the other maps"
    if name == "odd shape":
        save(folder / "basecolor.png", np.full((N, N - 20, 3), 0.5))
        return {}, "make no square"
    if name == "NaN":
        (folder / "height.png").unlink()
        bad = hills().astype(np.float32)
        bad[3, 4] = np.nan
        write_exr(folder / "height.exr", bad)
        return {}, "NaN"
    if name == "truncated":
        data = (folder / "height.png").read_bytes()
        (folder / "height.png").write_bytes(data[: len(data) // 2])
        return {}, "truncated or damaged"
    if name == "no normals":
        (folder / "height.png").rename(folder / "normal.png")
        save(folder / "normal.png", np.full((N, N, 3), [0.9, 0.5, 0.1]))
        return {}, "no tangent-space normal map"
    return {
        "no height_mm": ({"height_mm": None}, "it is not given"),
        "height": ({"height_mm": 21.0}, "21.0 mm"),
        "size": ({"size_mm": float("nan")}, "nan mm"),
        "f0": ({"f0": 0.9}, "f0"),
        "convention": ({"normal_convention": "vulkan"}, "'vulkan'"),
    }[name]


@pytest.mark.parametrize(
    "name",
    [
        *("no base colour", "no height", "two heights", "empty", "no folder", "shape", "odd shape", "NaN", "truncated"),
        *("no normals", "no height_mm", "height", "size", "f0", "convention"),
    ],
)
def test_bad_maps_get_a_sentence(tmp_path, name):
    folder = folder_of(tmp_path, height_png=hills())
    read(folder)
    options, words = change(folder, name)
    with pytest.raises(InputError) as caught:
        read(options.pop("folder", folder), **options)
    assert words in str(caught.value) and str(caught.value).count("; ") >= 2


@pytest.mark.parametrize("name", ["alcantara", "knit_fabric", "leather_008", "rock_020", "wood_floor_043"])
def test_real_sets(test_data, name):
    folder = test_data / "maps" / name
    if not folder.is_dir():
        pytest.skip("the test data have no such maps")
    found = read(folder, resolution=512).maps
    assert np.isfinite(found.height_mm).all() and found.height_mm.std() > 0.01
    assert 0.002 <= found.base_colour.min() and found.base_colour.mean() < 0.5
