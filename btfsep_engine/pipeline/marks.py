# SPDX-License-Identifier: GPL-3.0-or-later
"""What cameras near a scene's own see of its objects, as marks: outlines, and points of surfaces with their light."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.fit.misalignment import blurred_slopes
from btfsep_engine.fit.pose import Marks
from btfsep_engine.job.model import Camera
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.render.sampling import evenly
from btfsep_engine.render.surface import SurfacePoints, View, camera_view, surface_points

DIRECTIONS = fibonacci_sphere(96)  # light is smooth
ORDER, LOBE_ORDER = 2, 3  # of the light by its cosine, and from the mirror direction
EDGE_BLUR = 1.5  # pixels, of the picture of depths in which an outline's direction is found
MARGIN = 8  # pixels about the objects that are looked at: the reach of that blur, and two
DEEP = 0.03  # of the objects' radius: where depth jumps by more, one surface ends before another
STEEPER = 3.0  # times the step before it: a round surface that turns away makes steps up to 2.4 times the last one
PARTS = 16  # of the pixel in which an outline lies: a power of two, since it is halved
MOST = 1000  # points of outlines, of several times as many that there are: neighbours say the same


def grown(mask, pixels: int, *, beyond: bool = False) -> np.ndarray:
    """A mask (h, w) bool and all that is so many steps to a side, up or down from it; ``beyond`` : and the frame."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    edge = {"borderType": cv2.BORDER_CONSTANT, "borderValue": int(beyond)}
    return cv2.dilate(np.asarray(mask, np.uint8), cross, iterations=pixels, **edge).astype(bool)


def part_about(camera: Camera, meshes) -> tuple[Camera, tuple[int, int]]:
    """The camera of that part of a picture in which meshes can be, `MARGIN` included, and the row and column at which
    it begins. All of the picture, where a mesh reaches behind the camera."""
    ends = np.array([[m.vertices.min(0), m.vertices.max(0)] for m in meshes])  # (m, 2, 3)
    corners = ends[:, np.array(list(np.ndindex(2, 2, 2))), np.arange(3)].reshape(-1, 3)
    before = (camera.to_world[:3, 3] - corners) @ camera.to_world[:3, 2]
    if not camera.orthographic and (before <= 0).any():
        return camera, (0, 0)
    size = np.array([camera.width, camera.height])
    at = camera.project(corners)
    low = np.clip(np.floor(at.min(0)) - MARGIN, 0, size - 1).astype(int)
    high = np.clip(np.ceil(at.max(0)) + MARGIN, low + 1, size).astype(int)
    left, top = map(int, low)
    width, height = map(int, high - low)
    part = replace(camera.shifted(-left, -top), width=width, height=height)
    return part, (top, left)


def outline_of(view, of, camera: Camera, tracer, *, limit: float):
    """Where surfaces end before what is farther, to a fraction of a pixel, at about `MOST` places.

    Parameters
    ----------
    view : render.surface.View, what ``camera`` sees of ``tracer``'s geometry
    of : (h, w) bool, where the nearer surface is one whose outline is asked for
    limit : world units, of jumps in distance that count

    Returns
    -------
    points (m, 3) world, on the nearer surface; across (m, 2) unit, x and y
    """
    distance = np.where(view.mesh >= 0, view.distance, np.inf)
    nearness = np.where(view.mesh >= 0, 1 / np.maximum(view.distance, 1e-300), 0.0)
    slope = np.stack(blurred_slopes(nearness, EDGE_BLUR)[::-1], -1)  # to the right and down
    pairs = []  # of pixels: row and column of the nearer, row and column of the farther
    for down, right in ((1, 0), (0, 1)):
        h, w = distance.shape
        one, other = distance[: h - down, : w - right], distance[down:, right:]
        # compared as sums, since infinite less infinite is nothing
        for nearer, jump in ((0, other > one + limit), (1, one > other + limit)):
            first = np.argwhere(jump)
            second = first + np.array([down, right])
            pairs.append(np.concatenate([second, first] if nearer else [first, second], 1))
    each = np.concatenate(pairs)
    near, far = np.split(each[of[each[:, 0], each[:, 1]]], 2, axis=1)
    inwards = 2 * near - far
    inside = ((inwards >= 0) & (inwards < distance.shape)).all(1)
    row, column = np.where(inside[:, None], inwards, near).T
    slant = np.maximum(distance[tuple(near.T)] - distance[row, column], 0)
    ends = distance[tuple(far.T)] - distance[tuple(near.T)] > STEEPER * slant
    near, far = near[ends], far[ends]
    few = evenly(near, MOST)
    near, far = near[few], far[few]
    row, column = near.T
    # all places that halving may ask for are asked at once: a thousand rays take hardly longer than one
    shares = np.arange(1, PARTS)[:, None, None] / PARTS
    at = (near + shares * (far - near) + 0.5).reshape(-1, 2)
    hits = tracer.nearest(*camera.rays(at[:, 1], at[:, 0])).distance.reshape(PARTS - 1, -1)
    low, step, depth, each = np.zeros(len(near), int), PARTS // 2, distance[row, column], np.arange(len(near))
    while step:
        hit = hits[low + step - 1, each]
        on = hit < depth + limit
        low, depth, step = np.where(on, low + step, low), np.where(on, hit, depth), step // 2
    at = near + (low / PARTS)[:, None] * (far - near) + 0.5
    origins, rays = camera.rays(at[:, 1], at[:, 0])
    across = slope[row, column]
    length = np.linalg.norm(across, axis=1)
    clear = length > 0
    return (origins + depth[:, None] * rays)[clear], across[clear] / length[clear, None]


