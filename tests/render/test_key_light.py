# SPDX-License-Identifier: GPL-3.0-or-later
"""A key light in the estimate: found where there is one, not where the light is broad; what is written and rendered.

The photo's beam is closed form (a matte ball under a plate, its shadow included); the rest of its light the kernel's.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine import images, sh
from btfsep_engine.btf.model import Lambertian, Mirror
from btfsep_engine.cli import main
from btfsep_engine.fit.compare import relative_l2
from btfsep_engine.job.model import Photo
from btfsep_engine.light.files import read_lighting
from btfsep_engine.light.lightings import SHLighting, cap_factors
from btfsep_engine.light.sun import Sun, cap_around
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.key_light import Responses, key_light
from btfsep_engine.pipeline.problem import pose
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.together import fit_together
from btfsep_engine.progress import Reporter
from btfsep_engine.render.beams import beam_radiance
from tests.render.prepared import ball, bowl
from tests.render.scenes import as_mesh, job_of, looking_down, positive_light

GREY = Lambertian("test/grey", np.full(3, 0.3))
SILVER = Mirror("test/silver", np.ones(3))
FROM = np.array([0.5, 0.2, 0.84]) / np.linalg.norm([0.5, 0.2, 0.84])
LOW, HIGH = np.array([0.3, -0.4, 1.2]), np.array([0.9, 0.5, 1.25])  # a plate's corners
SETTINGS = choose("draft", pixels=1000, key_light="auto", bounces=1, directions=512)


def plate():
    shape = trimesh.creation.box(HIGH - LOW)
    return as_mesh(shape.apply_translation((LOW + HIGH) / 2), flat=True)


def lit_by_the_sun(positions, normals, direction):
    """Radiance per unit irradiance of the grey ball under the plate: closed form; 0 in shadow."""
    with np.errstate(divide="ignore"):
        near, far = ((corner - positions) / direction for corner in (LOW, HIGH))
    enter, leave = np.minimum(near, far).max(1), np.maximum(near, far).min(1)
    shadow = (enter < leave) & (leave > 0)
    return 0.3 / np.pi * np.maximum(normals @ direction, 0) * ~shadow


def photographed(*, share=0.0, half_degrees=0.0, light=None, noise=0.02, count=1000, direction=FROM):
    """A problem whose photo holds a beam (or a disc) of ``share`` of the light; the truth; the beam."""
    direction = direction / np.linalg.norm(direction)
    scene = PreparedScene(job_of([ball()], looking_down(), occluders=[plate()]), Reporter())
    points = scene.points(0, textured=False)
    rest = positive_light(3) if light is None else light
    irradiance = np.sqrt(4 * np.pi) * rest[0].mean() * share / (1 - share)
    sky = scene.radiance(points, GREY, SHLighting(rest), directions=2048)[:, 0]
    disc = cap_around(direction, np.radians(half_degrees), 200) if half_degrees else direction[None]
    beam = np.mean([lit_by_the_sun(points.position, points.normal, d) for d in disc], 0) * irradiance
    values = (sky + beam[:, None]) * np.random.default_rng(0).normal(1, noise, sky.shape)
    image = np.zeros((96, 96, 3), np.float32)
    image[points.pixels[:, 0], points.pixels[:, 1]] = values
    scene.job = replace(scene.job, photo=Photo(image, np.ones(image.shape[:2], bool), 0))
    truth = np.zeros((100, 3))
    truth[: len(rest)] = rest
    truth += sh.evaluate(9, direction)[:, None] * irradiance
    chosen = points.take(np.random.default_rng(1).permutation(len(points))[:count])
    return pose(scene, [GREY], [chosen], SETTINGS), truth, irradiance


def looked_for(problem, settings=SETTINGS):
    fit, solver, exposures = fit_together([problem], settings)
    return fit, *key_light([problem], [[GREY]], fit, solver, exposures, settings)


def order_2(fit, truth) -> float:
    return relative_l2(fit.all_coefficients[:9], truth[:9])["relative_l2_free_scale"]


def test_beams_are_the_closed_form_with_its_shadow():
    problem, _, _ = photographed()
    points = problem.points[0]
    directions = np.stack([FROM, [0.0, 0.0, 1.0], [0.6, 0.0, -0.8]])
    found = beam_radiance(problem.scene.tracer, points, GREY, directions, millimetres_per_unit=50.0)
    assert found.shape == (len(points), 3, 3)
    shadowed = 0
    for j, direction in enumerate(directions):
        truth = lit_by_the_sun(points.position, points.normal, direction)
        facing = points.flat_normal @ direction > 0.02  # elsewhere the mesh's facets decide
        right = np.abs(found[facing, j, 0] - truth[facing]) < 1e-5
        assert right.mean() > 0.995  # the shadow's edge is the facets'
        shadowed += int((truth[facing] == 0).sum())
    assert shadowed > 50
    assert not beam_radiance(problem.scene.tracer, points, SILVER, directions, millimetres_per_unit=50.0).any()


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_a_sun_is_found_and_the_whole_light_is_better_for_it(share):
    problem, truth, irradiance = photographed(share=share)
    plain, key, why = looked_for(problem)
    assert key is not None and why.startswith("a key light is split off")
    assert key.sun.direction @ FROM > np.cos(np.radians(2))
    assert np.abs(key.sun.irradiance / irradiance - 1).max() < 0.1
    assert (np.abs(key.sun.irradiance - irradiance) < 2 * key.sun.stddev).all()
    assert key.sun.size_degrees < 12
    assert order_2(key.fit, truth) < 0.5 * order_2(plain, truth) and order_2(key.fit, truth) < 0.04
    off = key.fit.free_coefficients - key.fit.coefficients  # both are of all of the light, the sun with the series
    assert np.linalg.norm(off) < 0.2 * np.linalg.norm(key.fit.coefficients)
    # the parts are the whole, and explain the photo
    shape = sh.evaluate(9, key.sun.direction) * np.repeat(
        cap_factors(9, 2 * np.pi * (1 - np.cos(np.radians(key.sun.size_degrees) / 2))), 2 * np.arange(10) + 1
    )
    assert np.allclose(key.sky + shape[:, None] * key.sun.irradiance, key.fit.all_coefficients, atol=1e-9)
    left = problem.radiance() - problem.predicted(key.sky) - key.images[0]
    assert np.linalg.norm(left) / np.linalg.norm(problem.radiance()) == pytest.approx(key.fit.residual, rel=0.02)
    assert key.fit.residual < 0.6 * plain.residual


def test_a_direction_that_reaches_no_point_answers_nothing_though_there_is_light_between_surfaces():
    """Its part of the series' indirect light is of either sign: a beam as strong as it likes would fit anything."""
    scene = PreparedScene(job_of([bowl()], looking_down()), Reporter())
    points = scene.points(0, textured=False)
    light = SHLighting(positive_light(3))
    image = np.zeros((96, 96, 3), np.float32)
    image[points.pixels[:, 0], points.pixels[:, 1]] = scene.radiance(points, GREY, light, directions=2048)[:, 0]
    scene.job = replace(scene.job, photo=Photo(image, np.ones(image.shape[:2], bool), 0))
    problem = pose(scene, [GREY], [points.take(slice(None, None, 7))], replace(SETTINGS, bounces=3))
    answers = Responses([problem], [[GREY]])
    directions = np.stack([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, -0.8]])
    assert answers.parts[0][3] is not None  # what surfaces send each other is in the basis
    k = answers(directions)
    assert k[:, 0].min() >= 0 and k[:, 0].max() > 0.05 and not k[:, 1:].any()


