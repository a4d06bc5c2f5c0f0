# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render shows of a scene, and the triangles of its objects do not: said, or made up for."""

import json

import bpy
import pytest
import trimesh

from blender_btfsep.basics.errors import InputError
from blender_btfsep.scene import export, meshes, own_surface
from btfsep_engine.job.load import load_job
from btfsep_engine.pipeline.refine.seen_colour import _is_asked
from scripts.cycles import materials
from tests.blender.test_export import add_cube, make_photo

GREY = {"base_color": [0.5, 0.5, 0.5], "roughness": 0.5, "metallic": 0}


@pytest.fixture
def exported(scene, tmp_path, add_camera):
    """exported(thing, **more) -> (the job's first object, warnings)."""
    camera, photo = add_camera(scene, (0, -6, 2)), make_photo(tmp_path)
    scene.render.resolution_x, scene.render.resolution_y = 96, 64

    def run(thing, **more):
        warnings = []
        bpy.context.view_layer.update()
        given = {"image_path": photo, "camera": camera, "objects": [thing], "warn": warnings.append, **more}
        job = json.loads(export.export_job(scene, tmp_path / "job", **given).read_text())
        return job["objects"][0], warnings

    return run


def grow(thing, render_type="PATH"):
    system = thing.modifiers.new("Fur", "PARTICLE_SYSTEM")
    system.particle_system.settings.type = "HAIR"
    system.particle_system.settings.render_type = render_type
    return system


def curves(scene, surface=None):
    data = bpy.data.hair_curves.new("Strands")
    data.add_curves([2] * 3)
    data.surface = surface
    thing = bpy.data.objects.new("Strands", data)
    scene.collection.objects.link(thing)
    return thing


@pytest.mark.parametrize("kind", ["particles", "curves"])
def test_hair_of_an_object_is_left_out_in_words(scene, exported, kind):
    thing = add_cube()
    hair = grow(thing) if kind == "particles" else curves(scene, thing)
    fitted, warnings = exported(thing)
    assert fitted["surface"] is None and warnings == ["object 'Thing': its hair is left out"]
    fitted, warnings = exported(thing, surfaces={"Thing": GREY})
    assert fitted["surface"] == GREY | {"left_out": ["its hair"]} and not warnings  # the engine says it
    if kind == "particles":
        hair.show_render = False
    else:
        hair.hide_render = True
    fitted, warnings = exported(thing, surfaces={"Thing": GREY})
    assert fitted["surface"] == GREY and not warnings


def test_what_stands_around_and_has_no_faces_is_named(scene, exported):
    thing = add_cube()
    curves(scene)
    scene.collection.objects.link(bpy.data.objects.new("Smoke", bpy.data.volumes.new("Smoke")))
    assert sorted(exported(thing)[1]) == [
        "left out, as it has no faces: the hair of 'Strands'",
        "left out, as it has no faces: the volume of 'Smoke'",
    ]
    assert not exported(thing, occluders=[])[1]
    grow(thing, "OBJECT")  # what is instanced is triangles
    assert len(exported(thing)[1]) == 2


def test_a_material_that_moves_the_surface_is_said(exported):
    thing = add_cube()
    material, _ = materials.shaded("Rock", "ShaderNodeBsdfDiffuse")
    thing.data.materials.append(material)
    tree = material.node_tree
    node = tree.nodes.new("ShaderNodeDisplacement")
    tree.links.new(node.outputs[0], tree.get_output_node("CYCLES").inputs["Displacement"])
    surface = {"Thing": export.own_surface.BLENDER}
    for method, left in (("DISPLACEMENT", ["its displacement"]), ("BOTH", ["its displacement"]), ("BUMP", None)):
        material.displacement_method = method
        fitted, warnings = exported(thing, surfaces=surface)
        assert fitted["surface"].get("left_out") == left and len(warnings) == (method == "BUMP")
    material.displacement_method = "BOTH"
    assert exported(thing)[1] == ["object 'Thing': its displacement is left out"]


def test_panes_and_lights_of_an_object_hide_what_is_behind_them_and_are_not_fitted(exported, tmp_path):
    """Whatever the rest of it is made of, by numbers or by images."""
    thing = add_cube()
    colours = [materials.shaded(name, "ShaderNodeBsdfDiffuse")[0] for name in ("Paint", "Rust")]
    colours[1].node_tree.nodes["Diffuse BSDF"].inputs["Color"].default_value = (0.3, 0.1, 0.05, 1)
    pane, lamp = (
        materials.shaded(name, f"ShaderNode{kind}")[0] for name, kind in (("Pane", "BsdfGlass"), ("Lamp", "Emission"))
    )
    for each in (*colours, pane, lamp):
        thing.data.materials.append(each)
    for face, number in zip(thing.data.polygons, (0, 0, 1, 1, 2, 3), strict=True):
        face.material_index = number
    fitted, warnings = exported(thing, surfaces={"Thing": export.own_surface.BLENDER})
    job = json.loads((tmp_path / "job" / "job.json").read_text())
    assert isinstance(fitted["surface"]["base_color"], str) and len(warnings) == 2
    assert [o["surface"]["base_color"] for o in job["occluders"]] == [[0, 0, 0]]
    assert not _is_asked(load_job(tmp_path / "job").occluders[0].surface, said=True)  # its pixels have another colour
    load_job(tmp_path / "job")
    faces = [len(trimesh.load(tmp_path / "job" / each["mesh"]).faces) for each in (fitted, job["occluders"][0])]
    assert faces == [8, 4]
    thing.data.materials.clear()
    thing.data.materials.append(lamp)
    with pytest.raises(InputError, match="all of it shines"):
        exported(thing, surfaces={"Thing": export.own_surface.BLENDER})
    exported(thing, surfaces={"Thing": GREY})  # all of it is grey, as the user says
    job = json.loads((tmp_path / "job" / "job.json").read_text())
    assert job["occluders"] == [] and len(trimesh.load(tmp_path / "job" / "Thing.ply").faces) == 12


