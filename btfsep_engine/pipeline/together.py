# SPDX-License-Identifier: GPL-3.0-or-later
"""One light for several photographs: the same unknowns, each photo with its own exposure.

Photo k shows e_k A_k x. The exposure of the first is 1, so that the light is in its scale; the others are found by
turns: with the light known, e_k is a projection; with the exposures known, the light is one fit of b_k / e_k. Basis
images do not change, so that they are factorised once and a turn takes milliseconds.
"""

from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from btfsep_engine import sh
from btfsep_engine.btf.surfaces import GIVEN
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.fit.least_squares import solve
from btfsep_engine.fit.log_normal import LightSolver
from btfsep_engine.fit.stated import Fit
from btfsep_engine.job.load import SAME_LAMP
from btfsep_engine.pipeline.problem import Problem
from btfsep_engine.pipeline.settings import FitSettings
from btfsep_engine.render.reach import response
from btfsep_engine.storage import kept

TURNS = 30
SETTLED = 1e-4  # relative change of an exposure
ELECTED_ANEW = 0.1  # as such: the light was of another photograph
APART = 1 << 30  # blocks' numbers of one photo
HIDING = 400  # directions, 10 degrees apart, in which is asked whether light comes from there,
REACHES = 5e-4  # more of it than that, of the largest: as good as none. Where less than 0.01 comes, edges show still


@dataclass(frozen=True)
class SolvedLight:
    """The light of a list of Problems.

    Attributes
    ----------
    fit : Fit
    solver : its LightSolver; None for least squares
    exposures : of each photograph over the first's
    near : (direction, light.sun.Near) of each lamp that stands near
    suns : light.sun.Sun, the lamps that are told apart from the sky, the brightest first
    alone : the fit of the objects alone, where ``fit`` is of what is seen of the ground, too; else None
    """

    fit: Fit
    solver: LightSolver | None
    exposures: list
    near: tuple = ()
    suns: tuple = ()
    alone: Fit | None = None

    @property
    def of_objects(self) -> Fit:
        """The fit of the objects alone."""
        return self.alone or self.fit

    @property
    def order(self) -> int:
        """That is reported."""
        return sh.order_of(len(self.fit.coefficients))

    def radiance(self, problems: list[Problem]) -> np.ndarray:
        """(p, 3) float64 of all photographs, in the first one's exposure: what is fitted."""
        return np.concatenate([p.radiance() / e for p, e in zip(problems, self.exposures, strict=True)])

    def left_over(self, problems: list[Problem]) -> np.ndarray:
        """(p, 3) of all photographs, in the first one's exposure: what the light does not explain."""
        return self.radiance(problems) - np.concatenate([p.predicted(self.fit.shown) for p in problems])

    def share_left(self, problems: list[Problem]) -> float:
        """What the light does not explain, over what is fitted."""
        count = np.sqrt(counts(problems))[:, None]
        left, all_of_it = (np.linalg.norm(count * v) for v in (self.left_over(problems), self.radiance(problems)))
        return float(left / max(all_of_it, 1e-300))


def light_solver(problems: list[Problem], settings: FitSettings, *, coarsening: float = 1.0) -> LightSolver:
    """The basis images of all photos together made ready, for the estimator with a prior."""
    order = min(settings.order, settings.fit_order)
    coarsening *= max(p.coarsening for p in problems)
    given, hidden = given_lamps([p.scene.job for p in problems]), hidden_directions(problems)
    things = things_of(problems)

    def made() -> LightSolver:
        normals = np.concatenate([p.normals for p in problems])
        how = {"order": order, "seed": settings.seed, "coarsening": coarsening, "given": given, "hidden": hidden}
        return LightSolver(stacked(problems)[0], normals=normals, parts=things, **how)

    parts = [[a, p.normal] for problem in problems for a, p in zip(problem.basis, problem.points, strict=True)]
    of = [parts, [] if things is None else things, order, settings.seed, float(coarsening), list(given)]
    of.append([] if hidden is None else hidden)
    solver = kept.recalled("solver", of, made)
    solver = solver if (dye := common_dye(problems)) is None else solver.with_dye(dye)
    solver = solver.with_stated_colour() if stated_colour(problems) else solver
    solver = solver.with_vivid() if any(p.vivid for p in problems) else solver
    known = counts(problems)
    if np.ptp(known):
        solver = solver.with_departing(np.sqrt(known.max() / known))
    return solver if (slopes := all_slopes(problems)) is None else solver.with_slopes(slopes)


def parts_of(problems: list[Problem]) -> np.ndarray | None:
    """(p,) int, the number of the object of each pixel, in every photograph another; None of one alone."""
    sizes = [len(points) for p in problems for points in p.points if len(points)]
    return None if len(sizes) == 1 else np.repeat(np.arange(len(sizes)), sizes)


def things_of(problems: list[Problem]) -> np.ndarray | None:
    """(p,) int, the number of the object of each pixel, the same in every photograph; None of one alone.

    One of the same name and of the same faces is the same, wherever it stands.
    """
    known, numbers, sizes = [], [], []
    for problem in problems:
        for thing, points in zip(problem.scene.job.objects, problem.points, strict=True):
            if not len(points):
                continue
            same = (i for i, o in enumerate(known) if o.name == thing.name)
            number = next((i for i in same if np.array_equal(known[i].mesh.faces, thing.mesh.faces)), len(known))
            known += [thing] * (number == len(known))
            numbers.append(number)
            sizes.append(len(points))
    return None if len(known) == 1 else np.repeat(numbers, sizes)


