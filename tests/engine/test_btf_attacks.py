# SPDX-License-Identifier: GPL-3.0-or-later
"""What a careless user, a full disk, a kill or an attacker can do to a library folder: one sentence, nothing lost."""

import json
import os
import resource
import signal
import subprocess
import sys

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from btfsep_engine.btf import importing, library, linear, storing
from btfsep_engine.btf.formats import writing
from btfsep_engine.btf.formats.archive import Members
from btfsep_engine.btf.formats.image_set import import_images
from btfsep_engine.cli import main
from btfsep_engine.commands import measure as measuring
from btfsep_engine.errors import InputError
from tests.engine.test_btf_store import flat, write_log_file

pytestmark = pytest.mark.skipif(os.name == "nt", reason="pipes, signals and limits of POSIX")


@pytest.fixture(autouse=True)
def own_cache_and_no_hang(tmp_path, monkeypatch):
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "cache"))

    def stop(*_):
        raise TimeoutError("it hangs")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(120)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def said(capsys, *arguments) -> str:
    """The one sentence that a command which has to fail says: exit status 2, "what; what was got; what to do"."""
    assert main([str(a) for a in ("library", *arguments)]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("warning: ")]
    assert len(lines) == 1 and lines[0].startswith("error: ") and lines[0].count("; ") >= 2, lines
    return lines[0]


@pytest.mark.parametrize("name", ["..", ".", "-rf", "../x", "a/b", "/etc/x", "a\n", "a\0b", "", "x" * 200, "é"])
def test_names_that_lead_somewhere(tmp_path, rng, capsys, name):
    write_log_file(tmp_path / "a.btf", rng)
    options = [f"--name={name}", "--class", "felt", "--library", tmp_path / "l"]
    assert "it is not class/name" in said(capsys, "import", tmp_path / "a.btf", *options)
    assert not (tmp_path / "l").exists()
    with pytest.raises(InputError, match="not class/name"):
        importing.full_name("x", f"felt/{name}")


def test_pipes_and_devices_do_not_hang(tmp_path, capsys):
    storing.add(tmp_path / "l", flat("felt/one"))
    os.mkfifo(tmp_path / "pipe.btf")
    options = ["--name", "a", "--class", "felt", "--library", tmp_path / "l"]
    for source in (tmp_path / "pipe.btf", "/dev/zero"):
        assert "neither a file nor a folder" in said(capsys, "import", source, *options)
    (tmp_path / "l" / "felt_one.btf").unlink()
    os.mkfifo(tmp_path / "l" / "felt_one.btf")
    assert "not the file in the index" in said(capsys, "show", "felt/one", "--library", tmp_path / "l")
    (tmp_path / "l" / "index.json").unlink()
    os.mkfifo(tmp_path / "l" / "index.json")
    assert "no file" in said(capsys, "list", "--library", tmp_path / "l")
    (tmp_path / "images").mkdir()
    os.mkfifo(tmp_path / "images" / "tl000 pl000 tv000 pv000.png")
    with Members(tmp_path / "images") as members:
        (name,) = members.names
        with pytest.raises(InputError, match="no file"), members.file(name):
            pass


def test_a_source_whose_name_is_not_text(tmp_path, rng):
    write_log_file(tmp_path / "a.btf", rng)
    odd = os.fsencode(tmp_path) + b"/caf\xe9.btf"
    os.rename(tmp_path / "a.btf", odd)
    importing.import_material(tmp_path / "l", os.fsdecode(odd), name="a", material_class="felt")
    assert library.open_library(tmp_path / "l").entries["felt/a"].source == "caf?.btf (DFMF08FCR file)"


def test_a_build_into_a_file_is_refused_before_the_work(tmp_path, capsys, monkeypatch):
    (tmp_path / "file").write_text("")

    def measured(*_, **__):
        raise AssertionError("measured first")

    monkeypatch.setattr(measuring, "build", measured)
    for folder in (tmp_path / "file", tmp_path / "file" / "deeper"):
        assert "cannot write to" in said(capsys, "build", folder, "--only", "felt/grey-melange")