def test_what_hardly_reaches_the_pixels_is_no_key_light():
    """From behind the ball the sun lights a rim of it."""
    behind = np.array([0.95, 0.0, -0.45])
    problem, _, _ = photographed(share=0.5, noise=0.004, count=4000, direction=behind)
    seen = lit_by_the_sun(problem.points[0].position, problem.points[0].normal, behind / np.linalg.norm(behind))
    assert 0.01 < (seen > 0).mean() < 0.2
    _, key, why = looked_for(problem)
    assert key is None and "next to nothing of what the photo shows" in why


def broad(half_degrees, share=0.6):
    """Coefficients to order 9 of even light and a disc of ``share`` of it, ``2 half_degrees`` wide, from `FROM`."""
    factors = cap_factors(9, 2 * np.pi * (1 - np.cos(np.radians(half_degrees))))
    x = (sh.evaluate(9, FROM) * np.repeat(factors, 2 * np.arange(10) + 1))[:, None] * np.ones(3) * share
    x[0] += (1 - share) / np.sqrt(4 * np.pi)
    return x


@pytest.mark.parametrize("light", [positive_light(3), positive_light(3, seed=5), broad(40), broad(60)])
def test_in_soft_light_there_is_none(light):
    problem, _, _ = photographed(light=light)
    _, key, why = looked_for(problem)
    assert key is None and why.startswith("no ")


