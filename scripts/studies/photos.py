# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the study's photographs with Cycles, and beside them the jobs that say what is known. Needs bpy."""

import json
import math
import os
import time
from itertools import groupby
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from blender_btfsep.export import export_job
from scripts.cycles import materials, objects, studio
from scripts.cycles.demo import quiet
from scripts.studies import scenes, shapes

FAR = 2000.0  # distance of a sun, radii
NOISE = 0.02  # of a pixel, where Cycles stops


def make(work, wanted, *, resolution: int, samples: int, threads: int) -> None:
    """Renders the photographs that are not there yet.

    Parameters
    ----------
    work : folder; `scenes.geometry_folder` says where in it
    wanted : list of scenes.Photo
    """
    work = Path(work)
    for light in sorted({p.light for p in wanted if p.light}):
        _write_truth(work, light)
    missing = [p for p in wanted if not p.path(work).exists()]
    done, started = 0, time.perf_counter()
    key = lambda p: (p.scene.name, p.geometry)  # noqa: E731
    for _, group in groupby(sorted(missing, key=key), key=key):
        group = list(group)
        with quiet():
            studio_of = _Studio(group[0].scene, group[0].geometry, resolution, threads)
            studio_of.export(work)
        for photo in group:
            with quiet():
                studio_of.photograph(photo, photo.path(work), samples)
            done += 1
            print(
                f"[photo {done}/{len(missing)}, {time.perf_counter() - started:.0f} s] {photo.scene.name}, "
                f"{photo.geometry}, {photo.name}",
                flush=True,
            )


def truth_path(work, light) -> Path:
    """Where the coefficients of a light are kept."""
    return Path(work) / "lights" / f"{scenes.light_name(light)}.json"


def _write_truth(work, light) -> None:
    path = truth_path(work, light)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        path.write_text(json.dumps(studio.true_lighting(light, scenes.ORDER).tolist()))


class _Studio:
    """One object before one camera."""

    def __init__(self, scene, geometry: str, resolution: int, threads: int):
        thickness = 1.0 if geometry in (scenes.AS_IS, scenes.LIBRARY_TEXELS) else float(geometry)
        self.what, self.geometry = scene, geometry
        self.scene = studio.clear()
        self.base = shapes.build(scene.shape, seed=scene.seed, thickness=thickness, view=studio.VIEW_FROM)
        if scene.material == "white":
            photo = bpy.data.objects.new(f"{self.base.name} in white", self.base.data.copy())
            photo.data.materials.append(materials.white())
            self.scene.collection.objects.link(photo)
        else:
            variation = 0 if geometry == scenes.LIBRARY_TEXELS else 1
            maps = materials.load_maps(scene.material, variation=variation)
            materials.displaced(self.base, scene.material, maps)
            objects.set_corner_uv(self.base.data, objects.corner_uv(self.base.data) * (1e3 / maps.size_mm))
        self.base.hide_render = True
        positions = objects.vertex_positions(self.base.data)
        self.radius = 0.5 * float(np.linalg.norm(positions.max(0) - positions.min(0)))
        data = bpy.data.cameras.new("camera")
        data.lens, data.sensor_width, data.clip_start = studio.LENS_MM, studio.SENSOR_MM, 0.01
        camera = bpy.data.objects.new("camera", data)
        self.scene.collection.objects.link(camera)
        self.scene.camera = camera
        render = self.scene.render
        render.resolution_x = render.resolution_y = resolution
        render.threads_mode, render.threads = "FIXED", threads
        self.scene.cycles.adaptive_threshold = NOISE
        render.use_persistent_data = True  # the displaced mesh is the same in all photographs
        studio.aim(camera, positions)
        bpy.context.view_layer.update()

    def export(self, work) -> None:
        folder = scenes.geometry_folder(work, self.what, self.geometry)
        if (folder / "job.json").exists():
            return
        folder.mkdir(parents=True, exist_ok=True)
        blank = folder / "blank.exr"
        image = bpy.data.images.new("blank", *(self.scene.render.resolution_x,) * 2, float_buffer=True)
        image.file_format, image.filepath_raw = "OPEN_EXR", str(blank)
        image.save()
        export_job(self.scene, folder, image_path=blank, objects=[self.base], occluders=[])
        blank.unlink()

    def photograph(self, photo, path: Path, samples: int) -> None:
        world = studio.make_world(photo.light) if photo.light else _dark()
        added = []
        if photo.lamp:
            distance, direction = photo.lamp
            radius = scenes.LAMP_RADIUS if distance else FAR * math.sin(math.radians(scenes.SUN_RADIUS_DEGREES))
            added.append(self._ball(scenes.unit(direction), distance or FAR, radius, scenes.lamp_radiance(photo.lamp)))
        if photo.wall:
            added.append(self._wall(photo.wall))
        partial = path.with_name(f"partial-{os.getpid()}.exr")
        self.scene.world = world
        studio.render_photo(self.scene, partial, samples)
        os.replace(partial, path)
        for obj in added:
            bpy.data.objects.remove(obj)

    def _ball(self, direction, distance: float, radius: float, radiance: float):
        """A ball that shines, unseen by the camera."""
        bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=1.0)
        ball = bpy.context.object
        ball.location = Vector(direction * distance * self.radius)
        ball.scale = (radius * self.radius,) * 3
        material = bpy.data.materials.new("lamp")
        tree = materials.node_tree(material)
        shine, out = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
        shine.inputs["Strength"].default_value = radiance
        tree.links.new(shine.outputs[0], out.inputs["Surface"])
        ball.data.materials.append(material)
        ball.visible_camera = False
        return ball

    def _wall(self, distance: float):
        direction = scenes.unit(scenes.WALL_FROM)
        bpy.ops.mesh.primitive_plane_add(size=scenes.WALL_EDGE * self.radius)
        wall = bpy.context.object
        wall.location = Vector(direction * distance * self.radius)
        wall.rotation_euler = Vector(-direction).to_track_quat("Z", "Y").to_euler()
        material = materials.white()
        material.node_tree.nodes["Diffuse BSDF"].inputs["Color"].default_value = (*scenes.WALL_COLOUR, 1)
        wall.data.materials.append(material)
        wall.visible_camera = False
        return wall


def _dark():
    world = bpy.data.worlds.new("dark")
    tree = materials.node_tree(world)
    background, out = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeOutputWorld")
    background.inputs["Color"].default_value = (0, 0, 0, 1)
    tree.links.new(background.outputs[0], out.inputs["Surface"])
    return world
