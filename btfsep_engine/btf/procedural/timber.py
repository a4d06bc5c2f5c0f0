# SPDX-License-Identifier: GPL-3.0-or-later
"""More woods: pine with knots, bamboo strips, weathered rough-sawn boards, herringbone parquet."""

import numpy as np

from btfsep_engine.btf.procedural.noise import fbm, gradient_noise, mix, smoothstep


def pine(u, v, rng, size):
    """Planed pine: yellow early wood, orange rings that run around two dark knots."""
    knots = np.array([(0.27, 0.30), (0.74, 0.78)]) + rng.uniform(-0.06, 0.06, (2, 2))
    radii = np.array([0.060, 0.040]) * rng.uniform(0.9, 1.1, 2)
    flow, inside, ring, halo = u.copy(), np.zeros_like(u), np.zeros_like(u), np.zeros_like(u)
    rough = fbm(u, v, 10, 8, 3, rng)
    for (x, y), radius in zip(knots, radii, strict=True):
        dx, dy = u - x, v - y
        dx, dy = dx - np.round(dx), (dy - np.round(dy)) / 1.7  # grain closes slowly above and below a knot
        r = np.hypot(dx, dy) * (1 + 0.10 * rough) + 1e-9
        # the stream function of a flow past a cylinder, faded out so that the tile stays periodic
        flow = flow - dx * np.minimum((1.15 * radius / r) ** 2, 1.0) * smoothstep(0.28, 0.10, r)
        ring = np.where(r < radius, 5.5 * r / radius, ring)
        inside = np.maximum(inside, smoothstep(1.08, 0.94, r / radius))
        halo = np.maximum(halo, smoothstep(2.3, 0.95, r / radius))
    phase = 13 * flow + 0.75 * fbm(u, v, 2, 1, 3, rng) + 0.06 * fbm(u, v, 10, 2, 2, rng)
    t = phase % 1.0
    late = smoothstep(0.30, 0.86, t) * smoothstep(1.0, 0.93, t)
    fibre = fbm(u, v, 110, 5, 3, rng)
    base = mix((0.70, 0.47, 0.22), (0.47, 0.215, 0.065), 0.80 * late + 0.16 * fibre + 0.28 * halo)
    heart = mix((0.20, 0.075, 0.026), (0.085, 0.028, 0.012), 0.5 + 0.5 * np.sin(2 * np.pi * ring))
    base = mix(base, heart, inside)
    rim = inside * (1 - inside) * 4
    check = inside * smoothstep(0.035, 0.010, np.abs(gradient_noise(u, v, 14, 14, rng)))
    height = 0.07 * late * (1 - inside) + 0.025 * fibre + 0.05 * inside - 0.18 * rim - 0.30 * check
    return base * (1 - 0.6 * rim)[..., None], height, 0.50 - 0.10 * late + 0.05 * fibre + 0.2 * rim


def bamboo(u, v, rng, size):
    """Laminated bamboo: narrow straight strips, fine dark vessels, a node across each strip; satin lacquer."""
    strips = 6
    number = np.floor(u * strips).astype(int) % strips
    inside = u * strips % 1.0
    node = rng.uniform(0, 1, strips)
    node = (np.arange(strips) * 0.39 + 0.12 * node) % 1.0
    shift = rng.uniform(0, 1, (2, strips))
    cut_u, cut_v = (u + shift[0, number]) % 1.0, (v + shift[1, number]) % 1.0
    fibre = fbm(cut_u, cut_v, 70, 2, 4, rng, gain=0.75)
    vessel = smoothstep(0.22, 0.46, fbm(cut_u, cut_v, 84, 5, 2, rng))
    bow = 0.010 * np.cos(np.pi * (inside - 0.5)) + 0.004 * fbm(u, v, 20, 6, 2, rng)
    away = v + bow - node[number]
    away -= np.round(away)
    line = smoothstep(0.010, 0.003, np.abs(away))
    swell = smoothstep(0.060, 0.0, np.abs(away))
    joint = smoothstep(0.030, 0.012, np.minimum(inside, 1 - inside))
    tone = np.array([0.3, -0.8, 0.9, -0.2, 0.6, -0.7]) + 0.35 * rng.standard_normal(strips).clip(-1, 1)
    base = mix((0.52, 0.345, 0.135), (0.70, 0.545, 0.285), 0.55 + 0.22 * tone[number] + 0.22 * fibre)
    base = base * (1 - 0.30 * vessel - 0.12 * swell)[..., None]
    base = mix(base, (0.19, 0.095, 0.032), 0.85 * line)
    base = base * (1 - 0.60 * joint)[..., None]
    height = 0.02 * fibre - 0.03 * vessel + 0.10 * swell - 0.12 * line - 0.22 * joint
    return base, height, 0.36 + 0.04 * fibre + 0.10 * vessel + 0.2 * joint


