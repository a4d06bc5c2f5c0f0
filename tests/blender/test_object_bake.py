# SPDX-License-Identifier: GPL-3.0-or-later
"""What an object's nodes reflect at its places, as a job has it: baked by Cycles, read by the engine."""

import json

import bpy
import numpy as np
import pytest

from blender_btfsep.run import request
from blender_btfsep.scene import own_surface
from btfsep_engine.job.load import load_job
from scripts.cycles import materials


@pytest.fixture
def cube(photographed):
    entry = photographed.btfsep.objects[0]
    entry.source = own_surface.BLENDER
    return entry.object


def surface_of(scene, tmp_path) -> dict:
    request.write_job(scene, folder=tmp_path / "job")
    return json.loads((tmp_path / "job" / "job.json").read_text())["objects"][0]["surface"]


def values_at_faces(tmp_path, what: str):
    """Middles of the triangles (f, 3), world, and what the job's image has there (f, 3)."""
    (thing,) = load_job(tmp_path / "job").objects
    image = getattr(thing.surface, what)
    column, up = (thing.mesh.corner_uv.mean(1) * len(image)).astype(int).T
    return thing.mesh.vertices[thing.mesh.faces].mean(1), image[len(image) - 1 - up, column]


def by_place(material, socket, *, axis=None):
    """Feeds an input with half of one more than the place on the object, or than one coordinate of it."""
    tree = material.node_tree
    place, half = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeVectorMath")
    half.operation = "MULTIPLY_ADD"
    half.inputs[1].default_value = half.inputs[2].default_value = (0.5, 0.5, 0.5)
    tree.links.new(place.outputs["Object"], half.inputs[0])
    if axis is None:
        tree.links.new(half.outputs[0], socket)
        return
    apart = tree.nodes.new("ShaderNodeSeparateXYZ")
    tree.links.new(half.outputs[0], apart.inputs[0])
    tree.links.new(apart.outputs[axis], socket)


def test_colours_by_nodes_lie_where_they_are(photographed, cube, tmp_path):
    own, shader = materials.shaded("own", "ShaderNodeBsdfPrincipled", Roughness=0.3)
    by_place(own, shader.inputs["Base Color"])
    cube.data.materials.append(own)
    surface = surface_of(photographed, tmp_path)
    assert "finish" not in surface and surface["roughness"] == pytest.approx(0.3, abs=1e-3)
    places, colours = values_at_faces(tmp_path, "image")
    assert np.allclose(colours, (places + 1) / 2, atol=0.01)
    assert "BTFsep bake" not in bpy.data.scenes and len(cube.data.uv_layers) == 1
    assert cube.material_slots[0].material == own and len(bpy.data.materials) == 1


def test_gloss_by_nodes_has_few_kinds(photographed, cube, tmp_path):
    own, shader = materials.shaded("own", "ShaderNodeBsdfPrincipled")
    by_place(own, shader.inputs["Roughness"], axis=2)
    cube.data.materials.append(own)
    assert surface_of(photographed, tmp_path)["finish"] == "finish_Cube.exr"
    places, finish = values_at_faces(tmp_path, "finish")
    assert np.allclose(finish[:, 0], (places[:, 2] + 1) / 2, atol=0.2)
    assert len(load_job(tmp_path / "job").objects[0].surface.kinds()) <= 4


def test_vertex_colours_are_followed(photographed, cube, tmp_path):
    own, shader = materials.shaded("own", "ShaderNodeBsdfPrincipled")
    colours = cube.data.color_attributes.new("Painted", "FLOAT_COLOR", "POINT")
    for i, vertex in enumerate(cube.data.vertices):
        colours.data[i].color = (0.2 if vertex.co.x < 0 else 0.7, 0.5, 0.1, 1)
    node = own.node_tree.nodes.new("ShaderNodeVertexColor")
    node.layer_name = "Painted"
    own.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    cube.data.materials.append(own)
    assert surface_of(photographed, tmp_path)["base_color"] == "colour_Cube.exr"
    places, colours = values_at_faces(tmp_path, "image")
    assert np.allclose(colours, [[0.45 + 0.25 * x, 0.5, 0.1] for x in places[:, 0]], atol=0.01)


