# SPDX-License-Identifier: GPL-3.0-or-later
"""What is said before a click: each thing that a scene may lack, and nothing of a scene that lacks nothing."""

import bpy
import pytest


def panoramic(scene, tmp_path):
    scene.camera.data.type = "PANO"


def mirrored(scene, tmp_path):
    scene.camera.scale.x = -1
    bpy.context.view_layer.update()


def without_camera(scene, tmp_path):
    scene.camera = None


def without_photo(scene, tmp_path):
    scene.btfsep.image = None


def lost_photo(scene, tmp_path):
    (tmp_path / "photo.png").unlink()


def many_layers(scene, tmp_path):
    picture = scene.render.image_settings
    if hasattr(picture, "media_type"):  # Blender 5
        picture.media_type = "MULTI_LAYER_IMAGE"
    picture.file_format, scene.render.filepath = "OPEN_EXR_MULTILAYER", str(tmp_path / "layers.exr")
    scene.cycles.samples = 1
    bpy.ops.render.render(write_still=True)
    scene.btfsep.image = bpy.data.images.load(str(tmp_path / "layers.exr"))


def of_no_file(scene, tmp_path):
    scene.cycles.samples = 1
    bpy.ops.render.render()
    scene.btfsep.image = bpy.data.images["Render Result"]


def another_shape(scene, tmp_path):
    scene.render.resolution_x = 90


def excluded(scene, tmp_path):
    thing = scene.btfsep.objects[0].object
    collection = bpy.data.collections.new("Away")
    scene.collection.children.link(collection)
    scene.collection.objects.unlink(thing)
    collection.objects.link(thing)
    bpy.context.view_layer.layer_collection.children["Away"].exclude = True
    bpy.context.view_layer.update()


def deleted(scene, tmp_path):
    bpy.ops.object.select_all(action="DESELECT")
    scene.btfsep.objects[0].object.select_set(True)
    bpy.ops.object.delete()


def unknown_material(scene, tmp_path):
    bpy.context.window_manager.btfsep.library.add().name = "wood/oak"
    scene.btfsep.objects[0].source, scene.btfsep.objects[0].material = "LIBRARY", "wood/oke"


def no_material(scene, tmp_path):
    scene.btfsep.objects[0].source = "LIBRARY"


def no_uv(scene, tmp_path):
    layers = scene.btfsep.objects[0].object.data.uv_layers
    layers.remove(layers[0])
    scene.btfsep.mapping = "OWN"


def small_mask(scene, tmp_path):
    scene.btfsep.objects[0].mask = bpy.data.images.new("mask", 24, 16)


def of_a_file_that_is_gone(scene, tmp_path):
    file = tmp_path / "set.blend"
    bpy.data.libraries.write(str(file), {scene.btfsep.objects[0].object})
    with bpy.data.libraries.load(str(file), link=True) as (_, wanted):
        wanted.objects = ["Cube"]
    (linked,) = wanted.objects
    scene.collection.objects.link(linked)
    scene.btfsep.objects[0].object = linked
    bpy.data.libraries.write(str(file), {scene.camera.data})  # it has no cube any more
    linked.library.reload()


def empty_list(scene, tmp_path):
    scene.btfsep.objects.clear()


@pytest.mark.parametrize(
    ("lacks", "words"),
    [
        (panoramic, "Camera 'Camera' is panoramic"),
        (mirrored, "The scale of camera 'Camera' is negative"),
        (without_camera, "The scene has no camera"),
        (without_photo, "Choose the photo first"),
        (lost_photo, "The photo's file photo.png is not there"),
        (many_layers, "The photo 'layers.exr' is an EXR of many layers: save the one"),
        (of_no_file, "The photo 'Render Result' is a render that is in no file: save it"),
        (another_shape, "The photo is 48 x 32, the scene renders 90 x 32"),
        (excluded, "'Cube' is in no collection of this view layer"),
        (deleted, "'Cube' was deleted: take it off the list"),
        (unknown_material, "The library has no material 'wood/oke'"),
        (no_material, "Choose the material of 'Cube'"),
        (no_uv, "'Cube' has no UV map"),
        (small_mask, "The mask of 'Cube' has another size"),
        (of_a_file_that_is_gone, "'Cube' is linked from set.blend, which is not there"),
        (empty_list, "Add the objects"),
    ],
)
def test_it_is_said_before_the_click(photographed, tmp_path, lacks, words):
    from blender_btfsep.run import request

    bpy.context.window_manager.btfsep.library.clear()
    assert request.missing(bpy.context) == "" and bpy.ops.btfsep.estimate.poll()
    lacks(photographed, tmp_path)
    assert request.missing(bpy.context).startswith(words) and not bpy.ops.btfsep.estimate.poll()
    bpy.context.window_manager.btfsep.library.clear()


