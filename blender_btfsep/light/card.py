# SPDX-License-Identifier: GPL-3.0-or-later
"""The card of a light: what an artist wants to know of it, in at most six lines, how far to trust it, and its doubts.

No bpy in this file. A card is plain data, kept as JSON with the scene and with the World (`kept_light`).
"""

import math
import re

import numpy as np

from ..basics.harmonics import LUMINANCE, evaluate, order_of
from .advice import (
    BY_CURVE,
    COLOUR_UNKNOWN,
    LOOK_ALIKE,
    MADE_UP_FOR,
    MATERIAL,
    MISFIT,
    NONE_OF_THESE,
    OUT_OF_LINE,
    OVEREXPOSED,
    RELIEF,
    SATURATED,
    advice,
    worst,
)
from .light_words import EVEN, ONE_SIDED, angles, brighter_side, colour_words, direction_words, irradiance, size_words

GOOD, FAIR = 0.15, 0.35  # the expected error up to which the light is green, and amber
TRUST = {"GREEN": "Good", "AMBER": "Fair", "RED": "Doubtful", "NONE": "Its error is not stated"}
LEAST_LAMP = 0.1  # of the light: a lamp of less is no key light
BROAD = 15.0  # degrees: the engine's lamps that are no suns
MOST_NAMES = 3
NO_CLASS = ("surface/", "reference/")  # begins the names of what has no class that people know
PLAIN = "surface/"  # how the engine's surfaces are called that are no material of a library
READING = {"UPRIGHT", "AGX", "STANDARD", "CAMERA", "CURVE"}
"""What mends how the photo is read: most other doubts may come of that."""
COMMANDS = re.compile(r" \([^()]*--[^()]*\)|; see stddev in lighting\.json")  # what the command line is told
OF_JOBS = {  # what jobs call things, and what the panel does
    "surface/given": "The material as given",
    "or its 'surface'": "or its colour",
    "its 'surface'": "its material",
    "a ground that the job does not have": "a ground that the scene does not have",
    "put it into the job": "put a plane there",
}
SAVED_BY = re.compile(r"of what Blender saved by evidence (?:Blender's view transform )?(.+?) \(probability ([\d.]+)\)")
SURE = 0.9  # of the view by which a render was saved: of what is more probable, nothing is asked
FILE_NAME = re.compile(r"[^:;]+\.\w{2,4}: ")  # begins a sentence about a file
# Of two doubts, the second says nothing more: its colour is asked for, its material, the camera is off still, or how
# much of an object it is.
SAID_ALREADY = (
    *((NONE_OF_THESE, other) for other in (MISFIT, COLOUR_UNKNOWN, LOOK_ALIKE)),
    (LOOK_ALIKE, MISFIT),
    (OUT_OF_LINE, MADE_UP_FOR),
    (OVEREXPOSED, SATURATED),
)
UNKNOWN = (NONE_OF_THESE, COLOUR_UNKNOWN, RELIEF)  # of an object: what else does not fit may come of that
BEHIND = "what the mirror hides"
FLASH, AT_CAMERA = "the camera's flash", "at the camera, as its flash"
AROUND = "what the table, or whatever stands around, keeps away"


def card_of(result: dict, lighting: dict, to_world=None, *, warnings=(), metres_per_unit: float = 1.0) -> dict:
    """The card of an estimate, or of a lighting from elsewhere (then ``result`` is empty).

    Parameters
    ----------
    result : the engine's answer
    lighting : as lighting_file.read returns it
    to_world : (4, 4) of the camera; None where there is none
    warnings : sentences of the engine and the add-on
    metres_per_unit : of the scene

    Returns
    -------
    dict of "trust" (GREEN, AMBER, RED or NONE), "lines" (pairs of a label and words), "warnings" (dicts of "short",
    "mend" and "object", a name or "", of "SELECT" several, a line each), "details" (sentences)
    """
    unsure = _unsure_materials(result)
    told = [(sentence, advice(sentence)) for sentence in warnings]
    phrases = {a.phrase for _, a in told}
    idle = {other for said, other in SAID_ALREADY if said in phrases}
    if NONE_OF_THESE in phrases:  # then it does not matter which it was taken for at first
        told = [(sentence, a) for sentence, a in told if a.phrase != BY_CURVE]
    asked = {doubt["object"] for doubt in unsure}  # which material it is
    which = [a for _, a in told if a.short and a.phrase not in idle]
    which = [a for a in which if a.phrase != BY_CURVE or not asked.intersection(a.objects)]
    which.sort(key=_rank)
    shown = {a.short: doubt_of(a) for a in which}
    errors = result.get("expected_error_shown") or result.get("expected_error") or {}
    error = errors.get("order_2") or errors.get("order_1")
    trust = "NONE"
    if error:
        by_warnings = worst(*[a.level for _, a in told]) if told else "GREEN"
        sure = error["median"] <= GOOD and error["high"] <= FAIR  # a lamp may stand where the photo shows nothing
        trust = "GREEN" if sure else "AMBER" if error["median"] <= FAIR else "RED"
        trust, by_error = worst(trust, by_warnings), trust
    words = TRUST[trust] + (", see below" if error and trust != by_error else "")
    if error:
        words += ": about {median:.0f}% off ({low:.0f}–{high:.0f}%)".format(
            **{key: 100 * error[key] for key in ("median", "low", "high")}
        )
    lines = [
        ("Trust", words),
        *_key_and_fill(result, lighting, to_world, metres_per_unit),
        ("Not shown", _unseen(result) or _not_shown(lighting)),
    ]
    materials = _materials(result)
    if materials:
        lines.append(("Material", materials))
    read = [doubt for doubt in shown.values() if doubt["mend"] in READING]
    others = [doubt for doubt in shown.values() if doubt not in read]
    return {
        "trust": trust,
        "lines": [list(line) for line in lines],
        "warnings": [*read, *unsure, *_unsure_view(result), *others],
        "details": _details(result, lighting, [s for s, a in told if a.phrase != MATERIAL or not unsure]),
    }


