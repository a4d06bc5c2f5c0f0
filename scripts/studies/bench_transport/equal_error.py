# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel against the path tracer (one Mitsuba render for each basis light and sign) at equal error.

Both look through the centres of the same pixels. Errors are relative L2 over pixels, lights and channels. The kernel's
is that of its quadrature, against very many directions, on some of the pixels; and if these with very many directions
differ from a long render by the path tracer by more than that one's noise (known from the spread of its paths), what is
too much counts as the kernel's error as well.
"""

import numpy as np

from btfsep_engine.btf.library import open_library
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.render.reference import Reference
from scripts.studies import tables
from scripts.studies.measures import timed
from scripts.studies.stage import Stage
from scripts.studies.tables import COLOURS

ORDER = 4
TRUE = 20011  # directions of the truth
FEW = 64  # pixels, of a render that compiles, and of one that shows what a render costs whatever the pixels
HEAD = (
    "material", "directions", "kernel, s (processor)", "error", "reference, s (processor)", "its error",
    "samples that it needs for the kernel's error", "s", "times longer", "by processor time", "squares over noise",
)  # fmt: skip


def reference(options) -> str:
    """Basis images of order 4 for textured materials with self-shadowing; draws transport.png."""
    lights, library = SHBasis(ORDER), open_library(None)
    stage = Stage(size=options.size)
    count = len(stage.points)
    some = np.sort(np.random.default_rng(0).choice(count, min(options.judged, count), replace=False))
    figure = tables.figure(11, 3.6)
    axes = figure.subplots(1, len(options.materials), sharey=True, squeeze=False)
    rows = []
    for name, axis in zip(options.materials, axes[0], strict=True):
        rows += _material(name, axis, library.load(name), stage, lights, some, options)
        print(f"  {name}: {rows[-1][-3]} times", flush=True)
    axes[0, 0].set_ylabel("relative error")
    axes[0, 0].legend(fontsize=8, frameon=False)
    tables.save(figure, options.images / "transport.png")
    return (
        f"{lights.count} basis images, {options.size} x {options.size}, of which {count} pixels are the object's; the "
        f"reference with {options.low_samples} samples a pixel, its time for the kernel's error extrapolated by 1 / "
        f"sqrt(samples). Errors are judged on {len(some)} pixels, against {TRUE} directions; the last column has the "
        f"squared differences between these and {options.judge_samples} samples a pixel, over the variance of the "
        "latter: 1 is noise alone.\n\n" + tables.table(HEAD, rows)
    )


def _material(name, axis, material, stage, lights, some, options) -> list:
    """The table's rows of one material; its curves are drawn."""
    renderer = Reference(stage.job, stage.tracer, [material], bounces=1, textured=True)
    pixels = stage.points.pixels

    def render(chosen, samples, seed=0):
        return timed(lambda: renderer.radiance(chosen, lights, samples=samples, seed=seed, jitter=False))

    judge = render(pixels[some], options.judge_samples, seed=1)[1]
    noise = judge.variance.astype(np.float64).sum()
    power = (judge.radiance.astype(np.float64) ** 2).sum() - noise
    render(pixels[:FEW], options.low_samples)
    fixed, _ = render(pixels[:FEW], options.low_samples)
    low_seconds, low = render(pixels, options.low_samples)
    low_error = np.sqrt(low.variance[some].astype(np.float64).sum() / power)
    truth = stage.transport(stage.points.take(some), TRUE).radiance(material, lights).astype(np.float64)
    off = ((truth - judge.radiance) ** 2).sum()
    rows, reached = [], []
    for directions in options.directions:
        stage.transport(stage.points.take(slice(0, FEW)), directions).radiance(material, lights)  # compiles
        seconds, got = timed(
            lambda d=directions: stage.transport(stage.points, d).radiance(material, lights), afresh=True
        )
        squared = ((got[some] - truth) ** 2).sum() + max(off - noise, 0)
        error = np.sqrt(squared / power)
        reached.append((seconds[0], error))
        share = (low_error / error) ** 2
        needed = fixed + (low_seconds - fixed) * share
        times = needed / seconds
        rows.append(
            (
                name, directions, f"{seconds[0]:.2f} ({seconds[1]:.2f})", f"{error:.3f}",
                f"{low_seconds[0]:.1f} ({low_seconds[1]:.1f})", f"{low_error:.2f}",
                f"{options.low_samples * share:.0f}", f"{needed[0]:.0f}", *(f"{t:.0f}" for t in times),
                f"{off / noise:.2f}",
            )
        )  # fmt: skip
    reached = np.array(reached)
    law = np.array([low_error, min(reached[:, 1].min(), low_error)])
    axis.loglog(fixed[0] + (low_seconds - fixed)[0] * (low_error / law) ** 2, law, "--", color=COLOURS[1])
    axis.loglog(low_seconds[0], low_error, "s", color=COLOURS[1], label="path tracer;\ndashed: its noise law")
    axis.loglog(*reached.T, "o-", color=COLOURS[0], label="kernel")
    for (x, y), directions in zip(reached, options.directions, strict=True):
        axis.annotate(f"{directions}", (x, y), textcoords="offset points", xytext=(7, 3), fontsize=8)
    axis.set_title(name, fontsize=10)
    axis.set_xlabel(f"seconds for {lights.count} basis images")
    axis.grid(alpha=0.3, which="both", lw=0.4)
    return rows
