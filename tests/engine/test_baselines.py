# SPDX-License-Identifier: GPL-3.0-or-later
"""The study's other methods succeed on data of their own model: a comparison with a broken method says nothing."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from btfsep_engine import sh
from btfsep_engine.btf.model import Lambertian, Tabulated
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.fit.compare import direction_error, relative_l2
from btfsep_engine.job.load import load_job
from scripts.studies.stability import axes, cases, haber_alternating, joint_parametric, lobes, methods, scenes


@pytest.fixture(scope="module")
def seen():
    """A ball, seen from -y, with nothing that throws a shadow."""
    eye = np.array([0.0, -1.0, 0.0])
    normals = fibonacci_sphere(1200)
    normals = normals[normals @ eye > 0.05]
    visible = normals @ lobes.directions().T > 0
    return lobes.Seen(normals, np.broadcast_to(eye, normals.shape), visible)


@pytest.fixture(scope="module")
def light():
    """A grey sky, darker below, with two soft lamps in front of the ball: (cells, 3), its mean white."""
    d = lobes.directions().reshape(-1, lobes.FINE**2, 3).mean(1)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    out = np.repeat((0.3 + 0.2 * d[:, 2])[:, None], 3, 1)
    lamps = ((-0.6, -0.6, 0.5), 6.0, (1, 0.8, 0.6)), ((0.7, -0.6, 0.1), 2.0, (0.7, 0.9, 1))
    for direction, strength, colour in lamps:
        direction = np.array(direction) / np.linalg.norm(direction)
        out += strength * np.exp(12 * (d @ direction - 1))[:, None] * np.array(colour)
    return out / out.mean(0)


def cell_means(coefficients) -> np.ndarray:
    """The means of a light over the cells, (cells, 3); may be negative."""
    values = sh.evaluate(sh.order_of(len(coefficients)), lobes.directions(4)) @ coefficients
    return values.reshape(lobes.ROWS * lobes.COLUMNS, 16, -1).mean(1)


def errors(light, truth):
    a, b = lobes.to_coefficients(light, 2), lobes.to_coefficients(truth, 2)
    return relative_l2(a, b)["relative_l2_free_scale"], direction_error(a, b)


def test_cells_share_out_the_sphere(light):
    x = np.random.default_rng(0).normal(size=(16, 3))
    back = lobes.to_coefficients(cell_means(x), 3)
    np.testing.assert_allclose(back, x, atol=0.06)  # cells average, so they lose a little
    assert lobes.to_coefficients(np.ones((512, 3)), 0)[0, 0] == pytest.approx(np.sqrt(4 * np.pi), rel=1e-6)


def test_lambertian_matrix_agrees_with_the_formula(seen, light):
    """K L of a Lambertian lobe is the irradiance over pi (Ramamoorthi and Hanrahan 2001), of smooth light."""
    x = lobes.to_coefficients(light, 2)
    smooth = cell_means(x)
    np.testing.assert_allclose(seen.lambert() @ smooth, sh.irradiance(x, seen.normal) / np.pi, rtol=0.05, atol=0.02)


@pytest.mark.parametrize("alpha", [0.2, 0.4, 1.0])
def test_glossy_lobes_reflect_what_ggx_does(alpha):
    """Seen along the normal, the lobe is one integral over the polar angle."""
    normal = np.array([[0.0, -1.0, 0.0]])
    seen = lobes.Seen(normal, normal, normal @ lobes.directions().T > 0)
    nl = (np.arange(200_000) + 0.5) / 200_000
    nh = np.sqrt((1 + nl) / 2)
    d = alpha**2 / np.pi / ((alpha**2 - 1) * nh**2 + 1) ** 2
    masked = 2 * (nl + np.sqrt(alpha**2 + (1 - alpha**2) * nl**2))
    expected = 2 * np.pi * np.mean(d / masked * (lobes.F0 + (1 - lobes.F0) * (1 - nh) ** 5) * nl)
    assert seen.ggx(alpha).sum() == pytest.approx(expected, rel=0.01)


def test_haar_basis_is_orthonormal():
    basis, level = haber_alternating.haar_levels()
    np.testing.assert_allclose(basis @ basis.T, np.eye(len(basis)), atol=1e-12)
    assert (level == 0).sum() == 1 and np.ptp(basis[level == 0]) < 1e-12


def test_alternating_finds_its_own_model(seen, light):
    matrices = [seen.lambert(), *(seen.ggx(a) for a in haber_alternating.ALPHAS)]
    weights = np.array([[0.3, 0.2, 0.1], [0, 0, 0], [1.5, 1.5, 1.5], [0, 0, 0]])
    photo = np.einsum("jpn,nc,jc->pc", np.stack(matrices), light, weights)
    found = haber_alternating.fit(matrices, photo)
    assert found.residual[-1] < 0.02
    assert all(a >= b - 1e-6 for a, b in zip(found.residual, found.residual[1:], strict=False))
    error, degrees = errors(found.light, light)
    assert error < 0.15 and degrees < 6


def test_joint_energy_has_the_gradient_it_says(seen, light):
    energy = joint_parametric.Energy(
        seen.lambert(), [seen.ggx(a) for a in joint_parametric.ALPHAS], seen.lambert() @ light
    )
    random = np.random.default_rng(1)
    x = energy.start(0.3)
    x = x + 0.3 * random.normal(size=x.shape)
    _, gradient = energy(x)
    for i in (0, 700, -8, -7, -5, -2, -1):
        step = np.zeros_like(x)
        step[i] = 2e-3
        slope = (energy(x + step)[0] - energy(x - step)[0]) / 4e-3
        assert slope == pytest.approx(gradient[i], rel=0.02, abs=2e-3 * np.abs(gradient).max())


@pytest.mark.parametrize(("alpha", "specular"), [(0.15, 1.2), (0.4, 2.0)])
def test_joint_finds_its_own_model(seen, light, alpha, specular):
    photo = (seen.lambert() @ light) * [0.35, 0.25, 0.15] + specular * (seen.ggx(alpha) @ light)
    glossy = [seen.ggx(a) for a in joint_parametric.ALPHAS]
    found = joint_parametric.fit(seen.lambert(), glossy, photo, noise=0.03)  # it has none
    error, degrees = errors(found.light, light)
    assert found.residual < 0.03
    assert 0.6 < found.alpha / alpha < 1.6
    assert error < 0.15 and degrees < 6


def test_lambertian_finds_its_own_model():
    normals = fibonacci_sphere(2000)
    x = np.random.default_rng(3).normal(size=(9, 3)) * 0.2
    x[0] = 1.0  # a grey light
    photo = np.array([0.6, 0.3, 0.2]) / np.pi * sh.irradiance(x, normals)
    found = methods.lambertian_light(normals, photo)
    assert relative_l2(found, x)["relative_l2_free_scale"] < 1e-9


def test_the_lamps_light_is_what_a_ball_gives():
    """The coefficients of a ball are those of a cap of the sphere, by quadrature; its irradiance is pi."""
    lamp = (3.0, (0.3, -0.8, 0.5))
    d = fibonacci_sphere(400_000)
    inside = d @ scenes.unit(lamp[1]) > np.cos(scenes.lamp_angle(lamp))
    radiance = inside * scenes.lamp_radiance(lamp)
    expected = sh.evaluate(scenes.ORDER, d[inside]).sum(0) * scenes.lamp_radiance(lamp) * 4 * np.pi / len(d)
    np.testing.assert_allclose(scenes.lamp_coefficients(lamp)[:, 1], expected, atol=0.02 * np.abs(expected).max())
    irradiance = (radiance * (d @ scenes.unit(lamp[1]))).sum() * 4 * np.pi / len(d)
    assert irradiance == pytest.approx(np.pi, rel=0.01)


def test_smoothing_takes_bumps_and_leaves_the_ball():
    """Heat over a length sigma takes a wave of length w down to exp(-(2 pi sigma / w)^2 / 2)."""
    vertices, faces = _ball()
    assert np.linalg.norm(axes.smoothed(vertices, vertices, faces, 0.05), axis=1) == pytest.approx(1.0, abs=0.01)
    order, length = 12, 0.1
    wave = sh.evaluate(order, vertices)[:, order * order + order]
    left = axes.smoothed(wave[:, None], vertices, faces, length)[:, 0]
    expected = np.exp(-order * (order + 1) * length**2 / 2)  # the sphere's own wave number
    assert (left @ wave) / (wave @ wave) == pytest.approx(expected, rel=0.1)


def _ball():
    directions = fibonacci_sphere(6000)
    return directions, ConvexHull(directions).simplices


def test_materials_are_mixed_by_their_shares():
    random = np.random.default_rng(0)
    directions = fibonacci_sphere(20)

    def material(size, components):
        texels, angular = random.random((size, size, components)), random.random((20, 20, 3, components))
        return Tabulated("a/b", "a", texels.astype("f4"), angular.astype("f4"), directions, directions, 0.3)

    first, second = material(4, 3), material(7, 2)
    both = methods.blended(first, second, 0.25)
    np.testing.assert_allclose(both.mean_abrdf, 0.75 * first.mean_abrdf + 0.25 * second.mean_abrdf, rtol=1e-4)
    matte = methods.blended(Lambertian("white", np.array([0.8, 0.6, 0.4])), second, 0.5)
    np.testing.assert_allclose(
        matte.mean_abrdf, 0.5 * second.mean_abrdf + 0.5 * np.array([0.8, 0.6, 0.4]) / np.pi, rtol=1e-4
    )
    assert methods.blended(first, second, 1) is second


def test_a_case_is_a_job_that_the_engine_reads(tmp_path):
    vertices, faces = _ball()
    image = np.random.default_rng(0).random((12, 12, 3))
    to_world = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
    camera = {"width": 12, "height": 12, "fx": 18.0, "fy": 18.0, "cx": 6.0, "cy": 6.0, "to_world": to_world}
    case = cases.Case(
        2 * image, image, camera, vertices, faces, np.zeros((len(faces), 3, 2)) + np.arange(3)[None, :, None] % 2,
        image[..., 0] > 0, np.ones((25, 3)), "reference/white-diffuse", scenes.AS_IS, coded=True,
    )  # fmt: skip
    cases.write_job(case, tmp_path)
    job = load_job(tmp_path)
    clipped = (2 * image >= 1).any(-1)
    assert 0 < clipped.sum() < clipped.size
    assert (job.photo.usable[~clipped & (2 * image < 0.95).all(-1)]).all() and not job.photo.usable[clipped].any()
    np.testing.assert_allclose(job.photo.radiance[~clipped], 2 * image[~clipped], atol=0.01)
    again, _ = cases.welded(job.objects[0].mesh)
    assert len(again) == len(vertices)
    np.testing.assert_allclose(np.sort(again, 0), np.sort(vertices, 0), atol=1e-6)
