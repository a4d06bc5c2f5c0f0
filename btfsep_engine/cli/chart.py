# SPDX-License-Identifier: GPL-3.0-or-later
"""``btfsep chart``: what each setting costs and gives on one job."""

from pathlib import Path

import click

from btfsep_engine.cli.command import LIBRARY, command, opened_library


@click.command()
@click.argument("job", type=click.Path(path_type=Path))
@LIBRARY
@click.option("--material", help="The material of all objects, instead of recognition.")
@click.option("--truth", type=click.Path(path_type=Path), help="The true light: lighting.json or an environment map.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the chart.  [default: JOB/result]")
@click.option("--repeats", type=click.IntRange(1, 50), default=3, show_default=True, help="Timed runs of each setting.")
@click.option(
    "--paper-samples",
    type=click.IntRange(0, 65536),
    default=64,
    show_default=True,
    help="Paths per pixel of the paper's path-traced basis images; 0 leaves them out.",
)
@click.option("--quick", is_flag=True, help="Fewer settings.")
@command
def chart(*, job, library_folder, material, truth, out, repeats, paper_samples, quick, reporter):
    """Charts speed against accuracy of JOB: every setting that trades one for the other, with the Pareto front."""
    from btfsep_engine.pipeline.charting import run_chart

    result = run_chart(
        job,
        opened_library(library_folder),
        material=material,
        truth=truth,
        out=out,
        repeats=repeats,
        paper_samples=paper_samples,
        quick=quick,
        reporter=reporter,
    )
    return result, words(result)


def words(result: dict) -> str:
    """A line for each point, the fastest first; * marks the front."""
    lines = [f"error of order 2 against the {result['reference']}; seconds of transport and fit"]
    for p in sorted(result["points"], key=lambda p: p["seconds"]):
        ratio = f"  {p['paper_ratio']:8.0f} x" if p["paper_ratio"] else ""
        lines.append(f"{'*' if p['front'] else ' '} {p['seconds']:9.3f} s  {p['error']:7.3f}{ratio}  {p['name']}")
    if any(p["paper_ratio"] for p in result["points"]):
        lines.append("x: how many times the paper's path tracing takes as long, in this run")
    lines.append(f"wrote {result['chart']}")
    return "\n".join(lines)
