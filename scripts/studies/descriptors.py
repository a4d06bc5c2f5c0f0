# SPDX-License-Identifier: GPL-3.0-or-later
"""What the parts of the paper's recogniser are worth, each against the same photographs: by the classifier alone.

scripts/study descriptors FOLDER          photographs of `scripts/study recognition FOLDER`, which are there

Colour patches, SIFT and both; the SVM and the nearest neighbour; sizes of the dictionaries; Fisher vectors beside VLAD;
the paper's descriptors and vectors as they are and the product's; training under natural light and under single lamps,
and with BTFs and with flat textures (the paper's premise is that natural light and BTFs are worth it). Each object of
the photographs is trained on in all materials once for each kind of rendering. No object and no light of the
photographs was seen in training.

Shares come with Wilson's range of 95 %. All ways answer the same photographs, so two are compared by those that only
one of them has right: McNemar's exact test, as if photographs were independent, and the same with the signs of all
photographs of a mesh (an object in a material) turned at once.

Answers are kept in FOLDER/descriptors.json, and asked anew where what they depend on has changed.
"""

import inspect
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from btfsep_engine.btf.directions import cosine_weights
from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.model import Material
from btfsep_engine.conventions import fibonacci_sphere, pixel_directions
from btfsep_engine.job.load import load_job
from btfsep_engine.light.lightings import EnvironmentMaps
from btfsep_engine.light.maps import training_lights
from btfsep_engine.pipeline.recognition import INDISTINGUISHABLE, bounding_window, training_region
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.recognise import vlad
from btfsep_engine.recognise.descriptors import extract
from btfsep_engine.recognise.model_file import source_digest
from btfsep_engine.recognise.training import METHODS, Described, Method, described, render_samples, taught
from btfsep_engine.storage.atomic import write_text
from btfsep_engine.storage.cache import digest
from scripts.studies import fisher, parser, photos, tables
from scripts.studies.estimates import scene_of
from scripts.studies.recognition import OBJECTS, share

TUNED, PAPER = METHODS["tuned"], METHODS["paper"]
LAMP_ROWS, LAMP_DEGREES = 64, 8.0  # of the map of a single lamp; radius of its disc
FILL = 0.02  # of the lamp's irradiance: even light beside it, so that no shadow is black
TURNS = 100_000  # of the signs of meshes, at random


@dataclass(frozen=True)
class Way:
    """One row of the table: a method, a classifier, what it is trained on, and which row it is compared with."""

    name: str
    method: Method = TUNED
    classifier: str = "svm"
    light: str = "natural"
    shown: str = "BTFs"
    learn: Callable = vlad.learn_encoder
    beside: str = "the product's"

    @property
    def rendered(self) -> tuple[str, str]:
        """The kind of its training images, a key of ``LIGHTS`` and one of ``SHOWN``."""
        return self.light, self.shown

    @property
    def described(self) -> tuple:
        """All that their descriptors depend on."""
        return *self.rendered, repr(self.method.settings), self.method.as_photos


def encoded(method: Method, **settings) -> Method:
    """Another encoding, whose dictionaries are learned from the training images."""
    return replace(method, ready=False, encoding=replace(method.encoding, **settings))


