# SPDX-License-Identifier: GPL-3.0-or-later
"""The key ``surface`` of objects and occluders: what it says, and each thing that can be wrong, in a sentence."""

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.errors import InputError
from btfsep_engine.imaging.srgb import srgb_to_linear
from btfsep_engine.job.load import load_job
from btfsep_engine.job.model import Job
from tests.engine.test_images import png_that_claims
from tests.engine.test_job import changed, fails

WHOLE = {"base_color": [0.1, 0.2, 1], "roughness": 0.3, "metallic": 1, "specular": 0, "emission": [0, 0, 0]}


def with_surface(job, surface):
    job.tree["objects"][0]["surface"] = surface
    return job


def test_every_key_is_read_and_every_key_may_be_left_out(job):
    (cube,) = load_job(with_surface(job, WHOLE).write()).objects
    assert cube.surface == Surface((0.1, 0.2, 1), roughness=0.3, metallic=1, specular=0)
    assert cube.material is None and cube.uv == "xatlas" and not cube.pictured
    before = load_job(job.folder).digest
    (cube,) = load_job(with_surface(job, {}).write()).objects
    assert cube.surface == Surface((0.8, 0.8, 0.8), roughness=0.5, metallic=0, specular=0.5)
    assert load_job(job.folder).digest != before
    (cube,) = load_job(with_surface(job, None).write()).objects
    assert cube.surface is None


def test_an_image_is_linear_square_and_of_the_mesh_s_own_uvs(job):
    codes = np.random.default_rng(0).integers(0, 256, (5, 9, 3), np.uint8)
    cv2.imwrite(str(job.folder / "paint.png"), codes[..., ::-1])
    (cube,) = load_job(with_surface(job, {"base_color": "paint.png"}).write()).objects
    assert cube.pictured and cube.uv == "mesh" and cube.surface.image.shape == (9, 9, 3)
    linear = srgb_to_linear(codes / 255.0)
    np.testing.assert_allclose(cube.surface.image[4], linear[2], atol=1e-6)  # the middle row, in linear light
    np.testing.assert_allclose(cube.surface.image[0], linear[0], atol=1e-6)  # row 0 is the top
    job.exr("paint.exr", np.full((4, 4, 3), 0.25, np.float32))
    (cube,) = load_job(with_surface(job, {"base_color": "paint.exr"}).write()).objects
    np.testing.assert_array_equal(cube.surface.image, np.float32(0.25))  # float files are linear
    seen = load_job(job.folder).digest
    job.exr("paint.exr", np.full((4, 4, 3), 0.5, np.float32))
    assert load_job(job.folder).digest != seen


def test_large_images_are_averaged_down(job):
    stripes = np.zeros((2, 5000, 3), np.float32)
    stripes[:, ::2] = 1
    job.exr("paint.exr", stripes)
    (cube,) = load_job(with_surface(job, {"base_color": "paint.exr"}).write()).objects
    assert cube.surface.image.shape == (2048, 2048, 3)
    np.testing.assert_allclose(cube.surface.image.mean(), 0.5, atol=1e-3)
    assert np.ptp(cube.surface.image) < 0.75  # 2.4 columns each


def test_an_image_of_base_colours_that_claims_gigabytes_is_refused_undecoded(job):
    (job.folder / "paint.png").write_bytes(png_that_claims(8193, 8192))
    fails(with_surface(job, {}), "8193 x 8192 pixels; the limit", "objects.0.surface.base_color", "paint.png")


def test_a_surface_from_depth_takes_numbers(job):
    job.exr("depth.exr", np.full((8, 12, 1), 4.0, np.float32), "Z")
    job.tree |= {"depth": "depth.exr", "objects": [{"name": "wall", "mesh": None, "surface": {"metallic": 1}}]}
    (wall,) = load_job(job.write()).objects
    assert wall.surface.metallic == 1
    cv2.imwrite(str(job.folder / "paint.png"), np.zeros((4, 4, 3), np.uint8))
    fails(job, "the mesh has no UV map", "objects.0.surface", {"base_color": "paint.png"})


