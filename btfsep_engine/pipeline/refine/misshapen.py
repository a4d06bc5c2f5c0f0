# SPDX-License-Identifier: GPL-3.0-or-later
"""What is stated of the light where objects are of another shape than their mesh, or painted.

Noise and texture are as often above as below what is expected: over a patch of the picture they are nearly gone. What a
mesh of another shape, another pose of a limb or paint that nobody told of leave over stays. No fit knows of such a
misfit how much of it light has imitated; on photographs of which the truth is known, the light errs by twice the size
of what is left over patches, or by a little more. Of a mesh of few faces that is shaded smoothly the normals themselves
are a guess: the light errs by about as much as the faces lean from them, and hides much of that from the misfit.
Of objects of which the job says by numbers that they are alike all over, no texture leaves anything: what is left over
is of another surface than that, and where gloss lets the light imitate it, hardly any of it stays over patches.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.btf.surfaces import GIVEN
from btfsep_engine.fit.stated import expected_error, shown_error, widened
from btfsep_engine.pipeline.refine.given import surface_of
from btfsep_engine.pipeline.together import counts

PATCHES = 8  # along the longer side of an object in the picture
LEAST_POINTS = 4  # of a patch
MUCH = 0.1  # relative misfit of patches: 0.01 to 0.04 where the geometry is right, 0.18 of a convex hull
ERROR = 2.0  # that is stated at least, over that misfit
COARSE = 0.03  # misfit of patches with which a coarse mesh counts: one that is as the object is leaves 0.01 to 0.02
OF_LEAN = 0.8  # the error that is stated at least, over the faces' lean in radians: 0.4 to 1.4 on six decimated meshes
# The error that is stated at least, over all that is left over of what is alike all over. Of 72 plates of which that is
# a tenth and more, the error is 0.8 times as much in the median, of one in ten more than 1.7 times.
OF_ALL = 0.7
# The same of matte things, of which light explains all but some hundredths: there what is left over is of something
# that the model has not, as light that goes through, dust or fuzz. Of 43 plates eight are widened by it, which erred
# 1.5 times what they stated in the median.
OF_MATTE, MUCH_OF_MATTE, MATTE = 2.0, 0.06, 0.3
WORTH, WIDEST = 1.25, 4.0  # times what the fit states
UNEXPLAINED = "unexplained"  # its name among what is chosen
OTHERWISE, SHADED = "brighter or darker than the light makes them", "the normals that shade them"
ALIKE = "which the job says to be alike all over"
SHAPE = "the mesh's shape or pose may be wrong, or there is paint that the job does not say"
SURFACE = "there may be paint, or another finish than the job says"
FINER = "give a finer mesh, or shade it flat if the object has facets"


def patch_misfit(problems, light) -> float:
    """Root mean square of what is left over patches of the objects, over that of the photo; noise taken out."""
    b, left, counted = light.radiance(problems), light.left_over(problems), counts(problems)
    numbers, first = [], 0
    for points in (points for problem in problems for points in problem.points):
        if len(points):
            at = points.pixels - points.pixels.min(0)
            cells = at // max(at.max() / PATCHES, 1e-9)
            numbers.append(np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1) + first)
            first = numbers[-1].max() + 1
    patch = np.concatenate(numbers)
    count = np.bincount(patch).astype(np.float64)[:, None]
    mean, square = (np.stack([np.bincount(patch, v) for v in each.T], 1) / count for each in (left, np.square(left)))
    by_chance = (square - np.square(mean)) / np.maximum(count - 1, 1)
    kept = count[:, 0] >= LEAST_POINTS
    weight = np.bincount(patch, counted)[kept, None]  # of an object that counts for little, so do its patches
    power = (weight * (np.square(mean) - by_chance)[kept]).sum() / max(float(weight.sum()), 1e-300)
    return float(np.sqrt(max(power, 0.0) / max(float(np.average(np.square(b).sum(1), weights=counted)), 1e-300)))


def lean(problems) -> float:
    """Root mean square of the angle between the faces and the normals by which they are shaded, radians."""
    cosines = [(points.normal * points.flat_normal).sum(1) for problem in problems for points in problem.points]
    return float(np.sqrt(np.square(np.arccos(np.clip(np.concatenate(cosines), -1, 1))).mean()))


def alike_all_over(problems) -> bool:
    """Whether jobs say by numbers of what surface all objects are, and that it is the same in every place."""
    return all(m.name == GIVEN and not m.has_texture for p in problems for m in p.materials)


def matte(model) -> bool:
    """Whether all objects of `alike_all_over` are rougher than what has a gloss, and no metal."""
    surfaces = [surface_of(model, i) for i in range(len(model.materials[0]))]
    return all(s is not None and not s.metallic and s.roughness >= MATTE for s in surfaces)


def misshapen(model, light):
    """The refinement: wider ranges where parts of the objects are not explained, as wide as such lights err."""
    if light.fit.samples is None or (misfit := patch_misfit(model.problems, light)) < COARSE:
        return model, light, {}
    angle, left = lean(model.problems), light.fit.residual * alike_all_over(model.problems)
    shape = ERROR * misfit * (misfit >= MUCH), f"whole parts of the objects are {100 * misfit:.0f} % {OTHERWISE}", SHAPE
    coarse = OF_LEAN * angle, f"the mesh is coarse: its faces lean {np.degrees(angle):.0f}° from {SHADED}", FINER
    named = ", ".join(dict.fromkeys(f"object '{o.name}'" for p in model.problems for o in p.scene.job.objects))
    times, much = (OF_MATTE, MUCH_OF_MATTE) if left and matte(model) else (OF_ALL, MUCH)
    surface = times * left * (left >= much), f"the light leaves over {100 * left:.0f} % of {named}, {ALIKE}", SURFACE
    error, what, why = max(shape, coarse, surface)
    # of light that does not reach the photo, as from below a table, next to nothing is known whatever is left over
    stated = shown_error(light.fit) or expected_error(light.fit.all_coefficients, light.fit.samples)
    factor = min(error / max(stated["order_2"]["median"], 1e-9), WIDEST)
    if factor < WORTH:
        return model, light, {}
    words = f"{what}; what is known of the light is stated {factor:.1f} times as wide; {why}"
    return model, replace(light, fit=widened(light.fit, factor)), {UNEXPLAINED: words}
