# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights without extent leave no noise: kernel and reference must be equal to rounding.

So every convention is compared: charts, mirrored charts, tangents, sides, texels, shadows.
"""

import numpy as np
import pytest

from btfsep_engine.btf.model import Lambertian
from btfsep_engine.light.point_lights import DirectionalLights, PointLights
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.progress import Reporter
from btfsep_engine.render.point_transport import point_radiance
from tests.render.btf_materials import glossy, matte, textured
from tests.render.prepared import MILLIMETRES, Prepared, ball, plate, sheet

LAMPS = DirectionalLights(
    [[0.3, 0.1, 1], [-0.8, 0.3, 0.6], [0.2, -0.9, 0.3], [0.1, 0.6, -0.7]],
    [[1, 2, 3], [2, 2, 2], [3, 1, 1], [1, 1, 1]],
)


def same_to_rounding(scene, lights):
    expected = point_radiance(scene.tracer, scene.points, scene.material, lights, millimetres_per_unit=MILLIMETRES)
    found = scene.reference(lights, samples=2)
    got = found.radiance
    scale = np.abs(expected).max((0, 2))
    error = np.abs(got - expected).max(-1) / np.maximum(scale, 1e-6)
    # a ray beside a pixel's centre by a thousandth, and starts off the surface: some points change into the shade
    assert (error > 2e-3).mean() < 0.01, (error > 2e-3).mean()
    return expected


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
    lamps = DirectionalLights(np.stack([np.cos(turn), np.sin(turn), np.full(8, 0.2)], -1), np.ones((8, 3)))
    shown = same_to_rounding(scene, lamps)
    towards = lamps.directions.T
    doubtful = (scene.points.normal @ towards > 0.02) & (scene.points.flat_normal @ towards < 0)
    assert doubtful.mean() > 0.03 and not shown[doubtful].any()


def test_points_light_a_ball_with_charts_and_cast_the_same_shadows():
    scene = Prepared([ball()], textured(), count=1500, use_texture=True, occluders=[plate()])
    lights = PointLights([[2.5, 0.3, 2.6], [0.2, -1.8, 1.2], [0.0, 0.0, 9.0]], [[5, 5, 5], [1, 2, 3], [80, 40, 20]])
    shown = same_to_rounding(scene, lights)
    free = Prepared([ball()], textured(), count=1500, use_texture=True)
    unshadowed = point_radiance(free.tracer, free.points, textured(), lights, millimetres_per_unit=MILLIMETRES)
    assert 0.05 < ((shown[:, 0] == 0) & (unshadowed[:, 0] != 0)).all(-1).mean() < 0.95


def test_points_far_away_are_directions():
    scene = Prepared([ball()], glossy(), count=300, use_texture=False)
    away = 1e4 * LAMPS.directions
    far, at = (
        point_radiance(scene.tracer, scene.points, scene.material, lights, millimetres_per_unit=MILLIMETRES)
        for lights in (PointLights(away, 1e8 * LAMPS.irradiances), LAMPS)
    )
    assert far == pytest.approx(at, abs=2e-3 * at.max())


def test_a_prepared_scene_takes_lamps_as_it_takes_skies():
    scene = Prepared([ball()], glossy(), count=200, use_texture=False)
    prepared = PreparedScene(scene.job, Reporter())
    got = prepared.radiance(scene.points, scene.material, LAMPS, directions=64)
    expected = point_radiance(scene.tracer, scene.points, scene.material, LAMPS, millimetres_per_unit=MILLIMETRES)
    assert got.shape == (200, 4, 3) and got.any()
    assert got == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(
    ("make", "wrong"),
    [
        (PointLights, ([[0, 0]], [[1, 1, 1]])),
        (PointLights, ([[0, 0, 1]], [[1, 1, 1], [1, 1, 1]])),
        (PointLights, ([[0, 0, np.nan]], [[1, 1, 1]])),
        (DirectionalLights, ([[0, 0, 0]], [[1, 1, 1]])),
    ],
)
def test_lamps_that_cannot_be_are_refused(make, wrong):
    with pytest.raises(ValueError, match=r"shape|length"):
        make(*wrong)
