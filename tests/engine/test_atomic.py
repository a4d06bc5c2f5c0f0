# SPDX-License-Identifier: GPL-3.0-or-later
"""Files are there whole or not at all: whoever reads meanwhile, or whatever goes wrong, sees the older one."""

import os

import numpy as np
import pytest

from btfsep_engine.cli.summary import write_summary
from btfsep_engine.commands import report
from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.light.files import exactly, write_lighting, write_lighting_exr
from btfsep_engine.storage import atomic
from btfsep_engine.storage.atomic import write_json

LIGHT = exactly(np.ones((4, 3)))
PICTURE = np.full((4, 4, 3), 0.5, np.float32)
WRITERS = {
    "result.json": lambda path: write_json(path, {"a": 1}),
    "batch.json": lambda path: write_summary(path, []),
    "lighting.json": lambda path: write_lighting(path, LIGHT),
    "lighting.exr": lambda path: write_lighting_exr(path, LIGHT, height=4, width=8),
    "photo.exr": lambda path: images.write_exr(path, PICTURE),
    "photo.png": lambda path: images.write_png(path, PICTURE),
    "report.png": lambda path: report.write_row(path, [("photo", report.display(PICTURE))]),
    "bytes.bin": lambda path: atomic.write_bytes(path, b"new"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_the_older_file_stays_until_the_new_one_is_whole(name, tmp_path, monkeypatch):
    path, seen = tmp_path / name, []
    path.write_bytes(b"older")
    replace = os.replace

    def look(scratch, target):
        seen.append((path.read_bytes(), os.path.getsize(scratch)))
        replace(scratch, target)

    monkeypatch.setattr(os, "replace", look)
    WRITERS[name](path)
    content = path.read_bytes()
    assert seen[0] == (b"older", len(content)) and content != b"older"
    path.write_bytes(b"older")

    def full(scratch, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(InputError, match="No space left"):
        WRITERS[name](path)
    assert path.read_bytes() == b"older"
    assert not list(tmp_path.glob(".writing-*"))


def test_a_folder_that_cannot_be_written_is_found_without_a_trace(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("a")
    atomic.check_folder(tmp_path / "not" / "there" / "yet")
    for place in ("file", "file/below/it"):
        with pytest.raises(InputError, match=rf"{place}; .*file is no folder; choose a folder"):
            atomic.check_folder(tmp_path / place)
    monkeypatch.setattr(os, "access", lambda path, mode: path != tmp_path)
    with pytest.raises(InputError, match="may not be written"):
        atomic.check_folder(tmp_path / "not" / "there")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_an_error_while_writing_leaves_the_older_file(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("older")
    with pytest.raises(ZeroDivisionError), atomic.replacing(path) as scratch:
        scratch.write_text("half")
        1 / 0  # noqa: B018
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"] and path.read_text() == "older"
