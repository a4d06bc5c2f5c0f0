# SPDX-License-Identifier: GPL-3.0-or-later
"""The virtual gonioreflectometer against Cycles rendering the same displaced patch: mean radiance at random pairs.

scripts/study check-patch                            eight patches, 20 pairs each
scripts/study check-patch leather carpet --pairs 8   some of them, fewer pairs

Pairs of light and view are drawn uniformly over the hemisphere above 15 degrees of elevation (none is in the list of
151), and six more where the light, the view or both are below that. Errors are |ours / Cycles - 1| of the mean over the
tile, all channels. "reciprocal": the same micro-BRDF is built in Cycles from a Diffuse BSDF and Principled's layer;
"principled": a plain Principled BSDF, whose coupling of base and layer is another one. Seeds are fixed.
"""

import tempfile
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.btf.procedural import Maps
from btfsep_engine.btf.procedural import maps as procedural_maps
from btfsep_engine.render.microfacet import layer_albedo
from btfsep_engine.render.patch import Patch
from scripts.cycles import patch_scene
from scripts.cycles.studio import quiet
from scripts.studies import parser, tables

LIMIT = np.cos(np.radians(75))
BEYOND = 6


def waves(base, f0, *, roughness=0.5, metallic=None):
    """Ridges with a finer wave on them, along u."""
    n = 96
    x = (np.arange(n) + 0.5) / n
    height = np.tile((0.8 * np.sin(4 * np.pi * x) + 0.2 * np.sin(8 * np.pi * x)).astype(np.float32), (n, 1))
    colour = np.broadcast_to(np.asarray(base, np.float32), (n, n, 3))
    metal = None if metallic is None else np.full_like(height, metallic)
    return Maps("study/waves", colour, height, np.full_like(height, roughness), 10.0, f0, metal)


PATCHES = {
    "diffuse waves": lambda: waves((0.7, 0.4, 0.1), 0.0),
    "glossy waves": lambda: waves((0.5, 0.2, 0.05), 0.04),
    "metal waves": lambda: waves((0.9, 0.6, 0.3), 0.04, roughness=0.6, metallic=1.0),
    "leather": lambda: procedural_maps("leather/brown-grain", 192),
    "carpet": lambda: procedural_maps("carpet/cut-wine", 192),
    "weave": lambda: procedural_maps("fabric/linen-plain", 192),
    "stone": lambda: procedural_maps("stone/sandstone-yellow", 192),
    "wood": lambda: procedural_maps("wood/oak-boards", 192),
}


def directions(rng, count, low, high):
    """(count, 3): uniform over the directions whose z is between ``low`` and ``high``."""
    z, phi = rng.uniform(low, high, count), rng.uniform(0, 2 * np.pi, count)
    s = np.sqrt(1 - z * z)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], -1)


def pairs(count):
    """Views and lights, ``count`` above the limit, then BEYOND with the view, the light, or both below it."""
    rng = np.random.default_rng(2014)
    views, lights = directions(rng, count, LIMIT, 1), directions(rng, count, LIMIT, 1)
    low, high = directions(rng, 2 * BEYOND, np.cos(np.radians(85)), LIMIT), directions(rng, 2 * BEYOND, LIMIT, 1)
    kind = np.arange(BEYOND) % 3
    grazing_views = np.where((kind != 1)[:, None], low[:BEYOND], high[:BEYOND])
    grazing_lights = np.where((kind != 0)[:, None], low[BEYOND:], high[BEYOND:])
    return np.concatenate([views, grazing_views]), np.concatenate([lights, grazing_lights])


def reflectometer(maps, views, lights):
    """(pairs, 3) mean radiance."""
    blocks = Patch(maps, lights, seed=1).views(views, texels=64, samples=4)
    return np.stack([block[:, :, i].mean(1) for i, block in enumerate(blocks)])


def rendered(maps, views, lights, layer, samples, folder):
    """(pairs, 3) mean radiance by Cycles."""
    with quiet():
        patch_scene.build(maps, layer=layer)
        options = {"size_mm": maps.size_mm, "samples": samples}
        found = [
            patch_scene.mean_radiance(v, l, folder / "image.exr", seed=i, **options)
            for i, (v, l) in enumerate(zip(views, lights, strict=True))
        ]
    return np.array(found)


def compared(name, what, ours, theirs, count):
    """A line of the table, and the errors of the pairs that are not grazing."""
    error = np.abs(ours / theirs - 1)
    near, far = error[:count], error[count:]
    return (name, what, *(f"{f(part):.1%}" for part in (near, far) for f in (np.median, np.max))), near


def main(arguments) -> None:
    options = parser("check-patch", __doc__)
    options.add_argument("names", nargs="*", help=f"some of: {', '.join(PATCHES)}")
    options.add_argument("--pairs", type=int, default=20)
    options.add_argument("--samples", type=int, default=24, help="of Cycles, a pixel")
    given = options.parse_args(arguments)
    if unknown := set(given.names) - set(PATCHES):
        options.error(f"no patch is called {', '.join(unknown)}; choose from {', '.join(PATCHES)}")
    views, lights = pairs(given.pairs)
    lines, alike = [], []
    with tempfile.TemporaryDirectory() as folder:
        for name in tqdm(given.names or PATCHES):
            maps = PATCHES[name]()
            ours = reflectometer(maps, views, lights)
            coupled = maps.f0 > 0 and not maps.metal()
            layer = layer_albedo(maps.f0) if coupled else None
            theirs = rendered(maps, views, lights, layer, given.samples, Path(folder))
            row, near = compared(name, "reciprocal" if coupled else "same", ours, theirs, given.pairs)
            lines, alike = [*lines, row], [*alike, near]
            if coupled:
                plain = rendered(maps, views, lights, None, given.samples, Path(folder))
                lines.append(compared(name, "principled", ours, plain, given.pairs)[0])
    print(tables.table(("patch", "against Cycles", "median", "worst", "beyond 75°: median", "worst"), lines))
    print(f"\nmedian of all, like with like: {np.median(alike):.1%}, worst {np.max(alike):.1%}")
