# SPDX-License-Identifier: GPL-3.0-or-later
"""What is kept of a run: settings, versions, time, memory; and of an estimate, all that it found."""

import platform
import sys
from dataclasses import asdict
from functools import lru_cache

import numpy as np

from btfsep_engine import __version__, sh
from btfsep_engine.fit.stated import expected_error, shown_error
from btfsep_engine.pipeline.light_account import lamp_record
from btfsep_engine.pipeline.mending import mending_record
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.render.backend import choose_backend

PACKAGES = ("mitsuba", "drjit", "numpy", "scipy", "opencv-contrib-python-headless", "scikit-learn")


@lru_cache(maxsize=1)
def versions() -> dict:
    """Versions of everything that can change a result; looked up once, which reads files of every package."""
    from importlib.metadata import PackageNotFoundError, version  # slow, and the light is there before anybody asks

    def of(name):
        try:
            return version(name)
        except PackageNotFoundError:  # the same module out of a package of another name, as OpenCV's
            return "unknown"

    backend = choose_backend()
    return {
        "btfsep": __version__,
        "python": platform.python_version(),
        **{name: of(name) for name in PACKAGES},
        "variant": backend.variant,
        "llvm": backend.llvm,
    }


def peak_memory_mb() -> float | None:
    """Largest resident memory of this process so far, in megabytes; None where the system does not say."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak / (1 << 20 if sys.platform == "darwin" else 1 << 10), 1)


def run_record(settings: Settings, reporter) -> dict:
    """The part of ``result.json`` that every command shares."""
    return {
        "warnings": list(reporter.warnings),
        "seconds": {stage: round(seconds, 4) for stage, seconds in reporter.seconds.items()},
        "peak_memory_mb": peak_memory_mb(),
        "settings": asdict(settings),
        "versions": versions(),
    }


def determined_words(reported, fitted) -> str:
    """What the photo determines: "the photo determines 14 of 100 coefficients; of order 3 and above: none".

    ``reported`` : (terms,) bool, of the reported orders; ``fitted`` : of all orders of the fit
    """
    known = fitted
    text = f"the photo determines {int(np.sum(known))} of {len(known)} coefficients"
    if len(known) > len(reported):
        text += f", {int(np.sum(reported))} of the {len(reported)} that are reported"
    orders = sh.order_of(len(known))
    each = [known[l * l : (l + 1) ** 2] for l in range(orders + 1)]
    whole = next((l for l, band in enumerate(each) if not band.all()), orders + 1) - 1
    highest = max((l for l, band in enumerate(each) if band.any()), default=-1)
    if highest < 0:
        return text + "; not even how bright the light is"
    all_of = f"all up to order {whole}" if whole >= 0 else "not all of any order"
    return f"{text}; {all_of}, none above order {highest}"


def photo_record(photo) -> dict:
    """What is kept of one photograph, of an `estimation.PhotoFit`."""
    shown = {"exposure": photo.exposure, "residuals": photo.residuals, "pixels": photo.pixels}
    moved = mending_record(photo.scene)
    return {"job": photo.scene.job.folder.name, **shown, **({} if moved is None else {"alignment": moved})}


def result_record(estimate) -> dict:
    """The content of ``result.json``, of an `estimation.Estimate`."""
    fit, settings, job = estimate.fit, estimate.settings, estimate.scene.job
    first, reporter = estimate.photos[0], estimate.scene.reporter
    objects = zip(job.objects, estimate.materials, first.pixels, first.residuals, strict=True)
    return {
        "format": "btfsep-result",
        "version": 1,
        "job_digest": job.digest,
        "objects": [{"name": o.name, **m.record, "pixels": n, "residual": left} for o, m, n, left in objects],
        "residual": fit.residual,
        "residual_per_channel": fit.residual_per_channel,
        "order": settings.order,
        "estimator": settings.estimator,
        "fit_order": settings.fit_order,
        "effective_degrees_of_freedom": fit.effective_degrees_of_freedom,
        "noise": fit.noise,
        "lamps": [lamp_record(lamp) for lamp in fit.lamps],
        "object_tint": None if fit.tint is None else fit.tint.object_tint,
        "colour_unknown": None if fit.tint is None else fit.tint.unknown,
        "determined": determined_words(fit.determined, fit.all_determined),
        "expected_error": None if fit.samples is None else expected_error(fit.coefficients, fit.samples),
        "expected_error_shown": shown_error(fit),
        "choice": estimate.choice,
        "photos": [photo_record(p) for p in estimate.photos],
        "condition_number": fit.condition,
        "transport": estimate.model.problems[0].transport,
        "saturated_pixels": job.photo.saturated,
        **run_record(settings, reporter),
    }
