# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the photo shows the object elsewhere than the geometry, ranges are wider, and the light is the same."""

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.model import Lambertian
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline import estimation
from btfsep_engine.pipeline.basis import basis_images
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from tests.render.scenes import as_mesh, job_of, looking_down, picture, positive_light, scene_of, with_photo

pytestmark = pytest.mark.usefixtures("no_parts_with_edges")


def photographed(shift: int) -> PreparedScene:
    """A white ball before black, its photo ``shift`` pixels to the right."""
    mesh = as_mesh(trimesh.creation.icosphere(subdivisions=4, radius=0.6))
    job = job_of([mesh], looking_down())
    scene = scene_of(job)
    points = scene.points(0, textured=False)
    light = SHLighting(positive_light(2))
    settings = choose("draft", bounces=1)
    seen = basis_images(scene, [Lambertian("white", np.full(3, 0.8))], [points], light, settings)[0][0][:, 0]
    return scene_of(with_photo(job, np.roll(picture(points, seen), shift, axis=1)))


@pytest.mark.parametrize("shift", [0, 4])
def test_ranges_are_twice_as_wide_where_the_outlines_lie_elsewhere(shift):
    found = []
    for refinements in (estimation.REFINEMENTS[:-1], estimation.REFINEMENTS):
        how = {"material": "reference/white-diffuse", "refinements": refinements}
        settings = choose("draft", key_light="never")
        found.append(estimation.estimate(photographed(shift), open_library(None), settings, **how))
    without, wider = (f.lighting for f in found)
    np.testing.assert_array_equal(wider.coefficients, without.coefficients)
    factor = 2 if shift else 1
    np.testing.assert_allclose(np.ptp(wider.interval, 0), factor * np.ptp(without.interval, 0), rtol=1e-6)
    np.testing.assert_allclose(wider.stddev, factor * without.stddev, rtol=1e-6)
    assert ("stated" in found[1].choice) == bool(shift)
    assert any("line up" in text for text in found[1].scene.reporter.warnings) == bool(shift)
