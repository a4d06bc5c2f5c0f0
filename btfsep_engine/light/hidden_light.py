# SPDX-License-Identifier: GPL-3.0-or-later
"""How bright the light is from where none reaches the photo: beside all other light, as in natural light.

Of light from below a table a photo says nothing, and a field's logarithm goes on there from the horizon, which is
bright, as smoothly as it varies: on 35 plates on tables it was twice as bright as it is, and scattered by as much. In
the shipped training lights what comes from below the horizon is 0.14 times as bright as what comes from above, give or
take a factor of 2: grounds are dark, and face what they reflect. So the field says how hidden light is spread and
coloured, and natural lights say how bright all of it is.
"""

from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from btfsep_engine.conventions import fibonacci_sphere, pixel_directions, pixel_solid_angles
from btfsep_engine.light.lightings import bilinear, shrink
from btfsep_engine.light.maps import FOLDER, read_map

COARSER, TURNS = 2, 16  # of each light: its pixels, and turns about the vertical
SIZE = 32, 64  # of the map of what is hidden, and of the lights then
NEIGHBOURS, BLUR = 6, 0.12  # of a direction among those that are known to be hidden or not; radians


def hidden_share(hidden, directions) -> np.ndarray:
    """How hidden directions (…, 3) are, 0 to 1: (…); ``hidden`` (m,) bool, of `fibonacci_sphere(m)`; soft at edges."""
    directions = np.asarray(directions)
    share = bilinear(directions.reshape(-1, 3), *SIZE) @ _share_map(np.asarray(hidden, bool).tobytes()).ravel()
    return share.reshape(directions.shape[:-1])


def usual_brightness(hidden) -> tuple[float, float]:
    """Of the mean radiance from ``hidden`` directions over that from all others its logarithm, in natural light.

    Parameters
    ----------
    hidden : (m,) bool, of `fibonacci_sphere(m)`; some are, and some are not

    Returns
    -------
    mean and standard deviation, of the shipped training lights in all turns about the vertical
    """
    return _usual(np.asarray(hidden, bool).tobytes())


@lru_cache(maxsize=16)
def _share_map(hidden: bytes) -> np.ndarray:
    """(h, w), of a map."""
    known = np.frombuffer(hidden, bool)
    near = min(NEIGHBOURS, len(known))
    distance, places = cKDTree(fibonacci_sphere(len(known))).query(pixel_directions(*SIZE), k=range(1, near + 1))
    weight = np.exp(-0.5 * np.square(distance / BLUR)) + 1e-12
    return (weight * known[places]).sum(-1) / weight.sum(-1)


@lru_cache(maxsize=16)
def _usual(hidden: bytes) -> tuple[float, float]:
    share, area = _share_map(hidden), pixel_solid_angles(*SIZE)[:, None]
    there, elsewhere = area * share / (area * share).sum(), area * (1 - share) / (area * (1 - share)).sum()
    turned = np.stack([np.roll(_lights(), turn * SIZE[1] // TURNS, 2) for turn in range(TURNS)])
    each = np.log([(turned * part).sum((2, 3)) for part in (there, elsewhere)])
    ratio = each[0] - each[1]  # (TURNS, lights)
    # of few lights between them, and of many turns within each
    return float(ratio.mean()), float(np.sqrt(ratio.mean(0).var(ddof=1) + ratio.var(0).mean()))


@lru_cache(maxsize=1)
def _lights() -> np.ndarray:
    """(lights, h, w), mean of the channels."""
    found = [shrink(read_map(file), COARSER) for file in sorted(FOLDER.glob("*.exr"))]
    return np.stack(found).mean(-1)
