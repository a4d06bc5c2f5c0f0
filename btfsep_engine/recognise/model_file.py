# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache of recognisers: arrays, and one JSON text for names, numbers and settings."""

import dataclasses
import functools
import json
import logging
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np

from btfsep_engine import __version__, cache, kept
from btfsep_engine.cache import digest
from btfsep_engine.errors import InputError
from btfsep_engine.lock import locked
from btfsep_engine.recognise.classifier import Nearest, Svm
from btfsep_engine.recognise.descriptors import Settings
from btfsep_engine.recognise.recogniser import Recogniser
from btfsep_engine.recognise.vlad import Dictionary, Encoder, Encoding

log = logging.getLogger("btfsep")
PATIENCE = 900.0  # seconds for which a training by another process is waited for
ENGINE = Path(__file__).resolve().parents[1]
# what a training runs through, from the geometry to the classifier
SOURCES = ("conventions.py", "images.py", "pipeline/recognition.py", "pipeline/scene.py", "sh.py")
ROOMS = ("btf", "job", "light", "recognise", "render")
OF_KIND = {"words": ("words", "axes"), "mean": ("numbers",), "axes": ("numbers", "axes")}  # of a Dictionary
SHAPES = {"header": cache.TEXT, "model.vectors": ("images", "length")}  # of an entry, see `cache.read`
SHAPES |= {f"{k}.{n}": tuple(f"{k} {size}" for size in of) for k in Encoding().kinds for n, of in OF_KIND.items()}


def _arrays(recogniser: Recogniser) -> dict:
    """All of a recogniser as arrays by name."""
    model, encoder = recogniser.model, recogniser.encoder
    of_model = {field.name: getattr(model, field.name) for field in dataclasses.fields(model)}
    arrays = {f"{kind}.{name}": a for kind, own in encoder.dictionaries.items() for name, a in vars(own).items()}
    header = {
        "settings": dataclasses.asdict(recogniser.settings),
        "encoding": dataclasses.asdict(encoder.encoding),
        "half_contrast": encoder.half_contrast,
        "kind": model.kind,
        "classes": list(model.classes),
        "numbers": {name: value for name, value in of_model.items() if isinstance(value, float)},
    }
    arrays |= {f"model.{name}": value for name, value in of_model.items() if isinstance(value, np.ndarray)}
    return {"header": np.array(json.dumps(header)), **arrays}


def _assembled(arrays: dict) -> Recogniser:
    """What :func:`_arrays` took apart."""
    header = json.loads(str(arrays["header"]))
    settings = Settings(**header["settings"] | {"bins": tuple(header["settings"]["bins"])})
    encoding = Encoding(**header["encoding"])
    learnt = {kind: Dictionary(**{name: arrays[f"{kind}.{name}"] for name in OF_KIND}) for kind in encoding.kinds}
    encoder = Encoder(learnt, header["half_contrast"], encoding)
    kind = {"svm": Svm, "nearest": Nearest}[header["kind"]]
    of_kind = {name.removeprefix("model."): value for name, value in arrays.items() if name.startswith("model.")}
    return Recogniser(settings, encoder, kind(classes=tuple(header["classes"]), **header["numbers"], **of_kind))


@functools.cache
def source_digest(engine: Path = ENGINE) -> str:
    """A key of the engine's version and of all code and constants that a training depends on: their source text."""
    files = [engine / name for name in SOURCES]
    files += (path for room in ROOMS for path in sorted((engine / room).rglob("*.py")))
    return digest(__version__, [(f.relative_to(engine).as_posix(), f.read_bytes()) for f in files])


def cached(key: str, make: Callable[[], Recogniser], *, folder=None) -> Recogniser:
    """The recogniser of ``key``: from the cache, or made now and put there.

    This process keeps it. A damaged or older file is replaced silently. Of several processes one trains, and the others
    wait for it: many jobs of one geometry train once. A cache that cannot be written is no error; the recogniser is
    made each time.

    Parameters
    ----------
    key : says all that the recogniser depends on beside the engine itself (`source_digest`); see :func:`cache.digest`
    make : trains it
    folder : instead of :func:`cache_folder`
    """
    name, folder = digest(source_digest(), key)[:32], Path(folder or cache.cache_folder())
    path = folder / "recognisers" / f"{name}.entry"
    return kept.recalled("recogniser", [str(path)], lambda: _read_or_made(path, make, folder / "locks" / name[:2]))


def _read_or_made(path: Path, make, lock: Path) -> Recogniser:
    if (found := _found(path)) is not None:
        return found
    with ExitStack() as alone:
        try:  # a lock for a few keys together: as many files would stay as there were trainings
            alone.enter_context(locked(lock, PATIENCE, name="the cache's"))
        except InputError as error:
            log.info("trained beside others, perhaps: %s", error)
        if (found := _found(path)) is not None:
            return found
        recogniser = make()
        try:
            cache.write(path, _arrays(recogniser))
        except InputError as error:
            log.info("recogniser not kept: %s", error)
    return recogniser


def _found(path: Path) -> Recogniser | None:
    """The recogniser of an entry, where there is one that is whole."""
    found = cache.read(path, SHAPES)
    if found is not None:
        with suppress(ValueError, KeyError, TypeError, AttributeError):  # whole, but not a recogniser
            return _assembled(found)
    return None
