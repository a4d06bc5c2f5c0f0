# SPDX-License-Identifier: GPL-3.0-or-later
"""What each chosen pixel sees: the surface points that the transport works on."""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.errors import InputError
from btfsep_engine.job.model import Job
from btfsep_engine.render.parametrise import physical_uv, tangent_frames
from btfsep_engine.render.tracer import Tracer

BESIDE = (0.031, 0.017)  # pixels
SLIPPED = 1e-3  # scene radii
# Of the square of a pixel, the edge of the one that has as much spread as what a photograph's pixels gather from: lens
# and the camera's mosaic, or a renderer's filter, 0.35 to 0.4 pixels where the square has 0.29. On 36 aligned
# photographs by Cycles the texture has then the photo's contrast (0.98 to 1.02 times; with the square 0.82 to 0.88)
GATHERED = 1.3
RAYS_AT_ONCE = 2**19  # the view of a large photo is traced in bands of rows: memory for the rays of one band only


@dataclass(frozen=True)
class SurfacePoints:
    """n surface points of one object, one for each pixel.

    Attributes
    ----------
    pixels : (n, 2) int32, row and column
    position : (n, 3) float64, world
    normal : (n, 3) float64, shading normal, towards the camera's side
    flat_normal : (n, 3) float64, normal of the face, on the camera's side; secondary rays start along it
    to_eye : (n, 3) float64, unit
    face : (n,) int32, barycentric : (n, 3) float32
    footprint : (n,) float64, edge in world units of a pixel's patch of surface (geometric mean)
    tangent, bitangent : (n, 3) float64, unit, and uv : (n, 2) float64, millimetres; None until `with_texture`
    """

    pixels: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    flat_normal: np.ndarray
    to_eye: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray
    footprint: np.ndarray
    tangent: np.ndarray | None = None
    bitangent: np.ndarray | None = None
    uv: np.ndarray | None = None

    def __len__(self):
        return len(self.pixels)

    def take(self, index) -> "SurfacePoints":
        """The chosen points, in the order of ``index``."""
        return SurfacePoints(**{k: None if v is None else v[index] for k, v in vars(self).items()})


@dataclass(frozen=True)
class View:
    """What the camera sees: for every pixel the mesh, -1 where none, and where on it."""

    mesh: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray
    distance: np.ndarray


