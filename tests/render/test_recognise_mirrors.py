# SPDX-License-Identifier: GPL-3.0-or-later
"""A mirror is known by looking as sharp as natural lights do; a metal that is not, is no mirror."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import SURFACES
from btfsep_engine.job.photograph import Photo
from btfsep_engine.light.lightings import EnvironmentMaps
from btfsep_engine.pipeline.recognition import recognise_object
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.verification import PLAIN
from btfsep_engine.progress import Reporter
from btfsep_engine.render.homogeneous import homogeneous
from tests.render.scenes import as_mesh, job_of, looking_down

CHROME = "reference/chrome"


def natural(seed: int) -> EnvironmentMaps:
    """A light whose logarithm has as much of every size, grey, brighter above: no map of the training."""
    random, shape = np.random.default_rng(seed), (128, 256)
    octaves = [
        gaussian_filter(random.standard_normal(shape), s, mode=("nearest", "wrap")) for s in (1, 2, 4, 8, 16, 32)
    ]
    log = sum(0.5 * octave / octave.std() for octave in octaves) + np.linspace(0.7, -0.7, shape[0])[:, None]
    return EnvironmentMaps(np.repeat(np.exp(log)[None, ..., None], 3, 3).astype(np.float32), ("natural",))


@pytest.fixture(scope="module")
def recognised():
    """What is said of a ball of a material, by the shipped library, under lights of `natural`."""
    ball = as_mesh(trimesh.creation.icosphere(5))
    scene = PreparedScene(job_of([ball], looking_down(size=160, focal=300.0)), Reporter())
    region = scene.regions[0]
    points = scene.points(0, region=region, textured=True)
    library, settings = open_library(), choose("draft", training_directions=128)

    def of(material, seed):
        values = scene.transport(points, directions=8192).radiance(material, natural(seed))[:, 0]
        image = np.zeros((*region.shape, 3), np.float32)
        image[tuple(points.pixels.T)] = values
        image *= np.random.default_rng(seed).normal(1, 0.005, image.shape).astype(np.float32)
        scene.job = replace(scene.job, photo=Photo(image, region, 0))
        return recognise_object(scene, 0, library, settings)

    return of


@pytest.mark.parametrize("seed", range(2))
def test_a_mirror_is_known(recognised, seed):
    found = recognised(open_library().load(CHROME), seed)
    assert found.material == CHROME and CHROME in found.likely


@pytest.mark.parametrize("seed", range(2))
def test_a_brushed_metal_is_no_mirror(recognised, seed):
    metal = homogeneous(replace(SURFACES["surface/metal"], roughness=0.4), "surface/metal")
    found = recognised(metal, seed)
    assert CHROME not in found.likely and dict(found.candidates)[CHROME] < 0.2
    assert set(found.likely) & set(PLAIN)
