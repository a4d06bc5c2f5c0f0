# SPDX-License-Identifier: GPL-3.0-or-later
"""Brings a job's geometry into line with its photo: the camera moves until outlines and shading go together.

A turn that outlines and shading do not show stays: the prior of `fit.pose` holds it. Nothing is moved without a gain.
A depth knows no other side, and is one piece with its mask and its camera: the photo alone is shifted against them.
"""

import copy
from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.errors import InputError
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
from btfsep_engine.job.depth import shifted_mask
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
# For a move. On 16 photographs by Cycles the true camera, moved to where its photo goes best, gains 0.026 of the
# objective at most, one that is a pixel and a degree off 0.036 at least; 2.3 deviations as a rule, and 2.7 and more.
SIGNIFICANT = 3.0  # deviations, of what outlines and shading gain together
TILE = 16.0  # pixels, or a quarter of the objects' radius: neighbours in such a square are one witness
LEAST_GAIN = 0.03  # of the objective: texture and the blur of an edge draw by less
WORSE = 2.0  # deviations by which the shading may become worse; the outlines may not
ZOOM_GAIN = 0.03  # least logarithm that another focal length has to gain beside a move
STARTS, KEPT, APART = 3, 2, 1.5  # shifts to start from beside none; how many go on; pixels between two ways
LEAST_MOVE = 0.3  # pixels of the photo
STILL = 0.1  # pixels: marks are not made anew for a smaller step
# What an estimate looks at first: cameras that are a degree or a pixel off ask for up to 1.3 pixels, true ones up to 1.
FIRST_LEVEL, FIRST_STEPS, OFF = 1, 3, 1.5  # pixels of what is looked at
# Pixels by which the photo's edges lie beside the outlines and need not, and deviations by which outlines and shading
# have to go better, too. Of 288 photographs by Cycles whose camera is in place one has so many pixels, at 0.2 of the
# deviations; of 53 that are a pixel off 38 do, of 56 that are two off 54. 0.45 would find 50 and 56, and move a real
# ball whose edges lie 0.7 pixels beside its mesh under every lamp, which made its light worse. Many edges are believed
# of less: times the root of their number, 173 in place have at most 1.6 such pixels, that ball 1.95; 34 of 36 plates
# that are a pixel off have 2 and more, or 0.6 of them.
BESIDE, AGREED = 0.6, 0.5
SURELY, BY_MANY = 0.45, 2.0
# Pixels below which edges say that a camera is in place, and how many have to say so: of 45 plates in place all have
# fewer than 0.34, of 36 that are a pixel off two; edges are 5 and more.
IN_PLACE, ENOUGH = 0.34, 4.0
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


@dataclass(frozen=True)
class Alignment:
    """What was found.

    Attributes
    ----------
    camera : of the whole photo; the job's own unless ``aligned``
    why : in words
    moved_px : mean way of what is seen, in the photo's pixels; degrees : of the camera about the objects
    focal_percent : change of the focal length
    before, after : Left, or None where nothing could be measured
    gain : of the place that was found, taken or not; None where nothing could be measured
    shift : of a depth, pixels to the right and down by which the photo shows it elsewhere; None: the job has meshes
    settled : whether it was found within a few pixels, by the photo's edges, and no search was needed
    """

    camera: Camera
    aligned: bool
    why: str
    moved_px: float = 0.0
    degrees: float = 0.0
    focal_percent: float = 0.0
    before: Left | None = None
    after: Left | None = None
    gain: Gain | None = None
    shift: tuple[float, float] | None = None
    settled: bool = False


def camera_keys(camera: Camera) -> dict:
    """What an alignment changes of a job's ``camera``."""
    return {"fx": camera.fx, "fy": camera.fy, "to_world": camera.to_world.tolist()}


def with_camera(scene: PreparedScene, camera: Camera) -> PreparedScene:
    """The same scene seen by another camera, of a picture of the same size; the mask of a depth goes with it.

    InputError where an object is not seen.
    """
    out, objects, old = copy.copy(scene), scene.job.objects, scene.job.camera
    if unseen_meshes(scene.job):
        way = camera.cx - old.cx, camera.cy - old.cy
        objects = tuple(replace(o, mask=None if o.mask is None else shifted_mask(o.mask, *way)) for o in objects)
    out.job = replace(scene.job, camera=camera, objects=objects)
    out.look()
    return out


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
        if _too_few(misfit):
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


