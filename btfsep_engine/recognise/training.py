# SPDX-License-Identifier: GPL-3.0-or-later
"""From rendered training images to a recogniser (the paper, section 3.2).

Images are consumed one by one. Of each only its vectors are kept, as half floats; where dictionaries are learned from
the images themselves, its descriptors, until they are.
"""

import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from btfsep_engine.errors import InputError
from btfsep_engine.progress import Reporter
from btfsep_engine.recognise import classifier as classifiers
from btfsep_engine.recognise import descriptors as dense
from btfsep_engine.recognise import vlad
from btfsep_engine.recognise.recogniser import Recogniser

SAMPLE = 60_000  # descriptors from which a dictionary is learnt
NOISES = (0.0, 0.15)  # of the region's mean radiance; photos have more or less, and so must training images
BLURS = (0.0, 0.8)  # pixels; photos are a little less sharp than point-sampled renderings
CLASSIFIERS = {"svm": classifiers.train_svm, "nearest": classifiers.train_nearest}


@dataclass(frozen=True)
class Method:
    """How a recogniser is trained.

    Attributes
    ----------
    settings : how images are described
    encoding : how descriptors become vectors
    as_photos : whether training images get the noise and blur of photos
    offsets, grid : which decisions of the SVM, and which C and gamma, are tried, see `classifier.train_svm`
    ready : whether the dictionaries are those that are shipped (`vlad.ready_encoder`), which no material of a library
        changes; else they are learned from the training images
    """

    settings: dense.Settings = dense.DEFAULT
    encoding: vlad.Encoding = vlad.DEFAULT
    as_photos: bool = True
    offsets: tuple[bool, ...] = (True, False)
    grid: tuple[tuple[float, float], ...] = classifiers.GRID
    ready: bool = False


METHODS = {
    # of no offset and C from 10 on, grid searches on three objects found what lies within 2 %: nothing to search for
    "tuned": Method(offsets=(False,), grid=((10.0, 2.0),), ready=True),
    "paper": Method(dense.PAPER, vlad.PAPER, as_photos=False, offsets=(True,)),
}


@dataclass(frozen=True)
class TrainingImage:
    """One rendering of an object.

    Attributes
    ----------
    material : its name in the library, "class/name"
    light : the name of its lighting. What follows an "@" (a turn of the same map, "noon_grass@90") is left out
        when lights are held apart: images of one map are never on both sides of a split
    radiance : (h, w, 3) float, linear; outside the mask anything, NaN too
    mask : (h, w) bool
    """

    material: str
    light: str
    radiance: np.ndarray
    mask: np.ndarray


def render_samples(
    materials: Iterable, lights: list[str], render: Callable[[object], np.ndarray], mask
) -> Iterator[TrainingImage]:
    """The training images of one object, rendered material by material.

    Parameters
    ----------
    materials : the library's materials; each has a ``name``
    lights : M names, in the order of what ``render`` returns
    render : ``render(material)`` gives (M, h, w, 3) float32, the object under all M training lights in one pass
    mask : (h, w) bool, the object's pixels

    Yields
    ------
    TrainingImage, materials x lights of them
    """
    for material in materials:
        images = render(material)
        if len(images) != len(lights):
            raise ValueError(f"{len(images)} images of {material.name} for {len(lights)} lights")
        for light, radiance in zip(lights, images, strict=True):
            yield TrainingImage(material.name, light, radiance, mask)


def as_photo(radiance, mask, rng) -> np.ndarray:
    """A training image with the faults of a photo: a random slight blur within the mask, and random noise.

    Parameters
    ----------
    radiance : (h, w, 3) float; mask : (h, w) bool; rng : numpy Generator

    Returns
    -------
    (h, w, 3) float32; NaN outside the mask and where ``radiance`` is not finite
    """
    valid = mask & np.isfinite(radiance).all(-1)
    image = np.where(valid[..., None], radiance, 0).astype(np.float32)
    if (sigma := rng.uniform(*BLURS)) > 0.2:
        weights = cv2.GaussianBlur(valid.astype(np.float32), (0, 0), sigma)
        image = cv2.GaussianBlur(image, (0, 0), sigma) / np.maximum(weights, 1e-6)[..., None]
    mean = image[valid].mean() if valid.any() else 0.0
    # shot noise grows with the root of the signal
    noise = rng.uniform(*NOISES) * np.sqrt(np.maximum(image, 0) * mean) * rng.standard_normal(image.shape, np.float32)
    return np.where(valid[..., None], image + noise, np.nan).astype(np.float32)


def randomness(material: str, seed: int) -> np.random.Generator:
    """What makes a material's noise: its own, whatever other materials there are."""
    return np.random.default_rng([seed, zlib.crc32(material.encode())])


@dataclass(frozen=True)
class Described:
    """What is kept of n training images.

    Attributes
    ----------
    descriptors : n `descriptors.Descriptors`
    materials, lights : n names; of lights without the turns of their maps
    """

    descriptors: list
    materials: list[str]
    lights: list[str]


def described(
    samples: Iterable[TrainingImage],
    *,
    seed: int = 0,
    reporter: Reporter | None = None,
    method: Method = METHODS["tuned"],
    expected: int | None = None,
) -> Described:
    """The descriptors of training images, which are consumed one at a time.

    Parameters are those of `train`. Of the method its settings and ``as_photos`` count.

    Raises
    ------
    InputError
        No sample, or an object too small.
    """
    found = Described([], [], [])
    for sample, descriptors in _one_by_one(samples, seed, reporter, method, expected):
        found.descriptors.append(descriptors.compact())
        found.materials.append(sample.material)
        found.lights.append(_light_of(sample))
    if not found.descriptors:
        raise InputError("the training of recognition", "got no images", "choose a library with materials")
    return found


