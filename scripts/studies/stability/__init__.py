# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the estimate and eight other methods fail: photographs by Cycles, disturbed in fifteen ways.

scripts/study stability --work FOLDER          photographs, estimates, docs/results/stability.md and its charts
scripts/study stability --work FOLDER --half   each object under one of the two lights: half the time
scripts/study stability --work FOLDER --quick  two objects, each under one light
scripts/study stability --work FOLDER --axes noise clipping --methods ours paper-mean

Every photograph and every estimate is kept in --work: a run that was stopped goes on where it was. After a change of
the estimator take away WORK/estimates/*/*-ours.json, and keep the photographs; of methods that were not run anew, the
page keeps what it had (`--methods ours --stages photos estimates`, then `--stages page`). Two processes share the work
with --stages estimates --shard 0/2 and 1/2.
"""

from pathlib import Path

from scripts.studies import ROOT, parser, photos

STAGES = ("photos", "estimates", "page")
NOISE = 0.02  # of a pixel, where Cycles stops


def main(arguments) -> int:
    from scripts.studies.stability import axes, methods, page, run, scenes

    options = parser("stability", __doc__)
    options.add_argument("--work", type=Path, required=True, help="folder for photographs and estimates")
    options.add_argument("--quick", action="store_true", help="two objects, each under one light")
    options.add_argument("--half", action="store_true", help="each object under one of the lights, not under all")
    options.add_argument("--axes", nargs="*", choices=list(axes.AXES), default=list(axes.AXES), metavar="AXIS")
    options.add_argument("--methods", nargs="+", choices=list(methods.METHODS), default=list(methods.METHODS))
    options.add_argument("--lights", nargs="+", default=list(scenes.LIGHTS), help="Blender's studio lights, or maps")
    options.add_argument("--stages", nargs="+", choices=STAGES, default=list(STAGES))
    options.add_argument("--resolution", type=int, default=160, help="edge of a photograph, pixels")
    options.add_argument("--samples", type=int, default=64)
    options.add_argument("--shard", default="0/1", help="I/N: every N-th estimate from the I-th, for several processes")
    options.add_argument("--out", type=Path, default=ROOT / "docs" / "results" / "stability.md")
    given = options.parse_args(arguments)
    given.work, given.half = given.work.resolve(), given.half or given.quick
    chosen = (scenes.SCENES[0], scenes.SCENES[2]) if given.quick else scenes.SCENES
    if "photos" in given.stages:
        wanted, pairs = [], scenes.pairs(chosen, given.lights, half=given.half)
        for scene in chosen:
            under = [light for s, light in pairs if s == scene]
            wanted += scenes.shots(given.work, scene, given.lights, given.axes, under=under)
        wanted.sort(key=lambda s: s.folder)  # photographs of one geometry follow each other
        photos.take(wanted, resolution=given.resolution, samples=given.samples, threads=2, noise=NOISE)
    if "estimates" in given.stages:
        run.run(chosen, given)
    if "page" in given.stages:
        page.write(chosen, given)
    return 0
