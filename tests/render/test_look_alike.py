# SPDX-License-Identifier: GPL-3.0-or-later
"""Of a texture that nobody measured: what stands for it, and how much more is stated of its light."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import GIVEN, SURFACES, Surface
from btfsep_engine.pipeline import like_pixels, recognition
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.like_pixels import is_grainy, is_textured
from btfsep_engine.pipeline.materials import STRANGE, ObjectMaterial
from btfsep_engine.pipeline.model import Model
from btfsep_engine.pipeline.recognition import recognise_object, without_metal
from btfsep_engine.pipeline.refine.look_alike import BY_NUMBERS, GUESSED, LOOK_ALIKE, _factor, look_alike
from btfsep_engine.progress import Reporter
from btfsep_engine.recognise.recogniser import Recognition
from btfsep_engine.render.homogeneous import homogeneous
from tests.render.scenes import egg_and_pebble
from tests.render.test_like_pixels import SETTINGS, WHITE, of_mesh

PLASTIC, METAL, LEATHER = "surface/plastic", "surface/metal", "leather/brown-grain"
SCORES = ((METAL, 0.5), (LEATHER, 0.2), ("surface/matte", 0.18), (PLASTIC, 0.12))


@pytest.fixture(scope="module")
def photographed():
    """{is textured: PreparedScene} of the same objects in the same light."""
    return {texture > 0.05: of_mesh(egg_and_pebble(), texture=texture, coarse=0.8)[0].scene for texture in (0.01, 0.3)}


def widths(found) -> np.ndarray:
    return np.ptp(found.lighting.interval, 0)


@pytest.mark.parametrize(("textured", "name"), [(True, PLASTIC), (False, PLASTIC), (True, "reference/white-diffuse")])
def test_ranges_are_wider_where_a_surface_without_texture_stands_for_one_that_has(photographed, textured, name):
    scene, library = photographed[textured], open_library(None)
    scene.reporter = Reporter()
    found = estimate(scene, library, SETTINGS, material=name)
    model = found.model
    _, same, words = look_alike(model, found.light)  # once more: of the same model the answer is the same
    wider = textured and name == PLASTIC
    assert (LOOK_ALIKE in found.choice) is (LOOK_ALIKE in words) is wider
    assert any("not known how it reflects" in said for said in scene.reporter.warnings) is wider
    factor = np.ptp(same.fit.interval, 0) / widths(found)
    np.testing.assert_allclose(factor, GUESSED if wider else 1, rtol=1e-6)
    np.testing.assert_array_equal(same.fit.coefficients, found.fit.coefficients)


def test_of_noise_as_much_is_stated_and_not_that_it_is_a_texture(photographed):
    grainy = of_mesh(egg_and_pebble(), texture=0.1)[0].scene
    assert is_textured(grainy, 0, seed=0) and is_grainy(grainy, 0) and not is_grainy(photographed[True], 0)
    found = estimate(grainy, open_library(None), SETTINGS, material=PLASTIC)
    said = found.choice[LOOK_ALIKE]
    assert "is grainy where it shows object" in said and "texture of" not in said and f"{GUESSED:g} times" in said
    assert said in grainy.reporter.warnings
    # a material that was recognised and is strange is a doubt of its own
    strange = made_of(open_library(None).load(LEATHER), is_given=False, likely=(LEATHER,), unknown_score=2 * STRANGE)
    _, _, words = look_alike(replace(found.model, materials=([strange],)), found.light)
    assert "a texture of object" in words[LOOK_ALIKE] and "grainy" not in words[LOOK_ALIKE]


def test_noise_is_told_by_a_part_of_a_large_photo(photographed, monkeypatch):
    """By what lies about the object's middle: the rest may be anything."""
    monkeypatch.setattr(like_pixels, "LOOKED_AT", 64)
    scene = copy(of_mesh(egg_and_pebble(), texture=0.1)[0].scene)
    image, smooth = scene.job.photo.radiance.copy(), photographed[False].job.photo.radiance
    row, column = np.median(np.nonzero(scene.regions[0]), axis=1).astype(int)
    inside = np.zeros(image.shape[:2], bool)
    inside[row - 32 : row + 32, column - 32 : column + 32] = True
    for there in (inside, ~inside):
        scene.job = replace(
            scene.job, photo=replace(scene.job.photo, radiance=np.where(there[..., None], image, smooth))
        )
        assert is_grainy(scene, 0) is bool(there[row, column])


