# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a candidate looks like the photo under the light that it implies: recognition by re-rendering.

The classifier has seen the materials under its training lights, never under the photo's. But each candidate says what
that light is: its mean ABRDF is fitted to the photo's pixels, the BTF is rendered under the light that comes out, and
the rendering is described as the photo was. With s the cosine between the two VLAD vectors of the whole object, a
candidate's score becomes proportional to score · exp(WEIGHT s). A wrong candidate gets a light that explains the
shading with its own colour, and is betrayed by its texture; a right one is seen under the right light.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.log_normal import LightSolver
from btfsep_engine.light.lightings import SHBasis, SHLighting
from btfsep_engine.recognise.recogniser import Recogniser, Recognition
from btfsep_engine.render.sampling import choose_pixels

WEIGHT = 10.0  # of the cosine against the logarithm of the classifier's score
LARGEST_GAIN = 0.5  # in cosine that is to be expected between two candidates
CANDIDATES = 6
PIXELS = 1500  # of the fit of the light
ORDER = 9
NOISE = 0.05  # of a rendering that is compared, relative to the mean: a photo has some


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

    def verified(self, answer: Recognition, recogniser: Recogniser, radiance, described, load) -> Recognition:
        """The answer with its candidates' scores weighed anew; that of the classifier alone where it is certain.

        Parameters
        ----------
        answer : Recognition by the classifier
        radiance : (h, w, 3), the window of the photograph, NaN where a pixel is unusable
        described : (length,) VLAD vector of the whole object in the photograph
        load : material name -> Material
        """
        hopeless = answer.candidates[0][1] * np.exp(-WEIGHT * LARGEST_GAIN)
        asked = {name: load(name) for name, score in answer.candidates[:CANDIDATES] if score > hopeless}
        if len(asked) < 2:
            return answer
        # a mirror shows whatever light is asked of it: that it can look like the photo says nothing
        similar = {
            name: self.similarity(material, recogniser, radiance, described)
            for name, material in asked.items()
            if material.mirror_reflectance is None
        }
        if not similar:
            return answer
        best = max(similar.values())
        similar = dict.fromkeys(asked, float(np.mean(list(similar.values())))) | similar
        weighed = [
            (name, score * np.exp(WEIGHT * (similar[name] - best)) if name in similar else 0.0)
            for name, score in answer.candidates
        ]
        total = sum(score for _, score in weighed)
        candidates = tuple(sorted(((name, float(s / total)) for name, s in weighed), key=lambda c: -c[1]))
        return replace(answer, material=candidates[0][0], candidates=candidates)

    def similarity(self, material, recogniser: Recogniser, radiance, described) -> float:
        """Cosine, -1 to 1, between the photograph and the material under the light that it takes the photo's to be."""
        image = np.full((*self.region.shape, 3), np.nan, np.float32)
        image[self.region] = self.transport.radiance(material, self.light(material, radiance))[:, 0]
        rng = np.random.default_rng(self.seed)
        mean = max(float(np.nanmean(image)), 1e-30)
        noise = NOISE * np.sqrt(np.maximum(image, 0) * mean) * rng.standard_normal(image.shape, np.float32)
        image = np.maximum(image + noise, 1e-4 * mean)
        usable = self.region & np.isfinite(radiance).all(-1)
        vector = recogniser.describe(np.where(usable[..., None], image, np.nan), self.region)[-1]
        return float(vector @ described)

    def light(self, material, radiance) -> SHLighting:
        """The light under which a material explains the photograph best, by its mean ABRDF."""
        mean = material.mean_material()
        rows, columns = (self.points.pixels[self.few] - [s.start for s in self.window]).T
        b = radiance[rows, columns]
        good = np.isfinite(b).all(-1)
        basis = self.few_transport.radiance(mean, SHBasis(ORDER))[good]
        fit = LightSolver(basis, normals=self.points.normal[self.few][good], order=ORDER).solve(b[good])
        return SHLighting(fit.shown)