def camera_view(tracer: Tracer, job: Job, *, sure: bool = True) -> View:
    """Nearest hits through every pixel centre, images of (height, width).

    A ray that meets the edge between two triangles exactly can slip through it. A second ray a little beside the
    first tells: where it stops much earlier, it is the one that is believed. ``sure`` : whether there is a second one,
    without which a pixel may be missing here and there, in half of the time
    """
    camera = job.camera
    shape = (camera.height, camera.width)
    view = View(
        np.empty(shape, np.int32), np.empty(shape, np.int32), np.empty((*shape, 3), np.float32), np.empty(shape)
    )
    band = max(1, RAYS_AT_ONCE // camera.width)
    for top in range(0, camera.height, band):
        rows, columns = np.mgrid[top : min(top + band, camera.height), : camera.width]
        hits, *beside = (
            tracer.nearest(*camera.rays(columns.ravel() + 0.5 + shift[0], rows.ravel() + 0.5 + shift[1]))
            for shift in ((0.0, 0.0), BESIDE)[: 1 + sure]
        )
        for name, whole in vars(view).items():
            chosen = getattr(hits, name)
            for other in beside:
                slipped = other.distance < hits.distance - SLIPPED * tracer.radius
                chosen = np.where(slipped.reshape(-1, *[1] * (chosen.ndim - 1)), getattr(other, name), chosen)
            whole[top : top + band] = chosen.reshape(whole[top : top + band].shape)
    return view


def object_region(view: View, job: Job, index: int) -> np.ndarray:
    """Pixels (h, w) bool that show object ``index`` alone: its mask, away from silhouettes and mask edges.

    Raises InputError when no pixel shows the object.
    """
    obj = job.objects[index]
    seen = view.mesh == index
    if not seen.any():
        hidden = (
            "other geometry is in front of it, or it is outside the picture"
            if (view.mesh >= 0).any()
            else ("no ray of the camera meets any geometry")
        )
        raise InputError(
            f"object '{obj.name}'",
            f"the camera does not see it ({hidden})",
            "check where the camera stands and looks (along its -Z), where the mesh stands, and the unit of length",
        )
    region = seen if obj.mask is None else seen & obj.mask
    if not region.any():
        raise InputError(
            f"object '{obj.name}'",
            f"its mask leaves none of the {int(seen.sum())} pixels that show it",
            "check that the mask belongs to this photo and is not inverted",
        )
    # pixels at an edge mix object and background
    inner = eroded(region)
    return inner if inner.sum() >= 0.2 * region.sum() else region


def eroded(region) -> np.ndarray:
    """A region (h, w) bool without the pixels that have one that is not in it, or none, among the eight around."""
    padded = np.pad(region, 1)
    rows = padded[:-2] & padded[1:-1] & padded[2:]
    return rows[:, :-2] & rows[:, 1:-1] & rows[:, 2:]


def surface_points(view: View, job: Job, index: int, *, region=None) -> SurfacePoints:
    """Surface points of object ``index`` in ``region`` ((h, w) bool; None: `object_region`).

    Occluders are counted after the objects; of these the region has to be given.
    """
    region = object_region(view, job, index) if region is None else region
    rows, columns = np.nonzero(region)
    mesh, camera = (*job.objects, *job.occluders)[index].mesh, job.camera
    face, weights = view.face[rows, columns], view.barycentric[rows, columns].astype(np.float64)
    # rounded to float32 they do not sum to one, and a position far from the origin would move
    weights[:, 0] = 1 - weights[:, 1] - weights[:, 2]
    triangles = mesh.vertices[mesh.faces[face]]
    position = (weights[..., None] * triangles).sum(1)
    to_eye, pixel = camera.seen_from(position)
    flat = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300)
    side = np.where((flat * to_eye).sum(1, keepdims=True) < 0, -1.0, 1.0)
    normal = (weights[..., None] * mesh.corner_normals[face]).sum(1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    # the shading normal belongs to the same side of the surface as the flat one
    flat = flat * side
    normal = normal * np.where((normal * flat).sum(1, keepdims=True) < 0, -1.0, 1.0)
    slant = np.maximum((flat * to_eye).sum(1), 0.05)
    footprint = pixel / np.sqrt(slant)
    return SurfacePoints(
        np.stack([rows, columns], -1).astype(np.int32),
        position,
        normal,
        flat,
        to_eye,
        face,
        weights.astype(np.float32),
        footprint,
    )


def as_gathered(points: SurfacePoints) -> SurfacePoints:
    """The points of a photograph's pixels, each of which has gathered light from somewhat beyond its square."""
    return replace(points, footprint=GATHERED * points.footprint)


def with_texture(points: SurfacePoints, job: Job, index: int, *, reporter=None) -> SurfacePoints:
    """The same points with tangent frames and texture coordinates in millimetres."""
    obj = job.objects[index]
    uv = physical_uv(obj.mesh, obj.uv, millimetres_per_unit=1000 * job.metres_per_unit, reporter=reporter)[points.face]
    tangent, bitangent = tangent_frames(obj.mesh.vertices[obj.mesh.faces[points.face]], uv, points.normal)
    at = (points.barycentric[..., None].astype(np.float64) * uv).sum(1)
    return replace(points, tangent=tangent, bitangent=bitangent, uv=at)


def with_any_tangent(points: SurfacePoints) -> SurfacePoints:
    """The same points with tangents that follow the world's vertical: enough for isotropic materials."""
    up = np.broadcast_to([0.0, 0.0, 1.0], points.normal.shape)
    tangent = np.cross(up, points.normal)
    length = np.linalg.norm(tangent, axis=1, keepdims=True)
    tangent = np.where(length > 1e-6, tangent / np.maximum(length, 1e-300), [1.0, 0.0, 0.0])
    tangent -= (tangent * points.normal).sum(1, keepdims=True) * points.normal
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return replace(points, tangent=tangent, bitangent=np.cross(points.normal, tangent), uv=np.zeros((len(points), 2)))
