# SPDX-License-Identifier: GPL-3.0-or-later
"""Learns how recognition weighs what speaks for a candidate, and how sure it may be (data/recognition.json).

scripts/study learn-recognition FOLDER              takes the photographs into FOLDER, and writes the table

The photographs are by Cycles, of displaced geometry whose texels are not the library's: three objects in every material
of the library, each under a light of its own; of each material one object's are twice as large. No object and no light
of theirs is in the evaluation (`scripts/study recognition`), and no light among those that a recogniser is trained
under. The lights: two of Blender's eight studio lights, drawn by chance, each photograph with another turn of it; and
draws from the prior of natural light (`light/log_field.py`) with up to two lamps.

Four models: "verified", of all cues; "spoilt", the same of photographs that have lost their finest detail: each is
blurred, made noisier and coded as JPEG once more; "explained", which says what is worth a rendering; and "votes", of
the classifier alone. The weights are those of the largest
likelihood (a multinomial logistic regression with a ridge), each photograph twice: with all materials, where its own is
right, and without its own, where none is. The strangeness of each photograph's own material is that under weights which
were learned on the other objects, and its p-value's rank is what `recognise.judgement` says.
"""

import itertools
import json
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from btfsep_engine.btf.library import open_library
from btfsep_engine.conventions import REC709_LUMINANCE, pixel_directions
from btfsep_engine.imaging.images import write_exr
from btfsep_engine.light.lightings import shrink, turned
from btfsep_engine.light.log_field import natural_field
from btfsep_engine.light.maps import read_map
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.verification import EXPLANATIONS, SIMILARITIES, TINT
from btfsep_engine.recognise.judgement import TABLE, judged, utilities
from btfsep_engine.storage.atomic import write_text
from scripts.cycles.lights import studio_lights
from scripts.studies import cues, parser, photos
from scripts.studies.makers.prepare_lights import normalised
from scripts.studies.photos import WHITE

OBJECTS = ("suzanne", "blob", "cloth")
LIGHTS = ("city", "sunrise")  # of the eight, drawn by chance
LIGHTS_EACH = 5  # of an object in a material; the last is a studio light
DRAWN = "drawn"  # what the other lights' names begin with
VARIATION = 2  # of the texels: the library has 0, the evaluation 1
HEIGHT = 128  # rows of a light
LAMPS = (0.4, 0.4, 0.2)  # how probable none, one and two are
LAMP_PIXELS = 2.0  # radius of a lamp's disc
RESOLUTIONS, SAMPLES = (256, 256, 512), 64  # of a photograph: of a material's first object, second, third
MODELS = {
    "verified": ("classifier", *EXPLANATIONS, *SIMILARITIES),
    "spoilt": ("classifier", *EXPLANATIONS, *SIMILARITIES),
    "explained": ("classifier", *EXPLANATIONS),
    "votes": ("classifier",),
}
FLAWS = ("clean", "all three")
RIDGE = 0.3  # of weights of cues of deviation 1: 0.1 does as well of clear photographs, 0.5 to 1 of spoilt ones
LEFT_OUT = 0.1  # how much a photograph without its material counts beside one with it


def drawn_light(random) -> np.ndarray:
    """A map (HEIGHT, 2 HEIGHT, 3) float32 from the prior of natural light, with lamps."""
    field, directions = natural_field(), pixel_directions(HEIGHT, 2 * HEIGHT)
    white = random.standard_normal(field.unknowns)
    white[0] = 0.0  # the level: a photo's exposure is free
    radiance = normalised(field.at(white, directions.reshape(-1, 3)).reshape(HEIGHT, 2 * HEIGHT, 3))
    for _ in range(random.choice(len(LAMPS), p=LAMPS)):
        d = random.standard_normal(3)
        d[2] = abs(d[2])
        inside = directions @ (d / np.linalg.norm(d)) > np.cos(LAMP_PIXELS * np.pi / HEIGHT)
        tint = 0.15 * random.standard_normal()
        irradiance = np.exp(random.standard_normal()) * np.exp([tint, 0, -tint])
        radiance[inside] += irradiance / (np.pi * (LAMP_PIXELS * np.pi / HEIGHT) ** 2)
    return radiance.astype(np.float32)


def tint_of(radiance, number: int) -> np.ndarray:
    """(3,), what moves the mean colour of a map (h, w, 3) to one of natural light's, at the same luminance.

    The prior itself has means three times as far apart: most rooms would be green or violet.
    """
    warm, green = np.random.default_rng(number).standard_normal(2) * TINT
    height = len(radiance)
    solid_angle = np.sin(np.pi * (np.arange(height) + 0.5) / height)
    mean = np.average(radiance.mean(1), axis=0, weights=solid_angle)
    wanted = np.exp2([warm / 2 - green / 3, green * 2 / 3, -warm / 2 - green / 3])
    wanted *= (mean @ REC709_LUMINANCE) / (wanted @ REC709_LUMINANCE)
    return (wanted / mean).astype(np.float32)


