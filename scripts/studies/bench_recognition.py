# SPDX-License-Identifier: GPL-3.0-or-later
"""How often the material is recognised, under lights that recognition was not trained with.

scripts/study bench-recognition                     one object, all materials of the library, Blender's studio lights
scripts/study bench-recognition --object blob --classifier nearest --preset accurate
scripts/study bench-recognition --photos engine     only renders of the engine itself (fast; no domain gap)
scripts/study bench-recognition --hide each         each material left out of the training in turn: is it unknown?

Training is that of an estimate with the same --preset. Shares come with the range that holds the true one with 95 %
(Wilson's, as if photos were independent).

Two kinds of photos: "engine" are renders by the engine's own transport of the same tables (the paper's setting);
"cycles" are made by Blender's Cycles with the meso-structure as displaced geometry, other texels and another UV map.
The photos are kept in --folder, and made only once.
"""

import json
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from btfsep_engine.btf.library import open_library
from btfsep_engine.job.load import load_job
from btfsep_engine.job.model import Photo
from btfsep_engine.light.lightings import EnvironmentMaps, shrink
from btfsep_engine.light.maps import read_map, training_lights
from btfsep_engine.pipeline import recognition
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.verification import Verification
from btfsep_engine.progress import Reporter
from scripts.cycles.lights import studio_lights
from scripts.studies import ROOT, parser, photos
from scripts.studies.photos import WHITE

KINDS = {"engine": "renders by the engine", "cycles": "photos by Cycles"}


def shown(library) -> list:
    """The materials that are photographed; others of the reference ones cannot be told from white, or are mirrors."""
    return [n for n in library.names() if n == WHITE or n in library.entries]


