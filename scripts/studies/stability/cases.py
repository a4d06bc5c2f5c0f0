# SPDX-License-Identifier: GPL-3.0-or-later
"""One case of the study: a photograph and what an estimator is told about it, to be disturbed and written as a job."""

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import trimesh

from btfsep_engine.imaging import images
from btfsep_engine.job.model import TriangleMesh
from scripts.cycles.lights import true_lighting
from scripts.studies.estimates import scene_of
from scripts.studies.stability import scenes


@dataclass
class Case:
    """What is disturbed.

    Attributes
    ----------
    image : (h, w, 3) float64, linear
    clean : (h, w, 3), the photograph as it was rendered, at the geometry's own resolution
    camera : the job's, as a dict
    vertices : (v, 3) float64, world, welded; faces : (f, 3) int; corner_uv : (f, 3, 2)
    region : (h, w) bool, pixels of the clean photograph that show the object
    truth : (terms, 3) the light
    material : name that the estimator is given
    geometry : which of the scene's geometries was photographed
    blend : None, or (name, share): the material is mixed with another
    coded : written as an 8-bit file, clipped at 1
    """

    image: np.ndarray
    clean: np.ndarray
    camera: dict
    vertices: np.ndarray
    faces: np.ndarray
    corner_uv: np.ndarray
    region: np.ndarray
    truth: np.ndarray
    material: str
    geometry: str
    blend: tuple | None = None
    coded: bool = False

    @property
    def level(self) -> float:
        """The photograph's mean over the object."""
        return float(self.image[self.region].mean())


def undisturbed(work, scene, light, *, geometry=scenes.AS_IS) -> Case:
    """The case of a photograph as it is."""
    folder = scenes.geometry_folder(work, scene, geometry)
    image = photograph(work, scene, geometry, f"light-{scenes.light_name(light)}")
    camera = json.loads((folder / "job.json").read_text())["camera"]
    truth = true_lighting(light, scenes.ORDER)
    return Case(image, image, camera, *_geometry(str(folder)), truth, scene.given, geometry)


def photograph(work, scene, geometry, name) -> np.ndarray:
    """(h, w, 3) float64 of one of the study's photographs."""
    path = scenes.geometry_folder(work, scene, geometry) / f"{name}.exr"
    return images.read_linear(path).pixels.astype(np.float64)


@lru_cache(maxsize=64)
def _geometry(folder: str):
    scene = scene_of(folder)
    mesh = scene.job.objects[0].mesh
    return *welded(mesh), mesh.corner_uv, scene.regions[0]


def welded(mesh: TriangleMesh):
    """Vertices (v, 3) that are all different, and faces (f, 3)."""
    _, first, inverse = np.unique(mesh.vertices.round(9), axis=0, return_index=True, return_inverse=True)
    return mesh.vertices[first], inverse.reshape(-1)[mesh.faces]


def shape(vertices, faces) -> trimesh.Trimesh:
    """The mesh with its normals, edges and neighbours."""
    return trimesh.Trimesh(vertices, faces, process=False)


def write_job(case: Case, folder) -> None:
    """Writes the case as a job folder (``docs/formats.md``)."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    name = "photo.png" if case.coded else "photo.exr"
    if case.coded:
        images.write_png(folder / name, np.clip(case.image, 0, 1))
    else:
        images.write_exr(folder / name, case.image.astype(np.float32))
    _write_ply(folder / "object.ply", case)
    job = {"format": "btfsep-job", "version": 1, "image": name, "metres_per_unit": 1.0, "camera": case.camera}
    job["objects"] = [{"name": "object", "mesh": "object.ply", "uv": "mesh"}]
    (folder / "job.json").write_text(json.dumps(job))


def _write_ply(path, case: Case) -> None:
    """A PLY whose corners stand alone, each with its normal and texture coordinates."""
    corners = case.faces.ravel()
    normals = shape(case.vertices, case.faces).vertex_normals[corners]
    alone = np.arange(len(corners)).reshape(-1, 3)
    mesh = trimesh.Trimesh(case.vertices[corners], alone, vertex_normals=normals, process=False)
    uv = case.corner_uv.reshape(-1, 2).astype(np.float32)
    mesh.vertex_attributes = {"s": uv[:, 0], "t": uv[:, 1]}
    mesh.export(path, vertex_normal=True)
