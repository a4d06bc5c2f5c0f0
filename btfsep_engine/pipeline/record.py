# SPDX-License-Identifier: GPL-3.0-or-later
"""What is kept of a run: settings, versions, time, memory."""

import importlib.metadata
import json
import math
import platform
import sys
from dataclasses import asdict

import numpy as np

from btfsep_engine import __version__
from btfsep_engine.atomic import write_text
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.render.backend import choose_backend

PACKAGES = ("mitsuba", "drjit", "numpy", "scipy", "opencv-contrib-python-headless", "scikit-learn")


def versions() -> dict:
    """Versions of everything that can change a result."""
    backend = choose_backend()
    return {
        "btfsep": __version__,
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in PACKAGES},
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


def plain(value):
    """NumPy values as JSON's own; numbers that JSON cannot hold become null."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_json(path, value) -> None:
    """Writes ``value`` as indented JSON, whole or not at all."""
    write_text(path, json.dumps(plain(value), indent=1, allow_nan=False) + "\n")
