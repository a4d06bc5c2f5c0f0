# SPDX-License-Identifier: GPL-3.0-or-later
"""From a file to the one model in memory: the cosine, reciprocity, recompression, harmonics, energy."""

import numpy as np
import pytest

from btfsep_engine.btf import linear, reciprocity
from btfsep_engine.btf.directions import (
    hemisphere_quadrature,
    interpolator,
    light_projection,
    ubo2003_directions,
    ubo2014_directions,
)
from btfsep_engine.btf.formats.ubo2014 import open_btf
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.btf.recompress import recompress
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.progress import Reporter
from btfsep_engine.sh import evaluate
from btfsep_engine.storage import cache
from tests.engine import btf_files

pytestmark = pytest.mark.usefixtures("own_cache")

DIRECTIONS = ubo2014_directions()[::3]


def angles(d):
    return np.stack([np.arccos(d[:, 2]), np.arctan2(d[:, 1], d[:, 0])], 1)


def glossy(views, lights, exponent=12):
    """(views, lights): a reciprocal BRDF, diffuse and a lobe about the half vector."""
    half = views[:, None] + lights[None]
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    return 0.2 / np.pi + 0.3 * half[..., 2] ** exponent


def log_material(rng, side=24, k=6):
    """Log-domain factors of a textured glossy material: (pairs, 3, K), (texels, K) and the values they mean."""
    base = np.log(glossy(DIRECTIONS, DIRECTIONS) * DIRECTIONS[:, 2]).reshape(-1)
    angular = rng.normal(0, 0.15, (len(base), 3, k))
    angular[:, :, 0] = base[:, None] + np.array([0.2, 0, -0.3])
    spatial = rng.normal(0, 0.7, (side * side, k))
    spatial[:, 0] = 1
    return angular.astype("<f2").astype(np.float32), spatial.astype("<f2").astype(np.float32)


def write_log(path, angular, spatial, side=24, **common):
    common = {"views": angles(DIRECTIONS), "lights": angles(DIRECTIONS), "width": side, "height": side} | common
    path.write_bytes(btf_files.fmf(angular.reshape(-1, angular.shape[-1]), spatial, reduced=1, **common))


def test_recompression_is_near_the_best_factorisation_there_is(rng):
    """Against the exact SVD of the same columns, each divided by its mean, at the same number of components."""
    angular, spatial = log_material(rng)
    m = np.exp(np.einsum("tk,nck->tnc", spatial, angular))
    error = {}
    for k in (2, 6, 20):
        got = recompress(lambda t, p: m[t][:, p], *m.shape[:2], components=k)
        found = np.einsum("tk,nck->tnc", got.spatial, got.angular)
        weight = 1 / (m.mean(0) + 0.5 * m.mean())
        scaled = (m * weight).reshape(len(m), -1)
        values = np.linalg.svd(scaled, compute_uv=False)
        best = np.sqrt((values[k:] ** 2).sum() / (values**2).sum())
        error[k] = np.linalg.norm((found - m) * weight) / np.linalg.norm(scaled)
        assert error[k] < 1.1 * best + 1e-4
        assert abs(got.relative_error / error[k] - 1) < 0.25
        np.testing.assert_allclose((got.spatial**2).mean(0), 1, rtol=1e-4)
        cut = np.einsum("tk,nck->tnc", got.spatial[:, :2], got.angular[..., :2])
        assert np.linalg.norm((cut - m) * weight) / np.linalg.norm(scaled) < 1.15 * max(error[2], error[k])
        assert np.abs(found.mean(0) / m.mean(0) - 1).mean() < 0.05 * 2 / k + 0.003
    assert error[20] < 0.5 * error[6] < 0.3 * error[2]


