# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a scene the job has as occluders, against Blender's own render."""

import json

import bpy
import numpy as np
import pytest
import trimesh
from bpy_extras.object_utils import world_to_camera_view

from blender_btfsep.basics.errors import InputError
from blender_btfsep.scene import export
from scripts.cycles import materials
from tests.blender.test_export import add_cube, make_photo


def test_occluders_are_what_the_render_shows(scene, tmp_path, add_camera):
    camera = add_camera(scene, (0, -9, 0))
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    thing, floor = add_cube("Thing"), add_cube("Floor", location=(0, 0, -3))
    hidden, ghost = add_cube("Hidden"), add_cube("Ghost")
    hidden.hide_render = True
    ghost.visible_shadow = False
    array = floor.modifiers.new("Array", "ARRAY")
    array.count = 3
    parent = bpy.data.objects.new("Instancer", None)
    scene.collection.objects.link(parent)
    parent.instance_type = "COLLECTION"
    parent.instance_collection = bpy.data.collections.new("Pieces")
    piece = add_cube("Piece", location=(5, 0, 0))
    parent.instance_collection.objects.link(piece)
    scene.collection.objects.unlink(piece)
    parent.location = (0, 0, 7)
    bpy.context.view_layer.update()
    path = export.export_job(scene, tmp_path / "job", image_path=make_photo(tmp_path), camera=camera, objects=[thing])
    job = json.loads(path.read_text())
    assert [o["mesh"] for o in job["occluders"]] == ["Floor.ply", "Instancer.ply"]
    assert [o["name"] for o in job["occluders"]] == ["Floor", "Instancer"]
    assert len(trimesh.load(path.parent / "Floor.ply").faces) == 36
    assert np.allclose(trimesh.load(path.parent / "Instancer.ply").centroid, (5, 0, 7))


def test_what_animation_and_drivers_hide_in_the_viewport_only_is_there(scene, tmp_path, add_camera):
    """And what they hide in the render is not; all of it stands as before afterwards."""
    camera, fitted = add_camera(scene, (0, -9, 0)), add_cube("Fitted")
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    for number, name in enumerate(("hide_viewport", "hide_render", "hide_viewport driven", "hide_render driven")):
        thing, path = add_cube(name, location=(3 * number + 3, 0, 0)), name.split()[0]
        if name.endswith("driven"):
            thing.driver_add(path).driver.expression = "frame < 5"
        else:
            for frame in (1, 10):
                setattr(thing, path, frame < 5)
                thing.keyframe_insert(path, frame=frame)
    array = add_cube("array", location=(0, 0, 9)).modifiers.new("Array", "ARRAY")
    array.count = 3
    array.driver_add("show_viewport").driver.expression = "0"
    for frame in (1, 10, 1):
        scene.frame_set(frame)
        before = visibility(bpy.context.view_layer)
        job = export.export_job(
            scene, tmp_path / "job", image_path=make_photo(tmp_path), camera=camera, objects=[fitted]
        )
        found = {o["mesh"].removesuffix(".ply") for o in json.loads(job.read_text())["occluders"]}
        rendered = {"hide_viewport", "hide_viewport_driven", "array"}
        assert found == (rendered if frame < 5 else rendered | {"hide_render", "hide_render_driven"})
        assert len(trimesh.load(job.parent / "array.ply").faces) == 36
        bpy.context.view_layer.update()
        assert visibility(bpy.context.view_layer) == before
        assert not any(d.mute for o in bpy.data.objects if o.animation_data for d in o.animation_data.drivers)


def visibility(view_layer):
    """All that hides something, as it stands."""
    layers = [view_layer.layer_collection, *view_layer.layer_collection.children]
    return (
        {o.name: (o.hide_viewport, o.hide_render, o.show_instancer_for_viewport) for o in bpy.data.objects},
        {o.name: o.hide_get() for o in view_layer.objects},
        {c.name: (c.hide_viewport, c.hide_render) for c in bpy.data.collections},
        {layer.name: (layer.exclude, layer.hide_viewport, layer.holdout, layer.indirect_only) for layer in layers},
    )


