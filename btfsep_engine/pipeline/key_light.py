# SPDX-License-Identifier: GPL-3.0-or-later
"""A key light (a sun, a lamp) split off the series as one beam, where the photo says that there is one.

1. 512 directions over the sky are asked (`fit.sun.BeamTest`), on a part of the pixels; nothing stands out: done.
2. The best few are looked at from nearby, with rays of their own and all pixels; the beam becomes an unknown of the
   fit, and noise and prior are found anew with it.
3. With these, the neighbourhood is asked again, finer: the direction is the mean of what is probable, and how far that
   spreads is part of the stated uncertainty.
4. Discs of several sizes are asked in place of the point. What is as broad as the series' own resolution is no key
   light: the series can say it.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.fit.least_squares import Fit
from btfsep_engine.fit.map_estimate import LightSolver
from btfsep_engine.fit.sun import BeamTest, cap_around, over_the_sky, split_fit, with_beam
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.light.natural import natural_prior
from btfsep_engine.light.sun import Sun, beam_shape
from btfsep_engine.pipeline.together import stacked
from btfsep_engine.render.beams import beam_radiance

SKY = 512  # directions, 9 degrees apart
SCREENED = 1500  # pixels that are asked first
ENOUGH = 6.0  # logarithm of the evidence ratio that is asked for, a beam from anywhere against none
HOPELESS = 0.0  # in the first pass, below which nothing is looked at from nearby
PEAKS, APART = 3, np.cos(np.radians(20))
NEAR, NEAR_COUNT = np.radians(10), 24
FINE, FINE_COUNT = np.radians(5), 48
HALF_ANGLES = np.radians([0.0, 1.5, 3.0, 5.0, 8.0, 12.0, 18.0, 25.0])
DISC_COUNT = 12
BROADEST = np.radians(12.5)  # half of the narrowest blur that order 9 resolves (`light.positivity`)
CLEARLY = 2.0  # of the logarithm of the evidence: a size that is worse by more is not possible any more
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
            for points, material, basis in zip(problem.points, used, problem.basis, strict=True):
                few = points.take(slice(None, None, every)) if every > 1 else points
                extra = None
                if problem.transport["bounces"] > 1:  # smooth, so that the series holds a beam's
                    lights = SHBasis(sh.order_of(basis.shape[1]))
                    count = problem.transport["directions"]
                    extra = basis[::every] - problem.scene.radiance(few, material, lights, directions=count)
                self.parts.append((problem.scene, few, material, extra))

    def __call__(self, directions) -> np.ndarray:
        """(p, n, 3) float32 per unit irradiance from each direction (n, 3)."""
        out = []
        for scene, points, material, extra in self.parts:
            k = beam_radiance(
                scene.tracer, points, material, directions, millimetres_per_unit=scene.millimetres_per_unit
            )
            if extra is not None:
                shapes = sh.evaluate(sh.order_of(extra.shape[1]), directions).T.astype(np.float32)
                k = k + np.stack([np.ascontiguousarray(extra[:, :, c]) @ shapes for c in range(3)], 2)
            out.append(k)
        return np.concatenate(out)


def key_light(problems, materials, fit: Fit, exposures, settings) -> tuple[KeyLight | None, str]:
    """The key light of a photograph, or None; and why, in words.

    Parameters
    ----------
    problems : list of pipeline.problem.Problem, as they were fitted
    materials : for each of them the Material of each object, as in the fit
    fit, exposures : of `together.fit_together`
    settings : Settings
    """
    if settings.key_light == "never":
        return None, "not looked for: --key-light never"
    if settings.estimator != "map" or any(p.transport["by"] != "kernel" for p in problems):
        return None, "not looked for: that needs --estimator map and --transport kernel"
    basis, blocks = stacked(problems)
    b = np.concatenate([p.radiance() / e for p, e in zip(problems, exposures, strict=True)]).astype(np.float64)
    search = Search(basis, blocks, b, fit, settings)
    every = max(1, len(b) // SCREENED)
    sky = fibonacci_sphere(SKY)
    first = search.screen(Responses(problems, materials, every=every)(sky), problems, every)
    if over_the_sky(first) < HOPELESS:
        return None, NONE
    return search.found(Responses(problems, materials), sky, first, [sum(map(len, p.points)) for p in problems])


class Search:
    """Steps 1 to 4 for one photograph's (or several photographs') rows: basis, blocks, b and the Fit without a beam."""

    def __init__(self, basis, blocks, b, fit: Fit, settings):
        self.basis, self.blocks, self.b, self.fit, self.settings = basis, blocks, b, fit, settings
        self.prior = natural_prior(settings.fit_order)
        self.order = sh.order_of(len(fit.coefficients))

    def screen(self, response, problems, every: int) -> np.ndarray:
        """The evidence for a beam from each direction, of a part of the pixels that counts for all."""
        starts = np.cumsum([0, *(len(points) for p in problems for points in p.points)])
        rows = np.concatenate([np.arange(a, z, every) for a, z in pairwise(starts)])
        solver = LightSolver(self.basis[rows], blocks=self.blocks[rows], prior=self.prior, order=self.order)
        solver.coarsening *= len(rows) / len(self.b)
        return BeamTest(solver, self.fit.found, self.b[rows]).ask(response).evidence

    def found(self, responses, sky, evidence, counts) -> tuple[KeyLight | None, str]:
        """The beam near the best of the directions that were screened."""
        solver = LightSolver(self.basis, blocks=self.blocks, prior=self.prior, order=self.order)
        near = np.concatenate([cap_around(d, NEAR, NEAR_COUNT) for d in peaks(sky, evidence)])
        test = BeamTest(solver, self.fit.found, self.b).ask(responses(near))
        direction = near[test.evidence.argmax()]
        _, beside = self._with(responses(direction[None])[:, 0])
        test = BeamTest(solver, beside.found, self.b)
        around = cap_around(direction, FINE, FINE_COUNT)
        asked = test.ask(responses(around))
        if not np.isfinite(asked.evidence).any():
            return None, NONE
        weights = np.exp(asked.evidence - asked.evidence.max())
        cell = 2 * np.pi * (1 - np.cos(FINE)) / FINE_COUNT
        chance = np.log(weights.sum() * cell / (4 * np.pi))  # one direction out of all
        weights /= weights.sum()
        direction = weights @ around
        direction /= np.linalg.norm(direction)
        sizes, images = self._sizes(test, responses, direction)
        best = int(sizes.argmax())
        half = HALF_ANGLES[best]
        with_it, beside = self._with(images[:, best])
        gain = beside.found.evidence - self.fit.found.evidence + chance
        if gain < ENOUGH:
            return None, NONE
        if half > BROADEST:
            return None, (
                "no key light: the brightest part of the light is about "
                f"{2 * np.degrees(half):.0f} degrees wide, which the spherical harmonics can say"
            )
        size = 2 * float(np.degrees(half))
        shapes = np.stack([beam_shape(d, self.prior.order, size_degrees=size) for d in (direction, *around)])
        split = split_fit(
            self.fit,
            with_it,
            beside,
            self.b,
            shapes=shapes,
            weights=np.concatenate([[0.0], weights]),
            positive=self.settings.positive,
        )
        widest = HALF_ANGLES[np.flatnonzero(sizes > sizes.max() - CLEARLY).max()]
        sun = Sun(
            direction,
            split.irradiance,
            split.stddev,
            size_degrees=size,
            angle_degrees=2 * float(np.degrees(widest)),
            evidence=float(gain),
        )
        beam = images[:, best] * split.irradiance
        parts = np.split(beam, np.cumsum(counts)[:-1])
        return KeyLight(sun, split.fit, with_it, split.sky, parts), words(sun, split.fit)

    def _with(self, response):
        """Solver and Fit with a beam."""
        solver = with_beam(self.basis, response, blocks=self.blocks, prior=self.prior, order=self.order)
        return solver, solver.solve(self.b)

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


def words(sun: Sun, fit: Fit) -> str:
    """The key light for people."""
    share = sun.irradiance.mean() / (np.sqrt(4 * np.pi) * fit.coefficients[0].mean())
    height = np.degrees(np.arcsin(np.clip(sun.direction[2], -1, 1)))
    azimuth = np.degrees(np.arctan2(sun.direction[1], sun.direction[0]))
    return (
        f"a key light is split off: {100 * share:.0f} % of the light, from {height:.0f} degrees above the horizon, "
        f"azimuth {azimuth:.0f} degrees (from +X towards +Y), less than {max(sun.angle_degrees, 1.0):.0f} degrees wide "
        f"(logarithm of the evidence {sun.evidence:.0f})"
    )