def test_a_log_domain_file_read_as_a_material(tmp_path, rng):
    angular, spatial = log_material(rng)
    write_log(tmp_path / "leather05_a.btf", angular, spatial)
    told = []
    reporter = Reporter()
    reporter.progress = lambda stage, fraction, message="": told.append((stage, fraction))
    material = linear.read(tmp_path / "leather05_a.btf", components=14, reporter=reporter)
    assert told[-1] == ("decode", 1.0) and material.texels.shape == (24, 24, 14)
    found = np.einsum("tk,vlck->tvlc", material.texels.reshape(-1, 14)[::50], material.angular)
    truth = np.exp(np.einsum("tk,nck->tnc", spatial[::50], angular)) - 1e-5
    truth = truth.reshape(found.shape) / DIRECTIONS[:, 2, None]  # the header says that the cosine is in
    assert np.median(np.abs(found / truth - 1)) < 0.06
    assert material.material_class == "leather"
    (entry,) = (tmp_path / "cache" / "materials").iterdir()
    kept = cache.read(entry)
    for name, wrong in (("spatial", kept["spatial"][:, :3]), ("angular", kept["angular"] * np.nan)):
        cache.write(entry, kept | {name: wrong})  # whole, and of no use
        again = linear.read(tmp_path / "leather05_a.btf", components=14)
        np.testing.assert_array_equal(again.texels, material.texels)
        np.testing.assert_array_equal(again.angular, material.angular)


@pytest.mark.parametrize("included", [True, False])
@pytest.mark.parametrize("header", [0, 1])
def test_reciprocity_tells_whether_the_cosine_is_in(tmp_path, rng, included, header):
    angular, spatial = log_material(rng)
    if not included:
        angular[:, :, 0] -= np.log(np.tile(DIRECTIONS[:, 2], len(DIRECTIONS)))[:, None]
    write_log(tmp_path / "a.btf", angular, spatial, cosine=header)
    file = open_btf(tmp_path / "a.btf")
    found = linear.check_reciprocity(file)
    assert found.verdict == ("included" if included else "excluded")
    reporter = Reporter()
    assert linear.cosine_included(file, "auto", reporter=reporter) == included
    assert bool(reporter.warnings) == (bool(header) != included)
    assert linear.cosine_included(file, "header") == bool(header)
    assert linear.cosine_included(file, "included") and not linear.cosine_included(file, "excluded")


def test_reciprocity_of_lists_that_differ_and_of_what_is_neither():
    views, lights = ubo2014_directions(), ubo2003_directions()
    inside = [d[d[:, 2] > 0.4] for d in (views, lights)]
    assert reciprocity.reciprocity_error(glossy(*inside), *inside) < 0.02
    assert reciprocity.reciprocity_error(glossy(*inside) * inside[1][:, 2], *inside) > 0.1
    between = glossy(views, views) * np.sqrt(views[:, 2])  # half a cosine: neither
    assert reciprocity.check(between[..., None] * np.ones(3), views, views).verdict == "unclear"


def light_coefficients(material, order):
    """(views, 3, k, terms): the integrals of angular(view, omega) cos(theta) Y_j(omega)."""
    return np.einsum("vlck,lj->vckj", material.angular, light_projection(material.lights, lambda d: evaluate(order, d)))


def test_light_projection_against_quadrature_over_a_lit_hemisphere(rng):
    views, lights = ubo2003_directions()[:7], ubo2014_directions()
    angular = rng.uniform(0.1, 1, (7, 151, 3, 4)).astype(np.float32)
    texels = rng.normal(0, 1, (5, 6, 4)).astype(np.float32)
    material = Tabulated("a/b", "a", texels, angular, views, lights, 1.0)
    coefficients = light_coefficients(material, 3)
    assert coefficients.shape == (7, 3, 4, 16)
    light = rng.normal(0, 1, (16, 3))
    found = np.einsum("vckj,k,jc->vc", coefficients, texels[2, 3], light)
    # brute force: many spread directions, the material looked up at each, the light evaluated there
    d = fibonacci_sphere(40000)
    d = d[d[:, 2] > 0]
    centre = np.broadcast_to((np.array([3, 2]) + 0.5) * 1.0, (len(d), 2))
    for v in (0, 5):
        values = material.abrdf(centre, d, np.broadcast_to(views[v], d.shape))
        shaded = (values * (evaluate(3, d) @ light) * d[:, 2:]).sum(0) * 2 * np.pi / len(d)
        np.testing.assert_allclose(found[v], shaded, rtol=2e-3, atol=2e-3)


