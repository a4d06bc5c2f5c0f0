# SPDX-License-Identifier: GPL-3.0-or-later
"""The fifteen ways in which a case is disturbed, each in five severities."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.sparse import identity
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation
from sklearn.preprocessing import normalize
from trimesh.graph import edges_to_coo

from btfsep_engine.conventions import REC709_LUMINANCE
from scripts.cycles.lights import true_lighting
from scripts.studies.stability import scenes, wall
from scripts.studies.stability.cases import Case, photograph, shape, undisturbed

# what a material is taken for: another of its class, and one of another
SAME_CLASS = {
    "leather/black-nappa": "leather/brown-grain",
    "stone/granite-grey": "stone/sandstone-yellow",
    "fabric/linen-plain": "fabric/denim-twill",
}
OTHER_CLASS = {
    "white": "wood/walnut-lacquered",
    "leather/black-nappa": "carpet/loop-sand",
    "stone/granite-grey": "felt/green-coarse",
    "fabric/linen-plain": "wood/walnut-lacquered",
}
SHARES = (0.1, 0.25, 0.5, 0.75, 1.0)
SMOOTHING_STEPS = 4
NOISE_LENGTH_MM = 3.0  # of bumps that a noisy surface has
WARP_LENGTH_MM = 25.0


@dataclass(frozen=True)
class Setting:
    """Where a case comes from.

    Attributes
    ----------
    work : folder of the study
    scene : scenes.Scene
    light : its name; ``lights`` are all of the study
    """

    work: object
    scene: scenes.Scene
    light: str
    lights: tuple

    @property
    def number(self) -> int:
        return self.lights.index(self.light)

    @property
    def random(self):
        """Random numbers that are the same for every severity."""
        return np.random.default_rng([self.number, *self.scene.name.encode()])

    def photograph(self, name: str) -> np.ndarray:
        """Another one of the same object."""
        return photograph(self.work, self.scene, scenes.AS_IS, name)


@dataclass(frozen=True)
class Axis:
    """One way of disturbing.

    Attributes
    ----------
    label : what the values are
    words : what is done
    values : five severities
    disturb : (Case, Setting, value), changes the case
    zero : None, or the value at which nothing is disturbed, where that is not the plain photograph
    concerns : Scene -> bool
    changes : "photo" (or the geometry), "material" or "uv": what differs from the case at zero
    geometry : value -> which of the scene's geometries was photographed
    reaching : None, or (light, value) -> the light at the object's middle, where that is not the truth
    """

    label: str
    words: str
    values: tuple
    disturb: Callable
    zero: float | None = None
    concerns: Callable = lambda scene: True
    changes: str = "photo"
    geometry: Callable = lambda value: scenes.AS_IS
    reaching: Callable | None = None

    def make(self, setting: Setting, value) -> Case:
        case = undisturbed(setting.work, setting.scene, setting.light, geometry=self.geometry(value))
        self.disturb(case, setting, value)
        return case


AXES: dict[str, Axis] = {}


def axis(name: str, label: str, values: tuple, **more):
    """Enters a function among the axes; its docstring says what it does."""

    def enter(disturb):
        AXES[name] = Axis(label, " ".join(disturb.__doc__.split()).rstrip("."), values, disturb, **more)
        return disturb

    return enter


@axis("noise", "noise, of the object's mean", (0.03, 0.1, 0.3, 1.0, 3.0))
def _noise(case, setting, value):
    """Photon and sensor noise in every pixel, zero-mean before it is cut at 0."""
    b, level = np.maximum(case.image, 0), case.level
    spread = value * np.sqrt(level * b + (0.1 * level) ** 2)
    case.image = np.maximum(case.image + spread * setting.random.normal(size=b.shape), 0)


@axis("few pixels", "pixels across the picture", (80, 40, 24, 16, 10))
def _few_pixels(case, setting, value):
    """The photograph is made smaller, each new pixel the mean of the old ones."""
    scale = value / len(case.image)
    case.image = cv2.resize(case.image, (value, value), interpolation=cv2.INTER_AREA)
    case.camera = case.camera | {"width": value, "height": value}
    case.camera |= {key: case.camera[key] * scale for key in ("fx", "fy", "cx", "cy")}


@axis("flat geometry", "thickness along the view", scenes.THICKNESS, geometry=lambda value: f"{value:g}")
def _flat(case, setting, value):
    """The object is a flatter and flatter relief, seen from the front (photographed so)."""


@axis("wrong material, same class", "share of the wrong material", SHARES, changes="material",
      concerns=lambda scene: scene.material in SAME_CLASS)  # fmt: skip
def _same_class(case, setting, value):
    """The material that is given is mixed with another of its class, in the end is that one."""
    case.blend = (SAME_CLASS[setting.scene.material], value)


@axis("wrong material, other class", "share of the wrong material", SHARES, changes="material")
def _other_class(case, setting, value):
    """The same with a material of another class (matte for glossy, glossy for matte)."""
    case.blend = (OTHER_CLASS[setting.scene.material], value)


def smoothed(values, vertices, faces, length: float) -> np.ndarray:
    """Values (v, k) on a mesh after heat has flown ``length`` (implicit steps of the umbrella Laplacian)."""
    mesh = shape(vertices, faces)
    step = 2 * length**2 / mesh.edges_unique_length.mean() ** 2 / SMOOTHING_STEPS
    edges = mesh.edges_unique
    neighbours = edges_to_coo(np.concatenate([edges, edges[:, ::-1]]), len(vertices)).astype(np.float64)
    neighbours = normalize(neighbours, "l1")  # the mean over each vertex's neighbours
    solver = splu((identity(len(vertices)) * (1 + step) - step * neighbours).tocsc())
    for _ in range(SMOOTHING_STEPS):
        values = solver.solve(np.ascontiguousarray(values))
    return values


@axis("geometry smoothed", "length, mm (object: 150)", (1, 2, 4, 8, 16))
def _smoothing(case, setting, value):
    """The geometry that is given is smoothed (heat flow over the mesh)."""
    case.vertices = smoothed(case.vertices, case.vertices, case.faces, 1e-3 * value)


@axis("geometry noisy", "height of bumps, mm", (0.05, 0.1, 0.2, 0.5, 1.0))
def _bumps(case, setting, value):
    """Bumps of about 3 mm along the normals of the geometry that is given."""
    height = setting.random.normal(size=(len(case.vertices), 1))
    height = smoothed(height, case.vertices, case.faces, 1e-3 * NOISE_LENGTH_MM)
    normals = shape(case.vertices, case.faces).vertex_normals
    case.vertices = case.vertices + 1e-3 * value * height / height.std() * normals


@axis("misaligned", "shift, % of the picture", (0.5, 1, 2, 4, 8))
def _misaligned(case, setting, value):
    """The geometry stands beside its picture."""
    camera, to_world = case.camera, np.array(case.camera["to_world"])
    distance = np.linalg.norm(to_world[:3, 3] - case.vertices.mean(0))
    angle = setting.random.uniform(0, 2 * np.pi)
    shift = to_world[:3, 0] * np.cos(angle) + to_world[:3, 1] * np.sin(angle)
    case.vertices = case.vertices + value / 100 * camera["width"] * distance / camera["fx"] * shift


@axis("pose error", "turn, degrees", (1, 2, 5, 10, 20))
def _pose(case, setting, value):
    """The geometry is turned about its centre."""
    turn = Rotation.from_rotvec(np.radians(value) * scenes.unit(setting.random.normal(size=3)))
    centre = case.vertices.mean(0)
    case.vertices = turn.apply(case.vertices - centre) + centre


@axis("wrong UV", "warp, mm", (0.2, 0.5, 1, 3, 10), zero=0.0, changes="uv",
      concerns=lambda scene: scene.material != "white", geometry=lambda value: scenes.LIBRARY_TEXELS)  # fmt: skip
def _wrong_uv(case, setting, value):
    """The photographed texels are the library's own, and the texture coordinates that are given are warped in waves of
    25 mm; at 0 texture and photo coincide."""
    # one tile is a unit of uv: the surface says how many millimetres that is
    p, q = case.corner_uv[:, 1] - case.corner_uv[:, 0], case.corner_uv[:, 2] - case.corner_uv[:, 0]
    surface = 2 * shape(case.vertices, case.faces).area
    tile = 1e3 * np.sqrt(surface / np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum())
    random, warp = setting.random, np.zeros((*case.corner_uv.shape[:2], 2))
    place = 1e3 * case.vertices[case.faces]  # the warp is a field in space, so that charts stay whole
    for k in range(2):
        for _ in range(4):
            wave = 2 * np.pi / WARP_LENGTH_MM * scenes.unit(random.normal(size=3))
            warp[..., k] += np.sin(place @ wave + random.uniform(0, 2 * np.pi))
    case.corner_uv = case.corner_uv + value / tile * warp / np.sqrt(2)


@axis("clipping", "clipped pixels, %", (1, 5, 15, 35, 65))
def _clipping(case, setting, value):
    """An 8-bit photograph, so exposed that this part of the object's pixels is clipped."""
    limit = np.quantile(case.image[case.region].max(-1), 1 - value / 100)
    case.image, case.truth, case.coded = case.image / limit, case.truth / limit, True