def test_a_broad_lamp_with_soft_shadows_is_none_and_a_small_one_is():
    _, key, why = looked_for(photographed(share=0.75, half_degrees=13, noise=0.004, count=2000)[0])
    assert key is None and why.startswith("no key light: the brightest part of the light is taken to be about")
    _, key, _ = looked_for(photographed(share=0.5, half_degrees=4)[0])
    assert key.sun.direction @ FROM > np.cos(np.radians(2)) and 4 < key.sun.size_degrees <= 10


def test_a_weak_lamp_is_no_key_light():
    _, key, why = looked_for(photographed(share=0.1)[0])
    assert key is None and why.startswith("no key light: the strongest single direction has about 1")


def test_it_is_not_looked_for_where_it_cannot_be_or_was_not_asked_for():
    problem, _, _ = photographed(share=0.5, count=300)
    for settings, words in (
        (replace(SETTINGS, key_light="never"), "--key-light never"),
        (replace(SETTINGS, estimator="least-squares", order=2), "--estimator map"),
    ):
        _, key, why = looked_for(problem, settings)
        assert key is None and why.startswith("a key light was not looked for: ") and words in why


def test_the_estimate_has_it_with_several_photos_and_the_light_between_surfaces():
    """Two exposures of one scene; both photos' residuals are those of the whole light."""
    problem, truth, _ = photographed(share=0.5)
    scene = problem.scene
    brighter = PreparedScene(scene.job, Reporter())
    photo = scene.job.photo
    brighter.job = replace(scene.job, photo=replace(photo, radiance=2 * photo.radiance))

    class Library:
        def load(self, name):
            return GREY

    settings = replace(SETTINGS, bounces=3, order=4)
    found = estimate(scene, Library(), settings, material="grey", others=[brighter])
    assert found.choice["key_light"].startswith("a key light is split off")
    assert found.lighting.suns[0].direction @ FROM > np.cos(np.radians(2))
    assert [p.exposure for p in found.photos] == pytest.approx([1.0, 2.0], rel=0.01)
    assert all(p.residuals[0] < 0.1 for p in found.photos)
    x = found.lighting.coefficients
    assert relative_l2(x[:9], truth[:9])["relative_l2_free_scale"] < 0.06
    never = estimate(scene, Library(), replace(settings, key_light="never"), material="grey", others=[brighter])
    assert not never.lighting.suns and never.choice["key_light"].startswith("a key light was not looked for")
    assert never.photos[0].residuals[0] > 1.3 * found.photos[0].residuals[0]


