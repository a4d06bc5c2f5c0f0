# SPDX-License-Identifier: GPL-3.0-or-later
"""The study of recognition: apart from what was learned on, its figures right, photographs asked with and without."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from btfsep_engine.btf.library import open_library
from btfsep_engine.conventions import REC709_LUMINANCE
from btfsep_engine.light.maps import read_map
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.verification import PLAIN
from btfsep_engine.recognise.judgement import Judgement
from scripts.cycles import materials as cycles_materials
from scripts.cycles import shoot
from scripts.studies import cues, photos, recognition
from scripts.studies.makers import learn_recognition as learn

THREE = ("leather/brown-grain", "wallpaper/damask-teal", "wood/oak-boards")


def test_nothing_that_was_learned_on_is_judged_by(tmp_path):
    materials = [photos.WHITE, *open_library().entries]
    shots = recognition.shots(tmp_path, materials)
    assert len(shots) == len({s.folder for s in shots}) == 150
    assert {s.object for s in shots} == set(recognition.OBJECTS) and {s.light for s in shots} == set(recognition.LIGHTS)
    assert not set(recognition.OBJECTS) & set(learn.OBJECTS) and not set(recognition.LIGHTS) & set(learn.LIGHTS)
    assert {s.variation for s in shots} == {1} and learn.VARIATION not in (0, 1)
    plain = recognition.shots(tmp_path / photos.PLAIN, recognition.SHOWN_PLAIN)
    assert len(plain) == 80 and {s.light for s in plain} == set(recognition.LIGHTS)
    assert not set(recognition.SHOWN_PLAIN) & set(learn.SHOWN_PLAIN)
    counts = [sum(photos.library_name(s.material) == m for s in shots) for m in materials]
    assert counts == [10] * 15


def test_each_material_is_learned_on_two_objects(tmp_path, monkeypatch):
    monkeypatch.setattr(learn, "HEIGHT", 16)  # of 230 maps
    materials = [photos.WHITE, *open_library().entries]
    some, plain = learn.shots(tmp_path, materials)
    assert len(some) == len({s.folder for s in some}) == 150 and len({s.folder for s in plain}) == 80
    for shots, names in ((some, map(photos.studio_name, materials)), (plain, learn.SHOWN_PLAIN)):
        meshes = {(s.object, s.material) for s in shots}
        assert all(sum(material == name for _, material in meshes) == 2 for name in names)
        assert {name for name, _ in meshes} == set(learn.OBJECTS)
    assert {s.material for s in plain} == set(learn.SHOWN_PLAIN)
    # what other studies are given has the library's materials alone
    assert {Path(s.folder).parent for s in plain} == {tmp_path / photos.PLAIN}
    assert {Path(s.folder).parent for s in some} == {tmp_path}
    lights = [s.light for s in (*some, *plain)]
    assert len(set(lights)) == 150 + 80 and not any(light in recognition.LIGHTS for light in lights)
    assert sum(Path(light).name.startswith(learn.DRAWN) for light in lights) == 4 * (30 + 16)
    same = [np.array_equal(read_map(a), read_map(b)) for a, b in zip(lights[:4], lights[150:154], strict=True)]
    assert not any(same)


def test_shares_come_with_their_range():
    assert recognition.share(i < 22 for i in range(30)) == "73.3% (56 to 86)"
    assert recognition.share([False] * 12) == "0.0% (0 to 24)"


def test_the_area_under_the_curve_is_the_share_of_pairs_in_order():
    rng = np.random.default_rng(4)
    high, low = rng.integers(0, 6, 40) + 1.0, rng.integers(0, 6, 30)
    pairs = [(a > b) + 0.5 * (a == b) for a in high for b in low]
    assert recognition.area_under(high, low) == pytest.approx(np.mean(pairs))


def test_calibration_is_the_mean_distance_of_what_is_said_from_what_is_so():
    """Half said at 0.95 of which 0.75 are right, half said at 0.55 of which half are right."""
    confidence, right = np.repeat([0.95, 0.55], 20), np.concatenate([np.arange(20) < 15, np.arange(20) < 10])
    error, bins = recognition.calibration(confidence, right)
    assert error == pytest.approx(0.5 * 0.2 + 0.5 * 0.05) and [b[2] for b in bins] == [20, 20]


def test_photographs_of_which_the_confidence_is_right_differ_from_it_by_chance_alone():
    rng = np.random.default_rng(0)
    stated = rng.uniform(0.2, 1, 150)
    low, high = recognition.by_chance(stated)
    assert 0.02 < low < high < 0.15
    honest = [recognition.calibration(stated, rng.random(150) < stated)[0] for _ in range(40)]
    assert 30 <= sum(low <= error <= high for error in honest)
    assert recognition.calibration(stated, rng.random(150) < stated - 0.2)[0] > high


def test_the_weights_are_those_that_made_the_data():
    """Photographs whose right material is drawn from known weights; a cue that says nothing gets none."""
    rng, data = np.random.default_rng(0), []
    for _ in range(1500):
        seen = {name: rng.normal(size=5) for name in ("a", "b", "noise")}
        z = np.append(2.0 * seen["a"] + 0.5 * seen["b"], 1.0)
        p = np.exp(z) / np.exp(z).sum()
        right = rng.choice(6, p=p)
        data.append(learn.Example(seen, () if right == 5 else (int(right),), 1.0, "x", "light"))
    weights, none = learn.learned(data, ("a", "b", "noise"))
    assert weights["a"] == pytest.approx(2, abs=0.25) and weights["b"] == pytest.approx(0.5, abs=0.15)
    assert weights["noise"] < 0.1 and none == pytest.approx(1, abs=0.25)


def test_of_several_that_are_right_it_does_not_matter_which():
    """What speaks for both alike is learned, what tells them apart is not."""
    rng, data = np.random.default_rng(0), []
    for _ in range(400):
        seen = {"both": np.array([1.0, 1.0, 0.0]) + 0.3 * rng.normal(size=3), "one": np.array([rng.normal(), 0.0, 0.0])}
        data.append(learn.Example(seen, (0, 1), 1.0, "x", "light"))
    weights, _ = learn.learned(data, ("both", "one"))
    assert weights["both"] > 3 and weights["one"] < 0.3


def test_plain_surfaces_are_candidates_where_they_are_asked_for():
    names = ("leather/brown-grain", photos.WHITE, *PLAIN)
    found = {"names": names, "cues": {"classifier": list(range(5))}}

    def example(shown, **how):
        photograph = photos.Photograph(Path(), "blob", shown, "drawn-000")
        return learn.examples([cues.Seen(photograph, found, None)], **how)

    (leather,), (metal,), (matte,) = (
        example(s) for s in ("leather-brown-grain", "plain-metal-grey", "plain-matte-red")
    )
    assert (leather.right, metal.right, matte.right) == ((0,), (2, 3, 4), (1, 2, 3, 4))
    (alone,) = example("leather-brown-grain", plain=False)
    assert alone.cues["classifier"].tolist() == [0, 1] and example("plain-metal-grey", plain=False) == []


def test_drawn_lights_are_lights():
    maps = [learn.drawn_light(np.random.default_rng(seed)) for seed in range(8)]
    assert all(m.shape == (128, 256, 3) and np.isfinite(m).all() and m.min() >= 0 and m.max() > 0 for m in maps)
    assert len({float(m.max()) for m in maps}) == 8


def test_a_drawn_lights_mean_is_as_far_from_grey_as_natural_light_is():
    """In two colour differences of log2 radiance; and its luminance stays."""
    found = []
    for seed in range(300):
        rng = np.random.default_rng(1000 + seed)
        radiance = np.broadcast_to(rng.uniform(0.1, 2, 3), (8, 16, 3))
        there = (radiance * learn.tint_of(radiance, seed))[0, 0]
        assert there @ REC709_LUMINANCE == pytest.approx(radiance[0, 0] @ REC709_LUMINANCE, rel=1e-4)
        red, green, blue = np.log2(there)
        found.append([red - blue, green - (red + blue) / 2])
    np.testing.assert_allclose(np.std(found, axis=0), learn.TINT, rtol=0.15)


def test_a_photograph_is_asked_with_and_without_its_material_and_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "cache"))
    shipped = open_library()
    library = replace(shipped, entries={name: shipped.entries[name] for name in THREE})
    shot = photos.shot(tmp_path / "photos", "sphere", THREE[1], "studio")
    monkeypatch.setattr(cycles_materials, "MOST_FACES", 100_000)
    shoot.shoot([asdict(shot)], resolution=96, samples=4)
    pictures = {path: path.read_bytes() for path in (tmp_path / "photos").rglob("*.exr")}
    photos.take([shot], resolution=96, samples=4)  # in a process of its own, where there is nothing left to do
    assert pictures == {path: path.read_bytes() for path in (tmp_path / "photos").rglob("*.exr")} != {}
    settings = choose("draft", training_turns=1, training_pixels=800, training_directions=32)
    (seen,) = cues.cues_of(cues.seen_in([shot]), library, settings)
    known, left_out = seen.known["names"], seen.left_out["names"]
    assert set(known) == {*THREE, "reference/white-diffuse", "reference/chrome", *PLAIN} == {*left_out, THREE[1]}
    assert all(len(values) == len(known) for values in seen.known["cues"].values())
    models = dict.fromkeys(("verified", "spoilt", "grainy"), learned_by_hand())
    monkeypatch.setattr(recognition, "judgements", lambda: models)
    (answer,) = recognition.answers([seen])
    assert answer["truth"] == THREE[1] and answer["left_out"] > answer["strangeness"]
    kept = json.loads((seen.photograph.folder / "cues-clean.json").read_text())
    monkeypatch.setattr(cues, "View", None)  # what is kept is not asked again
    again = cues.cues_of([seen.photograph], library, settings)
    assert again[0].known == kept["known"]
    with pytest.raises(TypeError):
        cues.cues_of([seen.photograph], library, choose("draft"))


def learned_by_hand():
    return Judgement({"classifier": 1.0, "contrast": 5.0}, -2.0, np.linspace(0, 1, 40))


@pytest.mark.parametrize("flaw", cues.FLAWS[1:])
def test_a_flaw_changes_a_photograph_and_not_its_brightness(flaw):
    rng = np.random.default_rng(1)
    image = rng.uniform(0.2, 1.0, (64, 64, 3)).astype(np.float32)
    region = np.ones((64, 64), bool)
    spoilt = cues.flawed(image, region, flaw, rng)
    assert spoilt.dtype == np.float32
    if flaw == "small":
        assert spoilt.shape == (32, 32, 3) and spoilt.std() == pytest.approx(image.std() / 2, rel=0.1)
    else:
        assert spoilt.shape == image.shape and np.nanmean(np.abs(spoilt - image)) > 0.005
    assert (np.ptp(spoilt, axis=-1).max() == 0) == (flaw == "grey")
    assert np.nanmean(spoilt) == pytest.approx(image.mean(), rel=0.1)
