# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine as a child process, over its command line."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]


class EngineFailed(RuntimeError):
    """The engine's own sentence."""


def measured(*arguments, **environment):
    """``python -m btfsep_engine ARGUMENTS --json``, with variables added to its environment.

    Gives the result of the last line, and (seconds by the clock, seconds of processor, gigabytes resident at most).

    Raises EngineFailed.
    """
    command = [sys.executable, "-P", "-m", "btfsep_engine", *map(str, arguments), "--json"]
    with tempfile.TemporaryFile("w+") as complaints:
        where = {"cwd": ROOT, "env": os.environ | environment, "stdout": subprocess.PIPE, "stderr": complaints}
        started = time.perf_counter()
        child = subprocess.Popen(command, text=True, **where)
        with child.stdout:
            lines = [json.loads(line) for line in child.stdout]
        _, status, used = os.wait4(child.pid, 0)
        elapsed = time.perf_counter() - started
        child.returncode = os.waitstatus_to_exitcode(status)
        last = lines[-1] if lines else {}
        if child.returncode or last.get("type") != "done":
            complaints.seek(0)
            words = last.get("message") or complaints.read().strip()
            raise EngineFailed(words or f"the engine ended with {child.returncode}")
    peak = used.ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e9
    return last["result"], (elapsed, used.ru_utime + used.ru_stime, peak)


def run(*arguments) -> dict:
    """The result alone."""
    return measured(*arguments)[0]


def coefficients(lighting_json) -> np.ndarray:
    """((L + 1)^2, 3) float64 of a ``lighting.json``."""
    return np.array(json.loads(Path(lighting_json).read_text())["coefficients"], np.float64)
