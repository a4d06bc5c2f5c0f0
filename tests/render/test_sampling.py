# SPDX-License-Identifier: GPL-3.0-or-later
"""The choice of pixels, and the number of directions."""

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.model import Lambertian
from btfsep_engine.errors import InputError
from btfsep_engine.job.model import TriangleMesh
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.light.maps import natural_amplitude
from btfsep_engine.pipeline.basis import USUAL, basis_images
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.render import sampling
from btfsep_engine.render.surface import camera_view
from tests.render.scenes import as_mesh, ball, bowl, job_of, looking_down, scene_of

GREY = Lambertian("test/grey", np.full(3, 0.5))


def prepared(*meshes):
    scene = scene_of(job_of(meshes, looking_down()))
    return scene, scene.points(0, textured=False)


def test_the_number_of_directions_is_the_usual_or_as_asked():
    scene, points = prepared(bowl())
    points = [points.take(sampling.spread(points, 200))]
    usual = basis_images(scene, [GREY], points, SHBasis(9), choose())[1]
    assert usual == {"by": "kernel", "directions": USUAL, "bounces": 8}
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
