# SPDX-License-Identifier: GPL-3.0-or-later
"""What the materials of an object reflect at each of its places, baked by Cycles: nodes, attributes, mixtures, groups.

The object's evaluated mesh is copied with its materials into a scene of its own, and laid flat by a smart projection of
its own, so that no place is under another. In the copies every shader becomes an emission of what is looked for:
mixtures of shaders then mix these, also within groups.
"""

from dataclasses import dataclass

import bpy
import numpy as np

from ..basics import pixels
from ..basics.scratch import scratch
from . import meshes
from .bake import NAME as TARGET
from .bake import on_stage, source_of

SIDE, SAMPLES, MARGIN = 512, 4, 4  # pixels; of a pixel; pixels beyond a chart's edge
ANGLE = np.radians(66)  # between the normals of a chart
BETWEEN = 0.01  # charts, of the image
MOST_FACES = 300_000  # more take minutes to lay flat
KINDS, ALIKE = 4, 0.05  # of gloss that a job gets of a baked object; numbers that differ by less are one
PLACES = 20_000  # at which is looked what an object has
ROUNDS = 10  # in which the kinds are found


@dataclass
class BakedSurface:
    """What an object reflects.

    Attributes
    ----------
    colour : (n, n, 3) float32 in the working space, the lowest row first
    finish : (n, n, 3) float32: roughness, metallic and specular
    uv : (f, 3, 2) float32, of its triangles as `meshes.triangles_of_mesh` has them
    places : (m, 2) int, row and column of places that lie evenly over the object
    """

    colour: np.ndarray
    finish: np.ndarray
    uv: np.ndarray
    places: np.ndarray


def readable(source) -> bool:
    """Whether all shaders that a socket's light comes from are such as `bake_object` knows."""
    node = source.node if source is not None else None
    if node is None:
        return False
    if node.type in ("MIX_SHADER", "ADD_SHADER"):
        fed = [source_of(socket) for socket in node.inputs if socket.type == "SHADER"]
        return all(each is not None and readable(each) for each in fed)
    if node.type == "GROUP":
        inner = _inner(node, source)
        return inner is not None and readable(inner)
    return node.type in LEAVES


def _inner(group, source):
    """What feeds, within a group, the output ``source`` of it."""
    tree = group.node_tree
    output = tree and next((n for n in tree.nodes if n.type == "GROUP_OUTPUT" and n.is_active_output), None)
    socket = output and next((s for s in output.inputs if s.identifier == source.identifier), None)
    return socket and source_of(socket)


def bake_object(thing, depsgraph) -> BakedSurface | None:
    """Bakes an object as the render has it; None where Blender cannot. All that is made for it is gone afterwards.

    ``thing`` : bpy.types.Object, of which ``depsgraph`` has the evaluated one
    """
    with scratch() as own:
        mesh = own(bpy.data.meshes.new_from_object(thing.evaluated_get(depsgraph), depsgraph=depsgraph))
        if not mesh.polygons or len(mesh.polygons) > MOST_FACES:
            return None
        try:
            shown = on_stage(own, mesh, SAMPLES)
            copy = shown["object"]
            copy.matrix_world = thing.matrix_world
            was = next((each.name for each in mesh.uv_layers if each.active_render), None)
            if (charts := mesh.uv_layers.new(name=TARGET)) is None:  # there are eight already
                return None
            charts.active = charts.active_render = True
            with bpy.context.temp_override(**shown, edit_object=copy):
                bpy.ops.object.mode_set(mode="EDIT")
                bpy.ops.mesh.select_all(action="SELECT")
                bpy.ops.uv.smart_project(angle_limit=ANGLE, island_margin=BETWEEN)
                bpy.ops.object.mode_set(mode="OBJECT")
            flat = meshes.triangles_of_mesh(mesh, copy.matrix_world)
            if was is not None:
                mesh.uv_layers[was].active_render = True
            with bpy.context.temp_override(**shown):
                baked = [_of_all(copy, mesh, own, what) for what in ("colour", "finish")]
        except (RuntimeError, TypeError):  # no Cycles, or nothing to be laid flat
            return None
        colour, finish = (image[..., :3] for image in baked)
        return BakedSurface(colour, np.clip(finish, 0, 1), flat["uv"], _places(flat["positions"], flat["uv"]))


def _places(positions, uv) -> np.ndarray:
    """(PLACES, 2) int, row and column in an image, by chance, as many of each triangle as it has area."""
    random = np.random.default_rng(0)
    area = np.linalg.norm(np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0]), axis=1)
    face = random.choice(len(uv), PLACES, p=area / area.sum())
    a, b = np.sort(random.random((2, PLACES)), axis=0)
    at = np.einsum("nk,nkc->nc", np.stack([a, b - a, 1 - b], -1), uv[face])
    return np.clip((at[:, ::-1] * SIDE).astype(int), 0, SIDE - 1)


