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

ORDER = 4  # of the truth that is kept
LIGHTS = ("forest", "studio")  # of Blender's own studio lights; a path of another map does as well
AS_IS = "as-is"
LIBRARY_TEXELS = "library-texels"
WHITE = "reference/white-diffuse"
SUN_RADIUS_DEGREES = 0.27
LAMP_RADIUS = 0.12
LAMP_FROM = (-0.70, -0.55, 0.45)
SUNS = ((-0.55, -0.60, 0.58), (0.80, 0.10, 0.59))  # one for each light, before the object and behind it
THICKNESS = (0.6, 0.35, 0.2, 0.1, 0.04)  # of the object along the view, of what it was
NEAR = (12.0, 6.0, 3.5, 2.2, 1.5)  # distance of a lamp
WALL = (6.0, 3.5, 2.2, 1.5, 1.1)  # distance of a second surface
WALL_FROM = (0.95, 0.25, -0.05)
WALL_EDGE = 5.0
WALL_COLOUR = (0.80, 0.12, 0.06)


@dataclass(frozen=True)
class Scene:
    """One photographed object: its shape (as of `shapes.build`) and its material ("white", or one of the library)."""

    name: str
    shape: str
    seed: int
    material: str

    @property
    def given(self) -> str:
        """The material's name in the library."""
        return WHITE if self.material == "white" else self.material


SCENES = (
    Scene("white", "knot", 0, "white"),
    Scene("leather", "blob", 5, "leather/black-nappa"),
    Scene("gloss", "pebble", 1, "stone/granite-grey"),
    Scene("cloth", "cushion", 2, "fabric/linen-plain"),
)


@dataclass(frozen=True)
class Photo:
    """One photograph to make.

    Attributes
    ----------
    scene : Scene
    geometry : AS_IS, LIBRARY_TEXELS, or the thickness as text
    name : file stem
    light : a light's name, or None: dark but for the lamp
    lamp : (distance, direction) of a ball that shines, or None
    wall : distance of a coloured surface, or None
    """

    scene: Scene
    geometry: str
    name: str
    light: str | None = None
    lamp: tuple | None = None
    wall: float | None = None

    def path(self, work: Path) -> Path:
        return geometry_folder(work, self.scene, self.geometry) / f"{self.name}.exr"


def geometry_folder(work: Path, scene: Scene, geometry: str) -> Path:
    """Where the job and the photographs of one geometry are."""
    return Path(work) / "photos" / scene.name / geometry


def light_name(light: str) -> str:
    """A light's name in file names."""
    return Path(light).stem


def photographs(scene: Scene, lights, axes, *, under) -> list[Photo]:
    """The photographs that the axes need of one scene, which is estimated ``under`` these of the ``lights``."""
    plain = lights if "coloured light" in axes else under
    out = [Photo(scene, AS_IS, f"light-{light_name(l)}", light=l) for l in plain]
    if "sun" in axes:
        out += [Photo(scene, AS_IS, f"sun-{i}", lamp=(None, SUNS[i])) for i in range(len(SUNS))]
    if "near light" in axes:
        out += [Photo(scene, AS_IS, f"near-{d:g}", lamp=(d, LAMP_FROM)) for d in NEAR]
    if "second object" in axes:
        out += [Photo(scene, AS_IS, f"wall-{d:g}-{light_name(l)}", light=l, wall=d) for l in under for d in WALL]
    if "flat geometry" in axes:
        out += [Photo(scene, f"{t:g}", f"light-{light_name(l)}", light=l) for l in under for t in THICKNESS]
    if "wrong UV" in axes and scene.material != "white":
        out += [Photo(scene, LIBRARY_TEXELS, f"light-{light_name(l)}", light=l) for l in under]
    return out


def unit(direction) -> np.ndarray:
    """(3,) float64 of length 1."""
    d = np.asarray(direction, np.float64)
    return d / np.linalg.norm(d)


def ball_coefficients(direction, angular_radius: float) -> np.ndarray:
    """SH coefficients (terms, 3) of a ball of radiance 1 seen in ``direction`` under ``angular_radius`` radians."""
    solid_angle = 2 * np.pi * (1 - np.cos(angular_radius))
    factors = np.repeat(cap_factors(ORDER, solid_angle), 2 * np.arange(ORDER + 1) + 1)
    return np.repeat((solid_angle * factors * sh.evaluate(ORDER, unit(direction)))[:, None], 3, 1)


def lamp_angle(lamp) -> float:
    """The angular radius of a photo's lamp from the object's centre, radians."""
    distance, _ = lamp
    return np.radians(SUN_RADIUS_DEGREES) if distance is None else float(np.arcsin(LAMP_RADIUS / distance))


def lamp_radiance(lamp) -> float:
    """The radiance of a photo's lamp: such that its irradiance at the object's centre is pi."""
    return float(1 / np.sin(lamp_angle(lamp)) ** 2)


def lamp_coefficients(lamp) -> np.ndarray:
    """The light (terms, 3) of a photo's lamp, as it is at the object's centre."""
    return lamp_radiance(lamp) * ball_coefficients(lamp[1], lamp_angle(lamp))


def chosen(options) -> tuple:
    """The scenes of a run's options: ``quick``, ``meshes`` (None, or a folder whose first two meshes are added)."""
    if options.quick:
        return (SCENES[0], SCENES[2])
    if options.meshes is None:
        return SCENES
    files = sorted(p for p in options.meshes.resolve().iterdir() if p.suffix.lower() in (".obj", ".ply"))
    more = [Scene(f"{s.name}-{file.stem}", str(file), 0, s.material) for file in files[:2] for s in SCENES]
    return (*SCENES, *more)


def pairs(chosen_scenes, lights, *, half: bool) -> list:
    """(scene, light): every scene under every light, or, ``half``, each scene under one of them in turn."""
    lights = list(lights)
    if half:
        return [(scene, lights[i % len(lights)]) for i, scene in enumerate(chosen_scenes)]
    return [(scene, light) for scene in chosen_scenes for light in lights]