def test_a_mirror_shows_a_sun_as_a_series_does():
    problem, _, _ = photographed()
    points, sun = problem.points[0], Sun(FROM, np.full(3, 2.0), np.zeros(3))
    seen = problem.scene.sun_radiance(points, SILVER, sun)
    truth = problem.scene.radiance(points, SILVER, SHLighting(sun.coefficients(9)), directions=128)[:, 0]
    assert seen.max() > 1 and np.allclose(seen, truth)


def test_the_commands_write_and_render_it(tmp_path, capsys):
    """estimate writes the sun beside all of the light; relight draws its shadow where the photo has it."""
    problem, _, _ = photographed(share=0.6, noise=0.01)
    folder = written(problem.scene.job, tmp_path / "job")
    white = ["--material", "reference/white-diffuse"]
    assert main(["estimate", str(folder), *white, "--json"]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])["result"]
    assert result["choice"]["key_light"].startswith("a key light is split off: ")
    assert result["settings"]["key_light"] == "auto" and result["seconds"]["key light"] > 0
    light = read_lighting(result["lighting"])
    (sun,) = light.suns
    assert light.order == 4 and sun.direction @ FROM > np.cos(np.radians(2))
    assert abs(sun.share - 0.6) < 0.08
    assert np.abs(light.sky + sun.coefficients(4) - light.coefficients).max() < 1e-9
    sky = images.read_linear(folder / "result" / "lighting.exr").pixels
    assert np.abs(sh.project_map(sky, 4) - light.coefficients).max() < 0.02 * light.coefficients[0].max()
    assert sky.max() > 20 * np.median(sky)

    def relit(lighting):
        out = tmp_path / "relit.exr"
        assert main(["relight", str(folder), *white, "--lighting", str(lighting), "--out", str(out)]) == 0
        photo = problem.scene.job.photo.radiance
        seen = photo.any(2)
        again, photo = images.read_linear(out).pixels[seen], photo[seen]
        return np.linalg.norm(again - photo) / np.linalg.norm(photo)

    whole = json.loads((folder / "result" / "lighting.json").read_text())
    del whole["sun"], whole["suns"]  # as who knows of no sun reads it
    (tmp_path / "whole.json").write_text(json.dumps(whole))
    assert relit(result["lighting"]) < 0.06 and relit(tmp_path / "whole.json") > 0.1

    assert main(["estimate", str(folder), *white, "--key-light", "never", "--no-report"]) == 0
    assert read_lighting(folder / "result" / "lighting.json").suns == ()
    assert main(["estimate", str(folder), *white, "--key-light", "always"]) == 2
    assert "--key-light" in capsys.readouterr().err


def written(job, folder):
    """The job in memory as a folder."""
    folder.mkdir()
    for name, mesh in (("ball", job.objects[0].mesh), ("plate", job.occluders[0])):
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(folder / f"{name}.ply")
    images.write_exr(folder / "photo.exr", job.photo.radiance)
    c = job.camera
    camera = {k: getattr(c, k) for k in ("width", "height", "fx", "fy", "cx", "cy")}
    (folder / "job.json").write_text(
        json.dumps(
            {
                "format": "btfsep-job",
                "version": 1,
                "image": "photo.exr",
                "camera": {**camera, "to_world": np.asarray(c.to_world).tolist()},
                "objects": [{"name": "ball", "mesh": "ball.ply"}],
                "occluders": [{"mesh": "plate.ply"}],
                "metres_per_unit": job.metres_per_unit,
            }
        )
    )
    return folder


def test_a_photo_that_is_poorly_explained_with_a_sun_too_shows_none():
    """The sun is there, but so is noise as large as the photo: nothing of this fit is to be believed."""
    _, key, _ = looked_for(photographed(share=0.7, noise=0.4, count=4000)[0])
    assert key is not None
    problem, _, _ = photographed(share=0.7, noise=0.9, count=4000)
    _, key, why = looked_for(problem)
    assert key is None and "explains the photo poorly" in why
