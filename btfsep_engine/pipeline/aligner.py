# SPDX-License-Identifier: GPL-3.0-or-later
"""The search for the camera that took a scene's photo: from coarse to fine, and to the last pixel by the photo's edges.

Outlines and shading are asked together (`fit.pose`); a prior holds a turn that neither shows.
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine.fit.pose import (
    LEAST_LEFT,
    PARAMETERS,
    Frame,
    Gain,
    Marks,
    Misfit,
    Picture,
    Shifts,
    best_shifts,
    first_steps,
    gained,
    refined,
)
from btfsep_engine.fit.settling import Edges, Settled, settled
from btfsep_engine.job.model import Camera
from btfsep_engine.pipeline.marks import Sight, grown, key_of
from btfsep_engine.pipeline.scene import PreparedScene, unseen_meshes
from btfsep_engine.storage import kept

SIDE = 256  # pixels of a photo's longer edge, at most, of what is looked at
SIDE_OF_A_DEPTH = 512  # the same, where marks are made but once
NEAR = 12  # pixels about the objects, in which the photo's edges are measured
LEAST_OUTLINE, LEAST_SURFACE = 40, 100  # points; fewer say nothing
HELD = np.array([True] * 6 + [False])  # all but the focal length
FREE = np.ones(PARAMETERS, bool)
SHIFTS = np.array([False] * 3 + [True] * 2 + [False] * 2)
TILE = 16.0  # pixels, or a quarter of the objects' radius: neighbours in such a square are one witness
LEAST_GAIN = 0.03  # of the objective: texture and the blur of an edge draw by less
ZOOM_GAIN = 0.03  # least logarithm that another focal length has to gain beside a move
STARTS, KEPT, APART = 3, 2, 1.5  # shifts to start from beside none; how many go on; pixels between two ways
STILL = 0.1  # pixels: marks are not made anew for a smaller step
# What an estimate looks at first: cameras that are a degree or a pixel off ask for up to 1.3 pixels, true ones up to 1.
FIRST_LEVEL, FIRST_STEPS, OFF = 1, 3, 1.5  # pixels of what is looked at
AGREED = 0.5  # deviations by which outlines and shading have to go better where outlines settle on edges
FIRM, FREER = 0.05, 0.2  # holds (`fit.settling`): of a first look; of what a search has found
HOLDS = (0.1, 0.2)  # of a move nearby, one after the other where that is not enough
# Of how far a pose settles that is gone, one set of marks after the other, since each lets it waver by some tenths of a
# pixel; and pixels of the last step.
SETTLINGS, AT_REST = (1.0, 1.0, 0.5, 0.5), 0.25


@dataclass(frozen=True)
class Level:
    """A stage of the search, coarse to fine: blur in pixels, shading's weight, points of the surface, sets of marks."""

    blur: float
    shading: float
    points: int
    rounds: int


LEVELS = (Level(4.0, 0.3, 600, 2), Level(2.0, 1.0, 1000, 2), Level(1.0, 1.0, 1500, 3))


@dataclass(frozen=True)
class Left:
    """What speaks against a pose: the outline's share without an edge, the shading's residual over the brightness."""

    outline: float
    shading: float

    def gain_of(self, after: "Left") -> tuple[float, float]:
        """Logarithms of how many times as much there is here as after: of the outline, and of the shading."""
        pairs = ((self.outline, after.outline), (self.shading, after.shading))
        return tuple(float(np.log(max(a, LEAST_LEFT) / max(b, LEAST_LEFT))) for a, b in pairs)

    def better(self, after: "Left") -> float:
        """Logarithm of the gain by which one of several poses is chosen: texture makes shading the weaker witness."""
        outline, shading = self.gain_of(after)
        return 2 * outline + shading


