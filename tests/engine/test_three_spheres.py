# SPDX-License-Identifier: GPL-3.0-or-later
"""The three-spheres protocol: against its own programs' figures, against plain sums, and by construction."""

import json

import numpy as np
import pytest

from btfsep_engine.cli import main
from btfsep_engine.conventions import fibonacci_sphere, pixel_directions
from btfsep_engine.fit import blender_spheres as spheres
from btfsep_engine.fit.three_spheres import picture_figures, three_spheres, tone_mapped
from btfsep_engine.imaging import images
from btfsep_engine.light.files import exactly, lighting_map, write_lighting

# What mirror.py, matte_silver.py, diffuse.py and fast_rmse.py of DiffusionLight-evaluation give for the two rooms
# below in Blender 3.4.1, not denoised, with 128 samples (diffuse: 512): rmse, si_rmse, degrees, normalised rmse.
PUBLISHED_PROGRAMS = {
    "mirror": (0.22566, 0.21852, 1.87506, 0.22567),
    "matte_silver": (0.10121, 0.09299, 1.83407, 0.13621),
    "diffuse": (0.05282, 0.03236, 1.25561, 0.06510),
}


def room(directions, lamps, ground):
    """Radiance (..., 3): a sky, a ground and lamps (direction, sharpness, colour)."""
    up = directions[..., 2:]
    light = 0.2 + 0.6 * np.array([0.6, 0.8, 1.0]) * np.maximum(up, 0) + np.array(ground) * np.maximum(-up, 0)
    for towards, sharpness, colour in lamps:
        cosine = directions @ (np.array(towards) / np.linalg.norm(towards))
        light = light + np.exp(sharpness * (cosine - 1))[..., None] * np.array(colour)
    return light


def true_room(directions):
    lamps = [((1, -2, 1.5), 400, (90, 70, 50)), ((-2, -1, 0.5), 30, (3, 4, 6)), ((0.3, 1, 0.2), 150, (0, 12, 5))]
    return room(directions, lamps, (0.5, 0.3, 0.2))


def estimated_room(directions):
    lamps = [((1.3, -2, 1.2), 120, (25, 22, 16)), ((-2, -0.6, 0.8), 12, (2, 2.5, 4))]
    return room(directions, lamps, (0.3, 0.3, 0.2))


@pytest.fixture(scope="module")
def rooms():
    """Estimate and truth, (256, 512, 3) and (128, 256, 3)."""
    d = pixel_directions(256, 512)
    return estimated_room(d), spheres.averaged(true_room(d), 128, 256)


@pytest.fixture(scope="module")
def figures(rooms):
    return three_spheres(*rooms)


def test_figures_of_the_published_programs(figures):
    assert json.loads(json.dumps(figures)) == figures
    for kind, (rmse, si_rmse, degrees, normalised) in PUBLISHED_PROGRAMS.items():
        assert figures[kind]["rmse"] == pytest.approx(rmse, rel=0.02), kind
        assert figures[kind]["si_rmse"] == pytest.approx(si_rmse, rel=0.02), kind
        assert figures[kind]["angular_degrees"] == pytest.approx(degrees, abs=0.02), kind
        assert figures[kind]["normalised_rmse"] == pytest.approx(normalised, rel=0.03), kind


def test_brightness_does_not_count_and_equal_lights_are_equal(rooms, figures):
    estimate, truth = rooms
    for errors in three_spheres(7 * truth, 0.1 * truth).values():
        assert max(errors.values()) < 1e-6
    assert three_spheres(5 * estimate, truth)["diffuse"] == pytest.approx(figures["diffuse"])


def test_the_truth_keeps_its_detail_and_the_estimate_does_not(rooms):
    """Stripes of half a pixel of the estimate: the mirror shows them, the diffuse sphere cannot."""
    fine = np.repeat(np.repeat(rooms[1], 2, 0), 2, 1)
    fine[:, ::2] *= 1.6
    found = three_spheres(fine, fine)
    assert found["mirror"]["si_rmse"] > 0.01 and found["diffuse"]["si_rmse"] < 1e-6


def test_tone_map():
    a = np.random.default_rng(3).gamma(0.3, size=(8, 16, 3))
    a[:3] = 0
    a[4, 4] = -1
    found = tone_mapped(a)
    assert np.median(found[found > 0]) == pytest.approx(0.5)
    lit = a > 0
    assert (found[~lit] == 0).all() and np.ptp(found[lit] ** 2.4 / a[lit]) < 1e-9 * (found[lit] ** 2.4 / a[lit]).max()
    assert (tone_mapped(np.zeros((4, 8, 3))) == 0).all()


def test_averaging_to_any_size_keeps_means_and_whole_factors_are_blocks():
    a = np.random.default_rng(4).random((12, 24, 3))
    assert np.allclose(spheres.averaged(a, 4, 8), a.reshape(4, 3, 8, 3, 3).mean((1, 3)))
    for size in ((5, 10), (12, 24), (31, 17)):
        assert np.allclose(spheres.averaged(a, *size).mean((0, 1)), a.mean((0, 1)))


def test_figures_by_hand():
    """Two pixels of sphere in a picture of 2 x 2, red in one of them."""
    seen = np.array([[True, True], [False, False]])
    truth, estimate = np.zeros((2, 2, 2, 3))
    truth[0] = [1, 1, 1], [2, 0, 0]
    estimate[0] = [2, 2, 2], [2, 2, 0]
    found = picture_figures(estimate, truth, seen)
    assert found["rmse"] == pytest.approx(np.sqrt((3 + 4) / 2))
    scale = (6 + 4) / (12 + 8)
    error = 3 * (2 * scale - 1) ** 2 + (2 * scale - 2) ** 2 + (2 * scale) ** 2
    assert found["si_rmse"] == pytest.approx(np.sqrt(error / 2))
    assert found["angular_degrees"] == pytest.approx(45 / 2)
    ranges = [np.diff(np.percentile(a, (0.01, 99.9)))[0] for a in (estimate, truth)]
    stretched = 3 * (2 / ranges[0] - 1 / ranges[1]) ** 2 + (2 / ranges[0] - 2 / ranges[1]) ** 2 + (2 / ranges[0]) ** 2
    assert found["normalised_rmse"] == pytest.approx(np.sqrt(stretched / 2))
    assert set(picture_figures(0 * estimate, truth, seen).values()) == {None}


