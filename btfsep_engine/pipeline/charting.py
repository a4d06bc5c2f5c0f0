# SPDX-License-Identifier: GPL-3.0-or-later
"""The command behind the chart of speed against accuracy: reads, measures, writes."""

from pathlib import Path

from btfsep_engine import sh
from btfsep_engine.chart import write_chart
from btfsep_engine.errors import InputError
from btfsep_engine.job.load import load_job
from btfsep_engine.light.files import read_any_lighting
from btfsep_engine.pipeline.record import versions, write_json
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.tradeoff import ORDER, measure


def run_chart(
    folder, library, *, material=None, truth=None, out=None, repeats=3, paper_samples=64, quick=False, reporter
) -> dict:
    """Measures a job with :func:`btfsep_engine.pipeline.tradeoff.measure`; writes ``chart.png`` and ``chart.json``.

    Parameters
    ----------
    truth : a lighting file or environment map, or None
    out : folder, default ``folder/result``

    Returns
    -------
    dict, the content of ``chart.json``, and ``chart``: the picture's path

    Raises
    ------
    InputError
        Where the job cannot be read or estimated, or the true light has too few orders.
    """
    light = None if truth is None else read_any_lighting(truth, ORDER).coefficients
    if light is not None and sh.order_of(len(light)) < ORDER:
        raise InputError(f"--truth {truth}", f"order {sh.order_of(len(light))}", f"give order {ORDER} or more")
    with reporter.stage("reading"):
        job = load_job(folder)
        for note in job.warnings:
            reporter.warn(note)
    out = Path(out) if out is not None else job.folder / "result"
    scene = PreparedScene(job, reporter)
    found = measure(
        scene, library, material=material, truth=light, repeats=repeats, paper_samples=paper_samples, quick=quick
    )
    points = found["points"]
    slowest = next((p.seconds for p in points if p.axis == "paper"), None)
    names = ", ".join(dict.fromkeys(found["materials"]))
    title = f"{Path(folder).resolve().name}: {names}"
    write_chart(out / "chart.png", points, reference=found["reference"], title=title)
    result = {
        "format": "btfsep-chart",
        "version": 1,
        "reference": found["reference"],
        "materials": found["materials"],
        "points": [
            {
                "axis": p.axis,
                "name": p.name,
                "seconds": p.seconds,
                "error": p.error,
                "direction_degrees": p.direction,
                "front": p.front,
                "paper_ratio": slowest / p.seconds if slowest else None,
            }
            for p in points
        ],
        "warnings": list(reporter.warnings),
        "versions": versions(),
    }
    write_json(out / "chart.json", result)
    return {**result, "chart": str(out / "chart.png")}
