# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs that say what an object is made of by numbers: commands, photographs in closed form, both transports."""

import json

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.cli import main
from btfsep_engine.commands.relight import earlier_estimate, earlier_materials
from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.job.load import load_job
from btfsep_engine.light.files import read_lighting
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.render.homogeneous import IMAGE_SIDE, homogeneous, pictured, reflected_share
from btfsep_engine.render.reference import Reference
from tests.render.prepared import MILLIMETRES, Prepared, sheet
from tests.render.scenes import answer, edited, positive_light

QUICK = ["--pixels", "1500", "--directions", "256", "--order", "2", "--no-report"]
WHITE = {"base_color": [0.8, 0.8, 0.8], "specular": 0}


def error_of(path, truth):
    return np.linalg.norm(read_lighting(path).coefficients - truth) / np.linalg.norm(truth)


def test_estimate_plan_sequence_and_relight_take_it(sphere_job_folder, capsys, tmp_path):
    folder, truth = sphere_job_folder
    edited(folder, first={"surface": WHITE})
    result = answer(capsys, "estimate", folder, *QUICK)
    (ball,) = result["objects"]
    assert (ball["material"], ball["class"], ball["recognised"]) == ("surface/given", "surface", False)
    assert error_of(result["lighting"], truth) < 0.12
    planned = answer(capsys, "plan", folder, *QUICK[:4])
    assert planned["objects"][0]["material"] == "surface/given"
    frames = answer(capsys, "sequence", folder, "--images", folder / "*.exr", *QUICK[:6])
    assert error_of(folder / "sequence" / frames["frames"][0]["lighting"], truth) < 0.12
    answer(capsys, "relight", folder, "--lighting", result["lighting"], "--out", tmp_path / "again.exr")
    photo, again = (images.read_linear(p).pixels for p in (folder / "photo.exr", tmp_path / "again.exr"))
    shown = again.sum(-1) > 0
    assert np.median(np.abs(again / photo - 1)[shown]) < 0.02
    # a name on the command line is what counts, and with half the albedo comes twice the light
    half = answer(capsys, "estimate", folder, "--material", "surface/matte", *QUICK)
    assert half["objects"][0]["material"] == "surface/matte"
    assert error_of(half["lighting"], 1.6 * truth) < 0.12


def test_what_an_earlier_job_said_by_numbers_is_no_name(sphere_job_folder):
    folder, _ = sphere_job_folder
    job, record = load_job(folder), {"objects": [{"name": "ball", "material": "surface/given"}]}
    (folder / "result").mkdir(exist_ok=True)
    for written, known in ((json.dumps(record), record), ("[1]", {}), ("{", {})):
        (folder / "result" / "result.json").write_text(written)
        assert earlier_estimate(job) == known and earlier_materials(job, known) == [None]


def test_photographs_solved_together_each_state_it(sphere_job_folder, capsys, tmp_path):
    folder, truth = sphere_job_folder
    other = tmp_path / "other"
    other.mkdir()
    for name in ("photo.exr", "sphere.ply", "job.json"):
        (other / name).write_bytes((folder / name).read_bytes())
    edited(folder, first={"surface": WHITE})
    assert main(["estimate", str(folder), "--with", str(other), *QUICK[:-1]]) == 2
    assert "give that key in every job" in capsys.readouterr().err
    edited(other, first={"surface": WHITE})
    result = answer(capsys, "estimate", folder, "--with", other, *QUICK)
    assert error_of(result["lighting"], truth) < 0.12


