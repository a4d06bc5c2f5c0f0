# SPDX-License-Identifier: GPL-3.0-or-later
"""How well lamps and suns are found, on photographs by Cycles.

scripts/study lamps --make FOLDER     photographs objects under Blender's studio lights, some with a Sun lamp added
scripts/study lamps PHOTOS [PHOTOS …] [--maps FOLDER]

PHOTOS: folders of jobs OBJECT_MATERIAL_LIGHT, as --make or scripts/figures_table --photos leave them. LIGHT is one of
Blender's studio lights, or a map in --maps; a truth.json beside the job says what was added to it. Whole estimates,
preset balanced, the right material given. Prints a line a photo on stderr, and a table of the lights:

    lamp         how much of the true light comes from within 10 degrees of its brightest direction (or is the Sun lamp)
    found        photos in which a key light is told apart within 20 degrees of it
    direction    of the one that was found, from the true one: median (worst), and the median of what was stated
    share        of the light that it was given, over the lamp's own: median
    elsewhere    further key lights, and key lights that stand nowhere near: how many in all photos
    order 1, 2   errors of all of the light, relative L2 with one free scale: median (worst)
    over stated  the error up to order 2 over the stated one: median (worst)
    68 %, 95 %   true coefficients up to order 2 within 1 and 1.96 stated standard deviations; 95 % range: in the range
"""

import argparse
import itertools
import json
import sys
from pathlib import Path

import numpy as np

from btfsep_engine import sh
from btfsep_engine.btf.library import open_library
from btfsep_engine.conventions import pixel_directions, pixel_solid_angles
from btfsep_engine.fit.compare import relative_l2
from btfsep_engine.fit.expected_error import expected_error
from btfsep_engine.job.load import load_job
from btfsep_engine.light.sun import Sun
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from scripts.cycles import studio
from scripts.studies.measures import covered

MADE = (  # object, material
    ("suzanne", "white"),
    ("knot", "leather/brown-grain"),
    ("vase", "fabric/denim-twill"),
    ("blob", "wood/walnut-lacquered"),
)
LIGHTS = (  # Blender's, and how much of the light a Sun lamp adds: 0.3 is 30 % of the sum
    ("sunrise", 0.0),
    ("forest", 0.0),
    ("studio", 0.0),
    ("forest", 0.3),
    ("courtyard", 0.5),
)
SUN_FROM, SUN_DEGREES = (-0.55, -0.35, 0.76), 0.526
RESOLUTION, SAMPLES = 192, 64
LAMP_DEGREES, NEAR_DEGREES = 10.0, 20.0
TERMS = 9  # up to order 2


def make(folder: Path) -> None:
    """Photographs what `MADE` and `LIGHTS` name, one job folder each; those that are there stay."""
    import bpy
    from mathutils import Vector

    from blender_btfsep.export import export_job
    from scripts.cycles.demo import quiet

    for (name, material), (light, part) in itertools.product(MADE, LIGHTS):
        job = folder / f"{name}_{material.replace('/', '-')}_{light}{'sun' if part else ''}"
        if (job / "job.json").exists():
            continue
        job.mkdir(parents=True, exist_ok=True)
        with quiet():
            scene, _, base, _ = studio.make_scene(name, material, light, resolution=RESOLUTION)
            if part:
                even = np.sqrt(4 * np.pi) * studio.true_lighting(light, 0)[0]
                sun = even.mean() * part / (1 - part) * np.ones(3)
                lamp = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
                lamp.data.energy, lamp.data.angle = float(sun[0]), np.radians(SUN_DEGREES)
                lamp.rotation_euler = Vector(SUN_FROM).to_track_quat("Z", "Y").to_euler()
                scene.collection.objects.link(lamp)
                told = {"light": light, "direction": SUN_FROM, "irradiance": sun.tolist()}
                (job / "truth.json").write_text(json.dumps(told))
            studio.render_photo(scene, job / "rendered.exr", SAMPLES)
            export_job(scene, job, image_path=job / "rendered.exr", objects=[base], occluders=[])
        print(job.name, file=sys.stderr, flush=True)


def truth_of(folder: Path, light: str, maps):
    """True coefficients to order 9 (100, 3), the strongest light's direction (3,), and its share of all light."""
    beside = folder / "truth.json"
    if beside.exists():
        told = json.loads(beside.read_text())
        sun = Sun(told["direction"], told["irradiance"], [0, 0, 0])
        x = studio.true_lighting(told["light"], 9) + sun.coefficients(9)
        return x, sun.direction, sun.share_of(x)
    if light not in studio.studio_lights():
        light = next(p for p in sorted(maps.iterdir()) if p.stem.replace("_", "").startswith(light))
    radiance = studio.read_image(studio.light_path(light)).sum(2)
    toward = pixel_directions(*radiance.shape)
    brightest = toward[np.unravel_index(radiance.argmax(), radiance.shape)]
    power = radiance * pixel_solid_angles(*radiance.shape)[:, None]
    lamp = toward @ brightest > np.cos(np.radians(LAMP_DEGREES))
    return studio.true_lighting(light, 9), brightest, float(power[lamp].sum() / power.sum())


