# SPDX-License-Identifier: GPL-3.0-or-later
"""A key light (a sun, a lamp) split off the series as one beam, where the photo says that there is one.

1. Directions all over the sky are asked (`fit.sun.BeamTest`), on a part of the pixels; nothing stands out: done.
2. The best few are looked at from nearby, with rays of their own and all pixels; too little light: done.
3. The beam becomes an unknown of the fit, and noise and prior are found anew with it. With these, the neighbourhood is
   asked again, finer: the direction is the mean of what is probable, and how far that spreads is part of the stated
   uncertainty.
4. Discs of several sizes are asked in place of the point.

A key light is what explains the photo better by far (`ENOUGH`), comes from a small disc (`BROADEST`: what is broader
is light that the series can say, or gloss that the material's model lacks), and is a good part of the light (`LEAST`)
and of what the photo shows (`LEAST_SEEN`: a beam that hardly reaches the pixels could be as strong as it likes).
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.fit.least_squares import Fit
from btfsep_engine.fit.linear_algebra import one_thread
from btfsep_engine.fit.map_estimate import LightSolver
from btfsep_engine.fit.sun import BeamTest, over_the_sky, split_fit, with_beam
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.light.natural import natural_prior
from btfsep_engine.light.sun import Sun, beam_shape, cap_around
from btfsep_engine.pipeline.doubts import THRESHOLDS
from btfsep_engine.pipeline.together import stacked
from btfsep_engine.render.beams import beam_radiance

SKY = 400  # directions, 10 degrees apart
SCREENED = 1000  # pixels that are asked first
STIFF = 2.0  # times the coarsening of an estimate: a series as sharp as can be imitates a beam, and hides it
ENOUGH = 10.0  # logarithm of the evidence ratio that is asked for, a beam from anywhere against none
HOPELESS = -2.0  # of it in the first pass, below which nothing is looked at from nearby
BROADEST = np.radians(10.0)  # half of the disc's width
LEAST = 0.2  # of the light: what is less is no key light
LEAST_SEEN = 0.05  # of the radiance of the pixels; a rim at the silhouette is where geometry is least to be trusted
TOO_LITTLE = 0.05  # of the light, as a first look has it, before noise and prior are found anew
PEAKS, APART = 3, np.cos(np.radians(20))
NEAR, NEAR_COUNT = np.radians(10), 20
FINE, FINE_COUNT = np.radians(6), 40
FINEST, FINEST_COUNT = np.radians(1.5), 16
CENTRED = 3  # times at most that the cap is moved
HALF_ANGLES = np.radians([0.0, 1.5, 3.0, 5.0, 8.0, 12.0, 18.0])
DISC_COUNT = 8
CLEARLY = 2.0  # of the logarithm of the evidence: a size that is worse by more is not possible any more
ALL_OF_IT = np.sqrt(4 * np.pi)  # a beam's irradiance over this is its part of the first coefficient
NONE = "no single direction stands out: all of the light is in the spherical harmonics"


@dataclass(frozen=True)
class KeyLight:
    """A light with a beam in it.

    Attributes
    ----------
    sun : light.sun.Sun
    fit : Fit of all of the light
    solver : LightSolver of series and beam
    sky : (terms, 3), all orders of the series alone
    images : for each photograph (p, 3), what the beam alone makes of its points, at the first photo's exposure
    """

    sun: Sun
    fit: Fit
    solver: LightSolver
    sky: np.ndarray
    images: list


class Responses:
    """The fitted points' radiance under beams, what surfaces send each other included where the basis images have it.

    Parameters
    ----------
    problems : list of pipeline.problem.Problem
    materials : for each of them the Material of each object, as in the fit
    every : only every so many-th point
    """

    def __init__(self, problems, materials, *, every: int = 1):
        self.parts = []
        for problem, used in zip(problems, materials, strict=True):
            for i, (points, material) in enumerate(zip(problem.points, used, strict=True)):
                few = points.take(slice(None, None, every)) if every > 1 else points
                self.parts.append((problem.scene, few, material, self._between(problem, i, few, material, every)))

    @staticmethod
    def _between(problem, i: int, points, material, every: int):
        """What surfaces send each other of each basis light: smooth, so that the series holds a beam's."""
        if problem.transport["bounces"] < 2:
            return None
        if problem.between is not None:
            return problem.between[i][::every]
        basis = problem.basis[i]
        lights, count = SHBasis(sh.order_of(basis.shape[1])), problem.transport["directions"]
        return basis[::every] - problem.scene.radiance(points, material, lights, directions=count)

    def __call__(self, directions) -> np.ndarray:
        """(p, n, 3) float32 per unit irradiance from each direction (n, 3); 0 of one that reaches no point directly.

        Of such a direction only the series' indirect light were left, which is of either sign where it should be none.
        """
        out, lit = [], np.zeros(len(directions), bool)
        for scene, points, material, extra in self.parts:
            k = beam_radiance(
                scene.tracer, points, material, directions, millimetres_per_unit=scene.millimetres_per_unit
            )
            lit |= k.any((0, 2))
            if extra is not None:
                shapes = sh.evaluate(sh.order_of(extra.shape[1]), directions).T.astype(np.float32)
                k = k + np.stack([np.ascontiguousarray(extra[:, :, c]) @ shapes for c in range(3)], 2)
            out.append(k)
        return np.concatenate(out) * lit[:, None]


