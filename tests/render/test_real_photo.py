# SPDX-License-Identifier: GPL-3.0-or-later
"""Clipped photos and recognised objects of another dye, through the pipeline, against the light they were made of."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.model import Lambertian
from btfsep_engine.cli import main
from btfsep_engine.imaging import images
from btfsep_engine.light.files import read_lighting
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.checks import all_doubts
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.estimation import light_of as light_of_model
from btfsep_engine.pipeline.materials import ObjectMaterial
from btfsep_engine.pipeline.model import first_model, solve_model
from btfsep_engine.pipeline.real_photo import PHOTOS_OWN
from btfsep_engine.pipeline.settings import choose
from tests.render.scenes import as_mesh, job_of, looking_down, off_as_seen, positive_light, scene_of, with_photo

GREY = Lambertian("test/grey", np.full(3, 0.5))
SETTINGS = choose("draft", refine="all", bounces=1, directions=128, appearance="mean", order=2)
DYE = np.array([1.5, 1.0, 0.7])


def scene_of_balls(places, *, dyes=None, limit=None):
    """Grey balls, photographed under `positive_light` with 2 % noise, clipped at a quantile of their brightness."""
    balls = [as_mesh(trimesh.creation.icosphere(subdivisions=4, radius=0.45)) for _ in places]
    balls = [replace(m, vertices=m.vertices + place) for m, place in zip(balls, places, strict=True)]
    scene = scene_of(job_of(balls, looking_down()))
    image = np.zeros((96, 96, 3), np.float32)
    rng = np.random.default_rng(3)
    for i in range(len(places)):
        points = scene.points(i, textured=False)
        values = scene.radiance(points, GREY, SHLighting(positive_light(2)), directions=512)[:, 0]
        dye = 1 if dyes is None else dyes[i]
        image[points.pixels[:, 0], points.pixels[:, 1]] = values * dye * rng.normal(1, 0.02, values.shape)
    clipped = np.zeros(image.shape, bool)
    if limit is not None:
        top = np.quantile(image[image[..., 1] > 0].max(1), limit)
        clipped = image >= top
        image = np.minimum(image, top)
    whole = ~clipped.any(-1)
    scene.job = with_photo(scene.job, image, whole, clipped=clipped)
    return scene


def light_of(scene, materials, settings=SETTINGS):
    """The fit, the problem, and the choice."""
    model, light, choice = solve_model(first_model([scene], [materials], settings))
    return light.fit, model.problems[0], choice


def off(fit) -> float:
    """Relative error of what the camera sees lit, no free scale."""
    return off_as_seen(fit.coefficients, positive_light(2))


def test_a_clipped_photo_gives_the_light_of_the_whole_one_as_nearly_as_can_be():
    given = [ObjectMaterial("test/grey", GREY, True)]
    scene = scene_of_balls([(0, 0, 0)], limit=0.5)
    fit, problem, choice = light_of(scene, given)
    assert choice["scale"] == PHOTOS_OWN
    assert any("at least as bright" in text for text in scene.reporter.warnings)
    blind = replace(scene.job.photo, clipped=None)
    scene.job = replace(scene.job, photo=blind)
    without, fewer, _ = light_of(scene, given)
    assert any("left out" in text for text in scene.reporter.warnings)
    assert len(problem.pixels) > len(fewer.pixels)
    assert len(problem.pixels) == len(problem.radiance()) == len(problem.all_basis)
    scene.job = replace(scene.job, photo=replace(blind, usable=np.ones_like(blind.usable)))
    as_if_measured, _, _ = light_of(scene, given)
    assert off(fit) < off(without) and off(fit) < off(as_if_measured)
    assert problem.radiance().max() > blind.radiance.max()


@pytest.mark.parametrize("clipped_first", [True, False])
def test_what_one_photo_clips_and_another_shows_is_not_hidden(clipped_first):
    scenes = [scene_of_balls([(0, 0, 0)], limit=limit) for limit in (0.5, None)]
    if not clipped_first:
        scenes.reverse()

    class Library:
        def load(self, name):
            return GREY

    given = [[ObjectMaterial("test/grey", GREY, True)]] * 2
    model, light, _ = solve_model(first_model(scenes, given, SETTINGS))
    assert sorted(p.clipped.mean() > 0.1 for p in model.problems) == [False, True]
    found = estimate(scenes[0], Library(), SETTINGS, material="test/grey", others=scenes[1:])
    assert off(found.fit) < 0.12 and light.exposures[1] == pytest.approx(1, rel=0.02)


def test_each_frame_of_a_sequence_is_clipped_as_it_is_itself(sphere_job_folder, capsys):
    """A frame's light lights what is seen as the one that it gets alone does, whatever the frames before it."""
    folder, _ = sphere_job_folder
    frames = folder / "frames"
    frames.mkdir()
    image = images.read_linear(folder / "photo.exr").pixels
    images.write_png(frames / "1.png", 0.3 * image / image.max())
    images.write_png(frames / "2.png", image / np.quantile(image[20:76, 20:76], 0.6))

    def lights(pattern):
        out = folder / f"of {pattern.replace('*', 'all')}"
        command = ["sequence", str(folder), "--images", str(frames / pattern), "--material", "reference/white-diffuse"]
        assert main([*command, "--order", "2", "--pixels", "600", "--directions", "64", "--out", str(out)]) == 0
        capsys.readouterr()
        return {path.name: read_lighting(path) for path in out.glob("[12].json")}

    alone, together = {**lights("1.png"), **lights("2.png")}, lights("*.png")
    assert set(together) == set(alone) == {"1.json", "2.json"}
    for name, light in together.items():
        assert off_as_seen(light.coefficients, alone[name].coefficients) < 0.05