def hidden_directions(problems: list[Problem]) -> np.ndarray | None:
    """(m,) bool, from which of as many directions of `fibonacci_sphere` no light reaches what the photos show.

    None where nothing stands around it: what its own other side hides, its edges show.
    """
    if not any(p.scene.job.occluders for p in problems):
        return None
    directions = fibonacci_sphere(HIDING)
    hidden = np.ones(HIDING, bool)
    for problem in problems:
        for points in filter(len, problem.points):
            of = [problem.scene.tracer.key, points.position, points.flat_normal]
            found = kept.recalled("reach", of, partial(response, problem.scene.tracer, points, directions))
            hidden &= found < REACHES
    return hidden if hidden.any() and not hidden.all() else None


def common_dye(problems: list[Problem]):
    """The `dye` of all objects' materials; None where they have none, or several."""
    each = {m.dye for p in problems for m in p.materials}
    return each.pop() if len(each) == 1 else None


def stated_colour(problems: list[Problem]) -> bool:
    """Whether the job says of all objects by numbers or images what colour they have."""
    return all(m.name == GIVEN for p in problems for m in p.materials)


def given_lamps(jobs) -> tuple:
    """Direction and standard deviation in degrees of the lamps that jobs know of, each once."""
    out: list = []
    for lamp in (lamp for job in jobs for lamp in job.known_lamps):
        if not any(lamp.direction @ direction > np.cos(np.radians(SAME_LAMP)) for direction, _ in out):
            out.append((lamp.direction, lamp.degrees))
    return tuple(out)


def all_weights(problems: list[Problem]):
    """(p, 3) of all photos, None where none has any."""
    if all(p.weights is None for p in problems):
        return None
    return np.concatenate([np.ones((len(p.blocks), 3)) if p.weights is None else p.weights for p in problems])


def counts(problems: list[Problem]) -> np.ndarray:
    """(p,), how much each pixel of all photos counts beside those of other objects (`Problem.counts`)."""
    return np.concatenate([np.repeat(p.counts_of_each, [len(points) for points in p.points]) for p in problems])


def all_slopes(problems: list[Problem]):
    """(p, k, 3) of all photos, each moved by itself; None where none has any."""
    if all(p.slopes is None for p in problems):
        return None
    each = [np.zeros((len(p.pixels), 0, 3)) if p.slopes is None else p.slopes for p in problems]
    ends = np.cumsum([0, *(s.shape[1] for s in each)])
    return np.concatenate(
        [np.pad(s, ((0, 0), (a, ends[-1] - b), (0, 0))) for s, (a, b) in zip(each, pairwise(ends), strict=True)]
    )


def stacked(problems: list[Problem]):
    """Basis images (p, terms, 3) and blocks (p,) of all photos; one photo's are not copied."""
    if len(problems) == 1:
        return problems[0].all_basis, problems[0].blocks
    blocks = np.concatenate([p.blocks + i * APART for i, p in enumerate(problems)])
    return np.concatenate([p.all_basis for p in problems]), blocks


def fit_together(problems: list[Problem], settings: FitSettings, *, beside: Fit | None = None) -> SolvedLight:
    """The light of all photographs; ``settings`` : with a number as ``order``.

    ``beside`` : a fit of the same photographs, whose evidence is to be compared with this one's
    """
    solver = light_solver(problems, settings) if settings.estimator == "map" else None
    basis, blocks = (None, None) if solver else stacked([p.up_to(settings.order) for p in problems])
    light, weights, start = SolvedLight(None, solver, [1.0] * len(problems)), all_weights(problems), None
    for _ in range(TURNS if len(problems) > 1 else 1):
        b, before = light.radiance(problems), light
        if solver:
            fit = solver.solve(b, weights=weights, start=start, beside=beside)
        else:
            fit = solve(basis, b, blocks=blocks)
        factors = [exposure_of(p, fit) for p in problems]
        light = SolvedLight(fit, solver, [e / factors[0] for e in factors])  # what all photos miss alike is no exposure
        change = max(abs(a / e - 1) for a, e in zip(before.exposures, light.exposures, strict=True))
        if change < SETTLED:
            break
        start = None if change > ELECTED_ANEW else fit
    return light


def followed(problems: list[Problem], light: SolvedLight, settings: FitSettings) -> Fit:
    """The fit of photographs, in the exposures of a ``light`` of much the same, by that light's own model.

    What a trial is worth is known by it, in a third of the time of `fit_together`: in seven trials of another limb on
    photographs by Cycles the evidence was within 0.4 of an election's.
    """
    solver = light_solver(problems, settings)
    return solver.follow(light.radiance(problems), light.fit, weights=all_weights(problems), beside=light.fit)


def exposure_of(problem: Problem, fit: Fit) -> float:
    """The factor on the light that explains a photo best, least squares, > 0."""
    predicted = problem.predicted(fit.shown)
    factor = float((predicted * problem.radiance()).sum() / max(float(np.square(predicted).sum()), 1e-300))
    return max(factor, 1e-6)
