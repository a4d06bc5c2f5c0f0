# SPDX-License-Identifier: GPL-3.0-or-later
"""The light beside a wall, of the stability study, where it is known."""

import numpy as np

from btfsep_engine import sh
from btfsep_engine.imaging.images import write_exr
from scripts.studies.stability import scenes, wall


def test_a_wall_in_even_light_takes_what_it_absorbs_of_its_solid_angle(tmp_path):
    path = tmp_path / "even.exr"
    write_exr(path, np.ones((256, 512, 3), np.float32))
    for distance in scenes.WALL:
        half = scenes.WALL_EDGE / 2
        solid_angle = 4 * np.arcsin(half**2 / (half**2 + distance**2))  # of a square seen from above its middle
        mean = 1 - solid_angle / (4 * np.pi) * (1 - np.array(scenes.WALL_COLOUR))
        found = wall.coefficients(str(path), distance)
        assert np.allclose(found[0], np.sqrt(4 * np.pi) * mean, rtol=3e-3)
        missing, towards = -found[1:4, 0], sh.evaluate(1, scenes.unit(scenes.WALL_FROM))[1:]  # from where it stands
        assert missing @ towards > 0.999 * np.linalg.norm(missing) * np.linalg.norm(towards)
