# SPDX-License-Identifier: GPL-3.0-or-later
"""What other tone curves make of the light: samples of those nearly as probable, a doubt where one is far more so."""

from dataclasses import dataclass, replace
from operator import is_
from weakref import WeakKeyDictionary

import numpy as np
from scipy.special import expit

from btfsep_engine.fit.stated import mixed
from btfsep_engine.fit.tone_curve import AGX, CAMERA, LINEAR, SRGB, VIEWS, ToneCurve, importance, log_probability
from btfsep_engine.pipeline.together import all_weights
from btfsep_engine.pipeline.tone import OF_BLENDER, codes_of, curve_read_by, radiance_of, sought

PLAUSIBLE = 0.05  # probability of a curve whose light is among what is stated
NAMES = {"srgb": SRGB, "camera": CAMERA, "phone": CAMERA, "linear": LINEAR, **VIEWS}
# Curves that may be said to explain a photo better, by that which it was read by. That a JPEG is linear, which none is,
# is not said: three of 29 of painted plates, read rightly, look like it.
OTHERS = {LINEAR: (SRGB, AGX, CAMERA), SRGB: (LINEAR, AGX, CAMERA), CAMERA: (SRGB,)}
STATED_AS = {AGX: "a render that was saved with that view", CAMERA: "a camera's own picture"}
FAR = 2.25  # of the logarithm of the probability: how much more another curve has to explain before it is said
# Of it: how much less probable it is, before any light is known, that 8 bits a channel are linear than that they are by
# sRGB, whatever a job says. A camera's curve has no such advance: paint and shapes by photometric stereo look like it.
SELDOM = 4.25
HARDLY_EVER = "and what has 8 bits a channel is hardly ever linear"


def _read_by(curve: ToneCurve, problem, image, codes=lambda values: values):
    """The problem with its photo read by a curve; ``codes`` : what makes codes of values of an ``image`` (h, w, 3)."""
    job = problem.scene.job
    values = problem.as_measured(problem.means_of(image, lambda some: radiance_of(job, curve, codes(some))))
    # every curve has 1 for the largest code
    return replace(problem, measured=np.where(problem.clipped, problem.radiance(), values))


def other_curves(model, light):
    """The refinement: samples of the light in proportion to the curves' probabilities, each in the fit's own scale."""
    problems, choice = model.problems, {"curve": curve_words(model.problems)}
    known = next((p.scene.curves for p in problems if p.scene.curves is not None), None)
    if known is None:
        return model, _believed(problems, light), choice

    def read_by(curve):
        return [p if p.scene.curves is None else _read_by(curve, p, p.scene.curves.codes) for p in problems]

    total, each = known.shares[known.shares > PLAUSIBLE].sum(), zip(known.curves, known.shares, strict=True)
    others = [(read_by(curve), share / total) for curve, share in list(each)[1:] if share > PLAUSIBLE]
    return model, _mixed(problems, light, others), choice


def _mixed(problems, light, others):
    """The light with samples of others; ``others`` : of each the problems as its curve reads them, and its share."""
    weights, each = all_weights(problems), []
    for read, share in others:
        each.append((light.solver.solve(light.radiance(read), weights=weights), share))
    return replace(light, fit=mixed(light.fit, each)) if each else light


def _believed(problems, light):
    """The light with samples of another curve's, where 8 bits that are said to be linear are doubted, as many as that
    is probable."""
    if any(curve_read_by(p.scene.job) is not LINEAR for p in problems) or (doubt := _doubt(problems, light)) is None:
        return light
    return _mixed(problems, light, [(doubt.read, doubt.probable)])


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
            of = "of what Blender saved " if sought(scene.job) == OF_BLENDER else ""
            said.append(f"{of}by evidence {each[0]}{others}")
        elif stated in ("auto", "unknown"):
            why, camera = "whole numbers are by default", scene.job.photo.camera
            if bits is None:
                why = "floating-point numbers are"
            elif curve_read_by(scene.job) is LINEAR:
                why = "the file's colour profile says"
            elif camera:
                why = f"the file is from {camera}"
            said.append(f"{curve_read_by(scene.job).description}, as {why}")
        else:
            said.append(f"{NAMES[stated].description}, as stated")
    words = f"the photo's tone curve is {' | '.join(dict.fromkeys(said))}"
    profiles = [p.scene.job.photo.profile for p in problems]
    names = dict.fromkeys(p.name for p in profiles if p is not None and p.to_rec709 is not None)
    return words + (f"; its colours were converted from {', '.join(names)}" if names else "")


