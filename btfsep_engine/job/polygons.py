# SPDX-License-Identifier: GPL-3.0-or-later
"""What a mesh file holds, as numbers: the readers of PLY and OBJ. Nothing that a file points to is followed.

Both readers are vectorised: two million triangles take seconds. Own readers, because general ones drop polygons with
more than four corners, split or merge vertices at will, and look for materials and textures.
"""

import re
import warnings
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from btfsep_engine.errors import InputError

MAX_ROWS = 2**25  # vertices or faces of one mesh
_AGAIN = "export it again as PLY or OBJ"
_PLY_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}


@dataclass(frozen=True)
class Polygons:
    """Polygons as a file has them; the corners of all polygons stand one after the other.

    Attributes
    ----------
    vertices : (v, 3) float64
    sizes : (p,) int64, corners of each polygon
    corners : (sum of sizes,) int64, vertex of each corner; not checked yet
    normals, normal_corners : (n, 3) float64 and (corners,) int64 indices into it (-1: none), or None
    uv, uv_corners : (t, 2) float64 and (corners,) int64 indices into it (-1: none), or None
    """

    vertices: np.ndarray
    sizes: np.ndarray
    corners: np.ndarray
    normals: np.ndarray | None = None
    normal_corners: np.ndarray | None = None
    uv: np.ndarray | None = None
    uv_corners: np.ndarray | None = None


def read_ply(name: str, data: bytes) -> Polygons:
    """Reads a PLY: ascii, binary little- or big-endian; normals nx ny nz; uv per vertex or ``texcoord`` per face.

    Raises InputError: ``name`` is truncated, damaged, or has no vertices or no faces.
    """
    end = re.search(rb"end_header[ \t]*\r?\n", data[:65536])
    if end is None:
        raise InputError(name, "the header of the PLY has no end", _AGAIN)
    order, elements = _ply_header(name, data[: end.start()].decode("latin-1"))
    body = data[end.end() :]
    if order == "ascii":  # the same as binary where every number is a double
        body = _numbers(name, body).tobytes()
        order = "<"
        elements = [(e, n, [(p, "f8", c and "f8") for p, _, c in properties]) for e, n, properties in elements]
    at, tables = 0, {}
    for element, count, properties in elements:
        tables[element], at = _ply_element(name, body, at, order, count, properties)
    vertex, face = tables.get("vertex", {}), tables.get("face", {})
    if not {"x", "y", "z"} <= set(vertex):
        raise InputError(name, "the PLY has no vertices", _AGAIN)
    index = face.get("vertex_indices", face.get("vertex_index"))
    sizes, corners = index if isinstance(index, tuple) else (np.zeros(0, np.int64), np.zeros(0, np.int64))
    corners = _integers(name, corners)
    out = {"vertices": _columns(vertex, "x", "y", "z"), "sizes": sizes, "corners": corners}
    if {"nx", "ny", "nz"} <= set(vertex):
        out |= {"normals": _columns(vertex, "nx", "ny", "nz"), "normal_corners": corners}
    texcoord = face.get("texcoord")
    if isinstance(texcoord, tuple) and len(corners) and np.array_equal(texcoord[0], 2 * sizes):
        uv = np.asarray(texcoord[1], np.float64).reshape(-1, 2)
        out |= {"uv": uv, "uv_corners": np.arange(len(uv))}
    else:
        for u, v in (("s", "t"), ("u", "v"), ("texture_u", "texture_v")):
            if u in vertex and v in vertex:
                out |= {"uv": _columns(vertex, u, v), "uv_corners": corners}
                break
    return Polygons(**out)


def _columns(table: dict, *names: str) -> np.ndarray:
    return np.stack([np.asarray(table[n], np.float64) for n in names], -1)


def _integers(name: str, values) -> np.ndarray:
    values = np.asarray(values)
    if values.dtype.kind == "f" and not (np.isfinite(values).all() and (values == np.floor(values)).all()):
        raise InputError(name, "a vertex number of a face is not whole", _AGAIN)
    return np.clip(values, -(2**40), 2**40).astype(np.int64)


