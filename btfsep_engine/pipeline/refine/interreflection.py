# SPDX-License-Identifier: GPL-3.0-or-later
"""When the light that objects and occluders send each other is worth modelling: no more than the photo needs.

Of the light found without it, one extra image says what the surfaces would send each other: y, at a few hundred pixels,
spread to the others by nearest place and normal (it is smooth). Where that is more of the photo than what a material
that is as good as exact misses, it is modelled. Else the fit of b - y tells what it does to the estimate, as where one
lamp lights one side and the other is dark: where no coefficient moves by more than `MOVES` of its stated standard
deviation, it is left out. Before that, a bound that needs no light: a pixel from which no surface is seen receives
nothing, and none sends more than its albedo.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from btfsep_engine.fit.least_squares import solve
from btfsep_engine.fit.stated import Fit
from btfsep_engine.light.lightings import SHBasis, SHLighting
from btfsep_engine.pipeline.basis import USUAL
from btfsep_engine.pipeline.model import solve_model
from btfsep_engine.pipeline.problem import Problem
from btfsep_engine.pipeline.refine.surroundings import by_photo
from btfsep_engine.pipeline.scene import BRIGHTEST, PreparedScene
from btfsep_engine.pipeline.settings import MODELLED_BOUNCES, Settings
from btfsep_engine.pipeline.together import stacked
from btfsep_engine.render.radiosity import diffuse_albedo
from btfsep_engine.render.sampling import NORMAL_WEIGHT, spread
from btfsep_engine.render.surface import SurfacePoints
from btfsep_engine.storage import kept

WORTH = 0.02  # of the photo: `fit.search.EXACT`. How far the estimate moves is not all: of light that the photo hardly
# shows, as from below a table, so little is known that a fifth of the photo moves it by less than what is stated
MOVES = 0.25  # stated standard deviations: a bias of that size is not in them; to model it costs a tenth of a second
NEGLIGIBLE = 0.003  # of the sky's light: below any misfit
AGAINST = 5.0  # of the logarithm of the evidence
# What is so much of a photo shows in it: of 100 by Cycles, with meshes and with depths, coarse and noisy ones, nearly
# all gain more of the evidence, and what is left over falls (squared) by 0.13 of its share (squared) or more. Real ones
# of a shape by photometric stereo, which takes what surfaces send each other for shape (Nayar et al. 1991), do neither
SHOWS, CLEARLY, EXPLAINED = 0.05, 20.0, 0.1
NOT_SO_BRIGHT = (
    "interreflections are left out: the photo speaks against them, or shows nothing of them; the material may be "
    "darker than it is said to be, or the shape one that was found without them"
)
PROBE = 400  # pixels of an object at which the scene's own light is found
NEIGHBOURS = 3


@dataclass(frozen=True)
class OwnLight:
    """The answer.

    Attributes
    ----------
    modelled : bool
    bound : how much light other surfaces could add under an even sky, over the sky's own
    share : how much of the photo it is under the light that was found without it; None where the bound was enough
    change : the most that it moves a coefficient, in stated standard deviations; None where it was not asked
    """

    modelled: bool
    bound: float
    share: float | None = None
    change: float | None = None

    @property
    def why(self) -> str:
        """In words."""
        decision = f"interreflections are {'modelled' if self.modelled else 'left out'}"
        if self.share is None:
            return f"{decision}: they are at most {100 * self.bound:.1f} % of the light under an even sky"
        percent = f"{100 * self.share:.0f} % of the photo"
        if self.change is None:
            return f"{decision}: under the light that was found without them they are {percent}"
        return f"{decision}: {percent}, which moves the estimate by up to {self.change:.1f} of its stated uncertainty"


def light_between_surfaces(model, light):
    """The refinement: light between surfaces, where it was left open whether it is followed, and it is not yet.

    What was chosen beside the light without it, is chosen anew.
    """
    if model.settings.bounces != "auto" or model.settings.transport != "kernel" or model.bounces > 1:
        return model, light, {}
    with model.reporter.stage("transport"):
        own = own_light(model, light, bounces=MODELLED_BOUNCES)
        if not own.modelled:
            return model, light, {"interreflections": own.why}
        bounced = with_reflections(model)
    bounced, brighter, choice = solve_model(bounced, beside=light.fit)
    with model.reporter.stage("transport"):
        bounced, brighter = by_photo(model, bounced, brighter, with_reflections)
    if contradicted([p.scene for p in model.problems], brighter.fit, light.fit, own.share):
        return model, light, {"interreflections": NOT_SO_BRIGHT}
    return bounced, brighter, choice | {"interreflections": own.why}


def with_reflections(model):
    """The model with light between surfaces, of the appearance that is tried first."""
    bounced = replace(model, bounces=MODELLED_BOUNCES, appearance=next(iter(model.looks)))
    return bounced.changed(lambda problem: with_own_light(problem, bounced.modelled))


def contradicted(scenes, fit: Fit, without: Fit, share: float) -> bool:
    """Whether the photo speaks against light between surfaces that is ``share`` of it, or would show it and does not.

    It would where more is left over than that: what other light imitates, as in a bowl, no photo shows. A material may
    be darker than it is said to be. Two fits of one photo and of as many unknowns; their evidences can be compared
    (`fit.log_normal`). Not where there are occluders: without light between surfaces they are black, which none is, and
    what light from below a black table would be, nothing in the photo says.
    """
    if fit.evidence is None or any(scene.job.occluders for scene in scenes):
        return False
    gain = fit.evidence - without.evidence
    explains = (without.residual**2 - fit.residual**2) / share**2
    would_show = SHOWS < share < without.residual
    return gain < -AGAINST or bool(would_show and gain < CLEARLY and explains < EXPLAINED)


def open_share(scene: PreparedScene, points: SurfacePoints) -> np.ndarray:
    """How much of the hemisphere above each point is sky: (p,), weighted by the cosine."""
    transport = scene.transport(points, directions=USUAL)  # the rays of the basis images, as a rule

    def share():
        cosine = np.maximum(points.normal @ transport.directions.T, 0)
        return (cosine * transport.visible).sum(1) / np.maximum(cosine.sum(1), 1e-12)

    return kept.recalled("open", [scene.tracer.key, points.position, points.flat_normal, points.normal], share)


def even_sky_bound(scene: PreparedScene, materials, points) -> float:
    """What other surfaces can add to the light that falls on the points, over what the sky gives, under an even sky.

    Nothing that a closed direction shows, object or occluder, is brighter than ``albedo`` times all that falls on it.

    Parameters
    ----------
    materials : of each object
    points : list of SurfacePoints, of each object
    """
    albedo = max(float(a.max()) for a in (*map(diffuse_albedo, materials), *scene.occluder_albedos))
    opened = np.concatenate([open_share(scene, p) for p in points])
    received = albedo * (1 - opened) / (1 - albedo * (1 - opened))
    return float(received.sum() / max(opened.sum(), 1e-12))


def own_light(model, light, *, bounces: int) -> OwnLight:
    """Whether the scenes' own light is worth modelling.

    Parameters
    ----------
    model : Model, its basis images without the scene's own light; light : its SolvedLight
    bounces : that would be followed, >= 2
    """
    # what is not known may be bright
    problems, fit = [replace(p, scene=p.scene.with_grey(BRIGHTEST)) for p in model.problems], light.fit
    bound = max(even_sky_bound(p.scene, p.materials, p.points) for p in problems)
    if bound < NEGLIGIBLE:
        return OwnLight(False, bound)
    probes = [[p.take(spread(p, PROBE)) if len(p) > PROBE else p for p in problem.points] for problem in problems]
    lighting, added = SHLighting(np.asarray(fit.shown)), []
    for problem, few in zip(problems, probes, strict=True):
        indirect = problem.scene.indirect(problem.materials, lighting, model.settings, bounces=bounces)
        for i, (material, points, probe) in enumerate(zip(problem.materials, problem.points, few, strict=True)):
            received = problem.scene.received(i, probe, material, indirect)
            added.append(carried_over(probe, received[:, 0], points))
    added, measured = np.concatenate(added).astype(np.float64), light.radiance(problems)
    share = float(np.linalg.norm(added) / max(np.linalg.norm(measured), 1e-300))
    if share > WORTH:
        return OwnLight(True, bound, share)
    rest = measured - added
    if light.solver:  # so little was taken off that its own slopes lead to the answer
        again = light.solver.again(rest, fit, fit)
    else:
        basis, blocks = stacked([p.up_to(light.order) for p in problems])
        again = solve(basis, rest, blocks=blocks)
    moved = np.abs(again.coefficients[: fit.terms] - fit.coefficients) / np.maximum(fit.stddev, 1e-300)
    change = float(moved.max())
    return OwnLight(change > MOVES, bound, share, change)


def with_own_light(problem: Problem, settings: Settings) -> Problem:
    """The same problem with what the scene's surfaces send each other added to its basis images.

    Parameters
    ----------
    problem : its basis images of light that comes straight from outside
    settings : its bounces a number >= 2
    """
    scene = problem.scene
    indirect = scene.indirect(problem.materials, SHBasis(settings.fit_order), settings, bounces=settings.bounces)
    basis = [
        straight + scene.received(i, points, material, indirect)
        for i, (straight, material, points) in enumerate(
            zip(problem.basis, problem.materials, problem.points, strict=True)
        )
    ]
    return replace(problem, basis=basis, transport={**problem.transport, "bounces": settings.bounces})


def carried_over(probe: SurfacePoints, values, points: SurfacePoints) -> np.ndarray:
    """Smooth ``values`` (q, 3) of the probe's points at other points (p, 3): the mean of the nearest few."""
    size = max(float(np.ptp(points.position, axis=0).max()), 1e-300)

    def feature(p):
        return np.concatenate([p.position / size, p.normal * NORMAL_WEIGHT], 1)

    k = min(NEIGHBOURS, len(probe))
    taps = cKDTree(feature(probe)).query(feature(points), k=k)[1].reshape(len(points), k)
    return np.asarray(values)[taps].mean(1)