def test_a_lambertian_table_conserves_energy_exactly_with_the_band():
    for d in (ubo2014_directions(), ubo2003_directions()):
        table = np.full((len(d), len(d), 3, 1), 0.7 / np.pi, np.float32)
        material = Tabulated("a/b", "a", np.ones((1, 1, 1), np.float32), table, d, d, 1.0)
        np.testing.assert_allclose(material.directional_albedo(), 0.7, rtol=1e-6)
        up = light_coefficients(material, 2)[:, 0, 0]
        nodes, weights = hemisphere_quadrature()
        exact = 0.7 / np.pi * (evaluate(2, nodes) * (weights * nodes[:, 2])[:, None]).sum(0)
        np.testing.assert_allclose(up, np.broadcast_to(exact, up.shape), atol=1e-6)


def oren_nayar(views, lights, sigma=0.5):
    """(views, lights): the qualitative model of Oren and Nayar, 1994, albedo 0.5."""
    a, b = 1 - 0.5 * sigma**2 / (sigma**2 + 0.33), 0.45 * sigma**2 / (sigma**2 + 0.09)
    s = views[:, :2] @ lights[:, :2].T
    t = np.where(s > 0, np.maximum(views[:, None, 2], lights[None, :, 2]), 1)
    return 0.5 / np.pi * (a + b * np.maximum(s, 0) / t)


@pytest.mark.parametrize("function", [glossy, lambda v, l: glossy(v, l, 40), oren_nayar])
@pytest.mark.parametrize("d", [ubo2014_directions(), ubo2003_directions()])
def test_the_band_to_the_horizon_keeps_the_energy_within_one_percent(function, d):
    """The albedo of a table that ends at 75 degrees against the integral of the function itself over all of it."""
    nodes, weights = hemisphere_quadrature()
    weights = weights * nodes[:, 2]
    exact = function(d, nodes) @ weights
    table = np.repeat(function(d, d)[:, :, None, None], 3, 2).astype(np.float32)
    found = Tabulated("a/b", "a", np.ones((1, 1, 1), np.float32), table, d, d, 1.0).directional_albedo()[:, 0]
    np.testing.assert_allclose(found, exact, rtol=0.01)
    without = function(d, nodes) @ np.where(nodes[:, 2] > np.cos(np.radians(75)), weights, 0)
    assert (without < 0.975 * exact).all()  # that much hangs on the rule


def test_values_between_and_beyond_the_directions_stay_within_the_table(rng):
    d = ubo2014_directions()
    values = rng.uniform(0.2, 0.9, (151, 151, 3, 1)).astype(np.float32)
    material = Tabulated("a/b", "a", np.ones((1, 1, 1), np.float32), values, d, d, 1.0)
    sphere = fibonacci_sphere(4000)
    sphere = sphere[sphere[:, 2] > 1e-3]
    found = material.abrdf(np.zeros_like(sphere[:, :2]), sphere, np.roll(sphere, 7, 0))
    assert found.min() >= 0.2 - 1e-6 and found.max() <= 0.9 + 1e-6
    at_nodes = material.abrdf(np.zeros((151, 2)), d, d[::-1])
    assert interpolator(d).weights(d)[1].max(1).min() > 0.95
    assert np.abs(at_nodes - values[np.arange(150, -1, -1), np.arange(151), :, 0]).max() < 0.1


def test_texels_are_periodic_and_bilinear():
    texels = np.arange(6, dtype=np.float32).reshape(2, 3, 1)
    d = ubo2003_directions()
    material = Tabulated("a/b", "a", texels, np.ones((81, 81, 3, 1), np.float32), d, d, 2.0)
    up = np.array([[0.0, 0, 1]])
    look = lambda x, y: material.abrdf([[x, y]], up, up)[0, 0]  # noqa: E731
    assert look(1, 1) == 0 and look(5, 3) == 5 and look(7, 5) == 0  # centres; the patch is 6 x 4 mm
    assert np.isclose(look(2, 1), 0.5) and np.isclose(look(1, 2), 1.5) and np.isclose(look(0, 1), 1.0)
