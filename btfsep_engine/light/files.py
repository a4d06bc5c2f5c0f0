# SPDX-License-Identifier: GPL-3.0-or-later
"""``lighting.json`` and ``lighting.exr``: the estimated light as files (``docs/formats.md``)."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from btfsep_engine import atomic, images, sh
from btfsep_engine.conventions import pixel_directions
from btfsep_engine.errors import InputError
from btfsep_engine.job.schema import Strict, parse
from btfsep_engine.light.lightings import EnvironmentMaps, SHLighting
from btfsep_engine.light.maps import read_map
from btfsep_engine.light.positivity import positive_radiance, positive_share
from btfsep_engine.light.sun import Sun

MAX_ORDER = 64
MAP_SIZE = 256, 512  # of lighting.exr, height and width
SKY_EXACT = 1e-4  # of the first coefficient: how exactly sky and sun add up to the coefficients
Rgb = Annotated[list[float], Field(min_length=3, max_length=3)]


@dataclass(frozen=True)
class Lighting:
    """A light in spherical harmonics.

    Attributes
    ----------
    order : L
    coefficients : ((L + 1)^2, 3) float64, radiance, linear Rec.709, in the photo's own scale
    stddev : the same shape, standard deviations, >= 0
    determined : ((L + 1)^2,) bool, whether the photo determines the row
    exposure_ev : the exposure that had been applied to the photo, in stops; carried along, not applied
    sun : the key light that is part of the coefficients, or None where none stands out
    """

    order: int
    coefficients: np.ndarray
    stddev: np.ndarray
    determined: np.ndarray
    exposure_ev: float = 0.0
    sun: Sun | None = None

    def __post_init__(self):
        terms = sh.term_count(self.order)
        for name, kind, shape in (
            ("coefficients", np.float64, (terms, 3)),
            ("stddev", np.float64, (terms, 3)),
            ("determined", bool, (terms,)),
        ):
            value = np.asarray(getattr(self, name), kind)
            if value.shape != shape:
                raise ValueError(f"{name} of order {self.order} has the shape {value.shape}, not {shape}")
            object.__setattr__(self, name, value)

    @property
    def sky(self) -> np.ndarray:
        """(terms, 3), the coefficients without the sun."""
        return self.coefficients if self.sun is None else self.coefficients - self.sun.coefficients(self.order)


def exactly(coefficients, *, exposure_ev: float = 0.0) -> Lighting:
    """A Lighting of known ``coefficients : ((L + 1)^2, 3)``: no uncertainty, all determined."""
    x = np.asarray(coefficients, np.float64)
    return Lighting(sh.order_of(len(x)), x, np.zeros_like(x), np.ones(len(x), bool), exposure_ev)


NotNegative = Annotated[float, Field(ge=0)]
Degrees = Annotated[float, Field(ge=0, le=180)]


class SunSchema(Strict):
    direction: Annotated[list[float], Field(min_length=3, max_length=3)]
    irradiance: Annotated[list[NotNegative], Field(min_length=3, max_length=3)]
    stddev: Annotated[list[NotNegative], Field(min_length=3, max_length=3)]
    size_degrees: Degrees = 0.0
    widest_degrees: Degrees = 0.0
    evidence: float = 0.0
    sky: list[Rgb]


class LightingSchema(Strict):
    format: Literal["btfsep-lighting"]
    version: Literal[1]
    basis: Literal["real-sh"]
    order: Annotated[int, Field(ge=0, le=MAX_ORDER)]
    coefficients: list[Rgb]
    stddev: list[Rgb] | None = None
    determined: list[bool] | None = None
    frame: Literal["blender-z-up"]
    exposure_ev: Annotated[float, Field(ge=-100, le=100)] = 0.0
    sun: SunSchema | None = None


def read_lighting(path) -> Lighting:
    """Reads a ``lighting.json``. Without ``stddev`` it counts as exact, without ``determined`` as determined.

    Raises
    ------
    InputError
        Missing, no lighting of BTFsep, or wrong in itself, in words.
    """
    path = Path(path)
    schema = parse(LightingSchema, path.name, _read_bytes(path), kind="a BTFsep lighting")
    terms = sh.term_count(schema.order)
    for key in ("coefficients", "stddev", "determined"):
        rows = getattr(schema, key)
        if rows is not None and len(rows) != terms:
            got = f"it has {len(rows)} rows, and order {schema.order} has {terms}"
            raise InputError(f"{path.name}: {key}", got, "write (order + 1)^2 rows")
    if schema.stddev is not None and min(min(row) for row in schema.stddev) < 0:
        raise InputError(f"{path.name}: stddev", "a standard deviation is negative", "write the positive root")
    sun = None if schema.sun is None else _sun(path.name, schema)
    return Lighting(
        schema.order,
        np.array(schema.coefficients),
        np.zeros((terms, 3)) if schema.stddev is None else np.array(schema.stddev),
        np.ones(terms, bool) if schema.determined is None else np.array(schema.determined),
        schema.exposure_ev,
        sun,
    )


def _sun(name: str, schema: LightingSchema) -> Sun:
    """The sun of a file called ``name``, checked. Raises InputError."""
    told = schema.sun
    if not 0.99 < np.linalg.norm(told.direction) < 1.01:
        raise InputError(f"{name}: sun.direction", f"its length is not 1: {told.direction}", "write a unit vector")
    if len(told.sky) != len(schema.coefficients):
        got = f"it has {len(told.sky)} rows, and the coefficients have {len(schema.coefficients)}"
        raise InputError(f"{name}: sun.sky", got, "write the coefficients without the sun")
    sun = Sun(**told.model_dump(exclude={"sky"}))
    total = np.array(told.sky) + sun.coefficients(schema.order)
    if np.abs(total - schema.coefficients).max() > SKY_EXACT * np.abs(schema.coefficients).max():
        got = "sky and sun do not add up to the coefficients"
        raise InputError(f"{name}: sun", got, "change all three of them together, or leave the sun out")
    return sun


def write_lighting(path, lighting: Lighting) -> None:
    """Writes a ``lighting.json``, one coefficient a line, whole or not at all.

    Raises
    ------
    ValueError
        Something in it is not finite (a bug: nothing that is not finite is ever stored).
    """
    if not (np.isfinite(lighting.coefficients).all() and np.isfinite(lighting.stddev).all()):
        raise ValueError("a lighting that is not finite")
    fields = {
        "format": "btfsep-lighting",
        "version": 1,
        "basis": "real-sh",
        "order": int(lighting.order),
        "coefficients": lighting.coefficients.tolist(),
        "stddev": lighting.stddev.tolist(),
        "determined": lighting.determined.tolist(),
        "frame": "blender-z-up",
        "exposure_ev": float(lighting.exposure_ev),
    }
    if lighting.sun is not None:
        if not np.isfinite(lighting.sun.irradiance).all():
            raise ValueError("a sun that is not finite")
        fields["sun"] = {**sun_record(lighting.sun), "sky": lighting.sky.tolist()}
    lines = []
    for key, value in fields.items():
        text = json.dumps(value, allow_nan=False)
        if isinstance(value, list):
            text = "[\n  " + ",\n  ".join(json.dumps(row, allow_nan=False) for row in value) + "\n ]"
        lines.append(f" {json.dumps(key)}: {text}")
    atomic.write_text(path, "{\n" + ",\n".join(lines) + "\n}\n")


def sun_record(sun: Sun) -> dict:
    """The sun for JSON."""
    return {
        "direction": sun.direction.tolist(),
        "irradiance": sun.irradiance.tolist(),
        "stddev": sun.stddev.tolist(),
        "size_degrees": float(sun.size_degrees),
        "widest_degrees": float(sun.widest_degrees),
        "evidence": float(sun.evidence),
    }


def lighting_map(lighting: Lighting, height: int, width: int) -> np.ndarray:
    """The lighting as an equirectangular map (height, width, 3), nowhere negative (`positivity.positive_radiance`).

    A sun is a disc of its irradiance, so that its shadows are sharp when the map lights a scene.
    """
    image = positive_radiance(lighting.sky, pixel_directions(height, width))
    return image if lighting.sun is None else image + lighting.sun.to_map(height, width)


def seen_lighting(lighting: Lighting):
    """All of the light, and the light without its sun, as surfaces are to see it: nowhere negative.

    Returns
    -------
    two Lightings of one light; a series that is nowhere negative stays one, so that it is exact
    """
    if positive_share(lighting.sky)[0] == 0:
        return SHLighting(lighting.coefficients), SHLighting(lighting.sky)
    without = replace(lighting, sun=None, coefficients=lighting.sky)
    whole, sky = (EnvironmentMaps(lighting_map(each, 128, 256)[None], ("light",)) for each in (lighting, without))
    return whole, sky


def write_lighting_exr(path, lighting: Lighting, *, height: int = MAP_SIZE[0], width: int = MAP_SIZE[1]) -> None:
    """Writes `lighting_map`, 32-bit float EXR."""
    images.write_exr(path, lighting_map(lighting, height, width))


def read_any_lighting(path, order: int = 9) -> Lighting:
    """Reads a ``lighting.json`` (at its own order), or projects an environment map (EXR, HDR, …) to ``order``."""
    path = Path(path)
    if path.suffix.lower() == ".json":
        return read_lighting(path)
    return exactly(sh.project_map(read_map(path), order))


def read_any_map(path) -> np.ndarray:
    """Reads an environment map (EXR, HDR, …) whole, or a ``lighting.json`` as the map of its ``lighting.exr``."""
    path = Path(path)
    return lighting_map(read_lighting(path), *MAP_SIZE) if path.suffix.lower() == ".json" else read_map(path)


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(str(path), "there is no such file", "check the name") from None
    except OSError as error:
        raise InputError(str(path), f"it cannot be read: {error.strerror or error}", "check the file") from error
