# SPDX-License-Identifier: GPL-3.0-or-later
"""The virtual gonioreflectometer against closed forms, an independent 2D tracer, and physics."""

from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine.btf.directions import cosine_weights, hemisphere_quadrature, interpolator, ubo2014_directions
from btfsep_engine.btf.procedural import Maps
from btfsep_engine.conventions import fibonacci_sphere, local_direction
from btfsep_engine.render.hats import sharpened
from btfsep_engine.render.patch import Patch, measure

DIRECTIONS = ubo2014_directions()
SOME = DIRECTIONS[[0, 3, 15, 31, 64, 88, 110, 128, 150]]


def flat(base=(0.6, 0.3, 0.1), roughness=0.5, f0=0.04, n=16, metallic=None):
    colour, level = np.broadcast_to(np.asarray(base, np.float32), (n, n, 3)), np.zeros((n, n), np.float32)
    metal = None if metallic is None else np.full_like(level, metallic)
    return Maps("test/flat", colour, level, np.full_like(level, roughness), 10.0, f0, metal)


def ridges(amplitude, base=0.5, f0=0.0, n=128, periods=2, skew=0.0):
    """Waves along u; ``skew`` makes them lean, so that left is not right."""
    x = (np.arange(n) + 0.5) / n
    h = ridge_height(x, amplitude, periods, skew).astype(np.float32)
    colour = np.full((n, n, 3), base, np.float32)
    return Maps("test/ridges", colour, np.tile(h, (n, 1)), np.full((n, n), 0.6, np.float32), 10.0, f0)


def ridge_height(x, amplitude, periods, skew):
    phase = 2 * np.pi * periods * x
    return amplitude * (np.sin(phase) + skew * np.sin(2 * phase))


def radiance(maps, views, lights, *, texels=16, samples=1, seed=0):
    """(views, lights, 3, texels^2), cos(theta_i) included."""
    patch = Patch(maps, lights, seed=seed)
    return np.stack([b.transpose(2, 0, 1) for b in patch.views(views, texels=texels, samples=samples)])


def test_flat_lambertian_is_albedo_over_pi():
    base = np.array([0.6, 0.3, 0.1])
    found = radiance(flat(base, f0=0.0), SOME, SOME)
    expected = base[None, :, None] / np.pi * SOME[:, 2, None, None]
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), rtol=1e-5)


def ggx_reference(base, roughness, f0, views, lights):
    """f cos(theta_i) by the textbook: D, Smith's G2 from Lambda, Fresnel; E by quadrature over light directions."""
    alpha = roughness**2

    def specular(v, l):
        h = v + l
        h = h / np.linalg.norm(h, axis=-1, keepdims=True)
        c, eta = (v * h).sum(-1), (1 + f0**0.5) / (1 - f0**0.5)
        tan2 = 1 / h[..., 2] ** 2 - 1
        d = 1 / (np.pi * alpha**2 * h[..., 2] ** 4 * (1 + tan2 / alpha**2) ** 2)

        def smith(w):
            return (np.sqrt(1 + alpha**2 * (1 / w[..., 2] ** 2 - 1)) - 1) / 2

        g2 = 1 / (1 + smith(v) + smith(l))
        inside = np.sqrt(1 - (1 - c**2) / eta**2)  # Snell
        fresnel = (((c - eta * inside) / (c + eta * inside)) ** 2 + ((inside - eta * c) / (inside + eta * c)) ** 2) / 2
        return d * g2 * fresnel / (4 * v[..., 2] * l[..., 2])

    theta, phi = np.meshgrid((np.arange(400) + 0.5) / 400 * np.pi / 2, (np.arange(400) + 0.5) / 400 * 2 * np.pi)
    grid = local_direction(theta, phi)
    measure_of = np.cos(theta) * np.sin(theta) * (np.pi / 2 / 400) * (2 * np.pi / 400)

    def albedo(w):
        return (specular(np.broadcast_to(w, grid.shape), grid) * measure_of).sum()

    mu = (np.arange(64) + 0.5) / 64
    mean = sum(albedo(local_direction(np.arccos(m), 0.0)) * 2 * m / 64 for m in mu)
    e_v, e_l = ([albedo(w) for w in ws] for ws in (views, lights))
    out = np.empty((len(views), len(lights), 3))
    for i, v in enumerate(views):
        for j, l in enumerate(lights):
            diffuse = np.asarray(base) / np.pi * (1 - e_v[i]) * (1 - e_l[j]) / (1 - mean)
            out[i, j] = (diffuse + specular(v, l)) * l[2]
    return out


