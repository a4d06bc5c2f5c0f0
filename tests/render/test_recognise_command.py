# SPDX-License-Identifier: GPL-3.0-or-later
"""Recognition through the command line: trained on the job's own geometry, asked about a photo of it."""

import json
import shutil
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

from btfsep_engine.btf.library import open_library
from btfsep_engine.cli import main
from btfsep_engine.light.files import exactly, write_lighting
from btfsep_engine.pipeline.recognition import bounding_window, training_region
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.verification import PLAIN, SIMILARITIES, Verification
from tests.render.progress_lines import assert_whole_run
from tests.render.scenes import positive_light, scene_of

CHOSEN = ("leather/brown-grain", "felt/green-coarse", "wood/oak-boards")


@pytest.fixture
def small_library(tmp_path):
    """A folder with three of the shipped materials."""
    shipped, folder = resources.files("btfsep_engine") / "data" / "library", tmp_path / "library"
    folder.mkdir()
    index = json.loads((shipped / "index.json").read_text())
    index["materials"] = [m for m in index["materials"] if m["name"] in CHOSEN]
    for material in index["materials"]:
        shutil.copy(str(shipped / material["file"]), folder)
    (folder / "index.json").write_text(json.dumps(index))
    return folder


@pytest.mark.parametrize("classifier", ["svm", "nearest"])
def test_the_material_of_a_photo_is_recognised_and_used(
    sphere_job_folder, small_library, capsys, tmp_path, monkeypatch, classifier
):
    """Each material photographed under a light that is no training light; the second run finds the training kept."""
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "cache"))
    folder, _ = sphere_job_folder
    light = tmp_path / "light.json"
    write_lighting(light, exactly(positive_light(4, seed=3) * [1.1, 1.0, 0.8]))
    common = ["--library", str(small_library), "--preset", "draft"]
    for name in CHOSEN[:2]:
        relit = [
            "relight",
            str(folder),
            "--lighting",
            str(light),
            "--material",
            name,
            "--out",
            str(folder / "photo.exr"),
        ]
        assert main([*relit, *common]) == 0
        capsys.readouterr()
        assert main(["recognise", str(folder), *common, "--classifier", classifier, "--json"]) == 0
        lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        assert_whole_run(lines, "recognise")
        result = lines[-1]["result"]
        (found,) = result["objects"]
        assert found["material"] == name and found["recognised"]
        scores = [c["score"] for c in found["candidates"]]
        assert scores == sorted(scores, reverse=True) and sum(scores) == pytest.approx(1, abs=1e-3)
        named = {c["name"] for c in found["candidates"]}
        assert named == {*CHOSEN, "reference/white-diffuse", "reference/chrome", *PLAIN}
    assert "classifier" not in result["seconds"]  # kept from the first photo: the geometry is the same
    assert main(["estimate", str(folder), *common, "--classifier", classifier, "--no-report", "--json"]) == 0
    estimated = json.loads(capsys.readouterr().out.splitlines()[-1])["result"]
    assert estimated["objects"][0]["material"] == CHOSEN[1]


def test_training_looks_at_windows_spread_over_a_large_object():
    region = np.zeros((512, 640), bool)
    region[40:500, 60:600] = True
    assert training_region(region, 10**6) is region
    chosen = training_region(region, 20_000)
    assert not (chosen & ~region).any()
    assert 20_000 <= chosen.sum() < 20_000 + 64 * 64
    halves = [chosen[:270].sum(), chosen[270:].sum(), chosen[:, :330].sum(), chosen[:, 330:].sum()]
    assert min(halves) > 0.25 * chosen.sum()
    thin = np.zeros((512, 640), bool)
    thin[100, 10:600] = True
    assert training_region(thin, 100) is thin  # no window is filled enough


def test_the_bounding_window_holds_just_the_region():
    region = np.zeros((30, 40), bool)
    region[5:9, 12] = region[7, 20] = True
    window = bounding_window(region)
    assert region[window].sum() == region.sum() and region[window].shape == (4, 9)


def test_candidates_are_compared_with_the_photo_under_the_light_they_imply(
    sphere_job_folder, small_library, tmp_path, monkeypatch
):
    """Under the photo's own light the texture is that of the right one."""
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "cache"))
    folder, _ = sphere_job_folder
    light = tmp_path / "light.json"
    write_lighting(light, exactly(positive_light(4, seed=5) * [1.0, 0.9, 0.7]))
    library, settings = open_library(small_library), choose("draft")
    for right, wrong in ((CHOSEN[0], CHOSEN[2]), (CHOSEN[2], CHOSEN[0])):
        target = ["--lighting", str(light), "--material", right, "--library", str(small_library), "--preset", "draft"]
        assert main(["relight", str(folder), *target, "--out", str(folder / "photo.exr")]) == 0
        scene = scene_of(folder)
        region = training_region(scene.regions[0], settings.training_pixels)
        window = bounding_window(region)
        verification = Verification(scene, 0, region, window, settings)
        radiance = scene.job.photo.radiance[window]
        names = (wrong, right, "reference/chrome")
        votes = {"classifier": np.array([-0.5, -1.0, -2.0])}
        cues = verification.cues(names, votes, radiance, library.load)
        for cue in SIMILARITIES:
            assert cues[cue][1] > cues[cue][0], cue
        # a mirror is as sharp as the lights about it, whatever the photo's own
        assert cues["contrast"][2] < 2 * cues["contrast"][1] and cues["together"][2] < cues["together"][1]
        assert cues["contrast"][1] > -0.1
        assert cues["evidence"].max() == 0 and cues["tint"][1] > -3
        (first,), (alone,) = (verification.explained([library.load(name)], radiance) for name in (right, wrong))
        (beside,) = verification.explained([library.load(wrong)], radiance, first)
        assert beside.effective == first.effective != alone.effective  # or their evidences could not be compared
        again = verification.cues(names, votes, 3 * radiance, library.load)
        np.testing.assert_allclose(again["contrast"], cues["contrast"], atol=1e-3)  # whatever the exposure


def test_that_a_mirror_can_explain_any_photo_says_nothing(sphere_job_folder, small_library, tmp_path, monkeypatch):
    """Light that is itself a blurred picture makes a mirror look like a matte ball, to the last pixel."""
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "cache"))
    folder, _ = sphere_job_folder
    library, settings, names = open_library(small_library), choose("draft"), (CHOSEN[0], "reference/chrome")
    scene = scene_of(folder)
    region = training_region(scene.regions[0], settings.training_pixels)
    verification = Verification(scene, 0, region, bounding_window(region), settings)
    explained = {CHOSEN[0]: -300.0, "reference/chrome": 0.0} | dict.fromkeys(PLAIN, -444.0)
    own = Verification.explained
    monkeypatch.setattr(
        Verification,
        "explained",
        lambda self, materials, *given: [
            replace(one, evidence=explained[material.name])
            for one, material in zip(own(self, materials, *given), materials, strict=True)
        ],
    )
    radiance = scene.job.photo.radiance[verification.window]
    told = {"classifier": np.array([-0.5, -2.0])}, radiance, library.load
    assert verification.cues(names, *told)["evidence"] == pytest.approx([0.0, 0.0, -12.0, -12.0, -12.0])
    explained["reference/chrome"] = -400.0  # and that it cannot speaks against it
    assert verification.cues(names, *told)["evidence"] == pytest.approx([0.0, -10.0, -12.0, -12.0, -12.0])
