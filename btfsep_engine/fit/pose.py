# SPDX-License-Identifier: GPL-3.0-or-later
"""The pose in which known geometry lies as a photograph shows it: by its outlines and by its shading, together.

What is seen is taken as points on the geometry, which are moved over the photo: points of the outlines belong where the
photo changes across them (as in RAPID: Harris and Stennett, BMVC 1990), and what is left of the brightness at points of
the surface after the best light has been taken away is to be small (variable projection: Golub and Pereyra, SIAM J.
Numer. Anal. 10, 1973). The light's columns hang on the geometry and not on the camera, so that they are made once for a
set of points. A weak prior about the start holds what the photo does not determine.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from btfsep_engine.job.camera import Camera
from btfsep_engine.linear_algebra import product

DARK = 0.05  # of the object's median luminance: noise in shadows is no edge
GLARE = 3.0  # of the objects' median colour: what is brighter is a highlight, which no light of a low order makes
SATURATES = 80  # percentile of the photo's gradients about the objects, at which half an edge is found
REACH = 16.0  # pixels, in which a shift is looked for; the prior's deviation
TURN = np.radians(5.0)  # the prior's deviation of each turn
STRETCH = 0.05  # the prior's deviation of distance and focal length
PRIOR = 0.02  # of the objective, for one deviation
OUTLINE = 3.0  # the outlines' weight in the objective; the shading's is at most one
CAPPED = 2.0  # robust deviations of the shading's residual at which it counts less
LEAST_LEFT = 0.01  # of the brightness: no model of the shading is better
STEP = 0.2  # pixels, of finite differences
LONGEST_STEP = 6.0  # pixels, where nothing is known of how far a step may be believed
PARAMETERS = 7
AT_ONCE = 12  # cameras: enough that NumPy's calls cost little, few enough for the cache


@dataclass(frozen=True)
class Frame:
    """The coordinates of a search: what seven numbers, each in pixels of the picture, do to a camera.

    Turns about the camera's three axes through the objects' centre; shifts to the right and down; the picture's
    scale, by the distance; the focal length, with the distance that keeps the size. An orthographic camera knows no
    distance: both of the last are its scale.

    Attributes
    ----------
    camera : the start
    centre : (3,) world
    radius : of the objects, pixels
    """

    camera: Camera
    centre: np.ndarray
    radius: float

    @property
    def deviations(self) -> np.ndarray:
        """(7,) of the prior, in pixels."""
        return np.array([TURN * self.radius] * 3 + [REACH] * 2 + [STRETCH * self.radius] * 2)

    def at(self, q) -> Camera:
        """The camera for seven numbers."""
        camera, q = self.camera, np.asarray(q, np.float64)
        turn, scale, zoom = q[:3] / self.radius, q[5] / self.radius, q[6] / self.radius
        world, flat = camera.to_world, camera.orthographic
        c = world[:3, :3].T @ (self.centre - world[:3, 3])
        shift = np.array([q[3] / camera.fx, -q[4] / camera.fy, 0]) * (1 if flat else -c[2])
        rotation = cv2.Rodrigues(turn)[0]
        # a larger picture is a nearer object
        place = c * (1 if flat else np.exp(zoom - scale)) + shift - rotation @ c
        growth, back = np.exp(zoom + scale * flat), np.eye(4)
        back[:3, :3], back[:3, 3] = rotation.T, -rotation.T @ place
        return replace(camera, fx=camera.fx * growth, fy=camera.fy * growth, to_world=world @ back)


class Shifts(Frame):
    """The same of geometry that is one piece with its camera, as a depth: only the two shifts do anything."""

    def at(self, q) -> Camera:
        """The camera for seven numbers."""
        return self.camera.shifted(q[3], q[4])


@dataclass(frozen=True)
class Marks:
    """What is seen of the geometry from somewhere near.

    Attributes
    ----------
    outline : (m, 3) world; across : (m, 2) unit, image directions (x, y) across the outline
    surface : (n, 3) world; light : (n, k), what each of k lights gives to the surface there
    """

    outline: np.ndarray
    across: np.ndarray
    surface: np.ndarray
    light: np.ndarray


def blurred(image, sigma: float) -> np.ndarray:
    """An image (h, w, …) float64 under a Gaussian of ``sigma`` pixels."""
    reach = int(4 * sigma + 0.5)
    return cv2.GaussianBlur(image, (2 * reach + 1,) * 2, sigma, borderType=cv2.BORDER_REFLECT)


def usual_colour(radiance) -> np.ndarray:
    """(3,), all positive, of pixels (n, 3) of which some are not black: their median, of the others' where most are."""
    level = np.median(radiance, 0)
    if not level.max() > 0:
        level = np.median(radiance[radiance.max(1) > 0], 0)
    return np.maximum(level, 1e-3 * level.max())


