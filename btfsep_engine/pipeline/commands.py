# SPDX-License-Identifier: GPL-3.0-or-later
"""The smaller commands: train, recognise, compare, chart."""

from pathlib import Path

import numpy as np

from btfsep_engine import sh
from btfsep_engine.atomic import write_json
from btfsep_engine.errors import InputError
from btfsep_engine.fit.compare import compare
from btfsep_engine.fit.three_spheres import three_spheres
from btfsep_engine.job.load import load_job
from btfsep_engine.light.files import read_any_lighting, read_any_map
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.materials import object_materials
from btfsep_engine.pipeline.recognition import trained_recogniser
from btfsep_engine.pipeline.record import run_record, versions
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import Settings, choose
from btfsep_engine.pipeline.tone import curve_read_by, sought
from btfsep_engine.report import render_objects


def _prepared(folder, reporter) -> PreparedScene:
    with reporter.stage("reading"):
        job = load_job(folder)
        for note in job.warnings:
            reporter.warn(note)
    return PreparedScene(job, reporter)


def run_train(folder, library, settings: Settings, *, reporter) -> dict:
    """Trains (or finds in the cache) the recogniser of every object."""
    scene = _prepared(folder, reporter)
    objects = []
    for index, obj in enumerate(scene.job.objects):
        recogniser = trained_recogniser(scene, index, library, settings)
        objects.append(
            {
                "name": obj.name,
                "materials": len(recogniser.materials),
                "held_out_accuracy": recogniser.model.held_out_accuracy,
            }
        )
    return {"objects": objects, **run_record(settings, reporter)}


def run_recognise(folder, library, settings: Settings, *, reporter) -> dict:
    """Recognises the material of every object, also of those whose material the job names."""
    scene = _prepared(folder, reporter)
    if sought(scene.job):
        reporter.warn(
            f"the photo's tone curve is unknown: it was read as {curve_read_by(scene.job).description}; an estimate "
            "finds it, and recognises by it"
        )
    found = object_materials(scene, library, settings, names=[None] * len(scene.job.objects))
    objects = [{"name": o.name, **m.record} for o, m in zip(scene.job.objects, found, strict=True)]
    return {"objects": objects, **run_record(settings, reporter)}


def run_compare(a, b, *, order: int, job=None, library=None, material=None, reporter) -> dict:
    """Error measures of lighting file ``a`` against ``b``, and of renderings of a job under both."""
    first, second = read_any_lighting(a, order), read_any_lighting(b, order)
    result = compare(first, second)
    if job is not None:
        scene = _prepared(job, reporter)
        settings = choose("balanced")
        names = [material or o.material for o in scene.job.objects]
        found = [m.material for m in object_materials(scene, library, settings, names=names)]
        images = [
            render_objects(
                scene, found, SHLighting(x.coefficients), textured=True, directions=settings.many_directions
            )[0]
            for x in (first, second)
        ]
        result["rendering_psnr_free_scale"] = psnr(images[0], images[1])
    return result


def run_three_spheres(a, b) -> dict:
    """The published comparisons' figures of lighting file ``a`` against ``b``, both taken as whole maps."""
    return {"protocol": "three-spheres", **three_spheres(read_any_map(a), read_any_map(b))}


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
        Where the job cannot be read or estimated, the true light has too few orders, or Matplotlib is missing.
    """
    try:
        from btfsep_engine.chart import write_chart
    except ModuleNotFoundError as error:
        what, do = "the chart is drawn with Matplotlib", "install it: pip install 'btfsep[chart]'"
        raise InputError(what, f"there is no module {error.name}", do) from error
    from btfsep_engine.pipeline.tradeoff import ORDER, measure  # brings all of an estimate

    light = None if truth is None else read_any_lighting(truth, ORDER).coefficients
    if light is not None and sh.order_of(len(light)) < ORDER:
        raise InputError(f"--truth {truth}", f"order {sh.order_of(len(light))}", f"give order {ORDER} or more")
    scene = _prepared(folder, reporter)
    out = Path(out) if out is not None else scene.job.folder / "result"
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


def psnr(image, truth) -> float:
    """Peak signal-to-noise ratio in dB of two linear images where both are finite, one free scale.

    The peak is the truth's 99th percentile.
    """
    shown = np.isfinite(image).all(-1) & np.isfinite(truth).all(-1)
    a, b = image[shown].astype(np.float64), truth[shown].astype(np.float64)
    scale = (a * b).sum() / max((a * a).sum(), 1e-300)
    error = np.mean((scale * a - b) ** 2)
    return float(10 * np.log10(np.percentile(b, 99) ** 2 / max(error, 1e-300)))
