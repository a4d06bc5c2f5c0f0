# SPDX-License-Identifier: GPL-3.0-or-later
"""A recogniser in one file, and the cache of recognisers.

The file is a NumPy ``.npz`` without pickled objects: arrays, and one JSON text for names, numbers and settings.
Whatever does not fit is refused with an InputError.
"""

import dataclasses
import functools
import hashlib
import json
import logging
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from btfsep_engine import __version__, atomic, cache
from btfsep_engine.errors import InputError
from btfsep_engine.recognise.classifier import Nearest, Svm
from btfsep_engine.recognise.descriptors import Settings
from btfsep_engine.recognise.recogniser import Recogniser
from btfsep_engine.recognise.vlad import Encoder, Encoding

log = logging.getLogger("btfsep")
FORMAT = "btfsep-recogniser"
VERSION = 3
ENGINE = Path(__file__).resolve().parents[1]
# what a training runs through, from the geometry to the classifier
SOURCES = ("conventions.py", "images.py", "pipeline/recognition.py", "pipeline/scene.py", "sh.py")
ROOMS = ("btf", "job", "light", "recognise", "render")


def save(path, recogniser: Recogniser) -> None:
    """Writes ``recogniser`` to ``path`` (.npz), whole or not at all. InputError where it cannot be written."""
    with atomic.replacing(path) as scratch, open(scratch, "wb") as file:
        np.savez(file, **_arrays(recogniser))


def _arrays(recogniser: Recogniser) -> dict:
    """All of a recogniser as arrays by name."""
    model, encoder = recogniser.model, recogniser.encoder
    arrays = {
        "encoder.colour": encoder.colour,
        "encoder.sift": encoder.sift,
        "encoder.sift_mean": encoder.sift_mean,
        "encoder.sift_axes": encoder.sift_axes,
        "model.vectors": model.vectors,
    }
    header = {
        "format": FORMAT,
        "version": VERSION,
        "settings": dataclasses.asdict(recogniser.settings),
        "encoding": dataclasses.asdict(encoder.encoding),
        "half_contrast": encoder.half_contrast,
        "kind": model.kind,
        "classes": list(model.classes),
        "sharpness": model.sharpness,
        "held_out_accuracy": model.held_out_accuracy,
        "known_vote": model.known_vote,
    }
    if isinstance(model, Svm):
        header |= {"gamma": model.gamma, "c": model.c}
        arrays |= {"model.weights": model.weights, "model.bias": model.bias}
    else:
        arrays["model.labels"] = model.labels
    return {"header": np.array(json.dumps(header)), **arrays}


