# SPDX-License-Identifier: GPL-3.0-or-later
"""What a process keeps: called by content, bounded, never changed."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from btfsep_engine.storage.kept import SMALL, Store, bytes_of, content, recalled


@dataclass(frozen=True)
class Pair:
    name: str
    values: np.ndarray


def block(kilobytes: int) -> np.ndarray:
    return np.zeros(kilobytes * 1024, np.uint8)


def test_content_is_the_same_for_the_same_content_only():
    values = np.arange(12.0).reshape(3, 4)
    same = [
        [Pair("a", values), 1, None],
        (Pair("a", values.copy()), 1, None),
        [Pair("a", np.asfortranarray(values)), 1, None],
    ]
    assert len({content(each) for each in same}) == 1
    changed = values.copy()
    changed[2, 3] = np.nextafter(changed[2, 3], 0)
    others = [
        [Pair("b", values), 1, None],
        [Pair("a", changed), 1, None],
        [Pair("a", values.reshape(4, 3)), 1, None],
        [Pair("a", values.astype(np.float32)), 1, None],
        [Pair("a", values), 1.0, None],
        [Pair("a", values), True, None],
        [Pair("a", values), "1", None],
        [[Pair("a", values), 1], None],
        [Pair("a", -values + values), 1, None],
    ]
    assert len({content(each) for each in (same[0], *others)}) == 1 + len(others)
    assert content(np.zeros(1)) != content(-np.zeros(1))


def test_an_array_that_may_change_is_looked_at_again():
    values = np.zeros(4)
    before, view = content(values), values[:]
    view.flags.writeable = False
    assert content(view) == before
    values[0] = 1
    assert content(values) != before and content(view) == content(values)


def test_the_content_of_what_is_gone_is_not_that_of_its_successor():
    seen = {content(Pair("a", np.full(3, float(i)))) for i in range(200)}
    assert len(seen) == 200


def test_what_has_no_content_is_made_each_time():
    with pytest.raises(TypeError):
        content(object())
    made = [recalled("thing", [object()], lambda: np.zeros(1)) for _ in range(2)]
    assert made[0] is not made[1] and made[0].flags.writeable


@dataclass
class Thing:
    own: np.ndarray
    others: dict


def test_all_that_is_in_a_thing_is_counted_and_frozen():
    """However much of it there is, and whatever is short-lived on the way there."""
    thing = Thing(block(1), {i: Thing(block(1), {"one": [block(1), (block(1),)]}) for i in range(100)})
    thing.others["twice"] = thing
    thing.others["again"] = thing.own
    assert bytes_of(thing) == 301 * 1024
    Store(1 << 30).get(("thing",), lambda: thing)
    inner = [each for i in range(100) for each in (thing.others[i].own, thing.others[i].others["one"][0])]
    assert not any(array.flags.writeable for array in (thing.own, *inner))


def test_what_was_unused_for_longest_goes():
    store = Store(10 * (1024 + SMALL))
    for i in range(10):
        store.get(("t", i), lambda: block(1))
    first = store.get(("t", 0), pytest.fail)
    store.get(("t", 10), lambda: block(1))
    assert store.bytes <= store.most_bytes
    assert store.get(("t", 0), pytest.fail) is first
    again = []
    store.get(("t", 1), lambda: again.append(1) or block(1))
    assert again and (store.made, store.recalled) == (12, 2)


def test_a_thing_too_large_leaves_the_others_and_nothing_is_kept_of_none():
    store = Store(8 << 10)
    small = store.get(("s",), lambda: block(1))
    assert len(store.get(("l",), lambda: block(7))) == 7 << 10
    assert store.get(("s",), pytest.fail) is small and store.bytes < 2 << 10
    none = Store(0)
    assert len(none.get(("s",), lambda: block(1))) == 1 << 10 and none.bytes == 0


def test_an_error_keeps_nothing():
    store = Store(1 << 20)
    with pytest.raises(KeyboardInterrupt):
        store.get(("t",), lambda: (_ for _ in ()).throw(KeyboardInterrupt))
    assert store.get(("t",), lambda: "made") == "made" and store.bytes == SMALL


def test_what_is_kept_cannot_be_changed():
    store, whole = Store(1 << 20), np.zeros((2, 3))
    thing = store.get(("t",), lambda: [Pair("a", whole[0]), {"b": whole.T}])
    assert bytes_of(thing) == 24 + 48
    for array in (thing[0].values, thing[1]["b"], whole):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 1
    assert replace(thing[0], name="b").values is thing[0].values
