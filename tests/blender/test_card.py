# SPDX-License-Identifier: GPL-3.0-or-later
"""The card of a light: its words against lights that are known, and that it stays with the file."""

from types import SimpleNamespace

import numpy as np
import pytest

from blender_btfsep.light import (
    advice,
    card,
    kept_light,
    light_picture,
    light_words,
    lighting_file,
)
from blender_btfsep.run import answer
from btfsep_engine import sh
from btfsep_engine.pipeline import delighting
from btfsep_engine.pipeline.refine import layers
from tests.blender.found import SAID, lighting, planck, sunny

FRONT = np.array([[1, 0, 0, 0], [0, 0, -1, -5], [0, 1, 0, 0], [0, 0, 0, 1]])  # from -Y, level, +X to the right


@pytest.mark.parametrize(
    ("direction", "words"),
    [
        ((0, -1, 0), "the front, 0° up"),
        ((1, -1, 0), "front right (45° round), 0° up"),
        ((-1, -1, 1.4142), "front left (45° round), 45° up"),
        ((-1, 0, 0), "left (90° round), 0° up"),
        ((1, 1, 0), "back right (135° round), 0° up"),
        ((0, 1, -0.2), "behind, 11° down"),
        ((0, 0.1, 1), "above, 84°"),
    ],
)
def test_directions_are_seen_from_the_camera(direction, words):
    assert light_words.direction_words(direction, FRONT) == words
    turn = np.eye(4)
    turn[:2, :2] = [[0, -1], [1, 0]]  # camera and light together, a quarter about the vertical
    assert light_words.direction_words(turn[:3, :3] @ direction, turn @ FRONT) == words


def test_a_camera_that_looks_down_has_sides_too():
    down = np.eye(4)  # up in the picture is +Y
    assert light_words.direction_words((1, 0, 0), down).startswith("right")
    assert light_words.direction_words((0, -1, 0), down).startswith("the front")


@pytest.mark.parametrize("kelvin", [2200, 3000, 4000, 5500, 6500, 9000, 12000])
def test_black_bodies_have_their_temperature(kelvin):
    assert light_words.kelvin(planck(kelvin)) == pytest.approx(kelvin, rel=0.04)


def test_colours_without_a_temperature_have_a_hue():
    assert light_words.colour_words((1, 1, 1)) == "white (6500 K)"
    assert [light_words.colour_words(c) for c in ((0, 1, 0), (1, 0, 1), (1, 0, 0), (0, 0, 1), (0, 0, 0))] == [
        "green",
        "magenta",
        "red",
        "blue",
        "dark",
    ]


def test_the_brighter_side_and_irradiance_are_those_of_a_light_that_is_known():
    b, a = np.array([0.3, -0.2, 0.6]), 1.5
    coefficients_ = np.zeros((9, 3))
    coefficients_[0] = a * np.sqrt(4 * np.pi)
    coefficients_[[3, 1, 2]] = (np.sqrt(4 * np.pi / 3) * b * [-1, -1, 1])[:, None]
    side, more = light_words.brighter_side(coefficients_)
    assert np.allclose(side, b / np.linalg.norm(b)) and more == pytest.approx(np.linalg.norm(b) / a)
    # of a + b.d a surface that faces n gets pi a + 2 pi / 3 b.n
    n = np.array([[0, 0, 1.0], [1, 0, 0], [0, -1, 0]])
    expected = np.pi * a + 2 * np.pi / 3 * n @ b
    assert np.allclose(light_words.irradiance(coefficients_, n), expected[:, None])
    c = np.random.default_rng(0).normal(size=(9, 3)) + np.eye(9, 3) * 20
    assert np.allclose(light_words.irradiance(c, n), sh.irradiance(c, n))


