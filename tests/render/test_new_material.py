# SPDX-License-Identifier: GPL-3.0-or-later
"""A new kind of material, which nothing in the engine knows: names and values are all that it gives."""

from dataclasses import dataclass

import numpy as np
import pytest

from btfsep_engine.btf import checks, library, thumbnail
from btfsep_engine.btf.departures import departures
from btfsep_engine.btf.directions import hemisphere_quadrature
from btfsep_engine.btf.model import Lambertian, Material
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.render.appearance import to_local
from tests.render.prepared import Prepared
from tests.render.scenes import ball, positive_light

NAME = "test/sheen"


@dataclass(frozen=True)
class Sheen(Material):
    """A wide lobe about the mirror direction (Phong's) over a matte base."""

    name: str = NAME
    material_class: str = "test"

    def abrdf(self, position_mm, to_light, to_eye):
        mirrored = to_light * [-1, -1, 1]
        lobe = np.maximum((mirrored * to_eye).sum(-1), 0)[:, None] ** 3
        dimmer_from_aside = 0.5 + 0.5 * to_eye[:, 2:]  # not reciprocal: eye and light cannot be taken for each other
        return np.array([0.3, 0.2, 0.1]) / np.pi * dimmer_from_aside + 0.05 * lobe


@pytest.fixture(scope="module")
def scene():
    return Prepared([ball()], Sheen(), count=60, use_texture=False)


def test_the_transport_shows_its_values(scene):
    light, directions = SHLighting(positive_light(2)), fibonacci_sphere(20000)
    points, found = scene.points, scene.kernel(light)[:, 0]
    seen = light.radiance(directions)[:, 0]
    for i in range(0, len(points), 9):
        here = points.take(np.full(len(directions), i))
        local, eye = to_local(here, directions), to_local(here, here.to_eye)
        up = local[:, 2] > 0
        values = Sheen().abrdf(np.zeros((up.sum(), 2)), local[up], eye[up]) * local[up, 2:]
        expected = (values * seen[up]).sum(0) * 4 * np.pi / len(directions)
        np.testing.assert_allclose(found[i], expected, rtol=0.01)


def test_the_path_tracer_shows_the_same(scene):
    light = SHLighting(positive_light(2))
    traced = scene.reference(light, samples=1024).radiance
    assert np.linalg.norm(traced - scene.kernel(light)) < 0.02 * np.linalg.norm(traced)


def test_a_library_that_names_it_has_it_in_every_way(monkeypatch):
    monkeypatch.setitem(library.REFERENCE, NAME, Sheen())
    opened = library.open_library()
    assert NAME in opened.names() and checks.check(opened, NAME)["ok"]
    nodes, weights = hemisphere_quadrature(24)
    cosine = weights * nodes[:, 2]
    n = len(nodes)
    pairs = Sheen().abrdf(np.zeros((n * n, 2)), np.tile(nodes, (n, 1)), np.repeat(nodes, n, 0)).reshape(n, n, 3)
    exact = np.einsum("vlc,v,l->c", pairs, cosine, cosine) / np.pi
    np.testing.assert_allclose(opened.show(NAME)["mean_albedo"], exact, atol=3e-3)


def test_pictures_and_rougher_or_glossier_ones_follow():
    picture = thumbnail.render(Sheen(), 32)
    matte = thumbnail.render(Lambertian("test/matte", np.array([0.3, 0.2, 0.1])), 32)
    assert picture.max() > 1.1 * matte.max() and (picture < 2 * matte.max()).all()
    assert [near.material.material_class for near in departures(Sheen())] == ["test", "test"]
