# SPDX-License-Identifier: GPL-3.0-or-later
"""From a job to its lighting: materials, basis images, fit, result files."""

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from btfsep_engine import report, sh
from btfsep_engine.btf.model import Material
from btfsep_engine.fit.diagnose import diagnose
from btfsep_engine.fit.misalignment import silhouette_shift
from btfsep_engine.fit.stated import Fit, expected_error
from btfsep_engine.job.load import load_job
from btfsep_engine.light.files import Lighting, write_lighting, write_lighting_exr
from btfsep_engine.pipeline.doubts import (
    THRESHOLDS,
    alignment_doubt,
    clamped_share,
    structure_doubts,
)
from btfsep_engine.pipeline.given import given_materials
from btfsep_engine.pipeline.interreflection import NOT_SO_BRIGHT, contradicted, open_share, own_light
from btfsep_engine.pipeline.lamps import key_lights
from btfsep_engine.pipeline.light_account import colour_doubts, colour_words, lamp_record, light_words, sky_radiance
from btfsep_engine.pipeline.modelling import (
    all_chosen_points,
    all_with_own_light,
    appearance,
    chosen_fit,
    posed,
    textures_to_try,
)
from btfsep_engine.pipeline.recognition import recognise_object
from btfsep_engine.pipeline.record import run_record, write_json
from btfsep_engine.pipeline.reflectance import nearer_materials
from btfsep_engine.pipeline.scene import PreparedScene, unseen_meshes
from btfsep_engine.pipeline.settings import MODELLED_BOUNCES, Settings
from btfsep_engine.pipeline.together import stacked
from btfsep_engine.pipeline.tone import curve_doubts, curve_words, read_otherwise, refuse_unknown, with_other_curves

UNSEEN = (
    "a depth shows one side: what lies behind it is taken as solid, closed and of the same material; of shadows and "
    "reflections by what the camera does not see, the stated uncertainty knows nothing"
)


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
    """Everything that an estimate found, before it is written; ``settings`` are those that were used."""

    scene: PreparedScene
    materials: list
    fit: Fit
    lighting: Lighting
    residuals: list
    pixels: list
    transport: dict
    settings: Settings
    choice: dict
    photos: list

    @property
    def radiance(self):
        """The sky's own radiance (`light_account.sky_radiance`); None where its series is all that is known."""
        return None if self.fit.election is None else sky_radiance(self.fit, self.lighting)


@dataclass(frozen=True)
class PhotoFit:
    """One photograph of an estimate: its scene, exposure over the first's, and each object's residual and pixels."""

    scene: PreparedScene
    exposure: float
    residuals: list
    pixels: list


def object_materials(scene: PreparedScene, library, settings: Settings, *, names) -> list:
    """The material of every object: the one named, or where ``names`` has None, of its surface, or as recognised."""
    # first: a wrong name must not cost a training
    found = []
    for index, known in enumerate(given_materials(scene.job, library, settings, names=names)):
        if known is not None:
            found.append(ObjectMaterial(known.name, known, True))
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


def materials_of(scenes, library, settings: Settings, *, material: str | None) -> list:
    """For every photograph `object_materials`; ``material`` : of all objects, or None."""
    materials = []
    for each in scenes:
        known = {o.name: m.name for o, m in zip(scenes[0].job.objects, materials[0], strict=True)} if materials else {}
        names = [material or o.material or (None if o.surface else known.get(o.name)) for o in each.job.objects]
        materials.append(object_materials(each, library, settings, names=names))
    return materials


def changed_materials(scenes, before, after) -> list[str]:
    """Where the photo's own curve showed another material than sRGB, which recognition begins with, in words."""
    found = [
        (o.name, old.name, new.name)
        for scene, olds, news in zip(scenes, before, after, strict=True)
        for o, old, new in zip(scene.job.objects, olds, news, strict=True)
    ]
    return [
        f"object '{name}' was recognised as {new} with the photo read by the tone curve that was found; read as sRGB, "
        f"it looked like {old}; state the curve or the material, if you know one of them"
        for name, old, new in dict.fromkeys(found)
        if old != new
    ]


