# SPDX-License-Identifier: GPL-3.0-or-later
"""Factorisation: error against components and megabytes, and the number from which more stops paying.

scripts/study factorisation                         the table, and docs/images/factorisation.png
scripts/study factorisation --materials stone/granite-grey --texels 64 --to FILE.png

Each material is measured as the library's are (one path a texel and view, all 151 x 151 pairs) and factorised with
every number of components from the same sketch. The reference is measured anew, with other random numbers and 16 paths
a texel, at six of the views. Two errors are told, both relative, root mean square over texels:

  relit    of pictures of the patch under natural light (eight environment maps that nothing was trained with, the
           patch lying and standing, turned twice): what recognition and estimation see
  single   of single pairs of directions, each divided by its mean

What the reference's own noise adds is measured, by the difference of its halves, and taken off. One component is the
mean alone, so the error there is the texture's contrast. With many, the paths' noise is kept instead of averaged, and
the error rises again. More stop paying at the fewest components whose two errors, over all materials, are within 3 % of
the least: that is what the default should be.
"""

from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.btf import procedural
from btfsep_engine.btf.directions import light_projection, ubo2014_directions
from btfsep_engine.btf.factorise import StreamingFactoriser
from btfsep_engine.commands import measure as measuring
from btfsep_engine.light.lightings import EnvironmentMaps, shrink
from btfsep_engine.light.maps import read_map
from btfsep_engine.render.patch import Patch
from scripts.cycles.lights import studio_lights
from scripts.studies import ROOT, parser, tables
from scripts.studies.makers.prepare_lights import normalised

MATERIALS = ("carpet/loop-sand", "fabric/denim-twill", "leather/brown-grain", "wood/walnut-lacquered")
COMPONENTS = (1, 2, 4, 6, 8, 10, 14, 20, 28, 40, 56)
VIEWS = (0, 9, 27, 52, 71, 110)  # of the reference: 0 to 67.5 degrees from the normal
HALF = 8  # paths a texel of each half of the reference
TOLERANCE = 1.03  # more components stop paying where the errors are so near the least ones
GOLDEN = np.pi * (3 - np.sqrt(5))


