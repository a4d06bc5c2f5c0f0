# SPDX-License-Identifier: GPL-3.0-or-later
"""The doubts of a card: their words, what mends them, and which of them comes first."""

from types import SimpleNamespace

import numpy as np
import pytest

from blender_btfsep.light import card
from blender_btfsep.scene import own_surface
from blender_btfsep.window import mending
from btfsep_engine.fit import tone_curve
from btfsep_engine.pipeline.refine.curves import curve_words
from btfsep_engine.pipeline.tone import Curves
from tests.blender.found import lighting
from tests.blender.test_card import FRONT


def test_paint_that_the_job_does_not_know_is_said_with_the_way_to_its_material():
    told = (
        "the light leaves over 26 % of object 'Jug, old', object 'Lid', which the job says to be alike all over; what "
        "is known of the light is stated 2.0 times as wide; there may be paint, or another finish than the job says"
    )
    (shown,) = card.card_of({}, lighting(), FRONT, warnings=[told])["warnings"]
    assert shown == {
        "short": "There may be paint on Jug, old, Lid, or another finish than its material has",
        "mend": "SELECT",
        "object": "Jug, old\nLid",
    }


def test_surfaces_that_are_not_as_the_light_makes_them_are_said_by_name_with_the_way_to_their_material():
    between = "is said to reflect 0.08, 0.08, 0.08 (red, green, blue), and the photo shows about 0.79, 0.74, 0.70 of it"
    otherwise = (
        f"occluder 'Table' {between}, which it was taken to reflect (by evidence); check its 'surface'; occluder "
        f"'John's wall' {between}, which it was taken to reflect (by evidence); check its 'surface'"
    )
    far = f"occluder 2 {between}: the light is another than was found, or what is said is wrong"
    unlike = (
        "occluder 'Table' is 25 % brighter in the photo than its 'surface' is under the light that was found: one "
        "of both is wrong, and in half of the cases what is known of the light is stated 3.8 times as wide; check its "
        "'surface'"
    )
    first = "the photo determines 2 of 25 coefficients, and not all of the first four"
    found = card.card_of({}, lighting(), FRONT, warnings=[first, otherwise, far, unlike])
    assert [(w["short"], w["mend"], w["object"].splitlines()) for w in found["warnings"][:3]] == [
        (
            "The photo shows Table, John's wall in another colour than Blender has; the light goes by the photo's",
            "SELECT",
            ["Table", "John's wall"],
        ),
        (
            "Table is 25 % brighter in the photo than in this light: the material is wrong, or the light",
            "SELECT",
            ["Table"],
        ),
        (
            "The photo tells only in part from where the light comes",  # which comes of it
            "FREEZE",
            [],
        ),
    ]
    unnamed = (
        "The photo shows what stands around in another colour than Blender has: the material is wrong, or the light"
    )
    assert (found["warnings"][3]["short"], found["warnings"][3]["mend"]) == (unnamed, "")
    assert not any("surface'" in words for words in found["details"])


@pytest.mark.parametrize(("found", "words", "mend"), [
    (tone_curve.AGX, "AgX (76 % sure); if it was Standard", "STANDARD"),
    (tone_curve.VIEWS["agx-punchy"], "AgX, Punchy (76 % sure); if it was Standard", "STANDARD"),
    (tone_curve.SRGB, "Standard (76 % sure); if it was AgX", "AGX"),
])  # fmt: skip
def test_where_a_render_may_have_been_saved_with_another_view_it_is_asked(found, words, mend):
    job = SimpleNamespace(
        image_colorspace="auto", photo=SimpleNamespace(bits=8, is_render=True, camera="", profile=None)
    )
    for share, asked in ((0.76, True), (0.9, False)):
        curves = Curves(None, (found, tone_curve.VIEWS["filmic"]), np.array([share, 1 - share]))
        said = curve_words([SimpleNamespace(scene=SimpleNamespace(job=job, curves=curves))])
        doubts = card.card_of({"choice": {"curve": said}}, lighting(), FRONT)["warnings"]
        assert [(d["short"], d["mend"]) for d in doubts] == asked * [
            (f"Taken for a render saved with {words}, say so", mend)
        ]
    assert mending.READ_AS[mend] in {"agx", "srgb"}
    assert not card.card_of({"choice": {"curve": "the photo's tone curve is sRGB"}}, lighting(), FRONT)["warnings"]


def test_how_the_photo_is_read_is_asked_before_what_may_come_of_it():
    said = [
        "occluder 'Table' is 23 % brighter in the photo than its 'surface' is under this light",
        "the material does not go with the photo",
        "the photo looks like a render that was saved with that view",
        "it says that it is to be turned",
    ]
    shown = card.card_of({}, lighting(), warnings=said)["warnings"]
    assert [doubt["mend"] for doubt in shown] == ["AGX", "UPRIGHT", "SELECT", "MATERIAL"]


def test_what_an_object_is_made_of_is_asked_before_what_may_come_of_that():
    said = [
        "occluder 'Table' is 23 % brighter in the photo than its 'surface' is under this light",
        "the material does not go with the photo",
        f"object 'Cup': {own_surface.RELIEF.format('Clay')}",
        "object 'Head' looks like none of the library's materials: a plain surface stands for it",
        "geometry and photo did not line up: for this estimate the camera is moved by 9.1 pixels",
    ]
    shown = [doubt["short"] for doubt in card.card_of({}, lighting(), warnings=said)["warnings"]]
    assert shown == [
        "Objects or camera are out of place; the engine made up for it",
        "Bumps of Cup's material are not followed: the light goes by the mesh alone",
        "Head looks like no material of the library; give its colour",
        "Table is 23 % brighter in the photo than in this light: the material is wrong, or the light",
    ]


def test_how_much_of_an_object_is_left_out_is_said_but_not_of_two_pixels():
    told = "{} of 3000 pixels show something else than the light explains: things in front of the objects"
    assert not card.card_of({}, lighting(), warnings=[told.format(2)])["warnings"]
    for lost, words in ((988, "33 %"), (29, "A little")):
        (shown,) = card.card_of({}, lighting(), warnings=[told.format(lost)])["warnings"]
        assert (
            shown["short"] == f"{words} of the object is left out: something is in front of it, or it has paint there"
        )
        assert shown["mend"] == "MASK"
