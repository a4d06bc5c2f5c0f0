# SPDX-License-Identifier: GPL-3.0-or-later
"""Leathers, stones, wallpapers and woods."""

import numpy as np

from btfsep_engine.btf.procedural.noise import fbm, gradient_noise, jittered_points, mix, nearest, smoothstep


def leather_brown(u, v, rng, size):
    """Pebbled grain: rounded cells of uneven size between creases."""
    bend = [0.010 * fbm(u, v, 6, 6, 3, rng) for _ in range(2)]
    a, b = u + bend[0], v + bend[1]
    d, index, _ = nearest(a, b, jittered_points(17, 17, rng, jitter=1.0))
    gap = (d[..., 1] - d[..., 0]) * 17
    fine, _, _ = nearest(a, b, jittered_points(58, 58, rng))
    wrinkle = smoothstep(0, 0.5, (fine[..., 1] - fine[..., 0]) * 58)
    pebble = 1 - (1 - np.clip(gap / 0.62, 0, 1)) ** 3  # steep at the crease, round on top
    large = fbm(u, v, 3, 3, 3, rng)
    swell = rng.normal(0, 1, 17 * 17).clip(-2, 2)[index[..., 0]]
    height = (0.26 + 0.04 * swell + 0.025 * wrinkle) * pebble + 0.08 * large + 0.02 * fbm(u, v, 40, 40, 2, rng)
    base = mix((0.055, 0.020, 0.008), (0.24, 0.098, 0.038), 0.80 * pebble + 0.10 * large + 0.05 * swell)
    return base, height, 0.62 - 0.20 * pebble + 0.03 * large


def leather_black(u, v, rng, size):
    """Smooth nappa, black: a fine net of creases, pores, a few long folds."""
    bend = [0.012 * fbm(u, v, 5, 5, 3, rng) for _ in range(2)]
    a, b = u + bend[0], v + bend[1]
    d, _, _ = nearest(a, b, jittered_points(44, 26, rng, jitter=1.0))
    net = smoothstep(0.0, 0.45, (d[..., 1] - d[..., 0]) * 34)
    pores, _, _ = nearest(u, v, jittered_points(26, 26, rng, jitter=1.0))
    pore = smoothstep(0.16, 0.05, pores[..., 0] * 26)
    fold = smoothstep(0.10, 0.0, np.abs(fbm(a, b, 2, 5, 3, rng)))
    height = 0.10 * net - 0.07 * pore - 0.13 * fold + 0.12 * fbm(u, v, 3, 3, 2, rng)
    base = mix((0.012, 0.011, 0.011), (0.034, 0.031, 0.030), net * (1 - pore))
    return base, height, 0.44 - 0.13 * net + 0.15 * pore + 0.06 * fold


def granite(u, v, rng, size):
    """Honed granite: interlocking crystals of feldspar, quartz and mica, with pits."""
    bend = [0.018 * fbm(u, v, 9, 9, 4, rng, gain=0.65) for _ in range(2)]
    a, b = u + bend[0], v + bend[1]
    points = jittered_points(23, 23, rng, jitter=1.0)
    d, index, _ = nearest(a, b, points)
    small, small_index, _ = nearest(a + bend[1], b, jittered_points(60, 60, rng))
    minerals = np.array([(0.56, 0.53, 0.49), (0.40, 0.39, 0.385), (0.47, 0.40, 0.35), (0.29, 0.29, 0.30)])
    kind = rng.choice(4, len(points), p=(0.36, 0.30, 0.18, 0.16))[index[..., 0]]
    mica_spot = (rng.uniform(size=3600) < 0.14)[small_index[..., 0]] & (small[..., 0] * 60 < 0.62)
    grain = fbm(u, v, 32, 32, 4, rng, gain=0.7)
    base = minerals[kind] * (1 + 0.22 * grain)[..., None]
    base = np.where(mica_spot[..., None], np.array((0.035, 0.033, 0.035)) * (1 + 0.3 * grain)[..., None], base)
    seam = smoothstep(0.10, 0.0, (d[..., 1] - d[..., 0]) * 23)
    pit = smoothstep(0.42, 0.62, fbm(u, v, 20, 20, 3, rng))
    level = rng.normal(0, 0.012, len(points))[index[..., 0]]
    height = level - 0.03 * seam - 0.22 * pit - 0.03 * mica_spot + 0.015 * grain
    return base * (1 - 0.35 * pit - 0.2 * seam)[..., None], height, np.where(mica_spot, 0.22, 0.30) + 0.35 * pit