def load(path) -> Recogniser:
    """Reads a recogniser.

    Raises
    ------
    InputError
        No such file, not one of ours, another version, damaged, or arrays that do not fit each other.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as archive:
            header = json.loads(str(archive["header"][()]))
            if header["format"] != FORMAT or header["version"] != VERSION:
                raise _bad(path, f"is {header['format']} version {header['version']}, not {FORMAT} version {VERSION}")
            arrays = {name: archive[name] for name in archive.files if name != "header"}
        return _assemble(header, arrays)
    except FileNotFoundError as error:
        raise InputError(f"{path}", "no such file", "run 'btfsep train' first") from error
    except OSError as error:
        raise _bad(path, error.strerror or "cannot be read") from error
    except (ValueError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise _bad(path, "is damaged or not a recogniser") from error


def _bad(path, got):
    return InputError(f"{path}", got, "delete it and run 'btfsep train' again")


def _assemble(header, arrays) -> Recogniser:
    """A Recogniser of what a file held; ValueError, KeyError or TypeError where it does not fit."""

    def array(name, *shape):
        a = arrays[name]
        fits = a.ndim == len(shape) and all(want in (None, n) for want, n in zip(shape, a.shape, strict=True))
        if not fits or a.dtype.kind not in "fi" or not np.isfinite(a).all():
            raise ValueError(f"{name} has shape {a.shape} and type {a.dtype}")
        return a

    settings = Settings(**header["settings"] | {"bins": tuple(int(b) for b in header["settings"]["bins"])})
    encoding = Encoding(**header["encoding"])
    colour = array("encoder.colour", encoding.colour_words, None)
    sift = array("encoder.sift", encoding.sift_words, None)
    mean = array("encoder.sift_mean", None)
    axes = array("encoder.sift_axes", len(mean), sift.shape[1])
    encoder = Encoder(colour, sift, mean, axes, float(header["half_contrast"]), encoding)
    classes = tuple(str(name) for name in header["classes"])
    if not classes or len(set(classes)) < len(classes):
        raise ValueError("names of materials are missing or repeat")
    vectors = array("model.vectors", None, encoder.length)
    common = {name: float(header[name]) for name in ("sharpness", "held_out_accuracy", "known_vote")}
    if not common["sharpness"] > 0 or not -1 <= common["known_vote"] <= 1:
        raise ValueError("numbers out of range")
    if header["kind"] == "svm":
        pairs = len(classes) * (len(classes) - 1) // 2
        weights, bias = array("model.weights", len(vectors), pairs), array("model.bias", pairs)
        model = Svm(classes, vectors, weights, bias, float(header["gamma"]), float(header["c"]), **common)
    elif header["kind"] == "nearest":
        labels = array("model.labels", len(vectors))
        if len(labels) and not (0 <= labels.min() and labels.max() < len(classes)):
            raise ValueError("labels out of range")
        model = Nearest(classes, vectors, labels, **common)
    else:
        raise ValueError(f"unknown classifier {header['kind']}")
    return Recogniser(settings, encoder, model)


def digest(*parts) -> str:
    """A key of content: texts, numbers, dataclasses, bytes, arrays, None, and lists and tuples of these."""
    h = hashlib.sha256()

    def feed(part):
        if isinstance(part, np.ndarray):
            data = np.ascontiguousarray(part)
            h.update(f"array {data.dtype.str} {data.shape};".encode())
            h.update(data.tobytes())
        elif isinstance(part, bytes):
            h.update(f"bytes {len(part)};".encode() + part)
        elif isinstance(part, list | tuple):
            h.update(f"list {len(part)};".encode())
            for item in part:
                feed(item)
        elif part is None or isinstance(part, str | int | float | bool):
            h.update(f"{type(part).__name__} {part!r};".encode())
        elif dataclasses.is_dataclass(part):
            h.update(f"{type(part).__name__};".encode())
            feed([item for f in dataclasses.fields(part) for item in (f.name, getattr(part, f.name))])
        else:
            raise TypeError(f"no digest of a {type(part).__name__}")

    feed(list(parts))
    return h.hexdigest()


@functools.cache
def source_digest(engine: Path = ENGINE) -> str:
    """A key of the engine's version and of all code and constants that a training depends on: their source text."""
    files = [engine / name for name in SOURCES]
    files += (path for room in ROOMS for path in sorted((engine / room).rglob("*.py")))
    return digest(__version__, [(f.relative_to(engine).as_posix(), f.read_bytes()) for f in files])


def cached(key: str, make: Callable[[], Recogniser], *, folder=None) -> Recogniser:
    """The recogniser of ``key``: from the cache, or made now and put there.

    A damaged or older file is replaced silently. Two processes may do it at once: both may train, each file
    appears whole, the last one stays. A cache that cannot be written is no error; the recogniser is made each time.

    Parameters
    ----------
    key : says all that the recogniser depends on beside the engine itself (`source_digest`); see :func:`digest`
    make : trains it
    folder : instead of :func:`cache_folder`
    """
    name = digest(FORMAT, VERSION, source_digest(), key)[:32]
    path = Path(folder or cache.cache_folder()) / "recognisers" / f"{name}.entry"
    kept = cache.read(path)
    if kept is not None:
        return _assemble(json.loads(str(kept["header"])), kept)
    recogniser = make()
    try:
        cache.write(path, _arrays(recogniser))
    except InputError as error:
        log.info("recogniser not kept: %s", error)
    return recogniser
