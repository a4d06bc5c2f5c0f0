# SPDX-License-Identifier: GPL-3.0-or-later
"""Adding to, checking and removing from a library; the commands; two processes at once."""

import json
import subprocess
import sys
import threading

import cv2
import numpy as np
import pytest

from btfsep_engine.btf import importing, library, linear, storing
from btfsep_engine.btf.checks import check
from btfsep_engine.btf.directions import ubo2014_directions
from btfsep_engine.btf.formats.ubo2014 import open_btf
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.cli import main
from btfsep_engine.errors import InputError
from btfsep_engine.storage.lock import locked
from tests.engine import btf_files

pytestmark = pytest.mark.usefixtures("own_cache")

DIRECTIONS = ubo2014_directions()[::4]
ANGLES = np.stack([np.arccos(DIRECTIONS[:, 2]), np.arctan2(DIRECTIONS[:, 1], DIRECTIONS[:, 0])], 1)


def flat(name, value=0.4):
    table = np.full((len(DIRECTIONS), len(DIRECTIONS), 3, 1), value / np.pi, np.float32)
    return Tabulated(name, name.split("/")[0], np.ones((4, 4, 1), np.float32), table, DIRECTIONS, DIRECTIONS, 0.5)


def write_log_file(path, rng, *, albedo=0.5, cosine_in=True, header=1):
    """A nearly Lambertian material whose factors are logarithms (model 12)."""
    base = np.log(albedo / np.pi * (DIRECTIONS[:, 2] if cosine_in else np.ones(len(DIRECTIONS))))
    u = [np.stack([np.tile(base, len(DIRECTIONS)), np.ones(len(DIRECTIONS) ** 2)], 1) for _ in range(3)]
    sxv = [np.stack([np.ones(64), rng.normal(0, 0.1, 64)], 1) for _ in range(3)]
    common = {"views": ANGLES, "lights": ANGLES, "width": 8, "height": 8, "cosine": header}
    path.write_bytes(btf_files.dfmf(u, sxv, model=12, **common))


