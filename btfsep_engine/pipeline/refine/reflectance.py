# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether an object is its material, or only nearly: a rougher, glossier or duller one where the evidence asks for it.

Nothing is as Lambert has it, and light can imitate what a surface departs from it by: beside an ideal material those
near it (`btf.departures`) are always tried. A measured one is doubted only where the misfit looks like shading
(`fit.diagnose`, "diffuse"), which is what a wrong balance of matte and gloss leaves over. The material of the largest
evidence, its prior counted, stands for the object in the fit. But roughness and a natural sky imitate each other, and
the evidence cannot always tell: a departure is believed only where it makes the light simpler: a plain one with
lamps, or one with lamps and far fewer effective unknowns. Objects are looked at one by one, the largest first; each
departure is tried on a few of the pixels, under a field alone, before it is on all.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine import sh
from btfsep_engine.btf.departures import departures
from btfsep_engine.fit.diagnose import effect
from btfsep_engine.fit.search import Solution
from btfsep_engine.fit.stated import Fit
from btfsep_engine.pipeline.together import SolvedLight, all_weights, fit_together, light_solver, stacked

SPEAKS = 12.0  # chi^2 of the misfit's likeness to shading: half of what is warned of
SIMPLER = 0.75  # of the effective unknowns
CLEARLY = 3.0  # of the logarithm of the evidence: less is not worth a departure
# Of 158 photographs (by Cycles, and of real objects) so many pixels, under a field alone, see -1.0 to 6.8 of the
# evidence, the prior counted, of what is believed; of what is not, 2.2 and less, mostly less than is tried.
FEW, HOPEFUL = 500, -2.5


def shading_left(problems, light: SolvedLight) -> float:
    """chi^2 of how much the misfit looks like what a matte surface would show."""
    fit, solver = light.fit, light.solver
    normals = np.concatenate([p.normals for p in problems])
    weight = 1 / solver.basis.response
    column = solver.smoother(fit)(sh.irradiance(fit.shown[:9], normals)) * weight
    left = (light.radiance(problems) - solver.basis.predicted(fit.shown)) * weight
    return effect(left, column[None], stacked(problems)[1]).chi2


def is_simpler(trial: Fit, fit: Fit) -> bool:
    """Whether a fit's light is of lamps and plain, or has far fewer effective unknowns than another's.

    Under light without a lamp roughness only makes all of it a little brighter: nothing could tell.
    """
    model = trial.election.solution.model
    fewer = trial.effective_degrees_of_freedom < SIMPLER * fit.effective_degrees_of_freedom
    return bool(model.lamps) and (model.field.order == 0 or fewer)


def nearer_materials(model, light):
    """The refinement: materials near each object's, by the kernel and with mean ABRDFs."""
    by = model.problems[0].transport["by"]
    if model.settings.estimator != "map" or by != "kernel" or model.appearance != "mean":
        return model, light, {}
    if model.settings.departures == "never":
        return model, light, {"reflectance": "as in the library: --departures never"}
    with model.reporter.stage("reflectance"):
        return _nearer(model, light)


def fewer(problems, count: int, seed: int) -> list:
    """The problems of a view with ``count`` points together, drawn by chance; those with less than twice so many."""
    sizes = [len(p.pixels) for p in problems]
    if sum(sizes) < 2 * count:
        return problems
    used = np.zeros(sum(sizes), bool)
    used[np.random.default_rng(seed).choice(len(used), count, replace=False)] = True
    return [p.subset(part) for p, part in zip(problems, np.split(used, np.cumsum(sizes)[:-1]), strict=True)]


def field_alone(problems, light: SolvedLight, settings, *, start: Solution | None = None) -> Solution:
    """A light's photographs under a field alone; ``start`` : as the materials are in the library."""
    solver = light_solver(problems, settings)
    return solver.field_alone(light.radiance(problems), weights=all_weights(problems), beside=light.fit, start=start)


def with_material(problems, index: int, material, settings) -> list:
    """The problems with another material for one of the objects."""
    return [
        p.of_materials([material if j == index else m for j, m in enumerate(p.materials)], settings) for p in problems
    ]


def _nearer(model, light):
    problems, settings = model.problems, replace(model.modelled, order=light.order)
    ideal = [m.matte_albedo is not None for m in problems[0].materials]
    speaks = not all(ideal) and shading_left(problems, light) > SPEAKS
    doubted = [(speaks or each) and m.dye is None for each, m in zip(ideal, problems[0].materials, strict=True)]
    if not any(doubted):
        return model, light, {"reflectance": "as in the library: what is left over does not look like shading"}
    sizes, departed = np.sum([[len(p) for p in problem.points] for problem in problems], 0), {}
    for i in (i for i in np.argsort(-sizes) if doubted[i]):
        few = fewer(problems, FEW, settings.seed)
        some = None if few is problems else field_alone(few, light, settings)
        largest, better, hopeful = light.fit.evidence + CLEARLY, None, True
        for near in departures(problems[0].materials[i]):
            if near.further and not hopeful:
                continue
            if some is not None:
                seen = field_alone(with_material(few, i, near.material, settings), light, settings, start=some)
                hopeful = seen.evidence + near.log_prior >= some.evidence + HOPEFUL
                if not hopeful:
                    continue
            trial = with_material(problems, i, near.material, settings)
            answer = fit_together(trial, settings, beside=light.fit)
            evidence = answer.fit.evidence + near.log_prior
            if evidence > largest and is_simpler(answer.fit, light.fit):
                largest, better = evidence, (near, trial, answer)
        if better is not None:
            departed[i], problems, light = better
    if not departed:
        why = "as in the library: none of the materials near it explains the photo better"
        return model, light, {"reflectance": why}
    objects = problems[0].scene.job.objects
    each = [f"'{objects[i].name}' with {near.description}" for i, near in departed.items()]
    why = f"nearly the library's: {', '.join(each)} (by evidence)"
    near = {int(i): d.material for i, d in departed.items()}
    return replace(model, looks={model.appearance: problems}, departed=near), light, {"reflectance": why}
