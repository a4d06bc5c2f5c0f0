# SPDX-License-Identifier: GPL-3.0-or-later
"""A Blender material as texture maps: base colour, roughness, metallic, height or normal of a square, by Cycles.

The square is ``size`` Blender units wide, with UV 0 to 1 and the origin in its middle. A copy of the material emits
what is at one input of its Principled BSDF after the other. All of it is in a scene of its own, removed afterwards.
"""

from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np

from ..basics import colour, pixels
from ..basics.errors import InputError
from ..basics.scratch import save_exr, scratch

NAME = "BTFsep bake"
SAMPLES = 16  # within a pixel, against jagged edges
NOT_MEASURED = ("Transmission Weight", "Subsurface Weight", "Coat Weight", "Sheen Weight")
OF_THE_OBJECT = {"ATTRIBUTE", "VERTEX_COLOR", "OBJECT_INFO", "AMBIENT_OCCLUSION"}  # nodes that a bare square lacks
DO = "connect a Principled BSDF to the Material Output"


@dataclass
class BakedMaps:
    """What a material's maps were found to be.

    Attributes
    ----------
    base_colour : (n, n, 3) float32, linear; roughness : (n, n) float32; row 0 is the smallest v
    height : (n, n) float32 in Blender units, or None
    normal : (n, n, 3) float32 in [-1, 1], where there is no height but something at the Normal input, else None
    f0 : reflectance of what is no metal at normal incidence
    warnings : list of str
    metallic : (n, n) float32, or None where nothing is metal
    """

    base_colour: np.ndarray
    roughness: np.ndarray
    height: np.ndarray | None
    normal: np.ndarray | None
    f0: float
    warnings: list = field(default_factory=list)
    metallic: np.ndarray | None = None


def bake_material(
    material, *, size: float, resolution: int = 512, uv_names=("UVMap",), scale: float = 1.0
) -> BakedMaps:
    """Bakes a material. Everything that is made for it is gone afterwards.

    Parameters
    ----------
    material : bpy.types.Material
    size : edge of the square, Blender units
    resolution : pixels an edge
    uv_names : of the UV maps that the material may name
    scale : of the object; displacement in the object's space grows with it

    Raises InputError: no node tree, no Principled BSDF at its output, a displacement that is no height.
    """
    warnings = []
    with _stage(material, size, resolution, uv_names) as stage:
        shader = _principled(stage)
        for node in stage.tree.nodes:
            if node.type in OF_THE_OBJECT:
                warnings.append(
                    f"node '{node.name}' looks at the object; the square that is measured has nothing there"
                )
        for name in NOT_MEASURED:
            if source_of(shader.inputs[name]) is not None or shader.inputs[name].default_value > 0.01:
                warnings.append(
                    f"{name} is not measured: the material is taken as opaque, with a base and a gloss alone"
                )
        f0 = _f0(shader, warnings)
        base = stage.value(shader.inputs["Base Color"])[..., :3]
        roughness = stage.value(shader.inputs["Roughness"])[..., 0]
        metallic = stage.value(shader.inputs["Metallic"])[..., 0]
        height, normal = _relief(stage, shader, scale, warnings)
    return BakedMaps(base, roughness, height, normal, f0, warnings, metallic if metallic.max() > 0.001 else None)


def write_maps(maps: BakedMaps, folder, *, millimetres: float, height_mm: float = 0.0) -> list:
    """Writes the maps as linear EXR into ``folder``, heights in millimetres; gives the options for the engine.

    Parameters
    ----------
    maps : BakedMaps
    folder : made if it is not there
    millimetres : in a Blender unit
    height_mm : if not 0, the height is stretched to so much from its lowest to its highest place
    """
    folder = Path(folder)
    written = {"basecolor": colour.to_rec709(maps.base_colour), "roughness": maps.roughness}
    if maps.metallic is not None:
        written["metallic"] = maps.metallic
    options = ["--f0", maps.f0]
    if maps.normal is not None:
        written["normal_gl"] = maps.normal
        options += ["--height-mm", height_mm] if height_mm else []
    else:
        height = (maps.height - maps.height.mean()) * millimetres
        span = float(np.ptp(height))
        if height_mm and span > 0:
            height *= height_mm / span
        written["height"] = height
        options += ["--height-mm", 1]  # the file is in millimetres
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, values in written.items():
            _write_exr(folder / f"{name}.exr", values)
    except (OSError, RuntimeError) as error:
        raise InputError(f"cannot write to {folder}", error, "choose a folder that can be written") from None
    return options