def painted_ball(folder):
    """The white ball of a job repainted: UVs, an image, and a photo of albedo as the image says."""
    ball = trimesh.creation.icosphere(5)
    u, v = 0.5 + 0.45 * ball.vertices[:, :2].T  # from above, where the camera is
    lines = [f"v {a} {b} {c}" for a, b, c in ball.vertices] + [f"vt {a} {b}" for a, b in zip(u, v, strict=True)]
    lines += ["f " + " ".join(f"{i + 1}/{i + 1}" for i in face) for face in ball.faces]
    (folder / "ball.obj").write_text("\n".join(lines) + "\n")
    row, column = np.mgrid[:256, :256] / 255.0
    picture = np.stack([0.2 + 0.7 * column, 0.5 - 0.4 * np.sin(9 * row), 0.1 + 0.5 * row], -1)
    images.write_exr(folder / "paint.exr", picture.astype(np.float32))
    job = load_job(folder)
    rows, columns = np.mgrid[: job.camera.height, : job.camera.width] + 0.5
    origin, direction = job.camera.rays(columns.ravel(), rows.ravel())
    b = (origin * direction).sum(1)
    reach = b * b - (origin**2).sum(1) + 1
    at = origin + (-b - np.sqrt(np.maximum(reach, 0)))[:, None] * direction
    u, v = 0.5 + 0.45 * at[:, :2].T
    albedo = np.stack([0.2 + 0.7 * u, 0.5 - 0.4 * np.sin(9 * (1 - v)), 0.1 + 0.5 * (1 - v)], -1)
    shape = job.photo.radiance.shape
    photo = np.where((reach > 0).reshape(shape[:2])[..., None], job.photo.radiance * albedo.reshape(shape) / 0.8, 0.1)
    images.write_exr(folder / "photo.exr", photo.astype(np.float32))


def test_an_image_is_fitted_with_its_texture(sphere_job_folder, capsys):
    folder, truth = sphere_job_folder
    painted_ball(folder)
    edited(folder, first={"surface": {"base_color": "paint.exr", "specular": 0}, "mesh": "ball.obj"})
    result = answer(capsys, "estimate", folder, *QUICK)
    assert error_of(result["lighting"], truth) < 0.35 and result["residual"] < 0.08
    assert "lines up and is used" in result["choice"]["appearance"]
    flat = answer(capsys, "estimate", folder, "--appearance", "mean", *QUICK)
    assert flat["residual"] > 0.1 and error_of(flat["lighting"], truth) > 0.4  # light has to imitate the paint


def laid(mesh, **numbers):
    """A surface with an image of strong colours on a mesh."""
    picture = 0.5 + 0.45 * np.sin(np.arange(12 * 12 * 3).reshape(12, 12, 3)).astype(np.float32)
    return pictured(Surface(image=picture, **numbers), "surface/given", mesh, millimetres_per_unit=MILLIMETRES)


@pytest.mark.parametrize("numbers", [{"roughness": 0.5}, {"roughness": 0.6, "metallic": 0.7}])
def test_both_transports_lay_the_image_alike(numbers):
    mesh, light = sheet(n=9), SHLighting(positive_light(3))
    scene = Prepared([mesh], laid(mesh, **numbers), count=200, use_texture=True, uv="mesh")
    ours = scene.kernel(light, directions=8192)[:, 0]
    # the reference has no textures of its own accord: what lines up is laid all the same
    path = Reference(scene.job, scene.tracer, scene.materials, bounces=1, textured=False)
    theirs = path.radiance(scene.points.pixels, light, samples=4096, jitter=False).radiance[:, 0]
    assert np.ptp(ours, axis=0).min() > 0.3 * ours.mean()
    assert np.median(np.abs(ours / theirs - 1)) < 0.02


def test_the_mean_of_an_image_is_that_of_the_places_that_the_mesh_shows():
    """A sheet that uses a corner of its image, the rest of which is black."""
    mesh = sheet(n=5)
    uv = mesh.corner_uv - mesh.corner_uv.min((0, 1))
    mesh.corner_uv[:] = 0.1 + 0.2 * uv / uv.max((0, 1))  # u and v from 0.1 to 0.3
    picture = np.zeros((32, 32, 3), np.float32)
    picture[16:, :16] = (0.8, 0.4, 0.2)  # the lower left quarter: v below 0.5
    material = pictured(Surface(specular=0.0, image=picture), "surface/given", mesh, millimetres_per_unit=1.0)
    np.testing.assert_allclose(material.diffuse_albedo(), (0.8, 0.4, 0.2), rtol=1e-4)
    one = homogeneous(Surface((0.8, 0.4, 0.2), specular=0.0), "surface/given")
    np.testing.assert_allclose(material.mean_material().mean_abrdf, one.mean_abrdf, rtol=1e-4)


