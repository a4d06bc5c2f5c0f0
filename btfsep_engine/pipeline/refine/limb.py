# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether surfaces are brighter, seen aslant, than their materials have it: towards the limb, as planets can be.

What comes from below the skin of wax, of plastic or of a face left it at some depth, and where it is seen aslant more
of it comes from nearby: such an object's limb is brighter by a tenth than Lambert has it, and by more where it is dark
(Chandrasekhar 1960). Dust and fuzz brighten it, too. Light from the sides imitates that, and then it is wrong: so the
same light is fitted anew with a difference free which goes by the cosine of the angle that a pixel is seen at, of each
object its own (`fit.products`, ``slopes``). It is kept where that explains the photo clearly better and the limb is
brighter; basis images stay as they are.

Not asked for: metals, into which no light goes, and photos of which the light leaves much over, where something else is
wrong. A limb that is darker than it should be is not believed: blur and a shape that is a little too large make it so.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.diagnose import effect
from btfsep_engine.pipeline.together import all_weights, fit_together, followed, stacked

USUAL = 0.3  # of the brightness, from a cosine of 0 to 1: a deviation
SPEAKS = 12.0  # chi^2 of one degree of freedom
CLEARLY = 3.0  # of the logarithm of the evidence
MOST = 0.25  # of the photo, left over: more is something else
METAL = 0.5
FEWEST = 30  # pixels of an object
FOUND = "seen aslant, {} brighter than the material is, which is reckoned with (by evidence): light from below its skin"


def limb_brightness(model, light):
    """The refinement: a brightness that goes by the angle that surfaces are seen at."""
    if light.solver is None or light.share_left(model.problems) > MOST:
        return model, light, {}
    with model.reporter.stage("fit"):
        columns = [aslant(p, light.fit.shown) for p in model.problems]
        of_first = zip(model.problems[0].materials, model.problems[0].scene.job.objects, strict=True)
        deep = [_has_depth(material, thing.surface) for material, thing in of_first]
        wanted = [i for i in _speaking(model.problems, columns, light) if deep[i]]
        if not wanted:
            return model, light, {}
        free = model.changed(lambda p, c: p.beside(USUAL * c[:, wanted]), columns)
        settings = replace(model.settings, order=light.order)
        if followed(free.problems, light, settings).evidence < light.fit.evidence + CLEARLY:
            return model, light, {}
        answer = fit_together(free.problems, settings, beside=light.fit)
    left, every = answer.left_over(free.problems), np.concatenate(columns)[:, wanted]
    is_brighter = (left[:, None] * every).sum() > 0
    if answer.fit.evidence < light.fit.evidence + CLEARLY or not is_brighter:
        return model, light, {}
    names = [f"'{model.problems[0].scene.job.objects[i].name}'" for i in wanted]
    said = f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'}"
    return free, answer, {"limb": FOUND.format(said)}


def aslant(problem, x) -> np.ndarray:
    """What changes where surfaces seen aslant are brighter, (p, objects, 3), under a light ``x`` (terms, 3).

    Of each object its pixels alone: its own brightness times how far the cosine lies below its mean.
    """
    out = np.zeros((len(problem.pixels), len(problem.points), 3))
    start = 0
    for i, (points, shown) in enumerate(zip(problem.points, problem.by_object(problem.predicted(x)), strict=True)):
        cosine = (points.normal * points.to_eye).sum(1)
        if len(points) >= FEWEST:
            out[start : start + len(points), i] = shown * (cosine.mean() - cosine)[:, None]
        start += len(points)
    return out


def _has_depth(material, surface=None) -> bool:
    """Whether light goes into a material: into any that is not known to be a mirror or a metal.

    ``surface`` : what the job says of the object; of an image of it, materials know no more
    """
    if material.mirror_reflectance is not None:
        return False
    surface = material.table.surface or surface
    return surface is None or surface.metallic < METAL


def _speaking(problems, columns, light) -> list[int]:
    """The numbers of the objects whose misfit looks like a brightness that goes by the angle."""
    weights, project = all_weights(problems), light.solver.smoother(light.fit)
    unit = (1.0 if weights is None else np.sqrt(weights)) / light.solver.basis.response
    left, blocks, every = light.left_over(problems) * unit, stacked(problems)[1], np.concatenate(columns)
    said = [effect(left, project(every[:, i])[None] * unit, blocks).chi2 for i in range(every.shape[1])]
    return [i for i, chi2 in enumerate(said) if chi2 > SPEAKS]