def _ply_header(name: str, text: str):
    """("ascii", "<" or ">") and the elements as (name, count, [(property, type, type of its length or None)])."""
    order, elements = None, []
    for line in text.splitlines():
        words = line.split()
        try:
            if words[:1] == ["format"]:
                order = {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}[words[1]]
            elif words[:1] == ["element"]:
                count = int(words[2])
                if not 0 <= count <= MAX_ROWS:
                    raise InputError(
                        name, f"it claims {count} of '{words[1]}'; the limit is {MAX_ROWS}", "simplify the mesh"
                    )
                elements.append((words[1], count, []))
            elif words[:2] == ["property", "list"]:
                elements[-1][2].append((words[4], _PLY_TYPES[words[3]], _PLY_TYPES[words[2]]))
            elif words[:1] == ["property"]:
                elements[-1][2].append((words[2], _PLY_TYPES[words[1]], None))
        except (IndexError, KeyError, ValueError):
            raise InputError(name, f"its header has the line '{line[:60]}'", _AGAIN) from None
    if order is None:
        raise InputError(name, "the header of the PLY names no format", _AGAIN)
    return order, elements


def _ply_element(name: str, body: bytes, at: int, order: str, count: int, properties):
    """The columns of one element, a list as (lengths, flat values), and where the next element starts."""
    truncated = InputError(name, "the PLY is truncated", _AGAIN)
    if count == 0 or not properties:
        return {}, at
    # as if every list had the length that it has in the first row: true of nearly all files
    fields, offset = [], at
    for i, (_, kind, length) in enumerate(properties):
        if length is None:
            fields.append((f"p{i}", order + kind))
        else:
            if offset + int(length[1]) > len(body):
                raise truncated
            first = float(np.frombuffer(body, order + length, 1, offset)[0])
            if not 0 <= first <= len(body) or first != int(first):
                raise InputError(name, "a face of the PLY has an absurd number of corners", _AGAIN)
            fields += [(f"n{i}", order + length), (f"p{i}", order + kind, (int(first),))]
            offset += int(length[1])
            kind = kind, int(first)
        offset += int(kind[1]) if length is None else int(kind[0][1]) * kind[1]
    row = np.dtype(fields)
    if at + row.itemsize * count <= len(body):
        rows = np.frombuffer(body, row, count, at)
        lists = [i for i, p in enumerate(properties) if p[2] is not None]
        if all((rows[f"n{i}"] == rows[f"p{i}"].shape[1]).all() for i in lists):
            table = {p: rows[f"p{i}"] for i, (p, _, _) in enumerate(properties)}
            for i in lists:
                table[properties[i][0]] = rows[f"n{i}"].astype(np.int64), rows[f"p{i}"].reshape(-1)
            return table, at + row.itemsize * count
    elif not any(length for _, _, length in properties):
        raise truncated
    return _ply_ragged(name, body, at, order, count, properties)


def _ply_ragged(name: str, body: bytes, at: int, order: str, count: int, properties):
    """As :func:`_ply_element`, row by row, for lists of different lengths; only the lists are kept."""
    lengths = {i: np.empty(count, np.int64) for i, p in enumerate(properties) if p[2] is not None}
    starts = {i: np.empty(count, np.int64) for i in lengths}
    reader = {i: np.dtype(order + properties[i][2]) for i in lengths}
    plan = [(i, int(kind[1]), length and int(length[1])) for i, (_, kind, length) in enumerate(properties)]
    for r in range(count):
        for i, size, length in plan:
            if length is None:
                at += size
                continue
            if length == 1 and reader[i].kind == "u":
                n = body[at] if at < len(body) else -1
            else:
                piece = body[at : at + length]
                n = int(np.nan_to_num(np.frombuffer(piece, reader[i])[0])) if len(piece) == length else -1
            at += length
            if n < 0 or at + n * size > len(body):
                raise InputError(name, "the PLY is truncated", _AGAIN)
            lengths[i][r], starts[i][r] = n, at
            at += n * size
    if at > len(body):
        raise InputError(name, "the PLY is truncated", _AGAIN)
    octets = np.frombuffer(body, np.uint8)
    table = {}
    for i, n in lengths.items():
        kind = np.dtype(order + properties[i][1])
        within = np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n)
        first = np.repeat(starts[i], n) + within * kind.itemsize
        table[properties[i][0]] = n, octets[first[:, None] + np.arange(kind.itemsize)].reshape(-1).view(kind)
    return table, at


