# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that was found stays: with the file, through undo, with its World, and before the estimate is over."""

import json

import bpy
import numpy as np
import pytest

from blender_btfsep.basics import colour, pixels
from blender_btfsep.light import (
    kept_light,
    light_files,
    lighting_file,
    sh_nodes,
    sun_lamp,
    world,
)
from blender_btfsep.run import answer
from btfsep_engine.imaging.images import write_exr
from tests.blender.found import SAID, coefficients, sunny
from tests.blender.lit import LIGHTING


@pytest.fixture
def estimated(photographed, fake_engine):
    fake_engine(lighting=LIGHTING, result=SAID | {"warnings": ["half of it is saturated"]})
    photographed.world = bpy.data.worlds.new("Mine")
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.btfsep.estimate() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="estimated")
    return photographed


def test_the_card_stays_with_the_file_and_its_light_can_be_applied_again(estimated, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    scene = bpy.context.scene
    light = kept_light.kept(scene)
    assert ["Trust", "Good: about 12% off (8–20%)"] in kept_light.card(light)["lines"]
    assert light.picture.packed_file and tuple(light.picture.size) == (256, 256)
    assert bpy.ops.btfsep.restore_world() == {"FINISHED"} and scene.world.name == "Mine"
    assert bpy.ops.btfsep.apply() == {"FINISHED"}
    assert coefficients(scene.world) == [tuple(row) for row in LIGHTING["coefficients"]]


def test_the_card_follows_undo(estimated):
    assert kept_light.kept(estimated)
    bpy.ops.ed.undo()
    assert kept_light.kept(bpy.context.scene) is None and bpy.context.scene.world.name == "Mine"
    assert not [image for image in bpy.data.images if image.name.startswith(kept_light.PICTURE)]
    bpy.ops.ed.redo()
    assert kept_light.card(kept_light.kept(bpy.context.scene))["trust"] == "GREEN"


def test_the_card_goes_where_the_world_goes(estimated):
    other = bpy.data.scenes.new("Other")
    assert kept_light.kept(other) is None
    other.world = estimated.world
    assert kept_light.kept(other).text == estimated.btfsep.light.text


def test_an_imported_lighting_has_a_card_and_can_be_applied_again(addon, scene, tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(LIGHTING))
    bpy.ops.btfsep.import_lighting(filepath=str(tmp_path / "a.json"))
    assert kept_light.card(kept_light.kept(scene))["trust"] == "NONE"
    assert bpy.ops.btfsep.apply(mode="TEXTURE") == {"FINISHED"}


def test_a_second_estimate_leaves_one_picture(estimated, fake_engine):
    fake_engine(lighting=LIGHTING | {"coefficients": [[2, 2, 2]] * 4}, result=SAID)
    bpy.ops.btfsep.estimate()
    assert len([image for image in bpy.data.images if image.name.startswith(kept_light.PICTURE)]) == 1
    assert kept_light.lighting_of(kept_light.kept(estimated))["coefficients"][0] == [2, 2, 2]


def test_a_light_that_was_tampered_with_is_refused_in_words(estimated):
    for text in ("[1]", "{", '{"lighting": {"format": "other"}}'):
        estimated.btfsep.light.text = text
        with pytest.raises(RuntimeError, match="not a BTFsep lighting"):
            bpy.ops.btfsep.apply()


@pytest.mark.parametrize("mode", ["NODES", "NONE"])
def test_the_light_is_the_world_as_soon_as_the_engine_has_it(photographed, fake_engine, tmp_path, mode):
    (tmp_path / "a.json").write_text(json.dumps(LIGHTING))
    sentence = "the report; the disk is full; make room"
    last = {"type": "failed", "message": sentence, "exit_code": 2}
    fake_engine(lines=[{"type": "light", "lighting": str(tmp_path / "a.json")}, last], exit=2)
    photographed.world = bpy.data.worlds.new("Mine")
    photographed.btfsep.world_mode = mode
    bpy.ops.ed.undo_push(message="before")
    with pytest.raises(RuntimeError, match="the disk is full"):
        bpy.ops.btfsep.estimate()
    scene = bpy.context.scene
    assert (scene.world.name == "Mine") == (mode == "NONE")
    if mode == "NODES":  # it stays, and is a step of its own
        assert coefficients(scene.world)[0] == tuple(LIGHTING["coefficients"][0])
        bpy.ops.ed.undo()
        assert bpy.context.scene.world.name == "Mine"


def test_a_light_that_cannot_be_read_is_said_at_the_end_alone(photographed, fake_engine, tmp_path):
    early = {"type": "light", "lighting": str(tmp_path / "absent.json")}
    fake_engine(lighting=LIGHTING, result=SAID, lines=[early])
    assert bpy.ops.btfsep.estimate() == {"FINISHED"}


def test_a_first_light_is_the_world_before_the_estimate_is_over(photographed, tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(LIGHTING))
    answer.take_light(photographed, tmp_path / "a.json")
    assert coefficients(photographed.world) == [tuple(row) for row in LIGHTING["coefficients"]]
    photographed.btfsep.world_mode = "NONE"
    answer.take_light(photographed, tmp_path / "absent.json")  # not even read


def test_what_a_mirror_shows_is_the_worlds_map_and_stays(photographed, tmp_path):
    """As sharp as `lighting.exr`, without the discs of lamps, which stand beside it; and again after reopening."""
    found = sunny()
    sky = np.random.default_rng(1).uniform(0.1, 2, (256, 512, 3)).astype(np.float32)
    write_exr(tmp_path / "lighting.exr", light_files.with_lamps(sky, found["suns"]["lamps"]))
    (tmp_path / "lighting.json").write_text(json.dumps(lighting_file.as_data(found)))
    told = {"out": str(tmp_path), "lighting": str(tmp_path / "lighting.json"), "choice": {"mirrors": "put together"}}
    answer.take_estimate(photographed, SAID | told)

    def shown():
        return colour.to_rec709(pixels.colours(sh_nodes.map_of(bpy.context.scene.world.node_tree.nodes[0].node_tree)))

    assert bpy.context.scene.world[world.WORLD_TAG]["mode"] == "TEXTURE" and sun_lamp.lamps(photographed)
    np.testing.assert_allclose(shown()[::-1], sky, rtol=1e-3, atol=1e-2)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.btfsep.restore_world()
    assert bpy.ops.btfsep.apply() == {"FINISHED"}
    np.testing.assert_allclose(shown()[::-1], sky, rtol=1e-3, atol=1e-2)
    answer.take_estimate(bpy.context.scene, SAID | told | {"choice": {}})  # without a mirror it is nodes
    assert bpy.context.scene.world[world.WORLD_TAG]["mode"] == "NODES" and bpy.context.scene.btfsep.light.sky is None


def test_a_second_report_comes_in_the_image_of_the_first(photographed, tmp_path):
    light, reports = photographed.btfsep.light, []
    for side in (8, 16):  # it may be of another size
        made = bpy.data.images.new("made", 2 * side, side)
        made.generated_color = (side / 16, 0, 0, 1)
        made.filepath_raw, made.file_format = str(tmp_path / "report.png"), "PNG"
        made.save()
        bpy.data.images.remove(made)
        kept_light.keep(photographed, LIGHTING | {"suns": None, "determined": None}, {"out": tmp_path})
        data = (tmp_path / "report.png").read_bytes()
        assert tuple(light.report.size) == (2 * side, side) and light.report.packed_file.data == data
        assert np.allclose(pixels.colours(light.report)[..., 0], side / 16, atol=1 / 255)
        reports.append(light.report)
    assert reports[0] == reports[1] and light.report.users == 1
    (tmp_path / "report.png").unlink()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert tuple(bpy.context.scene.btfsep.light.report.size) == (32, 16)
