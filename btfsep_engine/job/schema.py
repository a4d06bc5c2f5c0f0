# SPDX-License-Identifier: GPL-3.0-or-later
"""The schema of ``job.json``, and validation errors in words.

``parse`` is also what reads other JSON files (``lighting.json``): one way to say what is wrong.
"""

import difflib
import json
from typing import Annotated, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError, create_model

from btfsep_engine.errors import InputError
from btfsep_engine.imaging.blender_views import VIEWS
from btfsep_engine.imaging.colour_profile import PRIMARIES

MAX_OBJECTS = 1000
MAX_KNOWN_LAMPS = 8
KNOWN_TO = 1.0  # degrees: how well the direction of a known lamp is known where nobody says it
MAX_BYTES = 2**24
MAX_LEFT_OUT = 16

Row = Annotated[list[float], Field(min_length=4, max_length=4)]
Matrix = Annotated[list[Row], Field(min_length=4, max_length=4)]
Name = Annotated[str, Field(min_length=1, max_length=200)]
RelativePath = Annotated[str, Field(min_length=1, max_length=1000)]
Length = Annotated[float, Field(gt=0, lt=1e9)]
Focal = Annotated[float, Field(gt=1e-6, lt=1e9)]
Pixels = Annotated[int, Field(gt=0, le=20000)]
Position = Annotated[float, Field(gt=-1e9, lt=1e9)]
Bend = Annotated[float, Field(gt=-1e9, lt=1e9)]
Share = Annotated[float, Field(ge=0, le=1)]
Colour = Annotated[list[Share], Field(min_length=3, max_length=3)]
Power = Annotated[list[Annotated[float, Field(ge=0, lt=1e9)]], Field(min_length=3, max_length=3)]
KINDS = {list: "a colour", str: "an image"}  # of what may be either: they stand in pydantic's places, no user sees them
ColourOrImage = Annotated[
    Annotated[Colour, Tag(KINDS[list])] | Annotated[RelativePath, Tag(KINDS[str])],
    Discriminator(lambda value: KINDS.get(type(value))),
]


class Strict(BaseModel):
    """No unknown keys, no conversions, no NaN, not changeable."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True, defer_build=True)


class CameraSchema(Strict):
    """``fx`` and ``fy`` of an orthographic camera are pixels in a world unit."""

    width: Pixels
    height: Pixels
    fx: Focal
    fy: Focal
    cx: Position
    cy: Position
    to_world: Matrix
    projection: Literal["perspective", "orthographic"] = "perspective"
    k1: Bend = 0.0
    k2: Bend = 0.0
    p1: Bend = 0.0
    p2: Bend = 0.0


class SurfaceSchema(Strict):
    """Values of Blender's Principled BSDF, colours linear Rec.709.

    ``finish`` : an image of roughness, metallic and specular, in their place, beside one of base colours.
    ``sheen`` : weight times tint. ``left_out`` : what the numbers do not say of the material, each in a word or two.
    """

    base_color: ColourOrImage = [0.8, 0.8, 0.8]
    finish: RelativePath | None = None
    roughness: Share = 0.5
    metallic: Share = 0.0
    specular: Share = 0.5
    emission: Power = [0.0, 0.0, 0.0]
    coat: Share = 0.0
    coat_roughness: Share = 0.03
    sheen: Colour = [0.0, 0.0, 0.0]
    sheen_roughness: Share = 0.5
    left_out: Annotated[list[Name], Field(max_length=MAX_LEFT_OUT)] = []


class ObjectSchema(Strict):
    """``mesh`` may be null only where the job has ``depth``: the object is then the surface of the depth."""

    name: Name
    mesh: RelativePath | None
    to_world: Matrix | None = None
    mask: RelativePath | None = None
    material: Name | None = None
    uv: Literal["xatlas", "mesh"] = "xatlas"
    surface: SurfaceSchema | None = None


class OccluderSchema(Strict):
    """``name`` : what people call it; null: its number in the list."""

    mesh: RelativePath
    to_world: Matrix | None = None
    surface: SurfaceSchema | None = None
    evidence: bool = False
    name: Name | None = None


class KnownLampSchema(Strict):
    """``direction`` : to the lamp, which is far away, in world axes; of any length."""

    direction: Annotated[list[Position], Field(min_length=3, max_length=3)]
    direction_stddev_degrees: Annotated[float, Field(ge=0, le=45)] = KNOWN_TO


class JobSchema(Strict):
    format: Literal["btfsep-job"]
    version: Literal[1]
    image: RelativePath
    image_colorspace: Literal["auto", "srgb", "camera", "phone", "linear", "blender", *VIEWS, "unknown"] = "auto"
    image_primaries: Literal["auto", *PRIMARIES] = "auto"
    exposure_ev: Annotated[float, Field(ge=-100, le=100)] = 0.0
    camera: CameraSchema
    objects: Annotated[list[ObjectSchema], Field(max_length=MAX_OBJECTS)] = []
    occluders: Annotated[list[OccluderSchema], Field(max_length=MAX_OBJECTS)] = []
    depth: RelativePath | None = None
    depth_shift: Annotated[list[Position], Field(min_length=2, max_length=2)] = [0.0, 0.0]
    metres_per_unit: Length = 1.0
    known_lamps: Annotated[list[KnownLampSchema], Field(max_length=MAX_KNOWN_LAMPS)] = []


CameraChangeSchema = create_model(
    "CameraChangeSchema",
    __base__=Strict,
    __doc__="What of a `CameraSchema` is another in a frame.",
    **{name: (kind | None, None) for name, kind in CameraSchema.__annotations__.items()},
)


class PlaceSchema(Strict):
    to_world: Matrix


class PoseSchema(Strict):
    camera: CameraChangeSchema | None = None
    objects: dict[Name, PlaceSchema] = {}


class PosesSchema(Strict):
    """Of each frame, by its file's name without suffix, what is elsewhere than the job says."""

    format: Literal["btfsep-poses"]
    version: Literal[1]
    frames: dict[Name, PoseSchema]