def test_a_removal_makes_nothing_and_takes_links_not_what_they_point_to(tmp_path, capsys):
    assert "no readable index.json" in said(capsys, "remove", "felt/x", "--library", tmp_path / "none")
    assert not (tmp_path / "none").exists()
    storing.add(tmp_path / "l", flat("felt/one"))
    assert "give one of its names (felt/one …)" in said(capsys, "remove", "../../x", "--library", tmp_path / "l")
    for name in ("felt_one.btf", "index.json"):  # both become links to files elsewhere
        (tmp_path / "l" / name).rename(tmp_path / name)
        (tmp_path / "l" / name).symlink_to(tmp_path / name)
    content = [(tmp_path / n).read_bytes() for n in ("felt_one.btf", "index.json")]
    storing.add(tmp_path / "l", flat("felt/one", 0.2), overwrite=True)
    storing.remove(tmp_path / "l", "felt/one")
    assert [(tmp_path / n).read_bytes() for n in ("felt_one.btf", "index.json")] == content
    assert "which is empty" in said(capsys, "remove", "felt/one", "--library", tmp_path / "l")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "Invalid JSON"),
        (b"[" * 100_000, "recursion"),
        (b"\xff\xfe", "Invalid JSON"),
        (b"[]", "object"),
        ({"relative_error": float("nan")}, "relative_error"),
        ({"texels": [0, 4]}, "texels"),
        ({"texels": [10**400, 4]}, "texels"),
        ({"size": -1}, "size"),
        ({"name": "felt/.."}, "name"),
        ({"file": "felt_one.btf\n"}, "file"),
    ],
)
def test_broken_indexes(tmp_path, capsys, content, words):
    storing.add(tmp_path, flat("felt/one"))
    index = json.loads((tmp_path / "index.json").read_text())
    if isinstance(content, dict):
        index["materials"][0] |= content
        content = json.dumps(index).encode()
    (tmp_path / "index.json").write_bytes(content)
    for arguments in (["list"], ["check"], ["remove", "felt/one"]):
        sentence = said(capsys, *arguments, "--library", tmp_path)
        assert words in sentence and "; : " not in sentence
    assert (tmp_path / "index.json").read_bytes() == content and (tmp_path / "felt_one.btf").exists()


@settings(max_examples=600, deadline=20_000, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_damaged_index_is_told_or_valid(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp() / "damaged-index"
    if not folder.exists():
        storing.add(folder, flat("felt/one"))
        storing.add(folder, flat("wood/two"))
        (folder / "index.json").rename(folder / "good")
    content = bytearray((folder / "good").read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, 1 << 16)) * 31 % len(content)
        patch = data.draw(st.sampled_from([b"", b"9", b"-", b"..", b"/", b'"', b"null", b"1e999", b"NaN", b"[", b"\0"]))
        content[at : at + data.draw(st.integers(0, 4))] = patch
    (folder / "index.json").write_bytes(content)
    try:
        opened = library.open_library(folder)
    except InputError as error:
        assert error.what and error.got and error.do
        return
    for name in opened.entries:
        try:
            facts = opened.show(name)
        except InputError:
            continue
        json.dumps(facts, allow_nan=False)


def test_a_file_that_is_exchanged_while_it_is_read(tmp_path, monkeypatch):
    """What was hashed is what is used, though another file has its name by then."""
    storing.add(tmp_path, flat("felt/one", 0.4))
    writing.write(tmp_path / "other", flat("felt/one", 0.1))
    real = library.sha256

    def slow_hash(data):
        found = real(data)
        os.replace(tmp_path / "other", tmp_path / "felt_one.btf")
        return found

    opened = library.open_library(tmp_path)
    monkeypatch.setattr(library, "sha256", slow_hash)
    assert opened.load("felt/one").directional_albedo()[0, 0] == pytest.approx(0.4, rel=1e-3)
    monkeypatch.undo()
    with pytest.raises(InputError, match="not the file in the index"):
        opened.load("felt/one")


def command(*arguments, root, **options):
    line = [sys.executable, "-m", "btfsep_engine", "library", *map(str, arguments)]
    return subprocess.run(line, cwd=root, capture_output=True, text=True, timeout=100, **options)


def test_a_disk_that_is_full(tmp_path, rng, request):
    """No file may be larger than 8 kB: neither the cache's nor the library's."""
    write_log_file(tmp_path / "a.btf", rng)

    def limited():
        resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))

    options = ["--name", "a", "--class", "felt", "--library", tmp_path / "l"]
    done = command("import", tmp_path / "a.btf", *options, root=request.config.rootpath, preexec_fn=limited)
    assert done.returncode == 2
    what = f"cannot write {tmp_path}/l/felt_a.btf"
    assert done.stderr == f"error: {what}; File too large; free space or choose a folder that can be written\n"
    assert [p.name for p in (tmp_path / "l").iterdir()] == [".lock"]
    assert not list((tmp_path / "cache" / "materials").iterdir())


