# SPDX-License-Identifier: GPL-3.0-or-later
"""What a surface leaves out is said and widens what is stated; of a sheen no pixel at a slant is fitted."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import GIVEN, Surface
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline import points
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.render.homogeneous import homogeneous
from tests.render.scenes import as_mesh, job_of, looking_down, picture, positive_light, scene_of, with_photo

MATTE = Surface((0.5, 0.4, 0.3), roughness=1.0, specular=0.0)


def photographed(**more):
    """The scene of a matte ball whose job says ``more`` of its surface."""
    mesh = as_mesh(trimesh.creation.icosphere(subdivisions=4, radius=0.6))
    job = job_of([mesh], looking_down())
    scene = scene_of(job)
    seen = scene.points(0, textured=False)
    values = scene.radiance(seen, homogeneous(MATTE, GIVEN), SHLighting(positive_light(2)), directions=256)[:, 0]
    thing = replace(job.objects[0], surface=replace(MATTE, **more))
    return scene_of(with_photo(replace(job, objects=(thing,)), picture(seen, values, noise=0.01)))


def test_what_is_left_out_is_said_and_stated_wider():
    settings = choose("draft", key_light="never")
    whole, less = (
        estimate(photographed(left_out=words), open_library(None), settings) for words in ((), ("its hair", "its dust"))
    )
    np.testing.assert_array_equal(whole.lighting.coefficients, less.lighting.coefficients)
    np.testing.assert_allclose(less.lighting.stddev, 2 * whole.lighting.stddev, rtol=1e-6)
    said = [text for text in less.scene.reporter.warnings if "its hair, its dust" in text]
    assert len(said) == 1 and "2 times as wide" in said[0]
    assert not any("left out" in text for text in whole.scene.reporter.warnings)
    named = estimate(photographed(left_out=("its hair",)), open_library(None), settings, material="surface/matte")
    assert not any("its hair" in text for text in named.scene.reporter.warnings)


@pytest.mark.parametrize("sheen", [0.0, 0.5])
def test_a_sheens_pixels_face_the_camera(sheen):
    found = estimate(photographed(sheen=(sheen,) * 3), open_library(None), choose("draft", key_light="never"))
    (chosen,) = found.model.problems[0].points
    steepest = (chosen.normal * chosen.to_eye).sum(1).min()
    assert (steepest > points.SLANT) == (sheen > 0)
