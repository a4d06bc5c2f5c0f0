# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine as a child process, over its command line."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]


class EngineFailed(RuntimeError):
    """The engine's own sentence."""


def run(*arguments, on_progress=None) -> dict:
    """``python -m btfsep_engine ARGUMENTS --json``; gives the result of the last line.

    Parameters
    ----------
    on_progress : called with (stage, fraction, message) as the engine tells of its progress

    Raises
    ------
    EngineFailed
    """
    command = [sys.executable, "-P", "-m", "btfsep_engine", *map(str, arguments), "--json"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        result = failure = None
        for line in child.stdout:
            message = json.loads(line)
            if message["type"] == "progress" and on_progress:
                on_progress(message["stage"], message["fraction"], message.get("message", ""))
            elif message["type"] == "done":
                result = message["result"]
            elif message["type"] == "failed":
                failure = message["message"]
        complaints = child.stderr.read()
    if child.returncode or result is None:
        raise EngineFailed(failure or complaints.strip() or f"the engine ended with {child.returncode}")
    return result


def coefficients(lighting_json) -> np.ndarray:
    """((L + 1)^2, 3) float64 of a ``lighting.json``."""
    return np.array(json.loads(Path(lighting_json).read_text())["coefficients"], np.float64)
