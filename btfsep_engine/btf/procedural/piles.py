# SPDX-License-Identifier: GPL-3.0-or-later
"""More carpets and felts: long and patterned pile, sisal, needled cord; pressed, needled, striped and speckled felt."""

import numpy as np

from btfsep_engine.btf.procedural.noise import fbm, fibres, jittered_points, mix, nearest, smoothstep
from btfsep_engine.btf.procedural.woven import felt, weave


def shag(u, v, rng, size):
    """Long cream shag: locks of soft strands that lie over each other, each curling its own way."""
    columns, reach, broad = 27, 7.4, 1.15
    points = jittered_points(columns, columns, rng)
    count = len(points)
    angle = 1.6 * fbm(*points.T, 3, 3, 2, rng) + rng.normal(0, 0.40, count) - 1.2
    long = reach * rng.uniform(0.7, 1.15, count)
    curl = rng.normal(0, 2.2, count)
    order, tone, phase = rng.uniform(0, 1.1, count), rng.normal(0, 1, count).clip(-2, 2), rng.uniform(0, 6.28, count)
    fray = 0.25 * fbm(u, v, 30, 30, 3, rng)
    # the points nearest to a lock's middle, not to its root, are candidates: half its reach is then enough
    middle = points + 0.5 * (long / size)[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    _, index, _ = nearest(u, v, middle % 1.0, k=24)
    height, base, strand = np.zeros_like(u), np.zeros_like(u), np.zeros_like(u)
    shade = np.zeros_like(u)
    for rank in range(index.shape[-1]):
        i = index[..., rank]
        away = np.stack([u, v], -1) - middle[i]
        away = (away - np.round(away)) * size
        c, s = np.cos(angle[i]), np.sin(angle[i])
        t = (away[..., 0] * c + away[..., 1] * s) / long[i] + 0.5
        inside = np.clip(t, 0, 1)
        across = away[..., 1] * c - away[..., 0] * s - curl[i] * (inside - 0.5) ** 2 + fray
        width = broad * np.sqrt(inside) * (1 - inside**3) + 1e-6
        section = np.sqrt(np.maximum(1 - (across / width) ** 2, 0)) * (t > 0) * (t < 1)
        ply = np.cos(2 * np.pi * (2.6 * across / broad + 0.7 * inside) + phase[i])
        z = section * (0.55 + order[i] + 0.9 * np.sin(np.pi * inside**0.8) + 0.14 * ply)
        over = z > height
        height = np.where(over, z, height)
        base, strand, shade = np.where(over, inside, base), np.where(over, ply, strand), np.where(over, tone[i], shade)
    hair = fbm(u, v, 80, 80, 2, rng)
    light = 0.52 + 0.32 * base + 0.09 * shade + 0.14 * strand + 0.25 * hair
    colour = mix((0.44, 0.34, 0.22), (0.80, 0.72, 0.58), light)
    deep = smoothstep(0.0, 1.7, height)
    height = height + 0.06 * hair + 0.2 * fbm(u, v, 4, 4, 3, rng)
    return colour * (0.45 + 0.55 * deep)[..., None], height, np.full_like(u, 0.8)


def sisal(u, v, rng, size):
    """Natural sisal: a coarse weave of stiff, straw-coloured, stringy yarns over a dark ground."""
    yarns = 12
    pattern = np.array([[True, False], [False, True]])
    height, top, across, yarn, _ = weave(
        u, v, rng, yarns=yarns, pattern=pattern, radius=0.50, flat=0.60, swing=0.17, wander=0.10, plies=0.4
    )
    string = np.where(top, fbm(u, v, 110, 9, 2, rng), fbm(u, v, 9, 110, 2, rng))
    tone = rng.normal(0, 1, 2 * yarns).clip(-2, 2)[yarn]
    base = mix((0.24, 0.15, 0.055), (0.68, 0.53, 0.27), 0.55 + 0.10 * tone + 0.45 * string + 0.08 * top)
    edge = smoothstep(1.05, 0.55, np.abs(across))
    height = np.maximum(height, -0.34)  # the backing, seen between the yarns
    base *= (0.30 + 0.70 * edge)[..., None]
    return base, height * size / yarns + 0.13 * string, 0.62 - 0.10 * string


def trellis_pile(u, v, rng, size):
    """Low cut pile with a woven-in pattern: an ivory trellis with red flowers on navy."""
    columns = 76
    lean_u, lean_v = (0.006 * fbm(u, v, 4, 4, 3, rng) for _ in range(2))
    ends = jittered_points(columns, columns, rng, jitter=0.9)
    d, index, _ = nearest(u + lean_u, v + lean_v, ends)
    i = index[..., 0]
    x, y = (2 * ends).T  # every tuft has one colour: the pattern's at its foot
    diamond = np.abs(((x + y + 0.5) % 1.0) - 0.5), np.abs(((x - y + 0.5) % 1.0) - 0.5)
    line = np.minimum(*diamond) < 0.045
    centre = np.array([(0.5, 0.0), (0.0, 0.5)])[:, :, None]  # two diamonds to a repeat, a flower in each
    away = np.stack([x, y])[None] - centre
    away -= np.round(away)
    first = np.hypot(*away[0]) < np.hypot(*away[1])
    dx, dy = np.where(first, away[0], away[1])
    near, turn = np.hypot(dx, dy), np.arctan2(dy, dx)
    petal = near < 0.20 * (0.62 + 0.38 * np.cos(6 * turn))
    heart = near < 0.055
    colour = np.full((len(ends), 3), (0.018, 0.030, 0.095))
    colour[line] = (0.62, 0.54, 0.40)
    colour[petal] = (0.42, 0.035, 0.030)
    colour[heart] = (0.60, 0.38, 0.08)
    colour *= np.exp(rng.normal(0, 0.14, (len(ends), 1)))
    end = np.sqrt(np.maximum(1 - (d[..., 0] * columns / 0.80) ** 2, 0))
    stick = rng.uniform(0, 1, len(ends))[i]
    height = end * (0.50 + 0.30 * stick) + 0.22 * (line | petal)[i] + 0.10 * fbm(u, v, 4, 4, 3, rng)
    return colour[i] * (0.5 + 0.5 * end)[..., None], height, np.full_like(u, 0.88)


def needled_cord(u, v, rng, size):
    """Needle-punched contract carpet: anthracite ribs of matted hairs with pale flecks."""
    ribs, count = 8, 2600
    sway = 0.006 * fbm(u, v, 5, 5, 3, rng)
    rib = smoothstep(-0.55, 0.75, np.cos(2 * np.pi * ribs * (u + sway)))
    lift = 0.28
    hair, index = fibres(
        len(u), rng, count=count, length=4.5 / size, radius=(0.06 / size, 0.10 / size), curl=0.9, lift=lift / size
    )
    colours = np.array([(0.028, 0.032, 0.040)] * 5 + [(0.06, 0.075, 0.10)] * 3 + [(0.26, 0.28, 0.31)])
    pick = colours[rng.integers(0, len(colours), count + 1)]
    depth = np.clip(hair * size / (lift + 0.1), 0, 1)
    base = pick[index] * ((0.5 + 0.5 * depth) * (0.35 + 0.65 * rib))[..., None]
    return base, 1.25 * rib + hair * size + 0.15 * fbm(u, v, 9, 9, 3, rng), np.full_like(u, 0.9)


def felt_red(u, v, rng, size):
    """Thick pressed wool, bright red: short fine hairs, a soft cloudy surface."""
    base, height, roughness = felt(
        u, v, rng, size, count=5200, length=2.6, radius=(0.045, 0.075), curl=1.3, lift=0.16,
        colours=[(0.50, 0.018, 0.020), (0.58, 0.030, 0.026), (0.42, 0.012, 0.016)], spread=0.08, lumps=0.30,
        roughness=0.9,
    )  # fmt: skip
    cloud = fbm(u, v, 5, 5, 4, rng, gain=0.6)
    return base * (1 + 0.22 * cloud)[..., None], height, roughness


def felt_needled(u, v, rng, size):
    """Needle-punched charcoal felt: rows of dimples where the needles have drawn the hairs in."""
    base, height, roughness = felt(
        u, v, rng, size, count=2600, length=5.5, radius=(0.05, 0.09), curl=0.5, lift=0.30,
        colours=[(0.045, 0.05, 0.06)] * 4 + [(0.10, 0.11, 0.13)] * 2 + [(0.20, 0.22, 0.25)], spread=0.15, lumps=0.10,
        roughness=0.85,
    )  # fmt: skip
    points = jittered_points(14, 16, rng, jitter=0.30, brick=True)
    d, index, _ = nearest(u, v, points)
    deep = rng.uniform(0.6, 1.0, len(points))[index[..., 0]]
    hole = deep * smoothstep(0.40, 0.05, d[..., 0] * 15)
    return base * (1 - 0.75 * hole)[..., None], height - 0.75 * hole, roughness


def felt_striped(u, v, rng, size):
    """Felted in stripes of ochre, brown and cream; hairs stray over the borders."""
    count, lift = 4600, 0.30
    hair, index = fibres(
        len(u), rng, count=count, length=4.0 / size, radius=(0.06 / size, 0.11 / size), curl=1.0, lift=lift / size
    )
    stray = rng.normal(0, 0.013, count + 1).clip(-0.035, 0.035)[index] + 0.012 * fbm(u, v, 5, 5, 3, rng)
    place = (v + stray) % 1.0
    edges = np.array([0.0, 0.17, 0.24, 0.50, 0.60, 0.67, 1.0])
    colours = np.array(
        [(0.62, 0.36, 0.05), (0.13, 0.055, 0.022), (0.66, 0.58, 0.42), (0.13, 0.055, 0.022), (0.62, 0.36, 0.05),
         (0.36, 0.13, 0.035)]
    )  # fmt: skip
    base = colours[np.searchsorted(edges, place, side="right") - 1]
    base = base * np.exp(rng.normal(0, 0.13, count + 1))[index][..., None]
    depth = np.clip(hair * size / (lift + 0.1), 0, 1)
    return base * (0.55 + 0.45 * depth)[..., None], hair * size + 0.18 * fbm(u, v, 5, 5, 4, rng), np.full_like(u, 0.88)


def felt_speckled(u, v, rng, size):
    """Cream felt with coloured neps: small knots of other wool pressed in."""
    base, height, roughness = felt(
        u, v, rng, size, count=4200, length=3.6, radius=(0.05, 0.09), curl=1.1, lift=0.24,
        colours=[(0.66, 0.60, 0.48), (0.72, 0.67, 0.56), (0.60, 0.53, 0.41)], spread=0.05, lumps=0.15, roughness=0.88,
    )  # fmt: skip
    points = jittered_points(15, 15, rng, jitter=1.0)
    bend = [0.010 * fbm(u, v, 24, 24, 3, rng) for _ in range(2)]
    d, index, _ = nearest(u + bend[0], v + bend[1], points)
    i = index[..., 0]
    colours = np.array([(0.03, 0.09, 0.24), (0.50, 0.08, 0.04), (0.58, 0.32, 0.03), (0.05, 0.045, 0.04)])
    pick = colours[rng.integers(0, 4, len(points))]
    reach = np.where(rng.uniform(size=len(points)) < 0.62, rng.uniform(0.14, 0.34, len(points)), -1.0)
    nep = smoothstep(0.06, -0.06, d[..., 0] * 15 - reach[i])
    weight = 0.92 * nep
    light = base.mean(-1) / 0.6  # the hairs run over the neps
    return (
        base * (1 - weight)[..., None] + (pick[i] * light[..., None]) * weight[..., None],
        height + 0.22 * nep,
        roughness,
    )
