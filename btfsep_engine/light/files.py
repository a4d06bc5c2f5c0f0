# SPDX-License-Identifier: GPL-3.0-or-later
"""``lighting.json`` and ``lighting.exr``: the estimated light as files (``docs/formats.md``)."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from btfsep_engine import sh
from btfsep_engine.conventions import pixel_directions
from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.job.schema import Strict, parse
from btfsep_engine.light.lightings import EnvironmentMaps, SHLighting
from btfsep_engine.light.maps import read_map
from btfsep_engine.light.positivity import positive_radiance, positive_share
from btfsep_engine.light.sun import Near, Sun
from btfsep_engine.storage import atomic

MAX_ORDER = 64
MAP_SIZE = 256, 512  # of lighting.exr, height and width
SKY_EXACT = 1e-4  # of the largest coefficient: how exactly sky and suns add up to the coefficients
MOST_LAMPS = 64  # of a file
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
    suns : the key lights that are part of the coefficients, put in order: the brightest first; each knows its share
    interval : (2, terms, 3), the ends of the range that holds 95 % of what each coefficient may be, or None
    pattern : (4, terms, 3), likewise where only the light's pattern counts, whatever its scale, and of 68 %: the ends
        of both ranges, ascending, or None
    """

    order: int
    coefficients: np.ndarray
    stddev: np.ndarray
    determined: np.ndarray
    exposure_ev: float = 0.0
    suns: tuple[Sun, ...] = ()
    interval: np.ndarray | None = None
    pattern: np.ndarray | None = None

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
        if self.interval is not None:
            interval = np.asarray(self.interval, np.float64)
            if interval.shape != (2, terms, 3) or (interval[0] > interval[1]).any():
                raise ValueError(f"interval of the shape {interval.shape}, or its ends the wrong way round")
            object.__setattr__(self, "interval", interval)
        if self.pattern is not None:
            pattern = np.asarray(self.pattern, np.float64)
            if pattern.shape != (4, terms, 3) or (np.diff(pattern, axis=0) < 0).any():
                raise ValueError(f"pattern of the shape {pattern.shape}, or its ends in another order")
            object.__setattr__(self, "pattern", pattern)
        suns = sorted(self.suns, key=lambda sun: -sun.irradiance.mean())
        told = [s if s.share is not None else replace(s, share=s.share_of(self.coefficients)) for s in suns]
        object.__setattr__(self, "suns", tuple(told))

    @property
    def sky(self) -> np.ndarray:
        """(terms, 3), the coefficients without the suns."""
        return self.without(self.suns)

    def without(self, suns) -> np.ndarray:
        """(terms, 3), the coefficients without these of its suns."""
        return self.coefficients - sum(sun.coefficients(self.order) for sun in suns)


def exactly(coefficients) -> Lighting:
    """A Lighting of known ``coefficients : ((L + 1)^2, 3)``: no uncertainty, all determined."""
    x = np.asarray(coefficients, np.float64)
    return Lighting(sh.order_of(len(x)), x, np.zeros_like(x), np.ones(len(x), bool))


NotNegative = Annotated[float, Field(ge=0)]
Degrees = Annotated[float, Field(ge=0, le=180)]


class BeamSchema(Strict):
    direction: Annotated[list[float], Field(min_length=3, max_length=3)]
    irradiance: Annotated[list[NotNegative], Field(min_length=3, max_length=3)]
    stddev: Annotated[list[NotNegative], Field(min_length=3, max_length=3)]
    size_degrees: Degrees = 0.0


class SunSchema(BeamSchema):
    widest_degrees: Degrees = 0.0  # these two: of files written before there could be several; not looked at
    evidence: float = 0.0
    sky: list[Rgb]


Positive = Annotated[float, Field(gt=0)]


class NearSchema(Strict):
    centre: Annotated[list[float], Field(min_length=3, max_length=3)]
    distance: Positive
    distance_range: Annotated[list[Positive], Field(min_length=2, max_length=2)] | None = None


class LampSchema(BeamSchema):
    direction_stddev_degrees: Degrees = 0.0
    share: NotNegative | None = None
    share_stddev: NotNegative = 0.0
    near: NearSchema | None = None
    given: bool = False


class SunsSchema(Strict):
    lamps: Annotated[list[LampSchema], Field(min_length=1, max_length=MOST_LAMPS)]
    sky: list[Rgb]


class PatternSchema(Strict):
    low_95: list[Rgb]
    low_68: list[Rgb]
    high_68: list[Rgb]
    high_95: list[Rgb]


