# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera's tone curve: chosen where the job says that it is unknown, doubted where another explains far more.

The basis images are the same whatever the curve: a candidate costs one fit. The photo of each scene is then read by the
most probable curve, so that nothing after this knows of it, but for the samples of the light, which are in the end a
mixture over all curves that are nearly as probable.
"""

import copy
from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.errors import InputError
from btfsep_engine.fit.stated import restated
from btfsep_engine.fit.tone_curve import (
    CANDIDATES,
    LINEAR,
    SRGB,
    ToneCurve,
    darkest_offset,
    importance,
    log_probability,
    probabilities,
)
from btfsep_engine.images import linear_to_srgb
from btfsep_engine.pipeline.settings import FitSettings
from btfsep_engine.pipeline.together import all_weights, fit_together

PLAUSIBLE = 0.05  # probability of a curve whose light is among what is stated
FAR = 15.0  # of the logarithm of the probability: how much more another curve has to explain before it is said


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


def refuse_unknown(scenes, settings: FitSettings) -> None:
    """InputError where a curve is to be found and the estimator has no evidence to find it by."""
    if settings.estimator != "map" and any(each.job.image_colorspace == "unknown" for each in scenes):
        raise InputError(
            "image_colorspace",
            f"'unknown' with --estimator {settings.estimator}",
            "say srgb or linear (--colorspace), or take --estimator map",
        )


def is_coded(job) -> bool:
    """Whether the job's photo was decoded by the sRGB curve."""
    by_default = job.photo.bits is not None and job.image_colorspace in ("auto", "unknown")
    return by_default or job.image_colorspace == "srgb"


def codes_of(job) -> np.ndarray:
    """(h, w, 3) float32, a photo's codes, 1: the largest."""
    radiance = job.photo.radiance
    return linear_to_srgb(radiance).astype(np.float32) if is_coded(job) else radiance


def with_curves(problems, rich, settings: FitSettings):
    """The problems with photos read by the most probable curve, where a job says that it is unknown; and ``rich``.

    Parameters
    ----------
    problems : list of Problem, one for each photograph, with the photos' own values; rich : with textures, or None
    settings : with a prior
    """
    codes = [codes_of(p.scene.job) if _is_sought(p.scene) else None for p in problems]
    if all(c is None for c in codes):
        return problems, rich
    curves = list(CANDIDATES)
    logs = [_log_of(curve, problems, codes, settings) for curve in curves]
    photos = [(c, p.scene.job.photo) for c, p in zip(codes, problems, strict=True) if c is not None]
    offset = min(darkest_offset(c[photo.usable]) for c, photo in photos)
    if offset:
        at = int(np.argmax(logs))
        for near in CANDIDATES[max(at - 1, 0) : at + 2]:
            curves.append(ToneCurve(near.steepness, offset))
            logs.append(_log_of(curves[-1], problems, codes, settings))
    order = np.argsort(-np.array(logs))
    found = tuple(curves[i] for i in order)
    shares = probabilities(np.array(logs)[order])
    scenes = [
        p.scene if c is None else _read(p.scene, Curves(c, found, shares)) for p, c in zip(problems, codes, strict=True)
    ]

    def seen(each):
        return [replace(p, scene=s) for p, s in zip(each, scenes, strict=True)]

    return seen(problems), rich and seen(rich)


def _is_sought(scene) -> bool:
    """Whether the scene's photo has codes of an unknown curve which is not chosen yet."""
    job = scene.job
    return job.image_colorspace == "unknown" and job.photo.bits is not None and scene.curves is None


def read_otherwise(scene) -> bool:
    """Whether the scene's photo was found to have another curve than sRGB, as which it was read at first."""
    return scene.curves is not None and scene.curves.curves[0] != SRGB


def _read(scene, curves: Curves):
    """The scene with its photo read by the most probable curve."""
    out = copy.copy(scene)
    radiance = curves.curves[0].decode(curves.codes).astype(np.float32)
    out.job = replace(scene.job, photo=replace(scene.job.photo, radiance=radiance))
    out.curves = curves
    return out


def _at(problem, image):
    """(p, …), an image's values at a problem's pixels."""
    return image[problem.pixels[:, 0], problem.pixels[:, 1]]


def _log_of(curve: ToneCurve, problems, codes, settings: FitSettings) -> float:
    """The logarithm of a curve's probability, of all photos whose ``codes`` are given."""
    posed, slopes = [], []
    for p, image in zip(problems, codes, strict=True):
        clipped = np.zeros((len(p.pixels), 3), bool)
        if p.scene.job.photo.clipped is not None:
            clipped = _at(p, p.scene.job.photo.clipped)
        values = p.radiance() if image is None else _at(p, image)
        measured = None if image is None else curve.decode(values)
        posed.append(replace(p, measured=measured, weights=importance(values, clipped)))
        slopes.append(np.zeros(values.shape) if image is None else curve.log_slope(values))
    fit, _, exposures = fit_together(posed, replace(settings, order=settings.fit_order))
    slopes = np.concatenate([s - np.log(e) for s, e in zip(slopes, exposures, strict=True)])
    return log_probability(fit, slopes, all_weights(posed)) + curve.log_prior


