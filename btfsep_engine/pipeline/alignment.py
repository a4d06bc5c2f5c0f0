# SPDX-License-Identifier: GPL-3.0-or-later
"""Brings a job's geometry into line with its photo: the camera moves until outlines and shading go together.

A turn that outlines and shading do not show stays: the prior of `fit.pose` holds it. Nothing is moved without a gain.
A depth knows no other side, and is one piece with its mask and its camera: the photo alone is shifted against them.
"""

import copy
from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.errors import InputError
from btfsep_engine.fit.pose import PARAMETERS, Gain
from btfsep_engine.job.depth import shifted_mask
from btfsep_engine.job.model import Camera
from btfsep_engine.pipeline.aligner import FIRST_LEVEL, LEAST_GAIN, LEVELS, Aligner, Left, too_few
from btfsep_engine.pipeline.scene import PreparedScene, unseen_meshes
from btfsep_engine.storage import kept
from btfsep_engine.threads import one_thread

# For a move. On 16 photographs by Cycles the true camera, moved to where its photo goes best, gains 0.026 of the
# objective at most, one that is a pixel and a degree off 0.036 at least; 2.3 deviations as a rule, and 2.7 and more.
SIGNIFICANT = 3.0  # deviations, of what outlines and shading gain together
WORSE = 2.0  # deviations by which the shading may become worse; the outlines may not
# By how much more of the outlines may have no edge after a move. A real ball, half of it overexposed, was moved by 26
# pixels, from where 39 % have none to where 45 have.
BARER = 0.02
LEAST_MOVE = 0.3  # pixels of the photo
# Pixels by which the photo's edges lie beside the outlines and need not (outlines and shading have to go better, too,
# by `aligner.AGREED`). Of 288 photographs by Cycles whose camera is in place one has so many, at 0.2 of these
# deviations; of 53 that are a pixel off 38 do, of 56 that are two off 54. 0.45 would find 50 and 56, and move a real
# ball whose edges lie 0.7 pixels beside its mesh under every lamp, which made its light worse. Many edges are believed
# of less: times the root of their number, 173 in place have at most 1.6 such pixels, that ball 1.95; 33 of 36 plates
# that are a pixel off have 2 and more, or 0.6 of them.
BESIDE = 0.6
SURELY, BY_MANY = 0.45, 2.0
# Pixels below which edges say that a camera is in place, and how many have to say so: of 45 plates in place all have
# fewer than 0.34, of 36 that are a pixel off two; edges are 5 and more.
IN_PLACE, ENOUGH = 0.34, 4.0


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
        if not aligner.shows_light or too_few(aligner.first_marks(FIRST_LEVEL)):
            return Look()
        if too_few(aligner.misfit(start, FIRST_LEVEL)):
            return Look()
        first = aligner.first_settled
        return Look(aligner.asks(start), first.excess, first.edges)

    return kept.recalled("first look", [photo.radiance, photo.usable, scene.seen, scene.tracer.key], look)


def looks_off(scene: PreparedScene) -> bool:
    """Whether a first look says that the camera may be another."""
    look = first_look(scene)
    return look.off or look.settles


@one_thread()
def align(scene: PreparedScene) -> Alignment:
    """Looks for the camera that took a scene's photo, near the job's own; of a depth, for the shift of its photo."""
    camera = scene.job.camera
    aligner = Aligner(scene)
    few = too_few(aligner.first_marks(len(LEVELS) - 1))  # as of a picture of one row, which has no edges to look at
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
    barer = gain.outline < 0 or after.outline > before.outline + BARER
    if near is None and (not clear or barer or gain.shading_significance < -WORSE):
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


def _words(before: Left, after: Left) -> str:
    return (
        f"outline without an edge {100 * before.outline:.0f} % before, {100 * after.outline:.0f} % after; "
        f"shading's residual {100 * before.shading:.1f} % before, {100 * after.shading:.1f} % after"
    )