def rough_sawn(u, v, rng, size):
    """Weathered rough-sawn boards, silver grey: standing late wood, drying cracks, arcs of the saw, a gap."""
    boards = 2
    number = np.floor(u * boards).astype(int) % boards
    inside = u * boards % 1.0
    shift = rng.uniform(0, 1, (2, boards))
    cut_u, cut_v = (u + shift[0, number]) % 1.0, (v + shift[1, number]) % 1.0
    phase = 17 * cut_u + 1.8 * fbm(cut_u, cut_v, 2, 1, 4, rng) + 0.10 * fbm(cut_u, cut_v, 12, 3, 2, rng)
    late = (0.5 + 0.5 * np.sin(2 * np.pi * phase)) ** 1.5
    fibre = fbm(cut_u, cut_v, 80, 4, 4, rng, gain=0.65)
    saw = 0.5 + 0.5 * np.sin(2 * np.pi * (17 * v + 0.9 * np.cos(np.pi * inside) + 0.5 * fbm(u, v, 3, 9, 3, rng)))
    saw = saw**2 * smoothstep(-0.45, 0.30, fbm(u, v, 3, 3, 3, rng))
    split = np.abs(fbm(cut_u, cut_v, 9, 1, 3, rng))
    crack = smoothstep(0.030, 0.004, split) * smoothstep(0.02, 0.30, fbm(cut_u, cut_v, 5, 2, 3, rng))
    gap = smoothstep(0.030, 0.014, np.minimum(inside, 1 - inside))
    tone = np.array([0.35, -0.35])[number]
    base = mix((0.20, 0.185, 0.165), (0.44, 0.425, 0.395), 0.42 + 0.28 * late + 0.38 * fibre + 0.25 * tone + 0.12 * saw)
    stain = smoothstep(0.05, 0.50, fbm(u, v, 3, 2, 4, rng))
    base = mix(base, (0.21, 0.135, 0.075), 0.45 * stain)
    base *= ((1 - 0.80 * crack) * (1 - 0.88 * gap))[..., None]
    height = 0.30 * late + 0.22 * fibre + 0.26 * saw - 0.80 * crack - 1.7 * gap
    return base, height, np.full_like(u, 0.85)


def parquet(u, v, rng, size):
    """Herringbone parquet: blocks four times as long as wide, each cut from another place; satin varnish."""
    length, cells = 4, 8  # the pattern repeats after 2 * length cells both ways
    i, j = np.floor(u * cells).astype(int), np.floor(v * cells).astype(int)
    fx, fy = u * cells - i, v * cells - j
    m = (i - j) % (2 * length)
    lying = m < length
    along = np.where(lying, m + fx, 2 * length - 1 - m + fy)
    across = np.where(lying, fy, fx)
    start_i, start_j = np.where(lying, i - m, i) % cells, np.where(lying, j, j - (2 * length - 1 - m)) % cells
    block = start_j * cells + start_i
    count = cells * cells
    shift = rng.uniform(0, 1, (2, count))[:, block]
    tone = rng.normal(0, 1, count).clip(-1.6, 1.6)[block]
    arch = rng.normal(0, 0.9, count)[block]  # some blocks show a bent figure
    x, y = (across / cells + shift[0]) % 1.0, (along / cells + shift[1]) % 1.0
    phase = 30 * x + 1.3 * arch * ((along / length - 0.5) * 2) ** 2 + 1.2 * fbm(x, y, 3, 1, 3, rng)
    late = smoothstep(0.25, 0.9, phase % 1.0) * smoothstep(1.0, 0.9, phase % 1.0)
    fibre = fbm(x, y, 100, 7, 3, rng, gain=0.65)
    pore = smoothstep(0.25, 0.50, fbm(x, y, 120, 10, 2, rng))
    edge = np.minimum(np.minimum(across, 1 - across), np.minimum(along, length - along))
    joint = smoothstep(0.040, 0.012, edge)
    bevel = smoothstep(0.10, 0.0, edge)
    base = mix((0.40, 0.205, 0.085), (0.165, 0.068, 0.024), 0.42 + 0.24 * tone + 0.30 * late + 0.22 * fibre)
    base *= ((1 - 0.35 * pore) * (1 - 0.85 * joint))[..., None]
    height = 0.025 * late + 0.02 * fibre - 0.06 * pore - 0.12 * bevel - 0.35 * joint + 0.02 * tone
    return base, height, 0.35 + 0.05 * fibre + 0.12 * pore + 0.3 * joint
