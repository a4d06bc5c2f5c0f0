# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects of Principled BSDFs under studio lights: the engine's ``surface`` and Cycles show the same picture."""

import json

import bpy
import numpy as np
import pytest
from scipy.ndimage import binary_erosion, gaussian_filter

from blender_btfsep.basics import pixels
from blender_btfsep.scene.export import export_job
from btfsep_engine.imaging.images import write_exr
from scripts.cycles import engine, materials, studio

SIZE, SAMPLES = 64, 256
SOCKETS = {
    "roughness": "Roughness", "metallic": "Metallic", "specular": "Specular IOR Level", "coat": "Coat Weight",
    "coat_roughness": "Coat Roughness", "sheen_roughness": "Sheen Roughness",
}  # fmt: skip


def principled(surface):
    """A material of the values of a job's ``surface``; its base colour may be an image (h, w, 3), row 0 at the top."""
    material, node = materials.shaded("given", "ShaderNodeBsdfPrincipled")
    tree = material.node_tree
    for key, socket in SOCKETS.items():
        if key in surface:
            node.inputs[socket].default_value = surface[key]
    if "sheen" in surface:
        node.inputs["Sheen Weight"].default_value, node.inputs["Sheen Tint"].default_value = 1, (*surface["sheen"], 1)
    colour = surface["base_color"]
    if isinstance(colour, np.ndarray):
        picture = tree.nodes.new("ShaderNodeTexImage")
        picture.image = pixels.new("paint", colour[::-1])
        tree.links.new(picture.outputs["Color"], node.inputs["Base Color"])
    else:
        node.inputs["Base Color"].default_value = (*colour, 1)
    return material


def photographed(light, surface, folder):
    """A ball of radius 1: its radiance by Cycles, and the job folder that states its surface."""
    scene = studio.clear()
    scene.world = studio.make_world(light)
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    bpy.ops.mesh.primitive_uv_sphere_add(segments=128, ring_count=64, radius=1)
    thing = bpy.context.object
    thing.data.shade_smooth()
    thing.data.materials.append(principled(surface))
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.data.lens, camera.data.sensor_width = studio.LENS_MM, studio.SENSOR_MM
    studio.aim(camera, [thing.matrix_world @ v.co for v in thing.data.vertices])
    bpy.context.view_layer.update()
    photo = studio.render_photo(scene, folder / "photo.exr", SAMPLES)
    job = export_job(scene, folder / "job", image_path=folder / "photo.exr", objects=[thing], occluders=[]).parent
    tree = json.loads((job / "job.json").read_text())
    stated = dict(surface)
    if isinstance(surface["base_color"], np.ndarray):
        write_exr(job / "paint.exr", surface["base_color"].astype(np.float32))
        stated["base_color"] = "paint.exr"
    tree["objects"][0]["surface"] = stated
    (job / "job.json").write_text(json.dumps(tree))
    return photo, job


def relit(job, light, folder):
    """The engine's picture under the same light."""
    out = folder / "relit.exr"
    result = engine.run("relight", job, "--lighting", studio.light_path(light), "--out", out, "--directions", 2048)
    assert [o["material"] for o in result["objects"]] == ["surface/given"]
    return studio.read_image(out)


def painted():
    """Smooth blotches of strong colours, 60 x 40, periodic; neither flipped nor turned they are like themselves."""
    noise = np.random.default_rng(3).normal(size=(40, 60, 3))
    smooth = gaussian_filter(noise, (3, 3, 0), mode="wrap")
    return 0.45 + 0.4 * np.tanh(1.5 * smooth / smooth.std())


PLASTIC = {"roughness": 0.4}
SURFACES = {
    "matte": ("courtyard", {"base_color": [0.5, 0.3, 0.1], "roughness": 1.0, "specular": 0.0}),
    "plastic": ("city", {"base_color": [0.5, 0.3, 0.1], **PLASTIC}),
    "metal": ("courtyard", {"base_color": [0.9, 0.6, 0.3], "roughness": 0.4, "metallic": 1.0}),
    "rough metal": ("city", {"base_color": [0.9, 0.6, 0.3], "roughness": 0.9, "metallic": 1.0}),
    "coated": ("city", {"base_color": [0.4, 0.1, 0.1], "roughness": 0.6, "coat": 1.0, "coat_roughness": 0.3}),
    "coated metal": (
        "city",
        {"base_color": [0.4, 0.1, 0.1], "roughness": 0.5, "metallic": 1.0, "coat": 0.8, "coat_roughness": 0.4},
    ),
    "velvet": (
        "city",
        {"base_color": [0.1, 0.1, 0.3], "roughness": 1.0, "sheen": [0.9, 0.5, 0.2], "sheen_roughness": 0.3},
    ),
    "painted plastic": ("city", {"base_color": painted(), **PLASTIC}),
    "painted metal": ("city", {"base_color": painted(), "roughness": 0.5, "metallic": 1.0}),
}


@pytest.mark.parametrize("name", SURFACES)
def test_the_engine_and_cycles_show_the_same(name, small_light, tmp_path):
    light, surface = SURFACES[name]
    light = small_light(light)
    photo, job = photographed(light, surface, tmp_path)
    again = relit(job, light, tmp_path)
    inner = binary_erosion(again.sum(-1) > 0, np.ones((5, 5)))[..., None]
    # means over squares of four pixels: the path tracer's noise is 3 to 5 % of a pixel
    ours, theirs = (
        np.where(inner, image, np.nan).reshape(SIZE // 4, 4, SIZE // 4, 4, 3).mean((1, 3)) for image in (again, photo)
    )
    error = np.abs(ours / theirs - 1)
    error = error[np.isfinite(error)]
    assert len(error) > 200
    assert np.median(error) < 0.03 and np.quantile(error, 0.9) < 0.1
    assert np.nansum(ours) == pytest.approx(np.nansum(theirs), rel=0.007)