def shots(folder: Path, materials) -> list[list]:
    """The photographs of each of `RESOLUTIONS`, their lights written beside them; those of one object in one material
    stand together."""
    random, out, lights = np.random.default_rng(0), [], folder / "lights"
    lights.mkdir(parents=True, exist_ok=True)
    for turn, (j, material), k in itertools.product(range(len(RESOLUTIONS)), enumerate(materials), range(LIGHTS_EACH)):
        number = len(out)
        if k == LIGHTS_EACH - 1:
            light = LIGHTS[j % len(LIGHTS)]
            radiance = read_map(studio_lights()[light])
            radiance = turned(shrink(radiance, max(1, len(radiance) // 256)), random.uniform(0, 360))
        else:
            light, radiance = DRAWN, drawn_light(random)
            radiance *= tint_of(radiance, number)
        path = lights / f"{light}-{number:03d}.exr"
        if not path.exists():
            write_exr(path, np.asarray(radiance, np.float32))
        name = OBJECTS[(j + turn) % len(OBJECTS)]
        out.append(photos.shot(folder, name, photos.studio_name(material), path, variation=VARIATION))
    each = len(materials) * LIGHTS_EACH
    return [out[i : i + each] for i in range(0, len(out), each)]


def examples(seen) -> list:
    """(cues, number of the right one or None, how much it counts, object, light) of photographs (cues.Seen)."""
    out = []
    for s in seen:
        right = s.known["names"].index(s.photograph.material)
        light = s.photograph.light
        about = s.photograph.object, light if light.startswith(DRAWN) else light.split("-")[0]  # a turn is the same
        out.append((s.known["cues"], right, 1.0, *about))
        out.append((s.left_out["cues"], None, LEFT_OUT, *about))
    return out


def learned(data, names) -> tuple[dict, float]:
    """The weights of the cues ``names``, and that of none, by the largest likelihood of `examples`."""
    unit = np.array([np.std(np.concatenate([cues[n] for cues, *_ in data])) for n in names])
    unit[unit == 0] = 1.0
    rows = [np.stack([cues[n] for n in names], 1) / unit for cues, *_ in data]

    def loss(w):
        total = RIDGE * np.square(w[:-1]).sum()
        for x, (_, right, counts, *_) in zip(rows, data, strict=True):
            z = np.append(x @ w[:-1], w[-1])
            total += counts * (z.max() + np.log(np.exp(z - z.max()).sum()) - z[-1 if right is None else right])
        return total

    limits = [(0, None)] * len(names) + [(None, None)]  # each cue speaks for a candidate, or says nothing
    w = minimize(loss, np.zeros(len(names) + 1), method="L-BFGS-B", bounds=limits).x
    return dict(zip(names, np.round(w[:-1] / unit, 4).tolist(), strict=True)), round(float(w[-1]), 4)


def strangeness(data, names) -> list:
    """-log p of the right material of one photograph of each light, under weights learned on the other objects."""
    of_light: dict = {}
    for name in sorted({of for *_, of, _ in data}):
        weights, none = learned([d for d in data if d[3] != name], names)
        for cues_, right, _, of, light in data:
            if of == name and right is not None:
                p = judged(utilities(weights, cues_), none, np.zeros(1)).probabilities[right]
                of_light.setdefault(light, []).append(round(-float(np.log(max(p, 1e-300))), 4))
    random = np.random.default_rng(0)
    return sorted(float(random.choice(values)) for values in of_light.values())


def main(arguments) -> int:
    options = parser("learn-recognition", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--no-take", dest="take", action="store_false", help="only photographs that are there")
    options.add_argument("--others", type=Path, nargs="*", default=[], help="folders of scripts/study photos, used too")
    given = options.parse_args(arguments)
    library = open_library()
    wanted = shots(given.folder.resolve(), [WHITE, *library.entries])
    if given.take:
        for some, resolution in zip(wanted, RESOLUTIONS, strict=True):
            photos.take(some, resolution=resolution, samples=SAMPLES, denoise=True)
    found = [cues.seen_in(given.folder, some) for some in wanted]
    found += [photos.photographs_in(folder, objects=OBJECTS, lights=LIGHTS) for folder in given.others]
    seen = {flaw: [] for flaw in FLAWS}
    for some in found:  # of one size each: an object's training is used for all of its photographs
        some.sort(key=lambda p: p.object)
        for flaw, into in seen.items():
            into += cues.cues_of(some, library, choose("balanced"), flaw=flaw, every=True)
    every = [s for some in seen.values() for s in some]
    used = {"verified": [s for s in every if not s.spoilt], "spoilt": [s for s in every if s.spoilt]}
    clean = seen[FLAWS[0]]
    table = {
        "photographs": len(clean),
        "objects": sorted({s.photograph.object for s in clean}),
        "lights": len({d[-1] for d in examples(clean)}),
        "made_by": "scripts/study learn-recognition",
        "models": {},
    }
    for model, names in MODELS.items():
        data = examples(used.get(model, clean))
        weights, none = learned(data, names)
        table["models"][model] = {"weights": weights, "none": none, "strangeness": strangeness(data, names)}
        print(model, weights, none)
    write_text(TABLE, json.dumps(table, indent=1) + "\n")
    return 0
