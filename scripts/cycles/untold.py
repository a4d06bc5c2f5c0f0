# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job does not say of an object and of its photo: how the material differs, and what the camera adds."""

import bpy
import cv2
import numpy as np

from scripts.cycles import objects

DUST = (0.6, 0.57, 0.5, 1)


def of_finish(kind: str, much: float, size: float, colour) -> dict | None:
    """Sockets of the Principled BSDF and their values; None: no finish.

    ``size`` : of the object; ``colour`` : (3,), its own
    """
    light = (*(0.5 + 0.5 * np.array(colour)), 1)
    scattered = {"Subsurface Weight": 1, "Subsurface Radius": (1, 0.7, 0.5)}
    return {
        "velvet": {"Sheen Weight": 1, "Sheen Roughness": 0.2 + 0.3 * much, "Sheen Tint": light},
        "coat": {"Coat Weight": 1, "Coat Roughness": 0.1 * much},
        "brushed": {"Metallic": 1, "Anisotropic": 0.5 + 0.45 * much},
        "wax": scattered | {"Subsurface Scale": size * (0.1 + 0.2 * much)},
        "frosted": {"Transmission Weight": 0.4 + 0.6 * much},
    }.get(kind)


def unlike(thing: bpy.types.Object, kind: str, much: float, *, paint=None) -> None:
    """Gives an object what its job does not say: ``kind`` of ``OF_OBJECTS`` or ``OF_FINISHES`` of
    `scripts.studies.plate_things`, or "painted".

    ``much`` : 0 to 1, of what is usual; ``paint`` : (3,), the colour of the half of it that is painted
    """
    material = thing.data.materials[0]
    tree, bsdf = material.node_tree, next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    size = float(np.ptp(objects.vertex_positions(thing.data), axis=0).max())
    if kind == "subsurface":
        bsdf.inputs["Subsurface Weight"].default_value = 1
        bsdf.inputs["Subsurface Radius"].default_value = (1, 0.6, 0.4)
        bsdf.inputs["Subsurface Scale"].default_value = size * (0.01 + 0.04 * much)
    elif finish := of_finish(kind, much, size, bsdf.inputs["Base Color"].default_value[:3]):
        for name, value in finish.items():
            bsdf.inputs[name].default_value = value
    elif kind == "dusty":  # where it faces up
        shape, up = tree.nodes.new("ShaderNodeNewGeometry"), tree.nodes.new("ShaderNodeSeparateXYZ")
        lies, mix = tree.nodes.new("ShaderNodeMapRange"), tree.nodes.new("ShaderNodeMix")
        lies.inputs["From Min"].default_value, lies.inputs["To Max"].default_value = 0.2, 0.3 + 0.6 * much
        mix.data_type = "RGBA"
        mix.inputs["A"].default_value, mix.inputs["B"].default_value = bsdf.inputs["Base Color"].default_value, DUST
        tree.links.new(shape.outputs["Normal"], up.inputs["Vector"])
        tree.links.new(up.outputs["Z"], lies.inputs["Value"])
        tree.links.new(lies.outputs["Result"], mix.inputs["Factor"])
        tree.links.new(mix.outputs["Result"], bsdf.inputs["Base Color"])
    elif kind in ("bumps", "mottled", "painted"):
        noise, place = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes.new("ShaderNodeTexCoord")
        scale, detail = (5, 1) if kind == "painted" else (12, 3)
        noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = scale / size, detail
        tree.links.new(place.outputs["Object"], noise.inputs["Vector"])
    if kind == "bumps":
        bump = tree.nodes.new("ShaderNodeBump")
        bump.inputs["Distance"].default_value = size * (0.01 + 0.03 * much)
        tree.links.new(noise.outputs["Fac"], bump.inputs["Height"])
        tree.links.new(bump.outputs["Normal"], bsdf.inputs["Normal"])
    elif kind == "mottled":  # the noise is 0.5 in the mean, and hardly ever beyond 0.25 and 0.75
        shade, tint = tree.nodes.new("ShaderNodeMapRange"), tree.nodes.new("ShaderNodeVectorMath")
        spread = 0.2 + 0.3 * much
        for name, value in {"From Min": 0.25, "From Max": 0.75, "To Min": 1 - spread, "To Max": 1 + spread}.items():
            shade.inputs[name].default_value = value
        tint.operation, tint.inputs[0].default_value = "MULTIPLY", bsdf.inputs["Base Color"].default_value[:3]
        tree.links.new(noise.outputs["Fac"], shade.inputs["Value"])
        tree.links.new(shade.outputs["Result"], tint.inputs[1])
        tree.links.new(tint.outputs["Vector"], bsdf.inputs["Base Color"])
    elif kind == "painted":
        ramp = tree.nodes.new("ShaderNodeValToRGB")
        low, high = ramp.color_ramp.elements
        low.position, high.position = 0.48, 0.52
        low.color, high.color = bsdf.inputs["Base Color"].default_value, (*paint, 1)
        tree.links.new(noise.outputs["Fac"], ramp.inputs["Fac"])
        tree.links.new(ramp.outputs["Color"], bsdf.inputs["Base Color"])


def through(linear, kind: str, much: float, seed: int) -> np.ndarray:
    """A picture (h, w, 3) as a camera with ``kind`` of `scripts.studies.plate_things.OF_CAMERAS` takes it."""
    height, width = linear.shape[:2]
    if kind == "vignette":  # at the corners down to 0.7 to 0.4, as open lenses have it
        y, x = np.mgrid[:height, :width]
        off = np.hypot((2 * x + 1) / width - 1, (2 * y + 1) / height - 1) / np.sqrt(2)
        return linear * (1 - (0.3 + 0.3 * much) * off[..., None] ** 2)
    if kind == "grain":  # of photons: 3 to 9 % at the mean
        mean = linear.mean()
        noise = np.random.default_rng(seed).standard_normal(linear.shape)
        return np.maximum(linear + (0.03 + 0.06 * much) * np.sqrt(np.maximum(linear, 0) * mean) * noise, 0)
    if kind == "soft":  # pixels
        return cv2.GaussianBlur(linear, (0, 0), 0.6 + 1.2 * much)
    if kind == "glare":  # of each pixel's light, over the whole of the picture
        return linear + (0.01 + 0.04 * much) * (cv2.GaussianBlur(linear, (0, 0), width / 6) - linear)
    return linear
