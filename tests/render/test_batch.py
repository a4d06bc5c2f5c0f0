# SPDX-License-Identifier: GPL-3.0-or-later
"""``btfsep batch``: every job estimated as alone, one that fails costs itself only, what is done stays."""

import contextlib
import csv
import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.cli import main
from btfsep_engine.cli.batch import EstimateTask, estimate_job
from btfsep_engine.cli.jobs import find_jobs, result_folders, shard_of
from btfsep_engine.cli.lanes import run_here
from btfsep_engine.cli.summary import Journal
from btfsep_engine.commands.resume import finished_result
from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.job.load import job_digest, load_job
from btfsep_engine.light.files import read_lighting
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter

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
    assert code == 3 and lines[-1]["type"] == "failed" and "1 of 3 jobs failed" in lines[-1]["message"]
    assert lines[-1]["exit_code"] == 3 and lines[-1]["result"]["done"] == 2 and lines[-1]["result"]["failed"] == 1
    assert any("photo.exr" in line["message"] for line in lines if line["type"] == "warning")
    summary = json.loads((shots / "batch.json").read_text())["jobs"]
    assert [e["status"] for e in summary] == ["done", "failed", "done"]
    with open(shots / "batch.csv", newline="") as table:
        assert [row["status"] for row in csv.DictReader(table)] == ["done", "failed", "done"]
    assert not (shots / "batch.jsonl").exists()
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