def test_no_room_for_what_a_zip_holds(tmp_path, monkeypatch):
    import zipfile

    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("a.png", b"x")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "gone"))
    with Members(tmp_path / "a.zip") as members:
        with pytest.raises(InputError, match=r"cannot write to .*gone; No such file"), members.file("a.png"):
            pass
    with pytest.raises(InputError, match=r"cannot write to .*gone; No such file"):
        import_images(tmp_path / "a.zip", components=2)


KILLED = """
import os, signal, sys
import numpy as np
from tests.engine.test_btf_store import flat
from btfsep_engine.btf import linear, storing
where, number, when, path = sys.argv[1:]

def dies(real):
    calls = iter(range(1, 10**6))
    def call(first, *rest, **options):
        last = next(calls) == int(number)
        if last and when == "before":
            os.kill(os.getpid(), signal.SIGKILL)
        found = real(first, *rest, **options)
        if last:
            getattr(first, "flush", str)()  # what was written so far is in the file
            os.kill(os.getpid(), signal.SIGKILL)
        return found
    return call

if where == "replace":
    os.replace = dies(os.replace)
    storing.add(path, flat("felt/same", 0.8), overwrite=True)
else:
    np.save = dies(np.save)
    linear.read(path, components=3)
"""


def killed(where, number, when, path, *, root) -> bool:
    """Runs a process that kills itself before or after its call number ``number``; False: it came to its end."""
    line = [sys.executable, "-c", KILLED, where, str(number), when, str(path)]
    return subprocess.run(line, cwd=root, timeout=100).returncode == -signal.SIGKILL


def test_an_import_that_is_killed_leaves_the_library_before_or_the_one_after(tmp_path, request):
    """Killed around every renaming of a file: the material's, the index's."""
    found = []
    for number in (1, 2, 3):
        for when in ("before", "after"):
            folder = tmp_path / f"{number}{when}"
            storing.add(folder, flat("felt/same", 0.4))
            storing.add(folder, flat("felt/other", 0.4))
            ended = not killed("replace", number, when, folder, root=request.config.rootpath)
            opened = library.open_library(folder)
            assert opened.load("felt/other").directional_albedo()[0, 0] == pytest.approx(0.4, rel=1e-3)
            found.append(round(float(opened.load("felt/same").directional_albedo()[0, 0]), 2))
            assert ended == (number == 3)
            storing.add(folder, flat("felt/same", 0.6), overwrite=True)
            again = library.open_library(folder).load("felt/same")
            assert again.directional_albedo()[0, 0] == pytest.approx(0.6, rel=1e-3)
    assert found == [0.4] * 3 + [0.8] * 3  # until the index is renamed


def test_what_killed_imports_leave_is_taken_away_later(tmp_path):
    storing.add(tmp_path, flat("felt/one"))
    left = tmp_path / ".writing-left.btf"
    left.write_bytes(b"x")
    storing.add(tmp_path, flat("felt/young"))
    assert left.exists()  # it may be another's, under way
    os.utime(left, (1, 1))
    storing.add(tmp_path, flat("felt/last"))
    assert not left.exists()


def test_a_conversion_that_is_killed_leaves_no_half_written_factors(tmp_path, rng, request):
    write_log_file(tmp_path / "a.btf", rng)
    cache = tmp_path / "cache" / "materials"
    for number in (1, 2, 3):
        assert killed("save", number, "after", tmp_path / "a.btf", root=request.config.rootpath)
        assert list(cache.iterdir()) and not list(cache.glob("[!.]*"))  # a scratch file, no more
    for left in cache.iterdir():
        os.utime(left, (1, 1))
    mean = linear.read(tmp_path / "a.btf", components=3).mean_abrdf
    assert not list(cache.glob(".*"))  # taken away, a day later
    (kept,) = cache.glob("[!.]*")
    whole = kept.read_bytes()
    for length in range(0, len(whole), 997):  # as another program might leave it
        kept.write_bytes(whole[:length])
        assert (linear.read(tmp_path / "a.btf", components=3).mean_abrdf == mean).all()
        assert kept.read_bytes() == whole
