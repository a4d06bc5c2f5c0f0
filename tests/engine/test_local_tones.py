# SPDX-License-Identifier: GPL-3.0-or-later
"""Tones that phones move place by place, and what undoes it."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from btfsep_engine.imaging.colour_profile import of_primaries
from btfsep_engine.imaging.local_tones import is_phone, undone
from btfsep_engine.job.load import load_job
from btfsep_engine.pipeline.phone import (
    STRENGTHS,
    USUAL,
    moves_tones,
    probabilities,
    strengths,
    tones_words,
    with_tones_undone,
)
from btfsep_engine.pipeline.settings import choose
from tests.engine.test_camera_curve import exif, with_exif

SIDE = 200


@pytest.mark.parametrize(("camera", "phone"), [
    ("Apple iPhone 13", True), ("Google Pixel 7", True), ("samsung SM-G991B", True), ("SAMSUNG NX500", False),
    ("ONEPLUS A6013", True), ("HUAWEI VOG-L29", True), ("Canon EOS 6D", False), ("", False), ("Applesauce 1", False),
    ("vivo 1901", True), ("NIKON CORPORATION NIKON D7200", False), ("HMD Global Nokia 7", True),
])  # fmt: skip
def test_which_cameras_are_phones(camera, phone):
    assert is_phone(camera) is phone


def scene_of_two(side=SIDE) -> np.ndarray:
    """A bright half and one four stops darker, both of the same fine pattern."""
    x = np.arange(side)
    pattern = 1 + 0.2 * np.sin(2 * np.pi * x / 8 * SIDE / side)[None] * np.sin(2 * np.pi * x / 8 * SIDE / side)[:, None]
    return (pattern * np.where(x < side / 2, 1.0, 2.0**-4))[..., None] * np.array([1.0, 0.8, 0.5])


def pressed(linear, a) -> np.ndarray:
    """What presses large contrasts to 1 / (1 + a), by a bilateral filter, which the engine does not use."""
    log = np.log2(linear.mean(-1)).astype(np.float32)
    large = cv2.bilateralFilter(log, -1, 1.0, 0.05 * len(log))
    return linear * np.exp2((1 / (1 + a) - 1) * (large - large.max()))[..., None]


def contrast(picture) -> float:
    """Stops between the middles of the halves."""
    n = len(picture)
    bright, dark = (picture[:, s].mean() for s in (slice(n // 8, 3 * n // 8), slice(5 * n // 8, 7 * n // 8)))
    return float(np.log2(bright / dark))


@pytest.mark.parametrize("a", [0.3, 0.6])
def test_large_contrasts_come_back_and_details_and_colours_stay(a):
    linear = scene_of_two()
    shown = pressed(linear, a)
    assert contrast(shown) < 4 / (1 + 0.8 * a)
    found = undone(shown, a)
    assert found.dtype == np.float32 and contrast(found) == pytest.approx(4, abs=0.25)
    for s in (slice(30, 70), slice(130, 170)):  # away from the edge
        before, after = (each[30:170, s].std() / each[30:170, s].mean() for each in (linear[..., 0], found[..., 0]))
        assert after == pytest.approx(before, rel=0.2)
    np.testing.assert_allclose(found / found[..., :1], shown / shown[..., :1], rtol=1e-5)
    assert np.percentile(found, 99) == pytest.approx(np.percentile(shown, 99), rel=0.1)


def test_nothing_is_moved_where_nothing_was_nor_of_a_black_picture():
    picture = scene_of_two()
    np.testing.assert_array_equal(undone(picture, 0.0), picture.astype(np.float32))
    assert not undone(np.zeros((20, 30, 3)), 0.6).any()
    flat = np.full((20, 30, 3), 0.4)
    np.testing.assert_allclose(undone(flat, 0.6), flat, rtol=1e-5)


def test_neither_the_exposure_nor_the_size_of_a_picture_matters():
    picture = pressed(scene_of_two(), 0.6)
    np.testing.assert_allclose(undone(1e-4 * picture, 0.6), 1e-4 * undone(picture, 0.6), rtol=1e-3)
    spots = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(SIDE, SIDE)), (0, 0), 6)
    small = np.exp(5 * spots)[..., None] * np.ones(3)  # as large as what means are of
    large = cv2.resize(small, (4 * SIDE, 4 * SIDE), interpolation=cv2.INTER_CUBIC)  # of which they are interpolated
    by_large = cv2.resize(undone(large, 0.6), (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    change, off = (np.log(each).std() for each in (undone(small, 0.6) / small, by_large / undone(small, 0.6)))
    assert off < 0.35 * change and change > 0.05


def job(stated="auto", camera="Apple iPhone 13", bits=8, profile=None):
    photo = SimpleNamespace(bits=bits, camera=camera, profile=profile)
    return SimpleNamespace(image_colorspace=stated, photo=photo)


@pytest.mark.parametrize(("told", "moved"), [
    ({}, True), ({"camera": "Canon EOS 6D"}, False), ({"camera": "", "stated": "phone"}, True), ({"bits": None}, False),
    ({"stated": "phone", "bits": None}, False), ({"stated": "camera"}, False), ({"stated": "srgb"}, False),
    ({"stated": "unknown"}, False), ({"profile": SimpleNamespace(linear=True)}, False),
    ({"profile": of_primaries("display-p3")}, True),
    ({"stated": "phone", "profile": SimpleNamespace(linear=True)}, True),
])  # fmt: skip
def test_of_which_photos_tones_were_moved(told, moved):
    assert moves_tones(job(**told)) is moved
    scene = SimpleNamespace(job=job(**told))
    tried = strengths([SimpleNamespace(job=job(stated="linear")), scene], choose("draft"))
    assert tried == ((USUAL, 0.0, 0.6) if moved else (None,))
    usual = (USUAL,) if moved else (None,)
    assert strengths([scene], choose("paper")) == strengths([scene], choose("draft", refine="least")) == usual
    if not moved:
        assert with_tones_undone(scene, USUAL) is scene
    assert with_tones_undone(scene, None) is scene


def test_a_job_of_a_phones_picture_is_read_by_the_curve_of_cameras_and_its_tones_undone(job):
    job.tree["image"] = "a.jpg"
    (job.folder / "a.jpg").write_bytes(with_exif(".jpg", exif("Apple", "iPhone 13"), 8, 12))
    by_file, stated, as_camera, linear = (
        load_job(job.write(), colorspace=read) for read in (None, "phone", "camera", "linear")
    )
    assert by_file.photo.camera == "Apple iPhone 13"
    for each in (by_file, stated):
        np.testing.assert_array_equal(each.photo.radiance, as_camera.photo.radiance)
        read = with_tones_undone(SimpleNamespace(job=each), USUAL)
        assert read.tones == USUAL
        np.testing.assert_array_equal(read.job.photo.radiance, undone(as_camera.photo.radiance, USUAL))
    assert with_tones_undone(SimpleNamespace(job=linear), USUAL).job is linear


def test_what_leaves_less_over_is_more_probable_and_what_is_usual_where_nothing_tells():
    alike = probabilities(dict.fromkeys(STRENGTHS, 0.1))
    assert alike == pytest.approx(STRENGTHS) and max(alike, key=alike.get) == USUAL
    clear = probabilities({0.3: 0.17, 0.0: 0.1, 0.6: 0.25})
    assert clear[0.0] > 0.7 and sum(clear.values()) == pytest.approx(1)
    assert probabilities({0.3: 0.01, 0.0: 1e-9, 0.6: 0.0}) == pytest.approx(STRENGTHS)  # no better than can be told


def test_words():
    said = tones_words({0.3: 0.64, 0.0: 0.02, 0.6: 0.34})
    assert said == (
        "tones that a phone moves place by place: undone by 0.3 (probability 0.64); "
        "also: undone by 0.6 (probability 0.34)"
    )
    assert "left as they are (probability 1.00)" in tones_words({0.3: 0.001, 0.0: 0.998, 0.6: 0.001})
