# SPDX-License-Identifier: GPL-3.0-or-later
"""The choice of pixels and of the number of directions."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.model import Lambertian, Mirror
from btfsep_engine.errors import InputError
from btfsep_engine.job.model import Photo, TriangleMesh
from btfsep_engine.light.lightings import SHBasis, SHLighting
from btfsep_engine.light.natural import natural_amplitude
from btfsep_engine.pipeline.basis import basis_images
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from btfsep_engine.render import sampling
from btfsep_engine.render.quadrature import FEWEST, MOST, USUAL, enough_directions
from btfsep_engine.render.surface import camera_view
from tests.render.btf_materials import glossy
from tests.render.prepared import ball, bowl
from tests.render.scenes import as_mesh, job_of, looking_down, positive_light

GREY = Lambertian("test/grey", np.full(3, 0.5))


def prepared(*meshes):
    scene = PreparedScene(job_of(meshes, looking_down()), Reporter())
    return scene, scene.points(0, textured=False)


def enough(scene, points, material, tolerance):
    return enough_directions(
        lambda p, n: scene.transport(p, directions=n), points, material, order=9, tolerance=tolerance
    )


def error_against_many(scene, points, material, directions, order=9):
    natural = natural_amplitude(order)[:, None]
    lights = SHBasis(order)
    right = scene.transport(points, directions=16384).radiance(material, lights) * natural
    found = scene.transport(points, directions=directions).radiance(material, lights) * natural
    return np.linalg.norm(found - right) / np.linalg.norm(right)


@pytest.mark.parametrize(("make", "tolerance"), [(ball, 0.05), (ball, 0.01), (bowl, 0.1), (bowl, 0.04)])
def test_as_many_directions_as_the_error_asks_for_and_no_more(make, tolerance):
    scene, points = prepared(make())
    points = points.take(sampling.spread(points, 500))
    count, stated = enough(scene, points, GREY, tolerance)
    true = error_against_many(scene, points, GREY, count)
    assert stated < tolerance and true < 1.3 * tolerance and 0.5 < stated / true < 2
    if count > FEWEST:
        assert error_against_many(scene, points, GREY, count // 2) > 0.7 * tolerance


def test_gloss_and_shadows_get_more_directions_and_a_mirror_none():
    scene, points = prepared(ball())
    matte, shiny = (enough(scene, points, m, 0.02)[0] for m in (GREY, glossy()))
    inside, bowl_points = prepared(bowl())
    shadowed = enough(inside, bowl_points, GREY, 0.02)[0]
    assert matte < shiny and matte < shadowed
    assert enough(scene, points, Mirror("test/mirror", np.ones(3)), 0.02) == (FEWEST, 0.0)
    count, error = enough(inside, bowl_points, GREY, 1e-6)
    assert count == MOST and error > 1e-6


def test_the_number_of_directions_is_chosen_recorded_or_as_asked():
    scene, points = prepared(bowl())
    points = [points.take(sampling.spread(points, 200))]
    loose, strict = (basis_images(scene, [GREY], points, SHBasis(9), choose(tolerance=t))[1] for t in (0.1, 0.03))
    assert loose["directions"] < strict["directions"] and loose["direction_error"] < 0.1
    usual = basis_images(scene, [GREY], points, SHBasis(9), choose())[1]
    assert usual["directions"] == USUAL and "direction_error" not in usual
    _, asked = basis_images(scene, [GREY], points, SHBasis(9), choose(directions=100))
    assert asked == {"by": "kernel", "directions": 100, "bounces": 8}
    for wrong in (8, "many"):
        with pytest.raises(InputError, match="--directions"):
            choose(directions=wrong)


@pytest.mark.parametrize("count", [1, 2, 50, 999, 5000])
def test_as_many_pixels_as_asked_for_and_none_twice(count):
    _, points = prepared(ball())
    chosen = sampling.choose_pixels(points, count)
    assert len(chosen) == count == len(np.unique(chosen)) and (np.diff(chosen) > 0).all()
    assert np.array_equal(chosen, sampling.choose_pixels(points, count))
    assert count == 1 or not np.array_equal(chosen, sampling.choose_pixels(points, count, seed=1))
    assert np.array_equal(sampling.choose_pixels(points, len(points)), np.arange(len(points)))


def test_without_leverage_every_part_of_the_surface_gets_its_share():
    _, points = prepared(ball())
    feature = np.concatenate([points.position, points.normal], 1)
    chosen = sampling.choose_pixels(points, 400, leverage_share=0)
    random = np.random.default_rng(0)
    off = {"chosen": [], "random": []}
    for normal in random.normal(size=(40, 6)):
        inside = feature @ normal > np.median(feature @ normal)
        off["chosen"].append(inside[chosen].mean() - 0.5)
        off["random"].append(inside[random.permutation(len(points))[:400]].mean() - 0.5)
    assert np.std(off["chosen"]) < 0.5 * np.std(off["random"])


def table_with_ball():
    table = trimesh.creation.box([2.2, 2.2, 0.1]).apply_translation([0, 0, -0.6])
    small = trimesh.creation.icosphere(4, radius=0.12).apply_translation([0.3, 0.2, -0.5])
    one, other = as_mesh(table, flat=True), as_mesh(small)
    return TriangleMesh(
        np.concatenate([one.vertices, other.vertices]),
        np.concatenate([one.faces, other.faces + len(one.vertices)]),
        np.concatenate([one.corner_normals, other.corner_normals]),
    )


def test_rare_normals_are_worth_more_than_their_area():
    """A small ball on a table: the light that the table cannot tell is seen on the ball alone."""
    scene, points = prepared(table_with_ball())
    basis = scene.radiance(points, GREY, SHBasis(4), directions=256)[..., 0].astype(np.float64)
    basis *= natural_amplitude(4)

    def determined(chosen):
        rows = basis[chosen] / (0.1 * basis[:, 0].mean())
        return np.linalg.slogdet(np.eye(25) + rows.T @ rows)[1]

    even, informed = (sampling.choose_pixels(points, 200, leverage_share=s) for s in (0, 0.5))
    on_ball = points.position[:, 2] > -0.54
    assert on_ball[informed].mean() > 4 * max(on_ball[even].mean(), on_ball.mean())
    assert determined(informed) > determined(even) + 3


def test_leverage_is_that_of_the_cheap_basis():
    _, points = prepared(ball())
    found = sampling.leverage(points.normal, points.to_eye)
    rows = sampling.cheap_basis(points.normal, points.to_eye) * natural_amplitude(sampling.LEVERAGE_ORDER)
    rows *= np.sqrt(sampling.EVIDENCE) / sampling.MISFIT / np.sqrt((rows[:, 0] ** 2).mean())
    covariance = np.linalg.inv(rows.T @ rows / len(rows) + np.eye(rows.shape[1]))
    exact = np.einsum("pi,ij,pj->p", rows, covariance, rows)
    assert found.mean() == pytest.approx(1) and (found > 0).all()
    exact /= exact.mean()
    assert np.abs(found - exact).mean() < 0.05 and (np.abs(np.log(found / exact)) < 0.4).all()
    assert exact.max() > 2 * exact.min()  # the cells do not pass for being all alike


def test_the_cheap_basis_is_unshadowed_diffuse_transport(monkeypatch):
    scene, points = prepared(ball())
    monkeypatch.setattr(sampling, "LOBE_SHARE", 0.0)
    cheap = sampling.cheap_basis(points.normal, points.to_eye)
    traced = scene.radiance(points, GREY, SHBasis(sampling.LEVERAGE_ORDER), directions=4096)[..., 0]
    scale = traced[:, 0].mean() / cheap[:, 0].mean()
    assert np.abs(cheap * scale - traced).max() < 0.02 * np.abs(traced).max()


def test_chances_follow_the_weights_and_heavy_items_are_sure():
    weight = np.array([100.0, 1, 1, 1, 1, 2, 2, 2])
    chance = sampling.capped_chances(weight, 4)
    assert chance.sum() == pytest.approx(4) and chance.max() <= 1 + 1e-9 and chance[0] == pytest.approx(1)
    assert chance[5] / chance[1] == pytest.approx(2)
    counts = np.zeros(8)
    for seed in range(400):
        counts[sampling.systematic(np.arange(8), weight, 4, seed=seed)] += 1
    assert counts[0] == 400 and counts / 400 == pytest.approx(chance, abs=0.12)


def test_no_chosen_pixel_touches_the_outline():
    scene, points = prepared(ball())
    chosen = points.take(sampling.choose_pixels(points, 300)).pixels
    seen = camera_view(scene.tracer, scene.job).mesh == 0
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            assert seen[chosen[:, 0] + dy, chosen[:, 1] + dx].all()


@pytest.mark.parametrize(("noise", "finer"), [(0.0, True), (0.2, False)])
def test_a_clean_photo_gets_more_directions_than_a_poor_one(noise, finer):
    scene, points = prepared(bowl())
    image = np.zeros((96, 96, 3), np.float32)
    values = scene.radiance(points, GREY, SHLighting(positive_light(2)), directions=4096)[:, 0]
    values = values * np.random.default_rng(0).normal(1, noise, values.shape)
    image[points.pixels[:, 0], points.pixels[:, 1]] = values
    scene.job = replace(scene.job, photo=Photo(image, np.ones(image.shape[:2], bool), 0))
    settings = choose("draft", pixels=500, bounces=1)

    class Library:
        def load(self, name):
            return GREY

    used = estimate(scene, Library(), settings, material="grey").transport["directions"]
    assert used > USUAL if finer else used == USUAL
