# SPDX-License-Identifier: GPL-3.0-or-later
"""The resident engine as a program talks to it: every request has one last line, whatever becomes of it."""

import json
import os
import queue
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits

from btfsep_engine.cli import main
from btfsep_engine.storage import kept

ROOT = Path(__file__).resolve().parents[2]
LAST = {"done", "failed", "cancelled"}
WHITE = ("--material", "reference/white-diffuse", "--preset", "draft", "--no-report")


# Where the command has several threads for its matrices: their number changes no digit.
ALONE = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


class Resident:
    """A process of ``btfsep serve`` and the lines that it said."""

    def __init__(self, *options, **environment):
        command = [sys.executable, "-P", "-m", "btfsep_engine", "serve", *options]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(
            command, cwd=ROOT, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True, env=ALONE | environment
        )
        self.lines, self.number = queue.SimpleQueue(), 0
        threading.Thread(target=self._read, daemon=True).start()
        assert self.line() == {"type": "ready", "version": self.version()}

    def _read(self):
        for line in self.process.stdout:
            self.lines.put(json.loads(line))

    @staticmethod
    def version():
        from btfsep_engine import __version__

        return __version__

    def line(self):
        return self.lines.get(timeout=120)

    def send(self, text=None, **request):
        self.process.stdin.write((text or json.dumps(request)) + "\n")
        self.process.stdin.flush()

    def ask(self, command, *arguments) -> int:
        self.number += 1
        self.send(id=self.number, command=command, arguments=[str(a) for a in arguments])
        return self.number

    def answer(self, number) -> list:
        """The lines of a request up to its last."""
        lines = []
        while not lines or lines[-1]["type"] not in LAST:
            lines.append(self.line())
            assert lines[-1]["id"] == number, lines
        return lines

    def until(self, kind, **fields):
        while (line := self.line())["type"] != kind or any(line.get(k) != v for k, v in fields.items()):
            assert line["type"] not in LAST, line
        return line

    def children(self) -> list:
        """The process that works, where there is one."""
        found = [each.read_text().split() for each in Path(f"/proc/{self.process.pid}/task").glob("*/children")]
        return [int(pid) for pids in found for pid in pids]


@pytest.fixture(scope="module")
def resident(tmp_path_factory):
    one = Resident(BTFSEP_CACHE=str(tmp_path_factory.mktemp("cache")))  # in which no training lies ready
    yield one
    one.process.stdin.close()
    assert one.process.wait(30) == 0


def lines_of(capsys, *command) -> list:
    main([str(c) for c in command] + ["--json"])
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_its_answers_are_those_of_the_command(resident, sphere_job_folder, tmp_path, capsys):
    folder, _ = sphere_job_folder
    kept.STORE.forget()
    with threadpool_limits(2, user_api="blas"):
        alone = lines_of(capsys, "estimate", folder, *WHITE, "--out", tmp_path / "alone")
    for _ in range(2):  # the second stands on what the first has left
        here = resident.answer(resident.ask("estimate", folder, *WHITE, "--out", tmp_path / "here"))
        kinds = [(line["type"], line.get("stage"), line.get("fraction"), line.get("whole")) for line in alone]
        assert [(x["type"], x.get("stage"), x.get("fraction"), x.get("whole")) for x in here] == kinds
        assert (tmp_path / "alone" / "lighting.json").read_bytes() == (tmp_path / "here" / "lighting.json").read_bytes()
    assert here[-1]["result"]["out"] == str(tmp_path / "here")
    assert here[-1]["result"]["choice"] == alone[-1]["result"]["choice"]


def test_a_sequence_goes_through_it_and_stands_on_what_is_kept(resident, sphere_job_folder, tmp_path, capsys):
    folder, _ = sphere_job_folder
    kept.STORE.forget()
    asked = ("sequence", folder, "--images", folder / "*.exr", *WHITE[:4])
    with threadpool_limits(2, user_api="blas"):
        alone = lines_of(capsys, *asked, "--out", tmp_path / "alone")[-1]["result"]
    for _ in range(2):
        here = resident.answer(resident.ask(*asked, "--out", tmp_path / "here"))[-1]["result"]
        assert (tmp_path / "alone" / "photo.json").read_bytes() == (tmp_path / "here" / "photo.json").read_bytes()
        assert here["frames"][0]["choice"] == alone["frames"][0]["choice"]