def read_obj(name: str, data: bytes) -> Polygons:
    """Reads an OBJ: v, vt, vn and f lines of all objects and groups; the rest, materials included, is not looked at.

    Raises InputError: a line of ``name`` cannot be understood, or there are absurdly many.
    """
    data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b"\\\n", b" ")
    rows = _obj_rows(name, data)
    vertices = _table(name, rows[b"v"], 3)
    sizes = _tokens_per_line(rows[b"f"])
    corners = _corners(name, rows[b"f"], int(sizes.sum()))
    if corners is None or (corners < 0).any():
        corners = _corners_by_line(name, data)
    out = {"vertices": vertices, "sizes": sizes, "corners": corners[:, 0] - 1}
    for key, field, width, column in ((b"vn", "normals", 3, 2), (b"vt", "uv", 2, 1)):
        if rows[key] and corners.shape[1] > column and (corners[:, column] > 0).any():
            out |= {field: _table(name, rows[key], width), field.rstrip("s") + "_corners": corners[:, column] - 1}
    return Polygons(**out)


def _obj_rows(name: str, data: bytes) -> dict[bytes, bytes]:
    """The lines of each kind, v, vt, vn and f, as one text without the keys and comments, a line each."""
    if any(data.startswith(blank) or b"\n" + blank in data for blank in (b" ", b"\t")):
        data = re.sub(rb"(?m)^[ \t]+", b"", data)
    octets = np.frombuffer(data + b"\n \n", np.uint8)
    ends = np.flatnonzero(octets == 10)
    starts = np.concatenate([[0], ends[:-1] + 1])
    first, second, third = (octets[np.minimum(starts + i, len(octets) - 1)] for i in range(3))
    blank = [np.isin(letter, (32, 9)) for letter in (second, third)]
    is_v = first == ord("v")
    out = {}
    for key, chosen in (
        (b"v", is_v & blank[0]),
        (b"vt", is_v & (second == ord("t")) & blank[1]),
        (b"vn", is_v & (second == ord("n")) & blank[1]),
        (b"f", (first == ord("f")) & blank[0]),
    ):
        lines = np.flatnonzero(chosen)
        if len(lines) > MAX_ROWS:
            raise InputError(name, f"it has more than {MAX_ROWS} lines of a kind", "simplify the mesh")
        # runs of neighbouring lines are cut out whole
        breaks = np.flatnonzero(np.diff(lines) > 1)
        heads, tails = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(lines) - 1]])
        runs = zip(starts[lines[heads]], ends[lines[tails]] + 1, strict=True) if len(lines) else ()
        text = np.frombuffer(
            b"".join(data[i:j] if j <= len(data) else data[i:] + b"\n" for i, j in runs), np.uint8
        ).copy()
        at = np.concatenate([[0], np.cumsum(ends[lines] + 1 - starts[lines])[:-1]]) if len(lines) else lines
        for i in range(len(key)):
            text[at + i] = 32
        text = text.tobytes()
        out[key] = re.sub(rb"#[^\n]*", b"", text) if b"#" in text else text
    return out


def _tokens_per_line(text: bytes) -> np.ndarray:
    """(lines,) int64, words in each line of a text that ends with a newline."""
    octets = np.frombuffer(b"\n" + text, np.uint8)
    blank = octets <= 32
    begins = np.flatnonzero(~blank[1:] & blank[:-1])
    return np.diff(np.searchsorted(begins, np.flatnonzero(octets[1:] == 10)), prepend=0)