class Picture:
    """A photograph, ready to be looked up at one scale.

    Parameters
    ----------
    radiance : (h, w, 3) linear
    usable : (h, w) bool
    about : (h, w) bool, where the objects are, roughly
    blur : pixels
    cubic : whether it is looked up by cubic splines: points that lie alike between pixels all go with a place
        between these or none, where lines would blur
    """

    def __init__(self, radiance, usable, about, *, blur: float, cubic: bool = False):
        self.cubic = cubic
        radiance = np.maximum(np.asarray(radiance, np.float64), 0)
        weight = blurred(usable.astype(np.float64), blur)
        level = usual_colour(radiance[about & usable])
        known = blurred(np.where(usable[..., None], np.minimum(radiance / level, GLARE), 0), blur)
        self.radiance = known / np.maximum(weight, 1e-6)[..., None]
        self.usable = weight > 0.5
        logs = blurred(np.log(radiance / level + DARK), blur)
        self.slopes = np.concatenate(np.gradient(logs, axis=(0, 1)), -1)  # (h, w, 2 * 3), down and right
        size = np.sqrt((self.slopes**2).sum(-1))
        self.half = max(float(np.percentile(size[about], SATURATES)), 1e-12)
        self.shape = self.usable.shape
        if cubic:
            from scipy.ndimage import spline_filter1d  # slow to import, and most jobs have meshes

            self.radiance, self.slopes = (
                spline_filter1d(spline_filter1d(i, axis=0, mode="nearest"), axis=1, mode="nearest")
                for i in (self.radiance, self.slopes)
            )
        else:  # these are looked up millions of times
            self.radiance, self.slopes = self.radiance.astype(np.float32), self.slopes.astype(np.float32)

    def _look(self, image, at):
        """Of an image (h, w, c) at image positions (…, 2): (…, c)."""
        shape, at = at.shape[:-1], at.reshape(-1, 2)
        if self.cubic:
            places = at[:, 1] - 0.5, at[:, 0] - 0.5
            from scipy.ndimage import map_coordinates

            channels = np.moveaxis(image.reshape(*self.shape, -1), -1, 0)
            each = [map_coordinates(c, places, order=3, mode="nearest", prefilter=False) for c in channels]
            return np.stack(each, -1).reshape(*shape, len(each))
        (h, w), cell = self.shape, at - 0.5
        cell = np.clip(cell, 0, [w - 1.001, h - 1.001])
        first = cell.astype(np.int64)
        right, down = (cell - first).T[..., None].astype(image.dtype)
        flat, at_first = image.reshape(h * w, -1), first[:, 1] * w + first[:, 0]
        above, beside, below, across = (flat.take(at_first + step, 0) for step in (0, 1, w, w + 1))
        above += (beside - above) * right
        below += (across - below) * right
        above += (below - above) * down
        return above.reshape(*shape, flat.shape[1])

    def inside(self, at) -> np.ndarray:
        """(n,) bool: which image positions are in the picture and usable."""
        h, w = self.shape
        column, row = (np.clip(np.floor(at[:, i]), 0, n - 1).astype(int) for i, n in ((0, w), (1, h)))
        within = (at > 0.5).all(1) & (at[:, 0] < w - 0.5) & (at[:, 1] < h - 0.5)
        return within & self.usable[row, column]

    def missing(self, at, across) -> np.ndarray:
        """How little of an edge there is at image positions (…, n, 2), in [0, 1]: 0 a strong one, 1 none: (…, n)."""
        slopes = self._look(self.slopes, at).reshape(*at.shape, 3)
        change = np.einsum("...mic,mi->...mc", slopes, across[:, ::-1])
        return self.half / (self.half + np.sqrt(np.einsum("...c,...c", change, change)))

    def colours(self, at) -> np.ndarray:
        """(…, 3) at image positions (…, 2), over the objects' median."""
        return self._look(self.radiance, at)