def test_what_is_wrong_is_said_as_by_the_command(resident, tmp_path, capsys):
    for command in (["estimate", tmp_path / "none"], ["library", "show", "wood/none"]):
        alone = lines_of(capsys, *command)
        here = resident.answer(resident.ask(*command))
        assert here == [{**line, "id": resident.number} for line in alone] and here[-1]["exit_code"] == 2
    main(["estimate", "JOB", "--frob"])
    said = capsys.readouterr().err.strip()
    (here,) = resident.answer(resident.ask("estimate", "JOB", "--frob"))
    assert here["exit_code"] == 2 and said == f"error: {here['message']}"
    assert resident.answer(resident.ask("library", "list"))[-1]["type"] == "done"


def test_a_request_that_is_none_is_refused(resident):
    for text in ("nonsense", "[1]", "[" * 100_000, '{"command": "doctor"}', '{"id": [1], "command": "doctor"}'):
        resident.send(text)
        line = resident.line()
        assert (line["type"], line["id"], line["exit_code"]) == ("failed", None, 2), line
    for request in (
        {},
        {"command": 3},
        {"command": "doctor", "arguments": "a"},
        {"command": "serve"},
        {"command": "batch"},
    ):
        resident.send(id="w", **request)
        line = resident.line()
        assert (line["type"], line["id"], line["exit_code"]) == ("failed", "w", 2), line


def test_a_cancelled_command_stops_and_what_is_kept_stays(resident, sphere_job_folder, tmp_path):
    folder, _ = sphere_job_folder
    resident.answer(resident.ask("library", "list"))
    working = resident.children()
    first = resident.ask("estimate", folder, "--preset", "draft")  # trains a recogniser: that takes long
    waiting = resident.ask("estimate", folder, *WHITE, "--out", tmp_path / "out")
    resident.until("progress", id=first, stage="training images")
    resident.send(cancel=waiting)
    resident.send(cancel=first)
    resident.send(cancel="never asked for")
    ends = [resident.line() for _ in range(2)]
    while ends[-1]["type"] != "cancelled" or ends[-2]["type"] != "cancelled":
        ends.append(resident.line())
    assert {line["id"] for line in ends[-2:]} == {first, waiting}
    assert not (tmp_path / "out").exists() and not (folder / "result").exists()
    assert resident.answer(resident.ask("library", "list"))[-1]["type"] == "done"
    assert resident.children() == working and len(working) == 1


def test_a_cancel_is_heard_whenever_it_comes(resident):
    """Before its request has begun, just after, and when it is over, which frees its id."""
    resident.answer(resident.ask("library", "list"))
    for number in range(40):
        text = json.dumps({"id": "same", "command": "doctor"}) + "\n" + json.dumps({"cancel": "same"})
        resident.send(text)
        assert resident.answer("same")[-1]["type"] in {"cancelled", "done"}, number
    for _ in range(40):
        resident.send(id="same", command="library", arguments=["show", "wood/none"])
        assert resident.answer("same")[-1]["type"] == "failed"
    resident.send(cancel="same")
    assert resident.answer(resident.ask("library", "list"))[-1]["type"] == "done"


def test_it_outlives_the_process_that_works(resident, sphere_job_folder):
    folder, _ = sphere_job_folder
    resident.answer(resident.ask("library", "list"))
    first = resident.ask("estimate", folder, "--preset", "draft")
    resident.until("progress", id=first, stage="training images")
    os.kill(resident.children()[0], signal.SIGABRT)  # as a native library that gives up
    line = resident.line()
    while line["type"] not in LAST:
        line = resident.line()
    assert (line["id"], line["type"], line["exit_code"]) == (first, "failed", 1) and "SIGABRT" in line["message"]
    assert resident.answer(resident.ask("estimate", folder, *WHITE))[-1]["type"] == "done"


def test_it_lets_go_of_all_when_it_has_long_been_idle(sphere_job_folder):
    resident = Resident("--idle", "0.01", "--memory", "256")
    assert resident.answer(resident.ask("library", "list"))[-1]["type"] == "done"
    for _ in range(600):
        if not resident.children():
            break
        threading.Event().wait(0.05)
    assert not resident.children()
    assert resident.answer(resident.ask("library", "list"))[-1]["type"] == "done"
    resident.ask("estimate", sphere_job_folder[0], *WHITE)
    resident.send(quit=True)
    assert resident.process.wait(30) == 0 and not (sphere_job_folder[0] / "result" / "result.json").exists()
