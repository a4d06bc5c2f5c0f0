# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects of few flat faces with hard edges, as packaging, furniture and houses are: few directions, and flat shading.

Their largest side is `scripts.cycles.objects.LARGEST_SIDE`, their bounding box about the origin.
"""

import bmesh
import bpy
import numpy as np
from mathutils import Matrix

from scripts.cycles import objects

HARD = np.radians(5)  # an edge between faces that lean so far apart is one that shows
LEGS, LEG = ((-1, -1), (1, -1), (1, 1), (-1, 1)), 0.12  # of a stool: corners; a leg's width over the seat's


def _block(bm, size, middle=(0, 0, 0)) -> None:
    bmesh.ops.create_cube(bm, size=1, matrix=Matrix.Translation(middle) @ Matrix.Diagonal((*size, 1)))


def _carton(bm, rng) -> None:
    """A box of any proportions from a book's to a tower's."""
    _block(bm, rng.uniform((0.5, 0.2, 0.4), (1, 0.9, 1.5)))


def _tin(bm, rng) -> None:
    """A cylinder with a flat lid."""
    radius, height = rng.uniform(0.3, 0.6), rng.uniform(0.4, 1.4)
    bmesh.ops.create_cone(bm, cap_ends=True, segments=96, radius1=radius, radius2=radius, depth=height)


def _house(bm, rng) -> None:
    """Walls and a gable roof that stands out."""
    wide, deep, high, ridge = rng.uniform((0.7, 0.8, 0.5, 0.3), (1, 1.3, 0.8, 0.7))
    _block(bm, (wide, deep, high))
    out, thick = 1.15, 0.06
    for side in (-1, 1):
        slope = np.arctan2(ridge, 0.5 * wide)
        length = out * np.hypot(ridge, 0.5 * wide)
        lies = Matrix.Translation((side * 0.25 * wide * out, 0, 0.5 * high + ridge * (1 - 0.5 * out)))
        turn = Matrix.Rotation(side * slope, 4, "Y")
        bmesh.ops.create_cube(bm, size=1, matrix=lies @ turn @ Matrix.Diagonal((length, out * deep, thick, 1)))


def _stool(bm, rng) -> None:
    """A slab on four legs."""
    high, thick = rng.uniform(0.5, 1.0), rng.uniform(0.05, 0.2)
    _block(bm, (1, 1, thick), (0, 0, 0.5 * (high + thick)))
    for x, y in LEGS:
        _block(bm, (LEG, LEG, high), (0.5 * x * (1 - LEG), 0.5 * y * (1 - LEG), 0))


def _gem(bm, rng) -> None:
    """An irregular polyhedron: the hull of points on a ball."""
    for place in rng.normal(size=(24, 3)):
        bm.verts.new(place / np.linalg.norm(place))
    hull = bmesh.ops.convex_hull(bm, input=bm.verts)
    bmesh.ops.delete(bm, geom=list({*hull["geom_interior"], *hull["geom_unused"]}), context="VERTS")


BUILDERS = {"carton": _carton, "tin": _tin, "house": _house, "stool": _stool, "gem": _gem}
NAMES = tuple(BUILDERS)


def build(name: str, *, seed: int) -> bpy.types.Object:
    """The object ``name`` (one of :data:`NAMES`), turned about the vertical by chance, linked to the current scene."""
    rng = np.random.default_rng(seed)

    def fill(bm):
        BUILDERS[name](bm, rng)
        bmesh.ops.rotate(bm, verts=bm.verts, matrix=Matrix.Rotation(rng.uniform(0, 2 * np.pi), 3, "Z"))
        bm.normal_update()
        for face in bm.faces:
            face.smooth = True
        for edge in bm.edges:
            edge.smooth = bool(edge.calc_face_angle(np.pi) < HARD)

    obj = bpy.data.objects.new(name, objects.centred(objects.filled(fill)))
    obj.data.name = name
    bpy.context.scene.collection.objects.link(obj)
    objects.unwrap(obj)
    return obj
