# SPDX-License-Identifier: GPL-3.0-or-later
"""Speed against accuracy: one job estimated with one setting after the other changed, timed warm.

The error is the relative L2 error of the coefficients up to order 2 with one free scale, against a known light or,
where none is known, against the estimate of :data:`THOROUGH`: then it says what a cheaper setting gives away, not how
right the thorough one is. The seconds are those of transport and fit of a scene of which nothing is kept yet, in a
process that has its kernels; reading, geometry and recognition are the same for all.
"""

import statistics
from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine import sh
from btfsep_engine.btf.surfaces import GIVEN
from btfsep_engine.fit.compare import direction_error, relative_l2
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.materials import object_materials
from btfsep_engine.pipeline.settings import MODELLED_BOUNCES, PRESETS, Settings, choose
from btfsep_engine.progress import Reporter
from btfsep_engine.storage import kept

ORDER = 2  # up to which errors are measured
TIMED = ("transport", "fit", "reflectance")  # the materials near the given one are fits, too
THOROUGH = {"pixels": 32_000, "directions": 2048, "bounces": 8}
ONE_BY_ONE = {  # from "balanced", one at a time
    "pixels": [{"pixels": n} for n in (250, 1000, 16_000)],
    "directions": [{"directions": n} for n in (64, 128, 1024)],
    "bounces": [{"bounces": n} for n in (1, 2, 8)],
    "surface samples": [{"surface_samples": n} for n in (1500, 20_000)],
    "appearance": [{"appearance": "textured"}],
    "components": [{"appearance": "textured", "components": n} for n in (1, 4, 8)],
    # the paper's estimator, with the reflections that are part of its renderings
    "estimator, order": [
        {"bounces": MODELLED_BOUNCES, "estimator": "least-squares", "order": n} for n in (2, 3, 4, "auto")
    ],
}


@dataclass(frozen=True)
class Point:
    """One way to estimate.

    Attributes
    ----------
    axis : what was changed, "preset" for the presets, "paper" for the paper's path tracing
    name : how, in words
    seconds : of transport and fit, the median of the warm runs
    error, direction : against the reference light, see the module; degrees
    front : whether no other point is both faster and more accurate
    coefficients : ((order + 1)^2, 3) float64
    """

    axis: str
    name: str
    seconds: float
    error: float
    direction: float | None
    front: bool
    coefficients: np.ndarray


class Fixed:
    """A library of materials that are loaded already, their factors cut to ``components``."""

    def __init__(self, materials, components: int | None):
        self.materials = {m.name: m.material.truncated(components) for m in materials}

    def load(self, name):
        """The material called ``name``."""
        return self.materials[name]


def variations(*, quick: bool = False) -> list[tuple[str, str, dict]]:
    """(axis, name, changes of "balanced") of all points but the paper's path tracing."""
    found = [("preset", name, {"preset": name}) for name in PRESETS]
    for axis, changes in ONE_BY_ONE.items():
        for change in changes[:1] if quick else changes:
            found.append((axis, ", ".join(_words(k, v) for k, v in change.items()), change))
    return found


def _words(key, value) -> str:
    if key == "order":
        return f"order {value}"
    return str(value) if isinstance(value, str) else f"{value:,} {key}".replace("_", " ")


def measure(
    scene,
    library,
    *,
    material=None,
    truth=None,
    repeats: int = 3,
    warm_up: bool = True,
    paper_samples: int = 64,
    quick: bool = False,
    only=None,
) -> dict:
    """Estimates a job in every way of :func:`variations`.

    Parameters
    ----------
    scene : pipeline.scene.PreparedScene
    library : btf.library.Library
    material : a name for all objects, instead of recognition
    truth : (terms, 3) float, the true light, orders 2 or more, or None
    repeats : timed runs of each way; with ``warm_up`` one more before them
    warm_up : False where this process has compiled everything already, for a job like this one
    paper_samples : paths per pixel and basis light of the paper's way, whose error they limit; 0 leaves it out
    quick : fewer points
    only : names of the ways, or None: all

    Returns
    -------
    dict : ``points`` (list of Point), ``reference`` ("truth" or "thorough"), ``materials`` (names)
    """
    reporter = scene.reporter
    names = [material or o.material for o in scene.job.objects]
    materials = object_materials(scene, library, choose("balanced"), names=names)
    given = [
        o if m.name == GIVEN else replace(o, material=m.name, surface=None)
        for o, m in zip(scene.job.objects, materials, strict=True)
    ]
    scene.job = replace(scene.job, objects=tuple(given))
    reference = truth
    if truth is None:
        reference, _ = _timed(scene, Fixed(materials, None), choose("accurate", **THOROUGH))
    ways = [(*way, repeats) for way in variations(quick=quick) if only is None or way[1] in only]
    if paper_samples:
        changes = {"preset": "paper", "transport": "reference", "samples": paper_samples}
        # path tracing is as fast the first time, to a few per cent, and takes minutes
        ways.append(("paper", f"paper, path traced, {paper_samples} samples", changes, 0))
    points = []
    for number, (axis, name, changes, count) in enumerate(ways):
        reporter.progress("chart", number / len(ways), name)
        changes = dict(changes)
        cut = changes.pop("components", None)
        x, seconds = _timed(scene, Fixed(materials, cut), choose(**changes), repeats=count, warm_up=warm_up)
        points.append((axis, name, seconds, *_errors(x, reference), x))
    scene.reporter = reporter
    reporter.progress("chart", 1.0)
    front = pareto_front([p[2] for p in points], [p[3] for p in points])
    points = [Point(*p[:5], bool(f), p[5]) for p, f in zip(points, front, strict=True)]
    return {
        "points": points,
        "reference": "thorough" if truth is None else "truth",
        "materials": [m.name for m in materials],
    }


def _timed(scene, library, settings: Settings, *, repeats: int = 0, warm_up: bool = True):
    """Coefficients and the median seconds of the warm runs (of the only run where ``repeats`` is 0)."""
    seconds, cold = [], bool(repeats and warm_up)
    for _ in range(max(repeats, 1) + cold):
        kept.STORE.forget()  # what a way before this one has left would be found for nothing
        scene.reporter = Reporter()
        found = estimate(scene, library, settings)
        seconds.append(sum(scene.reporter.seconds.get(stage, 0.0) for stage in TIMED))
    return found.lighting.coefficients, statistics.median(seconds[cold:])


def _errors(x, reference):
    terms = min(len(x), len(reference), sh.term_count(ORDER))
    return relative_l2(x[:terms], reference[:terms])["relative_l2_free_scale"], direction_error(x, reference)


def pareto_front(seconds, errors) -> np.ndarray:
    """(n,) bool: points for which no other is at least as fast and as accurate, and better in one of the two."""
    s, e = np.asarray(seconds, np.float64), np.asarray(errors, np.float64)
    no_worse = (s[None] <= s[:, None]) & (e[None] <= e[:, None])
    better = (s[None] < s[:, None]) | (e[None] < e[:, None])
    return ~(no_worse & better).any(1)