def plan(names, lights, per_material, wanted):
    """(material, light) pairs of the ``wanted`` of all ``names``: every light serves about equally many of all."""
    every = max(1, len(lights) // per_material)
    for i, name in enumerate(sorted(names, key=lambda n: (not n.startswith("reference/"), n))):
        for k in range(per_material if name in wanted else 0):
            yield name, lights[(i + k * every) % len(lights)]


def shot_of(folder: Path, object_name: str, name: str, light: str):
    """The photograph of a material of the library."""
    return photos.shot(folder, object_name, "white" if name == WHITE else name, light)


def share(right) -> str:
    """The share of true values and the range that holds it with 95 %."""
    right = [bool(r) for r in right]
    if not right:
        return "none asked"
    low, high = binomtest(sum(right), len(right)).proportion_ci(method="wilson")
    return f"{np.mean(right):.1%} ({100 * low:.0f} to {100 * high:.0f})"


def answers_of(recogniser, region, images, *, library, verification):
    """For ``images``, (material, light, image): (material, light, answer, rank of the right one, unknown_score)."""
    answers, window = [], recognition.bounding_window(region)
    for name, light, image in images:
        photo = Photo(np.nan_to_num(image), np.isfinite(image).all(-1), 0)
        found = recognition.recognised(photo, region, window, recogniser, library, verification, name="object")
        order = [c for c, _ in found.candidates]
        rank = order.index(name) if name in order else len(order)
        answers.append((name, light, found.material, rank, found.unknown_score))
    return answers


def judge(answers, title, seconds, *, hidden: bool):
    """Prints what came out, and gives it as JSON; ``hidden``: of materials that the training had not."""
    unknown, scores = [a[4] > 1 for a in answers], [a[4] for a in answers]
    same_class = share(a[0].split("/")[0] == a[2].split("/")[0] for a in answers)
    if hidden:
        print(
            f"\n## {title} of a material left out: {sum(unknown)} of {len(answers)} judged unknown, {share(unknown)}; "
            f"median score {np.median(scores):.2f}, highest {max(scores):.2f}"
        )
        print(f"answered with one of its class: {same_class}")
    else:
        print(f"\n## {title}: {len(answers)} photos, {seconds / len(answers):.2f} s each")
        print(
            f"material {share(a[0] == a[2] for a in answers)}, among the first two {share(a[3] < 2 for a in answers)}, "
            f"three {share(a[3] < 3 for a in answers)}; class {same_class}; "
            f"judged unknown {share(unknown)}, median score {np.median(scores):.2f}"
        )
        for light in sorted({a[1] for a in answers}):
            mine = [a[0] == a[2] for a in answers if a[1] == light]
            print(f"  {light:12} {np.mean(mine):6.1%} of {len(mine)}")
        print("confusions (truth -> answer: times)")
    for (truth, answer), times in Counter((a[0], a[2]) for a in answers if a[0] != a[2]).most_common():
        print(f"  {truth} -> {answer}: {times}")
    return {"title": f"{title}, left out" if hidden else title, "answers": answers}


def test_lights() -> EnvironmentMaps:
    """Blender's studio lights, 256 rows."""
    maps = {name: read_map(path) for name, path in sorted(studio_lights().items())}
    small = [shrink(m, max(1, len(m) // 256)) for m in maps.values()]
    return EnvironmentMaps(np.stack(small), tuple(maps))


def main(arguments) -> None:
    options = parser("bench-recognition", __doc__)
    options.add_argument(
        "--object", default="suzanne", help="suzanne, blob, knot, vase, cloth, sphere, pebble, cushion"
    )
    options.add_argument("--library", help="a library folder; the shipped one by default")
    options.add_argument("--photos", choices=(*KINDS, "both"), default="both")
    options.add_argument("--preset", default="balanced", help="whose training is measured")
    options.add_argument("--classifier", choices=("svm", "nearest"), help="the preset's by default")
    options.add_argument("--no-verify", dest="verify", action="store_false", help="the classifier's answer alone")
    options.add_argument("--resolution", type=int, default=400, help="edge of the photos, pixels")
    options.add_argument("--samples", type=int, default=32, help="of Cycles, per pixel")
    options.add_argument("--per-material", type=int, default=2, help="Cycles photos per material")
    options.add_argument(
        "--hide",
        nargs="+",
        default=[],
        metavar="NAME",
        help="materials, or 'each': every one is left out of a training of its own and then shown",
    )
    options.add_argument("--folder", type=Path, default=ROOT / "build" / "bench_recognition")
    options.add_argument("--materials", nargs="*", help="only these materials are photographed")
    given = options.parse_args(arguments)
    library = open_library(given.library)
    hidden = list(library.entries) if given.hide == ["each"] else given.hide
    if missing := set(hidden) - set(library.entries):
        options.error(f"not in the library: {', '.join(sorted(missing))}")
    wanted, kinds = given.materials or hidden or shown(library), [k for k in KINDS if given.photos in (k, "both")]
    folder = (given.folder / f"{given.object}-{given.resolution}").resolve()
    lights, how = test_lights(), {"resolution": given.resolution, "samples": given.samples}
    pairs = list(plan(shown(library), lights.names, given.per_material, wanted))
    first = shot_of(folder, given.object, WHITE, lights.names[0])  # its job is what the engine knows
    photos.take([first, *(shot_of(folder, given.object, *p) for p in pairs if "cycles" in kinds)], **how)

    settings = choose(given.preset, classifier=given.classifier)
    settings, reporter = replace(settings, verify=settings.verify and given.verify), Reporter()
    job = load_job(first.folder)
    scene = PreparedScene(replace(job, objects=(replace(job.objects[0], name="object", uv="xatlas"),)), reporter)
    region = recognition.training_region(scene.regions[0], settings.training_pixels)
    points = scene.points(0, region=region, textured=True)
    transport = scene.transport(points, directions=settings.training_directions)
    window = recognition.bounding_window(region)
    verification = Verification(scene, 0, region, window, settings) if settings.verify else None

    def images(kind, names):
        """(material, light, (h, w, 3)) of one kind of photos."""
        if kind == "cycles":
            for name, light in plan(shown(library), lights.names, given.per_material, names):
                yield name, light, load_job(shot_of(folder, given.object, name, light).folder).photo.radiance
            return
        for name in names:
            out = np.full((lights.count, *region.shape, 3), np.nan, np.float32)
            values = transport.radiance(library.load(name), lights).transpose(1, 0, 2)
            out[:, points.pixels[:, 0], points.pixels[:, 1]] = values
            yield from ((name, light, image) for light, image in zip(lights.names, out, strict=True))

    print(
        f"{given.object}: {int(region.sum())} of {int(scene.regions[0].sum())} pixels, preset {given.preset}, "
        f"{training_lights(settings.training_turns).count} training lights"
    )
    answers, seconds = {kind: [] for kind in kinds}, dict.fromkeys(kinds, 0.0)
    for out in [[name] for name in hidden] or [[]]:
        known = replace(library, entries={n: e for n, e in library.entries.items() if n not in out})
        recogniser = recognition.trained_recogniser(scene, 0, known, settings)
        print(
            f"trained{' without ' + out[0] if out else ''}: held-out windows "
            f"{recogniser.model.held_out_accuracy:.1%}, {reporter.seconds.get('training', 0):.0f} s so far",
            flush=True,
        )
        for kind in kinds:
            begun = time.perf_counter()
            answers[kind] += answers_of(
                recogniser, region, images(kind, out or wanted), library=known, verification=verification
            )
            seconds[kind] += time.perf_counter() - begun
    found = [judge(answers[k], KINDS[k], seconds[k], hidden=bool(hidden)) for k in kinds if answers[k]]
    name = f"{given.preset}-{settings.classifier}{'-hidden' if hidden else ''}.json"
    (folder / name).write_text(json.dumps(found, indent=1))