@pytest.mark.skipif(bpy.app.version >= (5, 0, 0), reason="adaptive subdivision is the modifier's own there")
def test_adaptive_subdivision_is_as_smooth_as_the_render(scene):
    thing = add_cube()
    smooth = thing.modifiers.new("Smooth", "SUBSURF")
    smooth.levels, smooth.render_levels = 0, 1

    def faces():
        with meshes.as_rendered(bpy.context.view_layer, {thing}):
            bpy.context.view_layer.update()
            return len(meshes.gather(bpy.context.view_layer.depsgraph, [thing])["Thing"]["positions"]) // 2

    thing.cycles.use_adaptive_subdivision = True
    assert faces() == 24  # it is switched off for the whole scene
    scene.cycles.feature_set = "EXPERIMENTAL"
    assert faces() == 6 * 4**6 <= meshes.FINE and smooth.levels == 0
    thing.modifiers.new("Bevel", "BEVEL").show_render = False
    assert faces() == 24  # a render does so only where the modifier is the last


def relief(material, shader, kind: str):
    """Gives a material a relief that moves no surface."""
    tree = material.node_tree
    if kind == "displacement":
        node, material.displacement_method = tree.nodes.new("ShaderNodeDisplacement"), "BUMP"
        tree.links.new(node.outputs[0], tree.get_output_node("CYCLES").inputs["Displacement"])
        return
    node = tree.nodes.new({"normal map": "ShaderNodeNormalMap", "bump": "ShaderNodeBump"}.get(kind, "ShaderNodeGroup"))
    if kind == "in a group":
        node.node_tree = bpy.data.node_groups.new("Inner", "ShaderNodeTree")
        node.node_tree.interface.new_socket("Normal", in_out="OUTPUT", socket_type="NodeSocketVector")
        bump, end = (node.node_tree.nodes.new(name) for name in ("ShaderNodeBump", "NodeGroupOutput"))
        node.node_tree.links.new(bump.outputs[0], end.inputs[0])
    tree.links.new(node.outputs[0], shader.inputs["Normal"])


@pytest.mark.parametrize("kind", ["normal map", "bump", "in a group", "displacement"])
def test_a_relief_that_a_material_alone_has_is_said_and_the_rest_of_it_followed(exported, kind):
    thing, (own, shader) = add_cube(), materials.shaded("Bark", "ShaderNodeBsdfPrincipled")
    shader.inputs["Base Color"].default_value = (0.3, 0.2, 0.1, 1)
    thing.data.materials.append(own)
    relief(own, shader, kind)
    fitted, warnings = exported(thing, surfaces={"Thing": own_surface.BLENDER})
    assert fitted["surface"]["base_color"] == pytest.approx([0.3, 0.2, 0.1], abs=1e-6)
    told = "object 'Thing': material 'Bark' has a normal or bump map, which is not followed"
    assert len(warnings) == 1 and warnings[0].startswith(told) and "left_out" not in fitted["surface"]


def test_a_bump_that_nothing_hangs_on_is_not_said(exported):
    thing, (own, shader) = add_cube(), materials.shaded("Bark", "ShaderNodeBsdfPrincipled")
    thing.data.materials.append(own)
    own.node_tree.nodes.new("ShaderNodeBump")
    assert exported(thing, surfaces={"Thing": own_surface.BLENDER})[1] == []
    relief(own, shader, "bump")
    assert exported(thing, surfaces={"Thing": GREY})[1] == []  # what is told is not the material's


@pytest.mark.parametrize(
    ("socket", "value", "said"),
    [
        ("Anisotropic", 0.5, ["how its gloss is stretched"]),
        ("Specular Tint", (1, 0.8, 0.5, 1), ["the tint of its gloss"]),
    ],
)
def test_a_gloss_that_no_number_has_is_left_out_in_words(exported, socket, value, said):
    thing, (own, shader) = add_cube(), materials.shaded("Steel", "ShaderNodeBsdfPrincipled")
    thing.data.materials.append(own)
    assert "left_out" not in exported(thing, surfaces={"Thing": own_surface.BLENDER})[0]["surface"]
    shader.inputs[socket].default_value = value
    assert exported(thing, surfaces={"Thing": own_surface.BLENDER})[0]["surface"]["left_out"] == said
