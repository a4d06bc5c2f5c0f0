# SPDX-License-Identifier: GPL-3.0-or-later
"""How a pixel's misfit goes with how bright it is: what texture and albedo leave over is a part of the light there.

The misfit of a pixel that a light predicts to be m is taken to have the variance

    v g,    g = (1 - t) + t m^2 / <m^2>,

channel by channel, with t the same in all: 0 where all pixels misfit alike (a camera's noise, a shape), towards 1 where
the misfit is a factor (texture of which only the mean is known, albedo that nobody told). t is the most probable of
`SHARES`. Then what is dark counts for more than what is bright: a shadow says surely from where no light comes.
"""

import numpy as np

SHARES = (0.0, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.95)  # t


def precision(predicted, left, *, of, given, floor) -> np.ndarray:
    """1 over the variance of every value (p, 3), of mean 1 over ``given``.

    Parameters
    ----------
    predicted, left : (p, 3), m and the misfit
    of : (p,) bool, the pixels that the law is of; of others g is 1
    given : (p, 3) >= 0, 1 over the variance of each value beside that
    floor : (3,), the least variance
    """
    count = np.maximum(given.sum(0), 1e-300)
    square, misfit, ours = np.square(np.maximum(predicted, 0)), given * np.square(left), given * of[:, None]
    usual = (ours * square).sum(0) / np.maximum(ours.sum(0), 1e-300)
    part = np.where(of[:, None], square / np.maximum(usual, 1e-300), 1.0)

    def of_share(t):
        g = 1 - t + t * part
        variance = np.maximum((misfit / g).sum(0) / count * g, floor)
        return float((given * np.log(variance) + misfit / variance).sum()), variance

    _, variance = min((of_share(t) for t in SHARES), key=lambda each: each[0])
    return count / np.maximum((given / variance).sum(0), 1e-300) / variance