def library_name(material: str) -> str:
    return "reference/white-diffuse" if material == "white" else material.replace("-", "/", 1)


def study(folder: Path, library, maps) -> dict:
    """One photograph."""
    _, material, light = folder.name.split("_")
    truth, direction, share = truth_of(folder, light, maps)
    scene = PreparedScene(load_job(folder), Reporter())
    found = estimate(scene, library, choose(), material=library_name(material))
    light_found, fit = found.lighting, found.fit
    x = light_found.coefficients
    errors = [relative_l2(x[:n], truth[:n])["relative_l2_free_scale"] for n in map(sh.term_count, (1, 2))]
    off = [np.degrees(np.arccos(np.clip(sun.direction @ direction, -1, 1))) for sun in light_found.suns]
    near = int(np.argmin(off)) if off and min(off) < NEAR_DEGREES else None
    sun = None if near is None else light_found.suns[near]
    return {
        "light": light,
        "lamp": share,
        "found": sun is not None,
        "off": np.nan if sun is None else off[near],
        "off_stated": np.nan if sun is None else sun.direction_stddev_degrees,
        "share": np.nan if sun is None else sun.share / share,
        "elsewhere": len(off) - (sun is not None),
        "errors": errors,
        "stated": expected_error(x, fit.samples)["order_2"]["median"],
        **covered(x[:TERMS], light_found.stddev[:TERMS], truth[:TERMS], interval=light_found.interval[:, :TERMS]),
        "words": found.choice["key_light"],
    }


HEADS = (
    "light", "photos", "lamp", "found", "direction: off, stated", "share", "elsewhere", "order 1", "order 2",
    "over stated", "68 %", "95 %", "95 % range",
)  # fmt: skip


def table(rows) -> str:
    """Each light, and all."""
    lines = ["| " + " | ".join(HEADS) + " |", "|---" * len(HEADS) + "|"]
    lights = dict.fromkeys(r["light"] for r in rows)
    for name, some in [(k, [r for r in rows if r["light"] == k]) for k in lights] + [("**all**", rows)]:
        e = np.array([r["errors"] for r in some])
        over = e[:, 1] / [r["stated"] for r in some]
        hits = [r for r in some if r["found"]]
        off, stated, share = (np.array([r[key] for r in hits]) for key in ("off", "off_stated", "share"))
        cells = [
            name,
            len(some),
            "" if name == "**all**" else f"{100 * some[0]['lamp']:.0f} %",
            len(hits),
            f"{np.median(off):.1f}° ({off.max():.1f}°), {np.median(stated):.1f}°" if hits else "–",
            f"{np.median(share):.2f}" if hits else "–",
            sum(r["elsewhere"] for r in some),
            *(f"{np.median(v):.2f} ({v.max():.2f})" for v in (*e.T, over)),
            *(f"{100 * np.mean([r[key] for r in some]):.0f} %" for key in ("within68", "within95", "inside")),
        ]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def main(arguments) -> int:
    parser = argparse.ArgumentParser(
        prog="scripts/study lamps", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("photos", type=Path, nargs="*")
    parser.add_argument("--make", type=Path, metavar="FOLDER", help="photograph what the study is made of")
    parser.add_argument("--maps", type=Path, help="folder of the lights that are not Blender's")
    parser.add_argument("--objects", nargs="+", help="some of the objects")
    parser.add_argument("--lights", nargs="+", help="some of the lights")
    options = parser.parse_args(arguments)
    if not (options.photos or options.make):
        parser.error("name folders of photos, or --make FOLDER")
    if options.make:
        make(options.make)
    library = open_library(None)
    for root in [*([options.make] if options.make else []), *options.photos]:
        rows = []
        for folder in sorted(p for p in root.iterdir() if (p / "job.json").exists()):
            name, _, light = folder.name.split("_")
            if (options.objects and name not in options.objects) or (options.lights and light not in options.lights):
                continue
            rows.append(study(folder, library, options.maps))
            r = rows[-1]
            told = f"order 1 {r['errors'][0]:.3f}, order 2 {r['errors'][1]:.3f} ({r['stated']:.3f} stated)"
            print(f"{folder.name:44s} {told}; {r['words']}", file=sys.stderr, flush=True)
        if not rows:
            parser.error(f"{root} has no jobs OBJECT_MATERIAL_LIGHT")
        print(table(rows) + "\n")
    return 0