def test_a_recognised_object_of_another_dye_does_not_colour_the_light():
    scene = scene_of_balls([(-0.5, 0, 0), (0.5, 0, 0)], dyes=[1, DYE])
    known, guessed = (ObjectMaterial("test/grey", GREY, given) for given in (True, False))
    free, problem, choice = light_of(scene, [known, guessed])
    held, other, words = light_of(scene, [known, known])
    np.testing.assert_allclose(problem.scales, [np.ones(3), DYE], rtol=0.05)
    assert "held by 'object 0'" in choice["scale"] and "'object 1' reflects 1." in choice["scale"]
    assert other.scales is None and words["scale"] == PHOTOS_OWN
    assert off(free) < 0.06 < off(held)


def test_least_squares_leaves_clipped_pixels_out():
    scene = scene_of_balls([(0, 0, 0)], limit=0.8)
    settings = choose("paper", directions=128, order=2, bounces=1)
    _, problem, _ = light_of(scene, [ObjectMaterial("test/grey", GREY, True)], settings)
    rows, columns = problem.pixels.T
    assert scene.job.photo.usable[rows, columns].all() and problem.measured is None


def test_things_in_front_are_left_out_where_that_is_asked_for():
    """A bright patch over a part of a ball; without it nearly nothing is left out, and nothing changes."""
    scene = scene_of_balls([(0, 0, 0)])
    known = [ObjectMaterial(GREY.name, GREY, True)]
    robust = replace(SETTINGS, robust=True)
    plain, _, _ = light_of(scene, known)
    same, problem, choice = light_of(scene, known, robust)
    assert problem.left_out < 0.02 * len(problem.points[0]) and "pixels" in choice["robust"]
    assert abs(off(same) - off(plain)) < 0.01
    image = scene.job.photo.radiance.copy()
    image[40:52, 38:50] = 6 * image.max()
    scene.job = replace(scene.job, photo=replace(scene.job.photo, radiance=image))
    fooled, _, choice = light_of(scene, known)
    warned = scene_of(scene.job)
    answer = light_of_model(first_model([warned], [known], SETTINGS), None)
    assert "pixels" in answer.choice["robust"] and off(answer.fit) < off(fooled) / 4  # nobody asked
    assert any("show something else" in doubt for doubt in all_doubts(answer))
    found, problem, _ = light_of(scene, known, robust)
    assert "robust" not in choice
    assert off(found) < 0.02 + off(plain) < off(fooled) / 5
    rows, columns = problem.points[0].pixels.T
    assert not ((rows >= 40) & (rows < 52) & (columns >= 38) & (columns < 50)).any()
