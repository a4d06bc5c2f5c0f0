# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials near a material: published formulas by angles, their limits, reciprocity and energy."""

import numpy as np
import pytest

from btfsep_engine.btf import departures as d
from btfsep_engine.btf.departures import EACH, departures, gloss_lobe, oren_nayar
from btfsep_engine.btf.directions import ubo2014_directions
from btfsep_engine.btf.model import Lambertian, Mirror, Tabulated

GREY = Lambertian("test/grey", np.array([0.8, 0.5, 0.3]))


def angles():
    """Inclination and azimuth of the library's directions, and which are not grazing."""
    w = ubo2014_directions()
    return np.arccos(np.clip(w[:, 2], -1, 1)), np.arctan2(w[:, 1], w[:, 0])


@pytest.mark.parametrize("sigma", [0.2, 0.3, 0.6])
def test_oren_and_nayar_as_published(sigma):
    """L / (rho / pi cos) = A + B max(0, cos(phi_i - phi_r)) sin alpha tan beta (1994, equation 30)."""
    theta, phi = angles()
    a, b = 1 - 0.5 * sigma**2 / (sigma**2 + 0.33), 0.45 * sigma**2 / (sigma**2 + 0.09)
    found = oren_nayar(sigma)
    for v in range(0, len(theta), 7):
        for l in range(0, len(theta), 5):
            alpha, beta = max(theta[v], theta[l]), min(theta[v], theta[l])
            published = a + b * max(0.0, np.cos(phi[v] - phi[l])) * np.sin(alpha) * np.tan(beta)
            assert found[v, l] == pytest.approx(published, rel=1e-6, abs=1e-6)


def test_a_surface_without_slopes_is_lamberts():
    np.testing.assert_allclose(oren_nayar(0.0), 1)
    np.testing.assert_allclose(oren_nayar(1e-4), 1, atol=1e-5)


def test_the_gloss_is_smiths_microfacets():
    """D of tan^2, masking by Smith's lambdas, Schlick's Fresnel: the textbook's forms (Walter et al. 2007)."""
    w, alpha = ubo2014_directions(), d.GLOSS**2
    found = gloss_lobe()[..., 0]
    for v, l in ((0, 0), (5, 40), (30, 100), (80, 20), (120, 121)):
        o, i = w[v], w[l]
        h = (o + i) / np.linalg.norm(o + i)
        tan2 = (1 - h[2] ** 2) / h[2] ** 2
        distribution = 1 / (np.pi * alpha**2 * h[2] ** 4 * (1 + tan2 / alpha**2) ** 2)
        smith = [(np.sqrt(1 + alpha**2 * (1 - k[2] ** 2) / k[2] ** 2) - 1) / 2 for k in (o, i)]
        fresnel = 0.04 + 0.96 * (1 - o @ h) ** 5
        textbook = distribution * fresnel / (1 + sum(smith)) / (4 * o[2] * i[2])
        assert found[v, l] == pytest.approx(textbook, rel=1e-6)


def energies(values):
    """Hemispherical reflectance for each view of a table (views, lights, …): each light stands for what is nearest."""
    random = np.random.default_rng(0)
    fine = random.normal(size=(100_000, 3))
    fine /= np.linalg.norm(fine, axis=1, keepdims=True)
    fine[:, 2] = np.abs(fine[:, 2])
    nearest = (fine @ ubo2014_directions().T).argmax(1)
    weight = np.bincount(nearest, fine[:, 2], minlength=values.shape[1]) * (2 * np.pi / len(fine))
    return np.tensordot(values, weight, (1, 0))


def test_tables_are_reciprocal_and_reflect_no_more_than_they_get():
    near = departures(GREY)
    steep = ubo2014_directions()[:, 2] > 0.3  # a table holds what is grazing in few directions
    for each in near:
        values = each.material.angular[..., 0]
        np.testing.assert_allclose(values, np.swapaxes(values, 0, 1), rtol=1e-5)
        assert (values >= 0).all() and energies(values)[steep].max() < 1
    assert energies(oren_nayar(0.3) / np.pi)[steep].max() <= 1.02
    assert 0.01 < energies(gloss_lobe())[steep].mean() < 0.1


def test_what_is_tried_beside_a_material():
    near = departures(GREY)
    assert [e.log_prior for e in near] == [0, 0]  # nothing is as Lambert has it
    assert [e.further for e in near] == [False, True]  # of two roughnesses the larger
    lambert = np.broadcast_to(GREY.albedo / np.pi, (151, 151, 3))
    for each, sigma in zip(near, (0.2, 0.3), strict=True):
        rough = lambert * oren_nayar(sigma)[..., None] + gloss_lobe()
        np.testing.assert_allclose(each.material.angular[..., 0], rough, rtol=1e-5)
    assert departures(Mirror("test/mirror", np.ones(3))) == []


def test_a_table_may_be_duller_and_keeps_its_albedo():
    lobe = np.asarray(gloss_lobe() * 5 + GREY.albedo / np.pi, np.float32)[..., None]
    w = ubo2014_directions()
    table = Tabulated("test/shiny", "plastic", np.ones((1, 1, 1), np.float32), lobe, w, w, 1.0)
    less, more = departures(table)
    assert (less.description, more.description) == ("less gloss", "a little more gloss")
    assert less.log_prior == more.log_prior == EACH < 0
    steep = w[:, 2] > 0.5
    before, after = (energies(m.angular[..., 0])[steep].mean(0) for m in (table, less.material))
    np.testing.assert_allclose(after, before, rtol=0.1)
    contrast = [np.ptp(m.angular[..., 0][:, :, 0]) for m in (table, less.material, more.material)]
    assert contrast[1] == pytest.approx(0.6 * contrast[0], rel=1e-3) and contrast[2] > contrast[0]
