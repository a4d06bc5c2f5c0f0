# SPDX-License-Identifier: GPL-3.0-or-later
"""``btfsep batch``: every job estimated as alone, one that fails costs itself only, what is done stays."""

import csv
import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from btfsep_engine.cli import main
from btfsep_engine.cli.batch import find_jobs, job_key, shard_of
from btfsep_engine.errors import InputError
from btfsep_engine.light.files import read_lighting

OPTIONS = ["--material", "reference/white-diffuse", "--order", "2", "--preset", "draft", "--no-report"]


@pytest.fixture
def shots(sphere_job_folder, tmp_path_factory):
    """A folder with two good jobs and between them one whose photo is not there."""
    folder, _ = sphere_job_folder
    shots = tmp_path_factory.mktemp("shots")
    for name in ("a", "b", "c"):
        shutil.copytree(folder, shots / name)
    (shots / "b" / "photo.exr").unlink()
    return shots


def run(arguments, capsys) -> tuple[int, list]:
    code = main(["batch", *map(str, arguments), "--json"])
    return code, [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_a_failing_job_does_not_stop_the_others_and_a_second_run_does_only_that_one(shots, capsys):
    code, lines = run([shots, "--summary", shots / "batch.json", *OPTIONS], capsys)
    assert code == 2 and lines[-1]["type"] == "failed" and "1 of 3 jobs failed" in lines[-1]["message"]
    assert any("photo.exr" in line["message"] for line in lines if line["type"] == "warning")
    summary = json.loads((shots / "batch.json").read_text())["jobs"]
    assert [e["status"] for e in summary] == ["done", "failed", "done"]
    with open(shots / "batch.csv", newline="") as table:
        assert [row["status"] for row in csv.DictReader(table)] == ["done", "failed", "done"]
    # alone, the same job gives the same light
    assert main(["estimate", str(shots / "a"), *OPTIONS, "--out", str(shots / "alone")]) == 0
    alone, together = (read_lighting(shots / p / "lighting.json") for p in ("alone", "a/result"))
    assert np.allclose(alone.coefficients, together.coefficients, rtol=2e-3, atol=5e-4)

    made = (shots / "a" / "result" / "lighting.json").stat().st_mtime_ns
    shutil.copy(shots / "a" / "photo.exr", shots / "b")
    capsys.readouterr()
    code, lines = run([shots, "--summary", shots / "batch.json", *OPTIONS], capsys)
    assert code == 0 and lines[-1]["result"]["kept"] == 2 and lines[-1]["result"]["done"] == 3
    assert (shots / "a" / "result" / "lighting.json").stat().st_mtime_ns == made
    # other options, or another library: everything anew
    code, lines = run([shots, "--summary", shots / "batch.json", *OPTIONS, "--seed", "1"], capsys)
    assert code == 0 and lines[-1]["result"]["kept"] == 0
    found = [job_key(shots / "a", *facts) for facts in (("digest", "--order"), ("other", "--order"), ("digest",))]
    assert len(set(found)) == 3


def test_results_are_gathered_in_one_folder_where_that_is_asked_for(shots, tmp_path, capsys):
    out = tmp_path / "out"
    code, lines = run([shots / "a", shots / "c", "--out", out, "--lanes", "2", *OPTIONS], capsys)
    assert code == 0 and lines[-1]["result"]["summary"] == str(out / "batch.json")
    assert all((out / name / "lighting.json").is_file() for name in "ac") and not (shots / "a" / "result").exists()


def test_places_shards_and_what_is_wrong_with_them(shots, tmp_path):
    every = find_jobs([shots])
    assert [p.name for p in every] == ["a", "b", "c"]
    assert find_jobs([shots / "a", shots / "a" / "job.json"]) == [shots / "a"]
    (tmp_path / "list.txt").write_text(f"# shots\n{shots / 'c'}\n\n{shots / 'a'}\n")
    assert [p.name for p in find_jobs([], tmp_path / "list.txt")] == ["c", "a"]
    (tmp_path / "list.txt").write_bytes(b"\xef\xbb\xbf" + os.fsencode(f"{shots / 'b'}\r\n  {shots / 'a'}  "))
    assert [p.name for p in find_jobs([], tmp_path / "list.txt")] == ["b", "a"]
    shards = [shard_of(every, f"{k}/2") for k in (1, 2)]
    assert sorted(shards[0] + shards[1]) == sorted(every) and not set(shards[0]) & set(shards[1])
    for wrong in ("0/2", "3/2", "two", "1"):
        with pytest.raises(InputError, match="K/N"):
            shard_of(every, wrong)
    with pytest.raises(InputError, match="has a job"):
        find_jobs([tmp_path / "nothing"])
    with pytest.raises(InputError, match="no jobs"):
        find_jobs([])
    with pytest.raises(InputError, match="--list"):
        find_jobs([], tmp_path / "missing.txt")


def test_a_shard_past_the_number_of_jobs_says_that_there_is_nothing_to_do(shots, tmp_path, capsys):
    code, lines = run([shots, "--shard", "4/7", "--out", tmp_path / "out", *OPTIONS], capsys)
    assert code == 0 and lines[-1]["result"] == {
        **{"jobs": [], "done": 0, "failed": 0, "crashed": 0, "kept": 0},
        "summary": None,
    }
    assert main(["batch", str(shots), "--shard", "4/7"]) == 0
    assert capsys.readouterr().out == "shard 4/7: of 3 jobs this one gets none; nothing was done\n"
    assert not (tmp_path / "out").exists()


def test_jobs_of_any_name_are_estimated(shots, monkeypatch, capsys):
    """Like an option's, and of bytes that are no text; named in a list, too."""
    names = ["--a", os.fsdecode(b"caf\xe9")]
    for old, new in zip("ac", names, strict=True):
        (shots / old).rename(shots / new)
    (shots / "--a" / names[1]).write_text("no part of the job")
    shutil.rmtree(shots / "b")
    (shots / "list.txt").write_bytes(b"caf\xe9\n")
    monkeypatch.chdir(shots)
    code, lines = run([".", *OPTIONS], capsys)
    assert code == 0 and lines[-1]["result"]["done"] == 2, lines[-1]
    assert all((shots / name / "result" / "lighting.json").is_file() for name in names)
    assert b"caf\\udce9" in (shots / "batch.csv").read_bytes()
    code, lines = run(["--list", "list.txt", *OPTIONS], capsys)
    assert code == 0 and lines[-1]["result"]["done"] == 1


def test_a_list_of_names_is_read_as_the_machine_names_files(shots):
    (shots / "a").rename(shots / "é")
    (shots / "list.txt").write_bytes("é\n".encode())
    program = "from btfsep_engine.cli.batch import find_jobs; print(len(find_jobs([], 'list.txt')))"
    environment = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    run = [sys.executable, "-c", program]
    assert subprocess.run(run, cwd=shots, env=environment, capture_output=True, check=True).stdout == b"1\n"


def test_an_option_that_is_wrong_is_said_once_and_nothing_is_begun(shots, capsys):
    code, lines = run([shots, *OPTIONS, "--order", "12"], capsys)
    assert code == 2 and [line["message"] for line in lines] == ["--order; '12'; choose 0 to 9, or auto"]
    assert not any((shots / name / "result").exists() for name in "abc")
