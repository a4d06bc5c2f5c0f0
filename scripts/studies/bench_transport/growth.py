# SPDX-License-Identifier: GPL-3.0-or-later
"""Time and memory of the transport against each size, the others held."""

import gc
from contextlib import suppress
from pathlib import Path

import drjit
import numpy as np

from btfsep_engine.btf.library import open_library
from btfsep_engine.light.lightings import SHBasis
from scripts.studies import tables
from scripts.studies.measures import timed
from scripts.studies.stage import MATERIALS, Stage
from scripts.studies.tables import COLOURS, table

ORDER, DIRECTIONS = 9, 512


def growth(options) -> str:
    """A table for each of pixels, directions, order, triangles, materials; draws transport_growth.png."""
    stage = Stage(size=400)
    library = open_library(None)
    material = library.load(MATERIALS[0])
    loaded = [library.load(n) for n in library.names() if not n.startswith("reference/")][:16]

    def run(points, directions=DIRECTIONS, order=ORDER, materials=(material,), on=stage):
        transport = on.transport(points, directions)
        for used in materials:
            transport.radiance(used, SHBasis(order))

    some, pixels = stage.sample(), (500, 1000, 2000, 4000, 8000, 16000, 32000)
    series = {
        "pixels": [(len(p), lambda p=p: run(p)) for p in map(stage.sample, pixels)],
        "directions": [(n, lambda n=n: run(some, n)) for n in (64, 128, 256, 512, 1024, 2048, 4096)],
        "order": [(n, lambda n=n: run(some, order=n)) for n in range(1, 10)],
        "triangles": [],
        "materials": [(n, lambda n=n: run(some, materials=loaded[:n])) for n in (1, 2, 4, 8, 16) if n <= len(loaded)],
    }
    built = {}
    for level in (2, 4, 5) if options.quick else (2, 4, 5, 6, 7, 8):
        other = Stage(level=level, size=400, textured=False)
        points, triangles = other.sample(), len(other.shape.faces)
        built[triangles] = other.built
        mean = (material.mean_material(),)
        series["triangles"].append((triangles, lambda p=points, o=other, m=mean: run(p, materials=m, on=o)))
    words, rows = [], {}
    for label, cases in series.items():
        rows[label] = [(n, *_measured(call, options.repeats)) for n, call in (cases[:3] if options.quick else cases)]
        print(f"  {label}: {rows[label][-1][0]} in {rows[label][-1][1]:.2f} s", flush=True)
        lines = [
            [label, *(f"{n:,}" for n, *_ in rows[label])],
            ["s (processor)", *(f"{s:.2f} ({w:.2f})" for _, s, w, _ in rows[label])],
            ["MB", *(f"{m:.0f}" for *_, m in rows[label])],
        ]
        if label == "triangles":
            lines.append(["building the scene, s", *(f"{built[n][0]:.2f}" for n, *_ in rows[label])])
        words.append(table(lines[0], lines[1:]))
    _draw(rows, options.images / "transport_growth.png")
    return (
        f"Otherwise {len(some)} pixels, {DIRECTIONS} directions, order {ORDER}, the BTF {MATERIALS[0]} ("
        f"against triangles: its mean ABRDF) on {len(stage.shape.faces):,} triangles. Least seconds of "
        f"{options.repeats} calls; megabytes by which the process grew at most.\n\n" + "\n\n".join(words)
    )


def _measured(call, repeats: int):
    """Least seconds by the clock and of processors, and the most megabytes by which the process grew meanwhile (Linux;
    else nan), of a few calls after one that is not counted."""
    call()
    found = []
    for _ in range(repeats):
        gc.collect()
        drjit.flush_malloc_cache()
        before = np.nan
        with suppress(OSError):  # not Linux: no memory is told
            Path("/proc/self/clear_refs").write_text("5")  # forgets the peak so far
            before = memory("VmRSS")
        seconds, _ = timed(call, afresh=True)
        found.append((*seconds, memory("VmHWM") - before if np.isfinite(before) else np.nan))
    clock, work, grown = zip(*found, strict=True)
    return min(clock), min(work), max(grown)


def memory(field: str) -> float:
    """A field of /proc/self/status in megabytes."""
    line = next(x for x in Path("/proc/self/status").read_text().splitlines() if x.startswith(field))
    return int(line.split()[1]) / 1024


def _draw(series: dict, path: Path) -> None:
    figure = tables.figure(13, 5)
    axes = figure.subplots(2, len(series), sharey="row")
    for column, (label, rows) in enumerate(series.items()):
        rows = np.array(rows)
        ticks = rows[:: 1 + len(rows) // 5, 0]
        for row, which in enumerate((1, 3)):
            axis = axes[row, column]
            axis.loglog(rows[:, 0], np.maximum(rows[:, which], 0.5 if row else 0), "o-", color=COLOURS[row], ms=4)
            axis.grid(alpha=0.3, which="both", lw=0.4)
            axis.set_xticks(ticks, [_short(n) for n in ticks], fontsize=8)
            axis.set_xticks([], minor=True)
        axes[1, column].set_xlabel(label)
    axes[0, 0].set_ylabel("seconds")
    axes[1, 0].set_ylabel("megabytes more at the peak")
    tables.save(figure, path)


def _short(n: float) -> str:
    """4000 as 4k: ticks stand close."""
    for size, letter in ((1e6, "M"), (1e3, "k")):
        if n >= size:
            return f"{n / size:.3g}{letter}"
    return f"{n:.0f}"
