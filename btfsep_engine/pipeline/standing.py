# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that stand on a ground of which the job knows nothing, where the photo shows their shadow on it.

Most things stand on something, and hardly anybody models it. It hides the light from below, and sends some of what
comes from above, which no light from far away imitates: it is dark where the object touches it. So a level plane is
thought under the lowest point, and the photo is asked whether what would be on it is lit as a matte one would be beside
the objects, under whatever light: patches of the sky, each with its shadow, of any strength that is not negative. What
lies behind an object that stands on nothing is seldom so, and never more so than it is merely smooth; what is all alike
says nothing. Then the job has an occluder more, whose surface nobody knows (`refine.surroundings`), and which may be
evidence (`refine.ground`).
"""

import numpy as np
from scipy.linalg import lstsq

from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.job.model import Occluder, TriangleMesh
from btfsep_engine.linear_algebra import product
from btfsep_engine.pipeline.ground_places import FEWEST, places_of
from btfsep_engine.pipeline.refine.seen_colour import sent
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.render.surface import RAYS_AT_ONCE, View
from btfsep_engine.threads import one_thread

NAME = "ground"
STANDS = "standing"  # its name among what is chosen
STANDING = (
    "the objects stand on a ground that the job does not have: the photo shows their shadow on a level plane under "
    "their lowest point, which was taken to be there; put it into the job, to be sure of it (--evidence job leaves it "
    "out)"
)
REACH = 4.0  # half an edge of the plane, in the longest edge of the box around the objects
NEAR = 2.0, 1.3  # so far from the objects' middle, in the same, the photo is asked; a small table has ended sooner
RAYS, PATCHES = 1024, 48  # directions of all, and patches that they are put together to
SIDE = 512  # pixels of a picture in which this is looked for
FOLDS = 4
STEPS = 300  # of the patches' strengths
# Of what varies over the plane's places, squared, what shadows leave over at most; and at most over what a smooth
# picture does. Of 53 plates without a table, of four sets, those that leave so little leave 1.15 times a smooth
# picture's and more; of 75 on a table of one colour 73 are within both, of 64 on patterned ones 49
LEAVE, UNLIKE = 0.5, 0.75
FARTHER = 1.7  # times the least that is left over so: the photo is believed farther off, too
LOWEST = 0.02  # sine of a direction's height: what comes from lower, a plane hardly receives


def ground_under(objects, near: float = NEAR[0]) -> Occluder:
    """A level plane under the lowest point of some `job.model.JobObject`, two triangles, of an unknown surface.

    ``near`` : how far the photo is believed to show it, in the longest edge of the box around the objects
    """
    low, high = _box(objects)
    size = float((high - low).max())
    corners = REACH * size * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    vertices = np.concatenate([corners + (low + high)[:2] / 2, np.full((4, 1), low[2])], 1)
    up = np.zeros((2, 3, 3), np.float32)
    up[..., 2] = 1
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Occluder(TriangleMesh(vertices, faces, up), name=NAME, supposed=near * size)


def _box(objects) -> tuple[np.ndarray, np.ndarray]:
    used = np.concatenate([o.mesh.vertices[np.unique(o.mesh.faces)] for o in objects])
    return used.min(0), used.max(0)


def with_plane(view: View, job, ground: Occluder) -> View:
    """What the camera of a job sees with a `ground_under` its objects, as far as the photo is believed to show it.

    A plane is met where it is: nothing is traced.
    """
    camera, corners = job.camera, ground.mesh.vertices
    edge = corners[2, 0] - corners[0, 0]
    changed = {name: image.copy() for name, image in vars(view).items()}
    changed["mesh"][view.mesh >= len(job.objects)] += 1  # unseen sides are counted after what stands around
    band = max(1, RAYS_AT_ONCE // camera.width)
    for top in range(0, camera.height, band):
        rows = slice(top, min(top + band, camera.height))
        y, x = np.mgrid[rows, : camera.width]
        origins, directions = camera.rays(x.ravel() + 0.5, y.ravel() + 0.5)
        height = corners[0, 2] - origins[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = height / directions[:, 2]
            u, v = ((origins + distance[:, None] * directions - corners[0]) / (corners[2] - corners[0]))[:, :2].T
            near = np.hypot(u - 0.5, v - 0.5) * edge < ground.supposed
        met = (height < 0) & (distance > 0) & near & (distance < view.distance[rows].ravel())
        u, v, second, where = u[met], v[met], (v > u)[met], met.reshape(x.shape)
        changed["mesh"][rows][where], changed["face"][rows][where] = len(job.objects), second
        changed["barycentric"][rows][where] = np.where(second, [1 - v, u, v - u], [1 - u, u - v, v]).T
        changed["distance"][rows][where] = distance[met]
    return View(**changed)


def shown_up_to(scene, ground: Occluder) -> float:
    """How far a scene shows the `ground_under` its objects, its last occluder, lit as beside them: of `NEAR`, or 0.

    Places count as much as they light the objects.
    """
    seen = places_of(scene, len(scene.job.occluders) - 1)
    if seen is None:
        return 0.0
    points, photo = seen
    weight, shown = np.sqrt(sent(points, scene.tracer)), photo.sum(1).astype(np.float64)
    weighted = weight / weight.max(), weight * shown / max(float((weight * shown).max()), 1e-300)
    lit, smooth = weight[:, None] * _lit(scene, points), weight[:, None] * _smooth(points.pixels)
    away = np.linalg.norm((points.position - ground.mesh.vertices.mean(0))[:, :2], axis=1) / ground.supposed
    left = []
    for near in NEAR:
        some = away < near / NEAR[0]
        few = some.sum() < FEWEST
        left.append(np.inf if few else _left_of_smooth(lit[some], smooth[some], *(each[some] for each in weighted)))
    clear = [near for near, one in zip(NEAR, left, strict=True) if one < UNLIKE and one <= FARTHER * min(left)]
    return max(clear, default=0.0)


def _left_of_smooth(lit, smooth, weight, shown) -> float:
    """What shadows leave over of what is shown, over what a smooth picture does; infinite where that is too much.

    By places that neither was found by.
    """
    even = shown - weight * (weight @ shown) / (weight @ weight)
    folds = np.random.default_rng(0).integers(FOLDS, size=len(shown))
    by_shadows, by_smooth = (_left(*each, shown, folds) for each in ((lit, _strengths), (smooth, _fitted)))
    return by_shadows / max(by_smooth, 1e-300) if by_shadows < LEAVE * float(even @ even) else np.inf


def _lit(scene, points) -> np.ndarray:
    """(p, patches): what each patch of the sky gives the points of a level plane, beside the objects."""
    directions, patches = fibonacci_sphere(RAYS), fibonacci_sphere(2 * PATCHES)
    directions = directions[directions[:, 2] > LOWEST]
    nearest = product(directions, patches[patches[:, 2] > 0].T).argmax(1)
    of_patch = np.eye(nearest.max() + 1)[nearest] * directions[:, 2:]
    return product(scene.tracer.visible(points.position, points.flat_normal, directions).astype(np.float64), of_patch)


def _smooth(pixels) -> np.ndarray:
    """(p, 10): polynomials of third degree of pixels (p, 2)."""
    y, x = (pixels / np.abs(pixels).max() - 0.5).T
    return np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], 1)


def _left(columns, fit, shown, folds) -> float:
    """What ``fit`` : (columns, shown) -> strengths leaves over, squared, of each fold by the others."""
    missed = [shown[folds == k] - columns[folds == k] @ fit(columns[folds != k], shown[folds != k]) for k in set(folds)]
    return float(sum(m @ m for m in missed))


def _fitted(columns, shown) -> np.ndarray:
    """x of the least |columns x - shown|."""
    return lstsq(columns, shown)[0]


def _strengths(lit, shown) -> np.ndarray:
    """x >= 0 of the least |lit x - shown|, nearly; neither is negative (Lee and Seung 2001)."""
    gram, goal = product(lit.T, lit), product(lit.T, shown)
    x = np.full(len(goal), max(float(shown.mean()), 1e-12) / max(float(lit.sum(1).mean()), 1e-300))
    for _ in range(STEPS):
        x *= goal / np.maximum(product(gram, x), 1e-300)
    return x


def with_ground(scene, near: float = NEAR[-1]):
    """The scene with a ground under its objects, whatever the photo shows; ``near`` as of `ground_under`."""
    ground = ground_under(scene.job.objects, near)
    return scene.with_occluder(ground, with_plane(scene.view, scene.job, ground))


@one_thread()
def on_ground(scene, settings: Settings):
    """The scene `with_ground`, where the job says nothing of what is around and the photo shows one; else as it is."""
    refused = settings.evidence not in ("auto", "all") or settings.refine != "all"
    if refused or scene.job.occluders or settings.estimator != "map" or settings.transport != "kernel":
        return scene
    with scene.reporter.stage("standing"):
        small = scene.at_most(SIDE)
        ground = ground_under(small.job.objects)
        looked = small.with_occluder(ground, with_plane(small.view, small.job, ground), met=False)
        near = shown_up_to(looked, ground)
        return with_ground(scene, near) if near else scene
