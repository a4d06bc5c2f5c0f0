# SPDX-License-Identifier: GPL-3.0-or-later
"""What a recogniser of a job is trained on, what it is kept by, and what of a photo it looks at."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import SURFACES
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.job.model import Photo
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline import recognition
from btfsep_engine.pipeline.materials import object_materials
from btfsep_engine.pipeline.recognition import recognise_object, trained_recogniser
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import RecognitionSettings, choose
from btfsep_engine.pipeline.verification import CELLS, PLAIN, ROUGHNESSES, Verification
from btfsep_engine.progress import Reporter
from btfsep_engine.recognise.judgement import judgements
from btfsep_engine.recognise.recogniser import Recogniser, Recognition
from btfsep_engine.render.transport import Transport
from btfsep_engine.render.weights import Weights
from btfsep_engine.storage.kept import STORE
from tests.render.scenes import as_mesh, job_of, looking_down, positive_light

FEW = ("leather/brown-grain", "wood/oak-boards", "felt/green-coarse")


@pytest.fixture(scope="module")
def library():
    """Three of the shipped materials."""
    shipped = open_library()
    return replace(shipped, entries={name: shipped.entries[name] for name in FEW})


@pytest.fixture
def scene():
    """A ball in 160 x 160 pixels."""
    ball = as_mesh(trimesh.creation.icosphere(4))
    return PreparedScene(job_of([ball], looking_down(size=160, focal=300.0)), Reporter())


def key_of(monkeypatch, scene, library, settings):
    monkeypatch.setattr(recognition, "cached", lambda key, make, **_: key)
    return trained_recogniser(scene, 0, library, settings)


def test_what_a_training_depends_on_is_in_its_key(monkeypatch, scene, library):
    def key(library=library, *, preset="draft", view=scene.view, job=None, **changes):
        other = PreparedScene.__new__(PreparedScene)
        vars(other).update(vars(scene) | {"job": scene.job if job is None else job, "view": view})
        return key_of(monkeypatch, other, library, choose(preset, **changes))

    job, entry = scene.job, library.entries[FEW[0]]
    mesh = job.objects[0].mesh
    keys = [
        key(),
        key(replace(library, entries={n: library.entries[n] for n in FEW[:2]})),
        key(replace(library, entries=library.entries | {FEW[0]: entry.model_copy(update={"sha256": 64 * "0"})})),
        key(job=replace(job, camera=replace(job.camera, fx=job.camera.fx + 1))),
        key(job=replace(job, camera=replace(job.camera, to_world=job.camera.to_world + np.eye(4)[3] * 0.1))),
        key(job=replace(job, metres_per_unit=1.0)),
        key(job=replace(job, objects=(replace(job.objects[0], mesh=replace(mesh, vertices=mesh.vertices * 1.1)),))),
        key(job=replace(job, objects=(replace(job.objects[0], mesh=replace(mesh, faces=mesh.faces[::-1])),))),
        key(classifier="nearest"),
        key(recogniser="paper"),
        key(training_directions=64),
        key(training_pixels=3000),
        key(training_turns=3),
        key(seed=1),
    ]
    assert len(set(keys)) == len(keys)
    assert key() == keys[0]
    assert key(pixels=77, order=2, verify=False) == keys[0]  # these have no part in it


@pytest.mark.parametrize(("preset", "turns"), [("draft", 2), ("balanced", 2), ("accurate", 4), ("paper", 2)])
def test_every_training_map_is_used_at_the_presets_turns(monkeypatch, scene, library, preset, turns):
    seen = {}

    def train(samples, **options):
        for sample in samples:
            seen.setdefault(sample.material, []).append(sample)
        seen["method"] = options["method"]

    monkeypatch.setattr(recognition, "cached", lambda key, make, **_: make())
    monkeypatch.setattr(recognition, "train", train)
    trained_recogniser(scene, 0, library, choose(preset, training_directions=32, training_pixels=2000))
    assert seen.pop("method").as_photos is (preset != "paper")
    assert set(seen) == {*FEW, "reference/white-diffuse", "reference/chrome"}
    for images in seen.values():
        names = [image.light for image in images]
        assert len(set(names)) == len(names) == 7 * turns
        assert {names.count(n) for n in names} == {1} and len({n.partition("@")[0] for n in names}) == 7
        pictures = np.stack([np.nan_to_num(image.radiance[image.mask]) for image in images])
        assert min(np.abs(a - b).max() for i, a in enumerate(pictures) for b in pictures[:i]) > 0


def test_one_more_material_is_all_that_is_made(monkeypatch, scene, library, tmp_path):
    """And the training is, bit for bit, that from the start."""
    settings = RecognitionSettings(training_pixels=3000, training_directions=32, training_turns=1)
    fewer = replace(library, entries={name: library.entries[name] for name in FEW[:2]})
    rendered, radiances = [], Transport.radiances

    def seen(self, material, *lightings):
        rendered.append(material.name)
        return radiances(self, material, *lightings)

    monkeypatch.setattr(Transport, "radiances", seen)

    def made(library, folder):
        monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / folder))
        STORE.forget()
        rendered.clear()
        return trained_recogniser(scene, 0, library, settings), sorted(set(rendered))

    _, first = made(fewer, "one")
    more, second = made(library, "one")
    anew, every = made(library, "other")
    assert first == sorted([*FEW[:2], "reference/white-diffuse", "reference/chrome"])
    assert second == [FEW[2]] and every == sorted([*first, FEW[2]])
    assert more.materials == anew.materials and more.contents == anew.contents
    for name, array in vars(anew.model).items():
        np.testing.assert_array_equal(getattr(more.model, name), array)
    changed = library.entries[FEW[0]].model_copy(update={"name": FEW[1]})  # a name that means something else now
    renamed = replace(library, entries=fewer.entries | {FEW[1]: changed})
    assert made(renamed, "one")[1] == [FEW[1]]  # by what its file holds, not by its name
    for entry in (tmp_path / "one" / "recognisers").iterdir():
        entry.write_bytes(entry.read_bytes()[:-100] + bytes(100))
    assert made(library, "one")[1] == every  # what is damaged is not believed


def photographed(scene, library, name, *, seed=5) -> Photo:
    """The scene's object in a material under a light that is no training light."""
    points = scene.points(0, textured=True)
    light = SHLighting(positive_light(4, seed=seed) * [1.0, 0.9, 0.7])
    image = np.zeros((*scene.regions[0].shape, 3), np.float32)
    values = scene.transport(points, directions=256).radiance(library.load(name), light)[:, 0]
    image[points.pixels[:, 0], points.pixels[:, 1]] = values
    return Photo(image, np.ones(image.shape[:2], bool), 0)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return str(tmp_path_factory.mktemp("cache"))