class LightingSchema(Strict):
    format: Literal["btfsep-lighting"]
    version: Literal[1]
    basis: Literal["real-sh"]
    order: Annotated[int, Field(ge=0, le=MAX_ORDER)]
    coefficients: list[Rgb]
    stddev: list[Rgb] | None = None
    determined: list[bool] | None = None
    low: list[Rgb] | None = None
    high: list[Rgb] | None = None
    pattern: PatternSchema | None = None
    frame: Literal["blender-z-up"]
    exposure_ev: Annotated[float, Field(ge=-100, le=100)] = 0.0
    sun: SunSchema | None = None
    suns: SunsSchema | None = None


def read_lighting(path) -> Lighting:
    """Reads a ``lighting.json``. Without ``stddev`` it counts as exact, without ``determined`` as determined.

    Raises InputError: missing, no lighting of BTFsep, or wrong in itself, in words.
    """
    path = Path(path)
    schema = parse(LightingSchema, path.name, atomic.read_bytes(path), kind="a BTFsep lighting")
    terms = sh.term_count(schema.order)
    for key in ("coefficients", "stddev", "determined", "low", "high"):
        rows = getattr(schema, key)
        if rows is not None and len(rows) != terms:
            got = f"it has {len(rows)} rows, and order {schema.order} has {terms}"
            raise InputError(f"{path.name}: {key}", got, "write (order + 1)^2 rows")
    if schema.stddev is not None and min(min(row) for row in schema.stddev) < 0:
        raise InputError(f"{path.name}: stddev", "a standard deviation is negative", "write the positive root")
    interval = None
    if schema.low is not None or schema.high is not None:
        if schema.low is None or schema.high is None or (np.array(schema.low) > np.array(schema.high)).any():
            raise InputError(f"{path.name}: low, high", "they are no ranges", "write both, low <= high, or neither")
        interval = np.array([schema.low, schema.high])
    return Lighting(
        schema.order,
        np.array(schema.coefficients),
        np.zeros((terms, 3)) if schema.stddev is None else np.array(schema.stddev),
        np.ones(terms, bool) if schema.determined is None else np.array(schema.determined),
        schema.exposure_ev,
        _suns(path.name, schema),
        interval,
        _pattern(path.name, schema),
    )


def _pattern(name: str, schema: LightingSchema) -> np.ndarray | None:
    """`Lighting.pattern` of a file called ``name``, checked. Raises InputError."""
    if schema.pattern is None:
        return None
    each = schema.pattern.model_dump().values()
    if {len(rows) for rows in each} != {len(schema.coefficients)}:
        raise InputError(f"{name}: pattern", "not as many rows as coefficients", "write as many, or leave it out")
    ends = np.array(list(each))
    if (np.diff(ends, axis=0) < 0).any():
        raise InputError(f"{name}: pattern", "its ranges are none", "write low_95 <= low_68 <= high_68 <= high_95")
    return ends


def _suns(name: str, schema: LightingSchema) -> tuple[Sun, ...]:
    """The key lights of a file called ``name``, checked: those of ``suns`` where it is there, else that of ``sun``.

    Raises InputError.
    """
    out = ()
    if schema.sun is not None:
        out = _checked(name, "sun", schema, {"sun": schema.sun})
    if schema.suns is not None:
        lamps = {f"suns.lamps[{i}]": lamp for i, lamp in enumerate(schema.suns.lamps)}
        out = _checked(name, "suns", schema, lamps)
    return out


def _checked(name: str, key: str, schema: LightingSchema, beams: dict[str, BeamSchema]) -> tuple[Sun, ...]:
    """The suns that ``beams`` tell of, by where each stands in the file; with the sky of ``key`` they are the light."""
    sky = getattr(schema, key).sky
    for where, beam in beams.items():
        if not 0.99 < np.linalg.norm(beam.direction) < 1.01:
            got = f"its length is not 1: {beam.direction}"
            raise InputError(f"{name}: {where}.direction", got, "write a unit vector")
    if len(sky) != len(schema.coefficients):
        got = f"it has {len(sky)} rows, and the coefficients have {len(schema.coefficients)}"
        raise InputError(f"{name}: {key}.sky", got, "write the coefficients without what stands beside it")
    suns = tuple(
        Sun(**beam.model_dump(exclude={"sky", "widest_degrees", "evidence", "near"}), near=_near(beam))
        for beam in beams.values()
    )
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers as large as they come; they do not add up then
        off = np.abs(np.array(sky) + sum(sun.coefficients(schema.order) for sun in suns) - schema.coefficients).max()
    if not off <= SKY_EXACT * np.abs(schema.coefficients).max():
        got = "sky and key lights do not add up to the coefficients"
        raise InputError(f"{name}: {key}", got, "change all of them together, or leave the key lights out")
    return suns


