# SPDX-License-Identifier: GPL-3.0-or-later
"""The fifteen ways in which a case is disturbed, each in five severities."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.sparse import identity
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from btfsep_engine.conventions import REC709_LUMINANCE
from scripts.studies import scenes
from scripts.studies.cases import (
    Case,
    edge_length,
    photograph,
    true_light,
    umbrella,
    undisturbed,
    vertex_normals,
)

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


@dataclass(frozen=True)
class Axis:
    """One way of disturbing.

    Attributes
    ----------
    label : what the values are
    words : what is done
    values : five severities
    make : (Setting, value) -> Case
    zero : None, or the value at which nothing is disturbed, where that is not the plain photograph
    concerns : Scene -> bool
    changes : "photo" (or the geometry), "material" or "uv": what differs from the case at zero
    """

    label: str
    words: str
    values: tuple
    make: Callable
    zero: float | None = None
    concerns: Callable = lambda scene: True
    changes: str = "photo"


def _plain(setting: Setting) -> Case:
    return undisturbed(setting.work, setting.scene, setting.light)


def _noise(setting, value) -> Case:
    case = _plain(setting)
    b, level = np.maximum(case.image, 0), case.level
    spread = value * np.sqrt(level * b + (0.1 * level) ** 2)
    case.image = np.maximum(case.image + spread * setting.random.normal(size=b.shape), 0)
    return case


def _few_pixels(setting, value) -> Case:
    case = _plain(setting)
    size = case.image.shape[0]
    few = int(value)
    edges = np.linspace(0, size, few + 1)
    fine = 8  # samples of a large pixel, along each side
    at = (edges[:-1, None] + (np.arange(fine) + 0.5) / fine * np.diff(edges)[:, None]).ravel() - 0.5
    rows, columns = np.meshgrid(at, at, indexing="ij")
    sampled = np.stack(
        [map_coordinates(case.image[..., c], [rows, columns], order=1, mode="nearest") for c in range(3)], -1
    )
    case.image = sampled.reshape(few, fine, few, fine, 3).mean((1, 3))
    scale = few / size
    case.camera = case.camera | {"width": few, "height": few}
    case.camera |= {key: case.camera[key] * scale for key in ("fx", "fy", "cx", "cy")}
    return case


def _flat(setting, value) -> Case:
    return undisturbed(setting.work, setting.scene, setting.light, geometry=f"{value:g}")


def _same_class(setting, value) -> Case:
    case = _plain(setting)
    case.blend = (SAME_CLASS[setting.scene.material], value)
    return case


def _other_class(setting, value) -> Case:
    case = _plain(setting)
    case.blend = (OTHER_CLASS[setting.scene.material], value)
    return case


def smoothed(values, vertices, faces, length: float) -> np.ndarray:
    """Values (v, k) on a mesh after heat has flown ``length`` (implicit steps of the umbrella Laplacian)."""
    step = 2 * length**2 / edge_length(vertices, faces) ** 2 / SMOOTHING_STEPS
    count = len(vertices)
    solver = splu((identity(count) * (1 + step) - step * umbrella(faces, count)).tocsc())
    for _ in range(SMOOTHING_STEPS):
        values = solver.solve(np.ascontiguousarray(values))
    return values


def _smoothing(setting, value) -> Case:
    case = _plain(setting)
    case.vertices = smoothed(case.vertices, case.vertices, case.faces, 1e-3 * value)
    return case


def _bumps(setting, value) -> Case:
    case = _plain(setting)
    height = setting.random.normal(size=(len(case.vertices), 1))
    height = smoothed(height, case.vertices, case.faces, 1e-3 * NOISE_LENGTH_MM)
    normals = vertex_normals(case.vertices, case.faces)
    case.vertices = case.vertices + 1e-3 * value * height / height.std() * normals
    return case


def _misaligned(setting, value) -> Case:
    case = _plain(setting)
    camera = case.camera
    to_world = np.array(camera["to_world"])
    distance = np.linalg.norm(to_world[:3, 3] - case.vertices.mean(0))
    angle = setting.random.uniform(0, 2 * np.pi)
    shift = to_world[:3, 0] * np.cos(angle) + to_world[:3, 1] * np.sin(angle)
    case.vertices = case.vertices + value / 100 * camera["width"] * distance / camera["fx"] * shift
    return case


def _pose(setting, value) -> Case:
    case = _plain(setting)
    axis = setting.random.normal(size=3)
    turn = Rotation.from_rotvec(np.radians(value) * axis / np.linalg.norm(axis)).as_matrix()
    centre = case.vertices.mean(0)
    case.vertices = (case.vertices - centre) @ turn.T + centre
    return case


def _wrong_uv(setting, value) -> Case:
    case = undisturbed(setting.work, setting.scene, setting.light, geometry=scenes.LIBRARY_TEXELS)
    # one tile is a unit of uv: the surface says how many millimetres that is
    a, b, c = (case.vertices[case.faces[:, i]] for i in range(3))
    surface = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    p, q = case.corner_uv[:, 1] - case.corner_uv[:, 0], case.corner_uv[:, 2] - case.corner_uv[:, 0]
    tile = 1e3 * np.sqrt(surface / np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum())
    random = setting.random
    warp = np.zeros((*case.corner_uv.shape[:2], 2))
    place = 1e3 * case.vertices[case.faces]  # the warp is a field in space, so that charts stay whole
    for k in range(2):
        for _ in range(4):
            wave = random.normal(size=3)
            wave *= 2 * np.pi / WARP_LENGTH_MM / np.linalg.norm(wave)
            warp[..., k] += np.sin(place @ wave + random.uniform(0, 2 * np.pi))
    case.corner_uv = case.corner_uv + value / tile * warp / np.sqrt(2)
    return case


def _clipping(setting, value) -> Case:
    case = _plain(setting)
    brightest = case.image[case.region].max(-1)
    case.image = case.image / np.quantile(brightest, 1 - value / 100)
    case.truth = case.truth / np.quantile(brightest, 1 - value / 100)
    case.coded = True
    return case


def _flux(coefficients) -> float:
    return float(coefficients[0] @ REC709_LUMINANCE)


def _with_lamp(setting, name: str, lamp, share: float) -> Case:
    """The photograph and a lamp that gives ``share`` of all light at the object's centre."""
    case = _plain(setting)
    more = scenes.lamp_coefficients(lamp)
    factor = share / (1 - share) * _flux(case.truth) / _flux(more)
    case.image = case.image + factor * photograph(setting.work, setting.scene, scenes.AS_IS, name)
    case.truth = case.truth + factor * more
    case.clean = case.image
    return case


