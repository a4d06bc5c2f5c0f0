# SPDX-License-Identifier: GPL-3.0-or-later
"""More stones: slate, marble, terrazzo, cobbles."""

import numpy as np

from btfsep_engine.btf.procedural.noise import fbm, jittered_points, mix, nearest, smoothstep, worn_gap


def slate(u, v, rng, size):
    """Riven slate, blue-black: flat sheets that have broken away in steps, a touch of rust along the edges."""
    warp = [0.030 * fbm(u, v, 7, 5, 5, rng, gain=0.8) for _ in range(2)]
    relief = fbm(u + warp[0], v + warp[1], 2, 3, 4, rng, gain=0.5)
    level = 4.5 * (relief + 0.9)
    sheet = np.floor(level)
    edge = level - sheet
    step = sheet + smoothstep(0.92, 1.0, edge)
    silk = fbm(u, v, 10, 60, 3, rng)
    grain = fbm(u, v, 50, 50, 3, rng, gain=0.65)
    broken = smoothstep(0.86, 0.94, edge) * smoothstep(1.0, 0.97, edge)
    height = 0.42 * step + 0.06 * edge + 0.05 * silk + 0.05 * grain
    tone = np.sin(5.1 * sheet)  # every sheet has a slightly different colour
    base = mix((0.030, 0.036, 0.044), (0.095, 0.108, 0.122), 0.45 + 0.16 * tone + 0.25 * silk + 0.25 * grain)
    rust = smoothstep(0.12, 0.42, fbm(u, v, 3, 3, 4, rng)) * (0.25 + 0.75 * broken)
    base = mix(base, (0.16, 0.085, 0.040), 0.75 * rust)
    base = mix(base, (0.17, 0.18, 0.19), 0.55 * broken)
    return base, height, 0.50 + 0.10 * grain + 0.20 * broken


def marble(u, v, rng, size):
    """Honed white marble: soft grey clouds and sharp wandering veins; almost flat."""
    warp = [0.11 * fbm(u, v, 2, 2, 6, rng, gain=0.55) for _ in range(2)]
    a, b = u + warp[0], v + warp[1]
    main = np.abs(np.sin(np.pi * (a + b) + 0.9 * fbm(a, b, 2, 2, 3, rng)))
    second = np.abs(fbm(a, b, 3, 2, 4, rng))
    cloud = fbm(a, b, 2, 2, 5, rng)
    strength = smoothstep(-0.35, 0.45, fbm(u, v, 3, 3, 3, rng))
    vein = smoothstep(0.16, 0.0, main) * (0.35 + 0.65 * strength)
    halo = smoothstep(0.60, 0.0, main)
    thin = smoothstep(0.035, 0.0, second) * strength
    crystal = fbm(u, v, 70, 70, 2, rng)
    dark = np.clip(0.80 * vein + 0.50 * thin + 0.22 * halo + 0.22 * cloud, 0, 1)
    base = mix((0.76, 0.75, 0.725), (0.19, 0.20, 0.215), dark) * (1 + 0.03 * crystal)[..., None]
    height = -0.035 * vein - 0.02 * thin + 0.012 * crystal + 0.02 * cloud
    return base, height, 0.36 + 0.08 * vein + 0.02 * crystal


def terrazzo(u, v, rng, size):
    """Ground terrazzo: angular chips of coloured marble of three sizes in pale cement, sealed."""
    grain = fbm(u, v, 40, 40, 3, rng, gain=0.6)
    base = np.array((0.60, 0.575, 0.53)) * (1 + 0.10 * grain)[..., None]
    level = np.zeros_like(u)
    stones = np.array(
        [(0.50, 0.22, 0.10), (0.035, 0.037, 0.042), (0.66, 0.64, 0.60), (0.13, 0.21, 0.17), (0.56, 0.38, 0.15),
         (0.30, 0.10, 0.075), (0.30, 0.31, 0.33)]
    )  # fmt: skip
    for columns, share, joint in ((38, 0.30, 0.20), (17, 0.42, 0.22), (8, 0.62, 0.20)):
        points = jittered_points(columns, columns, rng, jitter=1.0)
        d, index, _ = nearest(u, v, points)
        i = index[..., 0]
        keep = rng.uniform(size=len(points)) < share
        colour = stones[rng.integers(0, len(stones), len(points))] * np.exp(rng.normal(0, 0.12, (len(points), 1)))
        seat = rng.uniform(0.02, 0.05, len(points))
        mottle = fbm(u, v, 2 * columns, 2 * columns, 3, rng)
        chip = keep[i] * smoothstep(joint, joint + 0.05, (d[..., 1] - d[..., 0]) * columns)
        base = mix(base, colour[i] * (1 + 0.18 * mottle)[..., None], chip)
        level = level * (1 - chip) + seat[i] * chip
    hole = smoothstep(0.44, 0.60, fbm(u, v, 18, 18, 3, rng)) * (level < 0.01)
    height = level + 0.012 * grain - 0.16 * hole
    return base * (1 - 0.5 * hole)[..., None], height, 0.38 - 1.2 * level + 0.4 * hole + 0.03 * grain


def cobble(u, v, rng, size):
    """Rounded river pebbles set in sandy mortar, grey, brown and white, some banded."""
    columns = 9
    bend = [0.010 * fbm(u, v, 7, 7, 3, rng) for _ in range(2)]
    points = jittered_points(columns, columns, rng, jitter=0.72, brick=False)
    d, index, offset = nearest(u + bend[0], v + bend[1], points, k=6)
    i = index[..., 0]
    gap = worn_gap(d * columns, 6.0)
    dome = np.sqrt(1 - (1 - np.clip((gap + 0.02) / 0.66, 0, 1)) ** 2)
    tall = rng.uniform(0.75, 1.0, len(points))[i]
    stones = np.array(
        [(0.20, 0.20, 0.205), (0.30, 0.285, 0.26), (0.115, 0.118, 0.125), (0.28, 0.18, 0.115), (0.56, 0.54, 0.50),
         (0.36, 0.27, 0.19)]
    )  # fmt: skip
    colour = stones[rng.integers(0, len(stones), len(points))]
    grain = fbm(u, v, 60, 60, 3, rng, gain=0.6)
    turn = rng.uniform(0, np.pi, len(points))[i]
    across = (offset[..., 0] * np.cos(turn) + offset[..., 1] * np.sin(turn)) * columns
    band = np.sin(13 * across + 2.5 * grain) * (rng.uniform(size=len(points)) < 0.35)[i]
    sand = fbm(u, v, 45, 45, 4, rng, gain=0.75)
    stone = smoothstep(0.0, 0.25, dome)
    base = mix(np.array((0.36, 0.30, 0.22)) * (1 + 0.5 * sand)[..., None],
               colour[i] * (1 + 0.22 * grain + 0.16 * band)[..., None], stone)  # fmt: skip
    base *= (0.45 + 0.55 * smoothstep(0.0, 0.6, dome + 0.15))[..., None]
    height = 3.0 * tall * dome + 0.04 * grain * stone + 0.22 * sand * (1 - stone)
    return base, height, 0.92 - 0.42 * stone + 0.05 * grain