@pytest.fixture
def settings(cache, monkeypatch):
    monkeypatch.setenv("BTFSEP_CACHE", cache)
    return RecognitionSettings(training_pixels=8000, training_directions=128, training_turns=1)


def test_saturated_pixels_have_no_say(scene, library, settings):
    photo = photographed(scene, library, FEW[1])
    saturated = np.zeros_like(photo.usable)
    saturated[60:100, 60:75] = True

    def answer(value, usable, *, verify=False):
        image = np.where(saturated[..., None], np.float32(value), photo.radiance)
        scene.job = replace(scene.job, photo=Photo(image, usable, int((~usable).sum())))
        return recognise_object(scene, 0, library, replace(settings, verify=verify))

    assert answer(0, ~saturated) == answer(1, ~saturated) == answer(1e4, ~saturated)
    assert answer(1e4, ~saturated) != answer(1e4, photo.usable)  # they would have had one
    assert answer(1e4, ~saturated, verify=True).material == FEW[1]


def test_the_likeliest_are_rendered_again_before_one_is_named(monkeypatch, scene, library, settings):
    """A classifier that cannot decide names the wrong one first; under the photo's light the right one is found."""
    scene.job = replace(scene.job, photo=photographed(scene, library, FEW[0]))
    undecided = Recognition(FEW[1], ((FEW[1], 0.45), (FEW[0], 0.4), (FEW[2], 0.15)), False, 0.5)
    monkeypatch.setattr(Recogniser, "judged", lambda self, vectors: undecided)
    assert recognise_object(scene, 0, library, settings).material == FEW[0]
    assert recognise_object(scene, 0, library, replace(settings, verify=False)).material == FEW[1]


@pytest.mark.parametrize("strict", [False, True])
def test_what_is_like_no_material_is_said_to_be_unknown_and_a_surface_by_numbers_stands_in(
    monkeypatch, scene, library, settings, strict
):
    """A material left out, judged as if known materials were always, or never, as strange as it is."""
    without = replace(library, entries={name: library.entries[name] for name in FEW[:2]})
    scene.job = replace(scene.job, photo=photographed(scene, library, FEW[2]))
    shipped = judgements()["verified"]
    asked = replace(shipped, strangeness=np.full(40, 1e-6 if strict else 50.0))
    monkeypatch.setattr(recognition, "judgements", lambda: dict.fromkeys(("verified", "spoilt", "explained"), asked))
    scene.reporter = Reporter()
    answer = recognise_object(scene, 0, without, settings)
    assert answer.unknown is strict and (answer.unknown_score > 1) is strict
    assert (len(answer.likely) == 0) is strict and (answer.stand_in in SURFACES) is strict
    said = [text for text in scene.reporter.warnings if "looks like none of the library's materials" in text]
    assert len(said) == strict and all(answer.material in text and answer.stand_in in text for text in said)
    (used,) = object_materials(scene, without, choose("draft", seed=settings.seed), names=[None]) if strict else (None,)
    assert not strict or (used.name == answer.stand_in and used.unknown and used.record["likely"] == ())