class Misfit:
    """The objective of a set of marks on a picture."""

    def __init__(self, picture: Picture, marks: Marks, camera: Camera, *, shading: float):
        self.picture, self.shading = picture, shading
        kept = picture.inside(camera.project(marks.outline))
        self.outline, self.across = marks.outline[kept], marks.across[kept]
        kept = picture.inside(camera.project(marks.surface))
        self.surface, light = marks.surface[kept], marks.light[kept]
        # the ridge holds lights that these points cannot tell apart
        ridge = 1e-2 * np.sqrt((light**2).sum(0).mean()) * np.eye(light.shape[1])
        self.plane = np.linalg.qr(np.concatenate([light, ridge]))[0][: len(light)]
        left = self.left([camera])[0]
        usual = np.median(np.abs(left), 0) if len(left) else np.zeros(3)
        self.scale = np.maximum(1.4826 * usual, LEAST_LEFT)

    def left(self, cameras) -> np.ndarray:
        """What no light explains from each of k cameras, (k, n, 3), over the objects' median colour."""
        b = self.picture.colours(np.stack([camera.project(self.surface) for camera in cameras]))
        by_point = np.moveaxis(b, 1, 0)
        flat = by_point.reshape(b.shape[1], len(b) * b.shape[2])
        explained = product(self.plane, product(self.plane.T, flat))
        return b - np.moveaxis(explained.reshape(by_point.shape), 0, 1)

    def edges(self, cameras) -> np.ndarray:
        """(k, m) `Picture.missing` of the outlines."""
        return self.picture.missing(np.stack([camera.project(self.outline) for camera in cameras]), self.across)

    def residuals(self, cameras) -> np.ndarray:
        """Of outlines and shading from each of k cameras, (k, numbers): the sum of a camera's squares is the objective
        without the prior. All at once, since a call costs as much as a thousand points."""
        edges = self.edges(cameras) * np.sqrt(OUTLINE / max(len(self.outline), 1))
        if not self.shading:
            return edges
        left = self.left(cameras) / (CAPPED * self.scale)
        soft = np.copysign(np.sqrt(2 * (np.sqrt(1 + left**2) - 1)), left)  # soft_l1, signed: its square is the cost
        soft = soft.reshape(len(edges), -1)
        return np.concatenate([edges, soft * np.sqrt(self.shading / max(soft.shape[1], 1))], 1)

    def values(self, camera: Camera) -> tuple[float, float]:
        """What is missing of the outlines, in [0, 1], and the shading's residual over the objects' median colour."""
        edges, left = self.edges([camera])[0], np.abs(self.left([camera])[0])
        return float(edges.mean()), float(np.minimum(left, np.percentile(left, 90)).mean())


@dataclass(frozen=True)
class Gain:
    """How much better the same points go with a photo from one camera than from another.

    Attributes
    ----------
    outline, shading : what each takes off the objective
    significance : of both together, in deviations: neighbouring points err together, so that tiles of the picture, not
        points, are witnesses
    shading_significance : of the shading alone; negative where it goes worse
    """

    outline: float
    shading: float
    significance: float
    shading_significance: float


