# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures of scans less the light in them, which Mitsuba made."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine import sh
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.job.model import JobObject, TriangleMesh
from btfsep_engine.pipeline.delighting import ORDER, _irradiance, de_lit, light_in_texture, words_of
from btfsep_engine.pipeline.materials import of_surface
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.render.texels import texels_on
from tests.render.scanned import enlarged, in_islands, irradiance, paint, ring
from tests.render.scenes import as_mesh, job_of, looking_down

SETTINGS = choose()


def thing(image, mesh=None, name="ring", **numbers) -> JobObject:
    made_of = Surface(image=image, **({"roughness": 1.0, "specular": 0.0} | numbers))
    return JobObject(name, mesh or ring(), uv="mesh", surface=made_of)


def baked(side=128, *, seed=0):
    """Paint, and the same with light in it, (side, side, 3)."""
    clean = paint(side, seed=seed)
    return clean, np.clip(clean * enlarged(irradiance(), side), 0, 1).astype(np.float32)


def off(image, clean) -> float:
    """Median of how far the logarithm of a texture is off, with one free scale."""
    ratio = np.log(np.maximum(image, 1e-4) / clean)
    return float(np.median(np.abs(ratio - np.median(ratio))))


@pytest.mark.parametrize(("side", "seed"), [(64, 0), (100, 1), (128, 2), (512, 3)])
def test_a_scan_is_near_its_paint_when_the_light_is_taken_off(side, seed):
    clean, scan = baked(side, seed=seed)
    before, obj = scan.copy(), thing(scan)
    found = de_lit(obj, SETTINGS)
    assert found == replace(obj.surface, image=found.image) and obj.surface.image is scan
    image = found.image
    assert image.shape == scan.shape and image.dtype == np.float32
    assert np.isfinite(image).all() and image.min() >= 0 and image.max() <= 1
    assert off(image, clean) < 0.1 * off(scan, clean) and off(scan, clean) > 0.3
    assert np.median(np.log(image / scan)) == pytest.approx(0, abs=0.02)  # the light is 1 in the median
    np.testing.assert_array_equal(scan, before)
    light = light_in_texture(obj, SETTINGS)
    true = np.log(enlarged(irradiance(), len(light.laid)))[light.laid]
    apart = light.logarithm[light.laid] - true
    assert apart.std(0).max() < 0.1 and np.ptp(apart.mean(0)) < 0.03
    assert light.light.contrast == pytest.approx((true @ [0.2126, 0.7152, 0.0722]).std(), rel=0.15)


@pytest.mark.parametrize("side", [64, 128, 512])
def test_a_clean_texture_comes_back_as_it_is(side):
    obj = thing(paint(side, seed=4))
    assert de_lit(obj, SETTINGS) is obj.surface and light_in_texture(obj, SETTINGS) is None
    one = thing(np.full((side, side, 3), 0.5, np.float32))
    assert de_lit(one, SETTINGS) is one.surface


def test_what_is_not_asked_for_or_has_no_paint_is_left_alone():
    _, scan = baked()
    assert light_in_texture(thing(scan, metallic=0.4), SETTINGS) is not None
    for obj, settings in (
        (thing(scan), choose(delight="never")),
        (thing(scan, metallic=1.0), SETTINGS),
        (thing(scan, metallic=0.6), SETTINGS),
        (replace(thing(scan), surface=Surface((0.4, 0.3, 0.2))), SETTINGS),
        (thing(baked(16)[1]), SETTINGS),  # fewer texels than tell anything
        (thing(scan, replace(ring(), corner_uv=2 * ring().corner_uv)), SETTINGS),
        (thing(np.zeros_like(scan)), SETTINGS),
        (thing(np.ones_like(scan)), SETTINGS),
    ):
        assert light_in_texture(obj, settings) is None and de_lit(obj, settings) is obj.surface
    assert light_in_texture(JobObject("named", ring(), material="surface/matte"), SETTINGS) is None


