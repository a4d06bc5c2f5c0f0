# SPDX-License-Identifier: GPL-3.0-or-later
"""Fuzz and coats on matte things of given numbers: photos made with one, jobs that say nothing of it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.materials import of_surface
from btfsep_engine.pipeline.refine import layers
from tests.render.given_things import LIGHT, SETTINGS, found_of, photo_maker
from tests.render.scenes import (
    egg_and_pebble,
    job_of,
    looking_down,
    off_as_seen,
    picture,
    scene_of,
    with_photo,
)

CLAY = Surface((0.3, 0.1, 0.08), roughness=0.8)


@pytest.fixture(scope="module")
def photographed():
    return photo_maker()


@pytest.fixture(autouse=True)
def most_are_asked(monkeypatch):
    """A light from one side imitates fuzz better than one from all sides does."""
    monkeypatch.setattr(layers, "LEFT", 0.02)


def test_cloth_that_is_said_to_be_matte_has_its_fuzz_found_and_the_light_with_it(photographed):
    velvet = replace(CLAY, sheen=(0.8, 0.7, 0.7), sheen_roughness=0.35)
    job = photographed(velvet)
    found, left = (found_of(job, CLAY, departures=departures) for departures in ("auto", "never"))
    assert f"on object 'object 0' lies {layers.FUZZ}" in found.choice[layers.LAYERED]
    assert found.choice[layers.LAYERED] in found.scene.reporter.warnings
    taken = found.materials[0].surface
    assert any(taken.sheen) and taken.base_color == CLAY.base_color and not taken.coat
    assert found.model.departed[0].surface == taken == found.model.problems[0].materials[0].surface
    assert layers.LAYERED not in left.choice and left.materials[0].surface is None
    assert found.fit.evidence > left.fit.evidence + layers.CLEARLY
    told = found_of(job, velvet)
    wrong, right, best = (off_as_seen(each.lighting.coefficients, LIGHT) for each in (left, found, told))
    assert right < 0.5 * wrong and right < best + 0.05
    assert layers.LAYERED not in told.choice  # it has one already


def test_of_an_object_with_an_image_of_its_colours_it_is_found_too(monkeypatch):
    monkeypatch.setattr(layers, "LEFT", 0.0)
    mesh = egg_and_pebble(3)
    mesh = replace(mesh, corner_uv=((mesh.vertices[:, :2] + 1) / 2.2)[mesh.faces])
    stripes = np.where(np.arange(64)[:, None] % 2, 1.0, 0.7) * np.array(CLAY.base_color)
    striped = replace(CLAY, image=np.broadcast_to(stripes, (64, 64, 3)).astype(np.float32))
    for velvet in (False, True):
        made = replace(striped, sheen=(1.0,) * 3, sheen_roughness=0.3) if velvet else striped
        job = job_of([mesh], looking_down())
        job = replace(job, objects=(replace(job.objects[0], surface=made, uv="mesh"),))
        scene = scene_of(job)
        points = scene.points(0, region=scene.view.mesh == 0, textured=True)
        material = of_surface(job.objects[0], job, SETTINGS)
        values = scene.radiance(points, material, SHLighting(LIGHT), directions=4096)[:, 0]
        found = found_of(with_photo(job, picture(points, values, noise=0.02)), striped)
        assert (layers.LAYERED in found.choice) is velvet
        assert off_as_seen(found.lighting.coefficients, LIGHT) < 0.03


def test_matte_things_without_a_layer_keep_to_what_is_said(photographed, monkeypatch):
    job = photographed(CLAY)
    assert layers.LAYERED not in found_of(job, CLAY).choice
    monkeypatch.setattr(layers, "LEFT", 0.03)
    monkeypatch.setattr(layers, "gains_on_a_few", lambda *_: pytest.fail("asked, though the light explains it"))
    found_of(job, CLAY)


def test_what_lies_on_a_surface():
    names = [what for what, _ in layers.layers_on(CLAY)]
    assert names == [layers.FUZZ, layers.FUZZ, layers.COAT]
    for _, surface in layers.layers_on(CLAY):
        assert (surface.base_color, surface.roughness) == (CLAY.base_color, CLAY.roughness)
        assert bool(surface.coat) != any(surface.sheen)
    for other in ({"roughness": 0.3}, {"metallic": 1.0}, {"coat": 0.5}, {"sheen": (0.1, 0.0, 0.0)}):
        assert layers.layers_on(replace(CLAY, **other)) == []


def test_little_left_over_is_not_asked_about(photographed, monkeypatch):
    monkeypatch.setattr(layers, "LEFT", 0.06)
    assert (
        layers.LAYERED not in found_of(photographed(replace(CLAY, sheen=(1.0,) * 3, sheen_roughness=0.3)), CLAY).choice
    )


@pytest.fixture(scope="module")
def badly_explained(photographed):
    """Model and light of a velvet, without its fuzz."""
    job = photographed(replace(CLAY, sheen=(1.0,) * 3, sheen_roughness=0.3))
    found = found_of(job, CLAY, departures="never")
    assert found.light.share_left(found.model.problems) > 0.03
    return found.model, found.light


@pytest.mark.parametrize(
    ("few", "gained", "grown", "is_taken"),
    [(6, 31, 0.9, True), (4, 31, 0.9, False), (6, 29, 0.9, False), (6, 31, 1.01, False)],
)
def test_a_layer_has_to_explain_more_of_few_pixels_and_of_all(
    badly_explained, monkeypatch, few, gained, grown, is_taken
):
    model, light = badly_explained
    model = replace(model, highlights=True)
    share = grown * light.share_left(model.problems)
    other = SimpleNamespace(fit=SimpleNamespace(evidence=light.fit.evidence + gained), share_left=lambda _: share)
    for layer, highlights in ((layers.COAT, False), (layers.FUZZ, True)):
        monkeypatch.setattr(
            layers,
            "gains_on_a_few",
            lambda *_, layer=layer: lambda s: few if bool(s.coat) == (layer is layers.COAT) else 0,
        )
        monkeypatch.setattr(layers, "on_all", lambda *_: (model, other))
        found = layers._layer(model, light, 0)
        assert (found is not None) == is_taken
        if is_taken:
            assert found[1:] == (other, layer) and found[0].highlights == highlights  # a coat explains them