def _of_all(thing, mesh, own, what: str) -> np.ndarray:
    """(n, n, 4) of one of the two, over all of an object."""
    image = own(bpy.data.images.new(TARGET, SIDE, SIDE, alpha=True, float_buffer=True, is_data=True))
    kept = [slot.material for slot in thing.material_slots]
    if not kept:
        mesh.materials.append(None)
        kept = [None]
    for slot, material in zip(thing.material_slots, kept, strict=True):
        copy = own(material.copy() if material else bpy.data.materials.new(TARGET))
        if not copy.node_tree:
            copy.use_nodes = True
        _emitting(copy.node_tree, own, what)
        target = copy.node_tree.nodes.new("ShaderNodeTexImage")
        target.image = image
        copy.node_tree.nodes.active = target
        slot.material = copy
    bpy.ops.object.bake(
        type="EMIT", margin=MARGIN, uv_layer=TARGET, use_clear=True, target="IMAGE_TEXTURES", save_mode="INTERNAL"
    )
    for slot, material in zip(thing.material_slots, kept, strict=True):
        slot.material = material
    return pixels.read(image)


def _emitting(tree, own, what: str) -> None:
    """Makes each shader of a tree emit its colour or its finish; groups are copied for it."""
    layers = [_as_layer(tree, node, what) for node in tree.nodes if node.type == "MIX_SHADER"]
    for node in list(tree.nodes):
        if node.type == "GROUP" and node.node_tree and any(s.type == "SHADER" for s in node.outputs):
            node.node_tree = own(node.node_tree.copy())
            _emitting(node.node_tree, own, what)
        elif node.type in LEAVES:
            emission = tree.nodes.new("ShaderNodeEmission")
            colour, finish = LEAVES[node.type]
            finish = (finish[0], 0.0, 0.5) if node in layers else finish
            if what == "colour":
                _put(tree, next(node.inputs[name] for name in colour if name in node.inputs), emission.inputs["Color"])
            else:
                joined = tree.nodes.new("ShaderNodeCombineColor")
                for given, target in zip(finish, joined.inputs, strict=True):
                    if isinstance(given, str):
                        _put(tree, node.inputs[given], target)
                    else:
                        target.default_value = given
                tree.links.new(joined.outputs[0], emission.inputs["Color"])
            for link in [link for link in tree.links if link.from_node == node]:
                tree.links.new(emission.outputs[0], link.to_socket)
    output = next((node for node in tree.nodes if node.type == "OUTPUT_MATERIAL"), None)
    for link in [link for link in tree.links if output and link.to_node == output and link.to_socket.name != "Surface"]:
        tree.links.remove(link)


def _as_layer(tree, mix, what: str):
    """Where Fresnel's share mixes two shaders, the second is a dielectric's layer over the first; gives it, or None."""
    share = source_of(mix.inputs[0])
    if share is None or share.node.type not in VIEWED:
        return None
    for link in mix.inputs[0].links:
        tree.links.remove(link)
    mix.inputs[0].default_value = 0.0 if what == "colour" else 1.0
    second = source_of(mix.inputs[2])
    return second and second.node


def _put(tree, given, target) -> None:
    """What an input is fed with, or set to, for another."""
    source = source_of(given)
    if source is not None:
        tree.links.new(source, target)
    elif hasattr(target.default_value, "__len__"):
        target.default_value = [*given.default_value[:3], 1.0]
    else:
        target.default_value = given.default_value


# nodes whose value is another from another side
VIEWED = {"FRESNEL", "LAYER_WEIGHT"}
# of each shader the input of its colour, and roughness, metallic and specular: an input, or a number
LEAVES = {
    "BSDF_PRINCIPLED": (("Base Color",), ("Roughness", "Metallic", "Specular IOR Level")),
    "BSDF_DIFFUSE": (("Color",), (1.0, 0.0, 0.0)),
    "BSDF_GLOSSY": (("Color",), ("Roughness", 1.0, 0.5)),
    "BSDF_METALLIC": (("Base Color", "Color"), ("Roughness", 1.0, 0.5)),
}


def grouped(finish, values) -> np.ndarray:
    """The finish (n, n, 3) in few kinds: of each place the nearest of `KINDS` means of ``values`` (m, 3) (Lloyd's)."""
    if np.ptp(values, axis=0).max() < ALIKE:
        return np.broadcast_to(values.mean(0), finish.shape)
    order = np.argsort(values @ (1.0, 1.0, 1.0))
    centres = values[order[((np.arange(KINDS) + 0.5) / KINDS * len(values)).astype(int)]].astype(np.float64)

    def nearest(points):
        return np.argmin([np.square(points - centre).sum(1) for centre in centres], 0)

    for _ in range(ROUNDS):
        number = nearest(values)
        counts = np.bincount(number, minlength=KINDS)[:, None]
        sums = np.stack([np.bincount(number, v, KINDS) for v in values.T], -1)
        centres = np.where(counts > 0, sums / np.maximum(counts, 1), centres)
    return centres[nearest(finish.reshape(-1, 3))].reshape(finish.shape).astype(np.float32)
