# SPDX-License-Identifier: GPL-3.0-or-later
"""The seven methods, each from a job folder to a light. Four are the engine's, three are the study's own."""

import time
from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.btf.library import Library
from btfsep_engine.btf.model import Lambertian, Tabulated
from btfsep_engine.errors import InputError
from btfsep_engine.light.files import read_lighting
from scripts.studies import haber_alternating, joint_parametric, lambertian, lobes, scenes

LOOKED_AT = 800  # pixels, of the methods that estimate reflectance too
LAMBERTIAN_PIXELS = 4000


@dataclass(frozen=True)
class Given:
    """A light that a method found.

    Attributes
    ----------
    coefficients : (terms, 3), None where the method refused
    stddev : (terms, 3), None where the method states none
    warnings : what it said
    determined : "the photo determines 14 of 25 coefficients", or ""
    seconds : float
    interval : (2, terms, 3), the stated 95 % range; None where there are only standard deviations
    expected : the relative error up to order 2 that the method itself expects, one free scale; None: not stated
    """

    coefficients: np.ndarray | None
    stddev: np.ndarray | None
    warnings: tuple
    determined: str
    seconds: float
    interval: np.ndarray | None = None
    expected: float | None = None


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
    from btfsep_engine.pipeline.estimation import run_estimate
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
    light = read_lighting(result["lighting"])
    said = result.get("determined", "")
    expected = result["expected_error"]
    return Given(
        light.coefficients,
        light.stddev,
        tuple(result["warnings"]),
        str(said),
        0.0,
        light.interval,
        None if expected is None else expected["order_2"]["median"],
    )


def ours(folder, material, library) -> Given:
    """The engine's default estimator."""
    return _engine(folder, material, library)


def paper_btf(folder, material, library) -> Given:
    """Weinmann et al. 2016: least squares of order 4 (eq. 11) on renderings with the BTF, reflections included."""
    return _engine(folder, material, library, preset="paper", appearance="textured")


def paper_mean(folder, material, library) -> Given:
    """The same with the mean ABRDF (their regulariser, section 3.3)."""
    return _engine(folder, material, library, preset="paper", appearance="mean")


def paper_order(folder, material, library) -> Given:
    """The same at the order that block cross-validation chooses (the paper names none)."""
    return _engine(folder, material, library, preset="paper", order="auto")


def lambertian_order_2(folder, material, library) -> Given:
    """`lambertian`; it is not told the material."""
    seen, radiance = lobes.look(folder, count=LAMBERTIAN_PIXELS, shadows=False)
    if len(radiance) < 9:
        raise InputError("the fit", f"{len(radiance)} pixels for 9 unknowns", "use a larger picture")
    return Given(lambertian.fit(seen.normal, radiance), None, (), "", 0.0)


def alternating(folder, material, library) -> Given:
    """`haber_alternating`; it is not told the material."""
    seen, radiance = lobes.look(folder, count=LOOKED_AT)
    matrices = [seen.lambert(), *(seen.ggx(a) for a in haber_alternating.ALPHAS)]
    light = haber_alternating.fit(matrices, radiance).light
    return Given(lobes.to_coefficients(light, scenes.ORDER), None, (), "", 0.0)


def joint(folder, material, library) -> Given:
    """`joint_parametric`; it is not told the material."""
    seen, radiance = lobes.look(folder, count=LOOKED_AT)
    found = joint_parametric.fit(seen.lambert(), [seen.ggx(a) for a in joint_parametric.ALPHAS], radiance)
    return Given(lobes.to_coefficients(found.light, scenes.ORDER), None, (), "", 0.0)


METHODS = {
    "ours": ours,
    "paper-btf": paper_btf,
    "paper-mean": paper_mean,
    "paper-order": paper_order,
    "lambertian": lambertian_order_2,
    "alternating": alternating,
    "joint": joint,
}
NAMES = {
    "ours": "ours (default)",
    "paper-btf": "paper, BTF",
    "paper-mean": "paper, mean ABRDF",
    "paper-order": "paper, order cross-validated",
    "lambertian": "Lambertian, order 2",
    "alternating": "alternating (after Haber 2009)",
    "joint": "joint parametric (after Lombardi and Nishino)",
}
BLIND = ("lambertian", "alternating", "joint")  # not told the material, nor where its texture lies
STATES_SPREAD = ("ours", "paper-btf", "paper-mean", "paper-order")


def estimate(method: str, folder, case, library) -> Given:
    """One method on one job; a refusal in words is an answer."""
    if case.blend:
        library = Blended(library, *case.blend)
    library.load(case.material)  # a library that is broken, or being built anew, is no answer of a method
    start = time.perf_counter()
    try:
        found = METHODS[method](folder, case.material, library)
    except InputError as error:
        if not (folder / "job.json").exists():
            raise  # somebody cleaned up: no answer either
        return Given(None, None, (f"refused: {error}",), "", time.perf_counter() - start)
    seconds = time.perf_counter() - start
    return replace(found, seconds=seconds)
