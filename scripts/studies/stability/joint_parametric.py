# SPDX-License-Identifier: GPL-3.0-or-later
"""One homogeneous parametric BRDF and the light at once, after Lombardi and Nishino.

"Reflectance and Natural Illumination from a Single Image" (ECCV 2012), "Reflectance and Illumination Recovery in the
Wild" (PAMI 2016). What is theirs: the most probable pair of a reflectance with few parameters and a light without any,
under three priors. Reflectance blurs light and so raises its entropy: the light is to have little; its gradients are
heavy-tailed, as natural images' are; the parameters of the reflectance stay near those of real materials.

What is simpler here: the reflectance is a diffuse colour with one GGX lobe (as in Blender's or Disney's principled
BRDF) instead of the directional statistics BRDF, and its prior is a Gaussian instead of one learned from measured
materials; the entropy is that of the light as a distribution over directions; gradients are those of log radiance.
Scale and colour, which the two can hand to each other, are settled by a Gaussian on the colour of the light's mean.
All unknowns go downhill together (L-BFGS with the exact gradient) from several roughnesses, the best of them until the
energy stalls. `NOISE` is the value with which the converged fits of the study's undisturbed
photographs err least: it has been given more than an unknown photograph would give it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from scripts.studies.stability.lobes import COLUMNS, ROWS

ALPHAS = tuple(np.geomspace(0.06, 1.0, 9))  # between them the lobe is interpolated
STARTS = (0.12, 0.3, 0.6)
NOISE = 0.06  # of the photograph's root mean square: what the model may miss
GRADIENT_WEIGHT, GRADIENT_POWER, GRADIENT_FLOOR = 1.0, 0.8, 0.05
ENTROPY_WEIGHT = 40.0
LOG_ALPHA, LOG_ALPHA_SPREAD = np.log(0.3), 0.8
LOG_SPECULAR_SPREAD = 1.5  # of the lobe's strength over the diffuse albedo, about that of F0 0.04
COLOUR_SPREAD = 0.15  # of the logarithm of the colour of the light's mean
WIDEST = 1e4  # between the brightest cell of the light and its start; a guard, not a prior
FIRST, MOST = 300, 4000  # iterations from every start, and, a guard, from the best
STALLED = 1e-8  # relative change of the energy that ends a descent


@dataclass(frozen=True)
class Joint:
    """light : (cells, 3); diffuse : (3,); specular, alpha : float; energy, residual (relative) : float."""

    light: np.ndarray
    diffuse: np.ndarray
    specular: float
    alpha: float
    energy: float
    residual: float


class Energy:
    """The negative logarithm of the posterior, and its gradient.

    The unknowns are one vector: log radiance (cells * 3), log diffuse (3), log of the light's colour (3),
    log specular, log alpha.

    Parameters
    ----------
    diffuse : (p, cells), `lobes.Seen.lambert`
    glossy : list of (p, cells), `lobes.Seen.ggx` of `ALPHAS`
    radiance : (p, 3)
    noise : of its root mean square, what the model may miss
    """

    def __init__(self, diffuse, glossy, radiance, *, noise: float = NOISE):
        self.d = np.ascontiguousarray(diffuse, np.float32)
        self.s = [np.ascontiguousarray(g, np.float32) for g in glossy]
        self.b = np.asarray(radiance, np.float64)
        self.cells = self.d.shape[1]
        self.noise = noise * np.sqrt((self.b**2).mean()) * np.sqrt(len(self.b) / 500)  # pixels are not independent
        self.scale = float(self.b.mean() / np.maximum((self.d @ np.ones(self.cells, np.float32)).mean(), 1e-9))

    def start(self, alpha: float) -> np.ndarray:
        """A white, even light and the photograph's mean colour."""
        colour = np.log(np.maximum(self.b.mean(0) / max(self.b.mean(), 1e-300), 1e-3) * self.scale)
        return np.concatenate([np.zeros(3 * self.cells), colour, np.zeros(3), [np.log(self.scale)], [np.log(alpha)]])

    def unpack(self, x):
        """light (cells, 3) of mean 1, diffuse (3,), colour (3,), specular, alpha."""
        raw = np.exp(x[: 3 * self.cells].reshape(self.cells, 3))
        tail = x[3 * self.cells :]
        return raw / raw.mean(0), np.exp(tail[:3]), np.exp(tail[3:6]), float(np.exp(tail[6])), float(np.exp(tail[7]))

    def lobe(self, alpha: float):
        """Number of the lower table, the share of the upper one, and its derivative by log alpha."""
        logs = np.log(ALPHAS)
        i = int(np.clip(np.searchsorted(logs, np.log(alpha)) - 1, 0, len(logs) - 2))
        t = (np.log(alpha) - logs[i]) / (logs[i + 1] - logs[i])
        return i, float(np.clip(t, 0, 1)), (1 / (logs[i + 1] - logs[i]) if 0 <= t <= 1 else 0.0)

    def predicted(self, x) -> np.ndarray:
        """The photograph (p, 3) of the unknowns."""
        light, diffuse, colour, specular, alpha = self.unpack(x)
        i, t, _ = self.lobe(alpha)
        light = light.astype(np.float32)
        shine = (1 - t) * (self.s[i] @ light) + t * (self.s[i + 1] @ light)
        return colour * (diffuse * (self.d @ light) + specular * shine)

    def __call__(self, x):
        """Energy and gradient at ``x``."""
        light, diffuse, colour, specular, alpha = self.unpack(x)
        i, t, slope = self.lobe(alpha)
        single = light.astype(np.float32)
        matte, low, high = (m @ single for m in (self.d, self.s[i], self.s[i + 1]))
        shine = (1 - t) * low + t * high
        body = diffuse * matte + specular * shine
        r = (colour * body - self.b) / self.noise**2
        energy = 0.5 * float((r * (colour * body - self.b)).sum())
        back = (r * colour).astype(np.float32)
        by_light = (self.d.T @ (back * diffuse.astype(np.float32))).astype(np.float64)
        by_light += specular * (self.s[i].T @ ((1 - t) * back) + self.s[i + 1].T @ (t * back))
        by_diffuse = (back * matte).sum(0) * diffuse
        by_colour = (r * body).sum(0) * colour
        by_specular = float((back * shine).sum()) * specular
        by_alpha = float((back * (high - low)).sum()) * specular * slope

        tail = x[3 * self.cells :]
        centred = tail[3:6]
        ratio = tail[6] - np.log(diffuse.mean())
        lean = tail[7] - LOG_ALPHA
        energy += 0.5 * float((centred**2).sum()) / COLOUR_SPREAD**2
        energy += 0.5 * (ratio / LOG_SPECULAR_SPREAD) ** 2 + 0.5 * (lean / LOG_ALPHA_SPREAD) ** 2
        by_colour = by_colour + centred / COLOUR_SPREAD**2
        by_specular += ratio / LOG_SPECULAR_SPREAD**2
        by_diffuse = by_diffuse - ratio / LOG_SPECULAR_SPREAD**2 * diffuse / diffuse.sum()
        by_alpha += lean / LOG_ALPHA_SPREAD**2

        # light = exp(l) / mean exp(l): d light_i / d l_j = light_i (delta_ij - light_j / cells)
        prior, by_log, by_share = _light_prior(x[: 3 * self.cells].reshape(self.cells, 3), light / self.cells)
        total = light * by_light + by_share
        total = total - light / self.cells * total.sum(0) + by_log
        return energy + prior, np.concatenate([total.ravel(), by_diffuse, by_colour, [by_specular], [by_alpha]])


