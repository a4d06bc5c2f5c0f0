# SPDX-License-Identifier: GPL-3.0-or-later
"""Learns how recognition weighs what speaks for a candidate, and how sure it may be (data/recognition.json).

scripts/study learn-recognition FOLDER              takes the photographs into FOLDER, and writes the table

The photographs are by Cycles, of displaced geometry whose texels are not the library's: three objects, two of them in
each material of the library, each photograph under a light of its own; and objects in plain surfaces, of which the
library has none: right are there `verification.PLAIN`, of a matte one white, too. No object and no light of theirs is
in the evaluation (`scripts/study recognition`), and no light among those that a recogniser is trained under. The
lights: two of Blender's eight studio lights, drawn by chance, each photograph with another turn of it; and draws from
the prior of natural light (`light/log_field.py`) with up to two lamps.

Five models: "verified", of all cues; "spoilt" and "grainy", the same of photographs that have lost their finest
detail, or have noise over it: each is used with every flaw of `cues.FLAWS`, too, by the model that it is judged by;
"explained", which says what is worth a rendering; and "votes", of the classifier alone; of these two plain surfaces are
no part. The weights are those of the largest likelihood (a multinomial logistic regression with a ridge), each
photograph of the library's materials twice: with all, where its own is right, and without its own, where none is. The
strangeness of what is right in each photograph is that under weights which were learned on the other objects, each
light counting once, and its p-value's rank is what `recognise.judgement` says.
"""

import itertools
import json
from dataclasses import dataclass
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
from btfsep_engine.pipeline.verification import EXPLANATIONS, IS_PLAIN, PLAIN, SIMILARITIES, TINT
from btfsep_engine.recognise.judgement import TABLE, judged, utilities
from btfsep_engine.storage.atomic import write_text
from scripts.cycles import plain as studio_plain
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
OBJECTS_EACH = 2  # of a material
RESOLUTION, SAMPLES = 256, 64
SHOWN_PLAIN = (
    *("plain/matte-red", "plain/matte-navy", "plain/satin-clay", "plain/satin-grey"),
    *("plain/gloss-red", "plain/gloss-grey", "plain/metal-clay", "plain/metal-grey"),
)
MODELS = {
    "verified": ("classifier", *EXPLANATIONS, *SIMILARITIES, IS_PLAIN),
    "spoilt": ("classifier", *EXPLANATIONS, *SIMILARITIES, IS_PLAIN),
    "grainy": ("classifier", *EXPLANATIONS, *SIMILARITIES, IS_PLAIN),
    "explained": ("classifier", *EXPLANATIONS),
    "votes": ("classifier",),
}
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


