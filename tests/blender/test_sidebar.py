# SPDX-License-Identifier: GPL-3.0-or-later
"""What the sidebar shows: sentences over as many lines as they need, and buttons."""

import json
from functools import partial
from types import SimpleNamespace

import blf
import bpy
import pytest

from blender_btfsep.basics import labels
from blender_btfsep.engine import checkup
from blender_btfsep.light import kept_light, lighting_file
from blender_btfsep.panels import doubts, light_panel, photo_panels
from blender_btfsep.run import answer, runs
from blender_btfsep.window import mending
from tests.blender.lit import LIGHTING

PATH = "/tmp/blender_VC1elB/btfsep/sun-8bcbcf0a/Renamed/result/lighting.json"


@pytest.mark.parametrize("width", [3, 12, 30, 200])
def test_nothing_of_a_long_path_is_left_out(width):
    text = f"The light of a file that was left is in {PATH}"
    made = labels.lines(text, lambda line: len(line) <= width)
    assert all(len(line) <= width for line in made)
    assert "".join(made).replace(" ", "") == text.replace(" ", "")


def test_lines_break_between_words_and_names_of_folders():
    assert labels.lines("a light is in /one/two/three", lambda line: len(line) <= 10) == [
        "a light is",
        "in",
        "/one/two/",
        "three",
    ]
    assert labels.lines("", lambda line: True) == [""]
    told = labels.lines("warm white (5500 K), 42 % of it, 3 m away", lambda line: len(line) <= 17)
    assert told == ["warm white", "(5500\u00a0K), 42\u00a0% of", "it, 3\u00a0m away"]


class Drawn:
    """A layout that keeps the names of the properties that it is to show."""

    def __init__(self):
        self.shown, self.icons = [], {}

    def split(self, **_):
        return self

    def label(self, **_):
        pass

    def prop(self, owner, name, icon="NONE", **_):
        self.shown.append(name)
        self.icons[name] = icon


@pytest.mark.parametrize("lacking", ["", "Choose the photo first"])
def test_live_can_be_switched_off_where_no_estimate_can_be_begun(photographed, tmp_path, lacking):
    (tmp_path / "light.json").write_text(json.dumps(LIGHTING))
    answer.apply_light(photographed, lighting_file.read(tmp_path / "light.json"))
    photographed.btfsep.live, layout = True, Drawn()
    light_panel.BTFSEP_PT_light._beside(None, bpy.context, layout, runs.run_state(), lacking)
    assert layout.shown == ["live"] and layout.icons["live"] == ("PAUSE" if lacking else "PLAY")


class Everything:
    """A layout that keeps all that it is to show, in the order of the sidebar."""

    def __init__(self):
        self.shown = []

    def __getattr__(self, kind):
        def show(*what, text="", **_):
            self.shown.append((kind, text or next((each for each in what if isinstance(each, str)), "")))
            return self

        return show

    def place(self, kind, begins=""):
        """Where the first of a kind stands; None where there is none."""
        return next((n for n, (k, w) in enumerate(self.shown) if k == kind and w.startswith(begins)), None)


def drawn(scene, width=260):
    """What the light's panel shows of ``scene`` in a sidebar of some pixels."""
    kind = light_panel.BTFSEP_PT_light
    panel = SimpleNamespace(layout=Everything())
    for name in ("_beside", "_outcome", "_card"):
        setattr(panel, name, partial(getattr(kind, name), panel))
    kind.draw(panel, seen(width, scene=scene))
    return panel.layout


def seen(width: int, **more):
    """A context as in a window, of a region of some pixels."""
    found = {name: getattr(bpy.context, name) for name in ("window_manager", "view_layer", "object")} | more
    found["preferences"] = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0))  # without a window it is 0
    return SimpleNamespace(region=SimpleNamespace(width=width), **found)


@pytest.mark.parametrize(("colour", "source", "buttons"), [
    ((0.5, 0.04, 0.03, 1), "RECOGNISE", ["As in Blender", "Give Its Colour"]),
    ((0.8, 0.8, 0.8, 1), "RECOGNISE", ["Give Its Colour"]),
    ((0.5, 0.04, 0.03, 1), "BLENDER", ["Give Its Colour"]),
])  # fmt: skip
def test_where_blender_knows_a_colour_one_click_takes_it(photographed, colour, source, buttons):
    (entry,) = photographed.btfsep.objects
    own = bpy.data.materials.new("Own")
    own.use_nodes = True
    own.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = colour
    entry.object.data.materials.append(own)
    entry.source = source
    layout = Everything()
    for name in ("", entry.object.name):
        doubt = {"short": "Its colour is not known", "mend": "COLOUR", "object": name}
        doubts.draw(seen(260, scene=photographed), layout, doubt)
    assert [words for kind, words in layout.shown if kind == "operator"] == 2 * buttons
    assert bpy.ops.btfsep.mend(how="BLENDER", object=entry.object.name) == {"FINISHED"} and entry.source == "BLENDER"


