# SPDX-License-Identifier: GPL-3.0-or-later
"""What the sidebar shows: sentences over as many lines as they need, and buttons."""

import json

import bpy
import pytest

from blender_btfsep.light import lighting_file
from blender_btfsep.panels import light_panel, sidebar
from blender_btfsep.run import answer, runs
from tests.blender.lit import LIGHTING

PATH = "/tmp/blender_VC1elB/btfsep/sun-8bcbcf0a/Renamed/result/lighting.json"


@pytest.mark.parametrize("width", [3, 12, 30, 200])
def test_nothing_of_a_long_path_is_left_out(width):
    text = f"The light of a file that was left is in {PATH}"
    made = sidebar.lines(text, lambda line: len(line) <= width)
    assert all(len(line) <= width for line in made)
    assert "".join(made).replace(" ", "") == text.replace(" ", "")


def test_lines_break_between_words_and_names_of_folders():
    assert sidebar.lines("a light is in /one/two/three", lambda line: len(line) <= 10) == [
        "a light is",
        "in",
        "/one/two/",
        "three",
    ]
    assert sidebar.lines("", lambda line: True) == [""]


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
