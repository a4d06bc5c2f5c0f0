# SPDX-License-Identifier: GPL-3.0-or-later
"""Odd photographs, masks, depths, cameras and meshes through `btfsep estimate`: a light, or one clear sentence."""

import json

import cv2
import numpy as np
import pytest
import trimesh

from btfsep_engine.cli import main
from btfsep_engine.imaging import images
from btfsep_engine.imaging.srgb import linear_to_srgb
from btfsep_engine.light.files import read_lighting
from scripts.studies.stage import seen_normals
from tests.render.scenes import edited, looking_down

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")  # of numbers: overflow, division by zero, NaN
RUN = ["--material", "reference/white-diffuse"]
PICTURES = {"lighting.json", "lighting.exr", "report.png", "result.json"}


def photographed(folder, pixels, name="photo.exr"):
    images.write_exr(folder / name, pixels)
    edited(folder, image=name)


EXACT = ("--estimator", "least-squares", "--order", "2")  # the light has order 2, and nothing is noisy


def estimated(folder, *options):
    """The light's coefficients; everything that a result has is there and whole."""
    assert main(["estimate", str(folder), *RUN, *options]) == 0
    result = folder / "result"
    assert {p.name for p in result.iterdir()} == PICTURES
    found = read_lighting(result / "lighting.json")
    assert np.isfinite(found.coefficients).all() and np.isfinite(found.stddev).all()
    json.loads((result / "result.json").read_text(), parse_constant=lambda word: pytest.fail(f"{word} in result.json"))
    assert np.isfinite(images.read_linear(result / "lighting.exr").pixels).all()
    assert cv2.imread(str(result / "report.png")) is not None
    return found.coefficients


def refused(folder, capsys, *options) -> str:
    """The one sentence; nothing is left behind."""
    before = sorted(p.relative_to(folder) for p in folder.rglob("*"))
    assert main(["estimate", str(folder), *RUN, *options]) == 2
    (line,) = [text for text in capsys.readouterr().err.splitlines() if text.startswith("error: ")]
    assert line.count(";") >= 2 and "Traceback" not in line
    assert sorted(p.relative_to(folder) for p in folder.rglob("*")) == before
    return line


def photo_of(folder):
    return images.read_linear(folder / "photo.exr").pixels


def near(found, truth, tolerance=0.06):
    n = len(truth)
    return np.linalg.norm(found[:n] - truth) < tolerance * np.linalg.norm(truth)


# photographs


def test_a_photo_of_one_pixel(sphere_job_folder):
    folder, _ = sphere_job_folder
    photographed(folder, np.full((1, 1, 3), 0.4, np.float32))
    edited(folder, camera=dict(width=1, height=1, fx=2.0, fy=2.0, cx=0.5, cy=0.5))
    estimated(folder)


@pytest.mark.parametrize("shape", [(1, 96), (96, 1), (2, 2)])
def test_a_photo_of_one_row_or_column(sphere_job_folder, shape):
    folder, _ = sphere_job_folder
    h, w = shape
    photographed(folder, np.full((h, w, 3), 0.4, np.float32))
    edited(folder, camera=dict(width=w, height=h, cx=w / 2, cy=h / 2))
    estimated(folder)
    assert main(["align", str(folder)]) == 0
    assert "too little" in json.loads((folder / "aligned" / "alignment.json").read_text())["why"]


def test_a_grey_photo_gives_grey_light(sphere_job_folder):
    folder, truth = sphere_job_folder
    grey = photo_of(folder).mean(-1)
    photographed(folder, grey)
    found = estimated(folder)
    assert np.allclose(found, found[:, :1], rtol=1e-3, atol=1e-3 * np.abs(found).max())
    assert near(estimated(folder, *EXACT).mean(-1), truth.mean(-1))


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_a_grey_png(sphere_job_folder, kind):
    folder, _ = sphere_job_folder
    grey = photo_of(folder).mean(-1)
    code = linear_to_srgb(grey * 0.8 / grey.max()) * np.iinfo(kind).max
    cv2.imwrite(str(folder / "grey.png"), np.round(code).astype(kind))
    edited(folder, image="grey.png")
    found = estimated(folder)
    assert np.allclose(found, found[:, :1], rtol=1e-3, atol=1e-3 * np.abs(found).max())