def test_a_colour_that_blender_knows_is_a_click_away_before_anything_is_estimated(photographed, capfd):
    (entry,) = photographed.btfsep.objects
    entry.object.data.materials.append(own := bpy.data.materials.new("Own"))
    own.use_nodes = True
    own.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.5, 0.04, 0.03, 1)

    def buttons():
        panel = SimpleNamespace(layout=Everything())
        photo_panels.BTFSEP_PT_objects.draw(panel, seen(260, scene=photographed))
        return [words for words in operators(panel.layout) if words in mending.WORDS.values()]

    assert buttons() == ["As in Blender"]
    assert bpy.ops.btfsep.mend(how="BLENDER", object=entry.object.name) == {"FINISHED"} and entry.source == "BLENDER"
    assert buttons() == [] and "again" not in "".join(capfd.readouterr())  # nothing was estimated yet


@pytest.mark.parametrize(("width", "words"), [(208, False), (400, True)])
def test_in_a_narrow_sidebar_words_have_the_room_that_there_is(photographed, width, words):
    shown = {}

    class Kept(Everything):
        def prop(self, owner, name, **how):
            shown[name] = how.get("expand", False), how.get("text")

    panel, context = SimpleNamespace(layout=Kept()), seen(width, scene=photographed)
    for kind in (photo_panels.BTFSEP_PT_photo, photo_panels.BTFSEP_PT_objects, light_panel.BTFSEP_PT_advanced):
        kind.draw(panel, context)
    assert shown["overlay"] == ((True, None) if words else (False, ""))
    assert shown["source"] == (False, None if words else "")
    assert [shown[name][1] for name in ("exposure_ev", "clamp")] == (
        ["Photo Exposure", "Clamp Negative"] if words else ["Exposure", "Clamp"]
    )


def test_a_texture_with_light_in_it_has_a_button_and_a_field(photographed):
    layout = Everything()
    doubt = {"short": "The texture has light in it", "mend": "KEEP", "object": "Cube"}
    doubts.draw(seen(260, scene=photographed), layout, doubt)
    assert [words for kind, words in layout.shown if kind == "operator"] == ["Keep Its Colours"]
    panel = SimpleNamespace(layout=Everything())
    light_panel.BTFSEP_PT_advanced.draw(panel, seen(260, scene=photographed))
    assert ("prop", "delight") in panel.layout.shown


def operators(layout) -> list:
    return [words for kind, words in layout.shown if kind == "operator"]


def has_doubt(scene, sentence: str):
    """Makes a light that the engine doubts the World; gives a function that draws its only doubt."""
    light = lighting_file.validate(LIGHTING)
    kept_light.keep(scene, light, warnings=[sentence])
    answer.apply_light(scene, light)
    (doubt,) = kept_light.card(scene.btfsep.light)["warnings"]

    def draw():
        layout = Everything()
        doubts.draw(seen(260, scene=bpy.context.scene), layout, doubt)
        return layout

    return draw


def test_a_mend_that_was_pressed_shows_what_is_still_to_be_said_and_the_way_to_a_new_light(photographed):
    (entry,) = photographed.btfsep.objects
    draw = has_doubt(photographed, f"object '{entry.object.name}' looks like none of the library's materials")
    assert operators(draw()) == ["Give Its Colour"] and draw().place("prop") is None
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.btfsep.mend("EXEC_DEFAULT", True, how="COLOUR", object=entry.object.name) == {"FINISHED"}
    after = draw()
    assert operators(after) == ["Give Its Colour", "Estimate Again"]
    assert [words for kind, words in after.shown if kind == "prop"] == ["colour", "roughness", "metallic"]
    bpy.context.scene.btfsep.objects[0].source = "RECOGNISE"  # by hand: it is not mended any more
    assert operators(draw()) == ["Give Its Colour"]
    bpy.ops.ed.undo()
    assert operators(draw()) == ["Give Its Colour"]
    bpy.ops.ed.redo()
    assert operators(draw()) == ["Give Its Colour", "Estimate Again"]
    kept_light.keep(bpy.context.scene, lighting_file.validate(LIGHTING))
    assert not mending.done(bpy.context.scene.btfsep.light)


@pytest.mark.parametrize(("how", "takes_back"), [
    ("AGX", lambda scene: setattr(scene.btfsep, "curve", "auto")),
    ("KEEP", lambda scene: setattr(scene.btfsep, "delight", "auto")),
    ("GROUND", lambda scene: bpy.data.objects.remove(bpy.data.objects["Ground"])),
])  # fmt: skip
def test_what_was_mended_is_seen_until_it_is_taken_back(photographed, how, takes_back):
    kept_light.keep(photographed, lighting_file.validate(LIGHTING))
    light = photographed.btfsep.light
    assert not mending.is_done(photographed, light, how, "")
    assert bpy.ops.btfsep.mend(how=how) == {"FINISHED"}
    assert mending.is_done(photographed, light, how, "")
    takes_back(photographed)
    assert not mending.is_done(photographed, light, how, "")