def key_light(problems, materials, fit: Fit, solver, exposures, settings) -> tuple[KeyLight | None, str]:
    """The key light of a photograph, or None; and why, in words.

    Parameters
    ----------
    problems : list of pipeline.problem.Problem, as they were fitted
    materials : for each of them the Material of each object, as in the fit
    fit, solver, exposures : of `together.fit_together`
    settings : Settings
    """
    if settings.key_light == "never":
        return None, "a key light was not looked for: the preset draft and --key-light never leave that out"
    if settings.estimator != "map" or any(p.transport["by"] != "kernel" for p in problems):
        return None, "a key light was not looked for: that needs --estimator map and --transport kernel"
    basis, blocks = stacked(problems)
    b = np.concatenate([p.radiance() / e for p, e in zip(problems, exposures, strict=True)]).astype(np.float64)
    search = Search(basis, blocks, b, fit, solver, settings)
    every = max(1, len(b) // SCREENED)
    sky = fibonacci_sphere(SKY)
    with one_thread():
        first = search.screen(Responses(problems, materials, every=every)(sky), problems, every)
        if over_the_sky(first) < HOPELESS:
            return None, NONE
        return search.found(Responses(problems, materials), sky, first, [sum(map(len, p.points)) for p in problems])


class Search:
    """Steps 1 to 4 for one photograph's (or several photographs') rows: basis, blocks, b and the fit without a beam."""

    def __init__(self, basis, blocks, b, fit: Fit, solver: LightSolver, settings):
        self.basis, self.blocks, self.b = basis, blocks, b
        self.whole, self.settings = fit, settings
        self.prior = natural_prior(settings.fit_order)
        self.order = sh.order_of(len(fit.coefficients))
        self.coarsening = STIFF * solver.coarsening
        self.solver = LightSolver(basis, blocks=blocks, prior=self.prior, order=self.order, coarsening=self.coarsening)
        self.fit = self.solver.solve(b)

    def screen(self, response, problems, every: int) -> np.ndarray:
        """The evidence for a beam from each direction, of a part of the pixels that counts for all."""
        starts = np.cumsum([0, *(len(points) for p in problems for points in p.points)])
        rows = np.concatenate([np.arange(a, z, every) for a, z in pairwise(starts)])
        solver = LightSolver(
            self.basis[rows],
            blocks=self.blocks[rows],
            prior=self.prior,
            order=self.order,
            coarsening=self.coarsening * len(rows) / len(self.b),
        )
        return BeamTest(solver, self.fit.found, self.b[rows]).ask(response).evidence

    def found(self, responses, sky, evidence, counts) -> tuple[KeyLight | None, str]:
        """The beam near the best of the directions that were screened."""
        near = np.concatenate([cap_around(d, NEAR, NEAR_COUNT) for d in peaks(sky, evidence)])
        images = responses(near)
        asked = BeamTest(self.solver, self.fit.found, self.b).ask(images)
        best = int(asked.evidence.argmax())
        if not (np.isfinite(asked.evidence[best]) and self._part(asked.irradiance[best]) > TOO_LITTLE):
            return None, NONE
        direction = near[best]
        _, beside = self._with(images[:, best])
        test = BeamTest(self.solver, beside.found, self.b)
        around, evidence, area = self._around(test, responses, direction)
        if not np.isfinite(evidence).any():
            return None, NONE
        weights = np.exp(evidence - evidence.max()) * area
        chance = np.log(weights.sum() / (4 * np.pi))  # one direction out of all
        weights /= weights.sum()
        direction = weights @ around
        direction /= np.linalg.norm(direction)
        sizes, images = self._sizes(test, responses, direction)
        best = int(sizes.argmax())
        half = HALF_ANGLES[best]
        if half > BROADEST:
            return None, (
                "no key light: the brightest part of the light is taken to be about "
                f"{2 * np.degrees(half):.0f} degrees wide, which the spherical harmonics can say"
            )
        _, beside = self._with(images[:, best])
        gain = beside.found.evidence - self.fit.found.evidence + chance
        if gain < ENOUGH:
            return None, NONE
        size = 2 * round(float(np.degrees(half)), 3)
        shapes = np.stack([beam_shape(d, self.prior.order, size_degrees=size) for d in (direction, *around)])
        with_it, beside = self._with(images[:, best], stiff=False)
        split = split_fit(
            self.whole,
            with_it,
            beside,
            self.b,
            shapes=shapes,
            weights=np.concatenate([[0.0], weights]),
            positive=self.settings.positive,
        )
        part = split.irradiance.mean() / (ALL_OF_IT * split.fit.coefficients[0].mean())
        if part < LEAST:
            return None, (
                f"no key light: the strongest single direction has about {100 * part:.0f} % of the light, which stays "
                "in the spherical harmonics"
            )
        beam = images[:, best] * split.irradiance
        if beam.mean() < LEAST_SEEN * self.b.mean():
            return None, "no key light: what stands out lights next to nothing of what the photo shows"
        if split.fit.residual > THRESHOLDS.residual:
            return None, (
                "no key light: with one, too, the light explains the photo poorly "
                f"(relative residual {split.fit.residual:.2f})"
            )
        widest = HALF_ANGLES[np.flatnonzero(sizes > sizes.max() - CLEARLY).max()]
        sun = Sun(
            direction,
            split.irradiance,
            split.stddev,
            size_degrees=size,
        )
        parts = np.split(beam, np.cumsum(counts)[:-1])
        return KeyLight(sun, split.fit, with_it, split.sky, parts), words(
            sun, split.fit, widest=2 * np.degrees(widest), gain=gain
        )

    def _part(self, irradiance) -> float:
        """How much of the light a beam is, by the fit without it."""
        return float(irradiance.mean() / (ALL_OF_IT * self.fit.coefficients[0].mean()))

    def _with(self, response, *, stiff: bool = True):
        """Solver and Fit with a beam, as the search's or, not ``stiff``, as an estimate's."""
        solver = with_beam(
            self.basis,
            response,
            blocks=self.blocks,
            prior=self.prior,
            order=self.order,
            coarsening=self.coarsening / (1 if stiff else STIFF),
        )
        return solver, solver.solve(self.b)

    @staticmethod
    def _around(test: BeamTest, responses, direction):
        """Directions (n, 3) about one, the evidence for each (n,), and the solid angle that each stands for (n,).

        A wide cap, about its best direction again while that lies at its edge, and a narrow one about the last.
        """
        for _ in range(CENTRED):
            wide, centre = cap_around(direction, FINE, FINE_COUNT), direction
            asked = test.ask(responses(wide)).evidence
            direction = wide[asked.argmax()]
            if direction @ centre > np.cos(0.7 * FINE):
                break
        narrow = cap_around(direction, FINEST, FINEST_COUNT)
        outside = wide @ direction < np.cos(FINEST)
        cells = [2 * np.pi * (1 - np.cos(a)) / n for a, n in ((FINE, FINE_COUNT), (FINEST, FINEST_COUNT))]
        return (
            np.concatenate([wide[outside], narrow]),
            np.concatenate([asked[outside], test.ask(responses(narrow)).evidence]),
            np.repeat(cells, [outside.sum(), len(narrow)]),
        )

    def _sizes(self, test: BeamTest, responses, direction):
        """The evidence for discs of `HALF_ANGLES`, and their images (p, sizes, 3)."""
        discs = [cap_around(direction, a, DISC_COUNT if a > 0 else 1) for a in HALF_ANGLES]
        ends = np.cumsum([len(d) for d in discs])
        k = responses(np.concatenate(discs))
        images = np.stack([part.mean(1) for part in np.split(k, ends[:-1], axis=1)], 1)
        return test.ask(images).evidence, images


def peaks(sky, evidence) -> list:
    """The best few directions that are not beside each other."""
    out = []
    for j in np.argsort(-evidence):
        if len(out) == PEAKS or evidence[j] < evidence.max() - 20 or not np.isfinite(evidence[j]):
            break
        if all(sky[j] @ d < APART for d in out):
            out.append(sky[j])
    return out


def words(sun: Sun, fit: Fit, *, widest: float, gain: float) -> str:
    """The key light for people."""
    share = sun.irradiance.mean() / (ALL_OF_IT * fit.coefficients[0].mean())
    wide = max(widest, 1.0)
    height = np.degrees(np.arcsin(np.clip(sun.direction[2], -1, 1)))
    azimuth = np.degrees(np.arctan2(sun.direction[1], sun.direction[0]))
    return (
        f"a key light is split off: {100 * share:.0f} % of the light, from {height:.0f} degrees above the horizon, "
        f"azimuth {azimuth:.0f} degrees (from +X towards +Y), less than {wide:.0f} degrees wide "
        f"(logarithm of the evidence {gain:.0f})"
    )
