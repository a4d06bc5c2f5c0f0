# SPDX-License-Identifier: GPL-3.0-or-later
"""From images to names and back: synthetic textures under made-up lights, files, cache."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from btfsep_engine.errors import InputError
from btfsep_engine.recognise import descriptors, model_file, training
from btfsep_engine.recognise.vlad import Encoding
from btfsep_engine.storage import cache
from btfsep_engine.storage.kept import STORE

SIDE = 96
SMALL = Encoding(colour_words=20, sift_words=30, sift_components=16)
COARSE = descriptors.Settings(target=250)
QUICK = training.Method(COARSE, SMALL)
MATERIALS = ("fine", "coarse", "stripes", "flat")


def recognised(recogniser, radiance, mask, **names):
    """What a masked photo is taken for."""
    return recogniser.judged(recogniser.describe(radiance, mask, **names))


def disk(side=SIDE):
    y, x = np.mgrid[:side, :side] - side / 2 + 0.5
    return np.hypot(x, y) < 0.45 * side


def texture(material, rng, side=SIDE):
    """log2 albedo (side, side)."""
    noise = rng.standard_normal((side, side))
    if material == "stripes":
        x = np.arange(side)
        return 0.5 * np.sin(x * 2 * np.pi / 7 + rng.uniform(0, 6))[None, :] + 0.05 * noise
    if material == "flat":
        return 0.02 * noise
    smooth = gaussian_filter(noise, {"fine": 0.8, "coarse": 4.0}[material])
    return 0.5 * smooth / smooth.std()


def photo(material, rng, side=SIDE):
    """A lit disk: a texture, a smooth gradient of light, a tint of the light, some exposure."""
    y, x = np.mgrid[:side, :side] / side - 0.5
    a = rng.uniform(0, 2 * np.pi)
    shading = 1.2 * (x * np.cos(a) + y * np.sin(a))
    tint = rng.uniform(-0.1, 0.1, 3)
    log = (texture(material, rng, side) + shading)[..., None] + tint + rng.uniform(-3, 3)
    return np.where(disk(side)[..., None], np.exp2(log), np.nan).astype(np.float32)


def samples(rng, materials=MATERIALS, lights=6):
    for material in materials:
        for light in range(lights):
            yield training.TrainingImage(material, f"light {light}", photo(material, rng), disk())


def learn(seed=0, **options):
    rng = np.random.default_rng(seed)
    return training.train(samples(rng), method=QUICK, **options)


@pytest.fixture(scope="module")
def svm():
    return learn()


@pytest.fixture(scope="module")
def nearest():
    return learn(classifier="nearest")


@pytest.mark.parametrize("kind", ["svm", "nearest"])
def test_textures_are_told_apart_under_new_lights(kind, request, rng):
    recogniser, right = request.getfixturevalue(kind), 0
    for material in MATERIALS:
        for _ in range(3):
            answer = recognised(recogniser, photo(material, rng), disk())
            right += answer.material == material
            assert answer.candidates[0] == (answer.material, max(s for _, s in answer.candidates))
            assert sum(s for _, s in answer.candidates) == pytest.approx(1)
    assert right >= 10  # of 12; by chance 3


def test_unknown_is_farther_than_known(svm, rng):
    known = [recognised(svm, photo(m, rng), disk()).unknown_score for m in MATERIALS for _ in range(4)]
    y, x = np.mgrid[:SIDE, :SIDE]
    checks = np.exp2(1.5 * np.sign(np.sin(x / 4) * np.sin(y / 4)))[..., None] * np.array([1.0, 0.2, 0.05])
    strange = recognised(svm, checks.astype(np.float32), disk())
    assert strange.unknown_score > 1.1 * np.mean(known)
    assert np.mean(np.array(known) > 1) < 0.2


def test_unknown_is_a_winner_with_a_vote_below_the_limit(svm, rng):
    image = photo("fine", rng)
    answer = recognised(svm, image, disk())
    vote = 1 - answer.unknown_score * (1 - svm.model.known_vote)
    for limit, unknown in ((vote - 0.01, False), (vote + 0.01, True)):
        strict = replace(svm, model=replace(svm.model, known_vote=limit))
        assert recognised(strict, image, disk()).unknown is unknown


@pytest.mark.parametrize("factor", [1e-3, 0.7, 4096.0])
def test_exposure_does_not_matter(svm, rng, factor):
    image = photo("coarse", rng)
    here, there = recognised(svm, image, disk()), recognised(svm, image * factor, disk())
    assert here.material == there.material
    # 8-bit coding before SIFT may round the odd pixel the other way
    assert dict(here.candidates)[here.material] == pytest.approx(dict(there.candidates)[here.material], abs=0.02)
    a, b = descriptors.extract(image, disk()), descriptors.extract(image * factor, disk())
    np.testing.assert_allclose(a.colour, b.colour, atol=1e-3)
    np.testing.assert_array_equal(a.xy, b.xy)


def test_nan_and_infinite_pixels_are_bridged(svm, rng):
    image, mask = photo("fine", rng), disk()
    whole = descriptors.extract(image, mask)
    holes = rng.uniform(size=mask.shape) < 0.003
    image[holes] = np.nan
    image[SIDE // 2, SIDE // 2] = np.inf
    found = descriptors.extract(image, mask)
    assert all(np.isfinite(a).all() for a in (found.colour, found.contrast, found.xy))
    assert len(found) > 0.5 * len(whole)
    centres = found.xy.astype(int)
    # no colour patch touches a hole
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            assert not holes[centres[:, 1] + dy, centres[:, 0] + dx].any()
    assert recognised(svm, image, mask).material == "fine"


def test_patches_lie_inside_the_mask(rng):
    image, mask = photo("fine", rng), disk()
    edge = max(COARSE.bins)
    only = descriptors.Settings(bins=(edge,), target=250)
    found = descriptors.extract(image, mask, settings=only)
    for x, y in found.xy.astype(int):
        assert mask[y - 2 * edge : y + 2 * edge + 1, x - 2 * edge : x + 2 * edge + 1].all()
    beyond = image.copy()
    beyond[~mask] = 1e6
    again = descriptors.extract(beyond, mask, settings=only)
    np.testing.assert_array_equal(found.colour, again.colour)
    np.testing.assert_array_equal(found.sift, again.sift)


def test_position_in_the_photo_does_not_matter(svm, rng):
    image, mask = photo("coarse", rng), disk()
    canvas, moved = np.full((200, 300, 3), np.nan, np.float32), np.zeros((200, 300), bool)
    canvas[70 : 70 + SIDE, 190 : 190 + SIDE], moved[70 : 70 + SIDE, 190 : 190 + SIDE] = image, mask
    here, there = descriptors.extract(image, mask), descriptors.extract(canvas, moved)
    np.testing.assert_allclose(there.xy - here.xy, np.broadcast_to([190, 70], here.xy.shape))
    assert recognised(svm, canvas, moved).candidates == recognised(svm, image, mask).candidates


def test_black_beside_bright_has_no_contrast_rather_than_less_than_none(rng):
    image = np.zeros((100, 100, 3), np.float32)
    image[:, :34] = (np.where(np.arange(34) < 30, 50, 1e-4) * rng.uniform(0.5, 1, (100, 34)))[..., None]
    contrast = descriptors.extract(image, np.ones((100, 100), bool), settings=descriptors.PAPER).contrast
    assert np.isfinite(contrast).all() and contrast.min() < 1e-6 and contrast.max() > 0.1


def test_too_small_black_or_absent(svm, rng):
    image = photo("fine", rng)
    tiny = np.zeros((SIDE, SIDE), bool)
    tiny[40:46, 40:46] = True
    with pytest.raises(InputError, match=r"object 'bean'; covers only 36 pixels"):
        recognised(svm, image, tiny, what="object 'bean'")
    with pytest.raises(InputError, match="no pixel"):
        recognised(svm, image, np.zeros_like(tiny))
    with pytest.raises(InputError, match="black"):
        recognised(svm, np.zeros_like(image), disk())
    with pytest.raises(InputError, match="finite"):
        recognised(svm, np.full_like(image, np.nan), disk())
    small = disk(28)
    assert len(descriptors.extract(photo("fine", rng, 28), small)) >= COARSE.minimum


def test_turns_of_one_map_are_one_light():
    rng = np.random.default_rng(0)
    turned = [
        training.TrainingImage(m, f"hall@{k}", photo(m, rng), disk()) for m in ("fine", "coarse") for k in range(3)
    ]
    recogniser = training.train(turned, method=QUICK)
    assert recogniser.model.known_vote == -1 and np.isnan(recogniser.model.held_out_accuracy)


def test_bad_training():
    with pytest.raises(InputError, match="svm"):
        training.train([], classifier="forest")
    with pytest.raises(InputError, match="no images"):
        training.train([])


def test_the_same_seed_learns_the_same(svm):
    image = photo("stripes", np.random.default_rng(5))
    a, b = recognised(svm, image, disk()), recognised(learn(), image, disk())
    assert [n for n, _ in a.candidates] == [n for n, _ in b.candidates]
    np.testing.assert_allclose([s for _, s in a.candidates], [s for _, s in b.candidates], atol=1e-4)


@pytest.mark.parametrize("kind", ["svm", "nearest"])
def test_what_was_kept_gives_identical_scores(kind, request, rng, tmp_path):
    recogniser = request.getfixturevalue(kind)
    model_file.cached("a", lambda: recogniser, folder=tmp_path)
    STORE.forget()  # another process
    again = model_file.cached("a", pytest.fail, folder=tmp_path)
    image = photo("coarse", rng)
    assert recognised(again, image, disk()) == recognised(recogniser, image, disk())
    assert again.settings == recogniser.settings and again.encoder.encoding == recogniser.encoder.encoding
    numbers = [{k: v for k, v in vars(r.model).items() if np.isscalar(v)} for r in (again, recogniser)]
    assert repr(numbers[0]) == repr(numbers[1])  # not a number is not itself


def test_cache_keeps_and_mends(svm, nearest, tmp_path, monkeypatch):
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "cache"))
    calls = []

    def make():
        calls.append(1)
        return svm

    model_file.cached("a", make)
    assert model_file.cached("a", make).materials == svm.materials and len(calls) == 1
    assert model_file.cached("b", lambda: nearest).model.kind == "nearest"
    assert model_file.cached("a", make).model.kind == "svm"
    for file in (tmp_path / "cache").rglob("*.entry"):
        file.write_bytes(b"broken")
    for _ in range(2):  # mended, and read
        STORE.forget()
        model_file.cached("a", make)
        assert len(calls) == 2


def test_a_cache_that_cannot_be_written_is_no_error(svm, tmp_path):
    (tmp_path / "file").write_text("in the way")
    assert model_file.cached("a", lambda: svm, folder=tmp_path / "file") is svm


def test_digest_tells_contents_apart():
    digest = cache.digest
    a = np.arange(6.0)
    keys = [
        digest(a), digest(a.reshape(2, 3)), digest(a.astype(np.float32)), digest(a + 1), digest(["a", "b"]),
        digest(["ab"]), digest("a", "b"), digest(1), digest(1.0), digest("1"), digest(None), digest(SMALL), digest(),
    ]  # fmt: skip
    assert len(set(keys)) == len(keys)
    assert digest(a, SMALL) == digest(a.copy(), SMALL)
    with pytest.raises(TypeError):
        digest(object())