def _sun(setting, value) -> Case:
    number = setting.number % len(scenes.SUNS)
    return _with_lamp(setting, f"sun-{number}", (None, scenes.SUNS[number]), value / 100)


def _near(setting, value) -> Case:
    return _with_lamp(setting, f"near-{value:g}", (value, scenes.LAMP_FROM), 0.5)


def _coloured(setting, value) -> Case:
    case = _plain(setting)
    other = setting.lights[(setting.number + 1) % len(setting.lights)]
    second, light = photograph(setting.work, setting.scene, scenes.AS_IS, f"light-{scenes.light_name(other)}"), None
    light = true_light(setting.work, other)
    factor = _flux(case.truth) / _flux(light)
    warm = np.array([1, 1 - 0.55 * value, 1 - 0.95 * value])
    cool = np.array([1 - 0.9 * value, 1 - 0.4 * value, 1])
    case.image = warm * case.image + factor * cool * second
    case.truth = warm * case.truth + factor * cool * light
    case.clean = case.image
    return case


def _second_object(setting, value) -> Case:
    case = _plain(setting)
    name = f"wall-{value:g}-{scenes.light_name(setting.light)}"
    case.image = case.clean = photograph(setting.work, setting.scene, scenes.AS_IS, name)
    return case


def _textured(scene) -> bool:
    return scene.material != "white"


AXES = {
    "noise": Axis(
        "noise, of the object's mean",
        "photon and sensor noise in every pixel, zero-mean before it is cut at 0",
        (0.03, 0.1, 0.3, 1.0, 3.0),
        _noise,
    ),
    "few pixels": Axis(
        "pixels across the picture",
        "the photograph is made smaller, each new pixel the mean of the old ones",
        (80, 40, 24, 16, 10),
        _few_pixels,
    ),
    "flat geometry": Axis(
        "thickness along the view",
        "the object is a flatter and flatter relief, seen from the front (photographed so)",
        scenes.THICKNESS,
        _flat,
    ),
    "wrong material, same class": Axis(
        "share of the wrong material",
        "the material that is given is mixed with another of its class, in the end is that one",
        (0.1, 0.25, 0.5, 0.75, 1.0),
        _same_class,
        concerns=lambda scene: scene.material in SAME_CLASS,
        changes="material",
    ),
    "wrong material, other class": Axis(
        "share of the wrong material",
        "the same with a material of another class (matte for glossy, glossy for matte)",
        (0.1, 0.25, 0.5, 0.75, 1.0),
        _other_class,
        changes="material",
    ),
    "geometry smoothed": Axis(
        "length, mm (object: 150)",
        "the geometry that is given is smoothed (heat flow over the mesh)",
        (1, 2, 4, 8, 16),
        _smoothing,
    ),
    "geometry noisy": Axis(
        "height of bumps, mm",
        f"bumps of about {NOISE_LENGTH_MM:g} mm along the normals of the geometry that is given",
        (0.05, 0.1, 0.2, 0.5, 1.0),
        _bumps,
    ),
    "misaligned": Axis(
        "shift, % of the picture",
        "the geometry stands beside its picture",
        (0.5, 1, 2, 4, 8),
        _misaligned,
    ),
    "pose error": Axis("turn, degrees", "the geometry is turned about its centre", (1, 2, 5, 10, 20), _pose),
    "wrong UV": Axis(
        "warp, mm",
        "the photographed texels are the library's own, and the texture coordinates that are given are warped "
        f"in waves of {WARP_LENGTH_MM:g} mm; at 0 texture and photo coincide",
        (0.2, 0.5, 1, 3, 10),
        _wrong_uv,
        zero=0.0,
        concerns=_textured,
        changes="uv",
    ),
    "clipping": Axis(
        "clipped pixels, %",
        "an 8-bit photograph, so exposed that this part of the object's pixels is clipped",
        (1, 5, 15, 35, 65),
        _clipping,
    ),
    "sun": Axis("share of the sun, %", "a sun of 0.54 degrees beside the map", (10, 30, 60, 85, 97), _sun),
    "coloured light": Axis(
        "saturation",
        "two maps at once, one tinted orange, the other blue",
        (0.2, 0.4, 0.6, 0.8, 1.0),
        _coloured,
        zero=0.0,
    ),
    "near light": Axis(
        "distance, object radii",
        "half of the light comes from a ball that stands near; the truth is the light at the object's centre",
        scenes.NEAR,
        _near,
    ),
    "second object": Axis(
        "distance, object radii",
        "a large red surface, which nobody tells of, stands beside the object; the truth is the light without it",
        scenes.WALL,
        _second_object,
    ),
}