def test_a_light_that_is_kept_is_known_again_whatever_its_sun_is(photographed):
    """Else it would be kept anew, without its card and report, by what makes it the World."""
    suns = np.random.default_rng(0).normal(size=(40, 3))
    photographed.btfsep.sun_lamp = True
    for direction in suns / np.linalg.norm(suns, axis=1, keepdims=True):
        found = sunny()
        found["suns"]["lamps"][0]["direction"] = direction.tolist()
        kept_light.keep(photographed, lighting_file.validate(lighting_file.as_data(found)), SAID)
        answer.apply_light(photographed, kept_light.lighting_of(photographed.btfsep.light))
        assert kept_light.card(photographed.btfsep.light)["lines"][0] == ["Trust", "Good: about 12% off (8–20%)"]


def test_a_sunny_light_in_an_artists_words():
    lines = card.card_of({}, sunny(), FRONT)["lines"]
    assert len(lines) <= 6
    assert lines[0] == ["Trust", "Its error is not stated"]
    assert lines[1] == ["Key light", "front left (45° round), 45° up"]
    near = sunny()
    near["suns"]["lamps"][0]["near"] = {"centre": [0.0, 0.0, 0.0], "distance": 80.0}
    told = dict(card.card_of({}, near, FRONT, metres_per_unit=0.01)["lines"])
    assert told["Key light"] == "front left (45° round), 45° up, 0.8 m away"
    flash = {"choice": {"flash": "a flash on the camera lights the objects from 0.8 m (by evidence)"}}
    told = dict(card.card_of(flash, near, FRONT, metres_per_unit=0.01)["lines"])
    assert told["Key light"] == "the camera's flash, 0.8 m away"
    flash["choice"]["flash"] = "a light at the camera, as its flash would be, lights the objects from 0.8 m"
    told = dict(card.card_of(flash, near, FRONT, metres_per_unit=0.01)["lines"])
    assert told["Key light"] == "at the camera, as its flash, 0.8 m away"
    # where it stays in the World, the sun is no flash
    assert dict(card.card_of(flash, sunny(), FRONT)["lines"])["Key light"] == "front left (45° round), 45° up"
    # 3 of 4 pi + 3
    assert lines[2][1].startswith("hard, warm (3500 K), 19% of the light")
    # the sky's irradiance is pi
    assert lines[3] == ["Fill", "white (6500 K), even; key to fill 2.0:1"]
    assert card.card_of({}, sunny(size=12), FRONT)["lines"][2][1].startswith("soft")


def test_a_lamp_that_is_no_sun_is_the_key_and_is_not_its_own_fill():
    sun = sunny()
    lamp = sun["suns"]["lamps"][0] | {"share": 0.2}
    whole = sun | {"suns": None}  # it is in the harmonics alone
    lines = card.card_of({"lamps": [lamp]}, whole, FRONT)["lines"]
    assert lines[1] == ["Key light", "front left (45° round), 45° up"]
    assert lines[2][1] == "soft, warm (3500 K), 19% of the light"
    assert lines[3] == ["Fill", "white (6500 K), even; key to fill 2.0:1"]
    lines = card.card_of({"lamps": [lamp | {"share": 0.05}]}, whole, FRONT)["lines"]
    assert lines[1][1].startswith("front left") and "one-sided" not in lines[1][1] and "very soft" in lines[1][1]


def test_an_even_light_has_no_key():
    even = np.zeros((4, 3))
    even[0] = 2
    lines = dict(card.card_of({}, lighting(coefficients=even.tolist()), FRONT)["lines"])
    assert lines["Key light"].startswith("none") and "detail finer than 180°" in lines["Not shown"]
    known = [True, False, False, False]
    lines = dict(card.card_of({}, lighting(coefficients=even.tolist(), determined=known), FRONT)["lines"])
    assert lines["Not shown"].startswith("from where")


@pytest.mark.parametrize(
    ("median", "warnings", "trust"),
    [
        (0.1, [], "GREEN"),
        (0.2, [], "AMBER"),
        (0.5, [], "RED"),
        (0.1, ["the object's colour is not known: no usual light"], "AMBER"),
        (0.1, ["geometry and photo do not line up: the outlines in the photo lie 2 pixels down"], "RED"),
        (0.1, ["photo.png: 20 of 262144 pixels are saturated"], "GREEN"),
    ],
)
def test_trust_is_a_traffic_light(median, warnings, trust):
    result = {"expected_error": {"order_2": {"median": median, "low": median / 2, "high": 2 * median}}}
    found = card.card_of(result, lighting(), FRONT, warnings=warnings)
    assert found["trust"] == trust and f"about {100 * median:.0f}% off" in found["lines"][0][1]


