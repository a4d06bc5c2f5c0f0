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

from btfsep_engine import __version__
from btfsep_engine.errors import InputError
from btfsep_engine.recognise.classifier import Nearest, Svm
from btfsep_engine.recognise.descriptors import Settings
from btfsep_engine.recognise.recogniser import Recogniser
from btfsep_engine.recognise.vlad import Dictionary, Encoder, Encoding
from btfsep_engine.storage import cache, kept
from btfsep_engine.storage.cache import digest
from btfsep_engine.storage.lock import locked

log = logging.getLogger("btfsep")
HALF = 16  # digits of an entry's name for the view, and as many for all
LOOKED_AT = 3  # trainings of the same view in which materials are looked for: each is read whole
PATIENCE = 900.0  # seconds for which a training by another process is waited for
ENGINE = Path(__file__).resolve().parents[1]
# what a training runs through, from the geometry to the classifier
SOURCES = ("conventions.py", "linear_algebra.py", "pipeline/recognition.py", "pipeline/scene.py", "sh.py")
ROOMS = ("btf", "imaging", "job", "light", "recognise", "render")
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
        "contents": list(recogniser.contents),
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
    model = kind(classes=tuple(header["classes"]), **header["numbers"], **of_kind)
    return Recogniser(settings, encoder, model, tuple(header["contents"]))


@functools.cache
def source_digest(engine: Path = ENGINE) -> str:
    """A key of the engine's version and of all code and constants that a training depends on: their source text."""
    files = [engine / name for name in SOURCES]
    files += (path for room in ROOMS for path in sorted((engine / room).rglob("*.py")))
    return digest(__version__, [(f.relative_to(engine).as_posix(), f.read_bytes()) for f in files])


def cached(key: str, make: Callable[[], Recogniser], *, view: str = "", folder=None) -> Recogniser:
    """The recogniser of ``key``: from the cache, or made now and put there.

    This process keeps it. A damaged or older file is replaced silently. Of several processes one trains, and the others
    wait for it: many jobs of one geometry train once. A cache that cannot be written is no error; the recogniser is
    made each time.

    Parameters
    ----------
    key : says all that the recogniser depends on beside the engine itself (`source_digest`); see :func:`cache.digest`
    make : trains it
    view : says all of that but the materials: by it others are found that know some of them (`known_materials`)
    folder : instead of :func:`cache_folder`
    """
    name, folder = digest(source_digest(), key)[:HALF], Path(folder or cache.cache_folder())
    path = folder / "recognisers" / f"{_of_view(view)}{name}.entry"
    return kept.recalled("recogniser", [str(path)], lambda: _read_or_made(path, make, folder / "locks" / name[:2]))


def known_materials(view: str, contents: dict) -> dict:
    """Material -> its training vectors, of the latest recognisers of a ``view``, as of :func:`cached`.

    ``contents`` : material -> text; what is known of it is of use where it was the same
    """
    known: dict = {}
    for entry in _latest(cache.cache_folder() / "recognisers", _of_view(view)):
        missing = {name: content for name, content in contents.items() if name not in known}
        if missing and (found := _found(entry)) is not None:
            with suppress(ValueError):  # whole, but of other sizes
                known |= found.known_vectors(missing)
    return known


def _of_view(view: str) -> str:
    return digest(source_digest(), view)[:HALF]


def _latest(folder: Path, name: str) -> list[Path]:
    """The entries that begin with ``name`` and were used last, at most `LOOKED_AT`."""
    found = []
    for entry in folder.glob(f"{name}*.entry"):
        with suppress(OSError):  # another process may have removed it
            found.append((-entry.stat().st_mtime_ns, entry))
    return [entry for _, entry in sorted(found)[:LOOKED_AT]]


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