class _Stage:
    """A square with a copy of a material, and an emission that shows what is put to it.

    ``shown`` : of :func:`on_stage`
    """

    def __init__(self, name: str, tree, image, shown: dict):
        self.name, self.tree, self.image, self.shown = name, tree, image, shown
        self.output = self.tree.get_output_node("CYCLES")
        self.emission = self.tree.nodes.new("ShaderNodeEmission")
        target = self.tree.nodes.new("ShaderNodeTexImage")
        target.image = image
        self.tree.nodes.active = target

    def value(self, socket) -> np.ndarray:
        """(n, n, 4) float32: what arrives at an input, or what is set there; row 0 is the smallest v."""
        source = source_of(socket)
        if source is not None:
            return self.bake(source)
        value = socket.default_value
        n = self.image.size[0]
        constant = np.ones(4, np.float32)
        constant[:3] = value[:3] if hasattr(value, "__len__") else value
        return np.broadcast_to(constant, (n, n, 4))

    def bake(self, source) -> np.ndarray:
        """(n, n, 4) float32: what an output socket gives."""
        links = self.tree.links
        links.new(source, self.emission.inputs["Color"])
        links.new(self.emission.outputs[0], self.output.inputs["Surface"])
        with bpy.context.temp_override(**self.shown):
            bpy.ops.object.bake(type="EMIT", margin=0, use_clear=True, target="IMAGE_TEXTURES", save_mode="INTERNAL")
        return pixels.read(self.image)

    def combined(self, operation: str, *inputs):
        """The output of a new node ``operation`` of sockets (their sources or values) and numbers."""
        node = self.tree.nodes.new("ShaderNodeMath")
        node.operation = operation
        for target, given in zip(node.inputs, inputs, strict=False):
            if isinstance(given, int | float):
                target.default_value = given
            elif given.is_output:
                self.tree.links.new(given, target)
            elif (source := source_of(given)) is not None:
                self.tree.links.new(source, target)
            else:
                target.default_value = given.default_value
        return node.outputs[0]


def on_stage(own, mesh, samples: int) -> dict:
    """A scene of Cycles whose one object is ``mesh``; gives what ``temp_override`` needs for it to be baked."""
    scene, thing = own(bpy.data.scenes.new(NAME)), own(bpy.data.objects.new(NAME, mesh))
    scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", samples
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.render.bake.use_selected_to_active = False
    scene.collection.objects.link(thing)
    layer = scene.view_layers[0]
    layer.objects.active = thing
    thing.select_set(True, view_layer=layer)
    shown = {"scene": scene, "view_layer": layer, "active_object": thing, "object": thing}
    return shown | {"selected_objects": [thing], "selected_editable_objects": [thing]}


@contextmanager
def _stage(material, size: float, resolution: int, uv_names):
    if material.node_tree is None:
        raise InputError(f"material '{material.name}'", "it has no nodes", DO)
    with scratch() as own:
        mesh = own(bpy.data.meshes.new(NAME))
        half = size / 2
        mesh.from_pydata([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)], [], [(0, 1, 2, 3)])
        for name in uv_names or ("UVMap",):
            mesh.uv_layers.new(name=name).data.foreach_set("uv", [0, 0, 1, 0, 1, 1, 0, 1])
        copy = own(material.copy())
        copy.displacement_method = "BUMP"
        mesh.materials.append(copy)
        image = own(bpy.data.images.new(NAME, resolution, resolution, float_buffer=True, is_data=True))
        if copy.node_tree.get_output_node("CYCLES") is None:
            raise InputError(f"material '{material.name}'", "it has no Material Output", DO)
        yield _Stage(material.name, copy.node_tree, image, on_stage(own, mesh, SAMPLES))