@pytest.mark.parametrize("normals", [1, -1], ids=["normals out", "normals in"])
def test_a_mesh_wound_inwards_has_the_same_light(normals):
    _, scan = baked()
    outwards, inwards = ring(), ring(inward=True)
    inwards = replace(inwards, corner_normals=normals * inwards.corner_normals)
    one, other = (light_in_texture(thing(scan, mesh), SETTINGS) for mesh in (outwards, inwards))
    np.testing.assert_array_equal(other.laid, one.laid)
    assert np.abs(other.logarithm - one.logarithm).max() < 0.05 and np.ptp(one.logarithm) > 1


@pytest.mark.parametrize(("times", "away"), [(1.0, 1e4), (1e-3, 0.0), (1e3, 0.0)])
def test_where_a_mesh_lies_and_how_large_it_is_does_not_matter(times, away):
    _, scan = baked()
    moved = replace(ring(), vertices=times * ring().vertices + away)
    one, other = (light_in_texture(thing(scan, mesh), SETTINGS).logarithm for mesh in (ring(), moved))
    assert np.median(np.abs(other - one)) < 0.01


def nested(*radii) -> TriangleMesh:
    """Closed shells within each other, all faces outwards, each with as much of the image."""
    ball, parts = trimesh.creation.uv_sphere(count=[24, 48]), []
    turn = np.arctan2(ball.vertices[:, 1], ball.vertices[:, 0]) / (2 * np.pi) % 1
    uv = np.stack([turn, np.arccos(np.clip(ball.vertices[:, 2], -1, 1)) / np.pi], 1)[ball.faces]
    uv[..., 0] += (np.ptp(uv[..., 0], axis=1, keepdims=True) > 0.5) & (uv[..., 0] < 0.5)  # over the seam
    for number, radius in enumerate(radii):
        parts.append((radius * ball.vertices, (uv * [0.98, 1] + [number, 0]) / [len(radii), 1]))
    faces = np.concatenate([ball.faces + i * len(ball.vertices) for i in range(len(radii))]).astype(np.int32)
    normals = np.concatenate([ball.vertices[ball.faces]] * len(radii)).astype(np.float32)
    vertices, corners = (np.concatenate(each) for each in zip(*parts, strict=True))
    return TriangleMesh(vertices, faces, normals, np.clip(corners, 0, 1).astype(np.float32))


def test_walls_within_walls_of_which_most_see_no_sky():
    mesh = nested(1.0, 0.8, 0.6)
    assert len(texels_on(mesh, 64).number) > 3700
    obj = thing(paint(64), mesh)
    assert de_lit(obj, SETTINGS) is obj.surface


def test_beside_a_chart_the_light_goes_on_and_texels_there_say_nothing_of_the_mean():
    mesh, (clean, scan) = ring(), baked()
    small = replace(mesh, corner_uv=(0.125 + 0.75 * mesh.corner_uv).astype(np.float32))
    place, at = (slice(16, 112),) * 2, np.arange(96) * 128 // 96
    wide, true = (np.full((128, 128, 3), 0.2, np.float32) for _ in range(2))
    wide[place], true[place] = scan[np.ix_(at, at)], clean[np.ix_(at, at)]
    image = de_lit(thing(wide, small), SETTINGS).image
    assert off(image[place], true[place]) < 0.1 * off(wide[place], true[place])
    assert np.median(np.log(image[place] / wide[place])) == pytest.approx(0, abs=0.02)
    assert np.isfinite(image).all() and image.min() >= 0 and image.max() <= 1
    factor = np.log(image / wide)
    assert np.abs(factor[16:112, 10] - factor[16:112, 16]).max() < 0.1
    assert np.abs(factor[118, 16:112] - factor[111, 16:112]).max() < 0.1
    assert np.ptp(factor[16:112, 10]) > 0.5


