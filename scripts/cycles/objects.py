# SPDX-License-Identifier: GPL-3.0-or-later
"""The objects that are photographed, built by Blender itself: no outside data.

Each is a welded quad mesh, its largest side 150 mm (scene unit: metre), its bounding box centred at the origin,
smooth shaded, with a low-distortion UV map in **metres on the surface** (a later scale gives tiles).
"""

import bmesh
import bpy
import numpy as np
from scipy.interpolate import CubicHermiteSpline

LARGEST_SIDE = 0.15  # metres
ISLAND_ANGLE = np.radians(50.0)  # the most that a chart's faces lean from its projection: stretch below 1 / cos


def _mesh(name: str, vertices, quads) -> bpy.types.Mesh:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(np.asarray(vertices, float).tolist(), [], np.asarray(quads).tolist())
    mesh.validate()
    return mesh


def _grid_quads(rows: int, columns: int, *, wrap_rows: bool, wrap_columns: bool) -> np.ndarray:
    """Quads of a (rows, columns) vertex grid, counter-clockwise in (column, row)."""
    r = np.arange(rows if wrap_rows else rows - 1)[:, None]
    c = np.arange(columns if wrap_columns else columns - 1)[None, :]
    r1, c1 = (r + 1) % rows, (c + 1) % columns
    return np.stack(
        np.broadcast_arrays(r * columns + c, r * columns + c1, r1 * columns + c1, r1 * columns + c), -1
    ).reshape(-1, 4)


def subdivided(mesh: bpy.types.Mesh, levels: int) -> bpy.types.Mesh:
    """Catmull-Clark to the limit surface, so that every level lies on the same surface."""
    scratch = bpy.data.objects.new("subdivide", mesh)
    bpy.context.scene.collection.objects.link(scratch)
    modifier = scratch.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels = modifier.render_levels = levels
    modifier.use_limit_surface = True
    modifier.uv_smooth = "NONE"
    graph = bpy.context.evaluated_depsgraph_get()
    result = bpy.data.meshes.new_from_object(scratch.evaluated_get(graph), depsgraph=graph)
    bpy.data.objects.remove(scratch)
    return result


def filled(fill) -> bpy.types.Mesh:
    """A mesh of what ``fill(bm)`` puts into a bmesh."""
    mesh, bm = bpy.data.meshes.new("mesh"), bmesh.new()
    fill(bm)
    bm.to_mesh(mesh)
    bm.free()
    return mesh


def _ball(cuts: int):
    """A quad ball of radius 1, its faces of even size: mesh and its vertices (v, 3)."""

    def cube(bm):
        bmesh.ops.create_cube(bm, size=2.0)
        bmesh.ops.subdivide_edges(bm, edges=bm.edges, cuts=cuts, use_grid_fill=True)

    mesh = filled(cube)
    p = np.tan(vertex_positions(mesh) * np.pi / 4)  # evens out the faces
    return mesh, p / np.linalg.norm(p, axis=1, keepdims=True)


def _blob(rng) -> bpy.types.Mesh:
    """A ball swollen by a sum of smooth waves."""
    mesh, p = _ball(63)
    radius = np.ones(len(p))
    for frequency, height in ((2.0, 0.14), (3.6, 0.11), (6.0, 0.06)):
        for wave in rng.normal(size=(3, 3)):
            wave *= frequency / np.linalg.norm(wave)
            radius += height * np.sin(p @ wave + rng.uniform(0, 2 * np.pi))
    move(mesh, p * radius[:, None])
    return mesh


