# SPDX-License-Identifier: GPL-3.0-or-later
"""One case of the study: a photograph and what an estimator is told about it, to be disturbed and written as a job."""

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix

from btfsep_engine import images
from btfsep_engine.job.load import load_job
from btfsep_engine.job.model import TriangleMesh
from scripts.studies import scenes


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
    blend : None, or (name, share): the material is mixed with another
    coded : written as an 8-bit file, clipped at 1
    geometry : which of the scene's geometries was photographed
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
    def radius(self) -> float:
        """Half the diagonal of the bounding box."""
        return 0.5 * float(np.linalg.norm(self.vertices.max(0) - self.vertices.min(0)))

    @property
    def level(self) -> float:
        """The photograph's mean over the object."""
        return float(self.image[self.region].mean())


def undisturbed(work, scene, light, *, geometry=scenes.AS_IS) -> Case:
    """The case of a photograph as it is."""
    folder = scenes.geometry_folder(work, scene, geometry)
    vertices, faces, corner_uv, region = _geometry(str(folder))
    image = photograph(work, scene, geometry, f"light-{scenes.light_name(light)}")
    camera = json.loads((folder / "job.json").read_text())["camera"]
    return Case(
        image,
        image,
        camera,
        vertices,
        faces,
        corner_uv,
        region,
        true_light(work, light),
        scene.given,
        geometry,
    )


def photograph(work, scene, geometry, name) -> np.ndarray:
    """(h, w, 3) float64 of one of the study's photographs."""
    path = scenes.geometry_folder(work, scene, geometry) / f"{name}.exr"
    return images.read_linear(path).pixels.astype(np.float64)


def true_light(work, light) -> np.ndarray:
    """(terms, 3) of one of the study's lights."""
    path = Path(work) / "lights" / f"{scenes.light_name(light)}.json"
    return np.array(json.loads(path.read_text()), np.float64)


@lru_cache(maxsize=64)
def _geometry(folder: str):
    from btfsep_engine.pipeline.scene import PreparedScene
    from btfsep_engine.progress import Reporter

    job = load_job(folder)
    mesh = job.objects[0].mesh
    vertices, faces = welded(mesh)
    return vertices, faces, mesh.corner_uv, PreparedScene(job, Reporter()).regions[0]


def welded(mesh: TriangleMesh):
    """Vertices (v, 3) that are all different, and faces (f, 3)."""
    _, first, inverse = np.unique(mesh.vertices.round(9), axis=0, return_index=True, return_inverse=True)
    return mesh.vertices[first], inverse.reshape(-1)[mesh.faces]


def vertex_normals(vertices, faces) -> np.ndarray:
    """(v, 3) unit, the faces' weighted by area."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    flat = np.cross(b - a, c - a)
    total = np.zeros_like(vertices)
    for i in range(3):
        np.add.at(total, faces[:, i], flat)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)


def umbrella(faces, count: int):
    """Sparse (v, v): the mean over each vertex's neighbours."""
    i = np.concatenate([faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()])
    j = np.concatenate([faces[:, [1, 2, 0]].ravel(), faces[:, [0, 1, 2]].ravel()])
    matrix = coo_matrix((np.ones(len(i)), (i, j)), (count, count)).tocsr()
    matrix.data[:] = 1.0
    degree = np.asarray(matrix.sum(1)).ravel()
    matrix.data /= np.repeat(np.maximum(degree, 1), np.diff(matrix.indptr))
    return matrix


def edge_length(vertices, faces) -> float:
    """The mean length of an edge."""
    return float(np.linalg.norm(vertices[faces[:, 1]] - vertices[faces[:, 0]], axis=1).mean())


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
    thing = {"name": "object", "mesh": "object.ply", "to_world": None, "mask": None, "material": None, "uv": "mesh"}
    job = {
        "format": "btfsep-job",
        "version": 1,
        "image": name,
        "image_colorspace": "auto",
        "exposure_ev": 0.0,
        "camera": case.camera,
        "objects": [thing],
        "occluders": [],
        "depth": None,
        "metres_per_unit": 1.0,
    }
    (folder / "job.json").write_text(json.dumps(job))


def _write_ply(path, case: Case) -> None:
    """A binary PLY whose corners stand alone, each with its normal and texture coordinates."""
    corners = case.faces.ravel()
    table = np.concatenate(
        [
            case.vertices[corners],
            vertex_normals(case.vertices, case.faces)[corners],
            case.corner_uv.reshape(-1, 2),
        ],
        axis=1,
    ).astype("<f4")
    records = np.empty(len(case.faces), [("n", "u1"), ("corners", "<i4", 3)])
    records["n"], records["corners"] = 3, np.arange(len(corners)).reshape(-1, 3)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    header += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz", "s", "t")]
    header += [f"element face {len(records)}", "property list uchar int vertex_indices", "end_header", ""]
    Path(path).write_bytes("\n".join(header).encode() + table.tobytes() + records.tobytes())
