# SPDX-License-Identifier: GPL-3.0-or-later
"""A knobbly ring with texture coordinates of its own, and textures of it as scans have them: paint times light.

The light at its places is path-traced by Mitsuba, rays from just above them: nothing of `pipeline.delighting` is in it.
"""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial import cKDTree

from btfsep_engine.job.model import TriangleMesh
from btfsep_engine.render.arrays import dr, mi, vector

AROUND, ACROSS = 96, 48  # corners of the mesh
BAKED = 64  # texels of a side of what is path-traced
PALE = 0.45  # what the ring reflects where it lights itself


def surface(u, v) -> np.ndarray:
    """(…, 3), where the ring is at texture coordinates: once around, once across, knobs on it."""
    turn, tilt = 2 * np.pi * np.asarray(u), 2 * np.pi * np.asarray(v)
    thick = 0.4 * (1 + 0.15 * np.sin(5 * turn) * np.sin(2 * tilt + 1))
    away = 0.75 + thick * np.cos(tilt)
    return np.stack([away * np.cos(turn), away * np.sin(turn), thick * np.sin(tilt)], -1)


def outward(u, v) -> np.ndarray:
    """(…, 3), the ring's unit normals."""
    step = 1e-4
    along, up = surface(u + step, v) - surface(u - step, v), surface(u, v + step) - surface(u, v - step)
    normal = np.cross(along, up)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def ring(*, inward=False) -> TriangleMesh:
    """The mesh, which has a seam along u = 0 and one along v = 0."""
    u, v = np.meshgrid(np.arange(AROUND + 1) / AROUND, np.arange(ACROSS + 1) / ACROSS, indexing="ij")
    at = np.arange(u.size).reshape(u.shape)
    a, b, c, d = (each.ravel() for each in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).astype(np.int32)
    faces = faces[:, ::-1] if inward else faces
    normals, uv = outward(u, v).reshape(-1, 3), np.stack([u, v], -1).reshape(-1, 2)
    return TriangleMesh(
        surface(u, v).reshape(-1, 3), faces, normals[faces].astype(np.float32), uv[faces].astype(np.float32)
    )


def texel_uv(side: int) -> tuple[np.ndarray, np.ndarray]:
    """(side, side) u and v of an image's texels, row 0 at the top."""
    row, column = np.mgrid[:side, :side] + 0.5
    return column / side, 1 - row / side


@cache
def irradiance(*, samples: int = 128, bounces: int = 3) -> np.ndarray:
    """(BAKED, BAKED, 3), under a sky brighter above, its mean 1: warm from above, a little more from +x."""
    mesh, (u, v) = ring(), texel_uv(BAKED)
    shape = mi.Mesh("ring", len(mesh.vertices), len(mesh.faces), props=_matte(), has_vertex_normals=False)
    params = mi.traverse(shape)
    params["vertex_positions"] = mi.Float(mesh.vertices.astype(np.float32).ravel())
    params["faces"] = mi.UInt32(mesh.faces.astype(np.uint32).ravel())
    params.update()
    # Mitsuba's skies have +Y up, and their first column lies at +Z: turned so that row 0 is +z
    polar, rows = np.linspace(0, np.pi, 33), np.ones((33, 64, 3), np.float32)
    rows *= (1.0 + np.cos(polar)[:, None, None] * [0.9, 0.8, 0.65]).astype(np.float32)
    upright = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
    sky = {"type": "envmap", "bitmap": mi.Bitmap(rows), "to_world": upright}
    scene = mi.load_dict({"type": "scene", "sky": sky, "ring": shape})
    integrator = mi.load_dict({"type": "path", "max_depth": bounces + 1, "rr_depth": 99})
    normal = outward(u, v).reshape(-1, 3)
    above = surface(u, v).reshape(-1, 3) + 0.02 * normal
    sampler, lanes = mi.load_dict({"type": "independent"}), BAKED * BAKED * samples
    sampler.seed(1, lanes)
    place = dr.arange(mi.UInt32, lanes) // samples
    origin, direction = (dr.gather(mi.Vector3f, vector(each), place) for each in (above, -normal))
    colour, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(mi.Point3f(origin), direction))
    sums = [dr.block_sum(channel, samples) for channel in (colour.x, colour.y, colour.z)]
    out = np.stack([np.array(s) for s in sums], -1).reshape(BAKED, BAKED, 3)
    return out / out.mean((0, 1))


def _matte():
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": PALE}})
    return properties


def paint(side: int = 128, *, pieces: int = 40, seed: int = 0) -> np.ndarray:
    """(side, side, 3) float32, in pieces of one colour each, which lie where they do in space."""
    random = np.random.default_rng(seed)
    places = surface(*random.uniform(size=(2, pieces)))
    colours = random.uniform(0.15, 0.55, (pieces, 3))
    return colours[cKDTree(places).query(surface(*texel_uv(side)))[1]].astype(np.float32)


def enlarged(values, side: int) -> np.ndarray:
    """(BAKED, BAKED, c) values as (side, side, c): between texels linear, on around both seams."""
    at = (np.arange(side) + 0.5) / side * BAKED - 0.5
    low = np.floor(at).astype(int)
    share = (at - low)[:, None, None]
    rows = (1 - share) * values[low % BAKED] + share * values[(low + 1) % BAKED]
    share = share.transpose(1, 0, 2)
    return (1 - share) * rows[:, low % BAKED] + share * rows[:, (low + 1) % BAKED]


def in_islands(image, *, islands: int = 6, gap: float = 0.1):
    """The ring with each of islands x islands parts of the image cut out and drawn in by ``gap``, black between them.

    Gives the mesh, the image (side, side, 3), and where it is laid, (side, side) bool.
    """
    mesh, side = ring(), len(image)
    uv = mesh.corner_uv.astype(np.float64) * islands
    cell = np.floor(uv.mean(1, keepdims=True))
    apart = (cell + 0.5 + (1 - gap) * (uv - cell - 0.5)) / islands
    at = np.stack(texel_uv(side), -1) * islands
    cell = np.floor(at)
    within = 0.5 + (at - cell - 0.5) / (1 - gap)
    laid = ((within >= 0) & (within <= 1)).all(-1)
    u, v = np.moveaxis((cell + np.clip(within, 0, 1)) / islands, -1, 0)
    row, column = (np.clip(each * side, 0, side - 1).astype(int) for each in (1 - v, u))
    cut = np.where(laid[..., None], image[row, column], 0).astype(np.float32)
    return replace(mesh, corner_uv=apart.astype(np.float32)), cut, laid


def obj_of(mesh: TriangleMesh) -> str:
    """The mesh as an OBJ file has it, with its normals and texture coordinates."""
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*place) for place in mesh.vertices]
    lines += ["vt {:.9g} {:.9g}".format(*place) for place in mesh.corner_uv.reshape(-1, 2)]
    lines += ["vn {:.9g} {:.9g} {:.9g}".format(*normal) for normal in mesh.corner_normals.reshape(-1, 3)]
    corner = np.arange(3 * len(mesh.faces)).reshape(-1, 3) + 1
    for vertices, corners in zip(mesh.faces + 1, corner, strict=True):
        lines.append("f " + " ".join(f"{a}/{b}/{b}" for a, b in zip(vertices, corners, strict=True)))
    return "\n".join(lines) + "\n"
