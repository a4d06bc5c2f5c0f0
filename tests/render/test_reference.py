# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel and the reference, two ways to one integral, within their noise.

The difference is measured in its own standard deviations: of the reference from the spread of its paths, of the
kernel from the spread between four sets of directions.
"""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.model import Mirror
from btfsep_engine.cli import main
from btfsep_engine.light.files import Lighting, read_lighting, write_lighting
from btfsep_engine.light.lightings import EnvironmentMaps, SHBasis
from btfsep_engine.render.radiosity import Indirect, diffuse_albedo
from btfsep_engine.render.reference import Reference
from btfsep_engine.render.surface import camera_view
from btfsep_engine.render.transport import Transport
from tests.render.btf_materials import diffuse, glossy, matte, textured
from tests.render.prepared import MILLIMETRES, Prepared
from tests.render.scenes import as_mesh, ball, bowl, looking_down, plate

COUNTS = (3001, 3517, 4021, 4523)  # directions of the kernel's four runs


@dataclass(frozen=True)
class Some:
    """A few lights of many: each costs the reference two renders."""

    lights: object
    chosen: tuple
    returns = False

    @property
    def count(self):
        return len(self.chosen)

    @property
    def names(self):
        return tuple(self.lights.names[i] for i in self.chosen)

    def radiance(self, directions):
        return self.lights.radiance(directions)[:, list(self.chosen)]

    def cell_averages(self, directions):
        return self.lights.cell_averages(directions)[:, list(self.chosen)]


def z_test(scene, lights, *, samples=1024):
    """Kernel and reference within noise, point by point and in the sum over the points."""
    runs = np.stack([scene.kernel(lights, directions=n) for n in COUNTS]).astype(np.float64)
    kernel = runs.mean(0)
    found = scene.reference(lights, samples=samples)
    quadrature = runs.var(0, ddof=1) / len(COUNTS)
    difference = found.radiance - kernel
    z2 = difference**2 / (found.variance + quadrature)
    assert 0.7 < z2.mean() < 1.3, z2.mean((0, 2))
    # the sum over points is sharper; the kernel's error goes together over them
    together = found.variance.sum(0) + runs.sum(1).var(0, ddof=1) / len(COUNTS)
    z = difference.sum(0) / np.sqrt(together)
    assert np.abs(z).max() < 4.5, z
    # and what is asked of the noise itself: that it can tell a per cent apart
    noise = np.sqrt(together).max() / np.abs(kernel).sum(0).max()
    assert noise < 0.01, noise


def test_a_glossy_ball_under_orders_0_to_4():
    z_test(Prepared([ball()], glossy(), count=120, use_texture=False), Some(SHBasis(4), (0, 1, 6, 12, 23)))


def test_a_textured_ball_in_the_shade_of_a_plate():
    scene = Prepared([ball()], textured(), count=120, use_texture=True, occluders=[plate()])
    z_test(scene, Some(SHBasis(4), (0, 3, 8, 17)))


def test_a_matte_bowl_that_shadows_itself():
    z_test(Prepared([bowl()], matte(), count=120, use_texture=False), Some(SHBasis(4), (0, 2, 5, 15)))


@pytest.mark.parametrize(
    "changes", [{"orthographic": True, "fx": 45.0, "fy": 40.0}, {"distortion": (-0.5, 0.1, 0.02, -0.03)}]
)
def test_a_glossy_ball_seen_by_other_cameras(changes):
    camera = replace(looking_down(), **changes)
    scene = Prepared([ball()], glossy(), count=120, use_texture=False, camera=camera)
    z_test(scene, Some(SHBasis(4), (0, 1, 6, 12)))


def test_the_mean_of_a_texture_under_maps():
    """A sky with a soft lamp, and one that is brighter on one side: orientation and scale of maps."""
    y, x = np.mgrid[:32, :64]
    lamp = np.exp(-(((x - 14) / 5) ** 2) - ((y - 8) / 4) ** 2)
    first = 0.2 + lamp[..., None] * [8.0, 5.0, 2.0]
    second = np.ones((32, 64, 3)) * (1.2 + np.sin(2 * np.pi * x / 64))[..., None]
    lights = EnvironmentMaps(np.stack([first, second]), ("lamp", "side"))
    z_test(Prepared([ball()], textured().mean_material(), count=120, use_texture=False), lights)


def test_a_mirror_and_seeds():
    """A mirror under a smooth map is without noise; other seeds are independent, the same one repeats."""
    scene = Prepared([ball()], Mirror("chrome", np.array([0.9, 0.6, 0.3])), count=200, use_texture=False)
    lights = Some(SHBasis(3), (0, 5, 11))
    got = scene.reference(lights, samples=4).radiance
    assert got == pytest.approx(scene.kernel(lights), abs=0.01 * float(np.abs(got).max()))
    scene = Prepared([ball()], matte(), count=50, use_texture=False)
    first, again, other = (scene.reference(Some(SHBasis(0), (0,)), samples=64, seed=s).radiance for s in (1, 1, 2**31))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_the_variance_is_that_of_independent_renders():
    scene = Prepared([ball()], matte(), count=150, use_texture=False)
    lights = Some(SHBasis(1), (0, 2))
    runs = [scene.reference(lights, samples=64, seed=s) for s in range(8)]
    spread_ = np.stack([r.radiance for r in runs]).astype(np.float64).var(0, ddof=1)
    assert spread_.mean() == pytest.approx(np.mean([r.variance for r in runs]), rel=0.15)


def test_a_white_bowl_under_a_white_sky_has_the_known_brightness():
    """Half a sphere sees half of itself from everywhere: E = pi L / 2 / (1 - albedo / 2); with the BTF plugin."""
    shape = trimesh.creation.icosphere(5)
    shape.update_faces(shape.triangles_center[:, 2] < 0)
    shape.remove_unreferenced_vertices()
    scene = Prepared([as_mesh(shape)], diffuse(0.8), count=100, use_texture=False)
    found = scene.reference(SHBasis(0), samples=512, bounces=20)
    assert found.radiance.mean() * np.sqrt(4 * np.pi) == pytest.approx(0.5 * 0.8 / (1 - 0.4), rel=0.02)


def test_light_between_matte_surfaces_is_that_of_the_path_tracer():
    """The kernel takes what other surfaces send as diffuse: of a nearly diffuse table it has to be right."""
    ball_in_it = as_mesh(trimesh.creation.icosphere(4, 0.4).apply_translation([0.2, 0.1, -0.5]))
    bright = replace(matte(), angular=matte().angular * 1.2)
    scene = Prepared([ball_in_it, bowl()], bright, count=150, use_texture=False, others=[bright])
    y, x = np.mgrid[:32, :64]
    lamp = np.exp(-(((x - 14) / 6) ** 2) - ((y - 7) / 4) ** 2)
    sky = EnvironmentMaps((0.3 + 4 * lamp)[None, ..., None] * [1, 0.8, 0.6], ("sky",))
    single, many = (scene.reference(sky, samples=1024, bounces=n).radiance[:, 0] for n in (1, 6))
    indirect = Indirect(scene.tracer, [diffuse_albedo(bright)] * 2, sky, bounces=5)
    transport = Transport(scene.tracer, scene.points, directions=2048, millimetres_per_unit=MILLIMETRES)
    got = transport.radiance(bright, sky)[:, 0] + indirect.reflected(transport, bright)[:, 0]
    added = (many - single).mean()
    assert added > 0.1 * single.mean()
    assert abs((got - many).mean()) < 0.1 * added
    assert np.sqrt(((got - many) ** 2).mean()) < 0.05 * many.mean()


def test_whole_pictures_and_pixels_that_see_nothing():
    scene = Prepared([ball()], matte(), count=50, use_texture=False)
    everywhere = np.argwhere(np.ones((96, 96)))
    found = Reference(scene.job, scene.tracer, scene.materials).radiance(everywhere, SHBasis(0), samples=4)
    picture = found.radiance[:, 0].reshape(96, 96, 3)
    seen = camera_view(scene.tracer, scene.job).mesh == 0
    assert not picture[0, 0].any() and (picture[48, 48] > 0).all()
    assert ((picture > 0).all(-1) == seen).mean() > 0.97


def test_estimate_by_the_reference_finds_the_light_and_says_so(sphere_job_folder, capsys):
    """The whole command on a white ball; of order 1, which stands noise in the basis images."""
    folder, _ = sphere_job_folder
    light = np.array([[3, 2.5, 2], [0.5, 0, 0], [0.3, 0.8, 0.1], [-0.4, 0.2, 0.9]])
    known = Lighting(1, light, np.zeros((4, 3)), np.ones(4, bool), 0.0)
    write_lighting(folder / "known.json", known)
    white = ["--material", "reference/white-diffuse"]
    photo = ["--lighting", str(folder / "known.json"), "--out", str(folder / "photo.exr")]
    assert main(["relight", str(folder), *white, *photo]) == 0
    options = ["--order", "1", "--estimator", "least-squares", "--no-report", "--pixels", "600", "--bounces", "1"]
    options += ["--transport", "reference", "--samples", "256"]
    assert main(["estimate", str(folder), *white, *options]) == 0
    assert "by the reference: 256 paths" in capsys.readouterr().out
    record = json.loads((folder / "result" / "result.json").read_text())
    assert record["transport"]["by"] == record["settings"]["transport"] == "reference"
    assert 0.01 < record["transport"]["relative_noise"] < 0.2 and record["transport"]["seconds_per_light"] > 0
    found = read_lighting(folder / "result" / "lighting.json").coefficients
    assert np.linalg.norm(found - light) < 0.04 * np.linalg.norm(light)
    for wrong in (["--transport", "magic"], ["--samples", "1"]):
        assert main(["estimate", str(folder), *wrong]) == 2
