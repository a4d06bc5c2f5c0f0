# SPDX-License-Identifier: GPL-3.0-or-later
"""Beams of parallel light leave no noise: kernel and reference must be equal to rounding.

So every convention is compared: charts, mirrored charts, tangents, sides, texels, shadows.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine.btf.model import Lambertian
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.render.arrays import mi
from btfsep_engine.render.beams import beam_radiance, lamp_radiance
from btfsep_engine.render.homogeneous import homogeneous
from btfsep_engine.render.reference import Reference
from tests.render.btf_materials import glossy, matte, textured
from tests.render.prepared import MILLIMETRES, Prepared, sheet
from tests.render.scenes import ball, plate

LAMPS = np.array([[0.3, 0.1, 1], [-0.8, 0.3, 0.6], [0.2, -0.9, 0.3], [0.1, 0.6, -0.7]])
LAMPS /= np.linalg.norm(LAMPS, axis=1, keepdims=True)


class LampReference(Reference):
    """The reference under lamps without extent, given by their ``directions`` (M, 3); unit irradiance."""

    def _lit_scenes(self, lamps):
        for number, towards in enumerate(lamps.directions):
            lamp = {"type": "directional", "direction": (-towards).tolist()}
            lamp["irradiance"] = {"type": "rgb", "value": [1.0, 1.0, 1.0]}
            yield number, 1, mi.load_dict({"type": "scene", "light": lamp, **self._shapes})


def by_kernel(scene, directions):
    return beam_radiance(scene.tracer, scene.points, scene.material, directions, millimetres_per_unit=MILLIMETRES)


def same_to_rounding(scene, directions):
    expected = by_kernel(scene, directions)
    traced = LampReference(scene.job, scene.tracer, scene.materials, textured=scene.textured)
    lamps = SimpleNamespace(directions=directions, count=len(directions))
    got = traced.radiance(scene.points.pixels, lamps, samples=2, jitter=False).radiance
    scale = np.abs(expected).max((0, 2))
    error = np.abs(got - expected).max(-1) / np.maximum(scale, 1e-6)
    # a ray beside a pixel's centre by a thousandth, and starts off the surface: some points change into the shade
    assert (error > 2e-3).mean() < 0.01, (error > 2e-3).mean()
    return expected


def test_a_surface_by_numbers_shows_beams_its_own_brdf_and_their_shadows():
    """As bright as its table makes it where light comes steeply, but for the table's width; dark where that is."""
    surface = homogeneous(Surface((0.6, 0.3, 0.2), roughness=0.8), "surface/x")
    table = replace(surface, surface=None)

    def shown(material):
        scene = Prepared([ball(), plate()], material, count=400, use_texture=False, others=[material])
        return by_kernel(scene, LAMPS)

    exact, by_table = shown(surface), shown(table)
    assert (exact == 0).any() and not np.array_equal(exact, by_table)
    np.testing.assert_array_equal(exact > 0, by_table > 0)
    np.testing.assert_allclose(exact[:, 0], by_table[:, 0], rtol=0.05, atol=0.01)
    layered = homogeneous(Surface((0.6, 0.3, 0.2), roughness=0.8, coat=0.5), "surface/x")
    np.testing.assert_array_equal(shown(layered), shown(replace(layered, surface=None)))


class NearReference(Reference):
    """The reference under lamps at ``places`` (M, 3); unit intensity, in the tracer's own unit of length."""

    def _lit_scenes(self, lamps):
        for number, place in enumerate(self.tracer.to_local(lamps.places)):
            lamp = {"type": "point", "position": place.tolist(), "intensity": {"type": "rgb", "value": [1.0] * 3}}
            yield number, 1, mi.load_dict({"type": "scene", "light": lamp, **self._shapes})


@pytest.mark.parametrize("material", [glossy(), Lambertian("white", np.full(3, 0.8))])
def test_a_lamp_nearby_lights_as_a_point_light_does(material):
    scene = Prepared([ball()], material, count=1500, use_texture=False, occluders=[plate()])
    place = np.array([2.0, 0.3, 2.6])
    shown = lamp_radiance(scene.tracer, scene.points, scene.material, place, millimetres_per_unit=MILLIMETRES)
    distance = np.linalg.norm(place - scene.points.position, axis=1) / scene.tracer.radius
    expected = shown / distance[:, None] ** 2
    traced = NearReference(scene.job, scene.tracer, scene.materials, textured=scene.textured)
    lamps = SimpleNamespace(places=place[None], count=1)
    got = traced.radiance(scene.points.pixels, lamps, samples=2, jitter=False).radiance[:, 0]
    error = np.abs(got - expected).max(1) / expected.max()
    assert (error > 2e-3).mean() < 0.01 and 0.2 < (expected > 0).all(1).mean() < 1
    # what stands beyond the lamp casts no shadow
    behind = Prepared([ball()], material, count=1500, use_texture=False, occluders=[plate(9.0, 5.0)])
    again = lamp_radiance(behind.tracer, scene.points, scene.material, place, millimetres_per_unit=MILLIMETRES)
    assert (again >= shown - 1e-6).all()


@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
def test_lamps_see_the_same_material_on_every_side_of_every_chart(mirrored, back):
    """An anisotropic texture on the file's own UV; the fourth lamp is behind the sheet."""
    scene = Prepared([sheet(mirrored=mirrored, back=back)], textured(), count=1500, use_texture=True, uv="mesh")
    shown = same_to_rounding(scene, LAMPS)
    assert (shown[:, :3] != 0).mean() > 0.6
    assert not shown[:, 3].any()


@pytest.mark.parametrize("material", [glossy(), matte(), Lambertian("white", np.full(3, 0.8))])
def test_lamps_see_the_same_mean_material_with_tangents_by_the_vertical(material):
    same_to_rounding(Prepared([ball()], material, count=1500, use_texture=False), LAMPS)


def test_light_from_behind_a_face_does_not_arrive_whatever_the_shading_normal_says():
    """A coarse open sheet with smooth normals under grazing lamps: nothing else would hold the light off."""
    scene = Prepared([sheet(n=6)], matte(), count=1500, use_texture=False)
    turn = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    lamps = np.stack([np.cos(turn), np.sin(turn), np.full(8, 0.2)], -1) / np.hypot(1, 0.2)
    shown = same_to_rounding(scene, lamps)
    doubtful = (scene.points.normal @ lamps.T > 0.02) & (scene.points.flat_normal @ lamps.T < 0)
    assert doubtful.mean() > 0.03 and not shown[doubtful].any()


def test_lamps_light_a_ball_with_charts_and_cast_the_same_shadows():
    scene = Prepared([ball()], textured(), count=1500, use_texture=True, occluders=[plate()])
    lamps = np.array([[2.5, 0.3, 2.6], [1.5, 0.2, 2.6], [0.9, -0.3, 2.0]])
    lamps /= np.linalg.norm(lamps, axis=1, keepdims=True)
    shown = same_to_rounding(scene, lamps)
    free = by_kernel(Prepared([ball()], textured(), count=1500, use_texture=True), lamps)
    assert 0.05 < ((shown[:, 0] == 0) & (free[:, 0] != 0)).all(-1).mean() < 0.95
