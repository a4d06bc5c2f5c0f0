# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine that stays while Blender does, as the add-on talks to it: the real one, and one that cannot stay."""

import json
import os
import signal
import sys
import time
from pathlib import Path

import pytest

from blender_btfsep.engine import engine_process, resident
from blender_btfsep.engine.engine_process import (
    Cancelled,
    Done,
    Engine,
    EngineProcess,
    Failed,
    Light,
    Notice,
    Progress,
    parse,
)
from tests.blender.test_engine_process import FAKE, alive, wait_until


@pytest.fixture
def engine():
    yield engine_process.find_engine()
    resident.stop()


def run(engine, *arguments):
    return resident.start(engine, [*arguments])


def test_runs_share_one_engine_which_ends_when_told(engine):
    first = run(engine, "library", "list")
    pid = first.pid
    assert "reference/white-diffuse" in [m["name"] for m in first.wait().result["materials"]]
    assert first.over and first.poll() == []
    absent = run(engine, "compare", "absent.json", "b.json")
    last = absent.wait()
    assert isinstance(last, Failed) and last.exit_code == 2 and "absent.json" in last.message and not last.details
    wrong = run(engine, "library", "list", "--frob").wait()
    assert wrong.exit_code == 2 and wrong.message.startswith("No such option")
    assert absent.pid == pid and alive(pid)
    resident.stop()
    assert not alive(pid)


def test_a_cancelled_run_is_over_at_once_and_the_engine_stays(engine, tmp_path):
    (tmp_path / "job.json").write_text("{}")
    warm = run(engine, "doctor")
    assert isinstance(warm.wait(), Done)
    long = run(engine, "library", "build", str(tmp_path / "library"), "--only", "wood/oak-boards")
    heard = []
    assert wait_until(lambda: heard.extend(long.poll()) or heard)
    assert isinstance(heard[0], Progress)
    long.cancel()
    long.cancel()  # impatience does no harm
    assert long.wait() == Cancelled() and alive(long.pid)
    again = run(engine, "library", "list")
    assert isinstance(again.wait(), Done) and again.pid == long.pid == warm.pid


def test_an_engine_that_hangs_or_dies_has_a_successor(engine):
    assert isinstance(run(engine, "library", "list").wait(), Done)
    hangs = run(engine, "doctor")
    os.kill(hangs.pid, signal.SIGSTOP)
    hangs.cancel()
    assert hangs.wait() == Cancelled() and not alive(hangs.pid)
    dies = run(engine, "doctor")
    assert dies.pid != hangs.pid
    assert wait_until(lambda: dies._resident.ready)
    os.kill(dies.pid, signal.SIGKILL)
    last = dies.wait()
    assert isinstance(last, Failed) and "SIGKILL" in last.message
    after = run(engine, "library", "list")
    assert isinstance(after.wait(), Done) and after.pid not in (dies.pid, hangs.pid)


def test_a_run_beside_another_has_a_process_of_its_own(engine):
    first = run(engine, "doctor")
    beside = run(engine, "library", "list")
    assert type(beside) is EngineProcess and isinstance(beside.wait(), Done)
    assert isinstance(first.wait(), Done)
    assert run(engine, "library", "list").pid == first.pid


def test_an_engine_that_cannot_stay_runs_once_for_each(tmp_path):
    path = tmp_path / "behaviour.json"
    light = {"type": "light", "lighting": "a/lighting.json"}
    lines = [light, {"type": "warning", "message": "w"}, {"type": "done", "result": {"order": 4}}]
    path.write_text(json.dumps({"lines": lines, "log": str(tmp_path / "arguments")}))
    old = Engine((sys.executable, str(FAKE), str(path)))
    heard = []
    assert run(old, "estimate", "job").wait(heard.append) == Done({"order": 4})
    assert heard == [Light("a/lighting.json"), Notice("w")]
    assert json.loads((tmp_path / "arguments").read_text()) == ["estimate", "job", "--json"]
    again = run(old, "estimate", "job")
    assert type(again) is EngineProcess and again.wait() == Done({"order": 4})  # it is not asked to stay again
    path.write_text(json.dumps({"sleep": 600}))
    slow = run(old, "estimate", "job")
    time.sleep(0.1)
    slow.kill()
    assert slow.over and not alive(slow.pid)
    resident.stop()


def test_it_ends_with_the_process_that_started_it(engine, tmp_path):
    root = Path(__file__).resolve().parents[2]
    program = (
        "import os, sys; from blender_btfsep.engine import engine_process, resident\n"
        "run = resident.start(engine_process.find_engine(), ['library', 'list']); run.wait()\n"
        f"open({str(tmp_path / 'pid')!r}, 'w').write(str(run.pid)); os.kill(os.getpid(), 9)"
    )
    os.system(f'cd {root} && {sys.executable} -c "{program}"')
    assert wait_until(lambda: not alive(int((tmp_path / "pid").read_text())))


def test_lines_that_are_new():
    assert parse('{"type": "cancelled", "id": 1}') == Cancelled()
    assert parse('{"type": "light", "id": 1}') is None