def test_what_lowers_the_trust_is_pointed_at():
    result = {"expected_error": {"order_2": {"median": 0.1, "low": 0.05, "high": 0.2}}}
    doubt = "geometry and photo do not line up: the outlines in the photo lie 2 pixels down"
    assert card.card_of(result, lighting(), FRONT, warnings=[doubt])["lines"][0][1].startswith("Doubtful, see below: ")
    assert card.card_of(result, lighting(), FRONT)["lines"][0][1].startswith("Good: ")


def test_on_a_table_the_trust_is_in_the_light_that_reaches_the_photo():
    of_all = {"order_2": {"median": 0.6, "low": 0.4, "high": 0.9}}
    result = {"expected_error": of_all, "expected_error_shown": None}
    found = card.card_of(result, lighting(), FRONT)
    assert found["trust"] == "RED" and dict(map(tuple, found["lines"]))["Not shown"] != card.AROUND
    result["expected_error_shown"] = {"order_2": {"median": 0.1, "low": 0.05, "high": 0.2}}
    found = card.card_of(result, lighting(), FRONT)
    assert found["trust"] == "GREEN" and found["lines"][0][1].startswith("Good: about 10% off")
    assert dict(map(tuple, found["lines"]))["Not shown"] == card.AROUND


def test_a_few_pixels_are_no_warning():
    few, many = (f"photo.png: {n} of 388800 pixels are saturated" for n in (7, 4000))
    found = card.card_of({}, lighting(), FRONT, warnings=[few])
    assert not found["warnings"] and few in found["details"]
    assert card.card_of({}, lighting(), FRONT, warnings=[many])["warnings"]


def test_a_material_that_nothing_hangs_on_is_not_doubted_and_commands_are_left_out():
    curve = (
        "object 'Head' was recognised as wood/oak with the photo read by the tone curve that was found; read as sRGB"
    )
    none = "object 'Head' looks like none of the library's materials after all (give --material, if you know it)"
    doubts = card.card_of({}, lighting(), FRONT, warnings=[curve])["warnings"]
    assert [(d["short"][:10], d["mend"]) for d in doubts] == [("What Head ", "MATERIAL")]
    found = card.card_of({}, lighting(), FRONT, warnings=[curve, none])
    assert [d["mend"] for d in found["warnings"]] == ["COLOUR"]
    assert found["details"][-1] == "Object 'Head' looks like none of the library's materials after all"
    misfit = "the material (surface/plastic) does not go with the photo: its gloss or its class may be wrong"
    assert [d["mend"] for d in card.card_of({}, lighting(), FRONT, warnings=[misfit])["warnings"]] == ["MATERIAL"]
    both = card.card_of({}, lighting(), FRONT, warnings=[misfit, none])
    assert [(d["mend"], d["object"]) for d in both["warnings"]] == [("COLOUR", "Head")] and len(both["details"]) == 2


def test_of_a_thing_that_is_none_of_the_librarys_its_colour_is_asked_for_once():
    none = "object 'Head' looks like none of the library's materials: a plain surface stands for it"
    colour = "the object's colour is not known: no usual light makes the material look like the photo"
    result = {"objects": [{"name": "Head", "material": "surface/plastic", "likely": ["surface/plastic", "surface/m"]}]}
    found = card.card_of(result, lighting(), FRONT, warnings=[none, colour])
    assert [(d["mend"], d["object"]) for d in found["warnings"]] == [("COLOUR", "Head")] and len(found["details"]) == 2
    assert [d["mend"] for d in card.card_of({}, lighting(), FRONT, warnings=[colour])["warnings"]] == ["COLOUR"]


def test_words_of_jobs_and_commands_are_not_the_panels():
    told = "object 'A' may be one (give --material, if you know it); give its material, or its 'surface'"
    assert card.plain(told) == "object 'A' may be one; give its material, or its colour"
    assert card.plain("surface/given has no texture; check its 'surface'") == (
        "The material as given has no texture; check its material"
    )