@dataclass(frozen=True)
class Look:
    """What a first look at a scene says of its camera.

    Attributes
    ----------
    off : whether outlines and shading ask for another at once
    beside : pixels by which the photo's edges lie beside the outlines and need not; edges : how many say so
    """

    off: bool = False
    beside: float = 0.0
    edges: float = 0.0

    @property
    def settles(self) -> bool:
        """Whether outlines have to settle on the photo's edges."""
        by_many = self.beside >= SURELY and self.beside * np.sqrt(self.edges) >= BY_MANY
        return bool(self.beside >= BESIDE or by_many)

    @property
    def in_place(self) -> bool:
        """Whether the photo's edges say that the camera is in place."""
        return not self.off and self.beside < IN_PLACE and self.edges >= ENOUGH


def first_look(scene: PreparedScene) -> Look:
    """What says, in a thirtieth of the time, that `align` may find another camera. Of a depth it is the outline alone
    that says so (`checks.shift_doubt`)."""
    if unseen_meshes(scene.job):
        return Look()
    photo, start = scene.job.photo, np.zeros(PARAMETERS)

    def look() -> Look:
        aligner = Aligner(scene)
        if not aligner.shows_light or _too_few(aligner.first_marks(FIRST_LEVEL)):
            return Look()
        if _too_few(aligner.misfit(start, FIRST_LEVEL)):
            return Look()
        first = aligner.first_settled
        return Look(aligner.asks(start), first.excess, first.edges)

    return kept.recalled("first look", [photo.radiance, photo.usable, scene.seen, scene.tracer.key], look)


def looks_off(scene: PreparedScene) -> bool:
    """Whether a first look says that the camera may be another."""
    look = first_look(scene)
    return look.off or look.settles


def align(scene: PreparedScene) -> Alignment:
    """Looks for the camera that took a scene's photo, near the job's own; of a depth, for the shift of its photo."""
    camera = scene.job.camera
    aligner = Aligner(scene)
    few = _too_few(aligner.first_marks(len(LEVELS) - 1))  # as of a picture of one row, which has no edges to look at
    before = None if few else aligner.left(np.zeros(PARAMETERS))
    if before is None:
        return Alignment(
            camera, False, "left as it is: the picture shows too little of the objects' outline or surface"
        )
    near = aligner.nearby() if first_look(scene).settles else None
    q, after = aligner.search(before) if near is None else (near, aligner.left(near))
    end, first = aligner.frame.at(q), aligner.frame.camera
    seen = aligner.marks(first, len(LEVELS) - 1).surface
    moved = np.linalg.norm(end.project(seen) - first.project(seen), axis=1).mean() * camera.fx / first.fx
    zoom = end.fx / first.fx
    degrees = np.degrees(np.linalg.norm(q[:3]) / aligner.frame.radius)  # 0 of a depth, as the zoom
    gain = aligner.gain(q)
    still = (0.0, 0.0) if aligner.depth else None
    stays = Alignment(camera, False, "", before=before, after=after, gain=gain, shift=still)
    if moved < LEAST_MOVE:
        return replace(
            stays, why=f"left as it is: it lies within {LEAST_MOVE} pixels of where it goes best", after=before
        )
    clear = gain.significance >= SIGNIFICANT and gain.outline + gain.shading >= LEAST_GAIN
    if near is None and (not clear or gain.outline < 0 or gain.shading_significance < -WORSE):
        return replace(stays, why=f"left as it is: no place nearby goes clearly better ({_words(before, after)})")
    shift = tuple(float(s) for s in camera.fx / first.fx * q[3:5]) if aligner.depth else None
    found = replace(camera, fx=camera.fx * zoom, fy=camera.fy * zoom, to_world=end.to_world)
    found = camera.shifted(*shift) if shift else found
    try:
        with_camera(scene, found)
    except InputError as error:
        return replace(stays, why=f"left as it is: after the move, {error}")
    better = "the photo's edges lay beside the outlines"
    if near is None:
        better = f"outlines and shading go better, by {gain.significance:.1f} deviations"
    why = f"moved: {better} ({_words(before, after)})"
    zoomed = 100 * float(zoom - 1)
    moved, degrees = float(moved), float(degrees)
    return Alignment(found, True, why, moved, degrees, zoomed, before, after, gain, shift, settled=near is not None)


def _too_few(points) -> bool:
    """Whether Marks, or a Misfit, have too few points to say anything."""
    return len(points.outline) < LEAST_OUTLINE or len(points.surface) < LEAST_SURFACE


def _words(before: Left, after: Left) -> str:
    return (
        f"outline without an edge {100 * before.outline:.0f} % before, {100 * after.outline:.0f} % after; "
        f"shading's residual {100 * before.shading:.1f} % before, {100 * after.shading:.1f} % after"
    )
