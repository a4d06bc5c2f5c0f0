# SPDX-License-Identifier: GPL-3.0-or-later
"""The natural lights that recognition is trained under: real environment maps, made small.

They come with the engine (``data/lights``, ``data/README.md`` says where they are from) and are never used for
evaluation. One rule for their scale: the mean luminance over the sphere is 1 / pi, so that the luminance of the
irradiance, averaged over all orientations of a surface, is 1.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np

from btfsep_engine import sh
from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.light.lightings import EnvironmentMaps, turned

FOLDER = Path(__file__).resolve().parents[1] / "data" / "lights"


def read_map(path) -> np.ndarray:
    """Reads an environment map: (h, w, 3) float32, linear Rec.709.

    Raises InputError as :func:`images.read_linear`; or the image is not twice as wide as high, or has pixels that are
    not finite.
    """
    path = Path(path)
    pixels = images.read_linear(path).pixels
    h, w = pixels.shape[:2]
    if w != 2 * h:
        raise InputError(path.name, f"it has {w} x {h} pixels", "give an equirectangular map, twice as wide as high")
    bad = ~np.isfinite(pixels).all(-1)
    if bad.any():
        raise InputError(path.name, f"{int(bad.sum())} pixels are NaN or infinite", "export the map again")
    return pixels


@lru_cache(maxsize=4)
def training_lights(rotations: int = 4) -> EnvironmentMaps:
    """The natural lights of ``data/lights``, each at ``rotations`` evenly spaced turns about the vertical.

    Deterministic. The maps of one turn stand together: index = turn * number of maps + map; the names say the turn
    in degrees ("noon_grass@90"). Maps k of successive turns are offset a little against each other, so that no
    two maps have their turns in step.

    Gives EnvironmentMaps (rotations * number of maps, 64, 128, 3) float32. Raises InputError where there are none.
    """
    files = sorted(FOLDER.glob("*.exr"))
    if not files:
        raise InputError(f"training lights in {FOLDER}", "there are none", "install BTFsep again")
    maps, names = [], []
    loaded = [read_map(f) for f in files]
    for turn in range(rotations):
        for k, (file, radiance) in enumerate(zip(files, loaded, strict=True)):
            degrees = round(360 * (turn / rotations + k / (rotations * len(files))) / 2.8125) * 2.8125
            maps.append(turned(radiance, degrees))
            names.append(f"{file.stem}@{degrees:g}")
    stacked = np.stack(maps)
    stacked.setflags(write=False)  # it is cached and shared
    return EnvironmentMaps(stacked, tuple(names))


@lru_cache(maxsize=10)
def natural_amplitude(order: int) -> np.ndarray:
    """Typical size of each coefficient of natural light, relative to the first.

    The root mean square over the training lights, all channels and each band's terms; a band's terms share one value,
    as if light could be turned about any axis.

    Gives ((order + 1)^2,) float64, the first is 1.
    """
    x = np.moveaxis(training_lights().coefficients(order), 1, 0)
    relative = x / x[0].mean(-1, keepdims=True)
    out = np.ones(sh.term_count(order))
    for l in range(1, order + 1):
        band = slice(l * l, (l + 1) ** 2)
        out[band] = np.sqrt((relative[band] ** 2).mean())
    return out
