# SPDX-License-Identifier: GPL-3.0-or-later
"""What the parts of the paper's recogniser are worth, each against the same photographs: by the classifier alone.

scripts/study descriptors FOLDER          photographs of `scripts/study recognition FOLDER`, which are there

Colour patches, SIFT and both; the SVM and the nearest neighbour; sizes of the dictionaries; the paper's descriptors and
vectors as they are and the product's; training under natural light and under single lamps (the paper's premise is that
natural light is worth it). Each object of the photographs is trained on in all materials once for each kind of light.
No object and no light of the photographs was seen in training. Shares come with Wilson's range of 95 %.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from btfsep_engine.btf.library import open_library
from btfsep_engine.conventions import fibonacci_sphere, pixel_directions
from btfsep_engine.job.load import load_job
from btfsep_engine.light.lightings import EnvironmentMaps
from btfsep_engine.light.maps import training_lights
from btfsep_engine.pipeline.recognition import INDISTINGUISHABLE, bounding_window, training_region
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from btfsep_engine.recognise.training import METHODS, Method, render_samples, train
from scripts.studies import parser, photos, tables
from scripts.studies.recognition import OBJECTS, share

TUNED, PAPER = METHODS["tuned"], METHODS["paper"]
LAMP_ROWS, LAMP_DEGREES = 64, 8.0  # of the map of a single lamp; radius of its disc
FILL = 0.02  # of the lamp's irradiance: even light beside it, so that no shadow is black


@dataclass(frozen=True)
class Way:
    """One row of the table: a method, a classifier, and under which light it is trained."""

    name: str
    method: Method = TUNED
    classifier: str = "svm"
    light: str = "natural"


def encoded(method: Method, **settings) -> Method:
    return replace(method, encoding=replace(method.encoding, **settings))


WAYS = (
    Way("the product's"),
    Way("colour patches alone", encoded(TUNED, colour_weight=1.0)),
    Way("SIFT alone", encoded(TUNED, colour_weight=0.0)),
    Way("nearest neighbour", classifier="nearest"),
    Way("50 + 50 words", encoded(TUNED, colour_words=50, sift_words=50)),
    Way("500 + 500 words", encoded(TUNED, colour_words=500, sift_words=500)),
    Way("trained under single lamps", light="single"),
    Way("the paper's", PAPER),
    Way("the paper's, nearest neighbour", PAPER, "nearest"),
    Way("the paper's, under single lamps", PAPER, light="single"),
)


def single_lamps(count: int) -> EnvironmentMaps:
    """Maps of one lamp each, of ``count`` directions of the upper half."""
    pixels = pixel_directions(LAMP_ROWS, 2 * LAMP_ROWS)
    directions = fibonacci_sphere(2 * count)
    directions = directions[np.argsort(-directions[:, 2])][:count]
    lit = np.stack([pixels @ d > np.cos(np.radians(LAMP_DEGREES)) for d in directions])
    radiance = np.where(lit, 1.0, FILL * np.mean(lit))[..., None] * np.ones(3, np.float32)
    return EnvironmentMaps(radiance.astype(np.float32), tuple(f"lamp {i}" for i in range(count)))


class Trained:
    """The training images of one object, and what recognises its photographs."""

    def __init__(self, photograph, library, settings):
        job = load_job(photograph.folder)
        scene = PreparedScene(replace(job, objects=(replace(job.objects[0], uv="xatlas"),)), Reporter())
        self.region = training_region(scene.regions[0], settings.training_pixels)
        self.window = bounding_window(self.region)
        natural = training_lights(settings.training_turns)
        points = scene.points(0, region=self.region, textured=True)
        transport = scene.transport(points, directions=settings.training_directions)
        names = [n for n in library.names() if n not in INDISTINGUISHABLE]
        inside = self.region[self.window]
        self.samples = {}
        for kind, lights in (("natural", natural), ("single", single_lamps(natural.count))):

            def render(material, lights=lights):
                images = np.full((lights.count, *inside.shape, 3), np.nan, np.float32)
                images[:, inside] = transport.radiance(material, lights).transpose(1, 0, 2)
                return images

            materials = (library.load(n) for n in names)
            self.samples[kind] = list(render_samples(materials, list(lights.names), render, inside))

    def right(self, way: Way, photographs, settings) -> list[bool]:
        """Whether each photograph's material is the answer."""
        recogniser = train(self.samples[way.light], classifier=way.classifier, seed=settings.seed, method=way.method)
        out = []
        for p in photographs:
            photo = load_job(p.folder).photo
            radiance = np.where(photo.usable[..., None], photo.radiance, np.nan)[self.window]
            vectors = recogniser.describe(radiance, self.region[self.window])
            out.append(recogniser.judged(vectors).material == p.material)
        return out


def main(arguments) -> int:
    options = parser("descriptors", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--objects", nargs="+", default=OBJECTS, choices=OBJECTS)
    given = options.parse_args(arguments)
    library, settings = open_library(), choose("balanced")
    right: dict = {way.name: [] for way in WAYS}
    for name in given.objects:
        some = photos.photographs_in(given.folder, objects=[name])
        trained = Trained(some[0], library, settings)
        for way in WAYS:
            right[way.name] += trained.right(way, some, settings)
            print(f"{name}: {way.name}: {share(right[way.name][-len(some) :])}", flush=True)
    rows = [
        [way.name, "SVM" if way.classifier == "svm" else "nearest", way.light, share(right[way.name])] for way in WAYS
    ]
    print(
        "\n"
        + tables.table(["descriptors", "classifier", "training light", f"right of {len(right[WAYS[0].name])}"], rows)
    )
    return 0