# a Gaussian has two vectors, a word one: with half as many the joined vectors are as long as those of VLAD
HALF = {"colour_words": vlad.COLOUR_WORDS // 2, "sift_words": vlad.SIFT_WORDS // 2}
WAYS = (
    Way("the product's"),
    Way("colour patches alone", encoded(TUNED, colour_weight=1.0)),
    Way("SIFT alone", encoded(TUNED, colour_weight=0.0)),
    Way("nearest neighbour", classifier="nearest"),
    Way("words of its own", encoded(TUNED)),
    Way("50 + 50 words", encoded(TUNED, colour_words=50, sift_words=50)),
    Way("500 + 500 words", encoded(TUNED, colour_words=500, sift_words=500)),
    Way("Fisher vectors, 75 + 125 Gaussians", encoded(TUNED, **HALF), learn=fisher.learn_encoder),
    Way("Fisher vectors, 150 + 250 Gaussians", encoded(TUNED), learn=fisher.learn_encoder),
    Way("trained under single lamps", light="single"),
    Way("trained on flat textures", shown="flat"),
    Way("trained on flat textures with gloss", shown="flat with gloss"),
    Way("the paper's", PAPER),
    Way("the paper's, nearest neighbour", PAPER, "nearest", beside="the paper's"),
    Way("the paper's, Fisher vectors", encoded(PAPER, **HALF), learn=fisher.learn_encoder, beside="the paper's"),
    Way("the paper's, under single lamps", PAPER, light="single", beside="the paper's"),
    Way("the paper's, on flat textures", PAPER, shown="flat", beside="the paper's"),
    Way("the paper's, on flat textures with gloss", PAPER, shown="flat with gloss", beside="the paper's"),
)


def single_lamps(count: int) -> EnvironmentMaps:
    """Maps of one lamp each, of ``count`` directions of the upper half."""
    pixels = pixel_directions(LAMP_ROWS, 2 * LAMP_ROWS)
    directions = fibonacci_sphere(2 * count)
    directions = directions[np.argsort(-directions[:, 2])][:count]
    lit = np.stack([pixels @ d > np.cos(np.radians(LAMP_DEGREES)) for d in directions])
    radiance = np.where(lit, 1.0, FILL * np.mean(lit))[..., None] * np.ones(3, np.float32)
    return EnvironmentMaps(radiance.astype(np.float32), tuple(f"lamp {i}" for i in range(count)))


def flattened(material: Material, *, gloss: bool) -> Material:
    """A BTF as a texture without meso-structure: what of it is seen from the front under light from all sides.

    ``gloss`` : the texture is multiplied with the mean ABRDF; else it is perfectly diffuse. Other kinds stay
    """
    if not material.has_texture:
        return material
    front = material.angular[np.argmax(material.views[:, 2])]
    albedo = np.maximum(material.texels @ np.einsum("l,lck->kc", cosine_weights(material.lights), front), 0)
    mean = albedo.mean((0, 1))
    of_directions = material.mean_abrdf if gloss else np.broadcast_to(mean / np.pi, material.mean_abrdf.shape)
    angular = of_directions[..., None] * np.eye(3)
    return replace(material, texels=(albedo / mean).astype(np.float32), angular=angular.astype(np.float32))


LIGHTS = {"natural": lambda natural: natural, "single": lambda natural: single_lamps(natural.count)}
SHOWN = {
    "BTFs": lambda material: material,
    "flat": lambda material: flattened(material, gloss=False),
    "flat with gloss": lambda material: flattened(material, gloss=True),
}


class Trained:
    """What one object looks like in all materials, and what recognises its photographs."""

    def __init__(self, photographs, library, settings):
        scene = scene_of(photographs[0].folder, uv="xatlas")
        region = training_region(scene.regions[0], settings.training_pixels)
        self.window = bounding_window(region)
        self.inside = region[self.window]
        points = scene.points(0, region=region, textured=True)
        self.transport = scene.transport(points, directions=settings.training_directions)
        self.photographs, self.library, self.settings = photographs, library, settings
        self.images, self.queries = {}, {}

    def rendered(self, light, shown):
        """Training images of a kind, one by one (`training.TrainingImage`)."""
        lights = LIGHTS[light](training_lights(self.settings.training_turns))
        names = [n for n in self.library.names() if n not in INDISTINGUISHABLE]

        def render(material):
            images = np.full((lights.count, *self.inside.shape, 3), np.nan, np.float32)
            images[:, self.inside] = self.transport.radiance(material, lights).transpose(1, 0, 2)
            return images

        materials = (SHOWN[shown](self.library.load(n)) for n in names)
        return render_samples(materials, list(lights.names), render, self.inside)

    def described(self, way: Way) -> Described:
        """Training images as the way describes them, which others may, too: the last ones are kept."""
        if way.described not in self.images:
            samples = self.rendered(*way.rendered)
            self.images = {way.described: described(samples, seed=self.settings.seed, method=way.method)}
        return self.images[way.described]

    def query(self, photograph, settings):
        """The descriptors of a photograph."""
        key = photograph.folder.name, settings
        if key not in self.queries:
            photo = load_job(photograph.folder).photo
            radiance = np.where(photo.usable[..., None], photo.radiance, np.nan)[self.window]
            self.queries[key] = extract(radiance, self.inside, settings=settings)
        return self.queries[key]

    def answers(self, way: Way) -> dict:
        """What each photograph, by its folder's name, is taken for."""
        how = {"classifier": way.classifier, "seed": self.settings.seed, "method": way.method, "learn": way.learn}
        recogniser, out = taught(self.described(way), **how), {}
        for p in self.photographs:
            vectors = recogniser.encoder.encode(self.query(p, way.method.settings))
            out[p.folder.name] = recogniser.judged(vectors).material
        return out


def answered(folder: Path, objects, ways, library, settings):
    """{way's name: {photograph's name: answer}}, those that are not kept asked now; and the photographs."""
    path = folder / "descriptors.json"
    kept = json.loads(path.read_text()) if path.exists() else {}
    code = [inspect.getsource(part) for part in (fisher, single_lamps, flattened, Trained)]
    every, answers = [], {way.name: {} for way in ways}
    for name in objects:
        some, trained = photos.photographs_in(folder, objects=[name]), None
        every += some
        for way in sorted(ways, key=lambda w: w.described):  # images of a kind are made once
            parts = [way.method, way.classifier, way.rendered, way.learn.__module__, [p.folder.name for p in some]]
            key, at = digest(source_digest(), code, library.digest, settings, *parts), f"{name}: {way.name}"
            if kept.get(at, {}).get("key") != key:
                trained = trained or Trained(some, library, settings)
                kept[at] = {"key": key, "answers": trained.answers(way)}
                write_text(path, json.dumps(kept, indent=1))
            answers[way.name] |= kept[at]["answers"]
            print(f"{at}: {share(answers[way.name][p.folder.name] == p.material for p in some)}", flush=True)
    return answers, every


def compared(first, second, meshes) -> tuple[str, str, str]:
    """How two ways differ on the same photographs, whose answers are right or not: (photographs,) bool each.

    Returns
    -------
    right with the first alone and with the second alone; McNemar's exact p; p by turning the signs of ``meshes``, which
    names the mesh of each photograph
    """
    first, second = np.asarray(first, int), np.asarray(second, int)
    only = int((first > second).sum()), int((second > first).sum())
    p = binomtest(only[0], sum(only)).pvalue if sum(only) else 1.0
    difference = np.bincount(np.unique(meshes, return_inverse=True)[1], weights=first - second)
    signs = np.random.default_rng(0).choice([-1, 1], (TURNS, len(difference)))
    as_far = (np.abs(signs @ difference) >= abs(difference.sum())).sum()
    return f"{only[0]} : {only[1]}", f"{p:.2g}", f"{(1 + as_far) / (1 + TURNS):.2g}"


def main(arguments) -> int:
    options = parser("descriptors", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--objects", nargs="+", default=OBJECTS, choices=OBJECTS)
    given = options.parse_args(arguments)
    answers, every = answered(given.folder, given.objects, WAYS, open_library(), choose("balanced"))
    right = {name: [of[p.folder.name] == p.material for p in every] for name, of in answers.items()}
    meshes, rows = [f"{p.object} {p.shown}" for p in every], []
    for way in WAYS:
        beside = ("–",) * 4
        if way.beside != way.name:
            beside = (way.beside, *compared(right[way.name], right[way.beside], meshes))
        rows.append([way.name, share(right[way.name]), *beside])
    heads = ["way", f"right of {len(every)}", "beside", "right in this alone : in that alone", "p", "p by mesh"]
    print("\n" + tables.table(heads, rows))
    return 0
