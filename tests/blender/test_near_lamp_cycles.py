# SPDX-License-Identifier: GPL-3.0-or-later
"""A lamp nearby, the whole circle: Blender's own Point lamp, photographed by Cycles, comes back at its place."""

import bpy
import numpy as np

from blender_btfsep.light import lighting_file, sun_lamp, world
from blender_btfsep.scene.export import export_job
from scripts.cycles import engine, studio

DIRECTION, RADII = np.array([-0.70, -0.55, 0.45]), 3.0


def test_a_point_lamp_comes_back_at_its_place_and_as_strong(tmp_path, small_light):
    scene, _, base, _ = studio.make_scene("knot", "white", small_light("forest"), resolution=160)
    corners = np.array([base.matrix_world @ v.co for v in base.data.vertices])
    low, high = corners.min(0), corners.max(0)
    centre, radius = (low + high) / 2, np.linalg.norm(high - low) / 2
    place = centre + RADII * radius * DIRECTION / np.linalg.norm(DIRECTION)
    mine = bpy.data.objects.new("Mine", bpy.data.lights.new("Mine", "POINT"))
    mine.data.energy, mine.data.shadow_soft_size = sun_lamp.power(6.0, {"distance": RADII * radius}), 0.05 * radius
    mine.location = place
    scene.collection.objects.link(mine)
    studio.render_photo(scene, tmp_path / "photo.exr", 64)
    export_job(scene, tmp_path / "job", image_path=tmp_path / "photo.exr", objects=[base], occluders=[])
    result = engine.run("estimate", tmp_path / "job", "--material", "reference/white-diffuse", "--no-report")
    found = lighting_file.read(result["lighting"])
    world.apply_lighting(scene, found)
    lamp = max(sun_lamp.lamps(scene), key=lambda lamp: lamp.data.energy)
    assert lamp.data.type == "POINT"
    off = np.array(lamp.location) - place
    assert np.linalg.norm(off) < 0.2 * RADII * radius, off
    assert abs(lamp.data.energy / mine.data.energy - 1) < 0.4
    near = max(found["suns"]["lamps"], key=lambda lamp: max(lamp["irradiance"]))["near"]
    np.testing.assert_allclose(near["centre"], centre, atol=1e-3 * radius)