def made_of(material, **changes) -> ObjectMaterial:
    return ObjectMaterial(material.name, material, **({"is_given": True} | changes))


def factors() -> list:
    leather, surface = open_library(None).load(LEATHER), homogeneous(SURFACES[PLASTIC], PLASTIC)
    seen = {"is_given": False, "likely": (LEATHER,)}
    return [
        (made_of(leather), 1.0),
        (made_of(leather, **seen, unknown_score=0.9 * STRANGE), 1.0),
        (made_of(leather, **seen, unknown_score=1.1 * STRANGE), GUESSED),
        (made_of(surface, is_given=False, unknown=True), GUESSED),
        (made_of(surface), GUESSED),
        (made_of(surface, mirror=Surface(metallic=1)), 1.0),
        (made_of(homogeneous(Surface((0.2, 0.3, 0.1)), GIVEN)), BY_NUMBERS),
        (made_of(WHITE), 1.0),
    ]


@pytest.mark.parametrize(("material", "factor"), factors())
def test_how_much_wider_goes_by_what_is_known_of_the_material(photographed, material, factor):
    found = estimate(photographed[True], open_library(None), SETTINGS, material="reference/white-diffuse")
    model: Model = replace(found.model, materials=([material],))
    _, light, words = look_alike(model, found.light)
    np.testing.assert_allclose(np.ptp(light.fit.interval, 0), factor * np.ptp(found.light.fit.interval, 0), rtol=1e-6)
    assert (f"{factor:g} times as wide" in words.get(LOOK_ALIKE, "")) is (factor > 1)


def test_textures_are_told_from_smooth_photos(photographed):
    assert is_textured(photographed[True], 0, seed=0) and not is_textured(photographed[False], 0, seed=0)


@pytest.mark.parametrize("textured", [True, False])
def test_textures_are_told_by_what_is_usable_of_a_photo_and_be_it_little(photographed, textured):
    scene = copy(photographed[textured])
    photo = scene.job.photo
    row, column = scene.points(0, textured=False).pixels.mean(0).astype(int)
    usable = np.zeros_like(photo.usable)
    usable[row - 3 : row + 3, column - 3 : column + 3] = True  # of 34 000 pixels
    image = np.where(usable[..., None], photo.radiance, np.nan)
    scene.job = replace(scene.job, photo=replace(photo, radiance=image, usable=usable))
    assert [is_textured(scene, 0, seed=seed) for seed in range(3)] == [textured] * 3


@pytest.mark.parametrize("textured", [True, False])
def test_no_metal_alike_all_over_stands_for_what_has_a_texture(photographed, textured, monkeypatch):
    scene = photographed[textured]
    scene.reporter = Reporter()
    strange = Recognition(LEATHER, SCORES, True, 2.0, (METAL,), METAL)
    monkeypatch.setattr(recognition, "trained_recogniser", lambda *_: None)
    monkeypatch.setattr(recognition, "Verification", lambda *_: None)
    monkeypatch.setattr(recognition, "recognised", lambda *_, **__: strange)
    answer = recognise_object(scene, 0, open_library(None), SETTINGS)
    assert answer.stand_in == ("surface/matte" if textured else METAL)
    assert answer.likely == (() if textured else (METAL,)) and answer.candidates == SCORES
    assert any(answer.stand_in in said for said in scene.reporter.warnings)


def test_without_metal_the_next_is_named():
    known = Recognition(METAL, SCORES, False, 0.5, (METAL, LEATHER), None)
    assert without_metal(known) == replace(known, material=LEATHER, likely=(LEATHER,))
    plain = replace(known, candidates=(SCORES[0], SCORES[2], SCORES[1]))  # the likelier one is ruled out
    assert without_metal(plain) == replace(plain, material=LEATHER, likely=(LEATHER,))
    assert without_metal(replace(plain, likely=None)) == replace(plain, material="surface/matte", likely=None)
    unsaid = replace(known, material=LEATHER, likely=None)
    assert without_metal(unsaid) == unsaid


def test_of_a_surface_given_with_its_image_the_texture_is_known():
    """Of numbers alone it is another surface, alike all over, that stands for it."""
    alike = homogeneous(Surface((0.2, 0.3, 0.1)), GIVEN)
    of_image = replace(alike, texels=np.array([[[0.8], [1.2]]], np.float32), laid_mean=np.ones(1, np.float32))
    assert _factor(made_of(alike)) == BY_NUMBERS and _factor(made_of(of_image)) == 1
