# SPDX-License-Identifier: GPL-3.0-or-later
"""What holds for all rings."""

import signal

import pytest

# A shell starts what runs in the background with Ctrl-C ignored, and children inherit that: some are to be stopped.
signal.signal(signal.SIGINT, signal.default_int_handler)


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