class Lights:
    """The lights of photographs in their order, each written beside them when it is first asked for."""

    def __init__(self, folder: Path, seed: int, prefix: str = ""):
        self.folder, self.prefix, self.count = folder / "lights", prefix, 0
        self.random = np.random.default_rng(seed)
        self.folder.mkdir(parents=True, exist_ok=True)

    def next(self, j: int, *, studio: bool) -> Path:
        """The next, of an object in the j-th material: of the studio, or drawn."""
        if studio:
            light = LIGHTS[j % len(LIGHTS)]
            radiance = read_map(studio_lights()[light])
            radiance = turned(shrink(radiance, max(1, len(radiance) // 256)), self.random.uniform(0, 360))
        else:
            light, radiance = DRAWN, drawn_light(self.random)
            radiance *= tint_of(radiance, self.count)
        path = self.folder / f"{light}-{self.prefix}{self.count:03d}.exr"
        if not path.exists():
            write_exr(path, np.asarray(radiance, np.float32))
        self.count += 1
        return path


def shots(folder: Path, materials) -> list[list]:
    """The photographs of the library's materials, and those of plain surfaces, their lights written beside them; those
    of one object in one material stand together."""
    names = [photos.studio_name(m) for m in materials]
    beside = folder / photos.PLAIN
    return [
        of_objects(folder, names, Lights(folder, 0)),
        of_objects(beside, SHOWN_PLAIN, Lights(folder, 1, "plain-")),
    ]


def of_objects(folder: Path, materials, lights: Lights) -> list:
    """Photographs of `OBJECTS_EACH` objects in each of some materials, of the studio's names."""
    out = []
    for turn, (j, material), k in itertools.product(range(OBJECTS_EACH), enumerate(materials), range(LIGHTS_EACH)):
        name, light = OBJECTS[(j + turn) % len(OBJECTS)], lights.next(j, studio=k == LIGHTS_EACH - 1)
        out.append(photos.shot(folder, name, material, light, variation=VARIATION))
    return out


@dataclass(frozen=True)
class Example:
    """What is learned from: ``cues`` : {cue: (candidates,)}, ``right`` : which of them are, if any; what it counts."""

    cues: dict
    right: tuple[int, ...]
    counts: float
    object: str
    light: str


def examples(seen, *, plain: bool = True) -> list[Example]:
    """Of photographs (cues.Seen); ``plain`` : with plain surfaces, as candidates and photographed."""
    out = []
    for s in seen:
        truth, light = s.photograph.material, s.photograph.light
        is_plain = truth in studio_plain.NAMES
        about = s.photograph.object, light if light.startswith(DRAWN) else light.split("-")[0]  # a turn is the same
        if is_plain and not plain:
            continue
        names, found = s.of_candidates(plain=plain)
        may = (*PLAIN, WHITE) if "matte" in truth else PLAIN if is_plain else (truth,)
        right = tuple(i for i, name in enumerate(names) if name in may)
        out.append(Example(found, right, 1.0, *about))
        if s.left_out:
            out.append(Example(s.of_candidates(left_out=True, plain=plain)[1], (), LEFT_OUT, *about))
    return out


def learned(data: list[Example], names) -> tuple[dict, float]:
    """The weights of the cues ``names``, and that of none, by the largest likelihood of examples."""
    unit = np.array([np.std(np.concatenate([one.cues[n] for one in data])) for n in names])
    unit[unit == 0] = 1.0
    rows = [np.stack([one.cues[n] for n in names], 1) / unit for one in data]

    def loss(w):
        total = RIDGE * np.square(w[:-1]).sum()
        for x, one in zip(rows, data, strict=True):
            z = np.append(x @ w[:-1], w[-1])
            total += one.counts * (np.logaddexp.reduce(z) - np.logaddexp.reduce(z[list(one.right) or [-1]]))
        return total

    limits = [(0, None)] * len(names) + [(None, None)]  # each cue speaks for a candidate, or says nothing
    w = minimize(loss, np.zeros(len(names) + 1), method="L-BFGS-B", bounds=limits).x
    return dict(zip(names, np.round(w[:-1] / unit, 4).tolist(), strict=True)), round(float(w[-1]), 4)


def strangeness(data: list[Example], names) -> list:
    """-log p of what is right under weights learned on the other objects: as many values as there are lights.

    Of a light are several photographs; which of them is drawn moves the set's coverage by a tenth. So the values are
    quantiles of all of them, each light counting once.
    """
    of_light: dict = {}
    for name in sorted({one.object for one in data}):
        weights, none = learned([one for one in data if one.object != name], names)
        for one in data:
            if one.object == name and one.right:
                p = judged(utilities(weights, one.cues), none, np.zeros(1)).probabilities[list(one.right)].sum()
                of_light.setdefault(one.light, []).append(round(-float(np.log(max(p, 1e-300))), 4))
    values = np.concatenate(list(of_light.values()))
    counts = np.concatenate([np.full(len(own), 1 / len(own)) for own in of_light.values()])
    order = np.argsort(values, kind="stable")
    below = np.cumsum(counts[order])
    return values[order][np.searchsorted(below, np.arange(len(of_light)) + 0.5)].tolist()


def main(arguments) -> int:
    options = parser("learn-recognition", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--no-take", dest="take", action="store_false", help="only photographs that are there")
    options.add_argument("--others", type=Path, nargs="*", default=[], help="folders of scripts/study photos, used too")
    given = options.parse_args(arguments)
    library = open_library()
    wanted = shots(given.folder.resolve(), [WHITE, *library.entries])
    if given.take:
        photos.take(list(itertools.chain(*wanted)), resolution=RESOLUTION, samples=SAMPLES, denoise=True)
    found = [cues.seen_in(some) for some in wanted]
    found += [photos.photographs_in(folder, objects=OBJECTS, lights=LIGHTS) for folder in given.others]
    seen = {flaw: [] for flaw in cues.FLAWS}
    for some in found:
        some.sort(key=lambda p: p.object)
        for flaw, into in seen.items():
            into += cues.cues_of(some, library, choose("balanced"), flaw=flaw, every=True)
    every, clean = [s for some in seen.values() for s in some], seen[cues.FLAWS[0]]
    used = {model: examples([s for s in every if s.model == model]) for model in ("verified", "spoilt", "grainy")}
    table = {
        "photographs": len(clean),
        "objects": sorted({s.photograph.object for s in clean}),
        "lights": len({one.light for one in examples(clean)}),
        "made_by": "scripts/study learn-recognition",
        "models": {},
    }
    for model, names in MODELS.items():
        data = used.get(model) or examples(clean, plain=False)
        weights, none = learned(data, names)
        table["models"][model] = {"weights": weights, "none": none, "strangeness": strangeness(data, names)}
        print(model, weights, none)
    write_text(TABLE, json.dumps(table, indent=1) + "\n")
    return 0
