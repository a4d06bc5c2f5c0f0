# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs whose tones a phone moved place by place, through the estimate, against the light they were made of."""

from dataclasses import replace
from itertools import cycle

import cv2
import numpy as np
import pytest

from btfsep_engine.fit.stated import expected_error
from btfsep_engine.fit.tone_curve import CAMERA
from btfsep_engine.job.model import Photo
from btfsep_engine.pipeline import checks, estimation
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.following import CHOSEN, Follower
from btfsep_engine.pipeline.phone import STRENGTHS, USUAL, with_tones_undone
from btfsep_engine.pipeline.refine import curves
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from tests.render import test_tone_curve
from tests.render.test_tone_curve import SETTINGS, Grey, off

ball = test_tone_curve.ball


def pressed(image, to) -> np.ndarray:
    """A picture with its large contrasts pressed together to a part of what they were, by a bilateral filter."""
    log = np.log2(np.maximum(image.mean(-1), 1e-3)).astype(np.float32)
    large = cv2.bilateralFilter(log, -1, 1.3, 0.06 * image.shape[1])
    return image * np.exp2((to - 1) * (large - np.percentile(large, 99)))[..., None]


def seen(ball, to, said, camera="", exposure=1.0) -> PreparedScene:
    """The scene with a photo that a phone took: tones moved ``to``, then the curve of a camera, 8 bits."""
    scene, image = ball
    moved = exposure * pressed(np.maximum(image, 0), to)
    codes = np.round(255 * CAMERA.encode(np.clip(moved, 0, 1))) / 255
    values = CAMERA.decode(codes).astype(np.float32)
    out = PreparedScene(scene.job, Reporter())
    photo = Photo(values, np.ones(codes.shape[:2], bool), 0, bits=8, camera=camera)
    out.job = replace(scene.job, photo=photo, image_colorspace=said)
    return out


def stated(found) -> float:
    return expected_error(found.fit.all_coefficients, found.fit.samples)["order_2"]["median"]


def test_a_phones_picture_tells_of_its_light_as_far_as_its_tones_are_undone(ball):
    as_camera = estimate(seen(ball, 0.6, "camera"), Grey(), SETTINGS, material="grey")
    as_phone = estimate(seen(ball, 0.6, "phone"), Grey(), SETTINGS, material="grey")
    assert off(as_phone) < 0.7 * off(as_camera)
    assert off(as_phone) < 1.5 * stated(as_phone)
    assert as_phone.scene.tones in STRENGTHS and as_phone.scene.tones > 0
    assert as_phone.choice["tones"].startswith("tones that a phone moves place by place: undone by ")
    assert "tones" not in as_camera.choice and as_camera.scene.tones is None and as_camera.otherwise == ()
    assert not any("tone curve" in each for each in as_phone.scene.reporter.warnings)


def test_tones_that_were_not_moved_are_left(ball):
    as_camera = estimate(seen(ball, 1.0, "camera"), Grey(), SETTINGS, material="grey")
    as_phone = estimate(seen(ball, 1.0, "phone"), Grey(), SETTINGS, material="grey")
    assert as_phone.scene.tones == 0.0 and "left as they are" in as_phone.choice["tones"]
    np.testing.assert_array_equal(as_phone.fit.coefficients, as_camera.fit.coefficients)


def test_a_phone_is_known_by_its_file(ball):
    said, told = (seen(ball, 0.6, *how) for how in (("phone", ""), ("auto", "Apple iPhone 13")))
    of_said, of_file = (estimate(scene, Grey(), SETTINGS, material="grey") for scene in (said, told))
    np.testing.assert_array_equal(of_file.fit.coefficients, of_said.fit.coefficients)
    assert of_file.choice["tones"] == of_said.choice["tones"]
    assert "the file is from Apple iPhone 13" in of_file.choice["curve"] and "as stated" in of_said.choice["curve"]


