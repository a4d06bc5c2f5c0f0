# SPDX-License-Identifier: GPL-3.0-or-later
"""What other tone curves make of the light: samples of those nearly as probable, a doubt where one is far more so."""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.stated import restated
from btfsep_engine.fit.tone_curve import AGX, LINEAR, SRGB, ToneCurve, importance, log_probability
from btfsep_engine.pipeline.together import all_weights
from btfsep_engine.pipeline.tone import codes_of, is_coded

PLAUSIBLE = 0.05  # probability of a curve whose light is among what is stated
NAMES = {"srgb": "sRGB", "linear": "linear", "agx": "Blender's view transform AgX"}
FAR = 15.0  # of the logarithm of the probability: how much more another curve has to explain before it is said


def _read_by(curve: ToneCurve, problem, codes):
    """The problem with its photo's ``codes`` (p, 3) read by a curve."""
    values = problem.as_measured(curve.decode(codes))
    # every curve has 1 for the largest code
    return replace(problem, measured=np.where(problem.clipped, problem.radiance(), values))


def other_curves(model, light):
    """The refinement: samples of the light in proportion to the curves' probabilities, each in the fit's own scale."""
    problems, fit, choice = model.problems, light.fit, {"curve": curve_words(model.problems)}
    known = next((p.scene.curves for p in problems if p.scene.curves is not None), None)
    if known is None:
        return model, light, choice
    kept = known.shares > PLAUSIBLE
    counts = np.floor(known.shares * kept / known.shares[kept].sum() * len(fit.samples)).astype(int)
    samples, x = [fit.samples[: len(fit.samples) - counts[1:].sum()]], fit.all_coefficients
    for curve, count in zip(known.curves[1:], counts[1:], strict=True):
        if not count:
            continue
        read = [
            p if p.scene.curves is None else _read_by(curve, p, p.values_of(p.scene.curves.codes)) for p in problems
        ]
        other = light.solver.solve(light.radiance(read), weights=all_weights(problems))
        y = other.all_coefficients
        samples.append(float((y * x).sum() / max(np.square(y).sum(), 1e-300)) * other.samples[:count])
    if len(samples) > 1:
        light = replace(light, fit=restated(fit, np.concatenate(samples)))
    return model, light, choice


def curve_words(problems) -> str:
    """How the photos were decoded, and why."""
    said = []
    for scene in (p.scene for p in problems):
        stated, bits, curves = scene.job.image_colorspace, scene.job.photo.bits, scene.curves
        if curves is not None:
            each = [
                f"{curve.description} (probability {share:.2f})"
                for curve, share in zip(curves.curves, curves.shares, strict=True)
                if share > PLAUSIBLE or curve is curves.curves[0]
            ]
            others = f"; also possible: {', '.join(each[1:])}" if each[1:] else ""
            said.append(f"by evidence {each[0]}{others}")
        elif stated in ("auto", "unknown"):
            said.append(
                "linear, as floating-point numbers are" if bits is None else "sRGB, as whole numbers are by default"
            )
        else:
            said.append(f"{NAMES[stated]}, as stated")
    return f"the photo's tone curve is {' | '.join(dict.fromkeys(said))}"


def curve_doubts(problems, light) -> list[str]:
    """That an 8-bit photo's own curve, sRGB or linear, explains it far worse than the other, or AgX, would."""
    jobs = [p.scene.job for p in problems]
    if light.solver is None or any(j.photo.bits != 8 or j.image_colorspace in ("unknown", "agx") for j in jobs):
        return []
    if len({is_coded(j) for j in jobs}) > 1:
        return []
    coded = is_coded(jobs[0])
    each = [codes_of(p.scene.job, p.values_of(p.scene.job.photo.radiance)) for p in problems]  # not of all of a picture
    codes = np.concatenate(each)
    unit = np.concatenate([np.full((len(p.pixels), 1), e) for p, e in zip(problems, light.exposures, strict=True)])
    own, clipped = all_weights(problems), np.concatenate([p.clipped for p in problems])
    weights = importance(codes, clipped) * (1.0 if own is None else own)
    logs = []
    for curve in (LINEAR, SRGB, AGX):
        read = [_read_by(curve, p, some) for p, some in zip(problems, each, strict=True)]
        answer = light.solver.solve(light.radiance(read), weights=weights, start=light.of_objects)
        logs.append(log_probability(answer, curve.log_slope(codes) - np.log(unit), weights))
    best = int(np.argmax(logs))
    if logs[best] - logs[coded] < FAR:
        return []
    read, other = "sRGB" if coded else "linear", (LINEAR, SRGB, AGX)[best].description
    what = f"the photo's tone curve is doubtful: it was read as {read}, and as {other} the light would explain it far"
    if best == 2:
        mend = "if it is a render that was saved with that view, state it (image_colorspace, --colorspace agx)"
    else:
        mend = "if you know the curve, state it (image_colorspace), else 'unknown' finds one (--colorspace unknown)"
    return [f"{what} better; {mend}"]
