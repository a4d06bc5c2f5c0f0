# SPDX-License-Identifier: GPL-3.0-or-later
"""The nine methods, each from a job folder to a light. Six are the engine's, three are the study's own."""

import time
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from btfsep_engine import sh
from btfsep_engine.btf.library import Library
from btfsep_engine.btf.model import Lambertian, Tabulated
from btfsep_engine.errors import InputError
from btfsep_engine.light.files import read_lighting
from scripts.studies.stability import haber_alternating, joint_parametric, lobes, scenes

LOOKED_AT = 800  # pixels, of the methods that estimate reflectance too
LAMBERTIAN_PIXELS, ALBEDO = 4000, 0.5


@dataclass(frozen=True)
class Given:
    """A light that a method found.

    Attributes
    ----------
    coefficients : (terms, 3), None where the method refused
    stddev : (terms, 3), None where the method states none
    warnings : what it said
    interval : (2, terms, 3), the stated 95 % range; None where there are only standard deviations
    expected : the relative error up to order 2 that the method itself expects, one free scale; None: not stated
    seconds : float
    """

    coefficients: np.ndarray | None
    stddev: np.ndarray | None = None
    warnings: tuple = ()
    interval: np.ndarray | None = None
    expected: float | None = None
    seconds: float = 0.0


class Blended:
    """A library in which every material is mixed with another one."""

    def __init__(self, library: Library, other: str, share: float):
        self.library, self.other, self.share = library, other, share

    @property
    def digest(self) -> str:
        return f"{self.library.digest}+{self.share}*{self.other}"

    def names(self) -> list:
        return self.library.names()

    def load(self, name: str):
        return blended(self.library.load(name), self.library.load(self.other), self.share)


def blended(first, second: Tabulated, share: float) -> Tabulated:
    """``1 - share`` of a material and ``share`` of the mean ABRDF of another; of share 1, the other itself."""
    if share == 1:
        return second
    mean = second.mean_abrdf[..., None]
    if isinstance(first, Lambertian):
        angular = np.broadcast_to((np.asarray(first.albedo) / np.pi).astype(np.float32)[:, None], mean.shape)
        texels, edge = np.ones((1, 1, 1), np.float32), second.texel_mm
        views, lights = second.views, second.lights
    else:
        angular, texels, edge, views, lights = first.angular, first.texels, first.texel_mm, first.views, first.lights
        if not (np.array_equal(views, second.views) and np.array_equal(lights, second.lights)):
            raise ValueError("materials that were measured in different directions")
    both = np.concatenate([angular * np.float32(1 - share), mean * np.float32(share)], -1)
    texels = np.concatenate([texels, np.ones((*texels.shape[:2], 1), np.float32)], -1)
    return Tabulated(f"{first.name} with {second.name}", first.material_class, texels, both, views, lights, edge)


def _engine(folder, material, library, **settings) -> Given:
    from btfsep_engine.commands.estimate import run_estimate
    from btfsep_engine.pipeline.settings import choose
    from btfsep_engine.progress import Reporter

    result = run_estimate(
        folder,
        library,
        choose(**settings),
        material=material,
        out=folder / "result",
        with_report=False,
        reporter=Reporter(),
    )
    light, expected = read_lighting(result["lighting"]), result["expected_error"]
    stated = None if expected is None else expected["order_2"]["median"]
    return Given(light.coefficients, light.stddev, tuple(result["warnings"]), interval=light.interval, expected=stated)


def paper(**changes):
    """Weinmann et al. 2016: least squares (eq. 11) on renderings with the material, eight reflections included."""
    return partial(_engine, preset="paper", **changes)


def lambertian_light(normals, radiance) -> np.ndarray:
    """SH coefficients (9, 3) of the light that explains ``radiance : (p, 3)`` of a Lambertian object, without shadows.

    Ramamoorthi and Hanrahan, "An Efficient Representation for Irradiance Environment Maps" (SIGGRAPH 2001): irradiance
    is a quadratic polynomial of the normal, its nine coefficients the light's times pi, 2 pi / 3 and pi / 4. The albedo
    is unknown: its colour is taken to be the photograph's (the light's mean is grey), its level `ALBEDO`.
    """
    per_term = np.repeat(sh.cosine_lobe(2), [1, 3, 5])
    basis = sh.evaluate(2, normals) * (ALBEDO / np.pi * per_term)
    x = np.linalg.lstsq(basis, np.asarray(radiance, np.float64), rcond=None)[0]
    return x * (x[0].mean() / np.where(np.abs(x[0]) > 1e-9 * np.abs(x).max(), x[0], np.inf))


def lambertian(folder, material, library) -> Given:
    """`lambertian_light`; it is not told the material."""
    seen, radiance = lobes.look(folder, count=LAMBERTIAN_PIXELS, shadows=False)
    if len(radiance) < 9:
        raise InputError("the fit", f"{len(radiance)} pixels for 9 unknowns", "use a larger picture")
    return Given(lambertian_light(seen.normal, radiance))


def alternating(folder, material, library) -> Given:
    """`haber_alternating`; it is not told the material."""
    seen, radiance = lobes.look(folder, count=LOOKED_AT)
    matrices = [seen.lambert(), *(seen.ggx(a) for a in haber_alternating.ALPHAS)]
    light = haber_alternating.fit(matrices, radiance).light
    return Given(lobes.to_coefficients(light, scenes.ORDER))


def joint(folder, material, library) -> Given:
    """`joint_parametric`; it is not told the material."""
    seen, radiance = lobes.look(folder, count=LOOKED_AT)
    found = joint_parametric.fit(seen.lambert(), [seen.ggx(a) for a in joint_parametric.ALPHAS], radiance)
    return Given(lobes.to_coefficients(found.light, scenes.ORDER))


METHODS = {  # method -> what it is called, and how
    "ours": ("ours (default)", _engine),
    "paper-btf": ("paper, BTF", paper(appearance="textured")),
    "paper-mean": ("paper, mean ABRDF", paper()),  # their regulariser, section 3.3
    "paper-2": ("paper, order 2", paper(order=2)),
    "paper-3": ("paper, order 3", paper(order=3)),
    "paper-order": ("paper, order cross-validated", paper(order="auto")),  # the paper names none
    "lambertian": ("Lambertian, order 2", lambertian),
    "alternating": ("alternating (after Haber 2009)", alternating),
    "joint": ("joint parametric (after Lombardi and Nishino)", joint),
}
NAMES = {method: words for method, (words, _) in METHODS.items()}
BLIND = ("lambertian", "alternating", "joint")  # not told the material, nor where its texture lies
STATES_SPREAD = tuple(m for m in METHODS if m not in BLIND)


def estimate(method: str, folder, case, library) -> Given:
    """One method on one job; a refusal in words is an answer."""
    if case.blend:
        library = Blended(library, *case.blend)
    library.load(case.material)  # a library that is broken, or being built anew, is no answer of a method
    start = time.perf_counter()
    try:
        found = METHODS[method][1](folder, case.material, library)
    except InputError as error:
        if not (folder / "job.json").exists():
            raise  # somebody cleaned up: no answer either
        found = Given(None, warnings=(f"refused: {error}",))
    return replace(found, seconds=time.perf_counter() - start)
