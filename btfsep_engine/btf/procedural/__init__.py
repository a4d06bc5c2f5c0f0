# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural materials, six for each class of UBO2014: colour, height and roughness maps of a periodic patch.

The physical definition, shared by the virtual gonioreflectometer (:mod:`btfsep_engine.render.patch`) and by anyone
who displaces real geometry with the same maps: a height field over the patch; at each point a dielectric with a
diffuse base of colour ``base_colour`` under a GGX specular layer of ``roughness`` (alpha = roughness squared) and
normal-incidence reflectance ``f0`` (refractive index (1 + sqrt f0) / (1 - sqrt f0)): Blender's Principled BSDF, GGX.

Highlights narrower than the 15 degrees between UBO2014's directions (level materials smoother than 0.3: granite,
walnut) are that wide in a table, their energy kept (:mod:`btfsep_engine.render.hats`).
"""

import difflib
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from btfsep_engine.btf.procedural import cloth, hard, hides, papers, piles, stones, timber, woven
from btfsep_engine.btf.procedural.noise import grid
from btfsep_engine.errors import InputError
from btfsep_engine.imaging.images import write_exr

WORK_PIXELS = 512  # patterns are made with at least so many pixels an edge, then averaged down
MAX_ALBEDO = 0.85


@dataclass(frozen=True)
class Maps:
    """One periodic patch of a material.

    Attributes
    ----------
    name : "class/material"
    base_colour : (n, n, 3) float32, linear RGB, in (0, 0.85]; row 0 is the smallest v
    height_mm : (n, n) float32, mm; the mean is 0
    roughness : (n, n) float32, in [0.15, 1]; alpha of GGX is its square
    size_mm : edge of the patch, mm
    f0 : float, specular reflectance of what is no metal at normal incidence
    metallic : (n, n) float32, in [0, 1], or None: nothing is metal. Where it is 1, there is no diffuse base, and
        ``base_colour`` (up to 0.98 there) is the reflectance at normal incidence
    """

    name: str
    base_colour: np.ndarray
    height_mm: np.ndarray
    roughness: np.ndarray
    size_mm: float
    f0: float = 0.04
    metallic: np.ndarray | None = None

    @property
    def material_class(self) -> str:
        """The part of the name before the slash."""
        return self.name.split("/")[0]

    def metal(self) -> tuple:
        """The metallic map, if anything is metal, as a tuple of one or none."""
        return () if self.metallic is None or not self.metallic.max() > 0 else (self.metallic,)


# name -> (function of u, v, rng, size; edge of the patch in mm; f0)
RECIPES = {
    "carpet/loop-sand": (woven.carpet_loop, 32.0, 0.03),
    "carpet/cut-wine": (woven.carpet_cut, 28.0, 0.03),
    "carpet/shag-cream": (piles.shag, 44.0, 0.03),
    "carpet/sisal-natural": (piles.sisal, 36.0, 0.04),
    "carpet/trellis-navy": (piles.trellis_pile, 56.0, 0.03),
    "carpet/cord-anthracite": (piles.needled_cord, 34.0, 0.03),
    "fabric/linen-plain": (woven.linen, 22.0, 0.03),
    "fabric/denim-twill": (woven.denim, 20.0, 0.03),
    "fabric/herringbone-wool": (cloth.herringbone, 34.0, 0.03),
    "fabric/satin-crimson": (cloth.satin, 16.0, 0.05),
    "fabric/corduroy-olive": (cloth.corduroy, 26.0, 0.03),
    "fabric/knit-oatmeal": (cloth.knit, 40.0, 0.03),
    "felt/grey-melange": (woven.felt_grey, 22.0, 0.03),
    "felt/green-coarse": (woven.felt_green, 26.0, 0.03),
    "felt/red-pressed": (piles.felt_red, 24.0, 0.03),
    "felt/charcoal-needled": (piles.felt_needled, 26.0, 0.03),
    "felt/striped-ochre": (piles.felt_striped, 34.0, 0.03),
    "felt/speckled-cream": (piles.felt_speckled, 30.0, 0.03),
    "leather/brown-grain": (hard.leather_brown, 28.0, 0.04),
    "leather/black-nappa": (hard.leather_black, 26.0, 0.04),
    "leather/crocodile-green": (hides.crocodile, 52.0, 0.05),
    "leather/perforated-tan": (hides.perforated, 24.0, 0.04),
    "leather/suede-sand": (hides.suede, 24.0, 0.02),
    "leather/saffiano-red": (hides.saffiano, 20.0, 0.045),
    "stone/granite-grey": (hard.granite, 44.0, 0.04),
    "stone/sandstone-yellow": (hard.sandstone, 40.0, 0.04),
    "stone/slate-riven": (stones.slate, 60.0, 0.04),
    "stone/marble-white": (stones.marble, 60.0, 0.05),
    "stone/terrazzo-mixed": (stones.terrazzo, 60.0, 0.04),
    "stone/cobble-river": (stones.cobble, 80.0, 0.04),
    "wallpaper/woodchip-white": (hard.woodchip, 44.0, 0.04),
    "wallpaper/damask-teal": (hard.damask, 48.0, 0.04),
    "wallpaper/stripes-plum": (papers.stripes, 56.0, 0.04),
    "wallpaper/dots-blue": (papers.dots, 56.0, 0.045),
    "wallpaper/grasscloth-straw": (papers.grasscloth, 44.0, 0.035),
    "wallpaper/fans-emerald": (papers.fans, 56.0, 0.045),
    "wood/oak-boards": (hard.oak, 60.0, 0.04),
    "wood/walnut-lacquered": (hard.walnut, 56.0, 0.04),
    "wood/pine-knots": (timber.pine, 60.0, 0.04),
    "wood/bamboo-strips": (timber.bamboo, 56.0, 0.045),
    "wood/rough-sawn-grey": (timber.rough_sawn, 60.0, 0.03),
    "wood/parquet-herringbone": (timber.parquet, 88.0, 0.045),
}
NAMES = tuple(RECIPES)
# Those with files in data/library were measured from these maps: what changes a map of one of them makes its file, and
# every number in docs, stale. The others are a `btfsep library build` away.


def maps(name: str, resolution: int = 256, *, variation: int = 0) -> Maps:
    """The maps of a material.

    Parameters
    ----------
    name : one of :data:`NAMES`
    resolution : pixels an edge
    variation : 0 is the instance in the library; any other number is another instance of the same material,
        laid out anew and of slightly different colour (about 4 % a channel)

    Raises InputError: an unknown name.
    """
    if name not in RECIPES:
        near = difflib.get_close_matches(name, NAMES, 1, 0.0)[0]
        raise InputError(f"material '{name}'", "no procedural material has this name", f"did you mean '{near}'?")
    recipe, size, f0 = RECIPES[name]
    rng = np.random.default_rng([zlib.crc32(name.encode()), variation])
    tint = np.exp(rng.normal(0, 0.04, 3) + rng.normal(0, 0.05)) if variation else np.ones(3)
    factor = -(-WORK_PIXELS // resolution)
    u, v = grid(resolution * factor)
    base, height, roughness = recipe(u, v, rng, size)

    def reduced(a):
        shape = (resolution, factor, resolution, factor, *a.shape[2:])
        return a.reshape(shape).mean((1, 3)).astype(np.float32)

    height = reduced(height)
    return Maps(
        name=name,
        base_colour=reduced(np.clip(base * tint, 0.002, MAX_ALBEDO)),
        height_mm=height - height.mean(),
        roughness=reduced(np.clip(roughness, 0.15, 1.0)),
        size_mm=size,
        f0=f0,
    )


def export_maps(name: str, folder, resolution: int = 1024) -> Maps:
    """Writes ``basecolor.exr`` (linear RGB), ``height.exr`` (mm, mean 0), ``roughness.exr`` of a procedural material.

    The top row of a file is the largest v, as image textures are read (the maps in memory begin with the smallest).

    Gives the Maps: what was written, with size_mm and f0.

    Raises InputError: an unknown name; a folder that cannot be written.
    """
    made = maps(name, resolution)
    for file, values in (("basecolor", made.base_colour), ("height", made.height_mm), ("roughness", made.roughness)):
        write_exr(Path(folder) / f"{file}.exr", np.ascontiguousarray(values[::-1]))
    return made