def test_the_render_decides_what_casts_shadows_not_the_viewport(scene, tmp_path, add_camera, render):
    """Each way of hiding, by the object and by its collection; Blender's own render is asked what it shows."""
    camera = add_camera(scene, (0, -20, 0))
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    ways = ["plain", "H", "monitor", "camera", "both", "eye", "collection monitor", "collection camera", "excluded"]
    ways += ["holdout", "indirect", "instance H", "instance camera"]
    view_layer, things = bpy.context.view_layer, {}
    for number, way in enumerate(ways):
        thing = things[way] = add_cube(way, location=(2.5 * (number % 5) - 5, 0, 2.5 * (number // 5) - 2.5))
        collection = bpy.data.collections.new(way)
        collection.objects.link(thing)
        scene.collection.objects.unlink(thing)
        if way.startswith("instance"):
            thing = things[way] = bpy.data.objects.new(f"{way} owner", None)
            thing.instance_type, thing.instance_collection = "COLLECTION", collection
            scene.collection.objects.link(thing)
        else:
            scene.collection.children.link(collection)
    layer_of = view_layer.layer_collection.children
    view_layer.update()
    things["H"].hide_set(True)
    things["instance H"].hide_set(True)
    things["monitor"].hide_viewport = things["both"].hide_viewport = True
    things["camera"].hide_render = things["both"].hide_render = True
    bpy.data.objects["instance camera"].hide_render = True
    layer_of["eye"].hide_viewport = layer_of["excluded"].exclude = True
    layer_of["holdout"].holdout = layer_of["indirect"].indirect_only = True
    bpy.data.collections["collection monitor"].hide_viewport = True
    bpy.data.collections["collection camera"].hide_render = True

    shown = ["H", "collection_monitor", "eye", "holdout", "indirect", "instance_H_owner", "monitor", "plain"]
    world = bpy.data.worlds.new("Black")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0, 0, 0, 1)
    scene.world = world
    material, _ = materials.shaded("Emits", "ShaderNodeEmission", Strength=0.9)  # less than a lamp
    for way in ways:
        bpy.data.objects[way].data.materials.append(material)
    before = visibility(view_layer)
    picture = render(scene)
    seen = []
    for way in ways:
        spot = world_to_camera_view(scene, camera, bpy.data.objects[way].location)
        if picture[int((1 - spot.y) * 64), int(spot.x * 96)].max() > 0.5:
            seen.append(things[way].name.replace(" ", "_"))
    # a holdout and what shows indirectly only are not in the picture, but their shadows are
    assert sorted([*seen, "holdout", "indirect"]) == shown

    photo, floor = make_photo(tmp_path), add_cube("Fitted", location=(0, 0, -9))
    path = export.export_job(scene, tmp_path / "job", image_path=photo, camera=camera, objects=[floor])
    assert sorted(o["mesh"] for o in json.loads(path.read_text())["occluders"]) == [f"{name}.ply" for name in shown]
    bpy.data.objects.remove(floor)
    assert visibility(view_layer) == before

    chosen = [things[way] for way in ways if way != "excluded" and things[way].type == "MESH"]
    path = export.export_job(scene, tmp_path / "fit", image_path=photo, camera=camera, objects=chosen)
    job = json.loads(path.read_text())
    assert [o["name"] for o in job["objects"]] == [o.name for o in chosen]
    assert [o["mesh"] for o in job["occluders"]] == ["instance_H_owner.ply"] and visibility(view_layer) == before
    with pytest.raises(InputError, match="'excluded'; it has no faces, or the view layer excludes it"):
        export.export_job(scene, tmp_path / "no", image_path=photo, camera=camera, objects=[things["excluded"]])
    assert visibility(view_layer) == before


def test_of_a_shadow_catcher_without_a_material_the_photo_says_what_it_is(scene, tmp_path, add_camera):
    camera = add_camera(scene, (0, -9, 0))
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    thing = add_cube("Thing")
    for name, x, catches, material in (("Bare", -8, True, None), ("Own", 0, True, "white"), ("Plain", 8, False, None)):
        floor = add_cube(name, location=(x, 0, -3))
        floor.is_shadow_catcher = catches
        if material:
            floor.data.materials.append(materials.white((0.2, 0.3, 0.4)))
    given = {"image_path": make_photo(tmp_path), "camera": camera, "objects": [thing]}
    job = json.loads(export.export_job(scene, tmp_path / "job", **given).read_text())
    surfaces = {o["name"]: o.get("surface") for o in job["occluders"]}
    assert surfaces["Bare"] is None and surfaces["Plain"] is not None
    np.testing.assert_allclose(surfaces["Own"]["base_color"], (0.2, 0.3, 0.4), atol=1e-6)


def test_a_table_is_evidence_where_its_object_says_so(addon, scene, tmp_path, add_camera):
    from blender_btfsep.run import request
    from btfsep_engine.job.load import load_job

    camera, thing = add_camera(scene, (0, -9, 0)), add_cube("Thing")
    tables = [add_cube(f"Table {i}", location=(0, 0, -3 - 3 * i)) for i in range(2)]
    tables[1].btfsep_evidence = thing.btfsep_evidence = True
    photo = make_photo(tmp_path)
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    path = export.export_job(scene, tmp_path / "job", image_path=photo, camera=camera, objects=[thing])
    job = json.loads(path.read_text())
    assert [o.get("evidence") for o in job["occluders"]] == [None, True] and "evidence" not in job["objects"][0]
    assert [o.evidence for o in load_job(path.parent).occluders] == [False, True]
    assert not any(request.may_be_evidence(scene.btfsep, o) for o in (thing, *tables))  # beside nothing
    scene.btfsep.objects.add().object = thing
    assert [request.may_be_evidence(scene.btfsep, o) for o in (None, thing, camera, *tables)] == [False] * 3 + [
        True
    ] * 2
