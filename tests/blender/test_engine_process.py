# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine as a child process, with a real child that speaks the protocol."""

import json
import os
import signal
import sys
import time
from pathlib import Path

import pytest

from blender_btfsep.basics.errors import InputError
from blender_btfsep.engine import engine_process
from blender_btfsep.engine.engine_process import Cancelled, Done, Engine, EngineProcess, Failed, Notice, Progress

FAKE = Path(__file__).with_name("fake_engine.py")


def start(tmp_path, *arguments, **behaviour):
    path = tmp_path / "behaviour.json"
    path.write_text(json.dumps(behaviour))
    return EngineProcess(Engine((sys.executable, str(FAKE), str(path))), arguments)


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat")
    return not (state.exists() and state.read_text().rsplit(")", 1)[1].split()[0] == "Z")


def wait_until(condition, seconds=20):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    return condition()


def test_messages_come_in_order_and_noise_is_skipped(tmp_path):
    process = start(
        tmp_path,
        "estimate",
        "job folder",
        log=str(tmp_path / "arguments"),
        lines=[
            {
                "type": "progress",
                "stage": "transport",
                "title": "Rays",
                "fraction": 0.25,
                "whole": 0.7,
                "message": "wood",
            },
            "a library that prints",
            "[1, 2]",
            {"type": "news", "message": "from a newer engine"},
            {"type": "progress", "stage": "fit", "fraction": "x"},
            {"type": "warning", "message": "half of it is saturated"},
            {"type": "progress", "stage": "fit", "fraction": 7},
            {"type": "done", "result": {"order": 4}},
        ],
    )
    heard = []
    assert process.wait(heard.append) == Done({"order": 4})
    assert heard == [
        Progress("transport", 0.25, "wood", 0.7, "Rays"),
        Notice("half of it is saturated"),
        Progress("fit", 1.0, title="fit"),
    ]
    assert json.loads((tmp_path / "arguments").read_text()) == ["estimate", "job folder", "--json"]
    assert process.poll() == []


def test_the_engines_sentence_is_passed_on_without_a_traceback(tmp_path):
    line = {"type": "failed", "message": "photo.exr; 3 NaN pixels; export it again", "exit_code": 2}
    process = start(tmp_path, lines=[line], stderr="noise", exit=2)
    assert process.wait() == Failed("photo.exr; 3 NaN pixels; export it again", 2, "")


def test_a_bug_keeps_what_the_engine_said_last(tmp_path):
    line = {"type": "failed", "message": "a bug in BTFsep: ZeroDivisionError", "exit_code": 1}
    process = start(tmp_path, lines=[line], stderr="Traceback …\nZeroDivisionError", exit=1)
    last = process.wait()
    assert (last.message, last.exit_code) == ("a bug in BTFsep: ZeroDivisionError", 1)
    assert "Traceback" in last.details


def test_wrong_options_are_reported_though_they_come_as_text(tmp_path):
    last = start(tmp_path, stderr="error: No such option: --oder\n", exit=2).wait()
    assert last == Failed("No such option: --oder", 2)


def test_a_death_without_words_is_a_failure(tmp_path):
    last = start(tmp_path, signal=int(signal.SIGABRT), stderr="LLVM ERROR: Cannot select").wait()
    assert last.exit_code == 1 and "SIGABRT" in last.message and "Cannot select" in last.details
    assert start(tmp_path, exit=0).wait().message.startswith("the engine ended without a result")
    # "done" does not count if the engine then fails
    late = start(tmp_path, lines=[{"type": "done", "result": {}}], exit=3).wait()
    assert isinstance(late, Failed) and "exit status 3" in late.message


def test_cancel_ends_the_engine_and_its_children(tmp_path):
    process = start(tmp_path, child=str(tmp_path / "pids"), sleep=600)
    assert wait_until(lambda: (tmp_path / "pids").exists() and " " in (tmp_path / "pids").read_text())
    pids = [int(pid) for pid in (tmp_path / "pids").read_text().split()]
    assert all(alive(pid) for pid in pids)
    process.cancel()
    process.cancel()  # impatience does no harm
    assert process.wait() == Cancelled()
    assert wait_until(lambda: not any(alive(pid) for pid in pids))


