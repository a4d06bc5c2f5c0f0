# SPDX-License-Identifier: GPL-3.0-or-later
"""What holds for all rings."""

import os
import signal

import pytest

# A shell starts what runs in the background with Ctrl-C ignored, and children inherit that: some are to be stopped.
signal.signal(signal.SIGINT, signal.default_int_handler)

CORES = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()  # that this process was given


def pytest_configure(config):
    """Each of several workers has a core of its own, and so have the processes that its tests start.

    Dr.Jit and the BLAS begin as many threads as a process has cores. Between the many small pieces of work of a test
    those wait busily, on cores that other workers need: half of all processor time of some files. A run without
    workers has all cores.
    """
    if hasattr(config, "workerinput") and CORES:
        number = int(config.workerinput["workerid"].removeprefix("gw"))
        os.sched_setaffinity(0, {sorted(CORES)[number % len(CORES)]})


@pytest.fixture
def all_cores():
    """All cores that there are, for processes that the test starts."""
    if not CORES:
        yield
        return
    own = os.sched_getaffinity(0)
    os.sched_setaffinity(0, CORES)
    yield
    os.sched_setaffinity(0, own)


LONGEST_FIRST = ("blender", "render", "engine")  # rings, by how long a file of theirs takes


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Ends with the ring whose files are short: workers that take one file after the other are done about together."""
    items.sort(key=lambda item: LONGEST_FIRST.index(item.path.parent.name))


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    """The folder of a cache of the test's own, empty at first."""
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"