def gained(misfits, before: Camera, after: Camera, *, tile: float) -> Gain:
    """The gain of ``after`` over ``before``, by the points that are seen from each of both (a Misfit of each).

    ``tile`` : pixels, edge of the squares whose points are one witness
    """
    tiles, edge, gains = [], [], []
    for misfit in misfits:
        one, other = misfit.residuals([before, after]) ** 2 / 2
        at = [before.project(points) for points in (misfit.outline, np.repeat(misfit.surface, 3, 0))]
        tiles.append((np.concatenate(at)[: len(one)] / tile).astype(np.int64))
        edge.append(np.arange(len(one)) < len(misfit.outline))
        gains.append((one - other) / len(misfits))
    _, number = np.unique(np.concatenate(tiles), axis=0, return_inverse=True)
    edge, gains, number = np.concatenate(edge), np.concatenate(gains), number.reshape(-1)
    sums = [np.bincount(number, gains * part) for part in (edge, ~edge)]
    both, shading = (float(s.sum() / max(np.linalg.norm(s), 1e-300)) for s in (sums[0] + sums[1], sums[1]))
    return Gain(float(sums[0].sum()), float(sums[1].sum()), both, shading)


class Objective:
    """A misfit and the prior as functions of those of seven numbers that are ``free`` (7,) bool; the others are q's."""

    def __init__(self, misfit: Misfit, frame: Frame, q, free):
        self.misfit, self.frame = misfit, frame
        self.q, self.free = np.array(q, np.float64), np.asarray(free, bool)

    def every(self, moved) -> np.ndarray:
        """(k, 7), of k sets of free numbers."""
        out = np.tile(self.q, (len(moved), 1))
        out[:, self.free] = moved
        return out

    def residuals(self, moved) -> np.ndarray:
        """(k, numbers), of k sets of free numbers."""
        every = self.every(moved)
        prior = np.sqrt(PRIOR) * every / self.frame.deviations
        return np.concatenate([self.misfit.residuals([self.frame.at(q) for q in every]), prior], 1)

    def slopes(self, moved) -> np.ndarray:
        """(numbers, free), their derivatives at one set, by differences."""
        steps = STEP * np.eye(len(moved))
        ahead, behind = np.split(self.residuals(np.concatenate([moved + steps, moved - steps])), 2)
        return (ahead - behind).T / (2 * STEP)


def refined(misfit: Misfit, frame: Frame, q, *, free, rounds: int = 6) -> np.ndarray:
    """Seven numbers of a camera near ``q`` with the least misfit; ``free`` : (7,) bool, the others stay."""
    from scipy.optimize import least_squares  # slow to import, and most cameras are in place

    objective = Objective(misfit, frame, q, free)
    found = least_squares(
        lambda moved: objective.residuals(moved[None])[0],
        objective.q[objective.free],
        jac=objective.slopes,
        method="lm",
        max_nfev=rounds,
        x_scale=1.0,
    )
    return objective.every(found.x[None])[0]


def first_steps(misfit: Misfit, frame: Frame, q, *, free, steps: int) -> np.ndarray:
    """Seven numbers to which Gauss and Newton's first steps from ``q`` lead, as long as the misfit shrinks."""
    objective = Objective(misfit, frame, q, free)
    moved = objective.q[objective.free]
    left = objective.residuals(moved[None])[0]
    for _ in range(steps):
        step = np.linalg.lstsq(objective.slopes(moved), -left, rcond=None)[0]
        further = moved + step * min(1.0, LONGEST_STEP / max(float(np.linalg.norm(step)), 1e-12))
        after = objective.residuals(further[None])[0]
        if not np.square(after).sum() < np.square(left).sum():
            break
        moved, left = further, after
    return objective.every(moved[None])[0]


def best_shifts(misfit: Misfit, frame: Frame, *, step: float, keep: int, apart: float) -> list[np.ndarray]:
    """The best starts on a grid of shifts, ``apart`` pixels or more from one another, the best first."""
    reach = np.arange(-REACH, REACH + step / 2, step)
    grid = np.array([[0, 0, 0, x, y, 0, 0] for x in reach for y in reach if np.hypot(x, y) <= 1.1 * REACH])
    values = PRIOR * np.square(grid / frame.deviations).sum(1)
    for some in np.split(np.arange(len(grid)), range(AT_ONCE, len(grid), AT_ONCE)):
        values[some] += np.square(misfit.residuals([frame.at(q) for q in grid[some]])).sum(1)
    out: list = []
    for i in np.argsort(values):
        if len(out) < keep and all(np.linalg.norm(grid[i] - q) >= apart for q in out):
            out.append(grid[i])
    return out
