# SPDX-License-Identifier: GPL-3.0-or-later
"""UBO2003, ATRIUM and UTIA as folders and zips of small images made here, and a library that is added to."""

import re
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from btfsep_engine.btf.directions import ubo2003_directions
from btfsep_engine.btf.formats.archive import Members
from btfsep_engine.btf.formats.image_set import direction_index, find_images, import_images
from btfsep_engine.btf.importing import read_source
from btfsep_engine.errors import InputError

HEIGHT, WIDTH = 6, 8
RINGS = ((0, 360), (15, 60), (30, 30), (45, 20), (60, 18), (75, 15))
ANGLES = [(theta, phi) for theta, step in RINGS for phi in range(0, 360, step)]
TEXTURE = np.random.default_rng(5).uniform(0.4, 1.0, (HEIGHT, WIDTH, 3)) * [1.0, 0.7, 0.5]  # row 0: the largest v


def unit(theta, phi):
    t, p = np.radians([theta, phi])
    return np.array([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)])


def brdf(light, view):
    """Reciprocal: diffuse and a lobe about the half vector, 1/sr."""
    half = unit(*light) + unit(*view)
    return (0.4 + 0.5 * (half[2] / np.linalg.norm(half)) ** 10) / np.pi


def radiance(light, view):
    """(HEIGHT, WIDTH, 3) in [0, 1]: 1 is a white diffuse surface lit straight on."""
    return TEXTURE * brdf(light, view) * np.pi * unit(*light)[2]


def pairs():
    return [(light, view) for view in ANGLES for light in ANGLES]


def coded(linear):
    v = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round(v * 255).astype(np.uint8)[..., ::-1]


def rgbe(linear):
    """A Radiance file as ATRIUM has it: flat pixels, columns-first line, rows from the bottom up."""
    peak = linear.max(-1)
    exponent = np.floor(np.log2(np.maximum(peak, 1e-20))).astype(int) + 1
    mantissa = np.clip(np.round(linear / 2.0 ** exponent[..., None] * 256), 0, 255).astype(np.uint8)
    pixels = np.concatenate([mantissa, (exponent[..., None] + 128).astype(np.uint8)], -1)
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n+X {WIDTH} -Y {HEIGHT}\n".encode()
    return head + pixels[::-1].tobytes()


def ubo2003(light, view):
    (tl, pl), (tv, pv) = light, view
    return f"UBO2003/MANYFILES/tv{tv:03}_pv{pv:03}/00008 tl{tl:03} pl{pl:03} tv{tv:03} pv{pv:03}.jpg"


@pytest.fixture(scope="module")
def utia(tmp_path_factory) -> Path:
    """A folder of 6,561 PNG files."""
    folder = tmp_path_factory.mktemp("utia")
    for (tl, pl), (tv, pv) in pairs():
        image = cv2.imencode(".png", coded(radiance((tl, pl), (tv, pv))))[1]
        (folder / f"fabric01_tl{tl:03}_pl{pl:03}_tv{tv:03}_pv{pv:03}.png").write_bytes(image)
    (folder / "readme.txt").write_text("not an image")
    return folder


def check_against_truth(read, tolerance):
    material = read.material
    assert material.texels.shape[:2] == (HEIGHT, WIDTH) and material.angular.shape[:3] == (81, 81, 3)
    for light, view in (((0, 0), (0, 0)), ((45, 320), (75, 15)), ((60, 18), (15, 300)), ((75, 345), (30, 90))):
        l, v = ANGLES.index(light), ANGLES.index(view)
        np.testing.assert_allclose(material.lights[l], unit(*light), atol=1e-9)
        found = np.einsum("yxk,ck->yxc", material.texels, material.angular[v, l])
        np.testing.assert_allclose(found[::-1], TEXTURE * brdf(light, view), rtol=tolerance, atol=2e-3)


