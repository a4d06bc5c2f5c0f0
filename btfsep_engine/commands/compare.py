# SPDX-License-Identifier: GPL-3.0-or-later
"""`btfsep compare`: how far two lights are apart, by coefficients, renderings, and three spheres."""

import numpy as np

from btfsep_engine.commands.report import render_objects
from btfsep_engine.fit.compare import compare
from btfsep_engine.fit.three_spheres import three_spheres
from btfsep_engine.light.files import read_any_lighting, read_any_map
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.materials import object_materials
from btfsep_engine.pipeline.scene import read_scene
from btfsep_engine.pipeline.settings import choose


def run_compare(a, b, *, order: int, job=None, library=None, material=None, reporter) -> dict:
    """Error measures of lighting file ``a`` against ``b``, and of renderings of a job under both."""
    first, second = read_any_lighting(a, order), read_any_lighting(b, order)
    result = compare(first, second)
    if job is not None:
        scene = read_scene(job, reporter)
        settings = choose("balanced")
        names = [material or o.material for o in scene.job.objects]
        found = [m.material for m in object_materials(scene, library, settings, names=names)]
        images = [
            render_objects(
                scene, found, SHLighting(x.coefficients), textured=True, directions=settings.many_directions
            )[0]
            for x in (first, second)
        ]
        result["rendering_psnr_free_scale"] = psnr(images[0], images[1])
    return result


def run_three_spheres(a, b) -> dict:
    """The published comparisons' figures of lighting file ``a`` against ``b``, both taken as whole maps."""
    return {"protocol": "three-spheres", **three_spheres(read_any_map(a), read_any_map(b))}


def psnr(image, truth) -> float:
    """Peak signal-to-noise ratio in dB of two linear images where both are finite, one free scale.

    The peak is the truth's 99th percentile.
    """
    shown = np.isfinite(image).all(-1) & np.isfinite(truth).all(-1)
    a, b = image[shown].astype(np.float64), truth[shown].astype(np.float64)
    scale = (a * b).sum() / max((a * a).sum(), 1e-300)
    error = np.mean((scale * a - b) ** 2)
    return float(10 * np.log10(np.percentile(b, 99) ** 2 / max(error, 1e-300)))