def estimate(scene: PreparedScene, library, settings: Settings, *, material: str | None = None, others=()) -> Estimate:
    """Recognises what is not given and solves for the light that all objects share.

    ``others`` are PreparedScenes of further photographs under the same light, each with an exposure of its own.
    """
    scenes, reporter = [scene, *others], scene.reporter
    refuse_unknown(scenes, settings)
    materials = materials_of(scenes, library, settings, material=material)
    # path tracing has interreflections for nothing; the kernel looks first whether they are needed
    decides = settings.bounces == "auto" and settings.transport == "kernel"
    settings = asked = replace(settings, bounces=1 if decides else settings.reflections)

    def set_up():
        with reporter.stage("transport"):
            tried, why = textures_to_try(scenes, materials, settings)
            chosen = all_chosen_points(scenes, replace(settings, appearance="textured") if tried else settings)
            return tried, why, *posed(scenes, materials, chosen, settings, both=tried)

    tried, why, problems, rich = set_up()
    read = [p.scene for p in problems]  # their photos read by the curve that was chosen
    if any(not m.given for found in materials for m in found) and any(read_otherwise(each) for each in read):
        before, materials = materials, materials_of(read, library, settings, material=material)
        changes = changed_materials(scenes, before, materials)
        for change in changes:
            reporter.warn(change)
        if changes:
            tried, why, problems, rich = set_up()
    scenes = [p.scene for p in problems]
    with reporter.stage("fit"):
        settings, fit, solver, exposures, choice = chosen_fit(problems, rich, asked)
    if decides:
        with reporter.stage("transport"):
            straight = rich if rich is not None and settings.appearance == "textured" else problems
            used = [[appearance(m.material, settings) for m in found] for found in materials]
            own = own_light(straight, used, fit, solver, exposures, settings, bounces=MODELLED_BOUNCES)
            straight_light = (problems, rich)
            if own.modelled:
                asked = replace(asked, bounces=MODELLED_BOUNCES)
                problems = all_with_own_light(
                    problems, materials, replace(asked, appearance="mean") if tried else asked
                )
                rich = rich and all_with_own_light(rich, materials, replace(asked, appearance="textured"))
        if own.modelled:
            with reporter.stage("fit"):
                without = (straight_light, settings, fit, solver, exposures, choice)
                settings, fit, solver, exposures, choice = chosen_fit(problems, rich, asked)
                if contradicted(fit, without[2]):
                    (problems, rich), settings, fit, solver, exposures, choice = without
                    own = replace(own, modelled=False, why=NOT_SO_BRIGHT)
        choice["interreflections"] = own.why
    choice.setdefault("appearance", why)
    if any(unseen_meshes(each.job) for each in scenes):
        choice["geometry"] = UNSEEN
    if rich is not None and settings.appearance == "textured":
        problems = rich
    used = [[appearance(m.material, settings) for m in found] for found in materials]
    if settings.estimator == "map" and problems[0].transport["by"] == "kernel" and settings.appearance == "mean":
        with reporter.stage("reflectance"):
            bounced = replace(
                settings, bounces=problems[0].transport["bounces"], directions=problems[0].transport["directions"]
            )
            near = nearer_materials(problems, used, fit, solver, exposures, bounced)
        problems, fit, solver, exposures = near.problems, near.fit, near.solver, near.exposures
        choice["reflectance"] = near.why
    fit = with_other_curves(problems, fit, solver, exposures)
    suns, choice["key_light"] = key_lights(fit, settings)
    choice["curve"] = curve_words(problems)
    choice["light"] = light_words(fit)
    choice["colour"] = colour_words(fit)
    measured, photos = [p.radiance() for p in problems], []
    shown = [p.predicted(fit.shown) for p in problems]
    for problem, b, exposure, image in zip(problems, measured, exposures, shown, strict=True):
        left = b - exposure * image
        residuals = [
            float(np.linalg.norm(r) / max(np.linalg.norm(c), 1e-30))
            for r, c in zip(problem.by_object(left), problem.by_object(b), strict=True)
        ]
        photos.append(PhotoFit(problem.scene, exposure, residuals, [len(p) for p in problem.points]))
    lighting = Lighting(
        settings.order,
        fit.coefficients,
        fit.stddev,
        fit.determined,
        scene.job.exposure_ev,
        suns=suns,
        interval=fit.interval,
    )
    with reporter.stage("checks"):
        doubts = all_doubts(problems, photos, materials, fit, solver, measured, lighting, settings)
        doubts += curve_doubts(problems, fit, solver, exposures)
    for doubt in doubts:
        reporter.warn(doubt)
    first = photos[0]
    return Estimate(
        scenes[0],
        materials[0],
        fit,
        lighting,
        first.residuals,
        first.pixels,
        problems[0].transport,
        settings,
        choice,
        photos,
    )