def test_a_folder_of_utia_images(utia):
    read = read_source(utia, name="fabric/a", material_class="fabric", size_mm=4.0, components=16)
    assert read.cosine == "included" and read.reciprocity.verdict == "included"
    assert read.material.texel_mm == 0.5 and read.kind == "81 x 81 images"
    assert read.relative_error < 0.03
    check_against_truth(read, 0.04)
    kept = read_source(
        utia, name="fabric/a", material_class="fabric", size_mm=4, components=4, cosine="excluded", scale=2
    )
    at = ANGLES.index((60, 18))
    ratio = kept.material.mean_abrdf[0, at] / read.material.mean_abrdf[0, at]
    np.testing.assert_allclose(ratio, 2 * 0.5, rtol=1e-3)


def test_a_zip_of_ubo2003_images(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for light, view in pairs():
            flat = np.broadcast_to(radiance(light, view).mean((0, 1)), (HEIGHT, WIDTH, 3))
            image = cv2.imencode(".jpg", coded(flat), [cv2.IMWRITE_JPEG_QUALITY, 100])[1]
            archive.writestr(ubo2003(light, view), image.tobytes())
    read = read_source(tmp_path / "a.zip", name="x/a", material_class="x", texel_mm=0.3, components=3)
    l, v = ANGLES.index((45, 320)), ANGLES.index((60, 18))
    np.testing.assert_allclose(
        read.material.mean_abrdf[v, l], TEXTURE.mean((0, 1)) * brdf((45, 320), (60, 18)), rtol=0.03
    )
    assert read.cosine == "included"


def test_atrium_files_are_mended_and_stand_upright(tmp_path):
    for (tl, pl), (tv, pv) in pairs():
        (tmp_path / f"00001 tl{tl:03} pl{pl:03} tv{tv:03} pv{pv:03}.hdr").write_bytes(
            rgbe(radiance((tl, pl), (tv, pv)))
        )
    read = read_source(tmp_path, name="x/a", material_class="x", texel_mm=0.3, components=16)
    check_against_truth(read, 0.03)


def test_the_list_of_directions_is_that_of_the_names():
    for number, angles in enumerate(ANGLES):
        assert direction_index(*angles) == number
        np.testing.assert_allclose(ubo2003_directions()[number], unit(*angles), atol=1e-9)
    assert direction_index(15, 30) is None and direction_index(20, 0) is None
    assert direction_index(75, 360) == direction_index(75, 0)


def test_missing_doubled_and_foreign_images(tmp_path, utia):
    for path in utia.iterdir():
        (tmp_path / path.name).symlink_to(path)
    lost = tmp_path / "fabric01_tl030_pl060_tv045_pv020.png"
    lost.unlink()
    with pytest.raises(InputError, match=r"1 of 6561 images are missing, the first of them tv045 pv020 tl030 pl060"):
        find_images(Members(tmp_path))
    other = tmp_path / "b tl000 pl000 tv000 pv000.png"
    other.symlink_to(utia / "fabric01_tl000_pl000_tv000_pv000.png")
    with pytest.raises(InputError, match="has the same angles"):
        find_images(Members(tmp_path))
    other.rename(tmp_path / "b tl010 pl000 tv000 pv000.png")
    with pytest.raises(InputError, match="not in the list of 81"):
        find_images(Members(tmp_path))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty"),
        (b"\x89PNG\r\n\x1a\n" + b"\0" * 8 + (60000).to_bytes(4, "big") * 2, "60000 x 60000"),
        (b"\x89PNG\r\n\x1a\n" + b"\0" * 8 + (1025).to_bytes(4, "big") * 2, "1025 x 1025"),
        (b"BM" + b"\0" * 60, "does not say its size"),
        (b"#?RADIANCE\n\n-Y 99999 +X 99999\n", "99999 x 99999"),
        (b"#?RADIANCE\n\n+Y 8 -X 8\n" + b"\0" * 300, "does not say its size"),
        (cv2.imencode(".png", np.zeros((3, 3, 3), np.uint8))[1].tobytes(), "another size"),
        (cv2.imencode(".png", np.zeros((HEIGHT, WIDTH, 3), np.uint8))[1].tobytes()[:60], "damaged"),
    ],
)
def test_bad_images_are_told_by_name(tmp_path, utia, content, words):
    for path in utia.iterdir():
        (tmp_path / path.name).symlink_to(path)
    bad = tmp_path / "fabric01_tl000_pl000_tv015_pv000.png"
    bad.unlink()
    bad.write_bytes(content)
    with pytest.raises(InputError, match=f"tl000_pl000_tv015_pv000.*{re.escape(words)}"):
        import_images(tmp_path, components=2)