def _knot(_rng) -> bpy.types.Mesh:
    """A (2, 3) torus knot; the tube's frame is parallel-transported, its closing twist spread over the length."""
    rings, sides, tube = 420, 56, 0.36
    t = np.arange(rings) * 2 * np.pi / rings
    centre = np.stack(
        [(2 + np.cos(3 * t)) * np.cos(2 * t), (2 + np.cos(3 * t)) * np.sin(2 * t), 1.1 * np.sin(3 * t)], -1
    )
    tangent = np.roll(centre, -1, 0) - np.roll(centre, 1, 0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.empty_like(centre)
    n = np.cross(tangent[0], [0, 0, 1.0])
    for i in range(rings):
        n = n - tangent[i] * (n @ tangent[i])
        normal[i] = n = n / np.linalg.norm(n)
    closing = n - tangent[0] * (n @ tangent[0])
    twist = np.arctan2(np.cross(normal[0], closing) @ tangent[0], normal[0] @ closing)
    around = np.arange(sides) * 2 * np.pi / sides
    angle = around[None, :] - twist * np.arange(rings)[:, None] / rings
    binormal = np.cross(tangent, normal)
    ring = np.cos(angle)[..., None] * normal[:, None] + np.sin(angle)[..., None] * binormal[:, None]
    points = centre[:, None] + tube * ring
    mesh = _mesh("knot", points.reshape(-1, 3), _grid_quads(rings, sides, wrap_rows=True, wrap_columns=True))
    # tilted, so that the camera sees through the loops
    a = np.radians(35)
    turn = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    move(mesh, vertex_positions(mesh) @ turn.T)
    return mesh


def _catmull_rom(points, steps: int) -> np.ndarray:
    p = np.asarray(points, float)
    at = np.linspace(0, len(p) - 1, (len(p) - 1) * steps + 1)
    return CubicHermiteSpline(np.arange(len(p)), p, np.gradient(p, axis=0))(at)


def _disk(cells: int):
    """A square grid bent into the unit disk: radius (n,), azimuth (n,), quads facing +Z.

    No vertex has many neighbours (a fan's hub makes subdivision slow), and the rim is ``4 * cells`` vertices at equal
    angles from azimuth -45 degrees on.
    """
    line = np.linspace(-1, 1, cells + 1)
    x, y = (a.ravel() for a in np.meshgrid(line, line))
    radius = np.maximum(np.abs(x), np.abs(y))
    safe = np.maximum(radius, 1e-12)
    across = np.abs(x) >= np.abs(y)
    azimuth = np.where(across, np.pi / 4 * y / safe * np.sign(x), np.pi / 2 - np.pi / 4 * x / safe * np.sign(y))
    azimuth = azimuth + np.where(np.where(across, x, y) < 0, np.pi, 0)
    return radius, azimuth, _grid_quads(cells + 1, cells + 1, wrap_rows=False, wrap_columns=False)


def _vase(_rng) -> bpy.types.Mesh:
    """Turned on a lathe: an open cup with a thick wall, so that much of it lights and shades itself."""
    outside = [(0.34, 0), (0.5, 0.06), (0.72, 0.4), (0.86, 0.8), (0.78, 1.15), (0.56, 1.42), (0.60, 1.62), (0.78, 1.78)]
    inside = [(0.74, 1.83), (0.66, 1.78), (0.50, 1.62), (0.46, 1.42), (0.66, 1.13)]
    inside += [(0.74, 0.8), (0.6, 0.42), (0.34, 0.14)]
    r, z = _catmull_rom(outside + inside, 8).T
    around = 160
    angle = np.arange(around) * 2 * np.pi / around
    wall = np.stack([r[:, None] * np.cos(angle), r[:, None] * np.sin(angle), np.repeat(z[:, None], around, 1)], -1)
    quads = _grid_quads(len(r), around, wrap_rows=False, wrap_columns=True)
    radius, azimuth, disk = _disk(around // 4)
    flat = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.zeros_like(radius)], -1)
    foot, floor = flat * r[0] + [0, 0, z[0]], flat * r[-1] + [0, 0, z[-1]]
    points = np.vstack([wall.reshape(-1, 3), foot, floor])
    first = wall.size // 3
    mesh = _mesh("vase", points, np.vstack([quads, disk[:, ::-1] + first, disk + first + len(flat)]))

    def welded(bm):
        bm.from_mesh(mesh)
        bmesh.ops.remove_doubles(bm, verts=bm.verts, dist=1e-5)

    return filled(welded)


def _cloth(rng) -> bpy.types.Mesh:
    """A round cloth draped over a ball: the cap follows the ball, the rest hangs in folds that deepen to the hem."""
    ball = 0.62
    radius, phi, quads = _disk(160)
    s = 1.75 * radius  # arc length from the top
    leave = 0.5 * np.pi * ball * 0.82  # where the cloth leaves the ball
    theta, hang, end = np.minimum(s, leave) / ball, np.maximum(s - leave, 0), leave / ball
    depth = 0.17 * (1 - np.exp(-((hang / 0.42) ** 2)))
    phase = rng.uniform(0, 2 * np.pi, 3)
    fold = np.sin(7 * phi + phase[0] + 0.5 * np.sin(2 * phi + phase[1])) + 0.35 * np.sin(11 * phi + phase[2])
    out = ball * np.sin(theta) + hang * np.cos(end) * np.exp(-0.6 * hang) + depth * fold
    up = ball * np.cos(theta) - hang * np.sin(end) + 0.1 * depth * np.cos(3 * phi + phase[1])
    return _mesh("cloth", np.stack([out * np.cos(phi), out * np.sin(phi), up], -1), quads)


def _pebble(rng) -> bpy.types.Mesh:
    """An egg with shallow dents, lying aslant: smooth, nearly convex."""
    mesh, p = _ball(47)
    radius = np.ones(len(p))
    for _ in range(6):
        centre = rng.normal(size=3)
        centre /= np.linalg.norm(centre)
        radius -= 0.10 * np.exp(-8 * (1 - p @ centre))
    p = p * radius[:, None] * (1.0, 0.72, 0.62)
    p[:, 0] *= 1 + 0.18 * p[:, 2]
    a = np.radians(35)
    turn = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    move(mesh, p @ turn.T)
    return mesh