class Aligner:
    """A scene whose camera is looked for, at a size of the photo that is enough for it."""

    def __init__(self, scene: PreparedScene):
        self.depth = bool(unseen_meshes(scene.job))
        self.scene = scene.at_most(SIDE_OF_A_DEPTH if self.depth else SIDE)
        self.job, self.tracer = self.scene.job, scene.tracer
        view, camera, edge = self.scene.view, self.job.camera, None
        seen = (view.mesh >= 0) & (view.mesh < len(self.job.objects))
        rows, columns = np.nonzero(seen)
        origins, rays = camera.rays(columns + 0.5, rows + 0.5)
        centre = np.median(origins + view.distance[seen][:, None] * rays, 0)
        radius = float(np.sqrt(seen.sum() / np.pi))
        self.frame = Frame(camera, centre, radius)
        if self.depth:
            # the middle of an even block of the photo lies half a pixel before the surface that stands for it
            edge = round(scene.job.camera.fx / camera.fx)
            self.frame = Shifts(camera.shifted(*[(1 - edge % 2) / (2 * edge)] * 2), centre, radius)
        self.sight = Sight(self.scene, edge=edge)
        self._about = grown(seen, NEAR)
        self._misfits: dict = {}  # camera and level -> Misfit
        self._edges: Edges | None = None
        self._pictures: dict = {}  # level -> Picture

    def picture(self, level: int) -> Picture:
        """The photo as a level looks at it."""
        if level not in self._pictures:
            photo, blur = self.job.photo, LEVELS[level].blur
            self._pictures[level] = Picture(photo.radiance, photo.usable, self._about, blur=blur, cubic=self.depth)
        return self._pictures[level]

    @property
    def shows_light(self) -> bool:
        """Whether the photo is anything but black and unknown where the objects are."""
        photo = self.job.photo
        return bool((photo.radiance[self._about & photo.usable] > 0).any())

    def marks(self, camera: Camera, level: int) -> Marks:
        """What a camera sees, as points on the geometry; of a depth, what the job's own sees."""
        if self.depth:
            return self.first_marks(level)
        return self.sight.marks(camera, blur=LEVELS[level].blur, points=LEVELS[level].points)

    def first_marks(self, level: int) -> Marks:
        """Those that the job's own camera sees, whatever the photo shows."""
        stage, of = LEVELS[level], [self.scene.seen, self.tracer.key, level]
        camera = self.job.camera
        return kept.recalled("marks", of, lambda: self.sight.marks(camera, blur=stage.blur, points=stage.points))

    @property
    def edges(self) -> Edges:
        """The photo, for `fit.settling`."""
        if self._edges is None:
            photo = self.job.photo
            self._edges = Edges(photo.radiance, photo.usable, self._about)
        return self._edges

    def misfit(self, q, level: int) -> Misfit:
        """The objective about seven numbers, with what the camera sees from there; several ask for the same."""
        camera = self.frame.at(q)
        key = key_of(camera), level
        if key not in self._misfits:
            picture = self.picture(level)
            marks = self.marks(camera, level) if np.any(q) else self.first_marks(level)
            self._misfits[key] = Misfit(picture, marks, camera, shading=LEVELS[level].shading)
        return self._misfits[key]

    def left(self, q) -> Left | None:
        """What speaks against seven numbers; None where too little is seen to say."""
        if not self.shows_light:
            return None
        misfit = self.misfit(q, len(LEVELS) - 1)
        if too_few(misfit):
            return None
        return Left(*misfit.values(self.frame.at(q)))

    def gain(self, q) -> Gain:
        """Of seven numbers over the start, at the finest level."""
        ends, last = (np.zeros(PARAMETERS), q), len(LEVELS) - 1
        misfits, cameras = [self.misfit(end, last) for end in ends], [self.frame.at(end) for end in ends]
        return gained(misfits, *cameras, tile=self.tile)

    @property
    def tile(self) -> float:
        """Pixels, edge of the squares whose points are one witness."""
        return min(TILE, self.frame.radius / 4)

    def follow(self, q, level: int, free) -> np.ndarray:
        """Seven numbers refined at one level, with marks made anew as long as they move."""
        for _ in range(LEVELS[level].rounds):
            before, q = q, refined(self.misfit(q, level), self.frame, q, free=free)
            if np.linalg.norm(q - before) < STILL:
                break
        return q

    def settle(self, q, *, hold: float, about=None, level: int = len(LEVELS) - 1) -> Settled:
        """Seven numbers near ``q`` whose outlines lie on the photo's edges; ``about``, ``hold`` : `fit.settling`."""
        misfit = self.misfit(q, level)
        return settled(misfit, self.edges, self.frame, q, about=about, free=HELD, tile=self.tile, hold=hold)

    def asks(self, q) -> bool:
        """Whether outlines and shading ask at once for another camera than that of seven numbers."""
        misfit, before = self.misfit(q, FIRST_LEVEL), self.frame.at(q)
        steps = first_steps(misfit, self.frame, q, free=HELD, steps=FIRST_STEPS)
        after = self.frame.at(steps)
        moved = np.linalg.norm(after.project(misfit.surface) - before.project(misfit.surface), axis=1).mean()
        gain = gained([misfit], before, after, tile=self.tile)
        return bool(moved >= OFF and gain.outline + gain.shading >= LEAST_GAIN)

    @property
    def first_settled(self) -> Settled:
        """How the photo's edges lie beside the outlines of the job's camera, and where these would settle at once."""
        return self.settle(np.zeros(PARAMETERS), hold=FIRM, level=FIRST_LEVEL)

    def nearby(self) -> np.ndarray | None:
        """Seven numbers within a few pixels whose outlines lie on the photo's edges, that go better with outlines and
        shading, and ask for no other camera; None where there are none."""
        start = q = np.zeros(PARAMETERS)
        for hold in HOLDS:
            q, rests = self.at_rest(q, about=start, hold=hold)
            if rests and self.gain(q).significance > AGREED and not self.asks(q):
                return q
        return None

    def at_rest(self, q, *, about, hold: float) -> tuple[np.ndarray, bool]:
        """Where seven numbers settle, with marks made anew as long as they move, and whether they come to rest."""
        for share in SETTLINGS:
            step = share * (self.settle(q, about=about, hold=hold).q - q)
            q = q + step
            if np.linalg.norm(step) < AT_REST:
                return q, True
        return q, False

    def search(self, before: Left) -> tuple[np.ndarray, Left]:
        """The best seven numbers, and what speaks against them."""
        start, held = np.zeros(PARAMETERS), SHIFTS if self.depth else HELD
        shifts = best_shifts(self.misfit(start, 0), self.frame, step=4.0, keep=STARTS, apart=5.0)
        starts = [start, *(q for q in shifts if q.any())]
        for level in (0, 1):
            ends: list = []
            for q in starts:
                q = self.follow(q, level, held)
                if all(np.linalg.norm(q - other) > APART for other in ends):
                    ends.append(q)
            judged = [(q, self.left(q)) for q in ends]
            known = sorted((before.better(left), i) for i, (_, left) in enumerate(judged) if left is not None)
            starts = [ends[i] for _, i in known[: -KEPT - 1 : -1]] or [start]
        best = self.follow(starts[0], 2, held)
        left = self.left(best)
        if left is None:
            return start, before
        if self.depth:
            return best, left
        zoomed = self.follow(best, 2, FREE)
        other = self.left(zoomed)
        if other is not None and left.better(other) > ZOOM_GAIN:
            best, left = zoomed, other
        best = self.at_rest(best, about=best, hold=FREER)[0]
        return best, self.left(best) or left


def too_few(points) -> bool:
    """Whether Marks, or a Misfit, have too few points to say anything."""
    return len(points.outline) < LEAST_OUTLINE or len(points.surface) < LEAST_SURFACE
