# SPDX-License-Identifier: GPL-3.0-or-later
"""The true light of the plates of `scripts.studies.plate_sets`."""

from pathlib import Path

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import across
from btfsep_engine.light.maps import read_map
from scripts.cycles.lights import AROUND, true_lighting

CORNERS = 0.5 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])  # of a softbox, in its edges from its middle
PATCHES = 24  # of a softbox, a side: of its integral
LAMPS, DIMMED, STRONG = 3, (0.03, 0.15), (1.0, 2.0)  # of a stage: at most; its other light, times what it is; lamps'
# irradiance, times what that of the other light would be undimmed


def of_box(box: dict, across_it) -> np.ndarray:
    """Points (n, 3) of a softbox, metres from the object's middle; ``across_it`` : (n, 2), in edges from its own."""
    towards = np.array(box["direction"])
    return box["distance"] * towards + box["edge"] * np.asarray(across_it) @ across(towards)


def box_light(box: dict, order: int) -> np.ndarray:
    """The light of a softbox at the object's middle: ((order + 1)^2, 3)."""
    steps = (np.arange(PATCHES) + 0.5) / PATCHES - 0.5
    points = of_box(box, np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2))
    distance = np.linalg.norm(points, axis=1)
    solid_angle = (box["edge"] / PATCHES) ** 2 * box["distance"] / distance**3
    light = sh.evaluate(order, points / distance[:, None]).T @ solid_angle
    return light[:, None] * box["radiance"]


def hides(neighbour: dict, direction) -> bool:
    """Whether what stands beside the object is between its middle and what lies in ``direction`` (3,)."""
    for quad in np.array(neighbour["quads"]):
        sides = quad[1] - quad[0], quad[3] - quad[0]
        along, up, away = np.linalg.solve(np.stack([*sides, -np.array(direction)], -1), -quad[0])
        if away > 0 and 0 < along < 1 and 0 < up < 1:
            return True
    return False


def truth(plate, folder: Path | None = None) -> np.ndarray:
    """The light's coefficients (100, 3); ``folder`` : the set's, of plates with neighbours."""
    c, s = np.cos(np.radians(plate["turn"])), np.sin(np.radians(plate["turn"]))
    suns = [plate["sun"]] * bool(plate["sun"])
    if "neighbour" in plate:
        x = sh.project_map(read_map(folder / plate["name"] / AROUND), 9)
        suns = [sun for sun in suns if not hides(plate["neighbour"], sun["direction"])]
    else:
        x = true_lighting(plate["light"], 9, rotation=np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))
    x = x * plate.get("dimmed", 1)
    for lamp in suns + plate.get("lamps", []):
        beam = sh.evaluate(9, np.array([lamp["direction"]]))[0]
        x = x + beam[:, None] * lamp["irradiance"]
    if "flash" in plate:
        place = np.array(plate["flash"]["place"])
        x = x + sh.evaluate(9, place[None] / np.linalg.norm(place))[0][:, None] * plate["flash"]["irradiance"]
    return x + sum(box_light(box, 9) for box in plate.get("boxes", ()))


def from_in_front(random) -> list[float]:
    """A random direction (3,) above the ground, on the camera's side."""
    azimuth, height = random.uniform(0, 2 * np.pi), random.uniform(0.1, 1.2)
    return [np.cos(azimuth) * np.cos(height), -abs(np.sin(azimuth)) * np.cos(height), np.sin(height)]
