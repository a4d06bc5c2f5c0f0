# SPDX-License-Identifier: GPL-3.0-or-later
"""From which directions light reaches what is photographed: straight, or by way of one other surface.

On a table nothing comes from below. Basis images of a low order are not 0 there, since a horizon is sharper than they
are: they ring, by a tenth of the largest response. Who asks rays instead knows.
"""

import numpy as np

from btfsep_engine.render.tracer import Tracer

PLACES = 400  # of what is photographed, and as many rays from there that end on other surfaces


def response(tracer: Tracer, points, directions) -> np.ndarray:
    """How much a white surface shows of light from each direction, over many places: (n,), of the largest.

    Parameters
    ----------
    tracer : Tracer
    points : SurfacePoints, what is photographed
    directions : (n, 3) float, unit, world, to the light
    """
    random = np.random.default_rng(0)
    some = points.take(random.permutation(len(points))[:PLACES])
    straight = _irradiance(tracer, some.position, some.flat_normal, directions).mean(0)
    towards = some.flat_normal + _on_sphere(random, len(some))  # as much as the cosine says
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
    _, places, facing = tracer.arrivals(some.position, some.flat_normal, towards)
    by_another = _irradiance(tracer, places, facing, directions).sum(0) / len(some)
    together = straight + by_another
    return together / max(float(together.max()), 1e-300)


def _irradiance(tracer: Tracer, positions, normals, directions) -> np.ndarray:
    """(p, n), of a beam of irradiance 1 from each direction on each place."""
    seen = tracer.visible(positions, normals, directions)
    return seen * np.maximum(np.asarray(normals) @ directions.T, 0)


def _on_sphere(random, count: int) -> np.ndarray:
    each = random.standard_normal((count, 3))
    return each / np.linalg.norm(each, axis=1, keepdims=True)
