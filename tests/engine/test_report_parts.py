# SPDX-License-Identifier: GPL-3.0-or-later
"""What a report is put together from: pictures filled from few pixels, and lines of text."""

import cv2
import numpy as np
import pytest

from btfsep_engine.commands import report
from btfsep_engine.imaging import lettering

RANDOM = np.random.default_rng(3)
ROW, COLUMN = np.mgrid[:80, :96]
DISC = (ROW - 40) ** 2 + (COLUMN - 48) ** 2 < 36**2


def some_of(region, stride):
    """Pixels (n, 2) of a region, about one of each stride x stride."""
    kept = np.flatnonzero(region & (RANDOM.random(region.shape) < 1 / stride**2))
    return np.stack(np.unravel_index(kept, region.shape), -1)


def test_a_smooth_picture_is_filled_from_some_of_its_pixels():
    whole = np.stack([ROW / 80 + 1, np.sin(COLUMN / 30) + 2], -1)
    pixels = some_of(DISC, 3)
    found = report.filled(pixels, whole[tuple(pixels.T)], DISC, 3)
    assert found.shape == (80, 96, 2)
    np.testing.assert_allclose(found[DISC], whole[DISC], atol=0.12)
    assert np.abs(found - whole)[DISC].mean() < 0.03


def test_what_no_pixel_is_near_to_has_the_nearest_ones_value():
    two = np.zeros((40, 90), bool)
    two[10:20, 5:15] = two[10:20, 70:80] = True  # a part of its own, of which no pixel is known
    pixels = np.argwhere(two & (np.arange(90) < 40))
    found = report.filled(pixels, np.full((len(pixels), 1), 0.7), two, 2)
    np.testing.assert_allclose(found[two], 0.7, rtol=1e-5)


def test_all_pixels_are_taken_as_they_are():
    values = RANDOM.random((int(DISC.sum()), 3))
    found = report.filled(np.argwhere(DISC), values, DISC, 1)
    np.testing.assert_allclose(found[DISC], values.astype(np.float32))


def test_values_are_carried_along_a_rough_picture():
    """The truth has the guide's detail; the guide lacks a factor for each channel, a slow change and even light."""
    guide = (0.6 + 0.3 * np.sin(COLUMN / 2.0) * np.cos(ROW / 3.0))[..., None] * [1.0, 0.7, 0.4]
    truth = 5 * (guide * [0.8, 1.0, 1.3] * (1 + 0.3 * ROW[..., None] / 80) + 0.1 * COLUMN[..., None] / 96)
    pixels = some_of(DISC, 4)
    found = report.carried(guide.astype(np.float32), pixels, truth[tuple(pixels.T)], DISC)
    off = np.linalg.norm((found - truth)[DISC]) / np.linalg.norm(truth[DISC])
    filled = report.filled(pixels, truth[tuple(pixels.T)], DISC, 4)
    without = np.linalg.norm((filled - truth)[DISC]) / np.linalg.norm(truth[DISC])
    assert off < 0.06 < 0.12 < without


@pytest.mark.parametrize("unit", [1e-20, 1.0, 1e20])
def test_a_photo_may_be_in_any_unit(unit):
    pixels = some_of(DISC, 4)
    found = report.carried(np.ones((80, 96, 3), np.float32), pixels, np.full((len(pixels), 3), unit), DISC)
    np.testing.assert_allclose(found[DISC], unit, rtol=1e-4)


def ink(picture) -> np.ndarray:
    """Columns in which a picture above the panels is not white."""
    return np.flatnonzero((picture[: lettering.ABOVE] < 128).any((0, 2)))


def test_labels_stand_above_the_middle_of_their_pictures():
    black = np.zeros((50, 100, 3), np.uint8)
    row = lettering.row([("HHHH", black), ("", black)])
    assert row.shape[:2] == (lettering.ABOVE + 330 + lettering.BELOW, 2 * 660 + 3 * lettering.BESIDE)
    columns = ink(row)
    assert abs(columns.mean() - (lettering.BESIDE + 330)) < 2
    assert np.ptp(columns) == pytest.approx(lettering.width("HHHH"), abs=6)
    assert (row[lettering.ABOVE + 5 : -10, 20:600] == 0).all()


def test_a_label_is_no_wider_than_its_picture():
    row = lettering.row([("wood/" * 40, np.zeros((10, 10, 3), np.uint8)), ("", np.zeros((10, 10, 3), np.uint8))])
    assert 250 < np.ptp(ink(row)) < 350
    assert lettering.shortened("short", 100) == "short" and lettering.shortened("l" * 90, 50).endswith("…")


def test_letters_that_are_not_there_are_marked():
    missing, known = (lettering.row([(t, np.zeros((9, 9, 3), np.uint8))])[: lettering.ABOVE] for t in ("木", "Äß"))
    assert (missing < 128).any() and not np.array_equal(missing, known)
    assert np.array_equal(missing, lettering.row([("\ufffd", np.zeros((9, 9, 3), np.uint8))])[: lettering.ABOVE])


def test_letters_are_those_of_the_font():
    """Against OpenCV's own strokes: a letter covers about the places where another font has it."""
    for letter in "HTLEO":
        cover = lettering.letters()[letter][0]
        strokes = np.zeros((60, 60), np.uint8)
        cv2.putText(strokes, letter, (10, 50), cv2.FONT_HERSHEY_SIMPLEX, 1.4, 255, 4)
        used = np.argwhere(strokes)
        (top, left), (bottom, right) = used.min(0), used.max(0) + 1
        other = cv2.resize(strokes[top:bottom, left:right], cover.shape[::-1], interpolation=cv2.INTER_AREA)
        assert np.corrcoef(cover.ravel(), other.ravel())[0, 1] > 0.4, letter