def test_a_roughness_that_the_photo_does_not_show_is_said_with_the_one_that_it_shows():
    each = "object '{}' was taken to have a roughness of {}, where its surface says 0.50 (by evidence)"
    told = f"{each.format('Jug', 0.95)}; check its 'surface'; {each.format('Lid', 0.2)}; check its 'surface'"
    (shown,) = card.card_of({}, lighting(), FRONT, warnings=[told])["warnings"]
    assert shown == {
        "short": "The photo shows Jug, Lid with a roughness of 0.95, 0.2; the light goes by that",
        "mend": "SELECT",
        "object": "Jug\nLid",
    }


def test_what_lies_on_an_object_is_said_in_the_words_of_its_material():
    def shown(*found):
        told = "; ".join(layers.SAID.format(name, what) for name, what in found)
        (doubt,) = card.card_of({}, lighting(), FRONT, warnings=[told])["warnings"]
        return doubt["short"].partition(", of which")[0], doubt["mend"], doubt["object"]

    assert shown(("Hat", layers.FUZZ)) == ("The photo shows Hat as cloth (sheen)", "SELECT", "Hat")
    assert shown(("Jug", layers.COAT)) == ("The photo shows Jug varnished (coat)", "SELECT", "Jug")
    assert shown(("Hat", layers.FUZZ), ("Jug", layers.COAT))[0].endswith("Jug as cloth (sheen) or varnished (coat)")


def test_how_much_is_overexposed_is_said_once_and_of_the_object():
    photo = "my photo.png: 64675 of 153600 pixels are saturated"
    thing = "7 % of the pixels of object 'Jug' are saturated or transparent; the saturated ones count as at least so"
    found = card.card_of({}, lighting(), FRONT, warnings=[photo, thing])
    assert [d["short"] for d in found["warnings"]] == ["7 % of Jug is overexposed or transparent in the photo"]
    assert photo in found["details"]  # a file has its own name
    assert card.card_of({}, lighting(), FRONT, warnings=[photo])["warnings"][0]["short"].startswith("Overexposed")


def light_found_in(monkeypatch, *names):
    """What the engine says where it has found light in the textures of these objects."""
    found = SimpleNamespace(light=SimpleNamespace(contrast=0.34))
    monkeypatch.setattr(delighting, "light_in_texture", lambda obj, settings: found)
    return delighting.words_of([SimpleNamespace(name=name) for name in names], None)


def test_light_in_a_texture_is_said_with_the_way_to_keep_it(monkeypatch):
    told = light_found_in(monkeypatch, "Jug, old")
    result = {"choice": {"de_lit": told}, "expected_error": {"order_2": {"median": 0.1, "low": 0.05, "high": 0.2}}}
    found = card.card_of(result, sunny(), FRONT, warnings=[told])
    assert found["warnings"] == [
        {
            "short": "The texture of Jug, old has light in it, which was taken off",
            "mend": "KEEP",
            "object": "Jug, old",
        }
    ]
    assert found["trust"] == "GREEN" and len(found["lines"]) <= 6
    (detail,) = found["details"][1:]  # beside where the sun stands
    assert detail.startswith("The texture of object 'Jug, old' (34 %) has light in it") and "--" not in detail


def test_of_several_textures_with_light_in_them_all_are_named(monkeypatch):
    told = light_found_in(monkeypatch, "Jug", "Lid and can")
    (shown,) = card.card_of({}, lighting(), FRONT, warnings=[told])["warnings"]
    assert shown["short"] == "The texture of Jug, Lid and can has light in it, which was taken off"


def test_a_light_that_may_be_quite_another_is_not_green():
    result = {"expected_error": {"order_2": {"median": 0.1, "low": 0.06, "high": 0.7}}}
    assert card.card_of(result, lighting(), FRONT)["trust"] == "AMBER"


