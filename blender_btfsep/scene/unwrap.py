# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture coordinates by Blender's angle-based unwrap, seams where its smart projection cuts; on a copy."""

import bpy
import numpy as np

from ..basics.errors import InputError
from ..basics.scratch import scratch

ANGLE = np.radians(66)  # between the normals of a chart, for the seams: Blender's own default


def angle_based(positions, vertex, name: str) -> np.ndarray:
    """Unwraps triangles in a scene of their own, which is gone afterwards; the user's scene, mode and mesh stay.

    Parameters
    ----------
    positions : (f, 3, 3) float, world
    vertex : (f, 3) int, the corners' vertices
    name : of the object, for errors

    Returns
    -------
    (f, 3, 2) float32, all charts at one scale

    Raises InputError when Blender cannot unwrap it.
    """
    faces = len(vertex)
    _, first, index = np.unique(vertex, return_index=True, return_inverse=True)
    with scratch() as own:
        mesh = own(bpy.data.meshes.new("btfsep unwrap"))
        stage = own(bpy.data.scenes.new("btfsep unwrap"))
        thing = own(bpy.data.objects.new("btfsep unwrap", mesh))
        try:
            points = np.asarray(positions, np.float64).reshape(-1, 3)[first]
            points -= points.mean(0)  # float32 from here on
            mesh.vertices.add(len(points))
            mesh.vertices.foreach_set("co", points.astype(np.float32).ravel())
            mesh.loops.add(3 * faces)
            mesh.loops.foreach_set("vertex_index", index.reshape(-1).astype(np.int32))
            mesh.polygons.add(faces)
            mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * faces, 3, dtype=np.int32))
            mesh.update(calc_edges=True)
            mesh.uv_layers.new(name="UVMap")
            stage.collection.objects.link(thing)
            layer = stage.view_layers[0]
            layer.objects.active = thing
            thing.select_set(True, view_layer=layer)
            layer.update()
            with _editing(stage, thing):
                bpy.ops.uv.smart_project(angle_limit=ANGLE, island_margin=0.0)
            mesh.edges.foreach_set("use_seam", _seams(mesh, _corner_uv(mesh)))
            with _editing(stage, thing):
                bpy.ops.uv.unwrap(method="ANGLE_BASED", margin=0.0)
                bpy.ops.uv.average_islands_scale()
            uv = _corner_uv(mesh)
        except RuntimeError as error:
            raise InputError(
                f"object '{name}'", f"Blender cannot unwrap it ({error})", "take the mapping 'Charts'"
            ) from error
    if len(uv) != faces or not np.isfinite(uv).all():
        raise InputError(f"object '{name}'", "Blender's unwrap failed on it", "take the mapping 'Charts'")
    return uv


class _editing:
    """Edit mode on the copy, everything selected; back to object mode, which writes the mesh, at the end."""

    def __init__(self, stage, thing):
        where = {"scene": stage, "view_layer": stage.view_layers[0], "active_object": thing, "object": thing}
        self.override = bpy.context.temp_override(**where, selected_objects=[thing], edit_object=thing)

    def __enter__(self):
        self.override.__enter__()
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.mesh.select_all(action="SELECT")

    def __exit__(self, *error):
        bpy.ops.object.mode_set(mode="OBJECT")
        self.override.__exit__(*error)


def _corner_uv(mesh) -> np.ndarray:
    flat = np.empty(2 * len(mesh.loops), np.float32)
    mesh.uv_layers[0].uv.foreach_get("vector", flat)
    return flat.reshape(-1, 3, 2)


def _seams(mesh, uv) -> np.ndarray:
    """(e,) bool: edges at whose ends the faces beside them disagree in their texture coordinates."""
    edge = np.empty(len(mesh.loops), np.int32)
    vertex = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("edge_index", edge)
    mesh.loops.foreach_get("vertex_index", vertex)
    start, end = uv.reshape(-1, 2), np.roll(uv, -1, 1).reshape(-1, 2)
    along = (vertex < np.roll(vertex.reshape(-1, 3), -1, 1).ravel())[:, None]
    ends = np.where(along, np.hstack([start, end]), np.hstack([end, start]))
    low, high = np.full((len(mesh.edges), 4), np.inf), np.full((len(mesh.edges), 4), -np.inf)
    np.minimum.at(low, edge, ends)
    np.maximum.at(high, edge, ends)
    return (high - low > 1e-6).any(1)