def test_those_of_occluders_are_read_and_a_warning_says_that_emission_is_left_out(job):
    job.tree["occluders"].append({"mesh": "cube.obj"})
    job.tree["occluders"][0]["surface"] = {"base_color": [0.7, 0.1, 0.1], "emission": [5, 4, 3]}
    result = load_job(job.write())
    (warning,) = result.warnings
    assert "occluders[0]" in warning and "emission, which is left out" in warning
    assert result.occluders[0].surface.base_color == (0.7, 0.1, 0.1) and result.occluders[1].surface is None
    del job.tree["occluders"][0]["surface"]["emission"]
    assert load_job(job.write()).warnings == ()
    fails(job, "no file 'none.png'", "occluders.0.surface.base_color", "none.png")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("roughness", float("nan"), r"surface.roughness; it is nan; it has to be a finite number"),
        ("roughness", -0.1, "roughness; it is -0.1; it has to be at least 0"),
        ("metallic", 1.5, "metallic; it is 1.5; it has to be at most 1"),
        ("specular", "0.5", 'specular; it is "0.5"; it has to be a number'),
        ("specular", None, "specular; it is null; it has to be a number"),
        ("base_color", [0.5, 0.5, 1.2], r"base_color\[2\]; it is 1.2; it has to be at most 1"),
        ("base_color", [0.5, "a", 1], r'base_color\[1\]; it is "a"; it has to be a number'),
        ("base_color", [0.5, float("inf"), 1], r"base_color\[1\]; it is inf; it has to be a finite number"),
        ("base_color", [0.5, 0.5], "base_color; it has 2 entries; it needs at least 3"),
        ("base_color", [0.5] * 4, "base_color; it has 4 entries; it needs at most 3"),
        ("base_color", 0.5, "base_color; it is 0.5; it has to be a list of three numbers or the name of an image"),
        ("base_color", None, "base_color; it is null; it has to be a list of three numbers or the name of an image"),
        ("base_color", {}, "base_color; it is {}; it has to be a list"),
        ("base_color", "", "base_color; it is empty"),
        ("base_color", "../paint.png", "'../paint.png' is not inside the job folder"),
        ("base_color", "/etc/passwd", "'/etc/passwd' is not inside the job folder"),
        ("base_color", "paint.png", "object 'cube': surface; there is no file 'paint.png' in the job folder"),
        ("base_color", "cube.obj", "cube.obj; "),
        ("base_colour", [1, 1, 1], "did you mean 'base_color'"),
        ("a colour", 1, "this key is not known"),
        ("emission", [0, 0, 3], "object 'cube': surface; it has emission"),
        ("emission", [0, -1, 0], r"emission\[1\]; it is -1"),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(job, key, value, words):
    fails(with_surface(job, {key: value}), words)


def test_images_that_are_no_base_colours(job):
    job.tree["objects"][0]["surface"] = {"base_color": "paint.exr"}
    colours = np.full((4, 4, 3), 0.5, np.float32)
    for value, words in ((np.nan, "1 of its colours are not within 0 and 1, first x 2, y 1"), (7.0, "not within")):
        colours[1, 2, 1] = value
        job.exr("paint.exr", colours)
        fails(job, f"paint.exr; .*{words}")
    job.exr("paint.exr", np.full((4, 4, 3), 0.5, np.float32))
    (job.folder / "bare.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    fails(job, "the mesh has no UV map", "objects.0.mesh", "bare.obj")


def test_a_material_and_a_surface_exclude_each_other(job):
    fails(with_surface(job, {}), "object 'cube'; it has a material and a surface", "objects.0.material", "felt/a")


ANYTHING = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-2, 2)
    | st.floats()
    | st.text(max_size=4)
    | st.sampled_from(["paint.png", "cube.obj", "..", "/", "a colour", "an image"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)
SHARE = st.floats(0, 1) | ANYTHING


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    surface=st.fixed_dictionaries(
        {},
        optional={
            "base_color": st.lists(SHARE, min_size=2, max_size=4) | ANYTHING,
            "roughness": SHARE,
            "metallic": SHARE,
            "specular": SHARE,
            "emission": st.lists(SHARE, min_size=3, max_size=3) | ANYTHING,
            "a colour": ANYTHING,
        },
    )
    | ANYTHING,
    place=st.sampled_from(["objects.0.surface", "occluders.0.surface"]),
)
def test_any_surface_gives_a_job_or_an_input_error(job, surface, place):
    cv2.imwrite(str(job.folder / "paint.png"), np.full((2, 3, 3), 99, np.uint8))
    job.write(changed(job.copy(), place, surface))
    try:
        assert isinstance(load_job(job.folder), Job)
    except InputError as error:
        assert "\n" not in str(error) and error.do
