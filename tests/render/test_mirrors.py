# SPDX-License-Identifier: GPL-3.0-or-later
"""A mirror's picture is the light: estimates from it, and what stands in its place."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine import sh
from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import GIVEN, Surface
from btfsep_engine.commands.sequence import Frames
from btfsep_engine.conventions import pixel_directions
from btfsep_engine.imaging.images import write_exr
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.light.sun import Sun
from btfsep_engine.pipeline import like_pixels, mirrors
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.materials import ObjectMaterial
from btfsep_engine.pipeline.problem import make_problem
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from btfsep_engine.render.homogeneous import homogeneous
from scripts.studies.measures import errors
from tests.render.scenes import as_mesh, job_of, looking_down, picture, positive_light, scene_of, with_photo

CHROME = open_library(None).load("reference/chrome").mirror_reflectance
TINT = np.array([0.9, 0.7, 0.5])
LAMPS, WIDE = ([0.3, -0.5, 0.8], [-0.9, 0.1, 0.4], [0.2, 0.9, 0.3]), 5.0  # to them; degrees
EDGE = np.cos(np.radians(WIDE / 2))


def lamps() -> list:
    return [Sun(np.array(d) / np.linalg.norm(d), np.full(3, 3.0), np.zeros(3), size_degrees=WIDE) for d in LAMPS]


def light(directions) -> np.ndarray:
    """(n, 3), a smooth sky with three lamps of five degrees."""
    out = sh.series(positive_light(2), directions)
    for lamp in lamps():
        out = out + (directions @ lamp.direction > EDGE)[:, None] * lamp.irradiance / (2 * np.pi * (1 - EDGE))
    return out


def truth() -> np.ndarray:
    sky = np.zeros((100, 3))
    sky[:9] = positive_light(2)
    return sky + sum(lamp.coefficients(9) for lamp in lamps())


def given(scene) -> list:
    """Its objects' materials, by their surfaces."""
    return [ObjectMaterial(GIVEN, homogeneous(o.surface, GIVEN), True) for o in scene.job.objects]


def softened(scene):
    return mirrors.softened(scene, given(scene), choose("balanced"))


def mirrored(tint=TINT, **surface):
    """A mirror ball's scene, its photo in closed form: averages over pixels, of their corners' directions."""
    mesh = as_mesh(trimesh.creation.icosphere(subdivisions=5, radius=0.6))
    job = job_of([mesh], looking_down())
    job = replace(job, objects=(replace(job.objects[0], surface=Surface(tuple(tint), metallic=1.0, **surface)),))
    scene = scene_of(job)
    points = scene.points(0, textured=False)
    total, rays = 0.0, job.camera.rays
    for down, right in np.stack(np.meshgrid(np.arange(8), np.arange(8)), -1).reshape(-1, 2) / 8 + 1 / 16:
        origin, ray = rays(points.pixels[:, 1] + right, points.pixels[:, 0] + down)
        middle = -(origin * ray).sum(1)
        reach = middle - np.sqrt(np.maximum(0.36 - ((origin + middle[:, None] * ray) ** 2).sum(1), 0))
        normal = (origin + reach[:, None] * ray) / 0.6
        cosine = np.clip(-(normal * ray).sum(1, keepdims=True), 0, 1)
        share = tint + (1 - tint) * (1 - cosine) ** 5
        total = total + share * light(ray + 2 * cosine * normal)
    return scene_of(with_photo(job, picture(points, total / 64)))


def test_a_mirror_ball_shows_the_light_with_its_lamps(monkeypatch):
    scene = mirrored(roughness=0.0)
    found = estimate(scene, open_library(None), choose("balanced"))
    off = errors(found.lighting.coefficients, truth())
    assert off["order2"] < 0.1 and off["direction"] < 4
    assert "mirrors" in found.choice and "put together" in found.choice["near"]
    monkeypatch.setattr(mirrors, "SHARP", -1.0)  # nothing counts as a mirror
    plain = estimate(scene, open_library(None), choose("balanced"))
    assert errors(plain.lighting.coefficients, truth())["order2"] > 2 * off["order2"]


