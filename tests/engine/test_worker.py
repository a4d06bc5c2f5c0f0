# SPDX-License-Identifier: GPL-3.0-or-later
"""A worker's process: every task has an answer, whatever becomes of the process, and none outlives its parent."""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path

import pytest

from btfsep_engine.cli.lanes import lanes_for, run_all
from btfsep_engine.cli.worker import DIED, STOPPED, TOO_LONG, Outcome, Worker, _Child
from tests.engine import worker_tasks as tasks

ROOT = Path(__file__).resolve().parents[2]
posix = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="signals, and who is there")


@pytest.fixture(scope="module")
def warm():
    with closing(Worker(grace=0.5)) as worker:
        yield worker


def wait_for(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.005)


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (ProcessLookupError, FileNotFoundError):
        return False


def test_tasks_share_a_process_and_their_messages_come_while_they_run(warm):
    heard = []
    first, second = (warm.run(tasks.count, i, heard.append) for i in (1, 2))
    assert first.exit_code == second.exit_code == 0
    assert second.result["done"] - first.result["done"] == 1 and first.result["pid"] == second.result["pid"] == warm.pid
    assert [m["message"] for m in heard if m["type"] == "warning"] == ["task 1", "task 2"]
    shown = [m for m in heard if m["type"] == "progress"]
    assert [m["fraction"] for m in shown] == [0, 1, 0, 1] and {m["title"] for m in shown} == {"Counting"}


def test_every_end_of_a_task_has_words(capfd):
    own = Worker()
    ends = [own.run(work, 3) for work in (tasks.interrupted, tasks.short_of_memory, tasks.wrong, tasks.not_to_be_sent)]
    assert [e.exit_code for e in ends] == [130, 2, 1, 1] and not any(e.result or e.died for e in ends)
    assert "use --preset draft" in ends[1].message and "ValueError: 3 is odd; please report it" in ends[2].message
    assert own.run(tasks.noisy, 4) == Outcome(result={"said": 4})
    own.close()
    said = capfd.readouterr()
    assert said.out == "" and "Traceback" in said.err
    assert all(words in said.err for words in ("not for the program", "native words", "of a grandchild"))


@posix
@pytest.mark.parametrize(("how", "words"), [("abort", "SIGABRT"), ("kill", "SIGKILL: out of memory"), ("exit", "9")])
def test_a_process_that_dies_costs_its_task_only(warm, how, words):
    died = warm.run(tasks.die, how)
    assert died.exit_code == DIED and died.died and "its process died" in died.message and words in died.message
    assert warm.run(tasks.count, 1).result["done"] == 1
    os.kill(warm.pid, signal.SIGKILL)  # and one that is killed while it has nothing to do costs none
    wait_for(lambda: warm._child.dead)
    assert warm.run(tasks.count, 1).exit_code == 0


@pytest.mark.parametrize("work", [tasks.endless, tasks.busy, tasks.stubborn])
def test_a_cancelled_task_stops_and_its_process_stays(warm, tmp_path, work):
    pid, ends = warm.run(tasks.count, 0).result["pid"], []
    thread = threading.Thread(target=lambda: ends.append(warm.run(work, str(tmp_path / "begun"))))
    thread.start()
    wait_for((tmp_path / "begun").exists)
    warm.cancel()
    thread.join()
    assert ends == [Outcome(STOPPED, "stopped")]
    heard = []
    assert warm.run(tasks.count, 0, heard.append).result["pid"] == pid  # waited for the one before
    assert (tmp_path / "begun").read_text() == "stopped"
    assert {m.get("stage", "counting") for m in heard} == {"counting"}  # none of the task before
    warm.cancel()  # nothing is running: nothing happens
    assert warm.run(tasks.count, 0).exit_code == 0


@posix
def test_a_task_that_does_not_listen_is_killed_after_the_grace(warm, tmp_path):
    ends = []
    thread = threading.Thread(target=lambda: ends.append(warm.run(tasks.deaf, str(tmp_path / "begun"))))
    thread.start()
    wait_for(lambda: (tmp_path / "begun").exists() and (tmp_path / "begun").read_text())
    began = time.monotonic()
    warm.cancel()
    thread.join()
    assert ends[0].exit_code == STOPPED
    deaf = int((tmp_path / "begun").read_text())
    assert alive(deaf) or time.monotonic() - began > 0.5  # the answer did not wait for the process
    assert warm.run(tasks.count, 0).result["pid"] != deaf
    assert not alive(deaf)


