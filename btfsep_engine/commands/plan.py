# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job could determine, before its photo is looked at."""

import time
from pathlib import Path

import cv2
import numpy as np

from btfsep_engine import sh
from btfsep_engine.commands.record import determined_words, run_record
from btfsep_engine.conventions import direction_to_equirect, pixel_directions
from btfsep_engine.errors import InputError
from btfsep_engine.fit.foresight import Foresight, foresee, over_directions
from btfsep_engine.imaging.images import write_png
from btfsep_engine.imaging.lettering import shortened, write_on
from btfsep_engine.job.load import load_job
from btfsep_engine.pipeline.materials import given_materials
from btfsep_engine.pipeline.model import view_problem
from btfsep_engine.pipeline.problem import Problem
from btfsep_engine.pipeline.refine.texture import texture_contrast
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.storage.atomic import check_folder, write_json
from btfsep_engine.threads import one_thread

SHAPE_NOISE = 0.05  # misfit of an object without texture, over its photo: shape, noise, what the basis leaves out
TEXTURE_SHARE = 0.6  # of a texture's contrast: so much stays a pixel's own misfit (white, leather, wood, denim alike)
MAP = (64, 128)
LINE = 22  # pixels of a line of text
POOR_ERROR = 0.25  # expected error of order 2: from here on advice is given


@one_thread()
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

    Raises
    ------
    InputError
        Where an object has no material.
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
    check_folder(out)
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
    share = np.clip((pattern / np.maximum(natural, 1e-12)) ** 2, 0, 1)
    error = foresight.expected.get("order_2") or foresight.expected.get("order_1")
    text = f"; expected error of order 2: {error['median']:.2f}" if error else ""
    count, order = int(foresight.all_determined.sum()), sh.order_of(len(foresight.share))
    lines = (
        f"What {', '.join(dict.fromkeys(names))} could determine here:",
        f"{count} of {len(foresight.all_determined)} coefficients{text}",
        f"(light up to order {order}, seen from the object, world axes)",
    )
    shown = (
        ("Expected standard deviation of the radiance, over the light's mean radiance", after / level, None, "MAGMA"),
        ("Unknown of its pattern: variance after the photo over before (0: determined)", share, 1.0, "VIRIDIS"),
    )
    maps = [_labelled_map(*each, eye) for each in shown]
    head = np.full((LINE * (len(lines) + 1), maps[0].shape[1], 3), 255, np.uint8)
    for i, line in enumerate(lines):
        write_on(head, shortened(line, head.shape[1]), head.shape[1] / 2, LINE * (i + 1))
    write_png(path, np.concatenate([head, *maps]))


def _labelled_map(title: str, values, top: float | None, colours: str, eye) -> np.ndarray:
    """A map with its axes, the bar of its colours, and where the camera is: (h, w, 3) uint8.

    ``values`` : (h, w), >= 0, as equirectangular maps are; ``top`` : the largest colour's, None: the largest value
    """
    top = top or float(values.max()) or 1.0
    width, height, left, above = 720, 360, 90, 2 * LINE
    out = np.full((above + height + 3 * LINE, left + width + 110, 3), 255, np.uint8)
    write_on(out, shortened(title, out.shape[1]), left + width / 2, above - 8)

    def coloured(share):
        codes = np.clip(255 * share + 0.5, 0, 255).astype(np.uint8)
        return cv2.applyColorMap(codes, getattr(cv2, f"COLORMAP_{colours}"))[..., ::-1]

    picture = np.ascontiguousarray(
        coloured(cv2.resize((values / top).astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR))
    )
    for direction, mark, label in (
        (eye, cv2.MARKER_DIAMOND, "camera"),
        (-np.asarray(eye), cv2.MARKER_TILTED_CROSS, "behind the object"),
    ):
        u, v = direction_to_equirect(direction)
        x, y = float(u) * width, (1 - float(v)) * height
        cv2.drawMarker(picture, (round(x), round(y)), (255, 255, 255), mark, 14, 2, cv2.LINE_AA)
        on_right = x > 0.75 * width
        write_on(picture, label, x + (-12 if on_right else 12), y - 6, before=float(on_right), level=255)
    out[above : above + height, left : left + width] = picture
    for i, names in enumerate((("−X", "180°"), ("+Y", "90°"), ("+X", "0°"), ("−Y", "−90°"), ("−X", "−180°"))):
        for row, name in enumerate(names):
            write_on(out, name, left + i * width / 4, above + height + LINE * (row + 1))
    for i, name in enumerate(("+Z", "45°", "horizon", "−45°", "−Z")):
        write_on(out, name, left - 8, above + i * height / 4 + 6, before=1.0)
    bar = slice(left + width + 26, left + width + 42)
    out[above : above + height, bar] = coloured(np.linspace(1, 0, height)[:, None])
    for share in np.linspace(0, 1, 5):
        write_on(out, f"{share * top:.2f}", bar.stop + 6, above + (1 - share) * height + 6, before=0.0)
    return out