def encoded(samples: Iterable[TrainingImage], encoder: vlad.Encoder, **options) -> dict:
    """Material -> (lights, vectors), M of each, of its training images; each vector's rows are `Encoder.encode`'s.

    ``options`` : those of `described`
    """
    found: dict = {}
    for sample, descriptors in _one_by_one(samples, **{"seed": 0, "reporter": None, "expected": None} | options):
        lights, vectors = found.setdefault(sample.material, ([], []))
        lights.append(_light_of(sample))
        vectors.append(encoder.encode(descriptors).astype(np.float16))
    return found


def _light_of(sample) -> str:
    return sample.light.partition("@")[0]


def _one_by_one(samples, seed, reporter, method, expected):
    """Each sample and its descriptors."""
    reporter, random, shared = reporter or Reporter(), {}, {}
    with reporter.stage("training images"):
        for number, sample in enumerate(samples):
            own = random.setdefault(sample.material, randomness(sample.material, seed))
            image = as_photo(sample.radiance, sample.mask, own) if method.as_photos else sample.radiance
            yield sample, dense.extract(image, sample.mask, settings=method.settings, shared=shared)
            reporter.progress("training images", (number + 1) / max(expected or 0, number + 2), sample.material)


def taught(
    images: Described,
    *,
    classifier: str = "svm",
    seed: int = 0,
    reporter: Reporter | None = None,
    method: Method = METHODS["tuned"],
    learn: Callable = vlad.learn_encoder,
) -> Recogniser:
    """Learns dictionaries and classifier from training images that are described; parameters as of `train`.

    ``learn`` : makes the encoder of a sample of descriptors; parameters as of `vlad.learn_encoder`. It is not asked for
        a method whose dictionaries are ready.
    """
    reporter = reporter or Reporter()
    with reporter.stage("dictionaries"):
        encoder = vlad.ready_encoder() if method.ready else learned_encoder(images, method, seed, learn)
        vectors = [encoder.encode(d).astype(np.float16) for d in images.descriptors]
    return classified(
        encoder,
        vectors,
        images.materials,
        images.lights,
        classifier=classifier,
        seed=seed,
        reporter=reporter,
        method=method,
    )


def classified(
    encoder,
    vectors,
    materials,
    lights,
    *,
    classifier: str = "svm",
    seed: int = 0,
    reporter: Reporter | None = None,
    method: Method = METHODS["tuned"],
) -> Recogniser:
    """The recogniser of n training images' vectors, each (windows + 1, length) float16, their materials and lights."""
    reporter = reporter or Reporter()
    with reporter.stage("classifier"):
        classes = sorted(set(materials))
        of_object = np.repeat(np.arange(len(vectors)), len(vectors[0]))
        labels = np.searchsorted(classes, materials)
        model = CLASSIFIERS[classifier](
            np.concatenate(vectors),
            labels[of_object],
            np.asarray(lights)[of_object],
            of_object,
            classes,
            seed=seed,
            offsets=method.offsets,
            grid=method.grid,
            step=lambda fraction: reporter.progress("classifier", fraction),
        )
    return Recogniser(method.settings, encoder, model)


def train(
    samples: Iterable[TrainingImage],
    *,
    classifier: str = "svm",
    seed: int = 0,
    reporter: Reporter | None = None,
    method: Method = METHODS["tuned"],
    expected: int | None = None,
    known: dict | None = None,
    contents: dict | None = None,
) -> Recogniser:
    """Learns dictionaries and classifier from training images.

    Parameters
    ----------
    samples : consumed once, one image at a time
    classifier : "svm" or "nearest"
    method : Method
    expected : number of samples, for the progress only
    known : material -> its lights (M,) and vectors (M, windows + 1, length) float16, of an earlier training
        (`Recogniser.known_vectors`): its images need not be made again. Only where the method's dictionaries are ready
    contents : material -> text that says all that it is made of

    Raises
    ------
    InputError
        Unknown classifier, no sample, or an object too small.
    """
    if classifier not in CLASSIFIERS:
        raise InputError("the classifier", f"'{classifier}'", f"choose one of {', '.join(sorted(CLASSIFIERS))}")
    how = {"seed": seed, "reporter": reporter, "method": method}
    if not method.ready:
        return taught(described(samples, expected=expected, **how), classifier=classifier, **how)
    encoder = vlad.ready_encoder()
    every = (known or {}) | encoded(samples, encoder, expected=expected, **how)
    if not every:
        raise InputError("the training of recognition", "got no images", "choose a library with materials")
    rows = [(name, light, v) for name in sorted(every) for light, v in zip(*every[name], strict=True)]
    materials, lights, vectors = zip(*rows, strict=True)
    found = classified(encoder, vectors, materials, lights, classifier=classifier, **how)
    return replace(found, contents=tuple((contents or {}).get(name, "") for name in found.materials))


def learned_encoder(images: Described, method: Method, seed: int = 0, learn: Callable = vlad.learn_encoder):
    """Dictionaries from an equal number of descriptors of every image; ``learn`` : as of `taught`."""
    random = np.random.default_rng(seed)
    share = max(1, SAMPLE // len(images.descriptors))
    sample = dense.joined([d.picked(random.permutation(len(d))[:share]) for d in images.descriptors])
    return learn(sample, half_contrast=method.settings.contrast, encoding=method.encoding, seed=seed)
