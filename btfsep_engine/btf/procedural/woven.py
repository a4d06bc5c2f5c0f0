# SPDX-License-Identifier: GPL-3.0-or-later
"""Textiles: woven fabrics, felts and carpets."""

import numpy as np

from btfsep_engine.btf.procedural.noise import fbm, fibres, gradient_noise, jittered_points, mix, nearest, smoothstep


def weave(u, v, rng, *, yarns: int, pattern, radius: float, flat: float, swing: float, wander: float, plies: float):
    """Interlaced yarns: warp runs along v, weft along u.

    Parameters
    ----------
    yarns : number of warps and of wefts in a tile
    pattern : (p, p) bool, [weft, warp], True where the warp lies on top; p divides ``yarns``
    radius : half the width of a yarn, in yarn pitches
    flat : height of a yarn's section over its width
    swing : how far a yarn goes up and down, in yarn pitches
    wander : how far its axis strays, in yarn pitches
    plies : slope of the twisted fibres on the yarn

    Returns
    -------
    height : in yarn pitches · top : True where it is warp · across : -1 … 1 over the yarn's width
    yarn : number of the yarn (warps first) · strand : -1 … 1, the pattern of twisted fibres
    """
    p = len(pattern)
    drift_u, drift_v = (wander * gradient_noise(u, v, 6, 6, rng) for _ in range(2))
    thick = 1 + 0.10 * rng.standard_normal((2, yarns)).clip(-2, 2)
    twist = rng.uniform(0, 2 * np.pi, (2, yarns))
    layers = []
    a, b = u * yarns + drift_u, v * yarns + drift_v
    for which, (x, t) in enumerate(((a, b), (b, a))):
        number = np.floor(x).astype(int)
        across = 2 * (x - number) - 1
        before = np.floor(t - 0.5).astype(int)
        f = t - 0.5 - before
        f = f * f * (3 - 2 * f)

        def up(crossing, number=number, which=which):
            row, col = (crossing % p, number % p) if which == 0 else (number % p, crossing % p)
            return np.where(pattern[row, col], 1.0, -1.0) * (1 if which == 0 else -1)

        lift = up(before) * (1 - f) + up(before + 1) * f
        r = radius * thick[which, number % yarns]
        bulge = np.sqrt(np.maximum(1 - (across / (2 * r)) ** 2, 0))
        strand = np.sin(2 * np.pi * (plies * t + 0.9 * across) + twist[which, number % yarns])
        z = swing * lift + flat * r * bulge + 0.03 * strand * bulge
        layers.append((np.where(bulge > 0, z, -swing - 0.3), across, number % yarns + which * yarns, strand))
    top = layers[0][0] >= layers[1][0]
    height, across, yarn, strand = (np.where(top, *both) for both in zip(*layers, strict=True))
    return height, top, across, yarn, strand


def linen(u, v, rng, size):
    """Plain weave of natural flax: thick and thin yarns, pale."""
    yarns = 18
    pattern = np.array([[True, False], [False, True]])
    height, _, across, yarn, strand = weave(
        u, v, rng, yarns=yarns, pattern=pattern, radius=0.54, flat=0.62, swing=0.15, wander=0.12, plies=1.2
    )
    tone = rng.normal(0, 1, 2 * yarns).clip(-2, 2)[yarn]
    fine = fbm(u, v, 40, 40, 3, rng)
    base = mix((0.46, 0.36, 0.23), (0.64, 0.54, 0.38), 0.5 + 0.16 * tone + 0.16 * strand + 0.25 * fine)
    base *= (1 - 0.2 * np.abs(across) ** 4)[..., None]
    height = height * size / yarns + 0.02 * fine
    return base, height, np.full_like(u, 0.75) + 0.05 * fine


def denim(u, v, rng, size):
    """Three-one twill: indigo warp over pale weft, diagonal ribs."""
    yarns = 24
    i, j = np.meshgrid(np.arange(4), np.arange(4))
    pattern = (i + j) % 4 != 0
    height, top, across, yarn, strand = weave(
        u, v, rng, yarns=yarns, pattern=pattern, radius=0.55, flat=0.75, swing=0.13, wander=0.08, plies=1.6
    )
    tone = rng.normal(0, 1, 2 * yarns).clip(-2, 2)[yarn]
    worn = fbm(u, v, 5, 5, 4, rng)
    indigo = mix((0.022, 0.045, 0.135), (0.075, 0.13, 0.30), 0.45 + 0.18 * tone + 0.22 * strand + 0.5 * worn)
    weft = mix((0.34, 0.35, 0.37), (0.50, 0.50, 0.50), 0.5 + 0.2 * strand)
    base = np.where(top[..., None], indigo, weft) * (1 - 0.3 * np.abs(across) ** 3)[..., None]
    return base, height * size / yarns + 0.015 * fbm(u, v, 48, 48, 2, rng), np.full_like(u, 0.8)


