# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a light lights no face of a mesh that its photograph shows: only relief and gloss could tell of it."""

from pathlib import Path

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import pixel_directions, pixel_solid_angles
from btfsep_engine.light.lightings import shrink
from btfsep_engine.light.maps import read_map
from btfsep_engine.render.reach import response
from scripts.cycles.lights import light_path
from scripts.studies.estimates import scene_of
from scripts.studies.measures import order2

ROWS = 64  # of a map that is looked at
NONE = 5e-4  # of what the direction shows that lights the object best: as good as nothing


def share_and_error(folder: Path, light: str) -> tuple[float, float]:
    """The share of a light that lights no pixel of a job's photograph, and the order-2 error of who knew all the rest.

    Straight, or by way of another surface of the object; one free scale, as of every estimate.

    Parameters
    ----------
    folder : of the job; light : of the studio, by name, or a map's path
    """
    radiance = read_map(light_path(light))
    radiance = np.array(shrink(radiance, max(1, len(radiance) // ROWS)), np.float64)
    directions, weights = pixel_directions(*radiance.shape[:2]), pixel_solid_angles(*radiance.shape[:2])[:, None, None]
    scene = scene_of(folder)
    shown = response(scene.tracer, scene.bare_points(0), directions.reshape(-1, 3)).reshape(radiance.shape[:2])
    known = np.where(shown[..., None] > NONE, radiance, 0)
    each = (sh.project_map(values, sh.order_of(9)) for values in (known, radiance))
    return 1 - float((weights * known).sum() / (weights * radiance).sum()), order2(*each)
