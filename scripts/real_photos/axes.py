# SPDX-License-Identifier: GPL-3.0-or-later
"""What is done to a photograph, at five severities each, and the estimators that are tried on it."""

import cv2
import numpy as np

from btfsep_engine.fit.censored import working_values
from btfsep_engine.fit.compare import relative_l2
from btfsep_engine.fit.log_normal import LightSolver
from btfsep_engine.fit.robust import outliers
from btfsep_engine.fit.white_balance import free_scales
from btfsep_engine.images import linear_to_srgb, srgb_to_linear
from btfsep_engine.pipeline.real_photo import STIFF
from scripts.studies.measures import covered

ORDER = 4
CLIPPED = (0.01, 0.05, 0.1, 0.2, 0.4)  # share of the object's pixels
CODED = ("8-bit", "JPEG 95", "JPEG 75", "JPEG 50", "8-bit, 4 stops dark")
EDGES = (1, 2, 3, 4, 6)  # pixels in from the silhouette, from which on they are used
SPECKS = (0.01, 0.02, 0.05, 0.1, 0.2)  # share of the object that something else covers
SHADES = (1.1, 1.25, 1.5, 2.0, 3.0)  # red of a piece over the library's, and blue of the library's over the piece's
BRIGHT = 0.8  # of the 99.5th percentile of the object in a well exposed 8-bit photo
INNER = 2  # pixels nearer to the silhouette are left out, as the engine does


def error(fit, truth) -> float:
    """Relative error of the coefficients up to order 2, with one free scale."""
    return relative_l2(fit.coefficients[:9], truth[:9])["relative_l2_free_scale"]


def error_of_colour(fit, truth) -> float:
    """The same without a free scale."""
    return relative_l2(fit.coefficients[:9], truth[:9])["relative_l2"]


def solver_of(view, chosen, key="mean", *, coarsening=1.0) -> LightSolver:
    """The basis images of the chosen pixels, (p,) bool or numbers, made ready."""
    return LightSolver(view.basis[key][chosen], normals=view.normals[chosen], order=ORDER, coarsening=coarsening)


def plain(view, b, chosen, key="mean"):
    """The fit of the chosen pixels, (p,) bool or numbers."""
    return solver_of(view, chosen, key).solve(b[chosen])


def censored(view, cut, clipped, keep):
    """The fit in which clipped channels count as at least as bright as they are."""
    values, weights = working_values(solver_of(view, keep), cut[keep], clipped[keep])
    used = weights.any(1)
    return solver_of(view, np.flatnonzero(keep)[used]).solve(values[used], weights=weights[used])


def inner(view) -> np.ndarray:
    """(p,) bool: the pixels that the engine uses."""
    return view.depth >= INNER


def clipped_at(view, light, share):
    """A photograph (p, 3) clipped per channel at one limit, and where: of so large a share of the inner pixels."""
    b = view.at(view.photos[light]).astype(np.float64)
    limit = float(np.quantile(b[inner(view)].max(1), 1 - share)) if share else np.inf
    return np.minimum(b, limit), b >= limit


def clipping(view, light, rng) -> dict:
    """{estimator: (error at none and at each severity)} of photographs clipped per channel at one limit."""
    truth, keep = view.truths[light], inner(view)
    rows: dict = {"left out": [], "inequality": []}
    for share in (0, *CLIPPED):
        cut, clipped = clipped_at(view, light, share)
        rows["left out"].append(error(plain(view, cut, keep & ~clipped.any(1)), truth))
        rows["inequality"].append(error(censored(view, cut, clipped, keep), truth))
    return rows


def stated(view, light, rng) -> dict:
    """Shares of the true coefficients in what is stated, photographs clipped as in :func:`clipping`."""
    truth, keep = view.truths[light][:9], inner(view)
    rows: dict = {"1.96 standard deviations": [], "95 % range": []}
    for share in (0, *CLIPPED):
        fit = censored(view, *clipped_at(view, light, share), keep)
        held = covered(fit.coefficients[:9], fit.stddev[:9], truth, interval=fit.interval[:, :9])
        for row, name in zip(rows.values(), ("within95", "inside"), strict=True):
            row.append(held[name])
    return rows


