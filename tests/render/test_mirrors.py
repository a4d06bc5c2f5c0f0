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
from btfsep_engine.conventions import fibonacci_sphere, pixel_directions
from btfsep_engine.imaging.images import write_exr
from btfsep_engine.job.model import Occluder
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.light.sun import Sun
from btfsep_engine.pipeline import like_pixels, mirrors
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.materials import ObjectMaterial
from btfsep_engine.pipeline.problem import make_problem
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from btfsep_engine.render.homogeneous import homogeneous
from scripts.studies.ground import above
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


def on_a_table():
    """A job of a mirror ball above a matte table, its brightest pixels clipped; all of the light is on the table."""
    job, surface = mirrored(roughness=0.0).job, Surface((0.5,) * 3, roughness=1.0, specular=0.0)
    plate = as_mesh(trimesh.creation.box([6, 6, 0.02]).apply_translation([0, 0, -0.71]), flat=True)
    job = replace(job, occluders=(Occluder(plate, surface),))
    scene, image = scene_of(job), job.photo.radiance.copy()
    sky, suns = fibonacci_sphere(3000), lamps()
    rows, columns = np.nonzero(scene.view.mesh == 1)
    origins, rays = job.camera.rays(columns + 0.5, rows + 0.5)
    at, up = origins + scene.view.distance[rows, columns, None] * rays, np.tile([0, 0, 1.0], (len(rows), 1))
    to_lamps = np.array([lamp.direction for lamp in suns])
    falls = scene.tracer.visible(at, up, sky) * np.maximum(up @ sky.T, 0)
    straight = scene.tracer.visible(at, up, to_lamps) * np.maximum(up @ to_lamps.T, 0)
    received = falls @ sh.series(positive_light(2), sky) * (4 * np.pi / len(sky))
    received = received + straight @ np.array([lamp.irradiance for lamp in suns])
    image[rows, columns] = 0.5 * received / np.pi
    most = np.quantile(image[scene.view.mesh == 0], 0.985)
    over = image >= np.where((scene.view.mesh == 0)[..., None], most, np.inf)
    photo = replace(job.photo, radiance=np.where(over, most, image).astype(np.float32), clipped=over)
    return replace(job, photo=replace(photo, usable=~over.any(-1)))


def test_a_table_shows_how_bright_clipped_lamps_are():
    """Three of a width that the mirror shows, each with a shadow of its own."""
    library, off = open_library(None), {}
    for evidence in ("auto", "never"):
        found = estimate(scene_of(on_a_table()), library, choose("balanced", evidence=evidence))
        off[evidence] = errors(above(found.fit.all_coefficients[:100]), above(truth()))
        (told,) = (each.lamps for each in found.scene.mirror_lights)
        assert told.by_table == (evidence == "auto")
        assert told.by_table == ("the table beside it shows" in found.choice["mirrors"])
        assert told.by_table != any("lamps are clipped" in said for said in found.scene.reporter.warnings)
    assert off["auto"]["direction"] < 0.6 * off["never"]["direction"]
    assert off["auto"]["order2"] < 0.9 * off["never"]["order2"]


def test_each_lamp_is_as_bright_as_its_shadow_is_deep():
    (ball,), job = softened(scene_of(on_a_table()))[0].mirrors, on_a_table()
    fine = mirrors.picture([ball], job.photo)[1][0].radiance
    directions, power = fibonacci_sphere(mirrors.FINE), []
    for lamp in lamps():
        near = directions @ lamp.direction > np.cos(np.radians(3 * WIDE))
        power.append(fine[near].sum(0) * 4 * np.pi / mirrors.FINE)
    np.testing.assert_allclose(power, 3.0, rtol=0.4)  # white, in the picture of a golden ball


def test_a_table_is_read_in_each_photo():
    """In another exposure it says the same of the same lamps."""
    (ball,), photo = softened(scene_of(job := on_a_table()))[0].mirrors, job.photo
    brighter = replace(photo, radiance=np.float32(3) * photo.radiance)
    once, again = (mirrors.picture([ball], each)[1][0].lamps for each in (photo, brighter))
    assert once.by_table and again.by_table
    np.testing.assert_allclose(again.times, once.times, rtol=1e-3)
    darker = replace(photo, radiance=np.where(photo.clipped, 1, np.float32(0.2)) * photo.radiance)
    assert mirrors.picture([ball], darker)[1][0].lamps.times.sum() != pytest.approx(once.times.sum(), rel=0.1)


def test_patches_of_what_is_clipped_are_in_doubt_one_by_one():
    seen, _ = softened(cut(mirrored(roughness=0.0)))
    (open_to,) = seen.mirror_lights
    assert len(open_to.clipped) == len(open_to.lamps.patches) >= 3
    still = replace(open_to, right=0 * open_to.right, down=0 * open_to.down)
    samples = still.spread(400, np.random.default_rng(0))[:, :9].reshape(400, -1)
    sizes = np.linalg.svd(samples - samples.mean(0), compute_uv=False)
    assert sizes[2] > 0.05 * sizes[0]  # one factor for all would leave one direction


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
