# SPDX-License-Identifier: GPL-3.0-or-later
"""The photo's tone curve, chosen where the job says that it is unknown, or the file that Blender rendered it.

The basis images are the same whatever the curve: a candidate costs one fit. The photo of each scene is then read by the
most probable curve, so that nothing after this knows of it but `pipeline.refine.curves`.
"""

import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import softmax

from btfsep_engine.errors import InputError
from btfsep_engine.fit.tone_curve import (
    AGX,
    CAMERA,
    CAMERAS,
    CANDIDATES,
    LINEAR,
    OF_RENDERS,
    OF_RENDERS_DOUBT,
    SRGB,
    VIEWS,
    Camera,
    ToneCurve,
    View,
    darkest_offset,
    importance,
    log_prior_of_render,
    log_probability,
)
from btfsep_engine.imaging.srgb import linear_to_srgb
from btfsep_engine.pipeline.settings import FitSettings
from btfsep_engine.pipeline.together import all_weights, fit_together


@dataclass(frozen=True)
class Curves:
    """What is known of the curve of a scene's photo.

    Attributes
    ----------
    codes : (h, w, 3) float32, the photo as stored, 1: the largest code
    curves : ToneCurve of each candidate, the most probable first; shares : (n,), their probabilities
    """

    codes: np.ndarray
    curves: tuple
    shares: np.ndarray


ANY, OF_BLENDER = "any", "of Blender"
RENDERS = tuple(SRGB if name == "srgb" else VIEWS[name] for name in OF_RENDERS)


def sought(job) -> str | None:
    """Among which curves a job's photo's is sought: `ANY`, or those of what Blender saves; None: it is known."""
    stated, photo = job.image_colorspace, job.photo
    if photo.bits is None or stated not in ("auto", "unknown", "blender"):
        return None
    if stated == "auto":
        return OF_BLENDER if photo.is_render and photo.profile is None and not photo.camera else None
    return ANY if stated == "unknown" else OF_BLENDER


def refuse_unknown(scenes, settings: FitSettings) -> None:
    """InputError where a curve is to be found and the estimator has no evidence to find it by."""
    for stated in ("unknown", "blender"):
        if settings.estimator != "map" and any(each.job.image_colorspace == stated for each in scenes):
            raise InputError(
                "image_colorspace",
                f"'{stated}' with --estimator {settings.estimator}",
                "say srgb, linear or agx (--colorspace), or take --estimator map",
            )


def curve_read_by(job) -> ToneCurve | Camera | View:
    """By which curve the job's photo was decoded when it was read."""
    stated, photo = job.image_colorspace, job.photo
    if photo.bits is None and stated not in ("srgb", "camera", "phone", *VIEWS):
        return LINEAR
    if stated in ("auto", "unknown"):
        if photo.profile is not None and photo.profile.linear:
            return LINEAR
        return CAMERA if photo.camera else SRGB
    return {"srgb": SRGB, "camera": CAMERA, "phone": CAMERA, "linear": LINEAR, "blender": SRGB, **VIEWS}[stated]


def codes_of(job, radiance=None) -> np.ndarray:
    """float32, a job's photo's codes, 1: the largest; ``radiance`` : of some of its pixels; None: of all, (h, w, 3).

    They are of the file's own primaries, and where it has a curve of its own they are what sRGB would have. Not of what
    was read as AgX.
    """
    radiance, curve = job.photo.radiance if radiance is None else radiance, curve_read_by(job)
    if _to_rec709(job) is not None:
        radiance = np.linalg.solve(_to_rec709(job), radiance.reshape(-1, 3).T).T.reshape(radiance.shape)
    encode = {LINEAR: lambda values: values, SRGB: linear_to_srgb, CAMERA: CAMERA.encode}[curve]
    return encode(radiance).astype(np.float32)


def radiance_of(job, curve, codes) -> np.ndarray:
    """Linear Rec.709 of a job's photo's ``codes`` (..., 3), of `codes_of`, by a curve. float64."""
    values = curve.decode(codes)
    return values if _to_rec709(job) is None else values @ _to_rec709(job).T


