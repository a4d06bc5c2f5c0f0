# SPDX-License-Identifier: GPL-3.0-or-later
"""Python files that lie in the folder where a command is run are never executed, by it or by its children."""

import os
import subprocess
import sys

import pytest

from btfsep_engine.render import backend

PLANTED = "import pathlib, os; open(os.environ['MARKER'], 'a').write(__name__ + '\\n')\n"
MODULES = "click cv2 drjit json logging mitsuba multiprocessing numpy pickle platformdirs scipy secrets signal socket"
CONSOLE = "import sys\nfrom btfsep_engine.cli import main\nif __name__ == '__main__':\n    sys.exit(main())\n"
OPTIONS = ["--material", "reference/white-diffuse", "--preset", "draft", "--no-report"]


@pytest.mark.parametrize("started", ["module", "module, with -P", "console script"])
@pytest.mark.parametrize("command", [["doctor"], ["batch", ".", *OPTIONS], ["estimate", "shot", *OPTIONS]], ids=str)
def test_modules_in_the_current_folder_do_not_run(sphere_job_folder, tmp_path_factory, started, command):
    job, _ = sphere_job_folder
    shots, elsewhere = tmp_path_factory.mktemp("shots"), tmp_path_factory.mktemp("elsewhere")
    job.rename(shots / "shot")
    safe = [*sys.stdlib_module_names, "btfsep_engine"]  # without -P Python looks for these before it starts a module
    for name in [*MODULES.split(), *(safe if started != "module" else ())]:
        (shots / f"{name}.py").write_text(PLANTED)
    (elsewhere / "btfsep").write_text(CONSOLE)
    marker = elsewhere / "executed"
    module = ["-m", "btfsep_engine"]
    program = {"module": module, "module, with -P": ["-P", *module]}.get(started, [str(elsewhere / "btfsep")])
    # a cache of its own: the renderer is tried in a child
    environment = os.environ | {"MARKER": str(marker), "BTFSEP_CACHE": str(elsewhere / "cache")}
    environment.pop("PYTHONSAFEPATH", None)
    run = subprocess.run(
        [sys.executable, *program, *command], cwd=shots, env=environment, capture_output=True, text=True, timeout=300
    )
    assert not marker.exists(), marker.read_text()
    assert run.returncode == 0, run.stderr


def test_the_renderers_trial_is_safe_for_any_caller(tmp_path, monkeypatch):
    (tmp_path / "json.py").write_text(PLANTED)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MARKER", str(tmp_path / "executed"))
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    chosen = backend.choose_backend()
    assert backend.try_backend(chosen.variant, chosen.library) == ""
    assert not (tmp_path / "executed").exists()