def test_where_something_would_be_brighter_than_white_all_is_darker():
    clean, _ = baked()
    bright = np.clip(1.9 * clean * enlarged(irradiance(), 128), 0, 1).astype(np.float32)
    image = de_lit(thing(bright), SETTINGS).image
    assert image.max() == 1 and (image == 1).mean() < 0.005
    assert np.median(np.log(image / bright)) < -0.04


def test_the_light_at_a_ball_is_that_of_the_closed_form():
    places = fibonacci_sphere(200)
    images, closed = _irradiance(as_mesh(trimesh.creation.icosphere(4)), places, places, places)
    true = sh.cosine_lobe(ORDER)[sh.degrees(ORDER)] * sh.evaluate(ORDER, places)
    assert np.abs(images - true).max() < 0.03 and closed.max() < 0.03


def test_a_map_of_many_islands_with_black_between_them():
    """Texels at their rims are darker where the image is made smaller: that is no light, nor does it hide any."""
    clean, scan = baked(384)
    mesh, cut, laid = in_islands(scan)
    _, true, _ = in_islands(clean)
    assert off(de_lit(thing(cut, mesh), SETTINGS).image[laid], true[laid]) < 0.1 * off(cut[laid], true[laid])
    assert light_in_texture(thing(true, mesh), SETTINGS) is None


def test_light_goes_on_over_seams():
    _, scan = baked()
    factor = np.log(de_lit(thing(scan), SETTINGS).image / np.maximum(scan, 1e-6))
    for first, last, inside in (
        (factor[0], factor[-1], np.abs(np.diff(factor, axis=0)).max()),
        (factor[:, 0], factor[:, -1], np.abs(np.diff(factor, axis=1)).max()),
    ):
        assert np.abs(first - last).max() < max(inside, 0.1)


def test_each_texture_and_each_mesh_has_its_own_light():
    clean, scan = baked()
    upside_down = np.ascontiguousarray(scan[::-1])
    first = light_in_texture(thing(scan), SETTINGS)
    assert light_in_texture(thing(clean), SETTINGS) is None
    assert light_in_texture(thing(scan), SETTINGS) is first
    other = light_in_texture(thing(upside_down), SETTINGS)
    assert other is None or np.abs(other.logarithm - first.logarithm).max() > 0.1
    flat = replace(ring(), vertices=ring().vertices * [1, 1, 0.2])
    moved = light_in_texture(thing(scan, flat), SETTINGS)
    assert moved is None or moved is not first


def test_the_words_name_what_has_light_and_how_much():
    clean, scan = baked()
    named = JobObject("named", ring(), material="surface/matte")
    things = [thing(clean, name="paint"), thing(scan, name="scan"), named]
    words = words_of(things, SETTINGS)
    percent = round(100 * light_in_texture(things[1], SETTINGS).light.contrast)
    assert f"object 'scan' ({percent} %) has light in it" in words and "--delight never" in words
    assert "paint" not in words and "named" not in words and 30 < percent < 60
    assert words_of(things, choose(delight="never")) == words_of(things[:1], SETTINGS) == ""
    both = words_of([things[1], replace(things[1], name="other")], SETTINGS)
    assert "'scan'" in both and "and object 'other'" in both


def test_the_material_of_a_scan_is_made_of_its_paint():
    job, (clean, scan) = job_of([ring()], looking_down()), baked()
    told = choose(delight="never")
    made, raw, true = (
        of_surface(thing(image), job, settings) for image, settings in ((scan, SETTINGS), (scan, told), (clean, told))
    )
    errors = [off(each.texels[..., :3], true.texels[..., :3]) for each in (made, raw)]
    assert errors[0] < 0.1 * errors[1]
    mean = of_surface(thing(scan), job, choose(appearance="mean"))
    np.testing.assert_allclose(mean.diffuse_albedo(), made.diffuse_albedo(), rtol=0.02)
    flat = Surface((0.4, 0.3, 0.2))
    assert of_surface(replace(thing(scan), surface=flat), job, SETTINGS).surface == flat