def light_columns(directions) -> np.ndarray:
    """(lights, pictures, 3): f @ this is the patch's radiance under each natural light, for f without the cosine."""
    stack = []
    for path in studio_lights().values():
        pixels = normalised(read_map(path))
        stack.append(shrink(pixels, max(1, len(pixels) // 64)))
    maps = EnvironmentMaps(np.stack(stack), tuple(studio_lights()))

    def seen(nodes):
        parts = []
        for number, standing in enumerate((False, False, True, True)):
            c, s = np.cos(number * GOLDEN), np.sin(number * GOLDEN)
            d = nodes[:, [2, 0, 1]] if standing else nodes  # local z is a horizontal axis of the world
            d = np.stack([c * d[:, 0] - s * d[:, 1], s * d[:, 0] + c * d[:, 1], d[:, 2]], -1)
            parts.append(maps.radiance(d).reshape(len(nodes), -1))
        return np.concatenate(parts, 1)

    return light_projection(directions, seen).reshape(len(directions), -1, 3).astype(np.float32)


def squares(block, columns):
    """Of f (texels, lights, 3): the relit pictures (texels, pictures, 3)."""
    return np.einsum("tlc,lmc->tmc", block, columns, optimize=True)


def study(name: str, texels: int, columns, directions) -> dict:
    """name -> (len(COMPONENTS),) errors "relit" and "single", and the reference's own noise in each."""
    patch = Patch(procedural.maps(name, measuring.DEFAULT_SETTINGS["mesh"]), directions, averaged=True)
    factoriser = StreamingFactoriser(texels * texels, max(COMPONENTS))
    for block in patch.views(directions, texels=texels, samples=measuring.DEFAULT_SETTINGS["samples"]):
        for channel in block:
            factoriser.add(channel)
    columns_kept = [3 * view + channel for view in VIEWS for channel in range(3)]  # the patterns are from all views
    factoriser.y, factoriser.means, factoriser.scales = (
        [part[i] for i in columns_kept] for part in (factoriser.y, factoriser.means, factoriser.scales)
    )
    truth = []
    cosine = directions[:, 2].astype(np.float32)
    for half in range(2):
        patch.seed = 1_000_003 + 500_009 * half
        looked = patch.views(directions[list(VIEWS)], texels=texels, samples=HALF)
        truth.append(np.stack([np.moveaxis(block, 0, -1) / cosine[None, :, None] for block in looked]))
    whole, noise = (truth[0] + truth[1]) / 2, (truth[0] - truth[1]) / 2
    del truth
    weight = 1 / np.maximum(whole.mean(1, keepdims=True), 1e-6)
    relit, relit_noise = (np.stack([squares(view, columns) for view in part]) for part in (whole, noise))
    power = (relit**2).mean((1, 3))  # (views, pictures)
    floor = {
        "relit": float(((relit_noise**2).mean((1, 3)) / power).mean()),
        "single": float(((noise * weight) ** 2).mean() / ((whole * weight) ** 2).mean()),
    }
    errors = {"relit": [], "single": []}
    for count in COMPONENTS:
        factoriser.components = count
        factors = factoriser.finish()
        angular = factors.angular.reshape(len(VIEWS), 3, len(directions), -1)
        angular = angular.transpose(0, 2, 1, 3) / cosine[None, :, None, None]
        lit = np.einsum("vlck,lmc->vmck", angular, columns, optimize=True)
        missed = relit - np.einsum("tk,vmck->vtmc", factors.texels, lit, optimize=True)
        square = {"relit": ((missed**2).mean((1, 3)) / power).mean(), "single": 0.0}
        for view, block in enumerate(whole):
            found = np.einsum("tk,lck->tlc", factors.texels, angular[view], optimize=True)
            square["single"] += (((block - found) * weight[view]) ** 2).mean() / len(whole)
        square["single"] /= ((whole * weight) ** 2).mean()
        for kind, value in square.items():
            errors[kind].append(np.sqrt(max(value - floor[kind], 0)))
    return {k: np.array(v) for k, v in errors.items()} | {"noise": {k: np.sqrt(v) for k, v in floor.items()}}


def megabytes(components, texels: int, directions: int) -> np.ndarray:
    """Of a library's file: half floats, header and height map left out."""
    return 2e-6 * np.asarray(components) * (texels**2 + 3 * directions**2)


def enough(relit, single) -> int:
    """The fewest components with both errors within TOLERANCE of the least that any number has."""
    good = (relit <= TOLERANCE * relit.min()) & (single <= TOLERANCE * single.min())
    return COMPONENTS[int(np.argmax(good))] if good.any() else COMPONENTS[int(relit.argmin())]


def draw(found: dict, size, chosen: int, path: Path) -> None:
    """The chart: one line for each material, and their mean."""
    figure = tables.figure(9, 3.9, dpi=140)
    titles = {"relit": "the patch under natural light", "single": "single pairs of light and view"}
    for axes, (kind, words) in zip(figure.subplots(1, 2, sharex=True), titles.items(), strict=True):
        for name, errors in found.items():
            axes.plot(COMPONENTS, errors[kind], marker="o", markersize=3, linewidth=1, label=name)
        axes.plot(COMPONENTS, mean_error(found, kind), color="black", linewidth=2, label="mean of the materials")
        axes.axvline(chosen, color="0.5", linestyle="--", linewidth=1, label=f"default: {chosen}")
        axes.set(xscale="log", ylim=(0, None), xlabel="components", ylabel="relative error", title=words)
        tables.log_ticks(axes.xaxis, 1, 32, (1, 2, 4, 8, 16, 32))
        axes.grid(color="0.9")
        below = axes.secondary_xaxis(-0.24, functions=(lambda k: k * size, lambda mb: mb / size))
        below.set_xlabel("megabytes a material")
        tables.log_ticks(below.xaxis, 0.2, 10, (0.2, 0.5, 1, 2, 5, 10))
    axes.legend(fontsize=7, framealpha=1, edgecolor="none", loc="upper center")
    tables.save(figure, path)


def mean_error(found: dict, kind: str) -> np.ndarray:
    """Root mean square over the materials."""
    return np.sqrt(np.mean([errors[kind] ** 2 for errors in found.values()], 0))


def main(arguments) -> None:
    options = parser("factorisation", __doc__)
    options.add_argument("--materials", nargs="*", default=MATERIALS)
    options.add_argument("--texels", type=int, default=measuring.DEFAULT_SETTINGS["texels"])
    options.add_argument("--to", type=Path, default=ROOT / "docs" / "images" / "factorisation.png")
    given = options.parse_args(arguments)
    directions = ubo2014_directions()
    columns = light_columns(directions)
    chosen, side = measuring.DEFAULT_SETTINGS["components"], measuring.DEFAULT_SETTINGS["texels"]
    found = {name: study(name, given.texels, columns, directions) for name in tqdm(given.materials)}
    for name, each in found.items():
        noise = each["noise"]
        print(f"{name}: the reference's noise, taken off: relit {noise['relit']:.4f}, single {noise['single']:.3f}")
    size = megabytes(1, side, len(directions))
    relit, single = mean_error(found, "relit"), mean_error(found, "single")
    rows = []
    for i, k in enumerate(COMPONENTS):
        errors = (*(f["relit"][i] for f in found.values()), relit[i], single[i])
        rows.append((f"{k}{' (default)' if k == chosen else ''}", f"{k * size:.2f}", *(f"{e:.3f}" for e in errors)))
    print("\n" + tables.table(("components", "MB", *(f"relit, {n}" for n in found), "relit, all", "single, all"), rows))
    least = COMPONENTS[int(relit.argmin())], COMPONENTS[int(single.argmin())]
    print(f"\nleast error: relit with {least[0]} components, single pairs with {least[1]}")
    print(f"more stop paying from {enough(relit, single)} on (both within {TOLERANCE - 1:.0%} of the least); "
          f"the default is {chosen}")  # fmt: skip
    draw(found, size, chosen, given.to)
