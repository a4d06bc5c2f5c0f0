# SPDX-License-Identifier: GPL-3.0-or-later
"""Odd meshes, cameras and photos through the whole command: the right light, or one clear sentence."""

import cv2
import numpy as np
import pytest
import trimesh

from btfsep_engine.cli import main
from btfsep_engine.imaging import images
from btfsep_engine.light.files import exactly, read_lighting, write_lighting
from tests.render.scenes import edited, looking_down

# the light has order 2 and nothing is noisy: least squares finds it exactly, whatever the file looks like
RUN = ["--material", "reference/white-diffuse", "--order", "2", "--estimator", "least-squares", "--no-report"]


def estimated(folder, *options):
    assert main(["estimate", str(folder), *RUN, *options]) == 0
    return read_lighting(folder / "result" / "lighting.json").coefficients


def refused(folder, capsys) -> str:
    assert main(["estimate", str(folder), *RUN]) == 2
    (line,) = [text for text in capsys.readouterr().err.splitlines() if text.startswith("error: ")]
    assert not (folder / "result").exists()
    return line


def rewritten(shape, name):
    """The sphere as triangles that the file describes oddly; the same surface."""
    vertices, faces = np.array(shape.vertices), np.array(shape.faces)
    random = np.random.default_rng(1)
    if name == "inside out":
        faces = faces[:, ::-1]
    elif name == "some faces flipped":
        some = random.random(len(faces)) < 0.3
        faces[some] = faces[some][:, ::-1]
    elif name == "every vertex three times":
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    elif name == "faces without area":
        faces = np.concatenate([faces, faces[:50, [0, 1, 1]]])
    elif name == "an edge of three faces":
        vertices = np.concatenate([vertices, 0.5 * vertices[faces[:20]].mean(1)])  # fins into the inside
        fins = np.stack([faces[:20, 0], faces[:20, 1], len(shape.vertices) + np.arange(20)], -1)
        faces = np.concatenate([faces, fins])
    return trimesh.Trimesh(vertices, faces, process=False)


@pytest.mark.parametrize(
    "name",
    ["inside out", "some faces flipped", "every vertex three times", "faces without area", "an edge of three faces"],
)
def test_the_same_surface_described_oddly_gives_the_same_light(sphere_job_folder, name):
    folder, truth = sphere_job_folder
    data = rewritten(trimesh.creation.icosphere(4), name).export(file_type="obj", include_normals=False)
    edited(folder, first={"mesh": "odd.obj"})
    (folder / "odd.obj").write_text(data)
    assert np.linalg.norm(estimated(folder) - truth) < 0.05 * np.linalg.norm(truth)


@pytest.mark.parametrize(
    ("scale", "offset"),
    [
        (1e-4, 0.0),
        (1.0, 1e6),
        (1e5, 0.0),
    ],
)
def test_size_and_place_do_not_matter(sphere_job_folder, scale, offset):
    folder, truth = sphere_job_folder
    place = np.diag([scale, scale, scale, 1.0])
    place[:3, 3] = offset

    camera = looking_down().to_world
    camera[:3, 3] = scale * camera[:3, 3] + offset
    edited(folder, camera={"to_world": camera.tolist()}, first={"to_world": place.tolist()})
    assert np.linalg.norm(estimated(folder) - truth) < 0.05 * np.linalg.norm(truth)


def test_a_mask_of_another_size_is_refused(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    cv2.imwrite(str(folder / "mask.png"), np.full((20, 30), 255, np.uint8))
    edited(folder, first={"mask": "mask.png"})
    assert "mask.png" in refused(folder, capsys)


def test_vertices_that_are_not_numbers_are_refused(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    (folder / "odd.obj").write_text("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n")
    edited(folder, first={"mesh": "odd.obj"})
    assert "NaN" in refused(folder, capsys)


def test_a_16_bit_photo_gives_the_light_up_to_its_scale(sphere_job_folder):
    folder, truth = sphere_job_folder
    pixels = images.read_linear(folder / "photo.exr").pixels
    scale = 0.8 / pixels.max()
    linear = np.clip(pixels * scale, 0, 1)
    coded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    cv2.imwrite(str(folder / "photo.png"), np.round(coded[..., ::-1] * 65535).astype(np.uint16))
    edited(folder, image="photo.png")
    assert np.linalg.norm(estimated(folder) / scale - truth) < 0.03 * np.linalg.norm(truth)


def test_how_far_the_ground_goes_on_does_not_matter(sphere_job_folder):
    """To a bowl on it: rays start a little off a surface, and light goes from one side of the bowl to the other."""
    folder, truth = sphere_job_folder
    bowl = trimesh.creation.icosphere(4)
    bowl.update_faces(bowl.triangles_center[:, 2] < 0.1)
    bowl.export(folder / "sphere.ply")
    write_lighting(folder / "light.json", exactly(truth))

    def on_ground(half):
        ground = trimesh.creation.box([2 * half, 2 * half, 0.02])
        ground.apply_translation([0, 0, -1.2]).export(folder / "ground.ply")
        black = {"base_color": [0.0, 0.0, 0.0], "specular": 0.0}
        edited(folder, occluders=[{"mesh": "ground.ply", "surface": black}])

    on_ground(3)
    shown = ["--lighting", str(folder / "light.json"), "--material", "reference/white-diffuse", "--directions", "4096"]
    assert main(["relight", str(folder), *shown, "--bounces", "8", "--out", str(folder / "photo.exr")]) == 0
    pixels = images.read_linear(folder / "photo.exr").pixels
    images.write_exr(folder / "photo.exr", np.nan_to_num(pixels))
    near = estimated(folder, "--bounces", "8")
    assert np.linalg.norm(near - truth) < 0.05 * np.linalg.norm(truth)
    for half in (300, 30_000):
        on_ground(half)
        assert np.linalg.norm(estimated(folder, "--bounces", "8") - near) < 2e-3 * np.linalg.norm(near)