def sandstone(u, v, rng, size):
    """Rough yellow sandstone: bedded, grainy, pitted."""
    warp = 0.03 * fbm(u, v, 3, 3, 4, rng)
    bed = np.sin(2 * np.pi * (5 * (v + warp) + 0.4 * fbm(u, v, 2, 6, 2, rng)))
    d, index, _ = nearest(u, v, jittered_points(84, 84, rng))
    sand = np.sqrt(np.maximum(1 - (d[..., 0] * 84 / 0.8) ** 2, 0))
    rough = fbm(u, v, 6, 7, 6, rng, gain=0.68)
    hole = smoothstep(0.22, 0.50, fbm(u, v, 11, 14, 4, rng))
    height = 0.70 * rough + 0.05 * bed + 0.14 * sand - 0.60 * hole
    tone = rng.normal(0, 1, 84 * 84).clip(-2, 2)[index[..., 0]]
    base = mix((0.34, 0.19, 0.085), (0.62, 0.43, 0.22), 0.52 + 0.22 * bed + 0.16 * tone + 0.35 * rough)
    return base * (1 - 0.35 * hole)[..., None], height, np.full_like(u, 0.92)


def woodchip(u, v, rng, size):
    """White ingrain paper: scattered wood chips under matt paint."""
    height = 0.03 * fbm(u, v, 48, 48, 3, rng) + 0.05 * fbm(u, v, 5, 5, 3, rng)
    for columns, reach, tall in ((9, 0.055, 0.75), (15, 0.032, 0.48), (26, 0.017, 0.28)):
        points = rng.uniform(0, 1, (columns * columns, 2))
        shape = rng.uniform(0.35, 1.0, (columns * columns, 2))
        turn = rng.uniform(0, np.pi, columns * columns)
        keep = rng.uniform(size=columns * columns) < 0.75
        bump = np.zeros_like(u)
        _, index, _ = nearest(u, v, points, k=4)
        for rank in range(4):
            i = index[..., rank]
            away = np.stack([u, v], -1) - points[i]
            away -= np.round(away)
            c, s = np.cos(turn[i]), np.sin(turn[i])
            x = (away[..., 0] * c + away[..., 1] * s) / (reach * shape[i, 0])
            y = (away[..., 1] * c - away[..., 0] * s) / (reach * 0.38 * shape[i, 1])
            bump = np.maximum(bump, keep[i] * smoothstep(1.15, 0.35, x * x + y * y) * (0.5 + 0.5 * shape[i, 0]))
        height = np.maximum(height, 0.6 * height + tall * bump)
    base = mix((0.70, 0.69, 0.66), (0.78, 0.77, 0.74), 0.5 + 0.5 * fbm(u, v, 30, 30, 3, rng))
    return base, height, np.full_like(u, 0.68)


def damask(u, v, rng, size):
    """Teal paper embossed with a satin ornament of mirrored leaves, on a fine rib."""
    wob_u, wob_v = (0.003 * fbm(u, v, 8, 8, 3, rng) for _ in range(2))

    def flower(x, y, petals, reach):
        x, y = x - np.round(x), y - np.round(y)
        r, phi = np.hypot(x, y), np.arctan2(np.abs(x), y)  # |x|: the motif is its own mirror image
        swing = np.abs(np.cos(0.5 * petals * phi))
        outline = reach * (0.42 + 0.58 * swing**0.55) - r
        vein = np.abs(np.sin(0.5 * petals * phi)) * r - 0.007  # a line cut along each petal
        petal = np.minimum(outline, np.maximum(vein, reach * 0.42 - r))
        gap = np.abs(r - 0.34 * reach) - 0.012
        return np.maximum(np.minimum(petal, gap), 0.24 * reach - r)

    a, b = 2 * (u + wob_u), 2 * (v + wob_v)
    motif = np.maximum(flower(a, b, 8, 0.30), flower(a + 0.5, b + 0.5, 6, 0.19))
    ogee = 0.25 * np.cos(2 * np.pi * b) * 0.55
    vine = 0.014 - np.minimum(np.abs((a - ogee) % 1.0 - 0.5), np.abs((a + ogee) % 1.0 - 0.5))
    inside = smoothstep(-0.010, 0.014, np.maximum(motif, vine))
    pillow = smoothstep(0.0, 0.07, np.maximum(motif, vine))
    rib = np.sin(2 * np.pi * 64 * u)
    paper = fbm(u, v, 40, 40, 3, rng)
    height = 0.30 * inside + 0.12 * pillow + 0.035 * rib * (1 - inside) + 0.015 * paper
    base = mix((0.022, 0.135, 0.145), (0.30, 0.40, 0.33), inside) * (1 + 0.12 * paper)[..., None]
    return base, height, 0.68 - 0.36 * inside + 0.03 * paper


