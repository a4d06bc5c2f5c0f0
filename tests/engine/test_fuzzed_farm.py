# SPDX-License-Identifier: GPL-3.0-or-later
"""Names, lists, summaries and result sets of any content: what is expected of them, or one sentence, and no bug."""

import json
import os
import shutil

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from btfsep_engine.btf.library import open_library
from btfsep_engine.cli.batch import run_batch
from btfsep_engine.cli.jobs import find_jobs, result_folders, shard_of
from btfsep_engine.cli.summary import STATUSES, join, read_entries, write_summary
from btfsep_engine.cli.worker import Outcome
from btfsep_engine.commands.resume import estimate_key, finished_result
from btfsep_engine.errors import InputError
from btfsep_engine.job.load import job_digest
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from btfsep_engine.storage import atomic

many = settings(
    max_examples=int(os.environ.get("BTFSEP_FUZZ", "60")),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inside: st.lists(inside, max_size=3) | st.dictionaries(st.text(max_size=8), inside, max_size=3),
    max_leaves=8,
)
NAMES = st.binary(min_size=1, max_size=40).filter(lambda b: not set(b) & set(b"\0/\r\n") and b not in (b".", b".."))


@many
@given(lines=st.lists(st.binary(max_size=300), max_size=8), mark=st.sampled_from([b"", b"\xef\xbb\xbf", b"\xff\xfe"]))
def test_a_list_of_any_bytes_is_places_or_a_sentence(tmp_path, lines, mark):
    (tmp_path / "list").write_bytes(mark + b"\n".join(lines))
    try:
        jobs = find_jobs([], tmp_path / "list")
    except InputError as error:
        assert ";" in str(error)
        return
    assert len(set(jobs)) == len(jobs)


@pytest.mark.skipif(os.name != "posix", reason="names of bytes")
@many
@given(names=st.lists(NAMES, min_size=1, max_size=6, unique=True), again=st.booleans())
def test_jobs_of_any_name_are_found_shared_and_summed_up(tmp_path_factory, names, again):
    room = tmp_path_factory.mktemp("room")
    plain = (n for n in names if not n.startswith(b"#") and n.strip() == n)
    listed = {name for name in plain if name.splitlines() == [name]}
    for name in names:
        (room / os.fsdecode(name)).mkdir()
        (room / os.fsdecode(name) / "job.json").write_text("{}")
    jobs = find_jobs([room, room / "." if again else room])
    assert {os.fsencode(j.name) for j in jobs} == set(names)
    (room / "list.txt").write_bytes(b"\n".join(os.fsencode(room) + b"/" + name for name in listed))
    if listed:
        assert {os.fsencode(j.name) for j in find_jobs([], room / "list.txt")} == listed
    shares = [shard_of(jobs, f"{k}/3") for k in (1, 2, 3)]
    assert sorted(job for share in shares for job in share) == sorted(jobs)
    folders = result_folders(jobs, room / "out")
    assert len(set(folders)) == len(jobs)
    failed, done = Outcome(2, "it; is wrong"), Outcome(result={"kept": False})
    ends = ((i, failed if i % 2 else done) for i in range(len(jobs)))
    result = run_batch(jobs, folders, ends, summary=room / "batch.json", reporter=Reporter())
    assert result["done"] == -(-len(jobs) // 2) and (room / "batch.csv").exists()
    assert [e["job"] for e in json.loads((room / "batch.json").read_text())["jobs"]] == list(map(str, jobs))
    shutil.rmtree(room)


@many
@given(text=st.text(max_size=12) | st.from_regex(r"[0-9]{0,12}/[0-9]{0,12}"))
def test_a_shard_of_any_text_is_a_share_or_a_sentence(text):
    try:
        assert set(shard_of(list("abcdefg"), text)) <= set("abcdefg")
    except InputError as error:
        assert "--shard" in str(error)


ENTRIES = st.lists(
    st.fixed_dictionaries(
        {"job": st.text(max_size=6), "status": st.sampled_from(STATUSES)},
        optional={"message": st.text(), "seconds": JSON, "materials": JSON, "warnings": JSON, "other": JSON},
    ),
    max_size=4,
)


@many
@given(entries=ENTRIES, cut=st.integers(0, 400), noise=st.binary(max_size=6), facts=JSON)
def test_a_summary_of_any_content_is_joined_or_a_sentence(tmp_path, entries, cut, noise, facts):
    whole, journal, damaged = (tmp_path / name for name in ("whole.json", "whole.jsonl", "damaged.json"))
    whole.write_text(json.dumps({"format": "btfsep-batch", "version": 1, "shard": facts, "jobs": entries}))
    journal.write_text("".join(json.dumps(e) + "\n" for e in entries))
    damaged.write_bytes(whole.read_bytes()[:cut] + noise + whole.read_bytes()[cut + len(noise) :])
    for path in (whole, journal, damaged):
        try:
            found = list(read_entries(path)[1])
            counts = join([path], tmp_path / "all.json", Reporter())
        except InputError as error:
            assert path == damaged and ";" in str(error)
            continue
        assert path == damaged or found == json.loads(json.dumps(entries))
        assert sum(counts[s] for s in STATUSES) == len({e["job"] for e in found})
        json.loads((tmp_path / "all.json").read_text())


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A job whose result set is whole, as far as that can be told."""
    job = tmp_path_factory.mktemp("job")
    fields = {"format": "btfsep-job", "version": 1, "image": "photo.png", "objects": [{"name": "a", "mesh": "a.ply"}]}
    fields["camera"] = {n: 8 for n in ("width", "height", "fx", "fy", "cx", "cy")}
    fields["camera"]["to_world"] = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
    (job / "job.json").write_text(json.dumps(fields))
    for name in ("photo.png", "a.ply"):
        (job / name).write_bytes(name.encode())
    out, library = job / "result", open_library()
    write_summary(out / "lighting.json", [])
    (out / "lighting.exr").write_bytes(b"light")
    key = estimate_key([job_digest(job)], library, choose("draft"), None)
    files = {name: atomic.digest(out / name) for name in ("lighting.json", "lighting.exr")}
    (out / "result.json").write_text(json.dumps({"key": key, "files": files, "warnings": ["ä"]}))
    return job, library


@many
@given(data=st.data())
def test_a_result_set_of_any_content_is_whole_or_none(finished, data):
    job, library = finished
    record = job / "result" / "result.json"
    told = {"with_report": False}
    good = record.read_bytes()
    assert finished_result(job, record.parent, library, choose("draft"), **told) == json.loads(good)
    fields = json.loads(good)
    changed = data.draw(st.sampled_from(["key", "files", "lighting.exr", "all", "bytes", "more"]))
    if changed == "bytes":
        at = data.draw(st.integers(0, len(good) - 1))
        record.write_bytes(good[:at] + data.draw(st.binary(max_size=3)) + good[at + 1 :])
    else:
        value = data.draw(JSON)
        if changed == "all":
            fields = value
        elif changed == "more":
            fields["files"] |= {data.draw(st.text(max_size=6) | st.just("../job.json")): value}
        elif changed == "lighting.exr":
            fields["files"][changed] = value
        else:
            fields[changed] = value
        record.write_text(json.dumps(fields))
    try:
        found = finished_result(job, record.parent, library, choose("draft"), **told)
        assert found is None or changed == "bytes"  # of the words of a result nobody has a digest
        assert found is None or (found["key"], found["files"]) == (json.loads(good)["key"], json.loads(good)["files"])
    finally:
        record.write_bytes(good)