def make_zip(path, entries, method=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in entries:
            archive.writestr(name, data)
    return path


@pytest.mark.parametrize("name", ["../a.png", "/etc/a.png", "x/../../a.png", "C:\\a.png", "..\\a.png"])
def test_zips_whose_names_lead_out_are_refused(tmp_path, name):
    with pytest.raises(InputError, match="leads out"):
        Members(make_zip(tmp_path / "a.zip", [(name, b"x")]))


def test_zip_bombs_are_refused_before_they_are_unpacked(tmp_path):
    make_zip(tmp_path / "a.zip", [("a.png", bytes(40 << 20))], zipfile.ZIP_DEFLATED)
    with pytest.raises(InputError, match="zip bomb"):
        Members(tmp_path / "a.zip")
    # hidden among honest data: the ratio of all is harmless, that of the member is not
    noise = np.random.default_rng(1).bytes(3 << 20)
    make_zip(tmp_path / "b.zip", [("a.png", bytes(40 << 20)), ("b.png", noise)], zipfile.ZIP_DEFLATED)
    with Members(tmp_path / "b.zip") as members:
        with pytest.raises(InputError, match="zip bomb"), members.file("a.png"):
            pass
        with members.file("b.png") as path:
            assert path.read_bytes() == noise
        assert not path.exists()


def test_zips_that_lie_about_a_members_size(tmp_path):
    make_zip(tmp_path / "a.zip", [("a.png", bytes(200_000))], zipfile.ZIP_DEFLATED)
    data = bytearray((tmp_path / "a.zip").read_bytes())
    size = (200_000).to_bytes(4, "little")
    assert data.count(size) == 2
    (tmp_path / "a.zip").write_bytes(bytes(data).replace(size, (1000).to_bytes(4, "little")))
    with Members(tmp_path / "a.zip") as members:
        with pytest.raises(InputError, match="cannot be unpacked"), members.file("a.png"):
            pass
    (tmp_path / "a.zip").write_bytes(bytes(data).replace(size, (65 << 20).to_bytes(4, "little")))
    with pytest.raises(InputError, match="zip bomb"):
        Members(tmp_path / "a.zip")


def test_damaged_and_encrypted_zips(tmp_path):
    make_zip(tmp_path / "a.zip", [("a.png", b"0123456789" * 20)])
    data = (tmp_path / "a.zip").read_bytes()
    (tmp_path / "a.zip").write_bytes(data.replace(b"0123", b"9999", 1))
    with Members(tmp_path / "a.zip") as members:
        with pytest.raises(InputError, match="CRC"), members.file("a.png"):
            pass
    central = data.index(b"PK\1\2")
    (tmp_path / "b.zip").write_bytes(data[: central + 8] + b"\1\0" + data[central + 10 :])
    with Members(tmp_path / "b.zip") as members:
        with pytest.raises(InputError, match="cannot be unpacked"), members.file("a.png"):
            pass
    (tmp_path / "c.zip").write_bytes(data[:-30])
    with pytest.raises(InputError, match="neither"):
        Members(tmp_path / "c.zip")
    with pytest.raises(InputError, match="no such file"):
        Members(tmp_path / "none.zip")


def test_what_is_no_material_is_called_so_before_its_size_is_asked_for(tmp_path, utia):
    mesh = tmp_path / "mesh.obj"
    mesh.write_text("v 0 0 0\n")
    for size in (None, 30.0):
        with pytest.raises(InputError, match=r"neither a \.btf file, nor a zip, nor a folder"):
            read_source(mesh, name="fabric/a", material_class="fabric", size_mm=size)
    with pytest.raises(InputError, match="the source does not say it; give --size-mm"):
        read_source(utia, name="fabric/a", material_class="fabric")
