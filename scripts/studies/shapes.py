# SPDX-License-Identifier: GPL-3.0-or-later
"""Shapes of the study that no figure uses: rounder ones than those of :mod:`scripts.cycles.objects`, and mesh files."""

from pathlib import Path

import bmesh
import bpy
import numpy as np

from scripts.cycles import objects


def _ball() -> bpy.types.Mesh:
    """A quad ball of radius 1, its faces of even size."""
    mesh = bpy.data.meshes.new("ball")
    bm = bmesh.new()
    bmesh.ops.create_cube(bm, size=2.0)
    bmesh.ops.subdivide_edges(bm, edges=bm.edges, cuts=47, use_grid_fill=True)
    bm.to_mesh(mesh)
    bm.free()
    p = np.tan(objects.vertex_positions(mesh) * np.pi / 4)
    objects.move(mesh, p / np.linalg.norm(p, axis=1, keepdims=True))
    return mesh


def pebble(rng) -> bpy.types.Mesh:
    """An egg with shallow dents, lying aslant: smooth, nearly convex."""
    mesh = _ball()
    p = objects.vertex_positions(mesh)
    radius = np.ones(len(p))
    for _ in range(6):
        centre = rng.normal(size=3)
        centre /= np.linalg.norm(centre)
        radius -= 0.10 * np.exp(-8 * (1 - p @ centre))
    p = p * radius[:, None] * (1.0, 0.72, 0.62)
    p[:, 0] *= 1 + 0.18 * p[:, 2]
    a = np.radians(35)
    turn = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    objects.move(mesh, p @ turn.T)
    return mesh


def cushion(rng) -> bpy.types.Mesh:
    """A pillow that stands on an edge: a superellipsoid with four corners and some creases."""
    mesh = _ball()
    p = objects.vertex_positions(mesh)
    length = (np.abs(p[:, 0]) ** 3.5 + np.abs(p[:, 2]) ** 3.5) ** (1 / 3.5)
    flat = np.hypot(p[:, 0], p[:, 2])
    p[:, [0, 2]] *= (flat / np.maximum(length, 1e-9))[:, None]
    p[:, 1] *= 0.55 * (1 - 0.45 * np.clip(flat, 0, 1) ** 2)
    for _ in range(3):
        wave, phase = rng.normal(size=2), rng.uniform(0, 2 * np.pi)
        wave *= 4.5 / np.linalg.norm(wave)
        p[:, 1] += 0.03 * np.sin(p[:, [0, 2]] @ wave + phase)
    objects.move(mesh, p)
    return mesh


def from_file(path) -> bpy.types.Mesh:
    """A mesh of a PLY or OBJ file, Z up, its doubled vertices welded."""
    path, before = Path(path), set(bpy.data.objects)
    if path.suffix.lower() == ".ply":
        bpy.ops.wm.ply_import(filepath=str(path), forward_axis="Y", up_axis="Z")
    else:
        bpy.ops.wm.obj_import(filepath=str(path))
    new = [o for o in bpy.data.objects if o not in before]
    bm = bmesh.new()
    for o in new:
        if o.type == "MESH":
            part = o.data.copy()
            part.transform(o.matrix_world)
            bm.from_mesh(part)
        bpy.data.objects.remove(o)
    size = max(v.co.length for v in bm.verts)
    bmesh.ops.remove_doubles(bm, verts=bm.verts, dist=1e-6 * size)
    mesh = bpy.data.meshes.new(path.stem)
    bm.to_mesh(mesh)
    bm.free()
    while mesh.uv_layers:
        mesh.uv_layers.remove(mesh.uv_layers[0])
    mesh.materials.clear()
    return mesh


SHAPES = {"pebble": pebble, "cushion": cushion}


def build(name: str, *, seed: int, thickness: float, view) -> bpy.types.Object:
    """An object with a UV map in metres, its largest side 150 mm before it is made thinner along ``view``.

    Parameters
    ----------
    name : one of `SHAPES`, one of ``objects.NAMES``, or a mesh file
    thickness : factor on the extent along ``view : (3,)``, the direction towards the camera
    """
    if name in objects.NAMES:
        obj = objects.build(name, seed=seed, with_uv=False)
    else:
        mesh = SHAPES[name](np.random.default_rng(seed)) if name in SHAPES else from_file(name)
        p = objects.vertex_positions(mesh)
        low, high = p.min(0), p.max(0)
        objects.move(mesh, (p - (low + high) / 2) * (objects.LARGEST_SIDE / (high - low).max()))
        mesh.shade_smooth()
        obj = bpy.data.objects.new(Path(name).stem, mesh)
        bpy.context.scene.collection.objects.link(obj)
    view = np.asarray(view, np.float64) / np.linalg.norm(view)
    p = objects.vertex_positions(obj.data)
    objects.move(obj.data, p - (1 - thickness) * (p @ view)[:, None] * view)
    objects.unwrap(obj)
    return obj