def felt(u, v, rng, size, *, count, length, radius, curl, lift, colours, spread, lumps, roughness):
    """Matted fibres over a lumpy ground; ``colours`` are drawn a fibre, lengths in mm."""
    n = len(u)
    ground = fbm(u, v, 4, 4, 5, rng)
    radius = (radius[0] / size, radius[1] / size)
    height, index = fibres(n, rng, count=count, length=length / size, radius=radius, curl=curl, lift=lift / size)
    pick = np.asarray(colours, float)[rng.integers(0, len(colours), count + 1)]
    pick *= np.exp(rng.normal(0, spread, (count + 1, 1)))
    depth = np.clip(height / (lift / size + radius[1]), 0, 1)
    base = pick[index] * (0.55 + 0.45 * depth)[..., None]
    return base, height * size + lumps * ground, np.full_like(u, roughness)


def felt_grey(u, v, rng, size):
    """Fine grey melange: pale, mid and dark hairs pressed together."""
    return felt(
        u, v, rng, size, count=5200, length=5.0, radius=(0.05, 0.09), curl=0.7, lift=0.35,
        colours=[(0.30, 0.30, 0.31)] * 3 + [(0.12, 0.12, 0.13), (0.60, 0.59, 0.57)], spread=0.12, lumps=0.12,
        roughness=0.85,
    )  # fmt: skip


def felt_green(u, v, rng, size):
    """Coarse green wool felt: thick curly hairs in clumps."""
    return felt(
        u, v, rng, size, count=1700, length=6.0, radius=(0.10, 0.19), curl=1.6, lift=0.8,
        colours=[(0.075, 0.22, 0.055), (0.10, 0.27, 0.07), (0.06, 0.17, 0.05)], spread=0.15, lumps=0.45,
        roughness=0.9,
    )  # fmt: skip


def carpet_loop(u, v, rng, size):
    """Loop pile: rows of arched, twisted loops."""
    columns = rows = 10
    points = jittered_points(columns, rows, rng, jitter=0.22, brick=True)
    _, index, offset = nearest(u, v, points)
    number = index[..., 0]
    turn = rng.normal(0.0, 0.25, len(points))[number]
    x, y = offset[..., 0] * columns, offset[..., 1] * rows
    along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    dome = np.sqrt(np.maximum(1 - (along / 0.78) ** 2 - (across / 0.60) ** 2, 0))
    phase = rng.uniform(0, 2 * np.pi, len(points))[number]
    strand = np.sin(2 * np.pi * (2.3 * along + 1.5 * across) + phase)
    fine = fbm(u, v, 64, 64, 2, rng)
    tall = 1.9 + 0.3 * rng.standard_normal(len(points)).clip(-2, 2)[number]
    height = (tall + 0.13 * strand) * dome + 0.10 * fine
    tone = rng.normal(0, 1, len(points)).clip(-2, 2)[number]
    base = mix((0.38, 0.27, 0.16), (0.58, 0.45, 0.30), 0.5 + 0.15 * tone + 0.20 * strand + 0.25 * fine)
    return base * (0.45 + 0.55 * smoothstep(0.0, 0.6, dome))[..., None], height, np.full_like(u, 0.9)


def carpet_cut(u, v, rng, size):
    """Cut pile: dense tufts of fibre ends at uneven heights, leaning in patches."""
    lean_u, lean_v = (0.02 * fbm(u, v, 3, 3, 3, rng) for _ in range(2))
    tufts = jittered_points(12, 12, rng, jitter=0.8)
    ends = jittered_points(52, 52, rng, jitter=1.0)
    d1, i1, _ = nearest(u + lean_u, v + lean_v, tufts)
    d2, i2, _ = nearest(u + lean_u, v + lean_v, ends)
    tuft = smoothstep(1.0, 0.15, d1[..., 0] * 12 / 0.75)
    end = np.sqrt(np.maximum(1 - (d2[..., 0] * 52 / 0.72) ** 2, 0))
    stick = rng.uniform(0, 1, len(ends))[i2[..., 0]]
    height = 1.1 * tuft + end * (0.25 + 0.75 * stick) + 0.25 * fbm(u, v, 4, 4, 3, rng)
    tone = rng.normal(0, 1, len(ends)).clip(-2, 2)[i2[..., 0]]
    tone = tone + 0.8 * rng.normal(0, 1, len(tufts)).clip(-2, 2)[i1[..., 0]]
    base = mix((0.15, 0.012, 0.022), (0.40, 0.05, 0.06), 0.45 + 0.15 * tone)
    return base * (0.45 + 0.55 * end)[..., None], height, np.full_like(u, 0.85)
