# SPDX-License-Identifier: GPL-3.0-or-later
"""What the stability study photographs: four objects, two lights, and what is put beside them. Plain data.

Neither the shapes nor the lights nor these instances of the materials were used in any tuning of the estimator.
Lengths are in units of the object's radius, which is half the diagonal of its bounding box.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from btfsep_engine import sh
from btfsep_engine.light.lightings import cap_factors
from scripts.studies.photos import Shot, library_name

ORDER = 4  # of the truth that is kept
LIGHTS = ("forest", "studio")  # of Blender's own studio lights; a path of another map does as well
AS_IS = "as-is"
LIBRARY_TEXELS = "library-texels"
SUN_RADIUS_DEGREES = 0.27
LAMP_RADIUS = 0.12
LAMP_FROM = (-0.70, -0.55, 0.45)
SUNS = ((-0.55, -0.60, 0.58), (0.80, 0.10, 0.59))  # one for each light, before the object and behind it
THICKNESS = (0.6, 0.35, 0.2, 0.1, 0.04)  # of the object along the view, of what it was
SECOND_FROM, SECOND_NEAR = (0.75, -0.45, 0.5), (2.2, 3.5)  # of a second lamp (scripts/study near --pairs)
NEAR = (12.0, 6.0, 3.5, 2.2, 1.5)  # distance of a lamp
WALL = (6.0, 3.5, 2.2, 1.5, 1.1)  # distance of a second surface
WALL_FROM, WALL_EDGE, WALL_COLOUR = (0.95, 0.25, -0.05), 5.0, (0.80, 0.12, 0.06)


@dataclass(frozen=True)
class Scene:
    """One photographed object: its shape (of `cycles.objects`) and its material ("white", or one of the library)."""

    name: str
    shape: str
    seed: int
    material: str

    @property
    def given(self) -> str:
        """The material's name in the library."""
        return library_name(self.material)


SCENES = (
    Scene("white", "knot", 0, "white"),
    Scene("leather", "blob", 5, "leather/black-nappa"),
    Scene("gloss", "pebble", 1, "stone/granite-grey"),
    Scene("cloth", "cushion", 2, "fabric/linen-plain"),
)


def geometry_folder(work: Path, scene: Scene, geometry: str) -> Path:
    """Where the job and the photographs of one geometry are: AS_IS, LIBRARY_TEXELS, or the thickness as text."""
    return Path(work) / "photos" / scene.name / geometry


def light_name(light: str) -> str:
    """A light's name in file names."""
    return Path(light).stem


def shots(work: Path, scene: Scene, lights, axes, *, under) -> list[Shot]:
    """The photographs that the axes need of one scene, which is estimated ``under`` these of the ``lights``."""

    def shot(name, light=None, *, geometry=AS_IS, **more):
        folder = str(geometry_folder(work, scene, geometry))
        more |= {"thickness": 1.0 if geometry in (AS_IS, LIBRARY_TEXELS) else float(geometry)}
        more |= {"variation": 0 if geometry == LIBRARY_TEXELS else 1, "seed": scene.seed, "name": f"{name}.exr"}
        return Shot(folder, scene.shape, scene.material, light, **more)

    plain = lights if "coloured light" in axes else under
    out = [shot(f"light-{light_name(l)}", l) for l in plain]
    if "sun" in axes:
        sun = {"irradiance": [np.pi] * 3, "degrees": 2 * SUN_RADIUS_DEGREES}
        out += [shot(f"sun-{i}", sun=sun | {"direction": d}) for i, d in enumerate(SUNS)]
    if "near light" in axes:
        out += [shot(lamp_name((d, LAMP_FROM)), ball=lamp_ball((d, LAMP_FROM))) for d in NEAR]
    if "second lamp" in axes:
        out += [shot(lamp_name((d, SECOND_FROM)), ball=lamp_ball((d, SECOND_FROM))) for d in SECOND_NEAR]
    if "second object" in axes:
        wall = {"edge": WALL_EDGE, "colour": WALL_COLOUR}
        places = {d: (d * unit(WALL_FROM)).tolist() for d in WALL}
        out += [
            shot(f"wall-{d:g}-{light_name(l)}", l, wall=wall | {"place": at}) for l in under for d, at in places.items()
        ]
    if "flat geometry" in axes:
        out += [shot(f"light-{light_name(l)}", l, geometry=f"{t:g}") for t in THICKNESS for l in under]
    if "wrong UV" in axes and scene.material != "white":
        out += [shot(f"light-{light_name(l)}", l, geometry=LIBRARY_TEXELS) for l in under]
    return out


def unit(direction) -> np.ndarray:
    """(3,) float64 of length 1."""
    d = np.asarray(direction, np.float64)
    return d / np.linalg.norm(d)


def lamp_name(lamp) -> str:
    """The photograph of a lamp (distance, or None: a sun; direction) alone."""
    distance, direction = lamp
    if distance is None:
        return f"sun-{SUNS.index(direction)}"
    return f"near-{distance:g}{'-second' if direction == SECOND_FROM else ''}"


def lamp_ball(lamp) -> dict:
    """A lamp nearby as a shot has it."""
    distance, direction = lamp
    place = (distance * unit(direction)).tolist()
    return {"place": place, "radius": LAMP_RADIUS, "radiance": lamp_radiance(lamp)}


def lamp_angle(lamp) -> float:
    """The angular radius of a lamp (distance, or None: a sun; direction) from the object's centre, radians."""
    distance, _ = lamp
    return np.radians(SUN_RADIUS_DEGREES) if distance is None else float(np.arcsin(LAMP_RADIUS / distance))


def lamp_radiance(lamp) -> float:
    """The radiance of a lamp: such that its irradiance at the object's centre is pi."""
    return float(1 / np.sin(lamp_angle(lamp)) ** 2)


def lamp_coefficients(lamp) -> np.ndarray:
    """The light (terms, 3) of a lamp, a ball of even radiance, as it is at the object's centre."""
    solid_angle = 2 * np.pi * (1 - np.cos(lamp_angle(lamp)))
    factors = cap_factors(ORDER, solid_angle)[sh.degrees(ORDER)]
    x = lamp_radiance(lamp) * solid_angle * factors * sh.evaluate(ORDER, unit(lamp[1]))
    return np.repeat(x[:, None], 3, 1)


def pairs(chosen_scenes, lights, *, half: bool) -> list:
    """(scene, light): every scene under every light, or, ``half``, each scene under one of them in turn."""
    if half:
        return [(scene, lights[i % len(lights)]) for i, scene in enumerate(chosen_scenes)]
    return [(scene, light) for scene in chosen_scenes for light in lights]