def _rank(advised) -> int:
    """Which of two doubts comes of the other: what is out of place, then what an object is made of, then what stands
    around it, then the rest."""
    if advised.phrase in (OUT_OF_LINE, MADE_UP_FOR):
        return 0
    return 1 if advised.phrase in UNKNOWN else 2 if advised.mend == "SELECT" else 3


def doubt_of(advised) -> dict:
    """A doubt as a card has it, of its `advice.Advice`."""
    told = "\n".join(advised.objects) if advised.mend == "SELECT" else "".join(advised.objects[:1])
    return {"short": advised.short, "mend": advised.mend, "object": told if advised.mend else ""}


def _key_and_fill(result: dict, lighting: dict, to_world, metres_per_unit: float) -> list:
    """The lines of the key light and of the fill."""
    suns = lighting["suns"]
    whole = np.array(lighting["coefficients"])
    sky = np.array(suns["sky"]) if suns else whole
    told = suns["lamps"] if suns else []
    lamps = [(np.array(s["direction"]), np.array(s["irradiance"]), s["size_degrees"]) for s in told]
    if not lamps:
        broad = [lamp for lamp in result.get("lamps") or [] if lamp["share"] >= LEAST_LAMP][:1]
        lamps = [(np.array(lamp["direction"]), np.array(lamp["irradiance"]), BROAD) for lamp in broad]
        sky = whole - sum(power * _beam(direction, len(whole)) for direction, power, _ in lamps)
    where = (lambda d: direction_words(d, to_world)) if to_world is not None else _in_the_world
    side, more = brighter_side(sky)
    if not lamps:
        if more < EVEN:
            return [("Key light", "none: even light from all sides"), ("Fill", colour_words(whole[0]))]
        kind = "one-sided, soft" if more > ONE_SIDED else "very soft"
        lit, shade = irradiance(whole, np.stack([side, -side])) @ LUMINANCE
        return [
            ("Key light", f"{where(side)}; {kind}, {colour_words(irradiance(whole, side))}"),
            ("Fill", f"the other side gets {100 * max(shade, 0) / max(lit, 1e-9):.0f}% of that"),
        ]
    direction, power, size = lamps[0]
    all_of = math.sqrt(4 * math.pi) * float(whole[0] @ LUMINANCE)
    share = float(power @ LUMINANCE) / max(all_of, 1e-9)
    others = f" (and {len(lamps) - 1} more)" if len(lamps) > 1 else ""
    fill = float(irradiance(sky, direction) @ LUMINANCE)
    ratio = (fill + float(power @ LUMINANCE)) / max(fill, 1e-9)
    words = f"{ratio:.0f}:1" if ratio >= 3 else f"{ratio:.1f}:1"  # in one piece, where the panel breaks lines
    from_where = "even" if more < EVEN else "mostly from above" if side[2] > 0.8 else f"more from {where(side)}"
    away = told[0]["near"]["distance"] if told and "near" in told[0] else None
    near = f", {metres_per_unit * away:.2g} m away" if away else ""
    flash = (result.get("choice") or {}).get("flash") if near else None  # no lamp stands near beside one
    place = where(direction) if not flash else FLASH if "a flash on the camera" in flash else AT_CAMERA
    return [
        ("Key light", place + near + others),
        ("", f"{size_words(size)}, {colour_words(power)}, {100 * min(share, 1):.0f}% of the light"),
        ("Fill", f"{colour_words(sky[0])}, {from_where}; key to fill {words}"),
    ]


