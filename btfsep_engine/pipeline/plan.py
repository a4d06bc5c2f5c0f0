# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job could determine, before its photo is looked at."""

import time
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from btfsep_engine import sh
from btfsep_engine.atomic import replacing
from btfsep_engine.conventions import direction_to_equirect, pixel_directions
from btfsep_engine.errors import InputError
from btfsep_engine.fit.foresight import Foresight, foresee, over_directions
from btfsep_engine.job.load import load_job
from btfsep_engine.pipeline.materials import given_materials
from btfsep_engine.pipeline.model import view_problem
from btfsep_engine.pipeline.problem import Problem
from btfsep_engine.pipeline.record import determined_words, run_record, write_json
from btfsep_engine.pipeline.refine.texture import texture_contrast
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import Settings

SHAPE_NOISE = 0.05  # misfit of an object without texture, over its photo: shape, noise, what the basis leaves out
TEXTURE_SHARE = 0.6  # of a texture's contrast: so much stays a pixel's own misfit (white, leather, wood, denim alike)
MAP = (64, 128)
POOR_ERROR = 0.25  # expected error of order 2: from here on advice is given


def run_plan(folder, library, settings: Settings, *, material=None, noise=None, out=None, reporter) -> dict:
    """The whole command; writes plan.json and plan.png.

    Parameters
    ----------
    folder : job folder; its photo is not read and need not be there
    library : btf.library.Library
    material : a name for all objects, instead of the job's
    noise : expected misfit over the photo's root mean square; None: from the material's texture
    out : folder for the results, default ``folder/plan``

    Returns
    -------
    dict, the content of plan.json and ``out``, ``picture``: paths
    """
    started = time.perf_counter()
    with reporter.stage("reading"):
        job = load_job(folder, with_photo=False)
        names = [material or o.material for o in job.objects]
        for o, name in zip(job.objects, names, strict=True):
            if name is None and o.surface is None:
                raise InputError(
                    f"object '{o.name}'", "the job names no material", "give --material; without a photo none is seen"
                )
        materials = given_materials(job, library, settings, names=names)
        names = [m.name for m in materials]
    out = Path(out) if out is not None else job.folder / "plan"
    scene = PreparedScene(job, reporter)
    with reporter.stage("transport"):
        problem = view_problem(scene, materials, settings)
    if noise is None:
        noise = max(_expected_noise(problem, i, m) for i, m in enumerate(materials))
    with reporter.stage("plan"):
        order = min(settings.order, settings.fit_order)
        foresight = foresee(problem.all_basis, normals=problem.normals, order=order, noise=noise, seed=settings.seed)
    eye = np.concatenate([p.to_eye for p in problem.points]).mean(0)
    with reporter.stage("writing"):
        draw_plan(out / "plan.png", foresight, eye / max(np.linalg.norm(eye), 1e-12), names)
    result = {
        "format": "btfsep-plan",
        "version": 1,
        "objects": [
            {"name": o.name, "material": n, "pixels": len(p)}
            for o, n, p in zip(job.objects, names, problem.points, strict=True)
        ],
        "order": order,
        "fit_order": settings.fit_order,
        "assumed_noise": noise,
        "determined": determined_words(foresight.determined, foresight.all_determined).replace(
            "determines", "could determine"
        ),
        "determined_coefficients": foresight.determined,
        "stddev": foresight.stddev,
        "prior_share": foresight.share,
        "effective_degrees_of_freedom": foresight.effective_degrees_of_freedom,
        "expected_error": foresight.expected,
        "condition_number": foresight.condition,
        "advice": advice(foresight),
        **run_record(settings, reporter),
    }
    result["seconds"]["total"] = round(time.perf_counter() - started, 4)
    write_json(out / "plan.json", result)
    return {**result, "out": str(out), "picture": str(out / "plan.png")}


def _expected_noise(problem: Problem, index: int, material) -> float:
    """Relative misfit to expect: shape and, where it is not fitted, the texture that the camera resolves."""
    footprint = float(np.median(problem.points[index].footprint)) * problem.scene.millimetres_per_unit
    texture = 0.0 if problem.materials[index] is material else texture_contrast(material, footprint)
    return float(np.hypot(SHAPE_NOISE, TEXTURE_SHARE * min(texture, 0.8)))