def _figure(u, v, rng, *, rings: int, waves: float, stretch: int):
    """Growth rings cut lengthwise (along v): phase in ring numbers; periodic because ``rings`` is whole."""
    slow = fbm(u, v, 2, 1, 3, rng)
    return rings * u + waves * slow + 0.12 * fbm(u, v, 6, max(1, 6 // stretch), 3, rng)


def _pores(u, v, rng, *, columns: int, rows: int, width: float):
    """Vessels cut lengthwise: thin dashes along v, in [0, 1]."""
    points = jittered_points(columns, rows, rng)
    _, _, offset = nearest(u, v, points, stretch=columns / rows)
    long = smoothstep(0.55, 0.30, np.abs(offset[..., 1]) * rows)
    return smoothstep(width, 0.3 * width, np.abs(offset[..., 0]) * columns) * long


def oak(u, v, rng, size):
    """Brushed oak boards: open pores, ring figure, grooves between four boards."""
    boards = 3
    number = np.floor(u * boards).astype(int)
    shift = rng.uniform(0, 1, (2, boards))
    inside = u * boards - number
    cut_u, cut_v = (u + shift[0, number]) % 1.0, (v + shift[1, number]) % 1.0
    phase = _figure(cut_u, cut_v, rng, rings=17, waves=3.2, stretch=6)
    late = (0.5 + 0.5 * np.sin(2 * np.pi * phase)) ** 2
    pore = _pores(cut_u + 0.004 * gradient_noise(cut_u, cut_v, 8, 2, rng), cut_v, rng, columns=105, rows=11, width=0.30)
    pore = pore * (0.35 + 0.65 * (1 - late))
    fibre = fbm(cut_u, cut_v, 90, 4, 3, rng)
    groove = smoothstep(0.035, 0.012, np.minimum(inside, 1 - inside))
    end = smoothstep(0.012, 0.004, np.abs((v - shift[1, number] + 0.5) % 1.0 - 0.5))
    joint = np.maximum(groove, end)
    tone = rng.normal(0, 1, boards).clip(-1.5, 1.5)[number]
    base = mix((0.50, 0.31, 0.15), (0.33, 0.18, 0.075), 0.75 * late + 0.25 * fibre + 0.08 + 0.14 * tone)
    base *= (1 - 0.55 * pore)[..., None] * (1 - 0.75 * joint)[..., None]
    height = 0.06 * late + 0.04 * fibre - 0.22 * pore - 0.9 * joint
    return base, height, 0.48 + 0.15 * pore + 0.2 * joint + 0.04 * fibre


def walnut(u, v, rng, size):
    """Lacquered walnut: dark cathedral figure, shallow filled pores, gloss."""
    centre = 0.5 + 0.05 * np.sin(2 * np.pi * v)
    away = np.abs((u - centre + 0.5) % 1.0 - 0.5)
    phase = 17 * np.sqrt(away**2 + 0.012 * (1.15 + np.cos(2 * np.pi * v))) + 0.55 * fbm(u, v, 3, 1, 4, rng)
    late = smoothstep(0.15, 0.95, phase % 1.0) * smoothstep(1.0, 0.95, phase % 1.0)
    streak = fbm(u, v, 5, 1, 4, rng)
    fibre = fbm(u, v, 120, 5, 2, rng)
    pore = _pores(u, v, rng, columns=90, rows=9, width=0.22)
    base = mix((0.175, 0.085, 0.042), (0.052, 0.022, 0.011), 0.65 * late + 0.35 * streak + 0.15 * fibre + 0.1)
    base *= (1 - 0.5 * pore)[..., None]
    height = 0.05 * fbm(u, v, 3, 2, 3, rng) - 0.05 * pore + 0.008 * fibre + 0.01 * late
    return base, height, 0.24 + 0.12 * pore + 0.02 * late
