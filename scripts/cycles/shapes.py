# SPDX-License-Identifier: GPL-3.0-or-later
"""Takes plates of which the geometry is to be wrong: ``python -m scripts.cycles.shapes`` with {"plates", "folder"}.

Each plate of `scripts.studies.shapes` leaves, for each lens, a folder with a job whose mesh is what was photographed,
and beside them ``meshes.npz``, what Blender's own modifiers make of that mesh. What is there already stays.
"""

import json
import math
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix
from tqdm import tqdm

from blender_btfsep.scene import own_surface
from blender_btfsep.scene.export import export_job
from scripts.cycles import materials, objects, studio

RESOLUTION, SAMPLES = 224, 64  # pixels; a pixel
LENSES = {  # millimetres, part of the frame, pixels, shift of the frame
    "plain": (85, 0.7, RESOLUTION, 0.0),
    "tele": (600, 0.7, RESOLUTION, 0.0),
    "wide": (14, 0.7, RESOLUTION, 0.0),
    "cut": (85, 0.9, RESOLUTION, 0.4),
    "small": (85, 0.12, 500, 0.0),
}


def imported(path: str, turn: float) -> bpy.types.Object:
    """The mesh of an OBJ, welded, as large as the studio's own, turned by degrees about the vertical."""
    bpy.ops.wm.obj_import(filepath=path)
    thing = bpy.context.selected_objects[0]
    thing.data.transform(Matrix.Rotation(math.radians(turn), 4, "Z") @ thing.matrix_world)
    thing.matrix_world = Matrix.Identity(4)
    thing.data.materials.clear()
    objects.centred(thing.data)
    thing.data.shade_smooth()
    return thing


def modified(thing, kind: str, **how) -> bpy.types.Mesh:
    """What a modifier makes of an object's mesh."""
    modifier = thing.modifiers.new(kind, kind)
    for name, value in how.items():
        setattr(modifier, name, value)
    graph = bpy.context.evaluated_depsgraph_get()
    mesh = bpy.data.meshes.new_from_object(thing.evaluated_get(graph), depsgraph=graph)
    thing.modifiers.remove(modifier)
    return mesh


def arrays(mesh, *, flat: bool) -> list[np.ndarray]:
    """Vertices (v, 3), triangles (t, 3), and normals at their corners (t, 3, 3)."""
    (mesh.shade_flat if flat else mesh.shade_smooth)()
    vertex, corner = objects.triangles(mesh)
    normals = np.empty(3 * len(mesh.loops), np.float32)
    mesh.corner_normals.foreach_get("vector", normals)
    return [objects.vertex_positions(mesh), vertex, normals.reshape(-1, 3)[corner]]


def meshes(thing) -> dict:
    """Name -> arrays, of what modifiers make of an object."""
    out = {"true": arrays(thing.data, flat=False)}
    for share in (0.1, 0.02, 0.005):
        mesh = modified(thing, "DECIMATE", ratio=share)
        for flat in (False, True):
            out[f"{100 * share:g} % of the faces, {'flat' if flat else 'smooth'}"] = arrays(mesh, flat=flat)
    for share in (0.02, 0.05):
        mesh = modified(thing, "REMESH", mode="VOXEL", voxel_size=share * objects.LARGEST_SIDE)
        out[f"voxels of {100 * share:g} %"] = arrays(mesh, flat=False)
    return out


def take(plate, folder: Path) -> None:
    """One plate."""
    folder.mkdir(parents=True, exist_ok=True)
    scene = studio.clear()
    scene.world = studio.make_world(plate["light"], rotation_euler=(0, 0, math.radians(plate["turn"])))
    name = plate["object"]
    if name.endswith(".obj"):
        thing = imported(name, plate["facing"])
    else:
        thing = objects.build(name, seed=plate["seed"], view=studio.VIEW_FROM)
    thing.data.materials.append(materials.principled(plate["surface"]))
    if plate["sun"]:
        studio.add_sun(plate["sun"]["direction"], plate["sun"]["irradiance"], degrees=0.53)
    studio.denoise(scene)
    positions = objects.vertex_positions(thing.data)
    for lens, (length, fill, pixels, shift) in LENSES.items():
        studio.LENS_MM = length
        camera = studio.add_camera(scene, positions, resolution=pixels, fill=fill)
        camera.data.shift_x = shift
        where = folder / lens
        where.mkdir(exist_ok=True)
        studio.render_photo(scene, where / "photo.exr", SAMPLES)
        told = {"image_path": where / "photo.exr", "objects": [thing]}
        export_job(scene, where, **told, surfaces={thing.name: own_surface.BLENDER})
    made = {f"{name}|{i}": part for name, parts in meshes(thing).items() for i, part in enumerate(parts)}
    np.savez_compressed(folder / "meshes.npz", **made)


if __name__ == "__main__":
    given = json.load(sys.stdin)
    for plate in tqdm(given["plates"], desc="plates"):
        where = Path(given["folder"]) / plate["name"]
        if not (where / "meshes.npz").exists():
            with studio.quiet():
                take(plate, where)