def test_an_image_of_one_colour_is_that_colour():
    mesh = sheet(n=5)
    picture = np.broadcast_to(np.float32([0.9, 0.5, 0.1]), (4, 4, 3))
    for numbers in ({}, {"metallic": 1.0, "roughness": 0.8}, {"metallic": 0.3}):
        laid_one = pictured(Surface(image=picture, **numbers), "surface/given", mesh, millimetres_per_unit=1.0)
        one = homogeneous(Surface((0.9, 0.5, 0.1), **numbers), "surface/given")
        np.testing.assert_allclose(laid_one.mean_material().mean_abrdf, one.mean_abrdf, rtol=1e-5, atol=1e-7)


def test_each_place_has_the_finish_that_the_image_says():
    """A sheet on the left half of its image is of one finish, on the right half of another; row 0 is at the top."""
    picture = np.broadcast_to(np.float32([0.9, 0.5, 0.1]), (32, 32, 3))
    finish = np.zeros((32, 32, 3), np.float32)
    ends = {"bottom": (0.2, 1.0, 0.5), "top": (0.9, 0.0, 0.3)}  # roughness, metallic, specular
    finish[:16], finish[16:] = ends["top"], ends["bottom"]
    surface = Surface(image=picture, finish=finish)
    for end, low in (("bottom", 0.1), ("top", 0.6)):
        mesh = sheet(n=5)
        uv = mesh.corner_uv - mesh.corner_uv.min((0, 1))
        mesh.corner_uv[:] = low + 0.2 * uv / uv.max((0, 1))
        material = pictured(surface, "surface/given", mesh, millimetres_per_unit=1.0)
        numbers = dict(zip(("roughness", "metallic", "specular"), ends[end], strict=True))
        one = homogeneous(Surface((0.9, 0.5, 0.1), **numbers), "surface/given")
        np.testing.assert_allclose(material.mean_material().mean_abrdf, one.mean_abrdf, rtol=1e-4, atol=1e-6)
        rows = slice(0, IMAGE_SIDE // 4) if end == "top" else slice(-IMAGE_SIDE // 4, None)
        share = reflected_share(surface)[rows].mean((0, 1))
        np.testing.assert_allclose(share, one.diffuse_albedo(), atol=0.03 if end == "bottom" else 1e-3)
    assert [numbers["metallic"] for numbers in surface.numbers()["finishes"]] == [1.0, 0.0]


@pytest.mark.parametrize(("told", "size", "value", "words"), [
    ({"base_color": [1, 1, 1]}, 12, 0.5, "its base_color is no image; give an image"),
    ({}, 10, 0.5, "it has 10 x 10 pixels and paint.exr 12 x 12; write both"),
    ({}, 12, 1.5, "not within 0 and 1"),
    ({}, 12, None, "144 kinds of roughness, metallic and specular, and 16 may be; group"),
])  # fmt: skip
def test_a_finish_that_cannot_be(sphere_job_folder, told, size, value, words):
    folder, _ = sphere_job_folder
    painted_ball(folder)
    images.write_exr(folder / "paint.exr", np.full((12, 12, 3), 0.5, np.float32))
    values = np.linspace(0, 1, size * size) if value is None else np.full(size * size, value)
    images.write_exr(folder / "finish.exr", np.repeat(values.reshape(size, size, 1), 3, -1).astype(np.float32))
    edited(folder, first={"surface": {"base_color": "paint.exr", "finish": "finish.exr"} | told, "mesh": "ball.obj"})
    with pytest.raises(InputError, match=words):
        load_job(folder)


def test_names_of_the_family_go_where_names_go(sphere_job_folder, capsys):
    folder, truth = sphere_job_folder
    edited(folder, first={"surface": None, "material": "surface/matte"})
    result = answer(capsys, "estimate", folder, *QUICK)
    assert result["objects"][0]["material"] == "surface/matte" and error_of(result["lighting"], 1.6 * truth) < 0.12
    assert open_library().load("surface/matte").name == "surface/matte"
