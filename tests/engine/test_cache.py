# SPDX-License-Identifier: GPL-3.0-or-later
"""Entries of the cache: what was written is read, anything else is as if it were not there."""

import os

import numpy as np
import pytest

from btfsep_engine.errors import InputError
from btfsep_engine.storage import cache

ARRAYS = {
    "numbers": np.arange(60, dtype=np.float32).reshape(3, 4, 5),
    "text": np.array('{"a": [1, "ä"]}'),
    "one": np.float64(0.25),
    "half": np.linspace(0, 1, 7, dtype=np.float16),
}


@pytest.fixture
def entry(tmp_path):
    path = tmp_path / "kind" / "key.entry"
    cache.write(path, ARRAYS)
    return path


def holds(path, arrays=ARRAYS) -> bool:
    found = cache.read(path)
    if found is None:
        return False
    assert list(found) == list(arrays)
    for name, value in arrays.items():
        assert found[name].dtype == np.asarray(value).dtype
        np.testing.assert_array_equal(found[name], value)
    return True


def test_what_was_written_is_read(entry):
    assert holds(entry) and [p.name for p in entry.parent.iterdir()] == ["key.entry"]
    cache.write(entry, {"other": np.zeros(3)})
    assert holds(entry, {"other": np.zeros(3)})
    assert cache.read(entry.with_name("absent")) is None


def test_no_damage_is_read_and_all_of_it_is_mended(entry):
    """Many lengths, every byte with a bit flipped, and a float that has become NaN."""
    whole = entry.read_bytes()
    damaged = [whole[:length] for length in range(0, len(whole), 7)]
    damaged += [whole[:i] + bytes([whole[i] ^ (1 << i % 8)]) + whole[i + 1 :] for i in range(len(whole))]
    damaged += [whole + b"\0", whole * 2, b"\x93NUMPY\x01\x00v\x00{", bytes(len(whole))]
    at = whole.index(ARRAYS["numbers"].tobytes())
    damaged.append(whole[:at] + np.float32(np.nan).tobytes() + whole[at + 4 :])
    for data in damaged:
        entry.write_bytes(data)
        assert cache.read(entry) is None
    cache.write(entry, ARRAYS)
    assert holds(entry)


def test_an_entry_in_the_place_of_another_is_not_taken_for_it(entry, tmp_path):
    for place in (entry.with_name("other.entry"), tmp_path / "other" / "key.entry"):
        place.parent.mkdir(exist_ok=True)
        place.write_bytes(entry.read_bytes())
        assert cache.read(place) is None


def folder(path):
    (path / "inside").mkdir(parents=True)


def loop(path):
    path.symlink_to(path)


def link_to_a_folder(path):
    (path.parent.parent / "elsewhere").mkdir()
    path.symlink_to(path.parent.parent / "elsewhere")


@pytest.mark.parametrize("put", [folder, loop, link_to_a_folder, lambda path: os.mkfifo(path)])
def test_whatever_is_in_its_place_makes_room(entry, put):
    entry.unlink()
    put(entry)
    assert cache.read(entry) is None
    cache.write(entry, ARRAYS)
    assert holds(entry)


def test_a_folder_that_cannot_be_is_an_error_that_says_so(tmp_path):
    (tmp_path / "kind").write_text("in the way")
    assert cache.read(tmp_path / "kind" / "key.entry") is None
    with pytest.raises(InputError, match="cannot write"):
        cache.write(tmp_path / "kind" / "key.entry", ARRAYS)


def test_content_is_on_the_disk_before_the_name_and_the_name_before_the_end(tmp_path, monkeypatch):
    order, real_sync, real_replace = [], os.fsync, os.replace

    def sync(handle):
        order.append("folder" if os.path.isdir(f"/proc/self/fd/{handle}") else os.fstat(handle).st_size)
        real_sync(handle)

    def replace(old, new):
        order.append("replace")
        real_replace(old, new)

    monkeypatch.setattr(os, "fsync", sync)
    monkeypatch.setattr(os, "replace", replace)
    cache.write(tmp_path / "kind" / "key.entry", ARRAYS)
    assert order == [(tmp_path / "kind" / "key.entry").stat().st_size, "replace", "folder"]