def coded_photo(image, region, how: str) -> np.ndarray:
    """The codes (h, w, 3) uint8 of the photograph in an 8-bit file, exposed by the object's bright pixels."""
    peak = float(np.quantile(image[region].max(1), 0.995))
    exposure = BRIGHT / peak * (2**-4 if "dark" in how else 1)
    codes = np.round(np.clip(linear_to_srgb(image.astype(np.float64) * exposure), 0, 1) * 255).astype(np.uint8)
    if how.startswith("JPEG"):
        quality = int(how.split()[1])
        _, data = cv2.imencode(".jpg", codes[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
        codes = cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1]
    return codes


def coding(view, light, rng) -> dict:
    """Errors of 8-bit photographs of unknown exposure: codes decoded alone, and with a noise floor for the codes."""
    image, truth, keep = view.photos[light], view.truths[light], inner(view)
    rows = {"as decoded": [], "floor for the codes": []}
    first = error(plain(view, view.at(image).astype(np.float64), keep), truth)
    for row in rows.values():
        row.append(first)
    for how in CODED:
        codes = view.at(coded_photo(image, view.region, how))
        b = srgb_to_linear(codes / 255)
        chosen = keep & (codes < 255).all(1)
        rows["as decoded"].append(error(plain(view, b, chosen), truth))
        step = srgb_to_linear((codes + 0.5) / 255) - srgb_to_linear((codes - 0.5) / 255)
        noise = np.square(0.05 * b).mean() + np.square(step) / 12
        weights = (noise.min() / noise)[chosen]
        fit = solver_of(view, chosen).solve(b[chosen], weights=weights)
        rows["floor for the codes"].append(error(fit, truth))
    return rows


def edges(view, light, rng) -> dict:
    """Errors by how far inside the silhouette pixels are used (1: all), the same number in each, and all."""
    b, truth = view.at(view.photos[light]).astype(np.float64), view.truths[light]
    count = int((view.depth >= EDGES[-1]).sum())
    order = rng.permutation(len(b))
    out = {"as many pixels": [], "all that are left": []}
    for width in EDGES:
        chosen = np.zeros(len(b), bool)
        chosen[order[view.depth[order] >= width][:count]] = True
        out["as many pixels"].append(error(plain(view, b, chosen), truth))
        out["all that are left"].append(error(plain(view, b, view.depth >= width), truth))
    return out


def robust_fits(view, b, keep, key="mean"):
    """(name, Fit) with all pixels, and without those that the light does not explain."""
    yield "all pixels", plain(view, b, keep, key)
    out = outliers(solver_of(view, keep, key, coarsening=STIFF), b[keep])
    yield "left out by pixel (--robust)", plain(view, b, np.flatnonzero(keep)[~out], key)


def specks(view, light, rng) -> dict:
    """Errors where something of another colour and brightness covers parts of the object."""
    image, truth, keep = view.photos[light], view.truths[light], inner(view)
    rows: dict = {}
    rows_at, columns_at = np.nonzero(view.region)
    level = float(image[view.region].mean())
    covered, image = np.zeros_like(view.region), image.copy()
    for share in (0, *SPECKS):
        while covered[view.region].mean() < share:
            i = rng.integers(len(rows_at))
            radius = rng.uniform(2, 7)
            y, x = np.ogrid[: image.shape[0], : image.shape[1]]
            disc = (y - rows_at[i]) ** 2 + (x - columns_at[i]) ** 2 <= radius**2
            image[disc] = level * 2 ** rng.uniform(-3, 2, 3)
            covered |= disc
        for name, fit in robust_fits(view, view.at(image).astype(np.float64), keep):
            rows.setdefault(name, []).append(error(fit, truth))
    return rows


def textures(view, light, rng) -> dict | None:
    """Errors with the mean ABRDF and with the texture, where it lines up and where not; None without a texture."""
    if "aligned" not in view.basis:
        return None
    b, keep, truth = view.at(view.photos[light]).astype(np.float64), inner(view), view.truths[light]
    rows: dict = {}
    for key in ("mean", "aligned", "not aligned"):
        for name, fit in robust_fits(view, b, keep, key):
            rows.setdefault(name, []).append(error(fit, truth))
    return rows


def shades(view, other, light, rng) -> dict:
    """Errors with no free scale, where a second object's dye is not the library's: alone held, both held, one free.

    ``other`` is under the same light in a photograph of its own; both together are a scene without reflections
    between them.
    """
    truth, keep = view.truths[light], (inner(view), inner(other))
    basis = [v.basis["mean"][k] for v, k in zip((view, other), keep, strict=True)]
    normals = [v.normals[k] for v, k in zip((view, other), keep, strict=True)]
    photos = [v.at(v.photos[light]).astype(np.float64)[k] for v, k in zip((view, other), keep, strict=True)]
    blocks = [view.blocks[keep[0]], other.blocks[keep[1]] + (1 << 20)]
    rows = {"the known object alone": [], "both as in the library": [], "the second one's scale free": []}
    alone = error_of_colour(LightSolver(basis[0], normals=normals[0], order=ORDER).solve(photos[0]), truth)
    for ratio in (1, *SHADES):
        seen = [photos[0], photos[1] * np.array([ratio, 1, 1 / ratio])]
        scales = free_scales(basis, seen, normals=normals, blocks=blocks, free=[False, True])
        rows["the known object alone"].append(alone)
        for name, factor in (("both as in the library", 1.0), ("the second one's scale free", scales[1])):
            a = np.concatenate([basis[0], basis[1] * np.asarray(factor, np.float32)])
            fit = LightSolver(a, normals=np.concatenate(normals), order=ORDER).solve(np.concatenate(seen))
            rows[name].append(error_of_colour(fit, truth))
    return rows


AXES = {
    "clipping": clipping,
    "stated": stated,
    "coding": coding,
    "edges": edges,
    "specks": specks,
    "textures": textures,
    "shades": shades,
}
PAIRS = ("shades",)  # of two objects
SHARES = ("stated",)  # no errors: means of shares, the least in brackets
SEVERITIES = {
    "clipping": ("none", *(f"{100 * v:.0f} %" for v in CLIPPED)),
    "stated": ("none", *(f"{100 * v:.0f} %" for v in CLIPPED)),
    "coding": ("linear", *CODED),
    "edges": tuple(f"{v}" for v in EDGES),
    "specks": ("none", *(f"{100 * v:.0f} %" for v in SPECKS)),
    "textures": ("mean ABRDF", "texture lines up", "texture does not"),
    "shades": ("1", *(f"{v:g}" for v in SHADES)),
}
TITLES = {
    "clipping": "Clipped: share of the object's pixels",
    "stated": "Clipped, too: true coefficients in what is stated",
    "coding": "How the photo is stored",
    "edges": "Pixels used from so many pixels inside the outline",
    "specks": "Covered by other things: share of the object",
    "textures": "Texture, with and without what is not explained",
    "shades": "Another dye: ratio in red and blue (no free scale)",
}
