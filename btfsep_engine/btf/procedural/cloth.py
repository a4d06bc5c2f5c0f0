# SPDX-License-Identifier: GPL-3.0-or-later
"""More fabrics: herringbone wool, satin, corduroy, a knit."""

import numpy as np

from btfsep_engine.btf.procedural.noise import fbm, mix, smoothstep
from btfsep_engine.btf.procedural.woven import weave


def herringbone(u, v, rng, size):
    """Two-two twill that turns every eight warps: charcoal warp, cream weft, woolly."""
    yarns = 32
    i, j = np.meshgrid(np.arange(16), np.arange(16), indexing="ij")
    pattern = (i + np.where(j < 8, j, 15 - j)) % 4 < 2
    height, top, across, yarn, strand = weave(
        u, v, rng, yarns=yarns, pattern=pattern, radius=0.55, flat=0.75, swing=0.15, wander=0.10, plies=1.3
    )
    wool = fbm(u, v, 60, 60, 2, rng)
    tone = rng.normal(0, 1, 2 * yarns).clip(-2, 2)[yarn]
    warp = mix((0.030, 0.028, 0.028), (0.085, 0.080, 0.078), 0.5 + 0.15 * tone + 0.2 * strand + 0.4 * wool)
    weft = mix((0.44, 0.39, 0.31), (0.64, 0.59, 0.50), 0.5 + 0.12 * tone + 0.2 * strand + 0.4 * wool)
    base = np.where(top[..., None], warp, weft) * (1 - 0.25 * np.abs(across) ** 3)[..., None]
    return base, height * size / yarns + 0.05 * wool, np.full_like(u, 0.85)


def satin(u, v, rng, size):
    """Eight-end satin, crimson: long smooth floats of the warp, weft only in scattered points; gloss."""
    yarns = 48
    i, j = np.meshgrid(np.arange(8), np.arange(8), indexing="ij")
    pattern = (3 * i) % 8 != j
    height, top, across, yarn, _ = weave(
        u, v, rng, yarns=yarns, pattern=pattern, radius=0.64, flat=0.30, swing=0.05, wander=0.05, plies=0.0
    )
    tone = rng.normal(0, 1, 2 * yarns).clip(-2, 2)[yarn]
    filament = fbm(u, v, 160, 6, 1, rng)
    base = mix((0.30, 0.006, 0.020), (0.46, 0.014, 0.034), 0.5 + 0.12 * tone + 0.3 * filament)
    base *= np.where(top, 1.0, 0.80)[..., None] * (1 - 0.22 * np.abs(across) ** 4)[..., None]
    wave = fbm(u, v, 2, 2, 2, rng)  # the cloth does not lie quite flat
    return base, height * size / yarns + 0.80 * wave + 0.006 * filament, np.where(top, 0.30, 0.42) + 0.03 * filament


def corduroy(u, v, rng, size):
    """Wide-wale corduroy, olive: round ribs of cut pile between furrows that show the ground weave."""
    wales = 8
    sway = 0.004 * fbm(u, v, 4, 6, 3, rng)
    phase = (u + sway) * wales % 1.0 - 0.5
    dome = np.sqrt(np.maximum(1 - (phase / 0.43) ** 2, 0))
    tuft = fbm(u, v, 40, 88, 3, rng, gain=0.7)
    brushed = fbm(u, v, 3, 5, 4, rng, gain=0.6)
    ground = 0.5 + 0.5 * np.sin(2 * np.pi * 64 * v)
    nap = smoothstep(0.0, 0.45, dome)
    height = 1.35 * dome + 0.28 * tuft * nap + 0.07 * ground * (1 - nap)
    base = mix((0.060, 0.058, 0.015), (0.24, 0.215, 0.070), 0.30 + 0.38 * dome + 0.45 * tuft + 0.25 * brushed)
    return base * (0.40 + 0.60 * nap)[..., None], height, np.full_like(u, 0.82)


def knit(u, v, rng, size):
    """Chunky stocking stitch, oatmeal: columns of V-shaped loops of a three-ply yarn."""
    wales, courses = 8, 12
    wobble = [0.005 * fbm(u, v, 5, 5, 3, rng) for _ in range(2)]
    a, b = (u + wobble[0]) * wales, (v + wobble[1]) * courses
    half, tall = 0.5 * size / wales, size / courses  # mm: width of a leg's place, height of a stitch
    column, left = np.floor(a).astype(int), (a % 1.0) < 0.5
    x = np.abs(a % 1.0 - 0.5) * 2 * half - 0.52 * half  # from the middle of the leg, outward
    lean = np.arctan(0.62 * half / tall)
    c, s = np.cos(lean), np.sin(lean)
    long, thick = 0.98 * tall, 0.47 * half + 0.12 * tall
    tone = rng.normal(0, 1, (courses, wales)).clip(-2, 2)
    height, strand, shade = (np.full_like(u, fill) for fill in (0.0, 0.0, 0.0))
    for step in (-1, 0, 1):
        row = np.floor(b).astype(int) + step
        y = (b - row - 0.5) * tall
        along, across = y * c + x * s, x * c - y * s
        bulge = np.sqrt(np.maximum(1 - (along / long) ** 2 - (across / thick) ** 2, 0))
        # a leg comes out of the loop below it and slips under the one above
        z = np.where(bulge > 0, 1.15 * thick * bulge - 0.26 * along, 0.0)
        over = z > height
        ply = np.sin(2 * np.pi * (0.85 * along + 0.55 * across) + np.where(left, 0, np.pi))
        height, strand = np.where(over, z, height), np.where(over, ply, strand)
        shade = np.where(over, tone[row % courses, column % wales], shade)
    fuzz = fbm(u, v, 60, 60, 3, rng, gain=0.6)
    base = mix((0.34, 0.27, 0.18), (0.66, 0.58, 0.45), 0.60 + 0.07 * shade + 0.16 * strand + 0.30 * fuzz)
    deep = smoothstep(0.0, 0.9, height)
    return base * (0.22 + 0.78 * deep)[..., None], height + 0.07 * strand * deep + 0.06 * fuzz, np.full_like(u, 0.87)
