# SPDX-License-Identifier: GPL-3.0-or-later
"""What each candidate explains of the photo under the light that it implies: recognition by re-rendering.

The classifier has seen the materials under its training lights, never under the photo's. But each candidate says what
that light is: the most probable one for its mean ABRDF and the photo's pixels. How probable that makes the photo is the
first cue, the evidence: a wrong candidate needs an unusual light, in shape or in colour. The BTF is then rendered under
that light, and described as the photo was; the cosines between both, of the colour patches and of SIFT, are the next:
a light that explains the shading does not explain the texture; and the last, how strong that is (`recognise.contrast`).
`recognise.judgement` says what all of it is worth.
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine.fit.log_normal import natural_light
from btfsep_engine.fit.products import Basis, Photograph
from btfsep_engine.light.lightings import SHBasis, SHLighting
from btfsep_engine.recognise.contrast import Contrast, contrast, unlike
from btfsep_engine.recognise.recogniser import Recogniser
from btfsep_engine.render.sampling import choose_pixels
from btfsep_engine.threads import one_thread

CANDIDATES = 8  # the first of the classifier's: others keep what the worst of these has
PIXELS = 1500  # of the fit of the light
ORDER = 9
SIMILARITIES = ("colour", "texture", "contrast", "skewness")
NOISE = 0.05  # of a rendering that is compared, relative to the mean: a photo has some


@dataclass(frozen=True)
class Explained:
    """The light under which a material explains a photo best.

    Attributes
    ----------
    light : SHLighting, in the photo's unit
    evidence : logarithm of how probable the photo is
    """

    light: SHLighting
    evidence: float


@dataclass(frozen=True)
class Photographed:
    """What candidates are compared with.

    Attributes
    ----------
    radiance : (h, w, 3), the window of the photograph, NaN where a pixel is unusable
    vector : (length,) VLAD of the whole object
    contrast : recognise.contrast.Contrast
    """

    radiance: np.ndarray
    vector: np.ndarray
    contrast: Contrast


class Verification:
    """The rays of one object, for as many photographs of it as there are.

    Parameters
    ----------
    scene : PreparedScene
    index : of the object
    region : (h, w) bool, pixels that recognition looks at
    window : two slices, the part of the photograph that holds ``region``
    settings : RecognitionSettings
    """

    def __init__(self, scene, index: int, region, window, settings):
        self.points = scene.points(index, region=region, textured=True)
        self.transport = scene.transport(self.points, directions=settings.training_directions)
        self.few = choose_pixels(self.points, PIXELS, seed=settings.seed)
        self.few_transport = scene.transport(self.points.take(self.few), directions=settings.training_directions)
        self.region, self.window, self.seed = region[window], window, settings.seed
        self._bases: dict = {}  # of the materials that were asked for: they are the same for every photo

    def cues(self, names, recogniser: Recogniser, radiance, vectors, load) -> dict:
        """{cue: (candidates,) float} of the materials ``names``, the classifier's likeliest first.

        Parameters
        ----------
        radiance : (h, w, 3), the window of the photograph, NaN where a pixel is unusable
        vectors : (windows + 1, length), VLAD of the photograph
        load : material name -> Material
        """
        photo, found = Photographed(radiance, vectors[-1], contrast(radiance, self.region)), []
        for name in names[:CANDIDATES]:
            material = load(name)
            explained = self.explained(material, radiance)
            # a mirror shows whatever light is asked of it: that it can look like the photo says nothing
            similar = (np.nan,) * len(SIMILARITIES)
            if material.mirror_reflectance is None:
                similar = self.similarity(material, explained.light, recogniser, photo)
            found.append((explained.evidence, *similar))
        evidence, *similar = np.array(found).T
        below = np.sqrt(np.maximum(evidence.max() - evidence, 0))  # half of a chi^2's size, of which a root is normal
        cues = zip(("evidence", *SIMILARITIES), (-below, *similar), strict=True)
        return {cue: _of_all(values, len(names)) for cue, values in cues}

    def explained(self, material, radiance) -> Explained:
        """What a material explains by its mean ABRDF of ``radiance`` (h, w, 3), the window of the photograph."""
        if material.name not in self._bases:
            self._bases[material.name] = self.few_transport.radiance(material.mean_material(), SHBasis(ORDER))
        rows, columns = (self.points.pixels[self.few] - [s.start for s in self.window]).T
        b = radiance[rows, columns]
        good = np.isfinite(b).all(-1)
        with one_thread():
            basis = Basis(self._bases[material.name][good], self.points.normal[self.few][good])
            photo = Photograph(basis, b[good])
            best = natural_light(photo, rounds=2)
        return Explained(SHLighting(best.x.T * photo.level), best.evidence)

    def similarity(self, material, light, recogniser: Recogniser, photo: Photographed) -> tuple[float, ...]:
        """`SIMILARITIES` of the photograph and a material under a light: cosines, -1 to 1, and differences, <= 0."""
        image = np.full((*self.region.shape, 3), np.nan, np.float32)
        image[self.region] = self.transport.radiance(material, light)[:, 0]
        usable = self.region & np.isfinite(photo.radiance).all(-1)
        image = np.where(usable[..., None], image, np.nan)
        differences = unlike(contrast(image, self.region), photo.contrast)
        mean = max(float(np.nanmean(image)), 1e-30)
        noise = np.random.default_rng(self.seed).standard_normal(image.shape, np.float32)
        image = np.maximum(image + NOISE * np.sqrt(np.maximum(image, 0) * mean) * noise, 1e-4 * mean)
        cosines = recogniser.encoder.cosines(recogniser.describe(image, self.region)[-1], photo.vector)
        return *cosines, *(-value for value in differences)


def _of_all(values, count: int) -> np.ndarray:
    """Of ``count`` candidates: the first ones' ``values``, their mean where NaN, the lowest for those not looked at."""
    known = np.isfinite(values)
    if not known.any():
        return np.zeros(count)
    out = np.full(count, np.nanmin(values))
    out[: len(values)] = np.where(known, values, np.nanmean(values))
    return out