def source_of(socket):
    """The output socket that feeds an input, past reroutes; None where nothing does."""
    for _ in range(1000):
        link = next((link for link in socket.links if not link.is_muted), None)
        if link is None:
            return None
        if link.from_node.type != "REROUTE":
            return link.from_socket
        socket = link.from_node.inputs[0]
    return None


def _principled(stage):
    source = source_of(stage.output.inputs["Surface"])
    what = f"material '{stage.name}'"
    if source is None:
        raise InputError(what, "nothing is at its Surface", DO)
    if source.node.type == "GROUP":
        raise InputError(
            what, f"its surface is the group '{source.node.name}'", "ungroup it, so that a Principled BSDF is there"
        )
    if source.node.type != "BSDF_PRINCIPLED":
        raise InputError(what, f"its surface is '{source.node.name}', which cannot be measured", DO)
    return source.node


def _f0(shader, warnings) -> float:
    """Schlick's reflectance of the layer; 0.04 where a map decides it."""
    ior, level = shader.inputs["IOR"], shader.inputs["Specular IOR Level"]
    if source_of(ior) is not None or source_of(level) is not None:
        warnings.append("IOR or specular level is not constant; a reflectance of 0.04 is taken")
        return 0.04
    f0 = ((ior.default_value - 1) / (ior.default_value + 1)) ** 2 * 2 * level.default_value
    if f0 > 0.2:
        warnings.append(f"a reflectance of {f0:.2f} at normal incidence is beyond what is measured; 0.2 is taken")
    return round(min(f0, 0.2), 5)


def _relief(stage, shader, scale: float, warnings):
    """(height in Blender units, None), or (None, normals)."""
    heights = []
    source = source_of(stage.output.inputs["Displacement"])
    if source is not None:
        heights.append(_displacement(stage, source, scale))
    source = source_of(shader.inputs["Normal"])
    if source is not None:
        bump = source.node if source.node.type == "BUMP" and source_of(source.node.inputs["Normal"]) is None else None
        if bump is not None:
            rise = stage.combined("MULTIPLY", bump.inputs["Height"], bump.inputs["Distance"])
            rise = stage.combined("MULTIPLY", rise, bump.inputs["Strength"])
            heights.append(stage.combined("MULTIPLY", rise, -1.0 if bump.invert else 1.0))
        elif not heights:
            return None, _normals(stage, source)
        else:
            warnings.append(f"'{source.node.name}' at the Normal input is left out: the displacement is measured")
    if not heights:
        warnings.append("the material is measured as flat: it has neither displacement nor bump nor normal")
        return np.zeros((stage.image.size[0],) * 2, np.float32), None
    total = heights[0] if len(heights) == 1 else stage.combined("ADD", *heights)
    return stage.bake(total)[..., 0], None


def _displacement(stage, source, scale: float):
    node = source.node
    if node.type != "DISPLACEMENT":
        raise InputError(
            f"material '{stage.name}'",
            f"its displacement comes from '{node.name}', which gives no height",
            "put a Displacement node before the Material Output",
        )
    rise = stage.combined("SUBTRACT", node.inputs["Height"], node.inputs["Midlevel"])
    rise = stage.combined("MULTIPLY", rise, node.inputs["Scale"])
    return stage.combined("MULTIPLY", rise, scale if node.space == "OBJECT" else 1.0)


def _normals(stage, source) -> np.ndarray:
    """(n, n, 3) float32: the square lies in the plane, so that the world's axes are those of its tangents."""
    node = stage.tree.nodes.new("ShaderNodeVectorMath")
    node.operation = "MULTIPLY_ADD"  # an emission is not negative
    stage.tree.links.new(source, node.inputs[0])
    node.inputs[1].default_value = node.inputs[2].default_value = (0.5, 0.5, 0.5)
    return 2 * stage.bake(node.outputs[0])[..., :3] - 1


def _write_exr(path: Path, values) -> None:
    """``values : (n, n) or (n, n, 3)`` as they are, float32, row 0 at the bottom."""
    with scratch() as own:
        save_exr(own(pixels.new(path.stem, values)), path, raw=True)
