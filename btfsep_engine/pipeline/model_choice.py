# SPDX-License-Identifier: GPL-3.0-or-later
"""Which model the fit uses, and why: no more than the scene needs, in words for ``result.json``.

Of two models the richer one is taken only where it predicts the photo better by more than one standard error, which
is counted over blocks of neighbouring pixels (misfit is structured, pixels are no independent witnesses).
"""

import numpy as np
from scipy.ndimage import uniform_filter

from btfsep_engine.fit.least_squares import solve
from btfsep_engine.fit.stated import Fit

VISIBLE_CONTRAST = 0.05  # of the texture as the camera resolves it: less is not worth a second transport
FOLDS = 5


def texture_contrast(material, footprint_mm: float) -> float:
    """Relative standard deviation of a material's brightness from place to place, seen by pixels of a footprint.

    0 for a material without texture.
    """
    if not material.has_texture:
        return 0.0
    brightness = material.texels @ material.angular.mean((0, 1, 2))
    size = max(1, round(footprint_mm / material.texel_mm))
    if size >= max(brightness.shape):
        return 0.0
    seen = uniform_filter(brightness.astype(np.float64), size, mode="wrap")
    return float(seen.std() / max(abs(seen.mean()), 1e-30))


def texture_may_help(obj, material, footprint_mm: float) -> tuple[bool, str]:
    """Whether fitting the BTF with its texture is worth trying for an object, and why not."""
    if not material.has_texture:
        return False, f"{material.name} has no texture"
    if material.lines_up:
        return False, "an image in the mesh's own UVs lines up and is used"
    if obj.uv != "mesh":
        return False, "computed charts cannot line up with the photo's texture"
    contrast = texture_contrast(material, footprint_mm)
    if contrast < VISIBLE_CONTRAST:
        return False, f"the camera does not resolve it (contrast {100 * contrast:.0f} %)"
    return True, f"the camera resolves it (contrast {100 * contrast:.0f} %)"


def better_by_blocks(simple, rich, blocks) -> tuple[float, float]:
    """How much less squared misfit the richer model leaves: the mean over blocks, and its standard error.

    Parameters
    ----------
    simple, rich : (p, 3), what each leaves over of the photo
    blocks : (p,) int
    """
    _, labels, counts = np.unique(blocks, return_inverse=True, return_counts=True)
    gain = (np.square(simple) - np.square(rich)).sum(1)
    each = np.bincount(labels.reshape(-1), gain) / counts
    if len(each) < 2:
        return float(each.mean()), np.inf
    mean = np.average(each, weights=counts)
    spread = np.sqrt(np.average((each - mean) ** 2, weights=counts) / (len(each) - 1))
    return float(mean), float(spread)


def appearance_choice(simple, rich, blocks) -> tuple[str, str]:
    """ "mean" or "textured", and the reason, from what both leave over (see `better_by_blocks`)."""
    mean, error = better_by_blocks(simple, rich, blocks)
    total = float(np.square(simple).sum() / max(len(simple), 1))
    share = 100 * mean / max(total, 1e-300)
    if mean > error:
        return "textured", f"the texture explains {share:.0f} % of what the mean ABRDF leaves over"
    return "mean", (
        f"with its texture the fit is not better by more than one standard error ({share:+.0f} % of the misfit)"
    )


def determined_order(determined) -> int:
    """The highest order of which something is determined: (terms,) bool -> L, at least 1 where there is one."""
    known = np.flatnonzero(determined)
    highest = int(np.sqrt(known.max())) if len(known) else 0
    return max(highest, min(1, int(np.sqrt(len(determined))) - 1))


def cross_validated_order(basis, radiance, blocks, largest: int, *, seed: int = 0) -> tuple[int, str]:
    """The order of a least-squares fit: by block cross-validation, the lowest within one standard error of the best.

    Parameters
    ----------
    basis : (p, terms, 3) at the order ``largest``; radiance : (p, 3); blocks : (p,) int

    Returns
    -------
    order, and the reason in words
    """
    names, labels = np.unique(blocks, return_inverse=True)
    fold_of_block = np.random.default_rng(seed).permutation(len(names)) % FOLDS
    fold = fold_of_block[labels.reshape(-1)]
    response = np.sqrt(np.mean(np.square(basis[:, 0], dtype=np.float64), 0))
    b = radiance / response
    terms = basis.shape[1]
    grams, moments = np.zeros((FOLDS, 3, terms, terms)), np.zeros((FOLDS, 3, terms))
    for k in range(FOLDS):
        mine = fold == k
        for c in range(3):
            a = basis[mine, :, c] / response[c]
            grams[k, c], moments[k, c] = a.T @ a, a.T @ b[mine, c]
    energies = np.array([np.square(b[fold == k]).sum(0) for k in range(FOLDS)])
    errors = np.full((largest + 1, FOLDS), np.inf)
    for order in range(largest + 1):
        n = (order + 1) ** 2
        for k in range(FOLDS):
            left = 0.0
            for c in range(3):
                gram = grams[:, c, :n, :n].sum(0) - grams[k, c, :n, :n]
                ridge = 1e-12 * np.trace(gram) / n * np.eye(n)
                x = np.linalg.solve(gram + ridge, moments[:, c, :n].sum(0) - moments[k, c, :n])
                left += energies[k, c] - 2 * x @ moments[k, c, :n] + x @ grams[k, c, :n, :n] @ x
            errors[order, k] = left / max(energies[k].sum(), 1e-300)
    mean = errors.mean(1)
    best = int(mean.argmin())
    error = errors[best].std(ddof=1) / np.sqrt(FOLDS)
    order = int(np.flatnonzero(mean <= mean[best] + error)[0])
    words = (
        f"the lowest order whose cross-validated misfit ({np.sqrt(max(mean[order], 0)):.3f}) is within one standard "
    )
    return order, words + f"error of the best, that of order {best} ({np.sqrt(max(mean[best], 0)):.3f})"


def solve_at_any_order(basis, radiance, blocks, largest: int, *, seed: int = 0) -> tuple[Fit, str]:
    """Least squares at the order that cross-validation chooses, and the reason."""
    order, reason = cross_validated_order(basis, radiance, blocks, largest, seed=seed)
    return solve(basis[:, : (order + 1) ** 2], radiance, blocks=blocks), reason
