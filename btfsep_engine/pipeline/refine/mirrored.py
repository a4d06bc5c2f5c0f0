# SPDX-License-Identifier: GPL-3.0-or-later
"""What is stated of the light by the picture of a mirror: how bright what is clipped in it is, and where it stands.

The fit knows nothing of either: the picture that it gets is put together of the mirror's, smooth and without a gap.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.stated import restated

WORDS = (
    "what mirrors shows the light itself: all that it shows was put together, and the light is the one that goes with "
    "what a rougher metal would show in its place"
)
CLIPPED = (
    "lamps are clipped in what mirrors: how bright they are is guessed by what natural light is like; give a photo "
    "that is exposed for them"
)
BY_TABLE = "; lamps that are clipped in it are as bright as the table beside it shows"


def mirrored(model, light):
    """The refinement: wider ranges by what is left open of the light that mirrors show."""
    mirror_lights = [each for problem in model.problems for each in problem.scene.mirror_lights]
    if not mirror_lights:
        return model, light, {}
    clipped = [each.lamps for each in mirror_lights if each.clipped.any()]
    if not all(lamps.by_table for lamps in clipped):
        model.reporter.warn(CLIPPED)
    words = {"mirrors": WORDS + BY_TABLE * any(lamps.by_table for lamps in clipped)}
    if light.fit.samples is None:
        return model, light, words
    samples, random = light.fit.samples.copy(), np.random.default_rng(model.settings.seed)
    for each in mirror_lights:  # of several mirrors each says as much of the light
        samples += each.spread(len(samples), random)[:, : samples.shape[1]] / np.sqrt(len(mirror_lights))
    return model, replace(light, fit=restated(light.fit, samples)), words