def test_flat_rough_dielectric_against_the_textbook():
    base = (0.5, 0.2, 0.05)
    found = radiance(flat(base, roughness=0.45), SOME, SOME).mean(-1)
    np.testing.assert_allclose(found, ggx_reference(base, 0.45, 0.04, SOME, SOME), rtol=0.015)


@pytest.mark.parametrize("roughness", [0.3, 0.7])
def test_white_base_keeps_energy(roughness):
    lights = fibonacci_sphere(6000)
    lights = lights[lights[:, 2] > 0]
    found = radiance(flat((1.0, 1.0, 1.0), roughness=roughness, n=4), SOME, lights, texels=4).mean(-1)
    albedo = found.sum(1) * 2 * np.pi / len(lights)
    assert albedo.max() < 1.005
    assert albedo.min() > 0.97


def traced_in_2d(amplitude, periods, skew, view, light, base):
    """Mean direct radiance of Lambertian waves along u, by marching rays through the profile."""
    x = (np.arange(600) + 0.5) / 600
    top = 1.01 * np.abs(ridge_height(np.linspace(0, 1, 5000), amplitude, periods, skew)).max()
    z = np.linspace(top, -top, 2001)

    def profile(at):
        return ridge_height(at / 10.0, amplitude, periods, skew)

    along = 10.0 * x[:, None] + z[None] * view[0] / view[2]
    first = np.argmax(z[None] <= profile(along), axis=1)
    hit_x = along[np.arange(len(x)), first]
    hit_z = profile(hit_x)
    step = 1e-4
    slope = (profile(hit_x + step) - profile(hit_x - step)) / (2 * step)
    normal = np.stack([-slope, np.zeros_like(slope), np.ones_like(slope)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    rise = np.linspace(1e-4, 2.05 * top, 1500)
    blocked = (profile(hit_x[:, None] + rise * light[0] / light[2]) > hit_z[:, None] + rise).any(1)
    return (base / np.pi * np.maximum(normal @ light, 0) * ~blocked).mean()


def test_shadows_and_masking_against_a_2d_tracer():
    base, amplitude, skew = 0.002, 0.9, 0.25  # so dark that interreflection does not matter
    views = local_direction(np.radians([0, 40, 40, 65, 70]), np.radians([0, 0, 180, 30, 170]))
    lights = local_direction(np.radians([10, 50, 50, 60, 70]), np.radians([90, 0, 180, 140, 10]))
    found = radiance(ridges(amplitude, base, skew=skew), views, lights, texels=48, samples=4).mean((-1, -2))
    expected = np.array([[traced_in_2d(amplitude, 2, skew, v, l, base) for l in lights] for v in views])
    np.testing.assert_allclose(found, expected, rtol=0.03, atol=4e-6)


def test_mean_abrdf_is_reciprocal_and_interreflection_brightens():
    f = (
        radiance(ridges(1.2, 0.8, f0=0.04, skew=0.25), SOME, SOME, texels=48, samples=6).mean((-1, -2))
        / SOME[None, :, 2]
    )
    np.testing.assert_allclose(f, f.T, rtol=0.06)
    assert np.median(np.abs(f / f.T - 1)) < 0.015
    lambertian = [
        radiance(ridges(1.2, base, skew=0.25), SOME, SOME, texels=32, samples=4).mean((-1, -2)) for base in (0.8, 0.08)
    ]
    assert (lambertian[0] / lambertian[1]).mean() > 10 * 1.15


def test_parallax_is_that_of_the_mean_height():
    """A raised red stripe is seen where the ray through it meets the reference plane."""
    n = 128
    height = np.full((n, n), -0.5, np.float32)
    colour = np.full((n, n, 3), 0.01, np.float32)
    inside = slice(48, 80)
    height[:, inside], colour[:, inside, 0] = 1.5, 0.8  # mean 0 at a share of 1/4
    maps = Maps("test/stripe", colour, height, np.full((n, n), 0.9, np.float32), 10.0, 0.0)
    view = local_direction(np.radians([0.0, 45.0, 45.0]), np.radians([0.0, 0.0, 180.0]))
    seen = radiance(maps, view, np.array([[0.0, 0.0, 1.0]]), texels=64, samples=4)[:, 0, 0].reshape(3, 64, 64).mean(1)
    centre = (seen * (np.arange(64) + 0.5)).sum(1) / seen.sum(1) * 10 / 64
    np.testing.assert_allclose(centre, [5.0, 5.0 - 1.5, 5.0 + 1.5], atol=0.12)


def hat_averages(maps, **options):
    """(views, lights, 3, texels^2) of SOME, without the cosine, as the tables hold it; and the mean over the texels."""
    patch = Patch(maps, SOME, seed=options.pop("seed"), averaged=True)
    block = np.stack([b.transpose(2, 0, 1) for b in patch.views(SOME, **options)]) / SOME[None, :, 2, None, None]
    both = sharpened(np.concatenate([block.mean(-1, keepdims=True), block], -1), SOME)
    return both[..., 1:], both[..., 0]


def test_measure_gives_the_factors_of_what_the_patch_shows():
    maps = ridges(0.8, 0.4, f0=0.04)
    measured = measure(maps, texels=24, samples=3, components=12, lights=SOME, views=SOME, seed=3)
    material = measured.material
    block, mean = hat_averages(maps, texels=24, samples=3, seed=3)
    again = material.angular @ material.texels.reshape(-1, 12).T
    scale = SOME[None, :, 2, None, None] / (mean * SOME[None, :, 2, None] + 0.5 * mean[0].mean())[..., None]
    error = np.linalg.norm((again - block) * scale) / np.linalg.norm(block * scale)
    assert error == pytest.approx(measured.relative_error, rel=0.1)
    assert error < 0.25
    np.testing.assert_allclose(material.mean_abrdf, mean, rtol=2e-3, atol=1e-5)
    assert 9 * 9 * 24 * 24 * 3 < measured.rays < 9 * (9 + 4) * 24 * 24 * 3 * 3 and measured.seconds > 0
    same = measure(maps, texels=24, samples=3, components=12, lights=SOME, views=SOME, seed=3).material
    np.testing.assert_array_equal(same.angular, material.angular)
    other = measure(maps, texels=24, samples=3, components=12, lights=SOME, views=SOME, seed=4).material
    assert not np.array_equal(other.angular, material.angular)


@pytest.mark.parametrize("roughness", [0.15, 0.26, 0.5, 1.0])
@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_a_measured_flat_gloss_reflects_what_it_should_however_narrow(roughness, metallic):
    """The energy of the table, as it is interpolated, from every view: that of the microfacets by sampling."""
    colour = np.array([0.9, 0.5, 0.02])
    maps = flat(colour, roughness=roughness, n=8, metallic=metallic)
    views = DIRECTIONS[[0, 9, 40, 70, 100, 140]]
    material = measure(maps, texels=32, samples=1, components=2, lights=DIRECTIONS, views=views).material
    found = np.einsum("vlc,l->vc", material.mean_abrdf, cosine_weights(DIRECTIONS))
    np.testing.assert_allclose(
        found, np.stack([albedo_by_halves(colour, roughness, metallic, v) for v in views]), rtol=0.02
    )
    assert found.max() < 1 and material.mean_abrdf.min() > 0


def albedo_by_halves(base, roughness, metallic, view, f0=0.04):
    """(3,) albedo: the layer's or the conductor's by quadrature over half vectors, whose density is D cos."""
    alpha2, eta = roughness**4, (1 + f0**0.5) / (1 - f0**0.5)
    u, phi = np.meshgrid((np.arange(500) + 0.5) / 500, (np.arange(300) + 0.5) / 300 * 2 * np.pi)

    def smith(z):
        return (np.sqrt(1 + alpha2 * (1 / np.maximum(z, 1e-9) ** 2 - 1)) - 1) / 2

    def reflected(eye, fresnel):
        z = np.sqrt((1 - u) / (1 + (alpha2 - 1) * u))
        h = np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z], -1)
        vh = h @ eye
        lz = 2 * vh * z - eye[2]
        up = (vh > 0) & (lz > 0)
        shadowed = 1 / (1 + smith(eye[2]) + smith(lz))
        return np.where(up, fresnel(np.where(up, vh, 1.0)) * shadowed * vh / (eye[2] * z), 0).mean()

    def dielectric(c):
        inside = np.sqrt(1 - (1 - c**2) / eta**2)
        return (((c - eta * inside) / (c + eta * inside)) ** 2 + ((inside - eta * c) / (inside + eta * c)) ** 2) / 2

    if metallic:
        return np.array([reflected(view, lambda c, b=b: b + (1 - b) * (1 - c) ** 5) for b in base])
    layer = reflected(view, dielectric)
    return np.asarray(base) * (1 - layer) + layer


