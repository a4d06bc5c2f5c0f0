# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes for the study of parametrisations, and Blender's unwrap of them.

Needs bpy, so in a process of its own: ``python -m scripts.studies.parametrisation.meshes``, told on standard input.
"""

import json
import sys
import time
from pathlib import Path

import bmesh
import bpy
import numpy as np

from blender_btfsep.scene.unwrap import angle_based
from scripts.cycles import objects, studio

TURNED = ("torus", "cylinder", "ball")  # their own coordinates follow their axis, which is the world's z
NAMES = ("suzanne", "vase", "knot", "cloth", *TURNED)


def make(folder) -> None:
    """Writes NAME.npz for each mesh.

    ``folder`` : that exists

    Each file has vertices (v, 3), metres; faces (f, 3); normals (f, 3, 3) of the corners; own (f, 3, 2), its own
    texture coordinates, of size 0 where it has none; unwrap (f, 3, 2), Blender's; seconds, that this took.
    """
    for name in NAMES:
        studio.clear()
        with studio.quiet():
            mesh, own = _turned(name) if name in TURNED else (_mesh(name), None)
            _write(Path(folder) / f"{name}.npz", mesh, own)


def _mesh(name):
    if name == "suzanne":

        def monkey(bm):
            bm.loops.layers.uv.new("UVMap")
            bmesh.ops.create_monkey(bm, calc_uvs=True)

        mesh = objects.subdivided(objects.filled(monkey), 2)
    else:
        mesh = objects.BUILDERS[name](np.random.default_rng(0))
    return objects.centred(mesh)


def _turned(name):
    """A surface of revolution about z with u along the parallels and v along the meridians, in metres at its widest."""
    around, along = 160, 80
    u = np.arange(around + 1) / around * 2 * np.pi
    if name == "torus":
        v = np.arange(along + 1) / along * 2 * np.pi
        radius, z, length = 0.052 + 0.023 * np.cos(v), 0.023 * np.sin(v), 0.023 * v
    elif name == "cylinder":
        v = np.linspace(0, 1, along + 1)
        radius, z, length = np.full_like(v, 0.05), 0.15 * (v - 0.5), 0.15 * v
    else:
        v = np.linspace(-0.5, 0.5, along + 1) * np.pi * 0.96  # without the poles, where no direction is the right one
        radius, z, length = 0.075 * np.cos(v), 0.075 * np.sin(v), 0.075 * v
    points = np.stack([radius * np.cos(u)[:, None], radius * np.sin(u)[:, None], z + 0 * u[:, None]], -1)
    wraps = name == "torus"
    rows = along if wraps else along + 1
    index = (np.arange(around + 1) % around)[:, None] * rows + np.arange(along + 1) % rows
    flat = np.stack([u[:, None] * radius.max() + 0 * length, length + 0 * u[:, None]], -1)
    quads = [(i, j) for i in range(around) for j in range(along)]
    corner = [[(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)] for i, j in quads]
    mesh = bpy.data.meshes.new(name)
    vertices = points[:around, :rows].reshape(-1, 3)
    mesh.from_pydata(vertices.tolist(), [], [[int(index[c]) for c in face] for face in corner])
    return mesh, np.array([[flat[c] for c in face] for face in corner]).reshape(-1, 2)


def _write(path, mesh, own) -> None:
    mesh.shade_smooth()
    mesh.update()
    vertex, corner = objects.triangles(mesh)
    normals = np.empty(3 * len(mesh.loops), np.float32)
    mesh.corner_normals.foreach_get("vector", normals)
    positions = objects.vertex_positions(mesh)
    if own is None and mesh.uv_layers:
        own = objects.corner_uv(mesh)
    started = time.perf_counter()
    unwrapped = angle_based(positions[vertex], vertex, path.stem)
    seconds = time.perf_counter() - started
    empty = np.zeros((0, 3, 2))
    np.savez(
        path,
        vertices=positions,
        faces=vertex,
        normals=normals.reshape(-1, 3)[corner],
        own=empty if own is None else own[corner],
        unwrap=unwrapped,
        seconds=seconds,
    )


if __name__ == "__main__":
    make(**json.load(sys.stdin))
