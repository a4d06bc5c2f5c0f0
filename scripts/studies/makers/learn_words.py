# SPDX-License-Identifier: GPL-3.0-or-later
"""Learns the dictionaries of visual words that recognition comes with (data/words.npz).

scripts/study learn-words FOLDER                   of the objects of `scripts/study learn-recognition FOLDER`

The words are those of the training images of these objects in all shipped materials, as many descriptors of each: by
k-means, 150 of colour patches and 250 of 40 principal components of SIFT (`recognise.vlad`). Photographs have no part
in them, and no object of the evaluation has (`scripts/study recognition`).
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from btfsep_engine.btf.library import open_library
from btfsep_engine.light.maps import training_lights
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.recognise.training import METHODS, Described, described, learned_encoder
from btfsep_engine.recognise.vlad import WORDS
from scripts.studies import parser, photos
from scripts.studies.descriptors import Trained
from scripts.studies.makers.learn_recognition import OBJECTS


def learned(folder: Path, objects) -> dict:
    """The arrays of the file, of one view of each of ``objects`` in ``folder``."""
    library, settings, every = open_library(), choose("balanced"), Described([], [], [])
    for name in objects:
        of_object = Trained(photos.photographs_in(folder, objects=[name])[:1], library, settings)
        images = described(of_object.rendered("natural", "BTFs"), seed=settings.seed)
        for own, more in zip(vars(every).values(), vars(images).values(), strict=True):
            own += more
        print(name, len(images.descriptors), "images of", training_lights(settings.training_turns).count, "lights")
    encoder = learned_encoder(every, replace(METHODS["tuned"], ready=False), settings.seed)
    arrays = {f"{kind}.{n}": array for kind, d in encoder.dictionaries.items() for n, array in vars(d).items()}
    return arrays | {"half_contrast": np.float64(encoder.half_contrast)}


def main(arguments) -> int:
    options = parser("learn-words", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--objects", nargs="+", default=OBJECTS)
    options.add_argument("--into", type=Path, default=WORDS)
    given = options.parse_args(arguments)
    np.savez(given.into, **learned(given.folder, given.objects))
    return 0