def _cushion(rng) -> bpy.types.Mesh:
    """A pillow that stands on an edge: a superellipsoid with four corners and some creases."""
    mesh, p = _ball(47)
    length = (np.abs(p[:, 0]) ** 3.5 + np.abs(p[:, 2]) ** 3.5) ** (1 / 3.5)
    flat = np.hypot(p[:, 0], p[:, 2])
    p[:, [0, 2]] *= (flat / np.maximum(length, 1e-9))[:, None]
    p[:, 1] *= 0.55 * (1 - 0.45 * np.clip(flat, 0, 1) ** 2)
    for _ in range(3):
        wave, phase = rng.normal(size=2), rng.uniform(0, 2 * np.pi)
        wave *= 4.5 / np.linalg.norm(wave)
        p[:, 1] += 0.03 * np.sin(p[:, [0, 2]] @ wave + phase)
    move(mesh, p)
    return mesh


BUILDERS = {  # the sphere is so fine that its facets do not show: for the tests of conventions
    "suzanne": lambda rng: subdivided(filled(bmesh.ops.create_monkey), 3),
    "blob": _blob, "knot": _knot, "vase": _vase, "cloth": _cloth, "pebble": _pebble, "cushion": _cushion,
    "sphere": lambda rng: filled(lambda bm: bmesh.ops.create_icosphere(bm, subdivisions=6, radius=1.0)),
}  # fmt: skip
NAMES = tuple(BUILDERS)


def vertex_positions(mesh) -> np.ndarray:
    """(v, 3) float64, object space."""
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3).astype(np.float64)


def move(mesh, positions) -> None:
    mesh.vertices.foreach_set("co", np.ascontiguousarray(positions, np.float32).ravel())
    mesh.update()


def triangles(mesh):
    """(t, 3) int32 vertex indices and (t, 3) int32 corner indices of the triangulated mesh."""
    mesh.calc_loop_triangles()
    vertex, corner = (np.empty(3 * len(mesh.loop_triangles), np.int32) for _ in range(2))
    mesh.loop_triangles.foreach_get("vertices", vertex)
    mesh.loop_triangles.foreach_get("loops", corner)
    return vertex.reshape(-1, 3), corner.reshape(-1, 3)


def corner_uv(mesh) -> np.ndarray:
    """(corners, 2) float64, the active UV map."""
    flat = np.empty(2 * len(mesh.loops), np.float32)
    mesh.uv_layers.active.uv.foreach_get("vector", flat)
    return flat.reshape(-1, 2).astype(np.float64)


def set_corner_uv(mesh, uv) -> None:
    """Writes (corners, 2) into the active UV map."""
    mesh.uv_layers.active.uv.foreach_set("vector", np.ascontiguousarray(uv, np.float32).ravel())


def unwrap(obj) -> None:
    """Gives ``obj`` a UV map in metres on its surface: charts of like-facing faces, unwrapped, scaled by area."""
    mesh = obj.data
    mesh.uv_layers.new(name="UVMap")
    bpy.context.view_layer.objects.active = obj
    obj.select_set(True)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(angle_limit=ISLAND_ANGLE, island_margin=0.0, scale_to_bounds=False)
    bpy.ops.uv.select_all(action="SELECT")
    bpy.ops.uv.seams_from_islands()
    bpy.ops.uv.unwrap(method="ANGLE_BASED", margin=0.0, fill_holes=False)
    bpy.ops.uv.select_all(action="SELECT")
    bpy.ops.uv.average_islands_scale()
    bpy.ops.object.mode_set(mode="OBJECT")
    vertex, corner = triangles(mesh)
    uv = corner_uv(mesh)
    flat = np.pad(uv, ((0, 0), (0, 1)))
    set_corner_uv(mesh, uv * np.sqrt(area(vertex_positions(mesh)[vertex]) / area(flat[corner])))


def area(corners) -> float:
    """Of triangles (t, 3, 3)."""
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()


def build(name, *, seed: int = 0, thickness: float = 1.0, view=(0.0, -1.0, 0.0)) -> bpy.types.Object:
    """The object ``name`` (one of :data:`NAMES`), linked to the current scene.

    Parameters
    ----------
    thickness : factor on the extent along ``view : (3,)``, the direction towards the camera

    Returns
    -------
    bpy.types.Object with an identity transform, smooth shaded; its UV map in metres
    """
    mesh = centred(BUILDERS[name](np.random.default_rng(seed)))
    mesh.name = name
    mesh.shade_smooth()
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    if thickness != 1:
        view, p = np.asarray(view) / np.linalg.norm(view), vertex_positions(mesh)
        move(mesh, p - (1 - thickness) * (p @ view)[:, None] * view)
    unwrap(obj)
    return obj


def centred(mesh) -> bpy.types.Mesh:
    """The mesh with its bounding box about the origin, its largest side :data:`LARGEST_SIDE`."""
    p = vertex_positions(mesh)
    low, high = p.min(0), p.max(0)
    move(mesh, (p - (low + high) / 2) * (LARGEST_SIDE / (high - low).max()))
    return mesh