def _light_prior(log_light, share):
    """Energy of the gradients and of the entropy.

    Parameters
    ----------
    log_light : (cells, 3); share : (cells, 3), the part of the light that comes from each cell, columns sum to 1

    Returns
    -------
    energy, its gradient by the log radiance, and (share times) its gradient by the share
    """
    grid = log_light.reshape(ROWS, COLUMNS, 3)
    gradient = np.zeros_like(grid)
    energy = 0.0
    down, right = np.diff(grid, axis=0), np.roll(grid, -1, 1) - grid  # the rows are rings, and close
    for difference, axis in ((down, 0), (right, 1)):
        square = difference**2 + GRADIENT_FLOOR**2
        energy += GRADIENT_WEIGHT * float((square ** (GRADIENT_POWER / 2)).sum())
        slope = GRADIENT_WEIGHT * GRADIENT_POWER * square ** (GRADIENT_POWER / 2 - 1) * difference
        if axis == 0:
            gradient[:-1] -= slope
            gradient[1:] += slope
        else:
            gradient += np.roll(slope, 1, 1) - slope
    logs = np.log(np.maximum(share, 1e-300))
    energy -= ENTROPY_WEIGHT * float((share * logs).sum())
    return energy, gradient.reshape(log_light.shape), -ENTROPY_WEIGHT * share * (logs + 1)


@threadpool_limits.wrap(limits=1, user_api="blas")  # small products: more threads wait for each other
def fit(diffuse, glossy, radiance, **noise) -> Joint:
    """The most probable reflectance and light; parameters as of `Energy`."""
    energy = Energy(diffuse, glossy, radiance, **noise)
    level, widest = np.log(energy.scale), np.log(WIDEST)
    bounds = [(-widest, widest)] * (3 * energy.cells)
    bounds += [(level - widest, level + widest)] * 3 + [(-1, 1)] * 3  # diffuse, colour of the light
    bounds += [(level - widest / 2, level + widest / 2), (np.log(ALPHAS[0]), 0.0)]  # specular, alpha

    def downhill(x, most):
        options = {"maxiter": most, "maxfun": 2 * most, "maxcor": 20, "ftol": STALLED, "gtol": 0.0}
        return minimize(energy, x, jac=True, method="L-BFGS-B", bounds=bounds, options=options)

    best = min((downhill(energy.start(alpha), FIRST) for alpha in STARTS), key=lambda found: found.fun)
    best = downhill(best.x, MOST)
    light, albedo, colour, specular, alpha = energy.unpack(best.x)
    left = energy.predicted(best.x) - energy.b
    residual = float(np.linalg.norm(left) / np.linalg.norm(energy.b))
    return Joint(light * colour, albedo, specular, alpha, float(best.fun), residual)
