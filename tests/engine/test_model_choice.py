# SPDX-License-Identifier: GPL-3.0-or-later
"""The simplest model within one standard error: appearance, order, and what is worth trying."""

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine.btf.model import Lambertian, Tabulated
from btfsep_engine.commands.record import determined_words
from btfsep_engine.commands.sequence import frame_files, missing_frames
from btfsep_engine.errors import InputError
from btfsep_engine.pipeline.refine.order import cross_validated_order, determined_order
from btfsep_engine.pipeline.refine.texture import held_against_each_other, texture_contrast, texture_may_help


def checkered(period=8):
    """A Tabulated of black and white squares, 1 mm a texel."""
    i = np.arange(64) // period
    texels = ((i[:, None] + i) % 2 * 1.6 + 0.2).astype(np.float32)[..., None]
    up = np.array([[0.0, 0.0, 1.0]])
    return Tabulated("fabric/check", "fabric", texels, np.ones((1, 1, 3, 1), np.float32), up, up, 1.0)


def test_the_texture_fades_with_the_footprint():
    material = checkered()
    contrasts = [texture_contrast(material, mm) for mm in (0.5, 4, 8, 16, 100)]
    assert contrasts[0] == pytest.approx(0.8, rel=1e-6) and contrasts[3] < 0.01 and contrasts[4] == 0
    assert all(a >= b - 1e-9 for a, b in pairwise(contrasts))
    assert texture_contrast(material.mean_material(), 0.1) == 0


def test_a_texture_is_worth_trying_where_it_lines_up_and_is_seen():
    own, computed = SimpleNamespace(uv="mesh"), SimpleNamespace(uv="xatlas")
    material = checkered()
    assert texture_may_help(own, material, 1.0)[0] and not texture_may_help(own, material, 16.0)[0]
    assert not texture_may_help(computed, material, 1.0)[0]
    assert not texture_may_help(own, Lambertian("x", np.ones(3)), 1.0)[0]


def test_each_light_is_held_against_what_the_other_was_found_by(rng):
    """The one that knows what the other does, and more, leaves less over there."""
    true, count = rng.normal(size=(9, 3)), 400

    def light(x):
        return SimpleNamespace(left_over=lambda problems: problems[0].b - np.einsum("ptc,tc->pc", problems[0].a, x))

    def told(few, weights=None):
        """A problem whose basis images tell the first ``few`` coefficients, and its light."""
        a = rng.normal(size=(count, 9, 3)) * (np.arange(9) < few)[:, None]
        b = np.einsum("ptc,tc->pc", a, true) + 0.1 * rng.normal(size=(count, 3))
        known = true * (np.arange(9) < few)[:, None]
        return light(known), [SimpleNamespace(a=a, b=b, weights=weights, blocks=np.zeros(count))]

    few, all_of_it = told(5), told(9)
    of_few, of_all = held_against_each_other(few, all_of_it)
    assert of_few == pytest.approx(0, abs=1e-9) and of_all > 10
    assert held_against_each_other(all_of_it, few) == [of_all, of_few]
    spared = np.ones((count, 3))
    spared[: count // 2] = 0  # what does not count
    found, problems = told(9, spared)
    problems[0].b[: count // 2] += 5
    left = [np.square(each.left_over(problems)[count // 2 :]).sum() for each in (found, few[0])]
    of_spared, _ = held_against_each_other((found, problems), few)
    assert of_spared == pytest.approx(left[1] / left[0] - 1)


def test_cross_validation_finds_the_order_that_made_the_photo(rng):
    basis = rng.normal(size=(3000, 25, 3))
    basis[:, 0] += 2
    x = rng.normal(size=(25, 3))
    x[9:] = 0
    b = np.einsum("pmc,mc->pc", basis, x) + 0.5 * rng.normal(size=(3000, 3))
    order, reason = cross_validated_order(basis, b, np.arange(3000) // 30, 4)
    assert order == 2 and "one standard error" in reason
    # so few pixels that all are of one block: nothing tells one order from another
    assert cross_validated_order(basis[:20], b[:20], np.zeros(20, int), 4)[0] == 0


def test_the_reported_order_is_the_highest_with_something_determined():
    known = np.zeros(25, bool)
    assert determined_order(known) == 1
    known[[0, 2]] = True
    assert determined_order(known) == 1
    known[10] = True
    assert determined_order(known) == 3
    assert determined_order(np.zeros(1, bool)) == 0


def test_what_is_determined_in_words():
    all_of_them = np.ones(100, bool)
    all_of_them[16:] = False
    all_of_them[20] = True
    text = determined_words(all_of_them[:25], all_of_them)
    assert text == (
        "the photo determines 17 of 100 coefficients, 17 of the 25 that are reported; "
        "all up to order 3, none above order 4"
    )
    assert "not even" in determined_words(*np.zeros((2, 4), bool))
    assert "not all of any order" in determined_words(*np.tile([False, True, True, True], (2, 1)))


def test_frames_come_in_the_order_of_their_numbers(tmp_path):
    for name in ("f10.png", "f9.png", "f100.png", "notes.txt", "a.png"):
        (tmp_path / name).touch()
    assert [p.name for p in frame_files(tmp_path / "f*.png")] == ["f9.png", "f10.png", "f100.png"]
    assert len(frame_files(tmp_path)) == 4
    (tmp_path / "f9.jpg").touch()
    with pytest.raises(InputError, match="two frames"):
        frame_files(tmp_path / "f*")
    with pytest.raises(InputError, match="no image matches"):
        frame_files(tmp_path / "g*")


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ("998 999 1000 1001", ""),
        ("998 999 1001 1002", "there is no photo of frame 1000 between 998 and 1002"),
        ("10 20 30 60 70", "there is no photo of frame 40 and 1 more between 10 and 70"),
        ("1 2 3 900000000", "there is no photo of frame 4 and 899999995 more between 1 and 900000000"),
        ("1 3 4", "there is no photo of frame 2 between 1 and 4"),
        ("1 5 7 20", ""),
        ("7 07 007", ""),
        ("1 3", ""),
    ],
)
def test_frames_that_are_missing_are_told(numbers, said):
    files = [Path(f"v2_shot.{n}.exr") for n in numbers.split()]
    assert missing_frames(files).partition(";")[0] == said
    assert missing_frames([*files, Path("other.exr")]) == ""
