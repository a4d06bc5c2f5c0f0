# SPDX-License-Identifier: GPL-3.0-or-later
"""The objects drawn over the photo, as the camera should see them; nothing of the scene changes."""

import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from gpu_extras.batch import batch_for_shader
from mathutils import Vector

from ..photo import camera as pinhole
from ..run import request, runs
from ..scene import meshes

COLOUR = (1.0, 0.45, 0.05)
WIDTH = 2.0  # pixels of an outline
MOST = 400_000  # triangles: of more, drawing would hold the window up
CELLS = 1 << 20  # along the object: corners in one cell are at one place
NEARER = 0.998  # of the way from the camera: lines lie before the surface that they belong to

_shapes: dict = {}
_handle = None


def edges_of(triangles: dict) -> tuple[np.ndarray, np.ndarray]:
    """The edges of triangles (of `meshes`) and what lies on either side.

    Gives (e, 2, 3) float64 ends; (e, 2) int, the triangles beside each, twice the same at a border.
    """
    positions = triangles["positions"]
    # Places that are the same are one corner: files of other programs split vertices along the seams of their UVs.
    flat = positions.reshape(-1, 3)
    size = max(float(np.ptp(flat, 0).max(initial=0.0)), 1e-12)
    cell = ((flat - flat.min(0)) / size * CELLS).round().astype(np.int64)
    corner = np.unique((cell[:, 0] * (CELLS + 1) + cell[:, 1]) * (CELLS + 1) + cell[:, 2], return_inverse=True)[1]
    vertex = corner.reshape(-1, 3)
    ends = vertex[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    order = np.lexsort((ends.max(1), ends.min(1)))
    sides = np.sort(ends, 1)[order]
    first = np.r_[True, (sides[1:] != sides[:-1]).any(1)]
    start = np.flatnonzero(first)
    owner = np.repeat(np.arange(len(vertex)), 3)[order]
    last = np.r_[start[1:], len(order)] - 1
    beside = np.stack([owner[start], owner[np.minimum(start + 1, last)]], -1)
    points = positions[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2, 3)[order][start]
    return points, beside


def silhouette(points, beside, normals, centres, eye, *, parallel: bool) -> np.ndarray:
    """(k, 2, 3) of the edges (of :func:`edges_of`) between what faces the camera and what does not, and of borders.

    ``normals``, ``centres`` : (f, 3) of the triangles; ``eye`` : (3,) the camera, or with ``parallel`` the way to it
    """
    towards = np.broadcast_to(eye, centres.shape) if parallel else eye - centres
    front = (normals * towards).sum(-1) > 0
    border = beside[:, 0] == beside[:, 1]
    return points[border | (front[beside[:, 0]] != front[beside[:, 1]])]


def _shape(thing, depsgraph):
    """What is drawn of an object, in its own space; None where it has no faces, or too many. Kept until it changes."""
    key = thing.session_uid
    if key in _shapes:
        return _shapes[key]
    triangles = None
    try:
        if thing.instance_type == "COLLECTION":
            triangles = _instanced(thing, depsgraph)
        else:
            evaluated = thing.evaluated_get(depsgraph)
            triangles = meshes.triangles_of_mesh(evaluated.to_mesh(), np.eye(4))
            evaluated.to_mesh_clear()
    except RuntimeError:  # the view layer does not have it
        pass
    made = None
    if triangles is not None and len(triangles["positions"]) <= MOST:
        p = triangles["positions"]
        normals = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        made = {"edges": edges_of(triangles), "positions": p, "normals": normals, "centres": p.mean(1)}
    _shapes[key] = made
    return made


def _instanced(thing, depsgraph) -> dict | None:
    """The triangles of the collection that an object instances, in the object's own space."""
    part = meshes.gather(depsgraph, [thing]).get(thing.name_full)
    if part is None:
        return None
    own = np.array(thing.matrix_world.inverted_safe())
    return {"positions": part["positions"] @ own[:3, :3].T + own[:3, 3]}


@persistent
def _changed(scene, depsgraph):
    """Forgets what changed its shape."""
    for update in depsgraph.updates if _shapes else ():
        if not isinstance(update.id, bpy.types.Object):
            continue
        thing = update.id.original
        if update.is_updated_geometry:
            _shapes.pop(thing.session_uid, None)
        if thing.name not in scene.objects:  # an instance may show it
            for each in (each for each in scene.objects if each.instance_type == "COLLECTION"):
                _shapes.pop(each.session_uid, None)


def _draw():
    context = bpy.context
    mode = runs.run_state().overlay
    if mode == "OFF" or context.region_data is None or context.region_data.view_perspective != "CAMERA":
        return
    camera = context.space_data.camera or context.scene.camera
    if camera is None:
        return
    depsgraph = context.evaluated_depsgraph_get()
    parallel = camera.data.type == "ORTHO"
    gpu.state.blend_set("ALPHA")
    try:
        _draw_photo(context.scene, camera)
        gpu.state.depth_test_set("LESS_EQUAL")
        for entry in request.listed(context.scene.btfsep):
            shape = _shape(entry.object, depsgraph)
            if shape is None:
                continue
            seen = entry.object.matrix_world.inverted_safe() @ camera.matrix_world  # the camera in the object's space
            eye = np.array(seen)[:3, 2 if parallel else 3]
            points, colours, kind = _drawn(shape, eye, mode, parallel=parallel)
            shader = gpu.shader.from_builtin("FLAT_COLOR" if kind == "TRIS" else "POLYLINE_UNIFORM_COLOR")
            given = {"pos": points} if kind == "LINES" else {"pos": points, "color": colours}
            batch = batch_for_shader(shader, kind, {name: v.astype(np.float32) for name, v in given.items()})
            with gpu.matrix.push_pop():
                gpu.matrix.multiply_matrix(entry.object.matrix_world)
                if kind == "LINES":
                    shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
                    shader.uniform_float("lineWidth", WIDTH if mode == "OUTLINE" else 1.0)
                    shader.uniform_float("color", (*COLOUR, 1.0 if mode == "OUTLINE" else 0.6))
                batch.draw(shader)
    finally:
        gpu.state.blend_set("NONE")
        gpu.state.depth_test_set("NONE")


def _draw_photo(scene, camera) -> None:
    """Draws the photo before the scene's objects, so that lines and photo are seen together."""
    image = scene.btfsep.image
    part = pinhole.shown(scene, image.size) if image is not None and image.size[0] else None
    if part is None:
        return
    shader = gpu.shader.from_builtin(shader_of_photo(bpy.app.version))
    corners = [camera.matrix_world.normalized() @ Vector(corner) for corner in photo_corners(scene, camera, part)]
    where = {"pos": corners, "texCoord": ((0, 0), (1, 0), (1, 1), (0, 1))}
    batch = batch_for_shader(shader, "TRI_FAN", where)
    shader.uniform_sampler("image", gpu.texture.from_image(image))
    batch.draw(shader)


def shader_of_photo(version) -> str:
    """Blender's shader for an image, whose texture is linear: a 3D view takes it so up to Blender 4, then in sRGB."""
    return "IMAGE" if version < (5, 0, 0) else "IMAGE_SCENE_LINEAR_TO_REC709_SRGB"


def photo_corners(scene, camera, part) -> np.ndarray:
    """(4, 3), in the camera's space: the photo's corners, from below left counter-clockwise, well within the clipping.

    ``part`` : of `camera.shown`
    """
    data, (width, height) = camera.data, pinhole.render_size(scene)
    frame = np.array(data.view_frame(scene=scene))  # right above, right below, left below, left above
    left_below, across, up = frame[2], frame[1] - frame[2], frame[3] - frame[2]
    left, top, wide, tall = part
    u, v = np.array([left, left + wide]) / width, 1 - np.array([top + tall, top]) / height
    shares = np.array([[u[0], v[0]], [u[1], v[0]], [u[1], v[1]], [u[0], v[1]]])
    corners = left_below + shares @ np.stack([across, up])
    depth = np.sqrt(data.clip_start * data.clip_end)
    if data.type == "ORTHO":
        corners[:, 2] = -depth
        return corners
    return corners * (depth / -corners[0, 2])


def _drawn(shape: dict, eye, mode: str, *, parallel: bool):
    """Points (n, 3), colours (n, 4) or None, and TRIS or LINES; ``eye`` as of :func:`silhouette`, in the same space."""
    normals, centres = shape["normals"], shape["centres"]
    if mode == "SHADED":
        towards = np.broadcast_to(eye, centres.shape) if parallel else eye - centres
        length = np.linalg.norm(normals, axis=1) * np.linalg.norm(towards, axis=1)
        lit = np.abs((normals * towards).sum(1)) / np.maximum(length, 1e-12)
        rgba = np.concatenate([np.outer(0.25 + 0.75 * lit, COLOUR), np.full((len(normals), 1), 0.5)], 1)
        return _nearer(shape["positions"], eye, parallel=parallel), np.repeat(rgba, 3, 0), "TRIS"
    points, beside = shape["edges"]
    if mode == "OUTLINE":
        points = silhouette(points, beside, normals, centres, eye, parallel=parallel)
    return _nearer(points, eye, parallel=parallel), None, "LINES"


def _nearer(points, eye, *, parallel: bool) -> np.ndarray:
    """(n, 3) a little nearer to the camera."""
    flat = points.reshape(-1, 3)
    if parallel:
        return flat + (1 - NEARER) * np.abs(flat).max(initial=0.0) * eye / np.linalg.norm(eye)
    return eye + NEARER * (flat - eye)


def too_fine(scene) -> bool:
    """Whether an object of the list has so many faces that it is not drawn."""
    ids = {entry.object.session_uid for entry in request.listed(scene.btfsep)}
    return any(key in ids and shape is None for key, shape in _shapes.items())


def register():
    global _handle
    bpy.app.handlers.depsgraph_update_post.append(_changed)
    if not bpy.app.background:
        _handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")


def unregister():
    global _handle
    if _handle is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handle, "WINDOW")
        _handle = None
    bpy.app.handlers.depsgraph_update_post.remove(_changed)
    _shapes.clear()