def _beam(direction, terms: int) -> np.ndarray:
    """(terms, 1) coefficients of a beam of irradiance one."""
    return evaluate(order_of(terms), direction)[:, None]


def _in_the_world(direction) -> str:
    around, up = angles(direction)
    return f"azimuth {around:.0f}°, {abs(up):.0f}° {'up' if up >= 0 else 'down'}"


def _unseen(result: dict) -> str:
    """What stands between the light and the photo; empty where nothing does."""
    if "mirrors" in (result.get("choice") or {}):
        return BEHIND
    return AROUND if result.get("expected_error_shown") else ""


def _not_shown(lighting: dict) -> str:
    """What of the light the photo does not determine."""
    known = lighting["determined"] or [True] * len(lighting["coefficients"])
    bands = [known[l * l : (l + 1) ** 2] for l in range(lighting["order"] + 1)]
    if not known[0]:
        return "not even how bright the light is"
    if len(bands) > 1 and not all(bands[1]):
        return "from where most of the light comes, for sure" if not any(bands[1]) else "part of its direction"
    finest = max(order for order, band in enumerate(bands) if any(band))
    return f"detail finer than {180 / finest:.0f}°" if finest else "from where the light comes"


def _materials(result: dict) -> str:
    found = [o for o in result.get("objects") or [] if o.get("material")]
    names = list(dict.fromkeys(_plain(o["material"]) for o in found))
    return ", ".join(names[:MOST_NAMES]) + (" …" if len(names) > MOST_NAMES else "")


def _plain(name: str) -> str:
    """A material's name for people: "leather/brown-grain" is "brown grain leather"."""
    kind, _, own = name.partition("/")
    if kind == "reference":
        return own.replace("-", " ")
    if kind == "surface":
        return "as given" if own == "given" else f"plain {own}"
    return f"{own} {kind}".replace("-", " ").strip()


def _kind(name: str) -> str:
    """The class of a material for people; of what has none, its name."""
    return _plain(name) if name.startswith(NO_CLASS) else name.split("/")[0]


def _unsure_materials(result: dict) -> list:
    """A warning for each object whose material recognition leaves open, in the card's form."""
    out = []
    for found in result.get("objects") or []:
        likely = found.get("likely") or []
        if len(likely) < 2 or all(name.startswith(PLAIN) for name in likely):  # of those the colour is asked for
            continue
        kinds = list(dict.fromkeys(map(_kind, likely)))
        names = kinds if len(kinds) > 1 else [_plain(name) for name in likely]
        more = ", …" if len(names) > MOST_NAMES else ""
        shown = names[:MOST_NAMES]
        listed = f"{', '.join(shown)}{more}" if more else f"{', '.join(shown[:-1])} or {shown[-1]}"
        sentence = f"The material of {found['name']} is not certain ({listed}); choose it for a surer light"
        out.append({"short": sentence, "mend": "MATERIAL", "object": str(found["name"])})
    return out


def _unsure_view(result: dict) -> list:
    """A warning, in the card's form, where a render may have been saved with another view than it was read by."""
    found = SAVED_BY.search(str((result.get("choice") or {}).get("curve") or ""))
    if found is None or float(found[2]) >= SURE:
        return []
    view, other, mend = (found[1], "Standard", "STANDARD") if found[1] != "sRGB" else ("Standard", "AgX", "AGX")
    sentence = f"Taken for a render saved with {view} ({100 * float(found[2]):.0f} % sure); if it was {other}, say so"
    return [{"short": sentence, "mend": mend, "object": ""}]


def _details(result: dict, lighting: dict, warnings) -> list:
    """All else that was said, in sentences."""
    out = []
    if lighting["suns"]:
        around, up = angles(lighting["suns"]["lamps"][0]["direction"])
        out.append(f"In the world the key light stands at azimuth {around:.0f}° (from +X towards +Y), {up:.0f}° up")
    out += [str(result.get("determined") or ""), *map(str, (result.get("choice") or {}).values()), *warnings]
    return list(dict.fromkeys(capitalised(map(plain, out))))


def plain(sentence: str) -> str:
    """One of the engine's sentences without the words of its command line and of jobs."""
    sentence = COMMANDS.sub("", sentence)
    for word, here in OF_JOBS.items():
        sentence = sentence.replace(word, here)
    return sentence


def capitalised(words) -> list:
    """Sentences; one that begins with the name of a material or a file keeps that name as it is."""
    kept = [word for word in words if word.strip()]
    return [w[:1].upper() + w[1:] if w.split()[0].isalpha() and not FILE_NAME.match(w) else w for w in kept]
