# SPDX-License-Identifier: GPL-3.0-or-later
"""A new mask: what of the photo the camera sees of an object, as Cycles renders it."""

import bpy
import numpy as np
import pytest

from blender_btfsep.photo import photo
from blender_btfsep.window import mask
from scripts.cycles import studio

SIZE = 600, 400  # more than the mask looks at in one go


@pytest.fixture
def hidden_in_part(photographed, tmp_path):
    """A cube, half of which another object hides that is not in the list; photo and render are larger."""
    photographed.render.resolution_x, photographed.render.resolution_y = SIZE
    image = bpy.data.images.new("large", *SIZE, float_buffer=True)
    image.generated_color = (0.2, 0.1, 0, 1)
    image.filepath_raw, image.file_format = str(tmp_path / "large.exr"), "OPEN_EXR"
    image.save()
    photographed.btfsep.image = bpy.data.images.load(str(tmp_path / "large.exr"))
    bpy.ops.mesh.primitive_uv_sphere_add(location=(1.2, -1.5, 0.7), radius=0.6)
    bpy.context.view_layer.update()
    return photographed


def rendered(scene, folder):
    """(h, w) how much of each pixel Cycles sees of the cube before all else: an emission, the rest a black one."""
    for thing in scene.objects:
        if thing.type == "MESH":
            shine = bpy.data.materials.new("shine")
            shine.use_nodes = True
            shine.node_tree.nodes.clear()
            node, out = (shine.node_tree.nodes.new(f"ShaderNode{n}") for n in ("Emission", "OutputMaterial"))
            node.inputs["Strength"].default_value = float(thing == scene.btfsep.objects[0].object)
            shine.node_tree.links.new(node.outputs[0], out.inputs["Surface"])
            thing.data.materials.append(shine)
    return studio.render_photo(scene, folder / "seen.exr", 16)[..., 0]


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_it_is_where_cycles_sees_the_object(hidden_in_part, tmp_path, kind):
    scene, cube = hidden_in_part, hidden_in_part.btfsep.objects[0].object
    data = scene.camera.data
    data.type, data.shift_x, data.ortho_scale = kind, 0.1, 6
    found = mask.part_seen(scene, bpy.context.view_layer, cube, SIZE)
    truth = rendered(scene, tmp_path)
    whole, none = truth > 0.99, truth < 0.01
    assert whole.sum() > 4000 and found[whole].mean() > 0.9999 and found[none].mean() < 1e-4
    scene.btfsep.occluders = "NONE"
    more = mask.part_seen(scene, bpy.context.view_layer, cube, SIZE)
    assert more.sum() > found.sum() + 1000 and (more | ~found).all()


def test_the_button_makes_a_mask_that_a_job_takes(hidden_in_part, tmp_path):
    entry = hidden_in_part.btfsep.objects[0]
    seen = mask.part_seen(hidden_in_part, bpy.context.view_layer, entry.object, SIZE)
    assert bpy.ops.btfsep.new_mask() == {"FINISHED"}
    assert (
        tuple(entry.mask.size) == SIZE and entry.mask.packed_file and entry.mask.name == f"Mask of {entry.object.name}"
    )
    photo.put_mask(entry.mask, tmp_path, "mask.png", SIZE)
    used = studio.read_image(tmp_path / "mask.png")[..., 0] > 0
    assert (used == seen & ~mask.spread(~seen, 2)).all() and 0.7 < used.sum() / seen.sum() < 1
    pixels = np.array(entry.mask.pixels[:]).reshape(*SIZE[::-1], 4)[::-1, :, :3]
    assert (pixels[used].min(0) > 0.1).all() and pixels[used][0, 0] > pixels[used][0, 2]  # the photo is to be seen
    hidden_in_part.btfsep.image = None
    with pytest.raises(RuntimeError, match="Choose the photo first"):
        bpy.ops.btfsep.new_mask()


def test_the_mask_is_opened_for_painting_without_the_objects_uv_map(hidden_in_part):
    area = bpy.context.window_manager.windows[0].screen.areas[0]
    before, area.type = area.type, "IMAGE_EDITOR"
    try:
        assert bpy.ops.btfsep.new_mask() == {"FINISHED"}
        space = area.spaces.active
        assert space.image == hidden_in_part.btfsep.objects[0].mask
        assert space.ui_mode == "PAINT" and not space.uv_editor.show_uv
    finally:
        area.type = before


def test_an_object_that_is_not_seen_has_no_mask(hidden_in_part):
    hidden_in_part.btfsep.objects[0].object.location.y = -20
    with pytest.raises(RuntimeError, match="does not see"):
        bpy.ops.btfsep.new_mask()
    assert hidden_in_part.btfsep.objects[0].mask is None


def test_cells_that_differ_are_looked_at_closely():
    rows, columns = np.mgrid[:700, :1000] + 0.5
    truth = (rows - 300) ** 2 + (columns - 600) ** 2 < 250**2
    looked = []

    def look(x, y):
        looked.append(len(x))
        return (np.asarray(y) - 300) ** 2 + (np.asarray(x) - 600) ** 2 < 250**2

    assert (mask.refined(look, 1000, 700) == truth).all() and sum(looked) < 0.15 * truth.size
    assert (mask.refined(lambda x, y: [True] * len(x), 5, 3) == np.ones((3, 5), bool)).all()


def test_spreading_is_a_square():
    flags = np.zeros((9, 12), bool)
    flags[4, 5] = flags[0, 11] = True
    expected = np.zeros_like(flags)
    expected[2:7, 3:8] = expected[:3, 9:] = True
    assert (mask.spread(flags, 2) == expected).all()


@pytest.mark.parametrize("assets", [True, False])
def test_there_is_a_brush_also_where_blender_came_without(photographed, tmp_path, monkeypatch, assets):
    """Some distributions leave the assets out, in which the brushes are since Blender 4.3."""
    (tmp_path / "assets" / "brushes").mkdir(parents=True) if assets else None
    monkeypatch.setattr(bpy.utils, "system_resource", lambda kind: str(tmp_path))
    for brush in list(bpy.data.brushes):
        bpy.data.brushes.remove(brush)
    for _ in range(2):
        mask._have_brush(photographed.session_uid)
    assert [brush.name for brush in bpy.data.brushes] == ([] if assets else [mask.BRUSH])
