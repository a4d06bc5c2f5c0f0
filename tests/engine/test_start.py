# SPDX-License-Identifier: GPL-3.0-or-later
"""What is loaded before a command says its first line, and before an estimate begins."""

import subprocess
import sys

LATER = {"importlib.metadata", "scipy.optimize", "scipy.ndimage", "scipy.stats", "sklearn", "matplotlib", "PIL"}
LATER |= {f"btfsep_engine.{name}" for name in ("render.patch", "render.reference", "btf.procedural", "btf.factorise")}


def loaded(statement: str) -> set:
    """The modules that a new process has after a statement."""
    program = f"import sys\n{statement}\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-P", "-c", program], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_the_first_line_waits_for_no_library():
    assert not {"numpy", "pydantic", "cv2", "mitsuba"} & loaded("import btfsep_engine.cli")


def test_an_estimate_begins_without_what_most_need_not():
    modules = loaded("import btfsep_engine.cli, btfsep_engine.pipeline.estimation")
    assert "scipy.linalg" in modules and not LATER & modules
    assert "mitsuba" not in modules  # where no renderer works, that is said, and the process lives
