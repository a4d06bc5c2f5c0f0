# SPDX-License-Identifier: GPL-3.0-or-later
"""The lamps of a light have a collection of their own, and stay where the user puts them."""

import bpy

from blender_btfsep.light import lamp_collection, lighting_file, sun_lamp, world


def places(scene):
    """{lamp: the collections that it is in} of those of ours, by name."""
    return {lamp.name: [each.name for each in lamp.users_collection] for lamp in sun_lamp.lamps(scene)}


def test_the_lamps_of_a_light_are_together_and_a_further_light_keeps_them_so(scene, lamplit):
    light = lighting_file.read(lamplit[0])
    for _ in range(2):
        world.apply_lighting(scene, light)
        assert len(places(scene)) > 1 and all(each == ["BTFsep Light"] for each in places(scene).values())
    assert [each.name for each in scene.collection.children] == ["BTFsep Light"] and len(bpy.data.collections) == 1
    bpy.context.view_layer.update()
    assert sun_lamp.lamps(scene)[0].name in bpy.context.view_layer.objects
    world.restore_previous(scene)
    assert not bpy.data.collections and not sun_lamp.lamps(scene)


def test_what_the_user_moves_stays_there(scene, lamplit):
    light = lighting_file.read(lamplit[0])
    world.apply_lighting(scene, light)
    own = bpy.data.collections["BTFsep Light"]
    lamp, *others = sun_lamp.lamps(scene)
    mine, group = bpy.data.collections.new("Mine"), bpy.data.collections.new("Lights")
    for each in (mine, group):
        scene.collection.children.link(each)
    mine.objects.link(lamp)
    own.objects.unlink(lamp)
    scene.collection.children.unlink(own)
    group.children.link(own)
    own.name = "Sunshine"
    for lighting in (light, {**light, "suns": None}, light):
        world.apply_lighting(scene, lighting)
        if lighting["suns"] and lamp in sun_lamp.lamps(scene):
            assert places(scene)[lamp.name] == ["Mine"]
            assert all(places(scene)[other.name] == ["Sunshine"] for other in others)
            continue
        lamp = None  # it went with the light that has none; the collection is the user's, and stays for the next
        assert own in scene.collection.children_recursive
    assert {name for each in places(scene).values() for name in each} == {"Sunshine"}


def test_it_follows_undo(addon, scene, sunny):
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.btfsep.import_lighting(filepath=str(sunny[0]))
    bpy.ops.ed.undo_push(message="imported")
    bpy.ops.ed.undo()
    assert not bpy.data.collections
    bpy.ops.ed.redo()
    assert list(places(bpy.context.scene).values()) == [["BTFsep Light"]]


def test_of_a_linked_copy_of_the_scene_each_has_its_own_lamps(scene, sunny):
    light = lighting_file.read(sunny[0])
    world.apply_lighting(scene, light)
    (first,) = sun_lamp.lamps(scene)
    bpy.ops.scene.new(type="LINK_COPY")
    other = bpy.context.scene
    assert other != scene and sun_lamp.lamps(other) == [first]
    world.apply_lighting(other, light)
    (second,) = sun_lamp.lamps(other)
    assert second != first and sun_lamp.lamps(scene) == [first]
    assert not lamp_collection._tagged(other)[0].objects.get(first.name)