@pytest.mark.parametrize(
    ("wrong", "fits"),
    [
        ({}, True),
        ({"uv": np.zeros((3, 2))}, False),
        ({"uv": np.zeros((4, 3, 2))}, False),
        ({"uv": np.array("text")}, False),
        ({"uv": np.full((3, 4, 2), np.nan)}, False),
        ({"uv": np.full((3, 4, 2), np.inf, np.float16)}, False),
        ({"other": np.zeros((5, 7))}, False),
        ({"uv": np.zeros((3, 7, 2)), "other": np.zeros((7, 7))}, True),
        ({"name": np.zeros(3)}, False),
        ({"name": np.array(["a", "b"])}, False),
        ({"name": np.array("")}, True),
        ({"more": np.array([np.nan])}, False),
    ],
)
def test_an_entry_that_is_whole_and_holds_something_else_is_none(tmp_path, wrong, fits):
    arrays = {"uv": np.zeros((3, 4, 2)), "other": np.zeros((4, 7), np.int32), "name": np.array("text"), **wrong}
    cache.write(tmp_path / "kind" / "key.entry", arrays)
    shapes = {"uv": (3, "n", 2), "other": ("n", 7), "name": cache.TEXT}
    assert (cache.read(tmp_path / "kind" / "key.entry", shapes) is not None) is fits
    assert cache.read(tmp_path / "kind" / "key.entry") is not None
    for name in shapes:
        cache.write(tmp_path / "kind" / "less.entry", {k: v for k, v in arrays.items() if k != name})
        assert cache.read(tmp_path / "kind" / "less.entry", shapes) is None


def test_a_full_folder_gives_up_what_was_unused_for_longest(tmp_path, monkeypatch):
    paths = [tmp_path / "kind" / f"{i}.entry" for i in range(5)]
    for i, path in enumerate(paths[:4]):
        cache.write(path, ARRAYS)
        os.utime(path, (1000 + i, 1000 + i))
    (tmp_path / "kind" / "other.txt").write_text("no entry")
    assert holds(paths[0])  # it is used: now the second is the oldest
    monkeypatch.setattr(cache, "MOST_BYTES", int(3.5 * paths[0].stat().st_size))
    cache.write(paths[4], ARRAYS)
    assert [p.exists() for p in paths] == [True, False, False, True, True]
    monkeypatch.setenv("BTFSEP_CACHE_MB", "0.000001")
    cache.write(paths[1], ARRAYS)
    assert {p.name for p in (tmp_path / "kind").iterdir()} == {"1.entry", "other.txt"}  # what is written stays


@pytest.mark.parametrize(("text", "bytes_"), [("3", 3 << 20), ("-1", 0), ("much", cache.MOST_BYTES)])
def test_a_user_can_say_how_large_a_folder_may_be(monkeypatch, text, bytes_):
    monkeypatch.setenv("BTFSEP_CACHE_MB", text)
    assert cache.most_bytes() == bytes_


def test_all_that_is_kept_is_taken_away_and_nothing_else(tmp_path, monkeypatch):
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "mine"))
    assert cache.entries() == [] and cache.clear() == 0
    for name in ("kind/a.entry", "kind/b.entry", "runs/key/0.entry"):
        cache.write(tmp_path / "mine" / name, ARRAYS)
    (tmp_path / "mine" / "kind" / ".writing-half").write_bytes(b"half")
    (tmp_path / "mine" / "kind" / "letter.txt").write_text("the user's own")
    (tmp_path / "other.entry").write_text("beside it")
    held = sum(path.stat().st_size for path in cache.entries())
    assert held > 4 and cache.clear() == held
    assert sorted(p.name for p in (tmp_path / "mine").rglob("*")) == ["kind", "letter.txt"]
    assert (tmp_path / "other.entry").is_file()