def _table(name: str, text: bytes, width: int) -> np.ndarray:
    """The first ``width`` numbers of each line, (lines, width) float64; missing ones (vt with one number) are 0."""
    if not text:
        return np.zeros((0, width))
    sizes = _tokens_per_line(text)
    columns = int(sizes[0])
    if columns < width or (sizes != columns).any():
        words = [(line.split() + [b"0"] * width)[:width] for line in text.splitlines()]
        text, columns = b"\n".join(b" ".join(w) for w in words), width
    values = _numbers(name, text)
    if len(values) != columns * len(sizes):
        raise InputError(name, "there is something else where numbers should be", _AGAIN)
    return values.reshape(len(sizes), columns)[:, :width]


def _corners(name: str, text: bytes, count: int):
    """(count, 3) int64: v, vt, vn of each corner, 0 where absent; None where the lines are not all of one form."""
    if not count:
        return np.zeros((0, 3), np.int64)
    text = text.replace(b"//", b"/0/")
    slashes = text.split(None, 1)[0].count(b"/")
    if slashes > 2 or text.count(b"/") != slashes * count:
        return None
    values = _numbers(name, text.replace(b"/", b" "))
    if len(values) != count * (slashes + 1):
        return None
    corners = np.zeros((count, 3), np.int64)
    corners[:, : slashes + 1] = _integers(name, values).reshape(count, slashes + 1)
    return corners


def _corners_by_line(name: str, data: bytes) -> np.ndarray:
    """As :func:`_corners`, one line at a time: mixed forms, and numbers that count back from the line."""
    seen, corners = {b"v": 0, b"vt": 0, b"vn": 0}, []
    for line in data.splitlines():
        words = line.split(b"#")[0].split()
        if not words:
            continue
        if words[0] in seen:
            seen[words[0]] += 1
        elif words[0] == b"f":
            for word in words[1:]:
                try:
                    numbers = [int(part) if part else 0 for part in word.split(b"/")]
                except ValueError:
                    numbers = []
                if not 1 <= len(numbers) <= 3:
                    raise InputError(name, f"a face has the corner '{word[:40].decode('latin-1')}'", _AGAIN)
                numbers += [0] * (3 - len(numbers))
                back = zip(numbers, seen.values(), strict=True)
                corners.append([min(n if n >= 0 else have + n + 1, 2**40) for n, have in back])
    return np.array(corners, np.int64).reshape(-1, 3)


def _numbers(name: str, text: bytes) -> np.ndarray:
    """All numbers of a text, (n,) float64."""
    if not text.strip():
        return np.zeros(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(text, np.float64, sep=" ")
        except (DeprecationWarning, ValueError):
            raise InputError(name, "there is something else where numbers should be", _AGAIN) from None


def triangulate(polygons: Polygons):
    """Triangles of the polygons, as positions in the list of corners: (t, 3) int64.

    Fans; of a quadrilateral the diagonal that keeps both halves facing the same way, so that concave ones are right.
    """
    sizes = np.maximum(polygons.sizes, 0)
    first = np.cumsum(sizes) - sizes
    count = np.maximum(sizes - 2, 0)
    which = np.repeat(np.arange(len(sizes)), count)
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    start = first[which]
    triangles = np.stack([start, start + step + 1, start + step + 2], -1)
    quads = np.flatnonzero(sizes == 4)
    if len(quads):
        at = (np.cumsum(count) - count)[quads]
        p = polygons.vertices[polygons.corners[first[quads][:, None] + np.arange(4)]]
        halves = [np.cross(p[:, b] - p[:, 0], p[:, c] - p[:, 0]) for b, c in pairwise((1, 2, 3))]
        turned = np.flatnonzero((halves[0] * halves[1]).sum(-1) < 0)
        corner = first[quads[turned]]
        triangles[at[turned]] = corner[:, None] + np.array([0, 1, 3])
        triangles[at[turned] + 1] = corner[:, None] + np.array([1, 2, 3])
    return triangles
