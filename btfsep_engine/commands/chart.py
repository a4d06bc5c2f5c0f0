# SPDX-License-Identifier: GPL-3.0-or-later
"""`btfsep chart`: speed against accuracy on a job, as numbers and as a picture."""

from pathlib import Path

from btfsep_engine import sh
from btfsep_engine.commands.record import versions
from btfsep_engine.errors import InputError
from btfsep_engine.light.files import read_any_lighting
from btfsep_engine.pipeline.scene import read_scene
from btfsep_engine.storage.atomic import check_folder, write_json


def run_chart(
    folder, library, *, material=None, truth=None, out=None, repeats=3, paper_samples=64, quick=False, reporter
) -> dict:
    """Measures a job with :func:`btfsep_engine.commands.tradeoff.measure`; writes ``chart.png`` and ``chart.json``.

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
        Where the job cannot be read or estimated, the true light has too few orders, or Matplotlib is missing.
    """
    try:
        from btfsep_engine.commands.chart_picture import write_chart
    except ModuleNotFoundError as error:
        what, do = "the chart is drawn with Matplotlib", "install it: pip install 'btfsep[chart]'"
        raise InputError(what, f"there is no module {error.name}", do) from error
    from btfsep_engine.commands.tradeoff import ORDER, measure  # brings all of an estimate

    light = None if truth is None else read_any_lighting(truth, ORDER).coefficients
    if light is not None and sh.order_of(len(light)) < ORDER:
        raise InputError(f"--truth {truth}", f"order {sh.order_of(len(light))}", f"give order {ORDER} or more")
    scene = read_scene(folder, reporter)
    out = Path(out) if out is not None else scene.job.folder / "result"
    check_folder(out)
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
