# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands for the scene in the fit: which pixels, which appearance, which order, how finely, and what follows."""

from dataclasses import replace

import numpy as np

from btfsep_engine.btf.model import Material
from btfsep_engine.errors import InputError
from btfsep_engine.pipeline.interreflection import with_own_light
from btfsep_engine.pipeline.model_choice import (
    appearance_choice,
    cross_validated_order,
    determined_order,
    texture_may_help,
)
from btfsep_engine.pipeline.problem import left_out_words, pose, shares
from btfsep_engine.pipeline.real_photo import as_real_photos, scale_words, warn_of_clipping
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import LARGEST_ORDER, Seeded, Settings, TransportSettings
from btfsep_engine.pipeline.together import fit_together, stacked
from btfsep_engine.pipeline.tone import with_curves
from btfsep_engine.render.sampling import REGION, choose_pixels, thinned
from btfsep_engine.render.surface import SurfacePoints

LEAKS = 1e-3  # of the pixels: a ray in a million slips through a closed mesh, between two triangles


def appearance(material: Material, settings: TransportSettings) -> Material:
    """What stands for the material in the fit: the BTF itself (always where it lines up), or its mean ABRDF."""
    return material if settings.appearance == "textured" or material.lines_up else material.mean_material()


def chosen_points(scene: PreparedScene, index: int, share: int, settings: Settings) -> SurfacePoints:
    """The points of an object that enter the fit, those that tell most of the light.

    Usable pixels, and with a prior saturated ones, too, as inequalities.
    """
    warn_of_clipping(scene, index, settings)
    photo = scene.job.photo
    region = scene.regions[index] & photo.usable
    if settings.estimator == "map" and photo.clipped is not None:
        region |= scene.regions[index] & photo.clipped.any(-1)
    points = scene.points(
        index,
        region=part_of(region, share, settings),
        textured=settings.appearance == "textured",
    )
    return points.take(choose_pixels(points, share, seed=settings.seed)) if share else points


def part_of(region, share: int, settings: Seeded):
    """What of a region (h, w) bool is worth computing at, to choose ``share`` pixels of it; 0: all."""
    return thinned(region, max(REGION, 4 * share), seed=settings.seed) if share else region


def all_chosen_points(scenes, settings: Settings) -> list:
    """For every photograph the points of each object."""
    out = []
    for scene in scenes:
        out.append([chosen_points(scene, i, n, settings) for i, n in enumerate(shares(scene, settings.pixels))])
        if not any(len(points) for points in out[-1]):
            raise InputError(
                names_of(scene),
                "every pixel that shows it is saturated or transparent",
                "give a photo with a shorter exposure, or one that is opaque where the object is",
            )
    return out


def names_of(scene: PreparedScene) -> str:
    """The objects of a scene, for an error."""
    names = " and ".join(f"'{o.name}'" for o in scene.job.objects)
    return f"object{'s' if len(scene.job.objects) > 1 else ''} {names}"


def textures_to_try(scenes, materials, settings: TransportSettings) -> tuple[bool, str]:
    """Whether the textured BTFs are tried beside their mean ABRDFs, and why, in words."""
    if settings.appearance != "auto":
        return False, "as asked for"
    answers = []
    for scene, found in zip(scenes, materials, strict=True):
        for i, m in enumerate(found):
            points = scene.points(i, region=thinned(scene.regions[i], REGION), textured=False)
            footprint = float(np.median(points.footprint)) * scene.millimetres_per_unit
            answers.append(texture_may_help(scene.job.objects[i], m.material, footprint))
    return any(a for a, _ in answers), "; ".join(dict.fromkeys(reason for _, reason in answers))


def posed(scenes, materials, chosen, settings: Settings, *, both: bool):
    """The fit's problems with mean ABRDFs (or as the settings say), and with textures where ``both`` is asked for.

    With a prior, unknown tone curves (`pipeline.tone`), clipped channels and the scales of recognised objects
    (`pipeline.real_photo`) are settled here.
    """
    textured = replace(settings, appearance="textured")

    def all_with(how):
        return [
            pose(scene, [appearance(m.material, how) for m in found], points, how)
            for scene, found, points in zip(scenes, materials, chosen, strict=True)
        ]

    problems = all_with(replace(settings, appearance="mean") if both else settings)
    for problem in problems:
        if np.mean([basis[:, 0].any(1).mean() for basis in problem.basis if len(basis)]) <= LEAKS:
            raise InputError(
                names_of(problem.scene),
                "no light from outside gets by way of it to the camera",
                "check that the camera is not inside closed geometry, and that the material is not black",
            )
    rich = all_with(textured) if both else None
    if settings.estimator == "map":
        problems, rich = with_curves(problems, rich, settings)
    return as_real_photos(problems, rich, materials, settings) if settings.estimator == "map" else (problems, rich)


def all_with_own_light(problems, materials, settings: Settings) -> list:
    """The problems with the light between surfaces added to their basis images."""
    return [
        with_own_light(problem, [appearance(m.material, settings) for m in found], settings)
        for problem, found in zip(problems, materials, strict=True)
    ]


def chosen_fit(problems, rich, settings: Settings):
    """The fit with the appearance and the order that the settings name or the photo asks for.

    Returns
    -------
    settings as chosen, Fit, LightSolver or None, exposures, {what: why}
    """
    choice = {"scale": scale_words(problems)}
    if settings.robust:
        choice["robust"] = left_out_words(problems)
    automatic = settings.order == "auto"
    if automatic:
        settings = replace(settings, order=LARGEST_ORDER)
        if settings.estimator == "least-squares":
            basis, blocks = stacked(problems)
            b = np.concatenate([p.radiance() for p in problems]).astype(np.float64)
            order, choice["order"] = cross_validated_order(basis, b, blocks, LARGEST_ORDER, seed=settings.seed)
            settings = replace(settings, order=order)
            problems = [p.up_to(order) for p in problems]
            rich = rich and [p.up_to(order) for p in rich]
    fit, solver, exposures = fit_together(problems, settings)
    appearance_name = "mean" if settings.appearance == "auto" else settings.appearance
    if rich is not None:
        other = fit_together(rich, settings)
        left = [
            np.concatenate([p.radiance() / e - p.predicted(f.shown) for p, e in zip(posed_problems, es, strict=True)])
            for posed_problems, (f, _, es) in ((problems, (fit, solver, exposures)), (rich, other))
        ]
        appearance_name, choice["appearance"] = appearance_choice(*left, stacked(problems)[1])
        if appearance_name == "textured":
            fit, solver, exposures = other
    settings = replace(settings, appearance=appearance_name)
    if automatic and settings.estimator == "map":
        order = determined_order(fit.determined)
        fit = solver.reported_up_to(fit, order)
        settings = replace(settings, order=order)
        choice["order"] = f"the highest order of which the photo determines something is {order}"
    return settings, fit, solver, exposures, choice