def as_read_by(problem, curve: ToneCurve, codes) -> np.ndarray:
    """(p, 3), what a problem measures where its photo's ``codes`` (h, w, 3) are read by a curve."""
    values = curve.decode(_at(problem, codes))
    if problem.scales is not None:
        parts = [b / s for b, s in zip(problem.by_object(values), problem.scales, strict=True)]
        values = np.concatenate(parts)
    clipped = problem.scene.job.photo.clipped
    if clipped is None:
        return values
    return np.where(_at(problem, clipped), problem.radiance(), values)  # every curve has 1 for the largest code


def with_other_curves(problems, fit, solver, exposures):
    """The fit with samples of its light in proportion to the curves' probabilities, each in the fit's own scale."""
    known = next((p.scene.curves for p in problems if p.scene.curves is not None), None)
    if known is None:
        return fit
    kept = known.shares > PLAUSIBLE
    counts = np.floor(known.shares * kept / known.shares[kept].sum() * len(fit.samples)).astype(int)
    samples, x = [fit.samples[: len(fit.samples) - counts[1:].sum()]], fit.all_coefficients
    for curve, count in zip(known.curves[1:], counts[1:], strict=True):
        if not count:
            continue
        measured = [
            p.radiance() if p.scene.curves is None else as_read_by(p, curve, p.scene.curves.codes) for p in problems
        ]
        b = np.concatenate([m / e for m, e in zip(measured, exposures, strict=True)])
        other = solver.solve(b, weights=all_weights(problems))
        scale = float((other.all_coefficients * x).sum() / max(np.square(other.all_coefficients).sum(), 1e-300))
        samples.append(scale * other.samples[:count])
    return restated(fit, np.concatenate(samples)) if len(samples) > 1 else fit


def curve_words(problems) -> str:
    """How the photos were decoded, and why."""
    said = []
    for problem in problems:
        scene = problem.scene
        asked, bits, curves = scene.job.image_colorspace, scene.job.photo.bits, scene.curves
        if curves is not None:
            each = [
                f"{curve.words} (probability {share:.2f})"
                for curve, share in zip(curves.curves, curves.shares, strict=True)
                if share > PLAUSIBLE or curve is curves.curves[0]
            ]
            others = f"; also possible: {', '.join(each[1:])}" if each[1:] else ""
            said.append(f"by evidence {each[0]}{others}")
        elif asked in ("auto", "unknown"):
            said.append(
                "linear, as floating-point numbers are" if bits is None else "sRGB, as whole numbers are by default"
            )
        else:
            said.append(f"{'sRGB' if asked == 'srgb' else 'linear'}, as stated")
    return f"the photo's tone curve is {' | '.join(dict.fromkeys(said))}"


def curve_doubts(problems, fit, solver, exposures) -> list[str]:
    """That an 8-bit photo's own curve, sRGB or linear, explains it far worse than the other would."""
    jobs = [p.scene.job for p in problems]
    if solver is None or any(j.photo.bits != 8 or j.image_colorspace == "unknown" for j in jobs):
        return []
    if len({is_coded(j) for j in jobs}) > 1:
        return []
    coded = is_coded(jobs[0])
    images = [codes_of(j) for j in jobs]
    codes = np.concatenate([_at(p, image) for p, image in zip(problems, images, strict=True)])
    unit = np.concatenate([np.full((len(p.pixels), 1), e) for p, e in zip(problems, exposures, strict=True)])
    own = all_weights(problems)
    weights = importance(codes, np.zeros(codes.shape, bool) if own is None else own < 1)
    logs = []
    for curve in (LINEAR, SRGB):
        b = np.concatenate([as_read_by(p, curve, image) for p, image in zip(problems, images, strict=True)]) / unit
        answer = solver.solve(b, weights=weights, start=fit)
        logs.append(log_probability(answer, curve.log_slope(codes) - np.log(unit), weights))
    if logs[1 - coded] - logs[coded] < FAR:
        return []
    read, other = ("sRGB", "linear") if coded else ("linear", "sRGB")
    return [
        f"the photo's tone curve is doubtful: it was read as {read}, and as {other} the light would explain it far "
        f"better; if you know the curve, state it (image_colorspace), else 'unknown' finds one (--colorspace unknown)"
    ]
