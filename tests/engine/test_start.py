# SPDX-License-Identifier: GPL-3.0-or-later
"""What is loaded before a command says its first line, and before an estimate begins."""

import subprocess
import sys

LATER = {"importlib.metadata", "scipy.optimize", "scipy.ndimage", "scipy.stats", "sklearn", "matplotlib", "PIL"}
LATER |= {f"btfsep_engine.{name}" for name in ("render.patch", "render.reference", "btf.procedural", "btf.factorise")}


def said(program: str) -> list:
    """The words that a new process prints."""
    done = subprocess.run([sys.executable, "-P", "-c", program], capture_output=True, text=True, check=True)
    return done.stdout.split()


def loaded(statement: str) -> set:
    """The modules that a new process has after a statement."""
    return set(said(f"import sys\n{statement}\nprint(*sys.modules)"))


def test_the_first_line_waits_for_no_library():
    assert not {"numpy", "pydantic", "cv2", "mitsuba"} & loaded("import btfsep_engine.cli")


def test_an_estimate_begins_without_what_most_need_not():
    modules = loaded("import btfsep_engine.cli, btfsep_engine.pipeline.estimation")
    of_scipy = loaded("import scipy.linalg")  # beside NumPy 2, all of numpy.testing, too
    assert "scipy.linalg" in modules and not LATER & (modules - of_scipy)
    assert "mitsuba" not in modules  # where no renderer works, that is said, and the process lives


def test_libraries_are_never_looked_through_for_garbage_but_what_comes_later_is():
    program = """
import gc, weakref
from btfsep_engine.loading import loading

class Round:
    def __init__(self):
        self.me = self

with loading():
    import numpy
    assert not gc.isenabled()
kept = gc.get_freeze_count()
garbage = weakref.ref(Round())
with loading():
    import numpy  # is there
print(gc.isenabled(), kept > 10_000, gc.get_freeze_count() - kept, gc.collect() > 0, garbage())
"""
    assert said(program) == ["True", "True", "0", "True", "None"]