def test_the_librarys_chrome_mirrors_as_one_by_numbers_does():
    """Named for all objects, or recognised beyond doubt; where it may be something else it stays as it is."""
    scene, library, settings = mirrored(tint=CHROME, roughness=0.0), open_library(None), choose("balanced")
    named = estimate(scene, library, settings, material="reference/chrome")
    off = errors(named.lighting.coefficients, truth())
    assert off["order2"] < 0.1 and off["direction"] < 4 and "mirrors" in named.choice
    (said,) = named.materials
    assert (said.record["material"], said.record["class"]) == ("reference/chrome", "reference")
    sure = ObjectMaterial("reference/chrome", library.load("reference/chrome"), False, likely=("reference/chrome",))
    seen, (metal,) = mirrors.softened(scene, [sure], settings)
    assert seen.mirrors and metal.material.mirror_reflectance is None
    assert mirrors.mirror_surface(seen.job.objects[0], metal) is metal.mirror  # of a further photo of it
    unsure = replace(sure, likely=("reference/chrome", "leather-brown-grain"))
    kept, materials = mirrors.softened(scene, [unsure], settings)
    assert kept is scene and materials == [unsure]


def test_every_frame_of_a_mirror_is_a_picture_of_the_light(tmp_path):
    scene, library, settings = mirrored(tint=CHROME, roughness=0.0), open_library(None), choose("balanced")
    frames = Frames(scene.job, library, settings, material="reference/chrome", poses={}, reporter=Reporter())
    for name, times in (("1.exr", 1.0), ("2.exr", 3.0)):
        write_exr(tmp_path / name, times * scene.job.photo.radiance)
        found, _ = frames.estimate(tmp_path / name)
        light = found.lighting.coefficients[:9] / times
        assert found.scene.mirrors and np.linalg.norm(light - truth()[:9]) < 0.1 * np.linalg.norm(truth()[:9])


def test_what_stands_in_its_place_is_a_rougher_metals_picture():
    scene, (ball,) = softened(mirrored(roughness=0.05))
    assert (ball.name, ball.mirror.roughness) == (GIVEN, 0.05)
    points = scene.points(0, textured=False)
    metal = homogeneous(mirrors.rougher(ball.mirror), GIVEN)
    assert np.allclose(ball.material.table.angular, metal.table.angular)
    shown = scene.sun_radiance(points, metal, *lamps())
    sky = mirrors.CellLights(sh.series(positive_light(2), mirrors.fibonacci_sphere(mirrors.CELLS))[:, None])
    shown = shown + scene.transport(points, directions=mirrors.CELLS).radiance(metal, sky)[:, 0]
    values = scene.job.photo.radiance[tuple(points.pixels.T)]
    assert np.median(np.abs(values / shown - 1)) < 0.1
    dull = mirrored(roughness=0.4)
    assert mirrors.softened(dull, known := given(dull), choose("balanced")) == (dull, known)


def test_what_stands_in_its_place_has_no_texture_to_average(monkeypatch):
    """Each of its pixels is a mean of the mirror's picture by itself, whatever lamps that shows."""
    settings = choose("draft", bounces=1, order=2)
    plain = mirrored(roughness=0.05)
    seen, (ball,) = softened(plain)
    problem = make_problem(seen, [ball.material], [seen.points(0, textured=False)], settings)
    monkeypatch.setattr(like_pixels, "TEXTURED", 0.0)
    assert like_pixels.as_seen_on_the_whole(problem, settings) is problem
    assert like_pixels.as_seen_on_the_whole(replace(problem, scene=plain), settings).around is not None