def _near(beam: BeamSchema) -> Near | None:
    near = getattr(beam, "near", None)
    return near and Near(near.centre, near.distance, *(near.distance_range or [near.distance] * 2))


def write_lighting(path, lighting: Lighting) -> None:
    """Writes a ``lighting.json``, one coefficient a line, whole or not at all.

    Raises ValueError: something in it is not finite (a bug: nothing that is not finite is ever stored).
    """
    arrays = (lighting.coefficients, lighting.stddev, lighting.interval, lighting.pattern)
    if not all(np.isfinite(each).all() for each in arrays if each is not None):
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
    if lighting.interval is not None:
        fields["low"], fields["high"] = lighting.interval.tolist()
    if lighting.pattern is not None:
        fields["pattern"] = dict(zip(PatternSchema.model_fields, lighting.pattern.tolist(), strict=True))
    if lighting.suns:
        if not all(np.isfinite(sun.irradiance).all() for sun in lighting.suns):
            raise ValueError("a sun that is not finite")
        first = lighting.suns[:1]  # who knows of one only takes the rest for sky
        fields["sun"] = {**beam_record(*first), "sky": lighting.without(first).tolist()}
        fields["suns"] = {"lamps": [sun_record(sun) for sun in lighting.suns], "sky": lighting.sky.tolist()}
    lines = []
    for key, value in fields.items():
        text = json.dumps(value, allow_nan=False)
        if isinstance(value, list):
            text = "[\n  " + ",\n  ".join(json.dumps(row, allow_nan=False) for row in value) + "\n ]"
        lines.append(f" {json.dumps(key)}: {text}")
    atomic.write_text(path, "{\n" + ",\n".join(lines) + "\n}\n")


def beam_record(sun: Sun) -> dict:
    """What lights of a sun, for JSON."""
    return {
        "direction": sun.direction.tolist(),
        "irradiance": sun.irradiance.tolist(),
        "stddev": sun.stddev.tolist(),
        "size_degrees": float(sun.size_degrees),
    }


def sun_record(sun: Sun) -> dict:
    """All of a sun, for JSON."""
    more = ("direction_stddev_degrees", "share", "share_stddev")
    out = {**beam_record(sun), **{key: float(getattr(sun, key)) for key in more}}
    if sun.given:
        out["given"] = True
    if sun.near is not None:
        centre, between = sun.near.centre.tolist(), [float(sun.near.low), float(sun.near.high)]
        out["near"] = {"centre": centre, "distance": float(sun.near.distance), "distance_range": between}
    return out


def lighting_map(lighting: Lighting, height: int, width: int, *, radiance=None) -> np.ndarray:
    """The lighting as an equirectangular map (height, width, 3), nowhere negative.

    A sun is a disc of its irradiance, so that its shadows are sharp when the map lights a scene.

    ``radiance`` : the sky's own, (…, 3), >= 0, of unit directions (…, 3), which knows more of it than a series does;
        without it the sky is what its coefficients stand for (`positivity.positive_radiance`)
    """
    directions = pixel_directions(height, width)
    if radiance is None:
        sky = positive_radiance(lighting.sky, directions)
    else:
        sky = np.asarray(radiance(directions), np.float64)
    return sky + sum(sun.to_map(height, width) for sun in lighting.suns)


def seen_lighting(lighting: Lighting):
    """All of the light, and the light without its suns, as surfaces are to see it: nowhere negative.

    Gives two Lightings of one light; a series that is nowhere negative stays one, so that it is exact.
    """
    if positive_share(lighting.sky)[0] == 0:
        return SHLighting(lighting.coefficients), SHLighting(lighting.sky)
    without = replace(lighting, suns=(), coefficients=lighting.sky)
    whole, sky = (EnvironmentMaps(lighting_map(each, 128, 256)[None], ("light",)) for each in (lighting, without))
    return whole, sky


def write_lighting_exr(
    path, lighting: Lighting, *, radiance=None, height: int = MAP_SIZE[0], width: int = MAP_SIZE[1]
) -> None:
    """Writes `lighting_map`, 32-bit float EXR; ``radiance`` is its.

    Compressed, it would take nine tenths of the place and ten times as long to write.
    """
    images.write_exr(path, lighting_map(lighting, height, width, radiance=radiance), compressed=False)


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