@dataclass(frozen=True)
class Seen:
    """What a camera sees of the part of its picture in which the objects are.

    Attributes
    ----------
    camera : of that part; rows, columns : where in the whole picture it lies
    view : its own
    outline, across : as of `outline_of`
    """

    camera: Camera
    rows: slice
    columns: slice
    view: View
    outline: np.ndarray
    across: np.ndarray


class Sight:
    """What cameras see of a scene's objects; what one has seen is kept.

    Parameters
    ----------
    scene : of a photo of the size in which cameras look
    edge : of a depth, how many pixels of it one of these is; None: the objects are meshes
    """

    def __init__(self, scene: PreparedScene, *, edge: int | None = None):
        self.scene, self.job, self.tracer, self.edge = scene, scene.job, scene.tracer, edge
        self._seen: dict = {}

    def objects_in(self, view) -> np.ndarray:
        """(h, w) bool, where a view shows an object and no occluder."""
        return (view.mesh >= 0) & (view.mesh < len(self.job.objects))

    def seen(self, camera: Camera) -> Seen:
        """Of a camera; what the job's own camera sees is there already."""
        key = key_of(camera)
        if key not in self._seen:
            part, view, top, left = camera, self.scene.view, 0, 0
            if camera is not self.job.camera:
                part, (top, left) = part_about(camera, [o.mesh for o in self.job.objects])
                view = camera_view(self.tracer, replace(self.job, camera=part), sure=False)
            where = slice(top, top + part.height), slice(left, left + part.width)
            outline = outline_of(view, self.objects_in(view), part, self.tracer, limit=DEEP * self.tracer.radius)
            self._seen[key] = Seen(part, *where, view, *outline)
        return self._seen[key]

    def marks(self, camera: Camera, *, blur: float, points: int) -> Marks:
        """What a camera sees; about ``points`` of the surface, so far inside that ``blur`` (pixels) mixes nothing."""
        seen, job = self.seen(camera), self.job
        outline, across = seen.outline, seen.across
        if self.edge is not None:
            at = camera.project(outline)
            if (mask := job.objects[0].mask) is not None:  # outside it the depth shows other things
                column, row = np.clip(at.astype(np.int64), 0, [camera.width - 1, camera.height - 1]).T
                mine = grown(mask, 2)[row, column]
                at, outline, across = at[mine], outline[mine], across[mine]
            # the surface ends in the middle of the last pixel that shows it, the object half a pixel farther on
            beyond = at - 0.5 / self.edge * across
            origins, rays = camera.rays(*beyond.T)
            outline = origins + np.linalg.norm(outline - origins, axis=1)[:, None] * rays
        surface = self._surface(seen, 1 + round(1.5 * blur), points)
        return Marks(outline, across, surface.position, self.light(surface))

    def _surface(self, seen: Seen, inwards: int, count: int) -> SurfacePoints:
        """About ``count`` points of all objects, ``inwards`` pixels or more from where other things are seen."""
        inner = ~grown(~self.objects_in(seen.view), inwards, beyond=True)
        owner = np.where(inner, seen.view.mesh, -1)
        for i, obj in enumerate(self.job.objects):
            if obj.mask is not None:
                owner[(owner == i) & ~obj.mask[seen.rows, seen.columns]] = -1
        job, pixels = replace(self.job, camera=seen.camera), np.argwhere(owner >= 0)
        rows, columns = pixels[evenly(pixels, count)].T
        region = np.zeros(owner.shape, bool)
        region[rows, columns] = True
        points = [surface_points(seen.view, job, i, region=region & (owner == i)) for i in range(len(job.objects))]
        given = [name for name, value in vars(points[0]).items() if value is not None]
        return SurfacePoints(**{n: np.concatenate([getattr(p, n) for p in points]) for n in given})

    def light(self, p: SurfacePoints) -> np.ndarray:
        """(n, 9 + 16): what each term of a light gives to a matt surface, shadows included, and to a shining one."""
        sees = self.tracer.visible(p.position, p.flat_normal, DIRECTIONS)
        cosine = np.maximum(p.normal @ DIRECTIONS.T, 0) * sees
        matt = cosine @ sh.evaluate(ORDER, DIRECTIONS) * (4 / len(DIRECTIONS))
        mirrored = 2 * (p.normal * p.to_eye).sum(1, keepdims=True) * p.normal - p.to_eye
        mirrored /= np.maximum(np.linalg.norm(mirrored, axis=1, keepdims=True), 1e-300)
        return np.concatenate([matt, sh.evaluate(LOBE_ORDER, mirrored) * cosine.mean(1, keepdims=True)], 1)


def key_of(camera: Camera) -> tuple:
    """What tells cameras of one search apart."""
    return camera.fx, camera.cx, camera.cy, camera.to_world.tobytes()