def test_materials_that_are_not_certain_are_said_shortly_and_once():
    names = ["leather/brown-grain", "stone/granite-grey", "felt/green", "felt/grey", "carpet/loop", "wood/oak"]
    result = {"objects": [{"name": "Cow", "material": names[0], "likely": names}]}
    long = (
        "object 'Cow' may be leather or stone, or one of 4 others: the photo does not rule them out (give --material)"
    )
    found = card.card_of(result, lighting(), FRONT, warnings=[long])
    assert [(w["short"], w["mend"], w["object"]) for w in found["warnings"]] == [
        (
            "The material of Cow is not certain (leather, stone, felt, …); choose it for a surer light",
            "MATERIAL",
            "Cow",
        )
    ]
    assert not any("may be" in sentence for sentence in found["details"])
    result["objects"][0]["likely"] = names[2:4]
    assert "(green felt or grey felt)" in card.card_of(result, lighting(), FRONT)["warnings"][0]["short"]
    assert ["Material", "brown grain leather"] in found["lines"]
    result["objects"][0]["likely"] = ["surface/metal", "reference/chrome", "wood/oak", "wood/walnut"]
    curve = "object 'Cow' was recognised as surface/metal with the photo read by the tone curve that was found"
    (shown,) = card.card_of(result, lighting(), FRONT, warnings=[curve])["warnings"]  # its material is asked for once
    assert "(plain metal, chrome or wood)" in shown["short"]
    other = curve.replace("Cow", "Calf")
    assert len(card.card_of(result, lighting(), FRONT, warnings=[other])["warnings"]) == 2


def test_warnings_that_are_not_known_are_said_by_their_beginning():
    told = "occluder 'Table': material 'Lamp' shines, which is left out; something more (and more)"
    assert advice.advice(told).short == "'Table': material 'Lamp' shines, which is left out"
    assert advice.advice("a short one").short == "A short one"
    assert not advice.advice("a mesh of 62976 faces is mapped by projecting patches onto planes").short


def test_the_icons_of_lights_that_are_gone_are_not_kept(addon):
    from blender_btfsep.basics import pixels
    from blender_btfsep.window import icons

    pictures = [pixels.new("Light", np.full((4, 8, 3), number / 50), floats=False) for number in range(3 * icons.KEPT)]
    for picture in pictures:
        picture.pack()
        assert icons.of_image(picture) == icons.of_image(picture)
    assert sum(key.startswith(icons.OF_IMAGE) for key in icons._previews) == icons.KEPT


def test_the_picture_shows_from_where_the_light_comes(photographed):
    pixels = light_picture.picture_of(photographed, sunny(), FRONT)
    assert pixels.shape == (256, 256, 3) and pixels.min() >= 0 and pixels.max() <= 1
    ball = pixels[128:, 128:]
    assert ball[40, 40].mean() > 1.2 * ball[90, 90].mean()  # from the front left, above
    above = pixels[:128].mean(-1)
    row, column = np.unravel_index(above.argmax(), above.shape)
    azimuth = 2 * np.pi * (0.5 - (column + 0.5) / 256)
    assert abs(np.degrees(azimuth) + 135) < 5 and abs(row - 32) < 3  # -X -Y, 45 degrees up
    assert np.ptp(pixels[128:, :128]) == 0  # the photo is black


def test_of_two_doubts_that_say_the_same_one_is_shown():
    texture = "the photo shows a texture of object 'Vase' of which it is not known how it reflects: what is known"
    misfit = "the material (surface/plastic) does not go with the photo: its gloss or its class may be wrong"
    none = "object 'Vase' looks like none of the library's materials: it is taken to be of one kind all over"
    off = "geometry and photo do not line up: give another camera"
    mended = "geometry and photo did not line up: for this estimate the camera is moved by 2.0 pixels"
    for told, mends in (
        ([texture], ["MATERIAL"]),
        ([texture, misfit], ["MATERIAL"]),
        ([texture, misfit, none], ["COLOUR"]),
        ([mended], ["ALIGN"]),
        ([mended, off], ["ALIGN"]),
    ):
        found = card.card_of({}, lighting(), FRONT, warnings=told)
        assert [d["mend"] for d in found["warnings"]] == mends and len(found["details"]) == len(told)
    assert found["warnings"][0]["short"] == "Photo and geometry do not line up"