@pytest.mark.parametrize(("source", "buttons"), [
    ("RECOGNISE", ["Choose Material"]),
    ("LIBRARY", ["Choose Material"]),
    ("COLOUR", ["Give Its Colour"]),
    ("BLENDER", ["Go to Its Material"]),
])  # fmt: skip
def test_what_is_given_is_looked_at_again_and_not_thrown_away(photographed, source, buttons):
    photographed.btfsep.objects[0].source = source
    draw = has_doubt(photographed, "the material (surface/given) does not go with the photo: its gloss may be wrong")
    assert operators(draw()) == buttons


def test_what_stands_before_an_object_is_painted_over_where_it_is_said(photographed):
    draw = has_doubt(photographed, "500 of 3000 pixels show something else than the light explains: things in front")
    assert operators(draw()) == ["Make a Mask"]
    photographed.btfsep.objects[0].mask = photographed.btfsep.image
    assert operators(draw()) == ["btfsep.paint_mask", "Estimate Again"]


def test_of_two_views_that_a_render_may_have_been_saved_with_either_can_be_said(photographed):
    draw = has_doubt(photographed, "the photo looks like a render that was saved with that view")
    assert operators(draw()) == ["Read as AgX", "Read as Standard"]
    bpy.ops.btfsep.mend(how="STANDARD")
    assert operators(draw()) == ["Read as AgX", "Read as Standard", "Estimate Again"]
    kept_light.keep(photographed, lighting_file.validate(LIGHTING))
    assert operators(draw()) == ["Read as AgX"]  # the photo is said to be read as Standard


def test_in_a_narrow_sidebar_nothing_stands_in_a_row_that_would_be_cut_off(photographed, sunny):
    answer.apply_light(photographed, lighting_file.read(sunny[0]))
    usual, narrow = drawn(photographed), drawn(photographed, 208)
    assert [kind for kind, _ in usual.shown].count("split") > [kind for kind, _ in narrow.shown].count("split") == 1
    assert narrow.place("label", "Key light") < narrow.place("label", "Fill") < narrow.place("operator", "Freeze")
    assert "Freeze Sun" in operators(usual) and "Freeze Sun" not in operators(narrow)
    blf.size(0, labels.FONT_SIZE)
    assert max(blf.dimensions(0, words)[0] for kind, words in narrow.shown if kind == "label") < 208


def test_suns_stand_once_below_the_card_or_where_one_is_asked_for(photographed, sunny):
    light = lighting_file.read(sunny[0])
    answer.apply_light(photographed, light)
    assert operators(drawn(photographed)).count("Freeze Sun") == 1
    kept_light.keep(photographed, light, warnings=["the photo determines 2 of 25, and not all of the first four"])
    shown = drawn(photographed)
    assert operators(shown).count("Freeze Sun") == 1
    assert shown.place("operator", "Freeze Sun") < shown.place("operator", "btfsep.apply")


def test_the_preferences_say_all_of_what_the_engine_lacks(addon, monkeypatch):
    message = "the engine; it was not found; " + "install the extension that contains it, or give the .venv " * 3
    monkeypatch.setattr(checkup, "_found", {"ok": False, "facts": {}, "message": message})
    layout, width = Everything(), 500
    checkup.draw(seen(width), layout)
    said = [words for kind, words in layout.shown if kind == "label"]
    assert " ".join(said[1:]).startswith("The engine It was not found Install the extension that contains it")
    assert " ".join(said).count("give the .venv") == 3
    blf.size(0, labels.FONT_SIZE)
    assert max(blf.dimensions(0, line)[0] for line in said) < width


def test_the_light_is_the_first_of_the_tab(addon):
    kinds = (light_panel.BTFSEP_PT_light, photo_panels.BTFSEP_PT_photo, photo_panels.BTFSEP_PT_objects)
    places = [getattr(kind, "bl_order", 0) for kind in (*kinds, light_panel.BTFSEP_PT_adjust)]
    assert places == sorted(set(places)) and places[0] >= 0  # below 0 Blender takes none for an order


def test_what_is_found_stands_below_the_buttons_and_trust_above_all_of_it(photographed, sunny):
    before = drawn(photographed)
    assert before.place("template_icon") is before.place("operator", "btfsep.apply") is None
    answer.apply_light(photographed, lighting_file.read(sunny[0]))
    after = drawn(photographed)
    button = before.place("operator", "btfsep.estimate")
    assert after.shown[: button + 1] == before.shown[: button + 1]  # it stays below the mouse
    trust, picture = after.place("label", "Its error is not stated"), after.place("template_icon")
    assert button < trust < picture < after.place("label", "Key light") < after.place("operator", "Freeze Sun")


def test_a_light_that_is_not_the_world_is_said_to_be_none(photographed, sunny):
    photographed.world = mine = bpy.data.worlds.new("Mine")
    answer.apply_light(photographed, lighting_file.read(sunny[0]))

    def said():
        return drawn(photographed, 400).place("label", "This light is not the World now") is not None

    assert not said()
    bpy.ops.btfsep.restore_world()
    assert photographed.world == mine and said()
    bpy.ops.btfsep.apply()
    assert not said()