def _flux(coefficients) -> float:
    return float(coefficients[0] @ REC709_LUMINANCE)


def with_lamps(case, setting, lamps, share: float) -> None:
    """The photograph and lamps that give ``share`` of all light at the object's centre, each as much as another."""
    flux = share / (1 - share) * _flux(case.truth) / len(lamps)
    for lamp in lamps:
        more = scenes.lamp_coefficients(lamp)
        factor = flux / _flux(more)
        case.image = case.clean = case.image + factor * setting.photograph(scenes.lamp_name(lamp))
        case.truth = case.truth + factor * more


@axis("sun", "share of the sun, %", (10, 30, 60, 85, 97))
def _sun(case, setting, value):
    """A sun of 0.54 degrees beside the map."""
    number = setting.number % len(scenes.SUNS)
    with_lamps(case, setting, [(None, scenes.SUNS[number])], value / 100)


@axis("coloured light", "saturation", (0.2, 0.4, 0.6, 0.8, 1.0), zero=0.0)
def _coloured(case, setting, value):
    """Two maps at once, one tinted orange, the other blue."""
    other = setting.lights[(setting.number + 1) % len(setting.lights)]
    light, second = true_lighting(other, scenes.ORDER), setting.photograph(f"light-{scenes.light_name(other)}")
    warm = np.array([1, 1 - 0.55 * value, 1 - 0.95 * value])
    cool = np.array([1 - 0.9 * value, 1 - 0.4 * value, 1]) * _flux(case.truth) / _flux(light)
    case.image = case.clean = warm * case.image + cool * second
    case.truth = warm * case.truth + cool * light


@axis("near light", "distance, object radii", scenes.NEAR)
def _near(case, setting, value):
    """Half of the light comes from a ball that stands near; the truth is the light at the object's centre."""
    with_lamps(case, setting, [(value, scenes.LAMP_FROM)], 0.5)


@axis("second object", "distance, object radii", scenes.WALL, reaching=wall.coefficients)
def _second_object(case, setting, value):
    """A large red surface, which nobody tells of, stands beside the object; the truth is the light without it."""
    case.image = case.clean = setting.photograph(f"wall-{value:g}-{scenes.light_name(setting.light)}")
