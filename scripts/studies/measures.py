# SPDX-License-Identifier: GPL-3.0-or-later
"""What one estimate is worth against the truth."""

from functools import lru_cache
from pathlib import Path

import numpy as np

from btfsep_engine import sh
from btfsep_engine.fit import compare
from scripts.studies import scenes

ERROR_ORDER = 2
RERENDER_PIXELS = 3000
WITHIN = {"within68": 0.9945, "within95": 1.96}  # standard deviations of a normal distribution
SPHERES = ("diffuse", "silver", "mirror")


def measure(given, case, pixels) -> dict:
    """The measures of a light that a method found.

    Parameters
    ----------
    given : methods.Given
    case : cases.Case
    pixels : (basis (p, terms, 3), radiance (p, 3)) of `rerendering`

    Returns
    -------
    dict, JSON-ready: order1, order2 (relative L2, one free scale), order2_absolute (none), direction (degrees),
    si_rmse and degrees of each sphere, psnr (dB, of the photograph rendered again), and, where a spread is stated,
    within68, within95 (share of the coefficients up to order 2), inside (the same of a stated 95 % range) and stated
    (the relative error up to order 2 that the method expects; of least squares its standard deviations over its size)
    """
    x, truth = np.asarray(given.coefficients), case.truth
    terms = sh.term_count(ERROR_ORDER)
    out = {}
    for order in (1, 2):
        n = sh.term_count(order)
        found = compare.relative_l2(x[:n], truth[:n])
        out[f"order{order}"] = found["relative_l2_free_scale"]
        out[f"order{order}_absolute"] = found["relative_l2"]
    out["direction"] = compare.direction_error(x, truth)
    known = min(len(x), len(truth))
    pictures = [compare.spheres(c[:known], size=64) for c in (x, truth)]
    for kind in SPHERES:
        found = compare.image_errors(pictures[0][kind], pictures[1][kind])
        out[f"{kind}_si_rmse"], out[f"{kind}_degrees"] = found["si_rmse"], found["angular_degrees"]
    basis, radiance = pixels
    out["psnr"] = psnr(np.einsum("pmc,mc->pc", basis[:, : len(x)], x[: basis.shape[1]]), radiance)
    if given.stddev is not None:
        spread = given.stddev[:terms]
        ends = None if given.interval is None else given.interval[:, :terms]
        out |= covered(x[:terms], spread, truth[:terms], interval=ends)
        out["stated"] = given.expected or float(np.linalg.norm(spread) / max(np.linalg.norm(x[:terms]), 1e-300))
    return out


def scaled_error(x, truth) -> tuple[float, float]:
    """The relative L2 error of coefficients with one free scale, and that scale."""
    found = compare.relative_l2(x, truth)
    return found["relative_l2_free_scale"], found["scale"]


def covered(x, stddev, truth, *, interval=None) -> dict:
    """Shares of true coefficients (terms, 3) in what is stated of ``x``: within 1 and 1.96 ``stddev``, and, where
    there is an ``interval`` (2, terms, 3), ``inside`` it."""
    off = np.abs(x - truth)
    out = {key: float((off <= width * stddev).mean()) for key, width in WITHIN.items()}
    if interval is not None:
        out["inside"] = float(((interval[0] <= truth) & (truth <= interval[1])).mean())
    return out


def psnr(image, truth) -> float:
    """As pipeline.commands.psnr, of pixels in a row."""
    from btfsep_engine.pipeline.commands import psnr as of_images

    return of_images(image[None], truth[None])


@lru_cache(maxsize=64)
def _basis(folder: str, material: str):
    from btfsep_engine.btf.library import open_library
    from btfsep_engine.job.load import load_job
    from btfsep_engine.light.lightings import SHBasis
    from btfsep_engine.pipeline.scene import PreparedScene
    from btfsep_engine.pipeline.settings import Settings
    from btfsep_engine.progress import Reporter
    from btfsep_engine.render.sampling import spread

    scene = PreparedScene(load_job(folder), Reporter())
    points = scene.points(0, textured=False)
    points = points.take(spread(points, RERENDER_PIXELS))
    told = open_library().load(material)
    told = told.mean_material()
    lights = SHBasis(scenes.ORDER)
    indirect = scene.indirect([told], lights, Settings(), bounces=4)
    return points.pixels, scene.radiance(points, told, lights, directions=512, indirect=indirect).astype(np.float64)


def rerendering(work, scene, case):
    """What renders a case's photograph again: with the true geometry and material, under any light.

    Returns
    -------
    basis : (p, terms, 3) radiance of pixels under each spherical harmonic
    radiance : (p, 3) the photograph's, undisturbed
    """
    pixels, basis = _basis(str(Path(scenes.geometry_folder(work, scene, case.geometry))), scene.given)
    return basis, case.clean[pixels[:, 0], pixels[:, 1]]