def test_where_all_materials_are_said_there_is_nothing_to_recognise(photographed):
    from blender_btfsep.run import request

    entry = photographed.btfsep.objects[0]
    assert bpy.ops.btfsep.recognise.poll() and request.nothing_to_recognise(photographed.btfsep) == ""
    for source in ("COLOUR", "BLENDER"):
        entry.source = source
        assert bpy.ops.btfsep.estimate.poll() and not bpy.ops.btfsep.recognise.poll()
        assert "set Made Of to Recognise" in request.nothing_to_recognise(photographed.btfsep)
    photographed.btfsep.objects.add().object = entry.object
    assert request.nothing_to_recognise(photographed.btfsep) == ""  # the second is to be


def test_a_packed_photo_needs_no_file(photographed, tmp_path):
    from blender_btfsep.run import request

    photographed.btfsep.image.pack()
    (tmp_path / "photo.png").unlink()
    assert request.missing(bpy.context) == ""


def test_a_collection_instance_is_an_object_like_any_other(photographed):
    from blender_btfsep.run import request
    from blender_btfsep.scene import meshes

    cube = photographed.btfsep.objects[0].object
    photographed.btfsep.objects.clear()
    inner, outer = (bpy.data.collections.new(name) for name in ("Inner", "Outer"))
    photographed.collection.objects.unlink(cube)
    inner.objects.link(cube)
    holder = bpy.data.objects.new("Holder", None)
    holder.instance_type, holder.instance_collection, holder.location = "COLLECTION", inner, (0, 0, 1)
    outer.objects.link(holder)
    placed = bpy.data.objects.new("Placed", None)
    placed.instance_type, placed.instance_collection, placed.location = "COLLECTION", outer, (0.5, 0, 0)
    bare = bpy.data.objects.new("Bare", None)
    for thing in (placed, bare):
        photographed.collection.objects.link(thing)
        thing.select_set(True)
    assert meshes.has_surface(placed) and not meshes.has_surface(bare)
    assert bpy.ops.btfsep.add_objects() == {"FINISHED"}
    assert [e.object for e in photographed.btfsep.objects] == [placed] and request.missing(bpy.context) == ""
    folder = request.write_job(bpy.context)
    assert (folder / "Placed.ply").is_file()
    placed.hide_set(True)  # with H: the photo shows it all the same
    (folder / "Placed.ply").unlink()
    assert request.missing(bpy.context) == "" and (request.write_job(bpy.context) / "Placed.ply").is_file()
    photographed.btfsep.objects[0].object = bare
    assert request.missing(bpy.context).startswith("'Bare' has no surface")


def test_what_a_render_has_finer_than_the_viewport_is_exported_so(photographed):
    """Simplify, the resolution of curves and metaballs: as if the viewport were as fine."""
    from blender_btfsep.run import request

    cube = photographed.btfsep.objects[0].object
    cube.modifiers.new("Smooth", "SUBSURF").render_levels = 3
    bpy.ops.curve.primitive_bezier_circle_add(location=(3, 0, 0))
    ring = bpy.context.object
    ring.data.bevel_depth, ring.data.resolution_u, ring.data.render_resolution_u = 0.1, 2, 20
    bpy.ops.object.metaball_add(location=(-4, 0, 0))
    drop = bpy.context.object
    drop.data.resolution, drop.data.render_resolution = 0.4, 0.1
    render = photographed.render
    render.use_simplify, render.simplify_subdivision, render.simplify_subdivision_render = True, 0, 6

    def sizes():
        folder = request.write_job(bpy.context)
        return {path.stem: path.stat().st_size for path in folder.glob("*.ply")}

    coarse = sizes()
    assert (render.simplify_subdivision, ring.data.resolution_u) == (0, 2) and drop.data.resolution == pytest.approx(
        0.4
    )
    render.simplify_subdivision, ring.data.resolution_u, drop.data.resolution = 6, 20, 0.1
    cube.modifiers[0].levels = 3
    assert coarse == sizes() and len(coarse) == 3
    render.use_simplify, cube.modifiers[0].render_levels = False, 1
    ring.data.render_resolution_u, drop.data.render_resolution = 2, 0.4
    assert all(size < coarse[name] for name, size in sizes().items())


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_what_stands_outside_of_the_picture_is_said(photographed, kind):
    from blender_btfsep.run import reasons, request

    camera, settings = photographed.camera, photographed.btfsep
    camera.data.type, camera.data.ortho_scale = kind, 4

    def said():
        bpy.context.view_layer.update()
        return reasons.unseen(photographed, settings, request.fitted(settings))

    thing, place = settings.objects[0].object, settings.objects[0].object.location.copy()
    right, ahead = camera.matrix_world.to_3x3().col[0], -camera.matrix_world.to_3x3().col[2]
    assert said() == ""
    for far in (20, -20):
        thing.location = place + far * right
        assert said() == "'Cube' stands outside of the camera's picture"
    thing.location = place - 50 * ahead
    assert said()
    camera.data.shift_x, thing.location = 3.0, place
    assert said()
    thing.scale = (100, 100, 100)  # around the camera: it may be seen
    assert said() == ""
