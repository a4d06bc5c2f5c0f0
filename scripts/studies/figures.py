# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's figures 3 and 4 on our library: photo, classified material, estimated and true light, re-rendering.

scripts/study figures                        eight photographs by Cycles -> docs/images/figure_3.png, figure_4.png
scripts/study figures --quick --to FOLDER    one row of each figure

The photographs show truly displaced materials on known objects under Blender's own studio lights, which nothing was
trained on. The material is recognised among all of the library's; the light is of order 4. The estimated light
is shown as it is, the true one at the same exposure. Photos and jobs are kept in --photos, results beside them.
"""

import contextlib
import tempfile
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine import sh
from btfsep_engine.btf import thumbnail
from btfsep_engine.btf.library import open_library
from btfsep_engine.imaging import images
from scripts.cycles import COVERAGE, engine
from scripts.cycles.figure import display, exposure, on_white, write_rows
from scripts.cycles.lights import true_lighting
from scripts.studies import ROOT, parser, photos
from scripts.studies.measures import errors

FIGURES = {
    "figure_3": (
        ("suzanne", "leather/brown-grain", "courtyard"),
        ("blob", "fabric/denim-twill", "sunset"),
        ("vase", "wood/walnut-lacquered", "city"),
        ("blob", "stone/granite-grey", "forest"),
    ),
    "figure_4": (
        ("cloth", "leather/black-nappa", "interior"),
        ("blob", "carpet/cut-wine", "night"),
        ("suzanne", "wood/oak-boards", "studio"),
        ("vase", "wallpaper/damask-teal", "sunrise"),
    ),
}
COLUMNS = ("input image", "classified material", "estimated illumination", "true illumination", "re-rendered")
ORDER = 4


def row_of(shot, given) -> list:
    """Estimates and re-renders one photograph; gives the five (picture, words below it)."""
    folder, told = Path(shot.folder), ["--order", ORDER, "--appearance", "mean"]
    found = engine.run("estimate", folder, *told, "--no-report")
    name = found["objects"][0]["material"]
    again = folder / "again.exr"
    engine.run("relight", folder, "--lighting", found["lighting"], "--material", name, "--out", again)
    estimate, truth = engine.coefficients(found["lighting"]), true_lighting(shot.light, ORDER)
    photo, rendered = (images.read_linear(folder / p).pixels[..., :3] for p in (shot.name, "again.exr"))
    inside = np.load(folder / COVERAGE)
    shown = exposure(photo[inside > 0.5])
    maps = [sh.to_map(x, 96, 192) for x in (estimate, truth)]
    bright = exposure(np.maximum(maps[1], 0))
    swatch, off = thumbnail.render(open_library(None).load(name), 200), errors(estimate, truth)
    pictures = [
        on_white(display(photo, shown), inside),
        display(swatch, exposure(swatch)),
        *(display(m, bright) for m in maps),
        on_white(display(rendered, shown), inside * (np.isfinite(rendered).all(-1) & rendered.any(-1))),
    ]
    words = (
        shot.material,
        name if name != shot.material else "right",
        f"order 2 error {off['order2']:.2f}, {off['direction']:.0f}°",
        shot.light,
        f"residual {found['residual']:.2f}",
    )
    return list(zip(pictures, words, strict=True))


def main(arguments) -> None:
    options = parser("figures", __doc__)
    options.add_argument("--to", type=Path, default=ROOT / "docs" / "images", help="folder for the two figures")
    options.add_argument("--photos", type=Path, help="folder in which photos and jobs are kept")
    options.add_argument("--resolution", type=int, default=320)
    options.add_argument("--samples", type=int, default=96)
    options.add_argument("--quick", action="store_true", help="one row of each figure")
    given = options.parse_args(arguments)
    right = []
    with contextlib.ExitStack() as stack:
        kept = (given.photos or Path(stack.enter_context(tempfile.TemporaryDirectory()))).resolve()
        for name, plan in FIGURES.items():
            shots = [photos.shot(kept, *each) for each in (plan[:1] if given.quick else plan)]
            photos.take(shots, resolution=given.resolution, samples=given.samples)
            rows = [row_of(shot, given) for shot in tqdm(shots, desc=name)]
            write_rows(given.to / f"{name}.png", rows, titles=COLUMNS)
            right += [row[1][1] == "right" for row in rows]
            print(f"wrote {given.to / f'{name}.png'}: {'; '.join(row[1][1] for row in rows)}")
    print(f"materials recognised: {sum(right)} of {len(right)}")
