# SPDX-License-Identifier: GPL-3.0-or-later
"""Recognition trained on the transport's own renders, tested under another light."""

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter

from btfsep_engine.btf.directions import ubo2014_directions
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.light.lightings import EnvironmentMaps
from btfsep_engine.recognise import descriptors, training
from btfsep_engine.recognise.vlad import Encoding
from tests.render.scenes import as_mesh, job_of, looking_down, scene_of

GRAIN = {"made/fine": 0.7, "made/coarse": 3.0, "made/flat": None}


def material(name):
    """Matte texels of one grain: (48, 48, 1) times a constant ABRDF."""
    noise = np.random.default_rng(3).standard_normal((48, 48))
    smooth = noise * 0 if GRAIN[name] is None else gaussian_filter(noise, GRAIN[name], mode="wrap")
    texels = np.exp(0.4 * smooth / max(smooth.std(), 1e-9))[..., None].astype(np.float32)
    directions = ubo2014_directions()
    angular = np.full((len(directions), len(directions), 3, 1), 0.3 / np.pi, np.float32)
    return Tabulated(name, "made", texels, angular, directions, directions, 1.0)


def lights(seed, count):
    """Maps with a bright spot somewhere above, each tinted."""
    rng = np.random.default_rng(seed)
    maps = np.full((count, 16, 32, 3), 0.2)
    for one in maps:
        one[rng.integers(0, 5), rng.integers(0, 32)] += 20
        one *= np.exp(rng.uniform(-0.3, 0.3, 3))
    return EnvironmentMaps(maps.astype(np.float32), tuple(f"map {seed}.{i}" for i in range(count)))


@pytest.fixture(scope="module")
def rendered():
    """region (h, w) and render(material, lightings) -> (M, h, w, 3), NaN outside."""
    job = job_of([as_mesh(trimesh.creation.icosphere(4))], looking_down(size=160, focal=300.0))
    scene = scene_of(job)
    region = scene.regions[0]
    points = scene.points(0, region=region, textured=True)
    transport = scene.transport(points, directions=128)

    def render(one, lightings):
        images = np.full((lightings.count, *region.shape, 3), np.nan, np.float32)
        values = transport.radiance(one, lightings)
        images[:, points.pixels[:, 0], points.pixels[:, 1]] = values.transpose(1, 0, 2)
        return images

    return region, render


@pytest.mark.parametrize("classifier", ["svm", "nearest"])
def test_materials_are_recognised_under_other_lights(rendered, classifier):
    region, render = rendered
    natural, other = lights(1, 5), lights(2, 3)
    samples = training.render_samples(
        [material(n) for n in GRAIN], list(natural.names), lambda one: render(one, natural), region
    )
    recogniser = training.train(
        samples,
        classifier=classifier,
        method=training.Method(
            descriptors.Settings(target=250), Encoding(colour_words=20, sift_words=30, sift_components=16)
        ),
    )
    assert set(recogniser.materials) == set(GRAIN)
    for name in GRAIN:
        for image in render(material(name), other):
            assert recogniser.judged(recogniser.describe(5 * image, region)).material == name


def test_a_wrong_number_of_images_is_a_bug(rendered):
    region, _ = rendered
    with pytest.raises(ValueError, match="2 images"):
        next(
            training.render_samples([material("made/flat")], ["one"], lambda _: np.zeros((2, *region.shape, 3)), region)
        )
