# SPDX-License-Identifier: GPL-3.0-or-later
"""What every part of the benchmark shares: the object, the camera, clocks, and words for seconds."""

import time
from pathlib import Path

import numpy as np
import trimesh

from btfsep_engine.render import surface
from btfsep_engine.render.sampling import spread
from btfsep_engine.render.tracer import Tracer
from btfsep_engine.render.transport import Transport
from tests.render.scenes import as_mesh, job_of, looking_down

ROOT = Path(__file__).resolve().parent.parent.parent
MATERIALS = ("leather/brown-grain", "fabric/denim-twill", "wood/walnut-lacquered")
METRES = 0.01  # of a world unit: a texel is larger than a pixel, whichever way it is filtered
WARM = 4000  # pixels of an estimate
COLOURS = ("#1f5f8b", "#c0532b", "#5a7d2a")


def dented(level: int):
    """A sphere with dents, of 20 * 4^level triangles: a trimesh shape of about unit radius."""
    ball = trimesh.creation.icosphere(min(level, 5))
    for _ in range(level - 5):
        vertices, faces = trimesh.remesh.subdivide(ball.vertices, ball.faces)
        ball = trimesh.Trimesh(vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces, process=False)
    x, y, z = ball.vertices.T
    waves = np.sin(5 * x + 1) * np.sin(5 * y + 2) * np.sin(5 * z + 0.5)
    ball.vertices = ball.vertices * (0.85 + 0.22 * waves)[:, None]
    return ball


class Stage:
    """The object before a camera of ``size`` x ``size`` pixels.

    Attributes
    ----------
    built : (2,) seconds that loading the mesh and building its tree of boxes took, as :func:`timed` has them
    """

    def __init__(self, *, level: int, size: int, textured: bool):
        self.shape = dented(level)
        self.job = job_of([as_mesh(self.shape)], looking_down(size, 1.55 * size), metres_per_unit=METRES)
        self.built, self.tracer = timed(lambda: Tracer([self.job.objects[0].mesh]))
        points = surface.surface_points(surface.camera_view(self.tracer, self.job), self.job, 0)
        self.points = surface.with_texture(points, self.job, 0) if textured else surface.with_any_tangent(points)

    def some(self, count: int = WARM):
        """About ``count`` of the points, spread over the picture."""
        return self.points.take(spread(self.points, count))

    def transport(self, points, directions: int) -> Transport:
        return Transport(self.tracer, points, directions=directions, millimetres_per_unit=1000 * METRES)


def timed(function):
    """Seconds of a call, by the clock and of all processors together: (2,), and its result."""
    clock, work = time.perf_counter(), time.process_time()
    result = function()
    return np.array([time.perf_counter() - clock, time.process_time() - work]), result


def seconds_of(function, repeats: int):
    """Medians over a few calls of what :func:`timed` says, after one that is not counted, and the last result."""
    function()
    seconds, results = zip(*(timed(function) for _ in range(repeats)), strict=True)
    return np.median(seconds, 0), results[-1]


def relative(a, b) -> float:
    """Relative L2 difference; b is the truth."""
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def table(head, rows) -> str:
    """A Markdown table: the head's words, and rows of words."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def save(figure, path: Path) -> None:
    """Writes a chart and lets its memory go."""
    from matplotlib import pyplot

    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
    print(f"drew {path}", flush=True)
