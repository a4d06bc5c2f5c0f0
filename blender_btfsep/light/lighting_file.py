# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads ``lighting.json`` in plain Python. The file may come from anywhere, so everything is checked."""

import json
import math
from pathlib import Path

from ..basics.errors import InputError
from ..basics.harmonics import term_count

FORMAT, VERSION = "btfsep-lighting", 1
MAX_ORDER = 64
MAX_BYTES = 8 << 20
MOST_LAMPS = 64
LARGEST = 3e38  # Blender's numbers are single precision: more would be infinite
ROUNDING = 1e-9  # of a unit vector's length
_REMEDY = "export the lighting again with BTFsep"


def read(path) -> dict:
    """The lighting in the file ``path``, validated.

    Returns
    -------
    dict with "order" (int), "coefficients" ((order + 1)^2 rows of 3 floats, linear Rec.709 radiance),
    "stddev" (same shape, or None), "determined" (list of bool, or None), "exposure_ev" (float),
    "suns" (None, or a dict of the key lights, "lamps", each a dict with "direction" (3 floats, unit), "irradiance"
    (3 floats >= 0) and "size_degrees", and "near" (its "distance" from "centre") of one nearby, and of "sky", the
    coefficients without them)

    Raises InputError.
    """
    path = Path(path)
    name = path.name
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(name, "the file is larger than any lighting", _REMEDY)
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(name, error, "choose a lighting.json that can be read") from None
    except (ValueError, RecursionError) as error:
        raise InputError(name, f"not JSON ({error})", _REMEDY) from None
    return validate(data, name)


def validate(data, name: str = "the lighting") -> dict:
    """``data`` as :func:`read` returns it. ``name`` stands in the error. Raises InputError."""
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise InputError(name, "this is not a BTFsep lighting", "choose the lighting.json that an estimate wrote")
    if data.get("version") != VERSION:
        raise InputError(name, f"version {data.get('version')!r} of the format", "update the BTFsep add-on")
    if data.get("basis") != "real-sh":
        raise InputError(name, f"the basis is {data.get('basis')!r}, not 'real-sh'", _REMEDY)
    if data.get("frame", "blender-z-up") != "blender-z-up":
        raise InputError(name, f"the frame is {data.get('frame')!r}, not 'blender-z-up'", _REMEDY)
    order = data.get("order")
    if isinstance(order, bool) or not isinstance(order, int) or not 0 <= order <= MAX_ORDER:
        raise InputError(name, f"the order is {order!r}, not a whole number from 0 to {MAX_ORDER}", _REMEDY)
    coefficients = _rows(data.get("coefficients"), order, name, "coefficients")
    stddev = data.get("stddev")
    if stddev is not None:
        stddev = _rows(stddev, order, name, "stddev")
    determined = data.get("determined")
    if determined is not None:
        if not isinstance(determined, list) or len(determined) != term_count(order):
            raise InputError(name, "'determined' does not have one entry a coefficient", _REMEDY)
        determined = [bool(value) for value in determined]
    exposure = data.get("exposure_ev", 0.0)
    if not _is_number(exposure):
        raise InputError(name, f"'exposure_ev' is {exposure!r}, not a number", _REMEDY)
    return {
        "order": order,
        "coefficients": coefficients,
        "stddev": stddev,
        "determined": determined,
        "exposure_ev": float(exposure),
        "suns": _suns(data, order, name),
    }


def as_data(lighting: dict) -> dict:
    """What :func:`validate` takes and makes ``lighting`` of, as plain JSON."""
    plain = {name: value for name, value in lighting.items() if name != "map"}  # of `light_files`, no JSON
    return {"format": FORMAT, "version": VERSION, "basis": "real-sh", "frame": "blender-z-up", **plain}


def _suns(data: dict, order: int, name: str) -> dict | None:
    """The key lights: of "suns" where it is there, else of "sun" (files from when there was one at most)."""
    found = None
    if data.get("sun") is not None:
        sun = _lamp(data["sun"], "sun", name)
        found = {"lamps": [sun], "sky": _rows(data["sun"].get("sky"), order, name, "sky")}
    if data.get("suns") is not None:
        suns = data["suns"]
        if not isinstance(suns, dict):
            raise InputError(name, "'suns' is no object", _REMEDY)
        lamps = suns.get("lamps")
        if not isinstance(lamps, list) or not 0 < len(lamps) <= MOST_LAMPS:
            raise InputError(name, f"'lamps' of 'suns' is no list of 1 to {MOST_LAMPS}", _REMEDY)
        lamps = [_lamp(lamp, f"lamps[{i}]", name) for i, lamp in enumerate(lamps)]
        found = {"lamps": lamps, "sky": _rows(suns.get("sky"), order, name, "sky")}
    return found


def _lamp(lamp, key: str, name: str) -> dict:
    if not isinstance(lamp, dict):
        raise InputError(name, f"'{key}' is no object", _REMEDY)
    direction, irradiance, size = lamp.get("direction"), lamp.get("irradiance"), lamp.get("size_degrees", 0.0)
    for part, row in (("direction", direction), ("irradiance", irradiance)):
        if not _is_row(row):
            raise InputError(name, f"'{part}' of '{key}' is not three finite numbers", _REMEDY)
    length = math.hypot(*direction)
    if not 0.99 < length < 1.01:
        raise InputError(name, f"'direction' of '{key}' is no unit vector", _REMEDY)
    if min(irradiance) < 0:
        raise InputError(name, f"'irradiance' of '{key}' is negative", _REMEDY)
    if not _is_number(size) or not 0 <= size <= 180:
        raise InputError(name, f"'size_degrees' of '{key}' is {size!r}, not a number from 0 to 180", _REMEDY)
    near = _near(lamp["near"], key, name) if lamp.get("near") is not None else None
    return {
        # one that is a unit vector but for rounding stays as it is, or what is written and read again would be another
        "direction": [float(value) if abs(length - 1) < ROUNDING else value / length for value in direction],
        "irradiance": [float(value) for value in irradiance],
        "size_degrees": float(size),
        **({"near": near} if near else {}),
    }


def _near(near, key: str, name: str) -> dict:
    """How near a lamp stands: "distance" (> 0) from "centre" in its direction."""
    if not isinstance(near, dict) or not _is_row(near.get("centre")):
        raise InputError(name, f"'near' of '{key}' has no 'centre' of three finite numbers", _REMEDY)
    distance = near.get("distance")
    if not _is_number(distance) or not distance > 0:
        raise InputError(name, f"'distance' of 'near' of '{key}' is {distance!r}, not a positive number", _REMEDY)
    return {"centre": [float(value) for value in near["centre"]], "distance": float(distance)}


def _is_number(value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST


def _is_row(row) -> bool:
    return isinstance(row, list) and len(row) == 3 and all(_is_number(value) for value in row)


def _rows(rows, order: int, name: str, key: str) -> list:
    wanted = term_count(order)
    if not isinstance(rows, list) or len(rows) != wanted:
        got = f"{len(rows)} rows" if isinstance(rows, list) else "no list"
        raise InputError(name, f"'{key}' has {got}, order {order} needs {wanted}", _REMEDY)
    for index, row in enumerate(rows):
        if not _is_row(row):
            raise InputError(name, f"row {index} of '{key}' is not three finite numbers", _REMEDY)
    return [[float(value) for value in row] for row in rows]
