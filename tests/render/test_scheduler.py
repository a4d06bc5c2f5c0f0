# SPDX-License-Identifier: GPL-3.0-or-later
"""``btfsep batch --scheduler``: Dask's workers do what lanes would, and one that is lost costs nothing but time."""

import gc
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from distributed import LocalCluster

from btfsep_engine.cli import main
from btfsep_engine.cli.batch import EstimateTask, estimate_job
from btfsep_engine.cli.scheduler import run_scheduled
from btfsep_engine.cli.worker import Worker
from btfsep_engine.errors import InputError
from btfsep_engine.light.files import read_lighting
from btfsep_engine.pipeline.settings import choose
from tests.engine import worker_tasks as tasks

OPTIONS = ["--material", "reference/white-diffuse", "--order", "2", "--preset", "draft", "--no-report"]


@pytest.fixture(scope="module")
def cluster():
    """Two workers of one thread, each a process with a nurse that replaces it."""
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster


@pytest.fixture(autouse=True)
def _collected():
    """Dask's clients that found no scheduler end when they are collected: not while another begins, and waits."""
    gc.collect()
    yield
    gc.collect()


def test_tasks_are_done_by_processes_of_the_workers(cluster, tmp_path):
    ends = dict(run_scheduled(cluster.scheduler_address, tasks.count, range(30)))
    assert sorted(ends) == list(range(30)) and not any(e.exit_code for e in ends.values())
    workers = {w.process.pid for w in cluster.workers.values()}
    assert len({e.result["pid"] for e in ends.values()}) == 2 and not workers & {e.result["pid"] for e in ends.values()}
    for work, task, says in ((tasks.die, "abort", "process died"), (tasks.wrong, 3, "3 is odd")):
        (_, end), *_ = run_scheduled(cluster.scheduler_address, work, [task])
        assert end.exit_code == 1 and says in end.message
    late = dict(run_scheduled(cluster.scheduler_address, tasks.endless, [str(tmp_path / "a")], time_limit=0.2))
    assert "more than 0.2 s" in late[0].message
    jobs = [str(tmp_path / f"{i}") for i in range(3)]
    again = dict(run_scheduled(cluster.scheduler_address, tasks.die_once, jobs, retries=1))
    assert all(e.result == {"survived": True} for e in again.values())


def test_a_batch_of_workers_is_one_of_lanes_and_a_lost_worker_loses_no_job(
    cluster, sphere_job_folder, tmp_path_factory, monkeypatch, capsys
):
    folder, _ = sphere_job_folder
    shots = tmp_path_factory.mktemp("shots")
    for i in range(8):
        shutil.copytree(folder, shots / f"{i:02}")
    (shots / "03" / "photo.exr").unlink()
    monkeypatch.chdir(shots)
    first = Path("00/result/result.json").absolute()
    victim = next(iter(cluster.workers.values())).process.pid

    def kill():
        while not first.exists():
            time.sleep(0.01)
        os.kill(victim, signal.SIGKILL)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    code = main(["batch", ".", "--scheduler", cluster.scheduler_address, "--json", *OPTIONS])
    killer.join()
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert code == 3, lines[-1]
    counts = lines[-1]["result"]
    assert counts.pop("kept") <= 2  # what the lost worker had done, and not said, is not done twice
    assert counts == {"done": 7, "failed": 1, "crashed": 0, "summary": "batch.json"}
    entries = json.loads(Path("batch.json").read_text())["jobs"]
    assert [e["job"] for e in entries] == [f"{i:02}" for i in range(8)] and entries[3]["status"] == "failed"
    # with one core, as a worker's thread has: sums are rounded otherwise by several
    told = {"material": OPTIONS[1], "with_report": False}
    task = EstimateTask(Path("07").absolute(), Path("alone").absolute(), choose("draft", order=2), **told)
    with closing(Worker(threads=1)) as worker:
        assert worker.run(estimate_job, task).exit_code == 0
    alone = read_lighting("alone/lighting.json").coefficients
    for i in set(range(8)) - {3}:
        together = read_lighting(f"{i:02}/result/lighting.json").coefficients
        assert np.allclose(alone, together, rtol=2e-3, atol=5e-4)
    assert main(["batch", ".", "--summary", "lanes.json", *OPTIONS]) == 3
    again = json.loads(Path("lanes.json").read_text())["jobs"]
    assert [e.get("kept") for e in again] == [None if i == 3 else True for i in range(8)]


def test_a_scheduler_that_is_not_there_is_said(monkeypatch):
    monkeypatch.setattr("btfsep_engine.cli.scheduler.PATIENCE", 0.2)
    for address in ("tcp://127.0.0.1:1", "nonsense://", "tcp://127.0.0.1:none"):
        with pytest.raises(InputError, match="--scheduler"):
            next(run_scheduled(address, tasks.count, [1]))


def test_a_scheduler_that_is_lost_is_said_and_what_is_done_stays(tmp_path, monkeypatch):
    """Without workers, so that its tasks are with it when it ends."""
    said = tmp_path / "scheduler.json"
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard"]
    scheduler = subprocess.Popen([*command, "--scheduler-file", said], stderr=subprocess.DEVNULL)
    try:
        while not said.exists() or not said.read_text():
            time.sleep(0.05)
        address = json.loads(said.read_text())["address"]
        asked = threading.Timer(2.0, scheduler.kill)
        asked.start()
        with pytest.raises(InputError, match=r"lost.*what is done stays"):
            next(run_scheduled(address, tasks.count, range(3)))
    finally:
        scheduler.kill()
        scheduler.wait()