@dataclass(frozen=True)
class Doubt:
    """That a photo of 8 bits may have an ``other`` curve than it was read by: what that explains more, ``gain`` of the
    logarithm of the probability, how ``probable`` it is beside the one it was read by, and the problems ``read`` by it.
    """

    other: ToneCurve
    gain: float
    probable: float
    read: list


# Election -> (problems, exposures, Doubt): it is asked before lamps nearby are, for what is stated and for what is
# said, of the same light as a rule
_asked: WeakKeyDictionary = WeakKeyDictionary()


def _doubt(problems, light) -> Doubt | None:
    """Whether another curve is as probable as that by which an 8-bit photo was read; None where it is not, or nothing
    is asked."""
    jobs = [p.scene.job for p in problems]
    if light.solver is None or any(j.photo.bits != 8 or sought(j) or j.image_colorspace in VIEWS for j in jobs):
        return None
    if any(p.scene.tones for p in problems):  # whose values no curve has made of codes
        return None
    read_by, *more = {curve_read_by(j) for j in jobs}
    if more:
        return None
    election = light.of_objects.election
    before, exposures, doubt = _asked.get(election, ((), (), None))
    alike = len(before) == len(problems) and all(map(is_, before, problems)) and exposures == tuple(light.exposures)
    if not alike:
        doubt = _found(problems, light, read_by)
        _asked[election] = tuple(problems), tuple(light.exposures), doubt
    return doubt


def _found(problems, light, read_by: ToneCurve) -> Doubt | None:
    """`_doubt` of photos that were read by a curve, asked anew."""
    each = [codes_of(p.scene.job, p.values_of(p.scene.job.photo.radiance)) for p in problems]  # not of all of a picture
    codes = np.concatenate(each)
    unit = np.concatenate([np.full((len(p.pixels), 1), e) for p, e in zip(problems, light.exposures, strict=True)])
    own, clipped = all_weights(problems), np.concatenate([p.clipped for p in problems])
    weights = importance(codes, clipped) * (1.0 if own is None else own)
    logs, read = {}, {}
    others = [c for c in OTHERS[read_by] if c is not LINEAR or not any(p.scene.job.photo.is_jpeg for p in problems)]
    for curve in (read_by, *others):
        read[curve] = [
            _read_by(curve, p, job.photo.radiance, lambda some, job=job: codes_of(job, some))
            for p, job in zip(problems, (p.scene.job for p in problems), strict=True)
        ]
        answer = light.solver.solve(light.radiance(read[curve]), weights=weights, start=light.of_objects)
        logs[curve] = log_probability(answer, curve.log_slope(codes) - np.log(unit), weights)
    before = {curve: SELDOM * (read_by is LINEAR and curve is SRGB) for curve in others}
    other = max(before, key=lambda curve: logs[curve] + before[curve])
    gain = logs[other] - logs[read_by]
    odds = gain + before[other]
    return Doubt(other, gain, float(expit(odds)), read[other]) if odds >= FAR else None


def curve_doubts(problems, light) -> list[str]:
    """That the curve by which an 8-bit photo was read explains it far worse than another would."""
    doubt = _doubt(problems, light)
    if doubt is None:
        return []
    read, other = curve_read_by(problems[0].scene.job).description, doubt.other
    how_much = "far better" if doubt.gain >= FAR else f"about as well, {HARDLY_EVER}"
    than = f"it was read as {read}, and as {other.description} the light would explain it {how_much}"
    if other in STATED_AS:
        name = "agx" if other is AGX else "camera"
        mend = f"if it is {STATED_AS[other]}, state it (image_colorspace, --colorspace {name})"
    else:
        mend = "if you know the curve, state it (image_colorspace), else 'unknown' finds one (--colorspace unknown)"
    return [f"the photo's tone curve is doubtful: {than}; {mend}"]
