# SPDX-License-Identifier: GPL-3.0-or-later
"""How many shared light directions the transport needs: as few as the wanted error allows.

Without a wanted error, `USUAL`, as many as no photo of textured or glossy things has shown to be too few. With one, the
number is doubled, on a few of the pixels, until twice as many change their basis images by less than the tolerance.
The change is measured as the relative root mean square of an image under natural light: each basis light counts by its
part in natural light. The error falls so fast (about as 1 / n for shadows, faster without) that the change is the error
of the coarser set (docs/sampling.md compares the two). Gloss needs more than matte without being told: a lobe that
falls between two directions shows as a change.
"""

import numpy as np

from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.light.natural import natural_amplitude
from btfsep_engine.render.sampling import spread

FEWEST, MOST = 64, 1024
USUAL = 256  # with 64 estimates err 8 % more, with 128 up to 1 %, with 1,024 as much (docs/speed-accuracy.md)
PROBE = 150  # pixels of an object


def enough_directions(transport_of, points, material, *, order: int, tolerance: float) -> tuple[int, float]:
    """The smallest of 64, 128, ..., 1024 directions whose error is below ``tolerance``.

    Parameters
    ----------
    transport_of : (points, directions) -> render.transport.Transport
    points : SurfacePoints of an object
    material : Material
    order : of the basis lights, 0 to 9
    tolerance : relative error of the images, > 0

    Returns
    -------
    directions, and their estimated error; with the most directions it can be above the tolerance
    """
    if material.mirror_reflectance is not None or len(points) == 0:
        return FEWEST, 0.0  # a mirror's own direction is followed, whatever the set
    few = points.take(spread(points, PROBE))
    natural = natural_amplitude(order)[:, None].astype(np.float32)
    lights = SHBasis(order)

    def images(directions):
        return transport_of(few, directions).radiance(material, lights) * natural

    count, coarse = FEWEST, images(FEWEST)
    while True:
        fine = images(2 * count)
        error = float(np.linalg.norm(coarse - fine) / max(np.linalg.norm(fine), 1e-30))
        if error < tolerance or count >= MOST:
            return count, error
        count, coarse = 2 * count, fine