def test_what_is_stated_has_the_light_of_other_tones_in_it(ball, monkeypatch):
    """As often as they are probable, each in the scale of the light that was elected."""
    shares = {USUAL: 0.5, 0.0: 0.3, 0.6: 0.2}
    monkeypatch.setattr(estimation, "probabilities", lambda left: {each: shares[each] for each in left})
    found = estimate(seen(ball, 0.6, "phone"), Grey(), SETTINGS, material="grey")
    own, count = found.light.fit, len(found.light.fit.samples)
    assert found.scene.tones == USUAL and [share for _, share in found.otherwise] == [0.3, 0.2]
    np.testing.assert_array_equal(found.fit.samples[: count // 2], own.samples[: count // 2])
    others = np.split(found.fit.samples[count // 2 :], [round(0.3 * count)])
    for (fit, _), samples in zip(found.otherwise, others, strict=True):
        scale = (samples * fit.samples[: len(samples)]).sum() / np.square(fit.samples[: len(samples)]).sum()
        np.testing.assert_allclose(samples, scale * fit.samples[: len(samples)], rtol=1e-9)
        light = scale * fit.all_coefficients
        left = ((own.all_coefficients - light) * light).sum()  # no other scale is nearer
        assert left == pytest.approx(0, abs=1e-6 * np.square(light).sum())
    wider = stated(found) / expected_error(own.all_coefficients, own.samples)["order_2"]["median"]
    monkeypatch.setattr(checks, "TONES_MATTER", 0.99 * wider)
    (said,) = checks.tones_doubts(found)
    assert f"stated {wider:.1f} times as wide" in said and said in checks.all_doubts(found)
    monkeypatch.setattr(checks, "TONES_MATTER", 1.01 * wider)
    assert checks.tones_doubts(found) == checks.tones_doubts(replace(found, otherwise=())) == []
    assert stated(found) > 1.05 * expected_error(own.all_coefficients, own.samples)["order_2"]["median"]


def test_slow_refinements_are_asked_of_what_was_elected_alone(ball, monkeypatch):
    """So an estimate with all of them takes one more; a quick one is elected whole."""
    asked = []

    def slow(model, light):
        asked.append(model.problems[0].scene.tones)
        return model, light, {"slow": "asked"}

    monkeypatch.setattr(estimation, "SLOW", (slow,))
    monkeypatch.setattr(estimation, "REFINEMENTS", (slow,))
    monkeypatch.setattr(estimation.refinements_of, "__defaults__", ((slow,),))
    quick, whole = (
        estimate(seen(ball, 1.0, "phone"), Grey(), replace(SETTINGS, refine=how), material="grey")
        for how in ("quick", "all")
    )
    assert whole.scene.tones != USUAL
    assert asked == [whole.scene.tones] and "slow" in whole.choice and "slow" not in quick.choice
    assert quick.scene.tones == whole.scene.tones and len(quick.otherwise) == len(whole.otherwise) == 2


@pytest.mark.parametrize("said", ["camera", "phone"])
def test_the_curve_is_not_doubted_of_what_no_curve_has_made_of_codes(ball, monkeypatch, said):
    logs = cycle([0.0, 9.0])  # by the camera's curve, and by sRGB
    monkeypatch.setattr(curves, "log_probability", lambda *_: next(logs))
    scene = seen(ball, 0.6, said)
    estimate(scene, Grey(), SETTINGS, material="grey")
    assert any("tone curve is doubtful" in each for each in scene.reporter.warnings) == (said == "camera")


def test_an_object_is_recognised_once_with_the_usual_undone(ball, monkeypatch):
    asked, recognised = [], estimation.materials_of_all

    def materials(scenes, *about, **how):
        asked.append([scene.tones for scene in scenes])
        return recognised(scenes, *about, **how)

    monkeypatch.setattr(estimation, "materials_of_all", materials)
    estimate(seen(ball, 0.6, "phone"), Grey(), SETTINGS, material="grey")
    assert asked == [[USUAL]]


def test_least_squares_undoes_what_is_usual(ball):
    paper = choose("paper", pixels=500, directions=128)
    found = estimate(seen(ball, 0.6, "phone"), Grey(), paper, material="grey")
    assert found.scene.tones == USUAL and found.otherwise == () and "usual" in found.choice["tones"]
    np.testing.assert_array_equal(
        found.scene.job.photo.radiance, with_tones_undone(seen(ball, 0.6, "phone"), USUAL).job.photo.radiance
    )


def test_what_follows_has_its_tones_undone_as_far(ball):
    first = estimate(seen(ball, 0.6, "phone"), Grey(), SETTINGS, material="grey")
    scene = seen(ball, 0.6, "phone", exposure=0.8)
    read = Follower(first, Grey()).scene_of(scene, scene.job.photo, Reporter())
    assert read.tones == first.scene.tones
    np.testing.assert_array_equal(
        read.job.photo.radiance, with_tones_undone(scene, first.scene.tones).job.photo.radiance
    )
    followed = Follower(first, Grey()).estimate(read)
    assert followed.how != CHOSEN and abs(off(followed.estimate) - off(first)) < 0.05