def all_doubts(problems, photos, materials, fit: Fit, solver, measured, lighting: Lighting, settings) -> list[str]:
    """Everything that speaks against the estimate, in words."""
    out = []
    shifted = False
    for problem in problems:
        scene = problem.scene
        frayed = bool(unseen_meshes(scene.job))
        doubt = alignment_doubt(silhouette_shift(scene.job.photo.radiance, scene.view.mesh >= 0, frayed=frayed))
        shifted |= doubt is not None
        out += [doubt] if doubt else []
    if solver is not None and not shifted:
        points = [p for problem in problems for p in problem.points]
        b = np.concatenate([m / photo.exposure for m, photo in zip(measured, photos, strict=True)])
        effects = diagnose(
            solver,
            fit,
            b,
            blocks=stacked(problems)[1],
            position=np.concatenate([p.position for p in points]),
            normal=np.concatenate([p.normal for p in points]),
            open_share=np.concatenate([open_share(q.scene, p) for q in problems for p in q.points]),
        )
        names = [m.name for found in materials for m in found]
        out += structure_doubts(effects, residual=fit.residual, names=names)
    for photo, found in zip(photos, materials, strict=True):
        for obj, m, residual in zip(photo.scene.job.objects, found, photo.residuals, strict=True):
            if residual > THRESHOLDS.residual:
                out.append(
                    f"the light explains object '{obj.name}' poorly (relative residual {residual:.2f}): the material "
                    f"({m.name}), the geometry or the camera may be wrong"
                )
    return out + colour_doubts(fit) + uncertainty_doubts(fit, lighting, settings)


def uncertainty_doubts(fit: Fit, lighting: Lighting, settings: Settings) -> list[str]:
    """What the photo cannot tell."""
    out = []
    count, terms = int(lighting.determined.sum()), len(lighting.determined)
    if settings.estimator == "least-squares" and fit.condition > THRESHOLDS.condition:
        out.append(
            f"the fit is badly conditioned (condition number {fit.condition:.0f}): {count} of {terms} coefficients are "
            "determined by the photo; --estimator map or a lower --order is steadier"
        )
    if settings.estimator == "map" and not lighting.determined[: min(terms, 4)].all():
        out.append(
            f"the photo determines {count} of {terms} coefficients, and not all of the first four, which hold the "
            "main direction of the light: the others are natural light's average; see stddev in lighting.json"
        )
    # the log-normal light is positive itself: what its series lacks is in lighting.exr
    clamped = 0.0 if settings.estimator == "map" else clamped_share(lighting.sky)
    if clamped > THRESHOLDS.clamped:
        out.append(
            f"the estimated light is negative in some directions ({100 * clamped:.0f} % of its power), as a series of "
            f"order {lighting.order} can be; the World shows it dark there"
        )
    return out


def run_estimate(
    folder, library, settings: Settings, *, material=None, out=None, with_report=True, others=(), reporter
) -> dict:
    """The whole command: reads the job, estimates, writes the results.

    Parameters
    ----------
    folder : job folder
    library : btf.library.Library
    material : a name for all objects, instead of recognition
    out : folder for the results, default ``folder/result``
    others : folders of further jobs, photographs under the same light

    Returns
    -------
    dict, the content of ``result.json`` and ``out``, ``lighting``: paths
    """
    started = time.perf_counter()
    with reporter.stage("reading"):
        job, *further = (load_job(each, colorspace=settings.colorspace) for each in (folder, *others))
        for note in (note for each in (job, *further) for note in each.warnings):
            reporter.warn(note)
    out = Path(out) if out is not None else job.folder / "result"
    scene = PreparedScene(job, reporter)
    beside = [PreparedScene(each, reporter) for each in further]
    found = estimate(scene, library, settings, material=material, others=beside)
    settings = found.settings
    if with_report:
        with reporter.stage("report"):
            report.write_estimate_report(out / "report.png", found, settings)
    with reporter.stage("writing"):
        write_lighting(out / "lighting.json", found.lighting)
        write_lighting_exr(out / "lighting.exr", found.lighting, radiance=found.radiance)
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
        "lamps": [lamp_record(lamp) for lamp in fit.lamps],
        "object_tint": None if fit.tint is None else fit.tint.object_tint,
        "colour_unknown": None if fit.tint is None else fit.tint.unknown,
        "determined": determined_words(found.lighting.determined, fit.all_determined),
        "expected_error": None if fit.samples is None else expected_error(fit.coefficients, fit.samples),
        "choice": found.choice,
        "photos": [
            {
                "job": photo.scene.job.folder.name,
                "exposure": photo.exposure,
                "residuals": photo.residuals,
                "pixels": photo.pixels,
            }
            for photo in found.photos
        ],
        "condition_number": fit.condition,
        "transport": found.transport,
        "saturated_pixels": scene.job.photo.saturated,
        **run_record(settings, scene.reporter),
    }


def determined_words(reported, fitted) -> str:
    """What the photo determines: "the photo determines 14 of 100 coefficients; of order 3 and above: none".

    ``reported`` : (terms,) bool, of the reported orders; ``fitted`` : of all orders of the fit
    """
    known = fitted
    text = f"the photo determines {int(np.sum(known))} of {len(known)} coefficients"
    if len(known) > len(reported):
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