def run(capsys, *arguments):
    """Exit status and the JSON lines of a command."""
    status = main([*map(str, arguments), "--json"])
    return status, [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_import_check_show_thumbnails_and_remove_by_commands(tmp_path, rng, capsys):
    write_log_file(tmp_path / "felt01.btf", rng, header=0)
    folder = tmp_path / "library"
    options = ["--name", "mine", "--class", "felt", "--library", folder]
    status, lines = run(capsys, "library", "import", tmp_path / "felt01.btf", *options, "--components", 6)
    result = lines[-1]["result"]
    assert status == 0 and result["name"] == "felt/mine" and result["components"] <= 6
    assert result["texel_mm"] == 0.25
    assert result["cosine"] == "included"  # reciprocity overrules the header, and says so
    assert next(line["message"] for line in lines if line["type"] == "warning").startswith(
        "felt01.btf: its header says"
    )
    assert lines[0]["type"] == "progress"
    np.testing.assert_allclose(result["albedo"], 0.5, atol=0.01)
    entry = library.open_library(folder).entries["felt/mine"]
    assert entry.source == "felt01.btf (DFMF08FCR file)" and entry.relative_error < 0.01
    assert sorted(p.name for p in folder.iterdir()) == [".lock", "felt_mine.btf", "index.json"]
    assert open_btf(folder / "felt_mine.btf").header.cosine_in_data

    status, lines = run(capsys, "library", "check", "--library", folder)
    assert status == 0 and lines[-1]["result"]["materials"][0]["ok"]
    assert lines[-1]["result"]["materials"][0]["cosine"] == {"header": "included", "reciprocity": "included"}
    damaged = bytearray((folder / "felt_mine.btf").read_bytes())
    damaged[-1] ^= 1
    (folder / "felt_mine.btf").write_bytes(damaged)
    status, lines = run(capsys, "library", "check", "--library", folder)
    table = lines[-1]["result"]["materials"][0]
    assert status == 2 and lines[-1]["type"] == "failed" and "1 of 7 materials are bad" in lines[-1]["message"]
    assert not table["ok"] and table["name"] == "felt/mine" and "index" in table["problems"][0]
    damaged[-1] ^= 1
    (folder / "felt_mine.btf").write_bytes(damaged)
    status, lines = run(capsys, "library", "list", "--library", folder, "--thumbnails", tmp_path / "t", "--side", 32)
    pictures = {m["name"]: cv2.imread(m["thumbnail"]) for m in lines[-1]["result"]["materials"]}
    assert set(pictures) == set(library.open_library(folder).names())
    assert all(p.shape == (32, 32, 3) for p in pictures.values())
    # albedo 0.5 lies between the reference materials of 0.18 and 0.8
    means = [pictures[n].mean() for n in ("reference/grey18", "felt/mine", "reference/white-diffuse")]
    assert means == sorted(means) and means[0] > 20

    status, lines = run(capsys, "library", "import", tmp_path / "felt01.btf", *options)
    assert status == 2 and "--replace" in lines[-1]["message"]
    status, lines = run(capsys, "library", "import", tmp_path / "felt01.btf", *options, "--replace", "--texel-mm", 0.1)
    assert status == 0 and library.open_library(folder).load("felt/mine").texel_mm == pytest.approx(0.1)
    assert len(list(folder.glob("*.btf"))) == 1
    assert run(capsys, "library", "remove", "felt/mine", "--library", folder)[0] == 0
    assert sorted(p.name for p in folder.iterdir()) == [".lock", "index.json"]
    status, lines = run(capsys, "library", "remove", "felt/mine", "--library", folder)
    assert status == 2 and "is not in" in lines[-1]["message"]


def test_how_many_components_an_import_keeps(tmp_path, rng):
    """A linear FMF file's own; three factors of their own become one; --components is obeyed by all."""
    common = {"views": ANGLES, "lights": ANGLES, "width": 8, "height": 8}
    pairs = len(ANGLES) ** 2
    u = [rng.uniform(0.1, 0.2, (pairs, 20)) for _ in range(3)]
    sxv = [rng.uniform(0, 0.05, (64, 20)) for _ in range(3)]
    (tmp_path / "dfmf.btf").write_bytes(btf_files.dfmf(u, sxv, **common))
    (tmp_path / "fmf.btf").write_bytes(btf_files.fmf(np.stack(u, 1).reshape(-1, 20), sxv[0], **common))
    truth = np.stack([s @ a.T for a, s in zip(u, sxv, strict=True)], -1).reshape(8, 8, len(ANGLES), -1, 3)
    for file, asked, kept in (("dfmf", None, 32), ("fmf", None, 20), ("dfmf", 5, 5), ("fmf", 5, 5)):
        read = importing.read_source(
            tmp_path / f"{file}.btf", name="a/b", material_class="a", cosine="excluded", components=asked
        )
        assert read.material.texels.shape[2] == kept
        if file == "dfmf":
            found = np.einsum("yxk,vlck->yxvlc", read.material.texels, read.material.angular)
            assert np.linalg.norm(found - truth) < (0.02 if kept == 32 else 0.15) * np.linalg.norm(truth)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--name", "a b", "--class", "felt"], "not class/name"),
        (["--name", "../x", "--class", "felt"], "not class/name"),
        (["--name", "grey18", "--class", "reference"], "reference"),
        (["--name", "a", "--class", "felt", "--components", "0"], "components"),
        (["--name", "a", "--class", "felt", "--texel-mm", "1", "--size-mm", "2"], "both"),
        (["--name", "a", "--class", "felt", "--texel-mm", "-1"], "millimetres"),
        (["--name", "a", "--class", "felt", "--gamma", "2.2"], "linear"),
    ],
)
def test_imports_that_cannot_be(tmp_path, rng, capsys, options, words):
    write_log_file(tmp_path / "a.btf", rng)
    status, lines = run(capsys, "library", "import", tmp_path / "a.btf", "--library", tmp_path / "l", *options)
    assert status == 2 and words in lines[-1]["message"]
    assert not (tmp_path / "l").exists() or not list((tmp_path / "l").glob("*.btf"))


def test_sources_that_are_nothing_or_too_bright(tmp_path, rng, capsys):
    for source, words in ((tmp_path / "none", "No such file"), (tmp_path, "6561 of 6561 images are missing")):
        status, lines = run(
            capsys,
            "library",
            "import",
            source,
            "--library",
            tmp_path / "l",
            "--name",
            "a",
            "--class",
            "b",
            "--size-mm",
            9,
        )
        assert status == 2 and words in lines[-1]["message"]
    write_log_file(tmp_path / "a.btf", rng, albedo=1.2)
    status, lines = run(
        capsys, "library", "import", tmp_path / "a.btf", "--library", tmp_path / "l", "--name", "a", "--class", "b"
    )
    assert status == 0 and any("would reflect 12" in line.get("message", "") for line in lines)
    status, lines = run(capsys, "library", "check", "b/a", "--library", tmp_path / "l")
    assert status == 2 and "more than comes" in lines[-1]["message"]


