# SPDX-License-Identifier: GPL-3.0-or-later
"""A photo without colours: when it is one, what materials are then, and what the light is taken for."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.model import Mirror
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.conventions import REC709_LUMINANCE, grey
from btfsep_engine.imaging.srgb import linear_to_srgb, srgb_to_linear
from btfsep_engine.job.model import Occluder, Photo
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline import estimation
from btfsep_engine.pipeline.black_and_white import is_black_and_white, without_colours
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.following import Follower
from btfsep_engine.pipeline.recognition import recognise_object
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from btfsep_engine.render.homogeneous import homogeneous
from scripts.studies.measures import errors
from tests.render.scenes import as_mesh, job_of, looking_down, positive_light

TEAL, BROWN, GREEN = "wallpaper/damask-teal", "leather/brown-grain", "felt/green-coarse"
SAID = "the photo is black and white"


@pytest.fixture(scope="module")
def library():
    """Three materials of strong colours."""
    shipped = open_library()
    return replace(shipped, entries={name: shipped.entries[name] for name in (TEAL, BROWN, GREEN)})


@pytest.fixture
def scene():
    ball = as_mesh(trimesh.creation.icosphere(4))
    return PreparedScene(job_of([ball], looking_down(size=160, focal=300.0)), Reporter())


def shown(scene, material, light, *, noise=0.02):
    """The scene with a photo in colours of its object in a material under light (terms, 3)."""
    points = scene.points(0, textured=True)
    pixels = scene.transport(points, directions=256).radiance(material, SHLighting(light))[:, 0]
    image = np.zeros((*scene.regions[0].shape, 3), np.float32)
    image[scene.regions[0]] = pixels
    image *= 1 + noise * np.random.default_rng(1).standard_normal(image.shape)
    return with_photo(scene, image.astype(np.float32))


def with_photo(scene, image):
    out = PreparedScene(scene.job, Reporter())
    out.job = replace(scene.job, photo=Photo(image, np.isfinite(image).all(-1), 0))
    return out


def test_a_photo_is_black_and_white_where_no_pixel_has_a_colour():
    rng = np.random.default_rng(0)
    image = rng.uniform(0.02, 1, (40, 40, 3)).astype(np.float32) ** 2

    def said(radiance, usable=None):
        usable = np.ones(radiance.shape[:2], bool) if usable is None else usable
        return is_black_and_white(Photo(radiance.astype(np.float32), usable, 0))

    assert said(grey(image)) and not said(image) and not said(grey(image) * [1.1, 1.0, 0.8])
    assert not said(np.zeros_like(image)) and not said(np.full_like(image, np.nan), np.zeros((40, 40), bool))
    one = grey(image)
    one[:20, :20] = image[:20, :20]  # a red flower in a grey picture
    assert not said(one) and said(one, np.arange(40)[:, None] + np.zeros(40) >= 20)
    coded = cv2.imencode(".jpg", (linear_to_srgb(grey(image)) * 255).round().astype(np.uint8))[1]
    assert said(srgb_to_linear(cv2.imdecode(coded, cv2.IMREAD_COLOR) / 255))


def test_without_colours_everything_is_of_its_luminance(library):
    """What it reflects of grey light, seen in luminance, in all three channels."""
    rng = np.random.default_rng(0)
    to_light, to_eye = (np.abs(v) / np.linalg.norm(v, axis=1)[:, None] for v in rng.normal(size=(2, 50, 3)))
    places = rng.uniform(0, 30, (50, 2))
    matte = homogeneous(Surface((0.7, 0.2, 0.1)), "surface/given")
    for material in (*map(library.load, (TEAL, BROWN)), library.load("reference/white-diffuse"), matte):
        values, found = (m.abrdf(places, to_light, to_eye) for m in (material, material.without_colours()))
        assert np.allclose(found, (values @ REC709_LUMINANCE)[:, None], rtol=1e-4, atol=1e-7)
        assert material.without_colours().name == material.name
    numbers = matte.without_colours().surface
    assert np.allclose(homogeneous(numbers, "x").diffuse_albedo(), matte.without_colours().diffuse_albedo(), rtol=1e-4)
    assert np.ptp(Mirror("m", np.array([1.0, 0.8, 0.3])).without_colours().reflectance) == 0
    image = Surface(image=rng.uniform(0, 1, (4, 4, 3)).astype(np.float32), sheen=(0.1, 0.2, 0.3)).without_colours()
    assert np.ptp(image.image, axis=-1).max() == np.ptp(image.sheen) == 0


def test_a_library_without_colours_is_another_one_of_the_same_names(library):
    one = library.without_colours()
    assert one.names() == library.names() and one.digest != library.digest
    assert one.content(TEAL) != library.content(TEAL) and one.without_colours().digest == one.digest
    assert np.ptp(one.load(TEAL).diffuse_albedo()) < 1e-6 < 0.01 < np.ptp(library.load(TEAL).diffuse_albedo())
    assert one.load(TEAL) is one.load(TEAL)


@pytest.mark.parametrize("name", (TEAL, BROWN))
def test_the_light_of_a_black_and_white_photo_is_grey(monkeypatch, scene, library, name):
    """And as right as that of the photo in colours; taken for a photo in colours it would be of the other colour."""
    light, settings = grey(positive_light(4, seed=3)), choose("draft")
    in_colours = shown(scene, library.load(name), light)
    without = with_photo(scene, grey(in_colours.job.photo.radiance))
    known, found = (estimate(each, library, settings, material=name) for each in (in_colours, without))
    right, grey_right = (errors(f.fit.coefficients, light)["order2"] for f in (known, found))
    assert np.ptp(found.fit.coefficients, axis=1).max() < 0.01 * np.abs(found.fit.coefficients).max()
    assert grey_right < 1.2 * right + 0.01 < 0.3
    assert found.choice["colour"].startswith(SAID) and not known.choice["colour"].startswith(SAID)
    assert sum(SAID in said for said in without.reporter.warnings) == 1
    assert not any(SAID in said for said in in_colours.reporter.warnings)
    monkeypatch.setattr(estimation, "as_photographed", lambda scenes, library, **_: (scenes, library))
    wrong = estimate(with_photo(scene, without.job.photo.radiance), library, settings, material=name)
    assert np.ptp(wrong.fit.coefficients[0]) > 0.1 * wrong.fit.coefficients[0].max()


def test_of_grey_things_in_white_light_a_photo_in_colours_has_none_either(scene, library):
    """A clay render by default lights is no black-and-white photo, unless something in it is said to have a colour."""
    white, light, settings = "reference/white-diffuse", grey(positive_light(4, seed=3)), choose("draft")
    neutral = shown(scene, library.load(white), light, noise=0.0)
    assert is_black_and_white(neutral.job.photo)
    found = estimate(neutral, library, settings, material=white)
    assert found.scene.has_colours and not any(SAID in said for said in neutral.reporter.warnings)
    (ball,), photo = neutral.job.objects, neutral.job.photo
    for surface, has_colours in ((Surface((0.8, 0.8, 0.8)), True), (Surface((0.8, 0.5, 0.2)), False)):
        job = replace(scene.job, photo=photo, objects=(replace(ball, surface=surface),))
        assert estimate(PreparedScene(job, Reporter()), library, settings).scene.has_colours == has_colours


def test_what_stands_around_is_grey_too(scene):
    table = Surface((0.8, 0.3, 0.1))
    mesh = as_mesh(trimesh.creation.box((4, 4, 0.1)).apply_translation((0, 0, -1.2)))
    job = job_of([scene.job.objects[0].mesh], scene.job.camera)
    job = replace(job, occluders=(Occluder(mesh, table),), objects=(replace(job.objects[0], surface=table),))
    coloured = PreparedScene(job, Reporter())
    assert np.ptp(coloured.occluder_albedos[0]) > 0.3
    one = without_colours(coloured)
    assert np.ptp(one.occluder_albedos[0]) < 1e-6 and np.ptp(one.job.objects[0].surface.base_color) == 0
    assert one.occluder_albedos[0][0] == pytest.approx(coloured.occluder_albedos[0] @ REC709_LUMINANCE, rel=1e-3)
    assert without_colours(one) is one and coloured.has_colours


def test_a_material_is_recognised_by_its_texture(monkeypatch, scene, library, tmp_path):
    """Trained on greys; in a further photo, too, the light is grey."""
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path))
    light, settings = grey(positive_light(4, seed=5)), choose("draft", training_turns=1)
    photo = with_photo(scene, grey(shown(scene, library.load(TEAL), light).job.photo.radiance))
    found = estimate(photo, library, settings)
    assert found.materials[0].name == TEAL and not found.scene.has_colours
    following = Follower(found, library)
    further = following.scene_of(scene, replace(photo.job.photo, radiance=1.5 * photo.job.photo.radiance), Reporter())
    assert any(SAID in said for said in further.reporter.warnings)
    again = following.estimate(further).estimate.fit.coefficients
    assert np.allclose(again, 1.5 * found.fit.coefficients, rtol=0.1, atol=0.05 * np.abs(again).max())
    alone = recognise_object(without_colours(photo), 0, library.without_colours(), settings)
    assert alone.material == TEAL