def test_what_the_photo_does_not_tell_apart_is_named_together(monkeypatch, scene, library, settings):
    scene.job = replace(scene.job, photo=photographed(scene, library, FEW[0]))
    lenient = replace(judgements()["verified"], strangeness=np.full(40, 50.0))
    monkeypatch.setattr(recognition, "judgements", lambda: dict.fromkeys(("verified", "spoilt", "explained"), lenient))
    scene.reporter = Reporter()
    answer = recognise_object(scene, 0, library, settings)
    assert answer.likely[0] == answer.material == FEW[0] and set(answer.likely) > set(FEW)
    (said,) = [text for text in scene.reporter.warnings if "may be" in text]
    assert all(name in said for name in answer.likely[:3])
    assert recognition.several(("a", "b")) == "a or b"
    assert recognition.several(tuple("abcde")) == "a or b or c, or one of 2 others"
    assert recognition.several(tuple("abcd")) == "a or b or c, or one more"


def test_another_classifier_has_the_order_of_the_cues_and_its_own_limit(monkeypatch, scene, library, settings):
    scene.job = replace(scene.job, photo=photographed(scene, library, FEW[0]))
    answer = recognise_object(scene, 0, library, replace(settings, classifier="nearest"))
    assert answer.material == FEW[0] and answer.likely is None


@pytest.mark.parametrize("name", FEW)
def test_cells_of_light_make_the_picture_that_the_light_makes(scene, library, name):
    transport = scene.transport(scene.points(0, textured=True), directions=256)
    light, directions = SHLighting(positive_light(4, seed=3) * [1.0, 0.9, 0.7]), fibonacci_sphere(400)
    cells = CELLS.means(light.radiance(directions)[:, 0].T[None], directions)[0]
    assert cells.shape == (CELLS.count, 3)
    found = np.einsum("pmc,mc->pc", transport.radiance(library.load(name), CELLS), cells)
    expected = transport.radiance(library.load(name), light)[:, 0]
    assert np.sqrt(np.square(found - expected).mean()) < 0.05 * np.sqrt(np.square(expected).mean())


def test_a_photo_after_others_is_answered_as_the_first_of_a_process(monkeypatch, scene, library, settings, tmp_path):
    """Bit for bit; and what a training has rendered is not rendered again, be it under its lights or the photo's."""
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path))
    photos = [photographed(scene, library, name, seed=seed) for name, seed in ((FEW[0], 5), (FEW[1], 6))]
    photos[1].usable[60:64, 80:90] = False  # some of the few pixels that lights are found from among them
    rendered, of_all = [], Weights.of_all

    def seen(self, points, active):
        rendered.append(len(points))
        return of_all(self, points, active)

    monkeypatch.setattr(Weights, "of_all", seen)

    def answered(photo):
        scene.job = replace(scene.job, photo=photo)
        return recognise_object(scene, 0, library, settings)

    STORE.forget()
    trained_recogniser(scene, 0, library, settings)
    trained, large = len(rendered), max(rendered)
    answers = [answered(photo) for photo in photos]
    after, plain = rendered[trained:], 1 + sum(map(len, ROUGHNESSES.values()))
    assert min(after) < large  # the few pixels that lights are found from
    assert sum(n == large for n in after) <= plain  # which no training knows
    for photo, before in zip(photos, answers, strict=True):
        STORE.forget()
        assert answered(photo) == before
    assert rendered[-1] == large


def test_a_training_leaves_room_for_all_else(monkeypatch, scene, library, settings, tmp_path):
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path))
    pixels = recognition.training_region(scene.regions[0], settings.training_pixels).sum()
    each = 12 * CELLS.count * pixels
    kinds, get = [], STORE.get

    def asked(key, make, *, size=None):
        return get(key, lambda: kinds.append(key[0]) or make(), size=size)

    monkeypatch.setattr(STORE, "get", asked)
    for room, left in ((1.5, 2), (10.0, 4)):  # three materials, and white; chrome is never rendered under cells
        monkeypatch.setattr(STORE, "most_bytes", int(room * each / recognition.KEPT))
        STORE.forget()
        kinds.clear()
        trained_recogniser(scene, 0, library, replace(settings, seed=left))
        assert kinds.count("basis") == left


def test_what_is_far_behind_is_not_rendered(monkeypatch, scene, library, settings):
    """One that the classifier is sure of, and whose light explains as much as any."""
    scene.job = replace(scene.job, photo=photographed(scene, library, FEW[0]))
    rendered, similarity = [], Verification.similarity

    def seen(self, material, *about):
        rendered.append(material.name)
        return similarity(self, material, *about)

    monkeypatch.setattr(Verification, "similarity", seen)
    others = [(name, 1e-12) for name in (FEW[1], FEW[2], "reference/white-diffuse")]
    for score, count in ((1 - 3e-12, 1), (1e-12, 4)):  # -log of 1e-12 is 28, of which the root counts
        rendered.clear()
        sure = Recognition(FEW[0], ((FEW[0], score), *others), False, 0.5)
        monkeypatch.setattr(Recogniser, "judged", lambda self, vectors, sure=sure: sure)
        recognise_object(scene, 0, library, settings)
        of_library = [name for name in rendered if name not in PLAIN]
        assert FEW[0] in rendered and (len(of_library) == 1) is (count == 1)
        assert 0 < len(rendered) - len(of_library) < len(PLAIN)  # a metal is far behind