@posix
def test_who_waits_for_a_worker_that_is_closed_begins_no_other(tmp_path, monkeypatch):
    worker, ends, begun = Worker(grace=60), [], []
    monkeypatch.setattr("btfsep_engine.cli.worker._Child", lambda threads: begun.append(_Child(threads)) or begun[-1])
    assert worker.run(tasks.deaf, str(tmp_path / "begun"), time_limit=2.0).exit_code == TOO_LONG
    waiting = threading.Thread(target=lambda: ends.append(worker.run(tasks.count, 0)))
    waiting.start()
    wait_for(worker._one_at_a_time.locked)
    worker.close()
    waiting.join()
    assert ends == [Outcome(STOPPED, "stopped")]
    wait_for(lambda: not any(alive(child.process.pid) for child in begun))


def test_a_time_limit_ends_a_task(warm, tmp_path):
    late = warm.run(tasks.endless, str(tmp_path / "begun"), time_limit=0.3)
    assert (late.exit_code, late.message) == (TOO_LONG, "it took more than 0.3 s")
    assert warm.run(tasks.count, 0, time_limit=60).exit_code == 0


def test_who_fails_to_listen_has_the_task_stopped(warm, tmp_path):
    def fail(message):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        warm.run(tasks.endless, str(tmp_path / "begun"), fail)
    assert warm.run(tasks.count, 0).exit_code == 0
    assert (tmp_path / "begun").read_text() == "stopped"


def test_a_process_is_replaced_after_many_tasks_or_much_memory():
    with closing(Worker(most_tasks=2)) as worker:
        assert [worker.run(tasks.count, i).result["done"] for i in range(5)] == [1, 2, 1, 2, 1]
    with closing(Worker(most_mb=600)) as worker:
        pids = [worker.run(tasks.large, mb).result["pid"] for mb in (1, 700, 1, 1)]
        assert pids[0] == pids[1] != pids[2] == pids[3]
    assert worker.run(tasks.count, 0).exit_code == STOPPED  # closed for good


@posix
@pytest.mark.parametrize("work", ["endless", "deaf"])
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT], ids=lambda s: s.name)
def test_no_process_outlives_its_parent(tmp_path, work, how):
    program = f"from tests.engine.worker_tasks import parent; parent({str(tmp_path)!r}, {work!r})"
    run = subprocess.Popen([sys.executable, "-c", program], cwd=ROOT, stderr=subprocess.DEVNULL)
    wait_for((tmp_path / "begun").exists)
    children = Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()
    assert len(children) == 1 and alive(int(children[0]))
    run.send_signal(how)
    run.wait(timeout=20)
    wait_for(lambda: not alive(int(children[0])), seconds=1.0)


def test_lanes_do_every_task_once_and_a_death_is_tried_again(tmp_path):
    jobs = [str(tmp_path / f"{i}") for i in range(3)]
    ends = dict(run_all(tasks.die_once, jobs, 2, retries=1))
    assert sorted(ends) == [0, 1, 2] and all(e.result == {"survived": True} for e in ends.values())
    never = dict(run_all(tasks.die, ["abort"], 1, retries=2))
    assert never[0].died
    many = list(run_all(tasks.count, iter(range(40)), 2))
    assert sorted(i for i, _ in many) == list(range(40))
    with pytest.raises(TypeError, match="pickle"):
        list(run_all(tasks.count, [threading.Lock()], 1))


@posix
def test_lanes_that_nobody_waits_for_end_their_processes(tmp_path):
    ends = run_all(tasks.count, range(1000), 2)
    pids = {next(ends)[1].result["pid"] for _ in range(20)}
    ends.close()
    wait_for(lambda: not any(map(alive, pids)), seconds=2.0)


def test_lanes_are_as_many_as_there_is_room_for(monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 8)
    monkeypatch.setattr("btfsep_engine.cli.lanes.available_mb", lambda: 5000.0)
    assert lanes_for("auto", 100) == 3 and lanes_for("auto", 2) == 2 and lanes_for(16, 100) == 16
    monkeypatch.setattr("btfsep_engine.cli.lanes.available_mb", lambda: 100.0)
    assert lanes_for("auto", 100) == 1
    monkeypatch.setattr("btfsep_engine.cli.lanes.available_mb", lambda: None)
    assert lanes_for("auto", 100) == 1
    monkeypatch.undo()
    assert lanes_for("auto", 100) >= 1
