# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo: Cycles takes a photo, the add-on and the engine find its material and its light, Cycles renders again.

Started by ``scripts/demo``. Leaves in the output folder: scene.blend (with the estimated World), photo.exr,
job/, lighting.json, lighting.exr, result.json, rerendered.exr, report.png.
"""

import argparse
import contextlib
import json
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

import blender_btfsep
from blender_btfsep import command
from btfsep_engine.fit import compare
from scripts.cycles import engine, figure, objects, studio
from scripts.cycles.lights import studio_lights, true_lighting
from scripts.studies.measures import errors

ORDER = 4


def parse():
    parser = argparse.ArgumentParser(prog="scripts/demo", description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("demo_output"), help="folder for what comes out")
    parser.add_argument("--object", default="suzanne", choices=[n for n in objects.NAMES if n != "sphere"])
    parser.add_argument("--material", default="leather/brown-grain", help="a material of the library, or white")
    parser.add_argument("--light", default="courtyard", choices=sorted(studio_lights()))
    parser.add_argument("--library", type=Path, help="another material library")
    parser.add_argument("--quick", action="store_true", help="a smaller photo and the draft settings")
    return parser.parse_args()


@contextlib.contextmanager
def stage(number: int, name: str, *, hush=True):
    """Tells a stage and how long it took."""
    print(f"[{number}/7] {name} …", flush=True)
    start = time.perf_counter()
    with studio.quiet() if hush else contextlib.nullcontext():
        yield
    print(f"      {time.perf_counter() - start:.1f} s", flush=True)


@dataclass(frozen=True)
class Taken:
    """What was photographed: the scene, its camera, the photo (h, w, 3), and how much of each pixel is the object."""

    scene: bpy.types.Scene
    camera: bpy.types.Object
    photo: np.ndarray
    mask: np.ndarray


def photographed(options, out: Path) -> Taken:
    """Builds the scene and takes its photo, with which the add-on then has to do."""
    resolution, samples = (256, 48) if options.quick else (512, 64)
    with stage(1, f"building a scene: {options.object} in {options.material} under '{options.light}'"):
        scene, camera, base, _ = studio.make_scene(
            options.object, options.material, options.light, resolution=resolution
        )
        base.display_type = "WIRE"  # what the engine is told, over what is photographed
        scene.cycles.samples = samples
    with stage(2, f"taking the photo with Cycles, {resolution} x {resolution}"):
        photo = studio.render_photo(scene, out / "photo.exr", samples)
        mask = studio.object_mask(scene)
    scene.btfsep.image = bpy.data.images.load(str(out / "photo.exr"), check_existing=False)
    scene.btfsep.objects.add().object = base
    scene.btfsep.occluders = "NONE"  # the photographed object is the known one: it casts no second shadow
    return Taken(scene, camera, photo, mask)


def estimated(options, out: Path) -> int:
    """Lets the add-on make the light its World; returns the exit status."""
    with stage(3, "BTFsep: job, recognition, estimate, World", hush=False):
        preset, results = "draft" if options.quick else "balanced", out / "job" / "result"
        given = ["--job", str(out / "job"), "--out", str(results), "--preset", preset, "--order", str(ORDER)]
        material = ["--material", "reference/white-diffuse"] if options.material == "white" else []
        status = command.main(["estimate", *given, *library_of(options), *material])
    if not status:
        for name in ("lighting.json", "lighting.exr", "result.json"):
            shutil.copyfile(results / name, out / name)
    return status


def library_of(options) -> list[str]:
    return ["--library", str(options.library.resolve())] if options.library else []


def rendered_again(options, taken: Taken, material: str, out: Path) -> tuple[np.ndarray, np.ndarray]:
    """The object as the library has the ``material`` and by Cycles, both under the estimated light; saves the scene."""
    with stage(4, "the object as the library has the material"):
        job_options = ["--lighting", out / "lighting.json", "--out", out / "material.exr"]
        engine.run("relight", out / "job", *job_options, "--material", material, *library_of(options))
        as_recognised = studio.read_image(out / "material.exr")
    with stage(5, "rendering again with Cycles, under the estimated World"):
        rerendered = studio.render_photo(taken.scene, out / "rerendered.exr", taken.scene.cycles.samples)
    with stage(6, "saving scene.blend"):
        taken.scene.render.filepath = "//rerendered.exr"
        for image in bpy.data.images:
            if image.source in {"GENERATED", "FILE"} and not image.packed_file:
                image.pack()  # the material's maps live in memory only, the light in Blender's own folder
        bpy.ops.wm.save_as_mainfile(filepath=str(out / "scene.blend"), compress=True)
    return as_recognised, rerendered


def main() -> int:
    options = parse()
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()
    blender_btfsep.register()
    taken = photographed(options, out)
    if status := estimated(options, out):
        return status
    result, estimate = json.loads((out / "result.json").read_text()), engine.coefficients(out / "lighting.json")
    found = result["objects"][0]["material"]
    as_recognised, rerendered = rendered_again(options, taken, found, out)
    with stage(7, "composing report.png"):
        truth = true_lighting(options.light, ORDER)
        off = errors(estimate, truth)
        solid = taken.mask > 0.99
        misfit = compare.relative_l2(rerendered[solid].astype(float), taken.photo[solid].astype(float))
        free, absolute = misfit["relative_l2_free_scale"], misfit["relative_l2"]
        right = found == options.material
        words = (
            f"{options.object}, {options.material}",
            found + ("" if right or options.material == "white" else f"  (true: {options.material})"),
            f"{options.light}, order {ORDER}",
            f"order {ORDER}, error {off['order2']:.2f} (order 2), {off['direction']:.0f}°",
            "Cycles, estimated World",
            f"error {absolute:.2f}, with a free scale {free:.2f}",
        )
        figure.write(
            out / "report.png",
            photo=taken.photo,
            mask=taken.mask,
            material=as_recognised,
            rerendered=rerendered,
            truth=truth,
            estimate=estimate,
            view=-np.array(taken.camera.matrix_world)[:3, 2],
            words=words,
        )
    total = time.perf_counter() - started
    known = "given" if options.material == "white" else ("right" if right else f"wrong, it is {options.material}")
    print(
        f"""
material         {found} ({known})
light, order 1   relative error {off["order1"]:.3f} with one free scale, {off["order1_absolute"]:.3f} with none
light, order 2   relative error {off["order2"]:.3f} with one free scale, {off["order2_absolute"]:.3f} with none
main direction   {off["direction"]:.1f} degrees off
re-rendering     relative error {free:.3f} with one free scale, {absolute:.3f} with none
time             {total:.0f} s, of which the engine {result["seconds"]["total"]:.0f} s

{out}/report.png  scene.blend  lighting.json  lighting.exr""",
        flush=True,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
