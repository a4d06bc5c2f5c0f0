# SPDX-License-Identifier: GPL-3.0-or-later
"""More wallpapers: satin stripes, raised dots, grasscloth, an embossed fan pattern."""

import numpy as np

from btfsep_engine.btf.procedural.noise import fbm, jittered_points, mix, nearest, smoothstep


def stripes(u, v, rng, size):
    """Regency stripes: satin cream and matt plum bands with gilt lines, on a paper with a fine laid rib."""
    repeat = 2
    x = (repeat * (u + 0.0012 * fbm(u, v, 6, 6, 3, rng))) % 1.0
    soft = 0.006
    band = smoothstep(0.25 - soft, 0.25 + soft, x) * smoothstep(0.75 + soft, 0.75 - soft, x)
    edge = np.minimum(np.abs(x - 0.25), np.abs(x - 0.75))
    gilt = smoothstep(0.024, 0.014, np.abs(edge - 0.055))
    thin = smoothstep(0.016, 0.008, np.abs(np.minimum(x, 1 - x)))
    rib = np.sin(2 * np.pi * 72 * v)
    paper = fbm(u, v, 50, 50, 3, rng)
    moire = np.sin(2 * np.pi * (6 * v + 1.6 * fbm(u, v, 5, 3, 3, rng)))  # watered silk, printed in the satin band
    plum = np.array((0.115, 0.016, 0.045)) * (1 + 0.12 * paper)[..., None]
    cream = np.array((0.64, 0.57, 0.43)) * (1 + 0.07 * moire + 0.04 * paper)[..., None]
    base = mix(mix(plum, cream, band), (0.50, 0.31, 0.075), np.maximum(gilt, thin))
    line = np.maximum(gilt, thin)
    height = 0.10 * band + 0.08 * line + (0.028 * (1 - band) + 0.008) * rib + 0.012 * paper + 0.008 * moire * band
    return base, height, 0.74 - 0.38 * band - 0.30 * line * (1 - band) + 0.05 * moire * band


def dots(u, v, rng, size):
    """Raised dots: pearly beads, large and small, blown up on a slate-blue vinyl ground."""
    columns = rows = 8
    large = jittered_points(columns, rows, rng, jitter=0.02, brick=True)
    small = large + np.array([0.5 / columns, 0.0])
    grain = fbm(u, v, 44, 44, 3, rng, gain=0.6)
    bead = np.zeros_like(u)
    tall = np.zeros_like(u)
    for points, radius, rise in ((large, 1.75, 0.80), (small % 1.0, 0.80, 0.42)):
        d, _, _ = nearest(u, v, points)
        r = d[..., 0] * size / radius
        bead = np.maximum(bead, smoothstep(1.06, 0.94, r))
        tall = np.maximum(tall, rise * np.sqrt(np.maximum(1 - r**2, 0)) ** 0.8)
    base = mix(np.array((0.090, 0.150, 0.215)) * (1 + 0.15 * grain)[..., None], (0.66, 0.64, 0.58), bead)
    return base, tall + 0.035 * grain * (1 - bead), 0.66 - 0.36 * bead + 0.04 * grain


def grasscloth(u, v, rng, size):
    """Grasscloth: uneven strips of dried grass laid side by side, held by thin cotton threads."""
    rows, threads = 34, 9
    wander = 0.30 * fbm(u, v, 4, 10, 3, rng)
    y = v * rows + wander
    widths = rng.uniform(-0.22, 0.22, rows)
    number = np.floor(y).astype(int) % rows
    low, high = widths[number], 1 + widths[(number + 1) % rows]  # strips are of uneven width
    place = y - np.floor(y)
    before, after = place < low, place >= high
    strip = (number - before + after) % rows
    start = np.where(before, widths[(number - 1) % rows] - 1, np.where(after, high, low))
    end = np.where(before, low, np.where(after, 1 + widths[(number + 2) % rows], high))
    end = np.maximum(end, start + 0.2)
    across = np.clip(2 * (place - start) / (end - start) - 1, -1, 1)
    dome = np.sqrt(np.maximum(1 - across**2, 0))
    tone = rng.normal(0, 1, rows).clip(-2, 2)[strip]
    fibre = fbm(u, v, 5, 150, 3, rng)
    patch = fbm(u, v, 5, rows, 3, rng)
    base = mix((0.20, 0.150, 0.055), (0.56, 0.47, 0.25), 0.50 + 0.22 * tone + 0.30 * fibre + 0.30 * patch)
    base *= (0.42 + 0.58 * dome**0.6)[..., None]
    line = np.abs(((u + 0.0035 * fbm(u, v, 4, 12, 3, rng)) * threads) % 1.0 - 0.5)
    thread = smoothstep(0.060, 0.042, line)
    cord = np.sqrt(np.maximum(1 - (line / 0.062) ** 2, 0))
    base = mix(base, (0.52, 0.46, 0.34), 0.85 * thread)
    height = (0.42 + 0.06 * tone) * dome + 0.05 * fibre
    height = np.where(cord > 0, np.maximum(height, 0.5 * height + 0.34 * cord + 0.05), height)
    return base, height, 0.62 + 0.08 * fibre + 0.12 * thread


def fans(u, v, rng, size):
    """Art-deco fans: overlapping scallops with embossed gilt ribs on deep emerald."""
    columns = 4
    a, b = u * columns, v * columns
    radius, pitch = 0.5, 0.25
    r, turn = np.zeros_like(u), np.zeros_like(u)
    first = np.floor(b / pitch).astype(int)
    for step in (3, 2, 1, 0, -1, -2, -3):  # lower rows lie in front of the upper ones
        row = first + step
        dx = a - 0.5 * (row % 2)
        dx = dx - np.round(dx)
        dy = b - row * pitch
        d = np.hypot(dx, dy)
        inside = d < radius
        r, turn = np.where(inside, d / radius, r), np.where(inside, np.arctan2(dx, dy), turn)
    paper = fbm(u, v, 44, 44, 3, rng)
    rim = smoothstep(0.90, 0.925, r)
    ring = smoothstep(0.028, 0.012, np.abs(r - 0.80)) + smoothstep(0.028, 0.012, np.abs(r - 0.36))
    spoke = np.abs((turn * 9 / np.pi + 0.5) % 1.0 - 0.5) * np.pi / 9 * r
    ray = smoothstep(0.022, 0.010, spoke) * smoothstep(0.36, 0.38, r) * smoothstep(0.80, 0.78, r)
    gilt = np.clip(rim + ring + ray, 0, 1)
    flute = np.abs(np.sin(9 * turn)) * (r > 0.36) * (r < 0.80)  # between two rays the paper is domed
    base = mix(np.array((0.006, 0.070, 0.052)) * (1 + 0.2 * paper)[..., None], (0.55, 0.36, 0.11), gilt)
    height = 0.26 * gilt + 0.10 * flute * (1 - gilt) + 0.18 * r + 0.012 * paper
    return base, height, 0.62 - 0.34 * gilt + 0.04 * paper