def test_what_is_done_is_told_by_the_results_themselves(shots, monkeypatch, capsys):
    """Whoever made them, however they are named, whatever a summary says."""
    shutil.rmtree(shots / "b")
    monkeypatch.chdir(shots)

    def kept(*arguments) -> int:
        code, lines = run([*arguments, *OPTIONS], capsys)
        assert code == 0, lines[-1]
        return lines[-1]["result"]["kept"]

    assert main(["estimate", "a", *OPTIONS]) == 0  # by hand
    capsys.readouterr()
    assert kept("a", "c") == 1
    assert kept(shots / "a", "c/job.json", "--summary", "other.json", "--lanes", "2") == 2
    Path("a/result/lighting.json").write_text("{}")
    assert kept(".", "--time-limit", "600") == 1
    assert kept("c", "--again") == 0

    usual = choose("draft", order=2)
    library, told = open_library(), {"material": OPTIONS[1], "with_report": False}

    def finished(job="a", *, settings=usual, library=library, **change) -> bool:
        return finished_result(job, f"{job}/result", library, settings, **told | change) is not None

    for path in map(Path, ("a/result/lighting.json", "a/result/lighting.exr", "a/result/result.json")):
        assert finished()
        whole = path.read_bytes()
        for damaged in (whole[: len(whole) // 2], whole + b"}", b"", b"[]", b"7", whole.replace(b"e", b"f"), None):
            path.unlink() if damaged is None else path.write_bytes(damaged)
            assert not finished(), (path, damaged)
        path.write_bytes(whole)
    changes = {"material": "reference/grey18"}, {"with_report": True}, {"settings": choose("draft", order=2, seed=1)}
    changes += ({"library": replace(library, entries=dict(list(library.entries.items())[1:]))},)
    assert not any(finished(**change) for change in changes)
    monkeypatch.setattr("btfsep_engine.commands.resume.__version__", "99")
    assert not finished()
    monkeypatch.undo()
    monkeypatch.chdir(shots)
    assert finished()
    shutil.rmtree("a/result")
    shutil.copytree("c/result", "a/result")
    assert finished()  # the same files have the same results
    Path("a/job.json").write_text(Path("a/job.json").read_text() + " ")
    assert not finished() and finished("c")
    Path("c/photo.exr").unlink()
    assert not finished("c")


def test_a_record_does_not_vouch_for_a_light_that_another_run_wrote_meanwhile(shots, monkeypatch):
    other, out = Path(shots / "c"), shots / "a" / "result"
    assert main(["estimate", str(other), *OPTIONS, "--order", "1"]) == 0

    def interrupted(path, answer):
        for name in ("lighting.json", "lighting.exr"):
            shutil.copy(other / "result" / name, out)
        path.write_bytes(b"a picture")

    monkeypatch.setattr("btfsep_engine.commands.report.write_estimate_report", interrupted)
    assert main(["estimate", str(shots / "a"), *OPTIONS, "--report"]) == 0
    told = {"material": OPTIONS[1], "with_report": True}
    assert finished_result(shots / "a", out, open_library(), choose("draft", order=2), **told) is None


def test_a_digest_without_loading_is_that_of_loading(shots):
    job = shots / "a"
    assert job_digest(job) == load_job(job).digest == job_digest(job / "job.json")
    fields = json.loads((job / "job.json").read_text())
    images.write_png(job / "mask.png", np.ones((fields["camera"]["height"], fields["camera"]["width"], 3), np.float32))
    fields["objects"][0]["mask"] = "mask.png"
    fields["occluders"] = [{"mesh": "floor.ply", "surface": {"base_color": [0.5, 0.5, 0.5]}}]
    trimesh.creation.box().export(job / "floor.ply")
    (job / "job.json").write_text(json.dumps(fields))
    before = job_digest(job)
    assert before == load_job(job).digest
    for name in ("mask.png", "floor.ply"):
        with (job / name).open("ab") as file:
            file.write(b"\n")
        assert job_digest(job) != before
        before = job_digest(job)
    (job / "floor.ply").unlink()
    with pytest.raises(InputError, match=r"floor\.ply"):
        job_digest(job)


def test_a_photo_that_changes_while_it_is_read_does_not_count_as_read(shots, monkeypatch):
    before, read = job_digest(shots / "a"), images.read_linear

    def late(path, **how):
        images.write_exr(path, 2 * read(path, **how).pixels)
        return read(path, **how)

    monkeypatch.setattr(images, "read_linear", late)
    assert load_job(shots / "a").digest == before != job_digest(shots / "a")


def test_whatever_is_wrong_with_one_place_costs_one_line(shots, tmp_path, capsys):
    """Folders that are missing, names that no file can have; a byte order mark in a job.json is no fault."""
    (shots / "empty").mkdir()
    (shots / "none").write_text("a file")
    (shots / "c" / "job.json").write_bytes(b"\xef\xbb\xbf" + (shots / "c" / "job.json").read_bytes())
    places = [b"a", b"gone", b"b", b"nul\0nul", b"empty", b"none", b"n\xf6", b"x" * 5000, b"c", b"./a"]
    (tmp_path / "list").write_bytes(b"\r\n".join(places))
    with contextlib.chdir(shots):
        code, lines = run(["--list", tmp_path / "list", "--out", tmp_path / "out", "--retries", "0", *OPTIONS], capsys)
    assert code == 3 and "7 of 9 jobs failed" in lines[-1]["message"]
    assert lines[-1]["result"] | {"summary": ""} == {"done": 2, "failed": 7, "crashed": 0, "kept": 0, "summary": ""}
    warnings = [line["message"] for line in lines if line["type"] == "warning"]
    assert len(warnings) == 7
    assert sum("there is no such folder" in w for w in warnings) >= 3
    summary = json.loads((tmp_path / "out" / "batch.json").read_text())
    assert [e["status"] for e in summary["jobs"]].count("done") == 2


def test_a_summary_that_cannot_be_written_is_said_and_nothing_else_stops(shots, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    code, lines = run([shots / "a", "--summary", tmp_path / "file" / "batch.json", *OPTIONS], capsys)
    assert code == 0 and lines[-1]["result"] == {"done": 1, "failed": 0, "crashed": 0, "kept": 0, "summary": None}
    assert any(line["message"].startswith("no summary in") for line in lines if line["type"] == "warning")
    assert (shots / "a" / "result" / "result.json").exists()
    code, lines = run([shots / "a", "--summary", tmp_path / "batch.csv", *OPTIONS], capsys)
    assert code == 2 and "batch.json" in lines[-1]["message"]


def test_two_batches_that_write_to_one_place_have_each_its_own_summary(tmp_path):
    summary, reporter = tmp_path / "batch.json", Reporter()
    (tmp_path / "batch.jsonl").write_text("of one that was killed")
    first = Journal(summary, reporter)
    first.add(0, {"job": "a", "status": "failed", "message": "no photo"})
    second = Journal(summary, reporter)
    second.add(0, {"job": "b", "status": "done", "message": ""})
    second.add(1, {"job": "c", "status": "done", "message": ""})
    first.add(1, {"job": "d", "status": "done", "message": ""})
    for journal, names in ((first, "ad"), (second, "bc")):  # the last to end has the file
        assert journal.close() == summary
        assert "".join(e["job"] for e in json.loads(summary.read_text())["jobs"]) == names
    assert sorted(p.name for p in tmp_path.iterdir()) == ["batch.csv", "batch.json"] and not reporter.warnings


def test_a_job_that_takes_too_long_fails_and_says_so(shots, capsys):
    limited = ["--time-limit", "0.01", "--retries", "0", "--summary", shots / "batch.json"]
    code, lines = run([shots / "a", shots / "c", *limited, *OPTIONS], capsys)
    assert code == 3 and lines[-1]["result"]["failed"] == 2
    assert sum("it took more than 0.01 s" in line.get("message", "") for line in lines) == 2


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT], ids=lambda s: s.name)
def test_a_batch_that_is_stopped_has_a_summary_of_what_it_did(shots, how):
    for i in range(30):
        shutil.copytree(shots / "a", shots / f"more{i}")
    command = [sys.executable, "-m", "btfsep_engine", "batch", ".", "--lanes", "2", "--json", *OPTIONS]
    with subprocess.Popen(command, cwd=shots, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as batch:
        while '"message": "2 of 33' not in batch.stdout.readline():
            pass
        batch.send_signal(how)
        batch.stdout.read()
        assert batch.wait() == 130, batch.stderr.read()
    done = [e["job"] for e in json.loads((shots / "batch.json").read_text())["jobs"] if e["status"] == "done"]
    assert 1 <= len(done) < 32 and all((shots / job / "result" / "result.json").exists() for job in done)
    assert not list(shots.glob("**/.writing-*")) and not list(shots.glob("*.jsonl"))


def test_summaries_of_shards_are_joined(shots, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(shots)
    out = ["--out", tmp_path]
    codes = [run([".", "--shard", f"{k}/2", *out, *OPTIONS], capsys)[0] for k in (1, 2)]
    assert codes == [0, 3]  # a and c; b
    parts = [tmp_path / f"batch-{k}-of-2.json" for k in (1, 2)]
    code, lines = run(["--join", *parts, *out], capsys)
    assert code == 3 and lines[-1]["result"] == {
        **{"done": 2, "failed": 1, "crashed": 0, "summary": str(tmp_path / "batch.json")}
    }
    assert [e["job"] for e in json.loads((tmp_path / "batch.json").read_text())["jobs"]] == ["a", "c", "b"]
    shutil.copy(shots / "a" / "photo.exr", shots / "b")
    run(["b", "--summary", tmp_path / "again.json", *out, *OPTIONS], capsys)
    code, lines = run(["--join", tmp_path / "again.json", *parts, *out], capsys)
    assert code == 0 and lines[-1]["result"]["done"] == 3  # what is done stays done
    assert main(["batch", "--join", str(parts[0]), "--out", str(tmp_path)]) == 0
    said = capsys.readouterr()
    assert "2 jobs done; see" in said.out and "of 2 shards there is no summary of 2" in said.err
    # the journal of a batch that was killed: its last line is not whole
    entries = json.loads(parts[0].read_text())["jobs"]
    journal = "\n".join(map(json.dumps, entries))
    (tmp_path / "killed.jsonl").write_text(journal[:-20])
    code, lines = run(["--join", tmp_path / "killed.jsonl", *out], capsys)
    assert code == 0 and lines[-1]["result"]["done"] == 1
    shutil.copy(parts[0], parts[1])
    assert run(["--join", tmp_path, *out], capsys)[0] == 0  # a folder's shards
    for wrong in (shots / "a" / "job.json", tmp_path / "batch.csv", tmp_path / "none", shots):
        assert run(["--join", wrong, *out], capsys)[0] == 2
    assert run(["--join", *out], capsys)[0] == 2 and run(["--join", parts[0], "--shard", "1/2"], capsys)[0] == 2


def test_two_shards_write_to_no_folder_twice(shots, tmp_path):
    """The second job of a name is on another machine, perhaps."""
    shutil.copytree(shots / "a", tmp_path / "a")
    jobs = find_jobs([shots, tmp_path / "a"])
    with pytest.raises(InputError, match="two job folders are named 'a'"):
        result_folders(jobs, tmp_path / "out")
    assert find_jobs([shots / "a", shots / "." / "a", os.path.relpath(shots / "a")]) == [shots / "a"]


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
    (tmp_path / "list.txt").write_text(f"{shots / 'b'}\n", "utf-16")
    assert [p.name for p in find_jobs([], tmp_path / "list.txt")] == ["b"]
    shards = [shard_of(every, f"{k}/2") for k in (1, 2)]
    assert sorted(shards[0] + shards[1]) == sorted(every) and not set(shards[0]) & set(shards[1])
    for wrong in ("0/2", "3/2", "two", "1", "1/2/3", "-1/2", "1_0/2_0", " 1/2", "１/２"):
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
        **{"done": 0, "failed": 0, "crashed": 0, "kept": 0},
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
    program = "from btfsep_engine.cli.jobs import find_jobs; print(len(find_jobs([], 'list.txt')))"
    environment = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    run = [sys.executable, "-c", program]
    assert subprocess.run(run, cwd=shots, env=environment, capture_output=True, check=True).stdout == b"1\n"


def test_an_option_that_is_wrong_is_said_once_and_nothing_is_begun(shots, capsys):
    code, lines = run([shots, *OPTIONS, "--order", "12"], capsys)
    assert code == 2 and [line["message"] for line in lines] == ["--order; '12'; choose 0 to 9, or auto"]
    assert not any((shots / name / "result").exists() for name in "abc")


def test_a_batch_in_its_own_process_is_as_any_other(shots, tmp_path, capsys):
    """As a resident engine does it; where a job may fail, that is no failure of the batch."""
    own = [shots, "--out", tmp_path, "--lanes", "0", *OPTIONS]
    code, lines = run(own, capsys)
    assert code == 3 and lines[-1]["result"]["done"] == 2
    code, lines = run([*own, "--allow-failures"], capsys)
    assert code == 0 and lines[-1]["type"] == "done"
    assert lines[-1]["result"] | {"summary": ""} == {"done": 2, "failed": 1, "crashed": 0, "kept": 2, "summary": ""}
    assert main(["batch", *map(str, own), "--allow-failures"]) == 0
    assert "2 jobs done (2 of them before), 1 failed; see" in capsys.readouterr().out
    assert run([*own, "--time-limit", "3"], capsys)[0] == 2
    for wrong in ("-1", "many", "257"):
        assert main(["batch", str(shots), "--lanes", wrong]) == 2


def test_a_batch_in_its_own_process_stops_when_its_reporter_says_so(shots):
    class Stopping(Reporter):
        words = 0

        def check(self):
            self.words += 1
            if self.words > 12:
                raise KeyboardInterrupt

    task = EstimateTask(shots / "a", shots / "out", choose("draft", order=2), material=OPTIONS[1], with_report=False)
    ends = run_here(estimate_job, [task] * 9, Stopping())
    with pytest.raises(KeyboardInterrupt):
        next(ends)
    assert not (shots / "out" / "result.json").exists()