def ggx(normal, eye, light, alpha, reflectance):
    """Textbook microfacets times cosine: GGX and Smith's height-correlated masking, for (n, 3) directions of light."""
    half = light + eye
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    nl, nv, nh, vh = light @ normal, eye @ normal, half @ normal, half @ eye
    density = alpha**2 / (np.pi * (nh**2 * (alpha**2 - 1) + 1) ** 2)
    hidden = nl * np.sqrt(alpha**2 + (1 - alpha**2) * nv**2) + nv * np.sqrt(alpha**2 + (1 - alpha**2) * nl**2)
    return reflectance(vh) * density / (2 * hidden) * nl


def glass(cosine):
    """Fresnel's reflectance of a refractive index of 1.5, from the two polarisations."""
    inside = np.sqrt(1 - (1 - cosine**2) / 1.5**2)
    s = (cosine - 1.5 * inside) / (cosine + 1.5 * inside)
    p = (1.5 * cosine - inside) / (1.5 * cosine + inside)
    return (s**2 + p**2) / 2


def burley(normal, eye, light, roughness):
    """Burley's lobe as he wrote it, times cosine, for an albedo of 1."""
    half = light + eye
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    nl, nv = light @ normal, eye @ normal
    grazing = 0.5 + 2 * roughness * (half @ eye) ** 2 - 1
    return (1 + grazing * (1 - nl) ** 5) * (1 + grazing * (1 - nv) ** 5) / np.pi * nl


def smooth_room(directions):
    return room(directions, [((1, -2, 1.5), 40, (9, 7, 5)), ((0.3, 2, 0.2), 15, (0, 12, 5))], (0.5, 0.3, 0.2))


@pytest.fixture(scope="module")
def pictures():
    return spheres.blender_spheres(smooth_room(pixel_directions(128, 256)))[0]


@pytest.mark.parametrize("off", [(10, 10), (-50, 50), (80, -80), (-95, -95)])
def test_pixels_against_plain_sums(pictures, off):
    """Pixels on the diagonals, where the outline is round: the light summed over 400,000 directions."""
    x, y = off
    eye_at = np.array([0, -16, 2.0])
    forward = -eye_at / np.linalg.norm(eye_at)
    ray = forward + (x * np.array([1, 0, 0]) + y * np.cross([1, 0, 0], forward)) / (960 * 85 / 36)
    ray /= np.linalg.norm(ray)
    along = -eye_at @ ray - np.sqrt((eye_at @ ray) ** 2 - eye_at @ eye_at + spheres.RADIUS**2)
    normal = (eye_at + along * ray) / spheres.RADIUS
    sky = fibonacci_sphere(400_000)
    sky = sky[sky @ normal > 1e-6]
    arriving = smooth_room(sky) * 4 * np.pi / 400_000
    mirrored = ray - 2 * (ray @ normal) * normal
    expected = {
        "mirror": smooth_room(mirrored) * spheres.MATERIALS["mirror"].reflectance(-ray @ normal),
        "matte_silver": ggx(normal, -ray, sky, 0.3271**2, lambda c: 0.8) @ arriving,
        "diffuse": (ggx(normal, -ray, sky, 0.364**2, glass) + 0.8 * burley(normal, -ray, sky, 0.364)) @ arriving,
    }
    for kind, value in expected.items():
        corner = pictures[kind][0][270 - y - 1 : 270 - y + 1, 480 + x - 1 : 480 + x + 1]  # around the point
        assert corner.mean((0, 1)) == pytest.approx(value, rel=0.015), kind


def test_metals_of_the_protocol():
    """A base colour of 0.8 that the mirror leaves towards the rim, and the silver, of specular 0, does not."""
    mirror, silver = spheres.MATERIALS["mirror"].reflectance, spheres.MATERIALS["matte_silver"].reflectance
    assert mirror(1.0) == pytest.approx(0.8) and mirror(1e-9) == pytest.approx(1)
    assert silver(np.linspace(0.01, 1, 9)) == pytest.approx(0.8)
    assert spheres.MATERIALS["diffuse"].reflectance(np.array([0.1, 0.5, 1])) == pytest.approx(
        glass(np.array([0.1, 0.5, 1]))
    )


def test_command(tmp_path, capsys):
    """A lighting.json against maps: what is compared is its lighting.exr against the whole truth."""
    d = pixel_directions(64, 128)
    light = exactly(np.array([[3, 2.5, 2], [0.5, 0, 0], [0.3, 0.8, 0.1], [-2.5, -0.2, 0.9]], float))
    write_lighting(tmp_path / "a.json", light)
    images.write_exr(tmp_path / "b.exr", true_room(d))
    command = ["compare", str(tmp_path / "a.json"), str(tmp_path / "b.exr"), "--protocol", "three-spheres"]
    assert main([*command, "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])["result"]
    truth = images.read_linear(tmp_path / "b.exr").pixels
    expected = three_spheres(lighting_map(light, 256, 512), truth)
    assert found == {"protocol": "three-spheres", **expected}
    assert main([*command, "--job", str(tmp_path)]) == 2
    assert "--job" in capsys.readouterr().err
