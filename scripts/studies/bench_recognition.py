# SPDX-License-Identifier: GPL-3.0-or-later
"""What recognition costs with libraries of several sizes: a new object, one more material, a photograph.

scripts/study bench-recognition FOLDER                photographs, of `scripts/study recognition`
scripts/study bench-recognition FOLDER --sizes 14 42

Materials beyond the library's are its own under other names. Of each size: the training of an object that has not been
seen; that of the same object after one more material has come (the last by name); and the answers to photographs of it
in one material, the first of a process and the median of the others, nothing of the fit of the light. The preset is
balanced, the cache is empty at first. Seconds are by the clock, and of all processors together: those hardly depend on
what else the machine does.
"""

import os
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import sklearn.svm  # noqa: F401  its import takes 3 seconds, of a process and not of a training

from btfsep_engine.btf.library import open_library
from btfsep_engine.pipeline.recognition import recognise_object, trained_recogniser
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.storage import cache, kept
from scripts.studies import parser, photos, tables
from scripts.studies.estimates import scene_of
from scripts.studies.measures import timed
from scripts.studies.recognition import OBJECTS


def looked_at(photograph) -> PreparedScene:
    """A photograph's scene; what each pixel sees is found beforehand: it is no part of recognition."""
    scene = scene_of(photograph.folder, uv="xatlas")
    _ = scene.regions
    return scene


def costs(photographs, library, settings) -> list:
    """(2,) seconds of each: a new object, one more material, the first photograph, the median of the others."""
    kept.STORE.forget()
    scene = looked_at(photographs[0])
    names = list(library.entries)
    before = replace(library, entries={name: library.entries[name] for name in names[:-1]})
    trainings = [timed(partial(trained_recogniser, scene, 0, some, settings))[0] for some in (before, library)]
    answers = [timed(partial(recognise_object, looked_at(p), 0, library, settings))[0] for p in photographs]
    return [*trainings, answers[0], np.median(answers[1:], axis=0)]


def of_size(library, size: int):
    """A library with so many materials, spread over its own; of more than it has, each under several names."""
    names = list(library.entries)
    if size <= len(names):
        chosen = [names[i] for i in np.linspace(0, len(names) - 1, size).round().astype(int)]
        return replace(library, entries={name: library.entries[name] for name in chosen})
    every = [(name, f"{name}-{turn}" if turn else name) for turn in range(-(-size // len(names))) for name in names]
    entries = {other: library.entries[name].model_copy(update={"name": other}) for name, other in every[:size]}
    return replace(library, entries=entries)


def main(arguments) -> int:
    options = parser("bench-recognition", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--library", type=Path, help="the shipped one by default")
    options.add_argument("--sizes", type=int, nargs="+", default=[14], help="materials")
    options.add_argument("--object", default=OBJECTS[0])
    given = options.parse_args(arguments)
    every, settings = open_library(given.library), choose("balanced")
    some = photos.photographs_in(given.folder, objects=[given.object])
    some = [p for p in some if p.shown == some[0].shown]  # in another material its outline, and so its mask, is another
    rows = []
    for size in given.sizes:
        library = of_size(every, size)
        with tempfile.TemporaryDirectory() as folder:
            os.environ[cache.ENVIRONMENT] = folder
            rows.append([size, *(f"{clock:.1f} ({work:.1f})" for clock, work in costs(some, library, settings))])
        print(rows[-1], flush=True)
    heads = ["materials", "a new object, one material less", "one more material", "the first photo", "others"]
    print(f"\nseconds by the clock (of all processors); {given.object}\n\n" + tables.table(heads, rows))
    return 0
