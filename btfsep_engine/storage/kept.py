# SPDX-License-Identifier: GPL-3.0-or-later
"""What this process has made and may need again: views, rays, basis images, networks of light, opened materials.

A thing is called by the content of all that it is made from (:func:`content`), never by whose it is, so that an answer
that stands on what is kept is, bit for bit, that of a process that has just begun. What is kept does not change any
more: its arrays are read-only. All together has at most so many bytes (`ENVIRONMENT`, or `Store.most_bytes`); what was
unused for longest goes.
"""

import dataclasses
import hashlib
import os
import weakref
from collections import OrderedDict

import numpy as np

ENVIRONMENT = "BTFSEP_KEEP_MB"
USUAL_MB = 1024  # as the resident engine: what recognition among 42 materials asks for again finds room
LARGEST = 0.5  # of all that may be kept: a larger thing is not, or it would be the only one
SMALL = 512  # bytes that Python takes for a thing, about


class Store:
    """Things by key, of a bounded size; what was unused for longest gives way.

    Attributes
    ----------
    most_bytes : int
    made, recalled : how many things were made, and how many were there already
    """

    def __init__(self, most_bytes: int):
        self.most_bytes, self.made, self.recalled = most_bytes, 0, 0
        self._things: OrderedDict = OrderedDict()  # key -> (thing, bytes)

    @property
    def bytes(self) -> int:
        """Of all that is kept, counted anew: a run that is stopped anywhere leaves no wrong sum."""
        return sum(size for _, size in list(self._things.values()))

    def get(self, key: tuple, make, *, size=None):
        """The thing called ``key``; ``make()``, kept from now on, where there is none. ``size`` (bytes) : of it."""
        found = self._things.pop(key, None)
        if found is not None:
            self._things[key] = found
            self.recalled += 1
            return found[0]
        thing = make()
        _freeze(thing)
        found = thing, SMALL + (bytes_of(thing) if size is None else size)
        self.made += 1
        if found[1] <= LARGEST * self.most_bytes:
            self._things[key] = found
            self._make_room()
        return thing

    def _make_room(self) -> None:
        over = self.bytes - self.most_bytes
        while over > 0 and self._things:
            _, (_, size) = self._things.popitem(last=False)
            over -= size

    def forget(self) -> None:
        """Keeps nothing of what it has."""
        self._things.clear()


def _usual_bytes() -> int:
    try:
        return max(int(float(os.environ.get(ENVIRONMENT, USUAL_MB)) * 2**20), 0)
    except (ValueError, OverflowError):
        return USUAL_MB << 20


STORE = Store(_usual_bytes())
"""This process's."""


def recalled(kind: str, parts, make, *, size=None):
    """``make()``, or what it gave when it was last asked with the same ``kind`` and ``parts`` (see :func:`content`).

    Where a part has no content that can be told, it is made each time. ``size`` in bytes; None: that of its arrays.
    """
    try:
        key = kind, content(parts)
    except TypeError:
        return make()
    return STORE.get(key, make, size=size)


_known: dict = {}  # id -> (weak reference, digest), of what does not change


def content(part) -> str:
    """A digest: of texts, numbers, bytes, None, arrays, frozen dataclasses, and lists and tuples of these.

    That of a read-only array and of a frozen dataclass is found once.

    Raises TypeError of anything else.
    """
    known = _known.get(id(part))
    if known is not None and known[0]() is part:
        return known[1]
    h = hashlib.sha256()
    if isinstance(part, np.ndarray):
        h.update(f"array {part.dtype.str} {part.shape};".encode())
        if part.dtype.hasobject:
            raise TypeError("no digest of an array of objects")
        h.update(np.ascontiguousarray(part).data.cast("B") if part.size else b"")
        lasting = _owned(part)
    elif isinstance(part, list | tuple):
        h.update(f"list {len(part)};".encode() + "".join(content(p) for p in part).encode())
        lasting = False
    elif isinstance(part, bytes):
        h.update(b"bytes;")
        h.update(part)
        lasting = False
    elif part is None or isinstance(part, str | int | float | np.number):
        h.update(f"{type(part).__name__} {part!r};".encode())
        lasting = False
    elif dataclasses.is_dataclass(part) and part.__dataclass_params__.frozen:
        names = [f.name for f in dataclasses.fields(part)]
        h.update(f"{type(part).__qualname__} {names};".encode())
        h.update("".join(content(getattr(part, name)) for name in names).encode())
        lasting = True
    else:
        raise TypeError(f"no digest of a {type(part).__name__}")
    found = h.hexdigest()
    if lasting:
        number = id(part)
        _known[number] = weakref.ref(part, lambda _: _known.pop(number, None)), found
    return found


def _owned(array: np.ndarray) -> bool:
    """Whether nobody can change an array: it is read-only, and so is all that it is a view of."""
    while isinstance(array, np.ndarray):
        if array.flags.writeable:
            return False
        array = array.base
    return array is None


def bytes_of(thing) -> int:
    """Of the arrays in a thing, its attributes and items."""
    return sum(a.nbytes for a in _arrays(thing, {}))


def _freeze(thing) -> None:
    for array in _arrays(thing, {}):
        while isinstance(array, np.ndarray):  # through a view, what is under it could be changed
            array.flags.writeable = False
            array = array.base


def _arrays(thing, seen: dict):
    """Every array in a thing, once. ``seen`` : what was met, by its number; it is held, or another would get that."""
    if id(thing) in seen:
        return
    if isinstance(thing, np.ndarray):
        seen[id(thing)] = thing
        yield thing
        return
    if isinstance(thing, list | tuple):
        inside = thing
    elif isinstance(thing, dict):
        inside = thing.values()
    elif hasattr(thing, "__dict__") and not isinstance(thing, type):
        inside = vars(thing).values()
    else:
        return
    seen[id(thing)] = thing
    for item in inside:
        yield from _arrays(item, seen)