def advice(foresight: Foresight) -> list[str]:
    """What a photographer can do about it, in words."""
    out = []
    first = foresight.determined[: min(4, len(foresight.determined))]
    if not first.all():
        out.append(
            "not even the main direction of the light could be determined: show more of the object, from a side where "
            "its normals differ more, or put something glossy or round beside it"
        )
    error = foresight.expected.get("order_2")
    if error and error["median"] > POOR_ERROR:
        out.append(
            f"half of all lights would be {100 * error['median']:.0f} % or more off up to order 2: a glossier "
            "material, a second object or a second photo from the other side would see what this one cannot"
        )
    return out


def without_level(covariance) -> np.ndarray:
    """A covariance (3 terms, 3 terms) with nothing unknown of the first coefficient."""
    out = np.array(covariance)
    out[:3] = out[:, :3] = 0
    return out


def draw_plan(path, foresight: Foresight, eye, names) -> None:
    """The picture: what would stay unknown of the light from every direction.

    Parameters
    ----------
    path : PNG
    eye : (3,) unit, from the object to the camera, world
    names : of the materials
    """
    directions = pixel_directions(*MAP)
    after = over_directions(foresight.covariance, directions)
    # how bright the light is on the whole any photo tells: what is asked here is its pattern
    pattern, natural = (over_directions(without_level(c), directions) for c in (foresight.covariance, foresight.prior))
    level = sh.evaluate(0, np.array([[0.0, 0.0, 1.0]]))[0, 0]  # radiance of even light of level 1
    figure = Figure(figsize=(8.2, 7.6), dpi=110, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    order = sh.order_of(len(foresight.share))
    panels = (
        ("Expected standard deviation of the radiance, over the light's mean radiance", after / level, None, "magma"),
        (
            "Unknown of its pattern: variance after the photo over before (0: determined, 1: not seen)",
            None,
            1.0,
            "viridis",
        ),
    )
    share = np.clip((pattern / np.maximum(natural, 1e-12)) ** 2, 0, 1)
    for axes, (title, values, top, colours) in zip(figure.subplots(2, 1), panels, strict=True):
        shown = share if values is None else values
        picture = axes.imshow(
            shown, extent=(180, -180, -90, 90), cmap=colours, vmin=0, vmax=top, aspect="equal", interpolation="bilinear"
        )
        figure.colorbar(picture, ax=axes, shrink=0.85, pad=0.015)
        axes.set_title(title, fontsize=10)
        axes.set_xticks([180, 90, 0, -90, -180], ["−X\n180°", "+Y\n90°", "+X\n0°", "−Y\n−90°", "−X\n−180°"])
        axes.set_yticks([-90, -45, 0, 45, 90], ["−Z", "−45°", "horizon", "45°", "+Z"])
        axes.tick_params(labelsize=8)
        for direction, mark, label in ((eye, "o", "camera"), (-np.asarray(eye), "x", "behind the object")):
            u, v = direction_to_equirect(direction)
            x, y = 180 - 360 * float(u), 180 * float(v) - 90
            axes.plot(x, y, mark, color="white", markersize=9, markeredgewidth=2, markerfacecolor="none")
            side = "right" if x < -90 else "left"
            shift = -9 if side == "right" else 9
            axes.annotate(
                label, (x, y), (shift, 7), textcoords="offset points", color="white", fontsize=9, ha=side, weight="bold"
            )
    error = foresight.expected.get("order_2") or foresight.expected.get("order_1")
    text = f"expected error of order 2: {error['median']:.2f}" if error else ""
    count = int(foresight.all_determined.sum())
    figure.suptitle(
        f"What {', '.join(dict.fromkeys(names))} could determine here: {count} of {len(foresight.all_determined)} "
        f"coefficients; {text}\n(light up to order {order}, seen from the object, world axes)",
        fontsize=11,
    )
    with replacing(path) as scratch:
        figure.savefig(scratch, format="png")
