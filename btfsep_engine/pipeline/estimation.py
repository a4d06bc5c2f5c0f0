# SPDX-License-Identifier: GPL-3.0-or-later
"""From a job to its lighting: materials, basis images, fit, result files."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from btfsep_engine import report, sh
from btfsep_engine.btf.model import Material, Tabulated
from btfsep_engine.fit.expected_error import expected_error
from btfsep_engine.fit.least_squares import Fit, determined, solve
from btfsep_engine.fit.map_estimate import solve_map
from btfsep_engine.job.load import load_job
from btfsep_engine.light.files import Lighting, write_lighting, write_lighting_exr
from btfsep_engine.light.natural import natural_amplitude, natural_prior
from btfsep_engine.pipeline.problem import pose, shares
from btfsep_engine.pipeline.recognition import recognise_object
from btfsep_engine.pipeline.record import run_record, write_json
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.render.surface import SurfacePoints, spread

CLIPPED_SHARE = 0.01  # of an object's pixels: from here on saturation is worth a warning
POOR_RESIDUAL = 0.35
POOR_CONDITION = 300.0


@dataclass(frozen=True)
class ObjectMaterial:
    """The material an object is taken to have, and why."""

    name: str
    material: Material
    given: bool
    candidates: tuple = ()
    unknown: bool = False
    unknown_score: float | None = None


@dataclass(frozen=True)
class Estimate:
    """Everything that an estimate found, before it is written."""

    scene: PreparedScene
    materials: list
    fit: Fit
    lighting: Lighting
    residuals: list
    pixels: list
    transport: dict


def object_materials(scene: PreparedScene, library, settings: Settings, *, names) -> list:
    """The material of every object: the one named, or where ``names`` has None, as recognised."""
    # names first: a wrong one must not cost a training
    given = [None if n is None else library.load(n) for n in names]
    found = []
    for index, known in enumerate(given):
        if known is not None:
            found.append(ObjectMaterial(names[index], known, True))
            continue
        answer = recognise_object(scene, index, library, settings)
        found.append(
            ObjectMaterial(
                answer.material,
                library.load(answer.material),
                False,
                answer.candidates,
                answer.unknown,
                answer.unknown_score,
            )
        )
    return found


def appearance(material: Material, settings: Settings) -> Material:
    """What stands for the material in the fit: the BTF itself, or its mean ABRDF."""
    if settings.appearance == "mean" and isinstance(material, Tabulated):
        return material.mean_material()
    return material


def chosen_points(scene: PreparedScene, index: int, share: int, settings: Settings) -> SurfacePoints:
    """The points of an object that enter the fit: usable pixels, spread over the picture."""
    points = scene.points(index, textured=settings.appearance == "textured")
    usable = scene.usable(points)
    clipped = 1 - usable.mean()
    if clipped > CLIPPED_SHARE:
        scene.reporter.warn(
            f"{100 * clipped:.0f} % of the pixels of object '{scene.job.objects[index].name}' are saturated or "
            "transparent and were left out: what they saw of the light is not in the estimate"
        )
    points = points.take(np.flatnonzero(usable))
    return points.take(spread(points, share, seed=settings.seed)) if share else points


def estimate(scene: PreparedScene, library, settings: Settings, *, material: str | None = None) -> Estimate:
    """Recognises what is not given and solves for the light that all objects share."""
    reporter = scene.reporter
    names = [material or o.material for o in scene.job.objects]
    materials = object_materials(scene, library, settings, names=names)
    with reporter.stage("transport"):
        counts = shares(scene, settings.pixels)
        chosen = [chosen_points(scene, i, counts[i], settings) for i in range(len(materials))]
        problem = pose(scene, [appearance(m.material, settings) for m in materials], chosen, settings)
    with reporter.stage("fit"):
        measured = problem.radiance()
        fit = solved(problem.all_basis, measured, problem.blocks, settings)
        left = measured - problem.predicted(fit.coefficients if fit.all_coefficients is None else fit.all_coefficients)
    residuals = [
        float(np.linalg.norm(r) / max(np.linalg.norm(b), 1e-30))
        for r, b in zip(problem.by_object(left), problem.by_object(measured), strict=True)
    ]
    known = fit.determined
    if known is None:
        known = determined(fit.coefficients, fit.stddev, natural_amplitude(settings.order))
    lighting = Lighting(settings.order, fit.coefficients, fit.stddev, known, scene.job.exposure_ev)
    _warn(scene, materials, fit, residuals, lighting, settings)
    return Estimate(scene, materials, fit, lighting, residuals, [len(p) for p in chosen], problem.transport)


def solved(basis, radiance, blocks, settings: Settings) -> Fit:
    """The fit by the estimator of the settings."""
    if settings.estimator == "least-squares":
        return solve(basis, radiance, blocks=blocks)
    return solve_map(basis, radiance, blocks=blocks, prior=natural_prior(settings.fit_order), order=settings.order)


def _warn(scene, materials, fit: Fit, residuals, lighting: Lighting, settings: Settings) -> None:
    warn = scene.reporter.warn
    for obj, found, residual in zip(scene.job.objects, materials, residuals, strict=True):
        if residual > POOR_RESIDUAL:
            warn(
                f"the light explains object '{obj.name}' poorly (relative residual {residual:.2f}): the material "
                f"({found.name}), the geometry or the camera may be wrong"
            )
    count, terms = int(lighting.determined.sum()), len(lighting.determined)
    if settings.estimator == "least-squares" and fit.condition > POOR_CONDITION:
        warn(
            f"the fit is badly conditioned (condition number {fit.condition:.0f}): {count} of {terms} coefficients are "
            "determined by the photo; --estimator map or a lower --order is steadier"
        )
    if settings.estimator == "map" and not lighting.determined[: min(terms, 4)].all():
        warn(
            f"the photo determines {count} of {terms} coefficients, and not all of the first four, which hold the "
            "main direction of the light: the others are natural light's average; see stddev in lighting.json"
        )
    radiance = sh.to_map(lighting.coefficients, 32, 64)
    if radiance.min() < -0.1 * radiance.max():
        warn(
            "the estimated light is negative in some directions, as a truncated series can be; the World clamps it at 0"
        )


def run_estimate(folder, library, settings: Settings, *, material=None, out=None, with_report=True, reporter) -> dict:
    """The whole command: reads the job, estimates, writes the results.

    Parameters
    ----------
    folder : job folder
    library : btf.library.Library
    material : a name for all objects, instead of recognition
    out : folder for the results, default ``folder/result``

    Returns
    -------
    dict, the content of ``result.json`` and ``out``, ``lighting``: paths
    """
    started = time.perf_counter()
    with reporter.stage("reading"):
        job = load_job(folder)
        for note in job.warnings:
            reporter.warn(note)
    out = Path(out) if out is not None else job.folder / "result"
    scene = PreparedScene(job, reporter)
    found = estimate(scene, library, settings, material=material)
    if with_report:
        with reporter.stage("report"):
            report.write_estimate_report(out / "report.png", found, settings)
    with reporter.stage("writing"):
        write_lighting(out / "lighting.json", found.lighting)
        write_lighting_exr(out / "lighting.exr", found.lighting)
    result = result_record(found, settings)
    result["seconds"]["total"] = round(time.perf_counter() - started, 4)
    write_json(out / "result.json", result)
    return {**result, "out": str(out), "lighting": str(out / "lighting.json")}


def result_record(found: Estimate, settings: Settings) -> dict:
    """The content of ``result.json``."""
    fit, scene = found.fit, found.scene
    return {
        "format": "btfsep-result",
        "version": 1,
        "job_digest": scene.job.digest,
        "objects": [
            {
                "name": obj.name,
                **material_record(m),
                "pixels": pixels,
                "residual": residual,
            }
            for obj, m, pixels, residual in zip(
                scene.job.objects, found.materials, found.pixels, found.residuals, strict=True
            )
        ],
        "residual": fit.residual,
        "residual_per_channel": fit.residual_per_channel,
        "order": settings.order,
        "estimator": settings.estimator,
        "fit_order": settings.fit_order,
        "effective_degrees_of_freedom": fit.effective_degrees_of_freedom,
        "noise": fit.noise,
        "block_correlation": fit.block_correlation,
        "prior_scale": fit.prior_scale,
        "determined": determined_words(found.lighting.determined, fit.all_determined),
        "expected_error": None
        if fit.covariance is None
        else expected_error(fit.coefficients, fit.covariance, seed=settings.seed),
        "condition_number": fit.condition,
        "transport": found.transport,
        "saturated_pixels": scene.job.photo.saturated,
        **run_record(settings, scene.reporter),
    }


def determined_words(reported, fitted=None) -> str:
    """What the photo determines: "the photo determines 14 of 100 coefficients; of order 3 and above: none".

    ``reported`` : (terms,) bool, of the reported orders; ``fitted`` : of all orders of the fit, None where it is those
    """
    known = reported if fitted is None else fitted
    text = f"the photo determines {int(np.sum(known))} of {len(known)} coefficients"
    if fitted is not None and len(fitted) > len(reported):
        text += f", {int(np.sum(reported))} of the {len(reported)} that are reported"
    orders = sh.order_of(len(known))
    each = [known[l * l : (l + 1) ** 2] for l in range(orders + 1)]
    whole = next((l for l, band in enumerate(each) if not band.all()), orders + 1) - 1
    highest = max((l for l, band in enumerate(each) if band.any()), default=-1)
    if highest < 0:
        return text + "; not even how bright the light is"
    all_of = f"all up to order {whole}" if whole >= 0 else "not all of any order"
    return f"{text}; {all_of}, none above order {highest}"


def material_record(found: ObjectMaterial) -> dict:
    """One object's material for JSON."""
    return {
        "material": found.name,
        "class": found.material.material_class,
        "recognised": not found.given,
        "unknown": found.unknown,
        "unknown_score": found.unknown_score,
        "candidates": [{"name": name, "score": score} for name, score in found.candidates],
    }