def _to_rec709(job) -> np.ndarray | None:
    """The photo's primaries' matrix to Rec.709; None: they are those."""
    return None if job.photo.profile is None else job.photo.profile.to_rec709


def with_curves(problems, settings: FitSettings) -> list:
    """The problems with photos read by the most probable curve, where that is sought.

    Parameters
    ----------
    problems : list of Problem, one for each photograph, with the photos' own values
    settings : with a prior
    """
    among = [sought(p.scene.job) if p.scene.curves is None else None for p in problems]
    codes = [codes_of(p.scene.job) if a else None for a, p in zip(among, problems, strict=True)]
    if all(c is None for c in codes):
        return problems
    if ANY in among:
        curves, logs = _any_curve(problems, codes, settings)
    else:
        curves = RENDERS
        logs = [_log_of(curve, problems, codes, settings) for curve in curves]
        logs = np.array(logs) / OF_RENDERS_DOUBT + sum(_logs_before(c) for c in codes if c is not None)
    order = np.argsort(-np.array(logs))
    ranked, shares = tuple(curves[i] for i in order), softmax(np.array(logs)[order])
    return [
        p if c is None else replace(p, scene=read_by(p.scene, Curves(c, ranked, shares)))
        for p, c in zip(problems, codes, strict=True)
    ]


def read_by_most_usual(scene):
    """A scene with its photo read by the most probable of Blender's curves before any light is known."""
    codes = codes_of(scene.job)
    shares = softmax(_logs_before(codes))
    best = int(np.argmax(shares))
    return read_by(scene, Curves(codes, (RENDERS[best],), shares[best : best + 1]))


def _logs_before(codes) -> np.ndarray:
    """Of each of `OF_RENDERS` the logarithm of its probability, of a photo's codes alone."""
    return np.array([log_prior_of_render(name, codes) for name in OF_RENDERS])


def _any_curve(problems, codes, settings: FitSettings):
    """Curves of all kinds, and of each the logarithm of its probability."""
    curves = [*CANDIDATES, *CAMERAS, AGX]
    logs = [_log_of(curve, problems, codes, settings) + curve.log_prior for curve in curves]
    photos = [(c, p.scene.job.photo) for c, p in zip(codes, problems, strict=True) if c is not None]
    offset = min(darkest_offset(c[photo.usable]) for c, photo in photos)
    if offset:
        at = int(np.argmax(logs[: len(CANDIDATES)]))
        for near in CANDIDATES[max(at - 1, 0) : at + 2]:
            curves.append(ToneCurve(near.steepness, offset))
            logs.append(_log_of(curves[-1], problems, codes, settings) + curves[-1].log_prior)
    return curves, logs


def read_otherwise(scene) -> bool:
    """Whether the scene's photo was found to have another curve than that by which it was read at first."""
    return scene.curves is not None and scene.curves.curves[0] != curve_read_by(scene.job)


def read_by(scene, curves: Curves):
    """The scene with its photo read by the most probable curve."""
    out = copy.copy(scene)
    radiance = radiance_of(scene.job, curves.curves[0], curves.codes).astype(np.float32)
    out.job = replace(scene.job, photo=replace(scene.job.photo, radiance=radiance))
    out.curves = curves
    return out


def _log_of(curve: ToneCurve, problems, codes, settings: FitSettings) -> float:
    """The logarithm of how probable all photos are by a curve whose ``codes`` are given."""
    read, slopes = [], []
    for p, image in zip(problems, codes, strict=True):
        values = p.radiance() if image is None else p.values_of(image)
        measured = None if image is None else radiance_of(p.scene.job, curve, values)
        weights = importance(values, p.clipped) * (1.0 if p.weights is None else p.weights)
        read.append(replace(p, measured=measured, weights=weights))
        slopes.append(np.zeros(values.shape) if image is None else curve.log_slope(values))
    light = fit_together(read, replace(settings, order=settings.fit_order))
    slopes = np.concatenate([s - np.log(e) for s, e in zip(slopes, light.exposures, strict=True)])
    return log_probability(light.fit, slopes, all_weights(read))
