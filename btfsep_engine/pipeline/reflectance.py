# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether an object is its material, or only nearly: a rougher, glossier or duller one where the evidence asks for it.

Nothing is as Lambert has it, and light can imitate what a surface departs from it by: beside an ideal material those
near it (`btf.departures`) are always tried. A measured one is doubted only where the misfit looks like shading
(`fit.diagnose`, "diffuse"), which is what a wrong balance of matte and gloss leaves over. The material of the largest
evidence, its prior counted, stands for the object in the fit. But roughness and a natural sky imitate each other, and
the evidence cannot always tell: a departure is believed only where it makes the light simpler: a plain one with
lamps, or one with lamps and far fewer effective unknowns. Objects are looked at one by one, the largest first.
"""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine import sh
from btfsep_engine.btf.departures import departures
from btfsep_engine.fit.diagnose import effect
from btfsep_engine.fit.stated import Fit
from btfsep_engine.pipeline.problem import pose
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.pipeline.together import fit_together, stacked

SPEAKS = 12.0  # chi^2 of the misfit's likeness to shading: half of what is warned of
SIMPLER = 0.75  # of the effective unknowns
CLEARLY = 3.0  # of the logarithm of the evidence: less is not worth a departure


@dataclass(frozen=True)
class Nearer:
    """The fit with the materials that were chosen, and why in words; ``problems`` : with their basis images."""

    problems: list
    fit: Fit
    solver: object
    exposures: list
    why: str


def shading_left(problems, fit: Fit, solver, exposures) -> float:
    """chi^2 of how much the misfit looks like what a matte surface would show."""
    left_of = solver.smoother(fit)
    b = np.concatenate([p.radiance() / e for p, e in zip(problems, exposures, strict=True)]).astype(np.float64)
    normals = np.concatenate([p.normals for p in problems])
    weight = 1 / solver.basis.response
    column = left_of(sh.irradiance(fit.shown[:9], normals)) * weight
    left = (b - solver.basis.predicted(fit.shown)) * weight
    return effect(left, column[None], stacked(problems)[1]).chi2


def simpler(departed: Fit, fit: Fit) -> bool:
    """Whether a fit's light is of lamps and plain, or has far fewer effective unknowns than another's.

    Under light without a lamp roughness only makes all of it a little brighter: nothing could tell.
    """
    plain = departed.election.rival is not None
    fewer = departed.effective_degrees_of_freedom < SIMPLER * fit.effective_degrees_of_freedom
    return bool(departed.lamps) and (plain or fewer)


def nearer_materials(problems, used, fit: Fit, solver, exposures, settings: Settings) -> Nearer:
    """Tries the materials near each object's.

    Parameters
    ----------
    problems : list of pipeline.problem.Problem, as they were fitted
    used : for each of them the Material of each object, as in the fit
    fit, solver, exposures : of `together.fit_together`
    settings : of the fit; its bounces those that the basis images have
    """
    chi2 = shading_left(problems, fit, solver, exposures)
    doubted = [chi2 > SPEAKS or m.matte_albedo is not None for m in used[0]]
    if not any(doubted):
        return Nearer(
            problems, fit, solver, exposures, "as in the library: what is left over does not look like shading"
        )
    sizes = np.sum([[len(p) for p in problem.points] for problem in problems], 0)
    used, said = [list(each) for each in used], []
    for i in (i for i in np.argsort(-sizes) if doubted[i]):
        best, found = fit.evidence + CLEARLY, None
        for near in departures(used[0][i]):
            trial = [[near.material if j == i else m for j, m in enumerate(each)] for each in used]
            posed = [
                replace(p, basis=pose(p.scene, m, p.points, settings).basis)
                for p, m in zip(problems, trial, strict=True)
            ]
            answer = fit_together(posed, settings)
            if answer[0].evidence + near.log_prior > best and simpler(answer[0], fit):
                best, found = answer[0].evidence + near.log_prior, (near, trial, posed, answer)
        if found is not None:
            near, used, problems, (fit, solver, exposures) = found
            said.append(f"'{problems[0].scene.job.objects[i].name}' with {near.words}")
    why = (
        f"nearly the library's: {', '.join(said)} (by evidence)"
        if said
        else ("as in the library: none of the materials near it explains the photo better")
    )
    return Nearer(problems, fit, solver, exposures, why)