def test_check_finds_what_is_wrong(tmp_path):
    for name in ("felt/good", "felt/changed", "felt/lost", "felt/skewed"):
        storing.add(tmp_path, flat(name))
    opened = library.open_library(tmp_path)
    data = bytearray((tmp_path / "felt_changed.btf").read_bytes())
    data[-1] ^= 1
    (tmp_path / "felt_changed.btf").write_bytes(data)
    (tmp_path / "felt_lost.btf").unlink()
    skewed = flat("felt/skewed")
    skewed.angular[:] *= np.linspace(0.2, 1, len(DIRECTIONS))[:, None, None, None] ** 3
    storing.add(tmp_path, skewed, overwrite=True)
    opened = library.open_library(tmp_path)
    assert check(opened, "felt/good") | {"problems": []} == check(opened, "felt/good")
    assert check(opened, "felt/good")["ok"] and check(opened, "reference/chrome")["ok"]
    for name, words in (
        ("changed", "not the file in the index"),
        ("lost", "No such file"),
        ("skewed", "not reciprocal"),
    ):
        found = check(opened, f"felt/{name}")
        assert not found["ok"] and words in " ".join(found["problems"])
    with pytest.raises(InputError, match="did you mean"):
        check(opened, "felt/goode")


def test_the_shipped_materials_pass_the_check():
    opened = library.open_library()
    for name in opened.names():
        found = check(opened, name)
        assert found["ok"], found
        assert found["albedo"][1] < 1


WRITER = """
import sys, time
from pathlib import Path
from tests.engine.test_btf_store import flat
from btfsep_engine.btf import storing
Path(sys.argv[3], sys.argv[2]).touch()
while len(list(Path(sys.argv[3]).iterdir())) < 2:  # both begin together
    time.sleep(0.001)
for i in range(30):
    storing.add(sys.argv[1], flat(f"felt/{sys.argv[2]}{i}"))
storing.remove(sys.argv[1], f"felt/{sys.argv[2]}0")
"""


def test_two_processes_add_and_remove_at_once(tmp_path, request):
    folder = tmp_path / "library"
    (tmp_path / "ready").mkdir()
    commands = [[sys.executable, "-c", WRITER, str(folder), who, str(tmp_path / "ready")] for who in ("a", "b")]
    running = [subprocess.Popen(c, cwd=request.config.rootpath) for c in commands]
    assert [p.wait(120) for p in running] == [0, 0]
    opened = library.open_library(folder)
    assert set(opened.entries) == {f"felt/{who}{i}" for who in "ab" for i in range(1, 30)}
    for name in opened.entries:
        opened.load(name)
    assert len(list(folder.glob("*.btf"))) == 58 and not list(folder.glob(".writing-*"))


def test_two_conversions_at_once_leave_one_whole_file(tmp_path, rng):
    write_log_file(tmp_path / "a.btf", rng)
    found, errors = [], []

    def read():
        try:
            found.append(linear.read(tmp_path / "a.btf", components=5))
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=read) for _ in range(4)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert not errors and len(list((tmp_path / "cache" / "materials").iterdir())) == 1
    for other in found[1:]:
        np.testing.assert_array_equal(other.angular, found[0].angular)


def test_a_lock_that_is_held_and_a_folder_that_cannot_be_made(tmp_path):
    with locked(tmp_path), pytest.raises(InputError, match="another program"), locked(tmp_path, patience=0.1):
        pass
    with locked(tmp_path, patience=0.1):
        pass
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"), locked(tmp_path / "file" / "x"):
        pass


def test_an_error_while_adding_leaves_nothing(tmp_path):
    storing.add(tmp_path, flat("felt/one"))
    before = (tmp_path / "index.json").read_bytes()
    bad = flat("felt/two", 1e6)
    with pytest.raises(InputError, match="half floats"):
        storing.add(tmp_path, bad)
    with pytest.raises(InputError, match="has one of this name"):
        storing.add(tmp_path, flat("felt/one", 0.1))
    assert (tmp_path / "index.json").read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == [".lock", "felt_one.btf", "index.json"]


def test_names_that_differ_in_case_only_get_files_of_their_own(tmp_path):
    storing.add(tmp_path, flat("felt/One"))
    storing.add(tmp_path, flat("felt/one", 0.2))
    opened = library.open_library(tmp_path)
    assert len({e.file.lower() for e in opened.entries.values()}) == 2
    assert [round(float(opened.load(n).directional_albedo()[0, 0]), 2) for n in ("felt/One", "felt/one")] == [0.4, 0.2]