def test_cancel_works_where_blender_was_started_in_the_background(tmp_path):
    """A shell has its background jobs ignore SIGINT, and what they start inherits that."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        process = start(tmp_path, child=str(tmp_path / "pids"), sleep=600)
    finally:
        signal.signal(signal.SIGINT, before)
    assert wait_until(lambda: (tmp_path / "pids").exists() and " " in (tmp_path / "pids").read_text())
    process.cancel()
    assert process.wait() == Cancelled()
    assert process._process.returncode == -signal.SIGTERM  # it was asked, not killed


def test_an_engine_that_does_not_listen_is_killed(tmp_path):
    process = start(tmp_path, deaf=True, child=str(tmp_path / "pids"), sleep=600)
    assert wait_until(lambda: (tmp_path / "pids").exists() and " " in (tmp_path / "pids").read_text())
    process.cancel()
    assert process.wait() == Cancelled()
    assert not alive(process.pid)


def test_kill_waits_until_it_is_gone(tmp_path):
    process = start(tmp_path, sleep=600)
    process.kill()
    assert process.over and not alive(process.pid)


def test_much_output_does_not_block(tmp_path):
    lines = [{"type": "progress", "stage": "s", "fraction": i / 5000, "message": "x" * 200} for i in range(5000)]
    process = start(tmp_path, lines=[*lines, {"type": "done", "result": {}}], stderr="e" * 300_000)
    heard = []
    assert process.wait(heard.append) == Done({})
    assert len(heard) == 5000


def test_an_engine_that_cannot_be_started_is_refused_in_words(tmp_path):
    with pytest.raises(InputError, match="there is no such file"):
        engine_process.find_engine(str(tmp_path / "absent"))
    (tmp_path / "text").write_text("no program")
    with pytest.raises(InputError, match="it is not a program"):
        engine_process.find_engine(str(tmp_path / "text"))
    with pytest.raises(InputError, match="it holds no Python"):
        engine_process.find_engine(str(tmp_path))
    with pytest.raises(InputError, match="correct it in the preferences"):
        EngineProcess(Engine((str(tmp_path / "absent"),)), [])


def test_the_engine_is_found_where_the_preferences_say(tmp_path):
    python = tmp_path / "env" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text("#!/bin/sh\n")
    python.chmod(0o755)
    program = tmp_path / "btfsep"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    assert engine_process.find_engine(str(tmp_path / "env")).command == (str(python), "-m", "btfsep_engine")
    assert engine_process.find_engine(str(python)).command == (str(python), "-m", "btfsep_engine")
    assert engine_process.find_engine(str(program)).command == (str(program),)


def test_a_python_without_the_engine_is_named():
    bare = Engine((sys.executable, "-I", "-S", "-m", "btfsep_engine"))  # sees the standard library only
    last = EngineProcess(bare, ["doctor"]).wait()
    assert last.exit_code == 2 and "not installed there" in last.message


def test_the_real_engine_lists_its_library():
    process = EngineProcess(engine_process.find_engine(), ["library", "list"])
    last = process.wait()
    assert isinstance(last, Done), last
    assert "reference/white-diffuse" in [m["name"] for m in last.result["materials"]]


def test_the_real_engines_own_words_on_a_file_that_is_not_there(tmp_path):
    last = EngineProcess(
        engine_process.find_engine(), ["compare", tmp_path / "absent.json", tmp_path / "b.json"]
    ).wait()
    assert isinstance(last, Failed) and last.exit_code == 2
    assert "absent.json" in last.message and not last.details


def test_modules_in_the_current_folder_do_not_run(tmp_path, monkeypatch):
    """Not even those that `python -m` itself imports, before the engine has a say."""
    (tmp_path / "planted.py").write_text("import os; open(os.environ['MARKER'], 'w')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MARKER", str(tmp_path / "executed"))
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    last = EngineProcess(Engine((sys.executable, "-c", "import planted")), []).wait()
    assert isinstance(last, Failed) and "No module named 'planted'" in last.details
    assert not (tmp_path / "executed").exists()