Model = TypeVar("Model", bound=BaseModel)


def parse(model: type[Model], name: str, data: bytes, *, kind: str) -> Model:
    """Validates the bytes of a JSON file.

    Parameters
    ----------
    model : the schema; has ``format`` and ``version`` as literals
    name : what to call the file in an error
    data : the file
    kind : the file in words, "a BTFsep job"

    Raises InputError: no JSON, another format or version, or the first thing in it that is wrong, in words.
    """
    if len(data) > MAX_BYTES:
        raise InputError(name, f"the file has {len(data) // 2**20} MB", f"check that this is {kind}")
    try:
        tree = json.loads(data.decode("utf-8-sig"), object_pairs_hook=_no_twins)
    except json.JSONDecodeError as error:
        got = f"line {error.lineno} is not valid JSON ({error.msg})"
        raise InputError(name, got, "correct the line") from None
    except _Twins as error:
        raise InputError(name, f"the key '{error}' stands there twice", "keep one of them") from None
    except (UnicodeDecodeError, ValueError, RecursionError):
        raise InputError(name, "this is not a JSON file", f"check that this is {kind}") from None
    if not isinstance(tree, dict):
        raise InputError(name, "the file does not hold a JSON object", f"check that this is {kind}")
    for key in ("format", "version"):
        wanted = get_args(model.model_fields[key].annotation)[0]
        got = tree.get(key)
        if type(got) is not type(wanted) or got != wanted:
            found = f"its {key} is {_show(got)}" if key in tree else f"it has no '{key}'"
            newer = key == "version" and isinstance(got, int) and not isinstance(got, bool) and got > wanted
            do = "use a newer BTFsep" if newer else f'it has to say "{key}": {json.dumps(wanted)}'
            raise InputError(name, found, do)
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        raise _in_words(model, name, error) from None


class _Twins(Exception):
    pass


def _no_twins(pairs):
    out = dict(pairs)
    if len(out) != len(pairs):
        keys = [k for k, _ in pairs]
        raise _Twins(next(k for k in keys if keys.count(k) > 1)[:60])
    return out


def _show(value) -> str:
    text = json.dumps(value, ensure_ascii=True)
    return text if len(text) <= 60 else text[:57] + "…"


def _place(location) -> str:
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else ("." if text else "") + str(part)[:60]
    return text


def _annotation_at(model, location):
    """The annotation at a location inside the schema."""
    annotation = model
    for part in location:
        annotation = _bare(annotation)
        holds_many = get_origin(annotation) in (list, dict)
        annotation = get_args(annotation)[-1] if holds_many else annotation.model_fields[part].annotation
    return _bare(annotation)


def _bare(annotation):
    """An annotation without its optional and annotated wrappers: a schema, a list, a dict, a literal, a plain type."""
    while get_origin(annotation) not in (None, list, dict, Literal):
        annotation = get_args(annotation)[0]
    return annotation


def nearest(word: str, choices) -> str:
    """ "did you mean 'x'?", or the choices where none is near."""
    choices = list(choices)
    near = difflib.get_close_matches(str(word).lower(), choices, 1, 0.5)
    if near:
        return f"did you mean '{near[0]}'?"
    return _list(choices)


_WANTED = {
    "string_type": "a text",
    "string_unicode": "a text of Unicode (give the file another name)",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "list_type": "a list",
    "model_type": "an object { }",
    "dict_type": "an object { }",
    "model_attributes_type": "an object { }",
}


def _in_words(model, name: str, error: ValidationError) -> InputError:
    first = error.errors(include_url=False)[0]
    kind, location, got, context = first["type"], first["loc"], first["input"], first.get("ctx", {})
    if kind != "extra_forbidden":
        location = [part for part in location if part not in KINDS.values()]
    what = f"{name}: {_place(location)}"
    if kind == "missing":
        return InputError(what, "it is missing", "add it")
    if kind.startswith("union_tag"):
        return InputError(what, f"it is {_show(got)}", "it has to be a list of three numbers or the name of an image")
    if kind == "extra_forbidden":
        known = _annotation_at(model, location[:-1]).model_fields
        return InputError(what, "this key is not known", nearest(str(location[-1]), known))
    if kind == "literal_error":
        choices = [str(c) for c in get_args(_annotation_at(model, location))]
        return InputError(
            what, f"it is {_show(got)}", nearest(got, choices) if isinstance(got, str) else _list(choices)
        )
    if kind in _WANTED:
        return InputError(what, f"it is {_show(got)}", f"it has to be {_WANTED[kind]}")
    if kind == "finite_number":
        return InputError(what, f"it is {got}", "it has to be a finite number")
    for key, words in (("gt", "greater than"), ("ge", "at least"), ("lt", "less than"), ("le", "at most")):
        if key in context:
            return InputError(what, f"it is {_show(got)}", f"it has to be {words} {context[key]:g}")
    if kind in ("too_short", "too_long"):
        limit = context.get("min_length" if kind == "too_short" else "max_length")
        do = f"it needs {'at least' if kind == 'too_short' else 'at most'} {limit}"
        return InputError(what, f"it has {context.get('actual_length')} entries", do)
    if kind == "string_too_short":
        return InputError(what, "it is empty", "fill it in")
    if kind == "string_too_long":
        return InputError(what, f"it has {len(got)} characters", f"it may have {context.get('max_length')}")
    return InputError(what, f"it is {_show(got)}", first["msg"])


def _list(choices) -> str:
    return "choose one of " + ", ".join(f"'{c}'" for c in choices)