def test_transparent_pixels_are_left_out_of_the_light(sphere_job_folder):
    folder, truth = sphere_job_folder
    pixels = np.dstack([photo_of(folder), np.ones((96, 96), np.float32)])
    pixels[40:60, 30:50] = [9.0, 0.0, 9.0, 0.0]  # what a cut-out leaves behind
    photographed(folder, pixels)
    assert near(estimated(folder, *EXACT), truth)


def test_a_photo_that_is_all_transparent_is_refused(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    photographed(folder, np.dstack([photo_of(folder), np.zeros((96, 96), np.float32)]))
    assert "transparent" in refused(folder, capsys)


def test_an_object_that_is_all_transparent_is_refused(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    alpha = np.zeros((96, 96), np.float32)
    alpha[:3, :3] = 1  # of the background something is there
    photographed(folder, np.dstack([photo_of(folder), alpha]))
    for options in ((), ("--estimator", "least-squares")):
        assert "object 'ball'" in refused(folder, capsys, *options)


@pytest.mark.parametrize("options", [(), ("--estimator", "least-squares", "--order", "2")])
def test_an_object_that_is_all_white(sphere_job_folder, capsys, options):
    folder, _ = sphere_job_folder
    code = np.full((96, 96, 3), 255, np.uint8)
    code[:3, :3] = 90
    cv2.imwrite(str(folder / "white.png"), code)
    edited(folder, image="white.png")
    assert ("saturated" if options else "clipped") in refused(folder, capsys, *options)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_pixels_that_are_no_numbers_are_refused_and_counted(sphere_job_folder, capsys, value):
    folder, _ = sphere_job_folder
    pixels = photo_of(folder)
    pixels[3, 5] = pixels[50, 40, 1] = value
    photographed(folder, pixels)
    line = refused(folder, capsys)
    assert "2 pixels are NaN or infinite" in line and "x 5, y 3" in line


def test_negative_pixels_of_a_sharpened_photo_do_no_harm(sphere_job_folder):
    folder, truth = sphere_job_folder
    pixels = photo_of(folder)
    pixels[5:8, 5:8] = -0.3  # the background
    pixels[48, 48] = -0.01
    photographed(folder, pixels)
    assert near(estimated(folder, *EXACT), truth)


@pytest.mark.parametrize("value", [1e-30, 1e30])
def test_a_photo_of_one_value(sphere_job_folder, value):
    folder, _ = sphere_job_folder
    photographed(folder, np.full((96, 96, 3), value, np.float32))
    estimated(folder)


@pytest.mark.parametrize("value", [1e20, 1e37])
def test_light_is_in_the_units_of_the_photo_whatever_they_are(sphere_job_folder, value):
    folder, truth = sphere_job_folder
    photographed(folder, photo_of(folder) * np.float32(value / 4))
    assert near(estimated(folder, *EXACT), truth * value / 4)
    assert json.loads((folder / "result" / "result.json").read_text())["objects"][0]["residual"] < 0.01


@pytest.mark.parametrize("lit", [[1, 0, 0], [0, 1, 1], [1e-6, 0, 0], [1, 1e-6, 0]])
def test_a_photo_with_black_channels(sphere_job_folder, lit):
    """A sodium lamp: there is no light in the other channels, and no noise from which theirs could be told."""
    folder, truth = sphere_job_folder
    photographed(folder, photo_of(folder) * np.float32(lit))
    assert near(estimated(folder, *EXACT), truth * lit)
    found = estimated(folder)
    dark = np.array(lit) == 0
    assert np.abs(found[:, dark]).max() < np.abs(found).max()


@pytest.fixture(scope="module")
def plain_light():
    """The light of the photo as it is, once a test has found it."""
    return []


@pytest.mark.parametrize("value", [1e6, 1e20, 1e38])
@pytest.mark.parametrize("channels", [0, slice(None)], ids=["red", "all"])
def test_a_pixel_that_is_far_brighter_than_all_others_is_left_out(
    sphere_job_folder, plain_light, capsys, value, channels
):
    folder, _ = sphere_job_folder
    pixels = photo_of(folder)
    if not plain_light:
        plain_light.append(estimated(folder, "--pixels", "0"))
    pixels[48, 48, channels] = value
    photographed(folder, pixels)
    found = estimated(folder, "--pixels", "0")
    assert "show something else" in capsys.readouterr().err
    assert np.linalg.norm((found - plain_light[0])[:9]) < 0.05 * np.linalg.norm(plain_light[0][:9])


def test_a_black_photo_is_refused(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    photographed(folder, np.zeros((96, 96, 3), np.float32))
    assert "black" in refused(folder, capsys)


# masks


def test_masks_that_are_wrong_are_refused(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    edited(folder, first={"mask": "mask.png"})
    corner = np.zeros((96, 96), np.uint8)
    corner[:4, :4] = 255
    for mask, words in (
        (np.full((95, 96), 255, np.uint8), "96 x 95 pixels"),
        (np.zeros((96, 96), np.uint8), "mask is empty"),
        (corner, "leaves none"),
    ):
        cv2.imwrite(str(folder / "mask.png"), mask)
        assert words in refused(folder, capsys)


def test_a_mask_of_one_pixel(sphere_job_folder):
    folder, _ = sphere_job_folder
    mask = np.zeros((96, 96), np.uint8)
    mask[48, 48] = 255
    cv2.imwrite(str(folder / "mask.png"), mask)
    edited(folder, first={"mask": "mask.png"})
    estimated(folder)


# cameras and meshes


def test_a_camera_inside_a_closed_mesh_is_refused_and_in_an_open_one_sees(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    edited(folder, camera={"to_world": np.eye(4).tolist()})
    assert "inside closed geometry" in refused(folder, capsys)
    shape = trimesh.creation.icosphere(4)
    shape.update_faces(shape.triangles_center[:, 2] < 0.3)
    shape.export(folder / "open.ply")
    edited(folder, first={"mesh": "open.ply"})
    estimated(folder)


def test_a_camera_on_the_surface(sphere_job_folder, capsys):
    """What a ray of no length hits differs between Embree and OptiX; from a hair above it the ball is seen."""
    folder, _ = sphere_job_folder
    pose = np.eye(4)
    pose[2, 3] = 1.0
    edited(folder, camera={"to_world": pose.tolist()})
    if main(["estimate", str(folder), *RUN]):
        assert "inside closed geometry" in capsys.readouterr().err
    pose[2, 3] = 1.001
    edited(folder, camera={"to_world": pose.tolist()})
    estimated(folder)


def test_a_camera_that_sees_nothing_is_refused(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    pose = np.eye(4)
    pose[:3, 3] = [50.0, 0, 4]
    edited(folder, camera={"to_world": pose.tolist()})
    assert "the camera does not see it" in refused(folder, capsys)


def test_an_object_behind_another_is_refused(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    trimesh.creation.box([3, 3, 0.1]).apply_translation([0, 0, 2]).export(folder / "wall.ply")
    edited(folder, occluders=[{"mesh": "wall.ply"}])
    assert "other geometry is in front of it" in refused(folder, capsys)


@pytest.mark.parametrize("uv", ["xatlas", "mesh"])
def test_a_single_triangle(sphere_job_folder, uv):
    folder, _ = sphere_job_folder
    (folder / "one.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0.5 1\nf 1/1 2/2 3/3\n")
    edited(folder, first={"mesh": "one.obj", "uv": uv})
    estimated(folder, "--material", "leather/brown-grain", "--appearance", "textured")


def test_uv_without_area_are_refused(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    (folder / "one.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 0 1 0\nvt 0.5 0.5\nf 1/1 2/1 3/1\n")
    edited(folder, first={"mesh": "one.obj", "uv": "mesh"})
    options = ("--material", "leather/brown-grain", "--appearance", "textured")
    assert "texture coordinates without area" in refused(folder, capsys, *options)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "NaN"),
        ("v 0 0 0\nv inf 0 0\nv 0 1 0\nf 1 2 3\n", "infinite"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "names vertex 8"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -7\n", "names vertex"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no faces"),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\nf 1 1 1\n", "no face of the mesh has an area"),
        ("", "the file is empty"),
        ("hello\n", "neither a PLY nor an OBJ"),
    ],
)
def test_meshes_that_are_none_are_refused(sphere_job_folder, capsys, text, words):
    folder, _ = sphere_job_folder
    (folder / "odd.obj").write_text(text)
    edited(folder, first={"mesh": "odd.obj"})
    line = refused(folder, capsys)
    assert words in line and "odd.obj" in line


@pytest.mark.parametrize("material", ["reference/white-diffuse", "leather/brown-grain"])
def test_a_bad_mesh_is_as_good_as_it_can_be(sphere_job_folder, material):
    """Flipped and doubled faces, fins on edges, slivers, vertices of no face far away: all at once, with charts."""
    folder, truth = sphere_job_folder
    random = np.random.default_rng(4)
    ball = trimesh.creation.icosphere(4)
    vertices, faces = np.array(ball.vertices), np.array(ball.faces)
    some = random.random(len(faces)) < 0.2
    faces[some] = faces[some][:, ::-1]
    faces = np.concatenate([faces, faces[:200, ::-1], faces[:50, [0, 1, 1]]])
    vertices = np.concatenate([vertices, [[0, 0, 0]], [[1e7, 0, 0]]])
    fins = np.stack([faces[:30, 0], faces[:30, 1], np.full(30, len(ball.vertices))], -1)
    shape = trimesh.Trimesh(vertices, np.concatenate([faces, fins]), process=False)
    (folder / "odd.obj").write_text(shape.export(file_type="obj", include_normals=False))
    edited(folder, first={"mesh": "odd.obj"})
    white = material == "reference/white-diffuse"
    found = estimated(folder, "--material", material, "--appearance", "textured", *(EXACT if white else ()))
    if white:
        assert near(found, truth)


# depth instead of a mesh


def depth_of_a_sphere():
    camera = looking_down()
    normals, inside = seen_normals(camera)
    return np.where(inside, camera.to_world[2, 3] - normals[..., 2], 0).astype(np.float32)


def with_depth(folder, depth):
    images.write_exr(folder / "depth.exr", depth)
    edited(folder, depth="depth.exr", objects=[])


def test_a_depth_with_holes(sphere_job_folder):
    folder, _ = sphere_job_folder
    depth = depth_of_a_sphere()
    with_depth(folder, depth)
    whole = estimated(folder)
    depth[np.random.default_rng(0).random(depth.shape) < 0.02] = 0
    depth[30:40, 50:60] = np.inf
    with_depth(folder, depth)
    assert near(estimated(folder)[:9], whole[:9], 0.1)


@pytest.mark.parametrize(
    ("depth", "words"),
    [
        (np.full((96, 96), np.nan, np.float32), "NaN"),
        (np.full((96, 96), -1, np.float32), "negative"),
        (np.zeros((96, 96), np.float32), "no surface"),
        (np.full((96, 96), np.inf, np.float32), "no surface"),
        (np.ones((95, 96), np.float32), "96 x 95 pixels"),
    ],
)
def test_depths_that_are_none_are_refused(sphere_job_folder, capsys, depth, words):
    folder, _ = sphere_job_folder
    with_depth(folder, depth)
    assert words in refused(folder, capsys)


def test_depth_of_one_triangle(sphere_job_folder):
    folder, _ = sphere_job_folder
    depth = np.zeros((96, 96), np.float32)
    depth[48, 48] = depth[48, 49] = depth[49, 48] = 3.0
    with_depth(folder, depth)
    estimated(folder)


def test_a_failure_leaves_an_earlier_result_alone(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    estimated(folder)
    before = {p.name: p.read_bytes() for p in (folder / "result").iterdir()}
    pixels = photo_of(folder)
    pixels[0, 0] = np.nan
    photographed(folder, pixels)
    refused(folder, capsys)
    assert {p.name: p.read_bytes() for p in (folder / "result").iterdir()} == before
