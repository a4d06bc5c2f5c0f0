# SPDX-License-Identifier: GPL-3.0-or-later
"""The spheres of the published comparisons, path-traced by Cycles in their own scene, against the engine's integrals.

Blender 3.6's *Principled BSDF* is built from what newer versions have: a *Glossy BSDF* is its mirror and its silver, a
*Principled BSDF* with a black base its gloss on the diffuse sphere. Burley's lobe is in none of them; it is checked
in tests/engine.
"""

import bpy
import numpy as np
import pytest

from btfsep_engine.conventions import pixel_directions
from btfsep_engine.fit import blender_spheres as spheres
from btfsep_engine.imaging import images


def light(directions):
    """Radiance (..., 3): sky, ground, and two lamps."""
    up = directions[..., 2:]
    out = 0.3 + np.maximum(up, 0) * [0.3, 0.4, 0.6] + np.maximum(-up, 0) * [0.5, 0.3, 0.2]
    for towards, sharpness, colour in (((1, -2, 1.5), 40, (3, 2.5, 2)), ((-2, 0.6, 0.5), 15, (0.3, 1, 1.5))):
        out = out + np.exp(sharpness * (directions @ towards / np.linalg.norm(towards) - 1))[..., None] * colour
    return out


@pytest.fixture
def sphere(scene, add_camera, tmp_path):
    """The protocol's sphere, camera and World; the material's node tree, with an output and nothing else."""
    bpy.ops.mesh.primitive_uv_sphere_add(radius=1)
    ball = bpy.context.object
    ball.data.shade_smooth()
    ball.modifiers.new("Subsurf", "SUBSURF").render_levels = 1
    camera = add_camera(scene, (0, -16, 2))
    camera.data.lens, camera.data.sensor_width = 85, 36
    camera.data.dof.use_dof, camera.data.dof.focus_object, camera.data.dof.aperture_fstop = True, ball, 0.5
    scene.render.resolution_x, scene.render.resolution_y = spheres.WIDTH, spheres.HEIGHT
    scene.render.use_border = True
    render = scene.render
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.34, 0.66, 0.22, 0.78
    scene.render.film_transparent = True
    scene.cycles.samples = 16
    images.write_exr(tmp_path / "light.exr", light(pixel_directions(128, 256)))
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    nodes = scene.world.node_tree.nodes
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(str(tmp_path / "light.exr"))
    scene.world.node_tree.links.new(texture.outputs["Color"], nodes["Background"].inputs["Color"])
    material = bpy.data.materials.new("Sphere")
    material.use_nodes = True
    material.node_tree.nodes.clear()
    material.node_tree.nodes.new("ShaderNodeOutputMaterial")
    ball.data.materials.append(material)
    return material.node_tree


def shader(tree, kind, **inputs):
    """A shader of GGX that reaches the surface."""
    node = tree.nodes.new(kind)
    node.distribution = "GGX"
    for name, value in inputs.items():
        node.inputs[name.replace("_", " ")].default_value = value
    tree.links.new(node.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    return node


def mirror(tree):
    """Reflectance 0.8, and towards the rim as much more as a dielectric of specular 0.2 has there."""
    glossy = shader(tree, "ShaderNodeBsdfGlossy", Roughness=0)
    fresnel, ramp = tree.nodes.new("ShaderNodeFresnel"), tree.nodes.new("ShaderNodeMapRange")
    index = 2 / (1 - np.sqrt(0.08 * 0.2)) - 1
    fresnel.inputs["IOR"].default_value = index
    ramp.inputs["From Min"].default_value = ((index - 1) / (index + 1)) ** 2
    ramp.inputs["To Min"].default_value, ramp.inputs["To Max"].default_value = 0.8, 1
    tree.links.new(fresnel.outputs[0], ramp.inputs["Value"])
    tree.links.new(ramp.outputs["Result"], glossy.inputs["Color"])


def silver(tree):
    shader(tree, "ShaderNodeBsdfGlossy", Roughness=0.3271, Color=(0.8, 0.8, 0.8, 1))


def gloss(tree):
    shader(tree, "ShaderNodeBsdfPrincipled", Roughness=0.364, IOR=1.5, Base_Color=(0, 0, 0, 1))


@pytest.mark.parametrize(
    ("build", "kind", "single", "overall"),
    [(mirror, "mirror", 0.03, 0.003), (silver, "matte_silver", 0.02, 0.003), (gloss, "diffuse", 0.03, 0.01)],
)
def test_against_cycles(sphere, scene, render, monkeypatch, build, kind, single, overall):
    """Root mean square over blocks of 6 x 6 pixels, which noise is averaged away in, and the mean of the picture."""
    if build is gloss:
        monkeypatch.setattr(spheres, "BASE", 0.0)  # no matte lobe below the gloss
    build(sphere)
    theirs = render(scene).astype(np.float64)
    ours = spheres.blender_spheres(light(pixel_directions(128, 256)))[0][kind][0]
    a, b = (x.reshape(90, 6, 160, 6, 3).mean((1, 3)) for x in (ours, theirs))
    assert np.sqrt(((a - b) ** 2).sum() / (b**2).sum()) < single
    assert np.abs(ours.mean((0, 1)) / theirs.mean((0, 1)) - 1).max() < overall