def test_the_map_shows_what_the_mirror_shows():
    """Far finer than a series: the lamps of five degrees are there, and as bright as they are."""
    found = estimate(mirrored(roughness=0.0), open_library(None), choose("balanced", key_light="never"))
    directions = pixel_directions(*found.map.shape[:2])
    shown = directions @ np.array([0.0, 0.0, -1.0]) < 0.8  # what lies behind the ball, it hides
    true, smooth = light(directions.reshape(-1, 3)).reshape(found.map.shape), found.fit.election.radiance(directions)
    off, plain = (np.median(np.abs(image - true)[shown]) for image in (found.map, smooth))
    assert off < 0.2 * plain
    for lamp in lamps():
        near = directions @ lamp.direction > np.cos(np.radians(2 * WIDE))
        area = np.gradient(-np.cos(np.linspace(0, np.pi, len(near))))[:, None] * (2 * np.pi / near.shape[1])
        power = [(image.mean(-1) * area)[near].sum() for image in (found.map, true)]
        assert power[0] == pytest.approx(power[1], rel=0.3)


def cut(scene, share=0.02):
    """The scene with the brightest of its pixels clipped."""
    photo = scene.job.photo
    most = np.quantile(photo.radiance[scene.regions[0]], 1 - share)
    clipped = photo.radiance >= most
    photo = replace(photo, radiance=np.minimum(photo.radiance, most), clipped=clipped, usable=~clipped.any(-1))
    scene.job = replace(scene.job, photo=photo)
    return scene


def test_how_bright_clipped_lamps_are_is_guessed_and_stated():
    """The truth is inside what is stated, and much is: the whole picture tells no more."""
    library, settings = open_library(None), choose("balanced")
    whole = estimate(mirrored(roughness=0.0), library, settings)
    found = estimate(cut(mirrored(roughness=0.0)), library, settings)
    assert any("lamps are clipped" in said for said in found.scene.reporter.warnings)
    assert not any("lamps are clipped" in said for said in whole.scene.reporter.warnings)
    (low, high), true = found.lighting.interval[:, :9], truth()[:9]
    assert ((low <= true) & (true <= high)).mean() > 0.9
    assert found.lighting.stddev[:9].mean() > 5 * whole.lighting.stddev[:9].mean()
    assert found.scene.job.photo.clipped is None  # of a sum nothing is a bound


def test_clipped_lamps_are_bounds_beside_an_object_that_tells_more():
    scene = cut(mirrored(roughness=0.0))
    (ball,) = mirrors.softened(scene, given(scene), choose("balanced"))[0].mirrors
    bounds = mirrors.picture([replace(ball, alone=False)], scene.job.photo)[0].clipped
    region = scene.regions[0]
    assert 0.02 < bounds[region].mean() and not bounds[~region].any()


def test_a_mesh_that_may_be_a_pixel_off_is_in_what_is_stated():
    """Of the light that the same mirror would show where it stands a pixel farther to either side."""
    scene = mirrored(roughness=0.0)
    seen, _ = softened(scene)
    (ball,), (open_to,) = seen.mirrors, seen.mirror_lights

    def aside(columns):
        moved = np.roll(scene.job.photo.radiance, columns, axis=1)
        return ball.coefficients(ball.light(moved[tuple(ball.pixels.T)].astype(np.float64)))

    np.testing.assert_allclose(open_to.right, (aside(-1) - aside(1)) / 2, atol=1e-9)
    assert not open_to.clipped.any()
    answer = estimate(scene, open_library(None), choose("balanced"))
    assert (answer.lighting.stddev[:9] > 0.8 * np.abs(open_to.right[:9])).all()


def test_what_a_table_sends_is_in_neither():
    """Light by way of another surface is left out of the picture, and so of its basis images."""
    scene, (metal,) = softened(mirrored(roughness=0.0))
    points = scene.points(0, textured=False)
    indirect = scene.indirect([metal.material], SHBasis(2), choose("balanced"), bounces=8)
    assert not scene.received(0, points, metal.material, indirect).any()
    plain = mirrored(roughness=0.0)
    assert plain.received(0, points, metal.material, indirect).shape == (len(points), 9, 3)


@pytest.mark.parametrize("surface", [{"roughness": 0.4}, {"roughness": 0.0, "coat": 0.0, "image": np.ones((2, 2, 3))}])
def test_what_is_no_mirror_stays(surface):
    assert not mirrors.mirror_like(Surface(metallic=1.0, **surface))
    assert not mirrors.mirror_like(Surface(roughness=0.0)) and not mirrors.mirror_like(None)