def test_a_rough_conductor_against_the_textbook():
    """D G2 F / (4 n.v n.l) with G2 from Lambda, pointwise; half a metal is half of each."""
    gold, roughness = np.array([0.95, 0.7, 0.3]), 0.45
    found = radiance(flat(gold, roughness=roughness, metallic=1.0), SOME, SOME).mean(-1)
    v, l = SOME[:, None], SOME[None]
    h = (v + l) / np.linalg.norm(v + l, axis=-1, keepdims=True)
    alpha = roughness**2
    tan2, c = 1 / h[..., 2] ** 2 - 1, (v * h).sum(-1)
    d = 1 / (np.pi * alpha**2 * h[..., 2] ** 4 * (1 + tan2 / alpha**2) ** 2)
    hidden = [(np.sqrt(1 + alpha**2 * (1 / w[..., 2] ** 2 - 1)) - 1) / 2 for w in (v, l)]
    f = gold + (1 - gold) * ((1 - c) ** 5)[..., None]
    expected = (d / (1 + hidden[0] + hidden[1]) / (4 * v[..., 2]))[..., None] * f
    np.testing.assert_allclose(found, expected, rtol=1e-3)
    parts = [radiance(flat(gold, roughness=roughness, metallic=m), SOME, SOME).mean(-1) for m in (0.0, 0.5)]
    np.testing.assert_allclose(parts[1], (parts[0] + found) / 2, rtol=1e-4)
    bumpy = ridges(1.2, 0.8, f0=0.04, skew=0.25)
    bumpy = replace(bumpy, metallic=np.ones_like(bumpy.height_mm))
    f = radiance(bumpy, SOME, SOME, texels=48, samples=6).mean((-1, -2)) / SOME[None, :, 2]
    assert np.median(np.abs(f / f.T - 1)) < 0.03  # reciprocal


