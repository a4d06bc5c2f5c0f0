# SPDX-License-Identifier: GPL-3.0-or-later
"""Periodic building blocks of the procedural materials, as functions of tile coordinates u, v in [0, 1).

All are seamless over the tile's edges, and all random numbers are drawn before anything depends on the number of
pixels, so that one seed gives the same pattern at every resolution.
"""

import numpy as np
from scipy.spatial import cKDTree


def grid(n: int):
    """u, v : (n, n) float64, pixel centres; u grows with the column, v with the row (row 0 is the smallest v)."""
    c = (np.arange(n) + 0.5) / n
    return np.meshgrid(c, c)


def smoothstep(low, high, x):
    """0 below ``low``, 1 above ``high``, a smooth cubic between."""
    t = np.clip((np.asarray(x) - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def gradient_noise(u, v, cells_u: int, cells_v: int, rng) -> np.ndarray:
    """Perlin's gradient noise, periodic, about [-1, 1], ``cells`` lattice cells along each axis."""
    angle = rng.uniform(0, 2 * np.pi, (cells_v, cells_u))
    gu, gv = np.cos(angle), np.sin(angle)
    x, y = u * cells_u, v * cells_v
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - i, y - j

    def corner(di, dj):
        row, col = (j + dj) % cells_v, (i + di) % cells_u
        return gu[row, col] * (fx - di) + gv[row, col] * (fy - dj)

    sx, sy = (t * t * t * (t * (6 * t - 15) + 10) for t in (fx, fy))
    low = corner(0, 0) + sx * (corner(1, 0) - corner(0, 0))
    high = corner(0, 1) + sx * (corner(1, 1) - corner(0, 1))
    return 1.5 * (low + sy * (high - low))


def fbm(u, v, cells_u: int, cells_v: int, octaves: int, rng, *, gain: float = 0.5) -> np.ndarray:
    """Sum of octaves of gradient noise, each of doubled frequency and ``gain`` times the weight; about [-1, 1]."""
    total, weight, norm = np.zeros_like(u), 1.0, 0.0
    for octave in range(octaves):
        total = total + weight * gradient_noise(u, v, cells_u << octave, cells_v << octave, rng)
        norm += weight
        weight *= gain
    return total / norm


def jittered_points(columns: int, rows: int, rng, *, jitter: float = 1.0, brick: bool = False) -> np.ndarray:
    """(columns * rows, 2) points in the unit tile: a grid, each point moved by up to ``jitter`` / 2 of a cell."""
    i, j = np.meshgrid(np.arange(columns), np.arange(rows))
    x = i + 0.5 + (0.5 * (j % 2) if brick else 0)
    move = rng.uniform(-0.5, 0.5, (2, rows, columns)) * jitter
    return np.stack([(x + move[0]) / columns, (j + 0.5 + move[1]) / rows], -1).reshape(-1, 2) % 1.0


def nearest(u, v, points, *, k: int = 2, stretch: float = 1.0):
    """The ``k`` nearest of ``points : (n, 2)`` on the torus.

    Returns
    -------
    distance : u.shape + (k,), in tile edges; ``stretch`` > 1 makes distances along v count less
    index : u.shape + (k,) int
    offset : u.shape + (2,), from the nearest point to the pixel, in tile edges
    """
    box = np.array([1.0, 1.0 / stretch])
    tree = cKDTree(np.minimum(points * box, box * (1 - 1e-12)), boxsize=box)
    distance, index = tree.query(np.stack([u, v], -1) % 1.0 * box, k=k)
    offset = np.stack([u, v], -1) - points[index[..., 0]]
    return distance, index, offset - np.round(offset)


def worn_gap(distance, sharpness: float) -> np.ndarray:
    """How far inside its cell a pixel is: the distance to the nearest point less those to the others, a soft minimum.

    Where three cells meet the corners are rounded off, the more so the lower ``sharpness``.

    Parameters
    ----------
    distance : (..., k), ascending, of :func:`nearest`, in units of the points' spacing

    Returns
    -------
    (...), in spacings; negative close to borders and corners
    """
    return -np.log(np.exp(-sharpness * (distance[..., 1:] - distance[..., :1])).sum(-1)) / sharpness


def fibres(n: int, rng, *, count: int, length: float, radius, curl: float, lift: float):
    """Curved fibres lying over each other, all over the tile.

    Parameters
    ----------
    n : pixels along an edge
    count : fibres
    length : mean length, in tile edges
    radius : (smallest, largest), in tile edges
    curl : standard deviation of the bend, radians a fibre length
    lift : heights of the fibres' axes are uniform in [0, lift], tile edges

    Returns
    -------
    height : (n, n), tile edges, 0 where there is no fibre
    index : (n, n) int, number of the uppermost fibre, -1 where there is none
    """
    steps = 48
    start = rng.uniform(0, 1, (count, 1, 2))
    angle = rng.uniform(-np.pi, np.pi, (count, 1))
    bend, wave = rng.normal(0, curl, (2, count, 1))
    r = rng.uniform(*radius, (count, 1))
    half = 0.5 * length * rng.uniform(0.5, 1.5, (count, 1))
    base = rng.uniform(0, lift, (count, 1))
    tilt = rng.uniform(-0.5, 0.5, (count, 1)) * lift
    t = np.linspace(-1, 1, steps)[None]
    heading = angle + bend * t + wave * np.sin(2.5 * t)
    step = 2 * half / (steps - 1)
    path = start + np.cumsum(np.stack([np.cos(heading), np.sin(heading)], -1) * step[..., None], 1)
    # points along the path close enough that the stamped discs merge into a tube
    refine = max(1, int(np.ceil(step.max() * n / 0.6)))
    fine = np.linspace(0, steps - 1, (steps - 1) * refine + 1)
    lower = np.minimum(fine.astype(int), steps - 2)
    f = (fine - lower)[None, :, None]
    path = path[:, lower] * (1 - f) + path[:, lower + 1] * f
    place = np.linspace(-1, 1, len(fine))[None]
    z = np.maximum(base + tilt * place - lift * 0.3 * place**4, 0)  # the ends dive under the others
    height, index = np.zeros(n * n), np.full(n * n, -1)
    reach = int(np.ceil(r.max() * n))
    pixel = np.floor(path * n).astype(np.int32)
    f = (path * n - pixel - 0.5).astype(np.float32)
    owner = np.broadcast_to(np.arange(count)[:, None], z.shape)
    r2 = ((r * n) ** 2).astype(np.float32)
    z = (z * n).astype(np.float32)
    for dy in range(-reach, reach + 1):
        row = (pixel[..., 1] + dy) % n * n
        for dx in range(-reach, reach + 1):
            under = r2 - (dx - f[..., 0]) ** 2 - (dy - f[..., 1]) ** 2
            inside = np.nonzero(under > 0)
            top = z[inside] + np.sqrt(under[inside])
            target = row[inside] + (pixel[..., 0][inside] + dx) % n
            better = np.nonzero(top > height[target])[0]
            better = better[np.argsort(top[better])]  # of several writes to a pixel the last, the highest, stays
            height[target[better]] = top[better]
            index[target[better]] = owner[inside][better]
    return height.reshape(n, n) / n, index.reshape(n, n)


def mix(a, b, weight):
    """Colours ``a`` and ``b``, each (3,) or (..., 3), blended by ``weight : (...)`` in [0, 1]."""
    w = np.asarray(weight)[..., None]
    return np.asarray(a, float) * (1 - w) + np.asarray(b, float) * w
