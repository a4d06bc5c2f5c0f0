# SPDX-License-Identifier: GPL-3.0-or-later
"""More leathers: crocodile, perforated, suede, saffiano."""

import numpy as np

from btfsep_engine.btf.procedural.noise import fbm, fibres, jittered_points, mix, nearest, smoothstep, worn_gap


def crocodile(u, v, rng, size):
    """Glazed crocodile, bottle green: rows of cushioned scales, wide on the belly and narrow at the flank."""
    columns, rows = 7, 8
    bend = [0.008 * fbm(u, v, 6, 6, 3, rng) for _ in range(2)]
    a = u + bend[0] + 0.055 * np.sin(2 * np.pi * u)
    b = v + bend[1] + 0.012 * np.sin(4 * np.pi * u)
    points = jittered_points(columns, rows, rng, jitter=0.36)
    d, index, _ = nearest(a, b, points, k=5)
    gap = worn_gap(d * 0.5 * (columns + rows), 9.0)
    cushion = 1 - (1 - np.clip((gap + 0.04) / 0.42, 0, 1)) ** 2.6
    wrinkle = fbm(u, v, 26, 26, 3, rng, gain=0.6)
    swell = rng.normal(0, 1, len(points)).clip(-1.5, 1.5)[index[..., 0]]
    height = (1.05 + 0.08 * swell) * cushion + 0.05 * wrinkle * (1.2 - cushion) + 0.05 * fbm(u, v, 4, 4, 2, rng)
    base = mix((0.006, 0.024, 0.012), (0.020, 0.105, 0.050), 0.85 * cushion + 0.10 * wrinkle + 0.06 * swell)
    return base, height, 0.56 - 0.26 * cushion + 0.03 * wrinkle


def perforated(u, v, rng, size):
    """Tan seat leather with punched holes in staggered rows; a fine grain between them."""
    bend = [0.008 * fbm(u, v, 7, 7, 3, rng) for _ in range(2)]
    d, _, _ = nearest(u + bend[0], v + bend[1], jittered_points(50, 50, rng, jitter=1.0))
    grain = smoothstep(0.0, 0.45, (d[..., 1] - d[..., 0]) * 50)
    columns, rows = 7, 8
    r, _, _ = nearest(u, v, jittered_points(columns, rows, rng, jitter=0.02, brick=True))
    r = r[..., 0] * size
    radius = 0.68
    hole = smoothstep(radius + 0.10, radius - 0.10, r)
    dip = smoothstep(2.1 * radius, radius, r)
    height = 0.07 * grain * (1 - dip) - 0.16 * dip - 0.85 * hole + 0.07 * fbm(u, v, 3, 3, 3, rng)
    base = mix((0.26, 0.115, 0.040), (0.43, 0.215, 0.085), 0.25 + 0.60 * grain + 0.2 * fbm(u, v, 5, 5, 3, rng))
    base = mix(base, (0.012, 0.008, 0.006), hole)
    return base, height, 0.52 - 0.14 * grain + 0.3 * hole


def suede(u, v, rng, size):
    """Sand-brown suede: a short nap, darker where a hand has brushed it the other way."""
    count, lift = 9000, 0.08
    nap, index = fibres(
        len(u), rng, count=count, length=0.8 / size, radius=(0.04 / size, 0.06 / size), curl=0.5, lift=lift / size
    )
    swirl = fbm(u, v, 2, 2, 3, rng)
    brushed = smoothstep(-0.10, 0.12, fbm(u + 0.05 * swirl, v, 2, 3, 4, rng))
    tone = rng.normal(0, 1, count + 1).clip(-2, 2)[index]
    depth = np.clip(nap * size / (lift + 0.05), 0, 1)
    base = mix((0.225, 0.125, 0.062), (0.43, 0.275, 0.155), 0.15 + 0.62 * brushed + 0.10 * tone)
    height = nap * size + 0.10 * fbm(u, v, 6, 6, 4, rng) + 0.05 * brushed
    return base * (0.82 + 0.18 * depth)[..., None], height, np.full_like(u, 0.9)


def saffiano(u, v, rng, size):
    """Saffiano, red: a machine-pressed cross-hatch of short slanting ridges under a wax finish."""
    lines = 16
    wob = [0.004 * fbm(u, v, 8, 8, 3, rng) for _ in range(2)]
    a, b = u + wob[0], v + wob[1]
    ridge = np.abs(np.sin(np.pi * lines * (a + b)))
    cross = np.abs(np.sin(np.pi * lines * (a - b)))
    length = smoothstep(0.05, 0.55, cross)  # the second hatch cuts the ridges of the first into short bars
    bar = ridge**0.7 * (0.62 + 0.38 * length)
    fine = fbm(u, v, 40, 40, 3, rng)
    height = 0.24 * bar + 0.03 * fine + 0.06 * fbm(u, v, 3, 3, 2, rng)
    base = mix((0.095, 0.006, 0.008), (0.38, 0.018, 0.020), 0.15 + 0.80 * bar + 0.08 * fine)
    return base, height, 0.46 - 0.18 * bar + 0.03 * fine
