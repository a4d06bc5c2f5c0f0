# SPDX-License-Identifier: GPL-3.0-or-later
"""What farms are given: the Open Job Description template runs, and the commands of Flamenco's tasks do."""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from py_mini_racer import MiniRacer

FARM = Path(__file__).resolve().parents[2] / "btfsep_engine" / "data" / "templates"
TEMPLATE = FARM / "btfsep.openjd.yaml"
BIN = Path(sys.executable).parent
ENVIRONMENT = os.environ | {"PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}
# what Flamenco's Manager gives to a job type: https://flamenco.blender.org/usage/job-types
AUTHOR = """
const author = {
    Task: (name, type) => ({
        name, type, commands: [], dependencies: [],
        addCommand(command) { this.commands.push(command); },
        addDependency(task) { this.dependencies.push(task.name); },
    }),
    Command: (name, parameters) => ({ name, parameters }),
};
function compiled(settings) {
    const job = { settings, tasks: [], addTask(task) { this.tasks.push(task); } };
    compileJob(job);
    return JSON.stringify(job.tasks);
}
"""


@pytest.fixture
def shots(sphere_job_folder, tmp_path_factory):
    """Three good jobs in a folder whose name a shell would take apart, and one whose photo is not there."""
    folder, _ = sphere_job_folder
    shots = tmp_path_factory.mktemp("shots") / 'it\'s $HOME "here"'
    for name in "abcd":
        shutil.copytree(folder, shots / name)
    (shots / "c" / "photo.exr").unlink()
    return shots


def openjd(*arguments):
    return subprocess.run(
        [BIN / "openjd", "run", TEMPLATE, *map(str, arguments)],
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=500,
    )


def engines(folder) -> list[str]:
    """Resident engines of sessions that ran in ``folder``."""
    found = subprocess.run(["pgrep", "-f", "btfsep serve"], capture_output=True, text=True).stdout.split()
    return [pid for pid in found if str(folder) in os.readlink(f"/proc/{pid}/cwd")]


@pytest.mark.skipif(sys.platform == "win32", reason="pipes with names")
def test_the_open_job_description_template_runs(shots, tmp_path):
    options = "--material reference/white-diffuse --order 2 --no-report"
    told = {"Jobs": shots, "Results": tmp_path / "light", "Tasks": 2, "Preset": "draft", "Options": options}
    parameters = [word for name, value in told.items() for word in ("-p", f"{name}={value}")]
    run = openjd(*parameters)
    assert run.returncode != 0 and "1 of 4 jobs failed" in run.stdout, run.stdout  # of the last step alone
    assert run.stdout.count("exited with code: 0") == 4  # of the engine's begin and end, and both shares
    assert "openjd_progress: 100.0" in run.stdout
    summary = json.loads((tmp_path / "light" / "batch.json").read_text())["jobs"]
    assert {Path(e["job"]).name: e["status"] for e in summary} == dict.fromkeys("abd", "done") | {"c": "failed"}
    assert all((tmp_path / "light" / name / "lighting.exr").exists() for name in "abd")
    shutil.copy(shots / "a" / "photo.exr", shots / "c")
    again = openjd(*parameters)
    assert again.returncode == 0 and all(f'"kept": {n}' in again.stdout for n in (1, 2)), again.stdout
    end = time.monotonic() + 20
    while engines("OpenJD"):
        assert time.monotonic() < end, "an engine is left"
        time.sleep(0.1)


def test_a_wrong_option_fails_its_task(shots, tmp_path):
    run = openjd("-p", f"Jobs={shots}", "-p", f"Results={tmp_path}", "-p", "Options=--order 12", "--step", "Estimate")
    assert run.returncode != 0 and "--order; '12'" in run.stdout and "exited with code: 2" in run.stdout


def test_the_commands_of_flamencos_tasks_run(shots, tmp_path):
    script = MiniRacer()
    script.eval((FARM / "btfsep.js").read_text(encoding="utf-8") + AUTHOR)
    settings = {s["key"]: s.get("default") for s in json.loads(script.eval("JSON.stringify(JOB_TYPE.settings)"))}
    settings |= {"jobs": str(shots), "results": str(tmp_path / "light"), "tasks": 2, "preset": "draft"}
    settings |= {"material": "reference/white-diffuse"}
    tasks = json.loads(script.eval(f"compiled({json.dumps(settings)})"))
    assert [t["name"] for t in tasks] == ["estimate-1", "estimate-2", "summary"]
    assert tasks[-1]["dependencies"] == ["estimate-1", "estimate-2"]
    codes = []
    for task in tasks:
        (command,) = task["commands"]
        assert command["name"] == "exec" and task["type"] == "misc"
        words = [command["parameters"]["exe"], *command["parameters"]["args"]]
        codes.append(subprocess.run(words, env=ENVIRONMENT, timeout=500).returncode)
    assert codes == [0, 0, 3]
    summary = json.loads((tmp_path / "light" / "batch.json").read_text())["jobs"]
    assert sorted(e["status"] for e in summary) == ["done", "done", "done", "failed"]