def test_the_rule_of_a_value_is_the_average_over_its_hat():
    """Waves in the shade and the light: each value before sharpening, against point samples all over its hat."""
    maps = ridges(1.2, 0.3, f0=0.04, skew=0.25, n=64)
    view = local_direction(np.radians([40.0]), np.radians([20.0]))
    fine = fibonacci_sphere(3000)
    fine = fine[fine[:, 2] > 0]
    f = radiance(maps, view, fine, texels=32, samples=2)[0, :, 0].mean(-1)
    index, share = interpolator(SOME).weights(fine)
    above, below = np.zeros(len(SOME)), np.zeros(len(SOME))
    np.add.at(above, index, share * f[:, None])
    np.add.at(below, index, share * fine[:, 2:])
    block = next(Patch(maps, SOME, averaged=True).views(view, texels=32, samples=16))
    np.testing.assert_allclose(block[0].mean(0) / SOME[:, 2], above / below, rtol=0.03)


def test_sharpening_keeps_the_energy_and_gives_smooth_functions_back():
    smooth = (1 + 0.8 * DIRECTIONS[:, 0] * DIRECTIONS[:, 2])[None, :, None, None] * np.ones((1, 1, 3, 1))
    nodes, weights = hemisphere_quadrature()
    index, share = interpolator(DIRECTIONS).weights(nodes)
    value = (1 + 0.8 * nodes[:, 0] * nodes[:, 2]) * weights * nodes[:, 2]
    above, below = np.zeros(151), np.zeros(151)
    np.add.at(above, index, share * value[:, None])
    np.add.at(below, index, share * (weights * nodes[:, 2])[:, None])
    average = np.broadcast_to((above / below)[None, :, None, None], (1, 151, 3, 1))
    sharp = sharpened(average, DIRECTIONS)
    inner = DIRECTIONS[:, 2] > np.cos(np.radians(61))
    left = np.abs(sharp - smooth)[:, inner].max(), np.abs(average - smooth)[:, inner].max()
    assert left[0] < 0.75 * left[1]
    np.testing.assert_allclose(cosine_weights(DIRECTIONS) @ sharp[0, :, 0, 0], value.sum(), rtol=2e-3)
    # averages of what is 1 at one light and falls to 0 at its neighbours: the peak comes back, nothing gets negative
    peak = np.full(151, 1e-9)
    own = (share * (index == 40)).sum(1) * weights * nodes[:, 2]
    np.add.at(peak, index, share * own[:, None])
    spike = np.broadcast_to((peak / below)[None, :, None, None], (1, 151, 3, 1))
    sharp = sharpened(spike, DIRECTIONS)[0, :, 0, 0]
    assert spike.max() < 0.6 and sharp.min() > 0 and 0.8 < sharp[40] < 1.05
    np.testing.assert_allclose(
        cosine_weights(DIRECTIONS) @ sharp, cosine_weights(DIRECTIONS) @ spike[0, :, 0, 0], rtol=2e-3
    )
