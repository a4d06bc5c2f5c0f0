# SPDX-License-Identifier: GPL-3.0-or-later
"""A light with several key lights renders as their sum: closed form on a matte ball, from the file on."""

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.btf.model import Lambertian
from btfsep_engine.commands.relight import lighting_of
from btfsep_engine.commands.report import render_objects
from btfsep_engine.light.files import Lighting, write_lighting
from btfsep_engine.light.sun import Sun
from tests.render.scenes import ball, job_of, looking_down, scene_of

SUNS = (
    Sun((0.6, 0.0, 0.8), (3.0, 2.0, 1.0), (0, 0, 0)),
    Sun((-0.6, 0.64, 0.48), (0.5, 1.0, 2.0), (0, 0, 0)),
    Sun((0.0, 0.0, -1.0), (9.0, 9.0, 9.0), (0, 0, 0)),  # lights what the camera does not see
)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_ball_under_several_suns(tmp_path, count):
    sky = np.zeros((25, 3))
    sky[0] = np.sqrt(4 * np.pi)  # radiance 1
    x = sky + sum(s.coefficients(4) for s in SUNS[:count])
    write_lighting(tmp_path / "l.json", Lighting(4, x, 0 * x, np.ones(25, bool), suns=SUNS[:count]))
    whole, rest, suns = lighting_of(tmp_path / "l.json")
    assert len(suns) == count and np.allclose(rest.coefficients, sky) and np.allclose(whole.coefficients, x)
    scene = scene_of(job_of([ball()], looking_down()))
    grey = Lambertian("test/grey", np.full(3, 0.3))
    image = render_objects(scene, [grey], rest, textured=False, directions=512, suns=suns)[0]
    points = scene.points(0, textured=False)
    seen = image[points.pixels[:, 0], points.pixels[:, 1]]
    lit = [np.maximum(points.normal @ s.direction, 0)[:, None] * s.irradiance for s in SUNS[:count]]
    truth = 0.3 / np.pi * (sh.irradiance(sky, points.normal) + sum(lit))
    clear = np.all([np.abs(points.normal @ s.direction) > 0.1 for s in SUNS], 0)  # elsewhere the mesh's facets decide
    assert clear.mean() > 0.5 and np.abs(seen[clear] / truth[clear] - 1).max() < 0.02