def test_mixtures_and_groups_are_numbers_where_they_are_even(photographed, cube, tmp_path):
    tree = bpy.data.node_groups.new("inner", "ShaderNodeTree")
    tree.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    inner, out = tree.nodes.new("ShaderNodeBsdfPrincipled"), tree.nodes.new("NodeGroupOutput")
    inner.inputs["Base Color"].default_value, inner.inputs["Metallic"].default_value = (0.2, 0.4, 0.6, 1), 1
    tree.links.new(inner.outputs[0], out.inputs[0])
    own, mix = materials.shaded("own", "ShaderNodeMixShader", Fac=0.25)
    group, matte = own.node_tree.nodes.new("ShaderNodeGroup"), own.node_tree.nodes.new("ShaderNodeBsdfDiffuse")
    group.node_tree = tree
    matte.inputs["Color"].default_value = (0.6, 0.6, 0.6, 1)
    own.node_tree.links.new(group.outputs[0], mix.inputs[1])
    own.node_tree.links.new(matte.outputs[0], mix.inputs[2])
    cube.data.materials.append(own)
    surface = surface_of(photographed, tmp_path)
    assert np.allclose(surface["base_color"], (0.3, 0.45, 0.6), atol=1e-3)
    assert surface["metallic"] == pytest.approx(0.75, abs=1e-3)
    assert surface["roughness"] == pytest.approx(0.75 * 0.5 + 0.25, abs=1e-3)
    assert len(bpy.data.node_groups) == 1 and inner.outputs[0].is_linked


def test_fresnels_mixture_is_a_layer(photographed, cube, tmp_path):
    own, mix = materials.shaded("own", "ShaderNodeMixShader")
    matte, gloss = (own.node_tree.nodes.new(f"ShaderNodeBsdf{kind}") for kind in ("Diffuse", "Glossy"))
    matte.inputs["Color"].default_value, gloss.inputs["Roughness"].default_value = (0.6, 0.3, 0.1, 1), 0.3
    for source, socket in zip((own.node_tree.nodes.new("ShaderNodeFresnel"), matte, gloss), mix.inputs, strict=True):
        own.node_tree.links.new(source.outputs[0], socket)
    cube.data.materials.append(own)
    surface = surface_of(photographed, tmp_path)
    assert np.allclose(surface["base_color"], (0.6, 0.3, 0.1), atol=1e-3)
    assert [surface[key] for key in ("roughness", "metallic", "specular")] == pytest.approx([0.3, 0, 0.5], abs=1e-3)


def test_layers_are_numbers_and_what_has_none_is_named(photographed, cube, tmp_path):
    told = {"Coat Weight": 0.5, "Coat Roughness": 0.1, "Sheen Weight": 0.5, "Sheen Tint": (1, 0.5, 0, 1)}
    own, shader = materials.shaded("own", "ShaderNodeBsdfPrincipled")
    for name, value in told.items():
        shader.inputs[name].default_value = value
    cube.data.materials.append(own)
    surface = surface_of(photographed, tmp_path)
    assert (surface["coat"], surface["sheen"]) == (0.5, [0.5, 0.25, 0])
    assert surface["left_out"] == ["how bright its sheen is at a slant"]
    assert surface["coat_roughness"] == pytest.approx(0.1)
    shader.inputs["Subsurface Weight"].default_value, shader.inputs["Sheen Weight"].default_value = 1, 0
    shader.inputs["Emission Strength"].default_value = 0.1
    told = ["light that goes on below its surface", "that it shines"]
    assert surface_of(photographed, tmp_path)["left_out"] == told
