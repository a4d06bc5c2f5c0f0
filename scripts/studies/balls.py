# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs of a grey ball that was photographed beside a mirror ball: real photographs under light from all sides.

scripts/study balls PAIRS JOBS [--only GLOB] [--surface BASE ROUGHNESS]
scripts/study real JOBS --chart FILE          judges the estimates of all that were written

PAIRS has pictures in pairs: one with "gray" in its name, and the same name with "chrome" instead. Each is a square that
the ball fills, linear, and seen from far away. (For one: the averages over a thousand rooms of "A Multi-Illumination
Dataset of Indoor Object Appearance", Murmann et al. 2019, that Poirier-Ginter et al. 2024 published.) Each grey ball
becomes a job of a sphere before an orthographic camera, `truth.json` what the mirror ball shows:

    r = 2 (n.e) n - e,    d_omega = 4 dA    (dA: of the disc of radius 1, which shows all directions once)

Directions behind the ball, which the disc's edge shows too small, have the mean of what it shows last. How a mirror
tints is not known, nor whether the grey is one: it is taken to be, the same for all pairs.
"""

from pathlib import Path

import numpy as np
import trimesh

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.imaging.images import read_linear, write_exr, write_png
from btfsep_engine.storage.atomic import write_json
from scripts.studies import parser
from scripts.studies.measures import ERROR_ORDER

MIRRORS = 0.985  # radius to which the mirror's picture is read: beyond, pixels show too much at once
BEHIND = 0.97  # radius from which what it shows stands for what lies behind the ball
INSIDE = 0.95  # radius of the grey ball's mask: the last pixels are blurred with what is behind them
TO_WORLD = np.array([[1, 0, 0, 0], [0, 0, -1, -5], [0, 1, 0, 0], [0, 0, 0, 1.0]])  # looks along +y, z is up


def disc(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Of a picture that a ball of radius 1 fills, (side, side): normals (…, 3) in the world, 0 outside, and radii."""
    across = (np.arange(side) + 0.5) * 2 / side - 1
    x, y = np.meshgrid(across, -across)
    radius = np.hypot(x, y)
    normal = np.stack([x, y, np.sqrt(np.maximum(1 - radius**2, 0))], -1) * (radius < 1)[..., None]
    return normal @ TO_WORLD[:3, :3].T, radius


def mirrored_light(picture) -> np.ndarray:
    """Coefficients (9, 3) of the light that a mirror ball shows in its ``picture`` (side, side, 3), linear."""
    normal, radius = disc(len(picture))
    shown = radius < MIRRORS
    to_eye = TO_WORLD[:3, 2]
    n, values = normal[shown], picture[shown].astype(np.float64)
    direction = 2 * (n @ to_eye)[:, None] * n - to_eye
    each = 4 * (2 / len(picture)) ** 2  # steradians
    every = fibonacci_sphere(20000)
    unseen = every[every @ to_eye < (direction @ to_eye).min()]
    behind = sh.evaluate(ERROR_ORDER, unseen).sum(0) * (4 * np.pi / len(every))
    edge = values[radius[shown] > BEHIND].mean(0)
    return each * sh.evaluate(ERROR_ORDER, direction).T @ values + np.outer(behind, edge)


def reflected_share(picture, light) -> np.ndarray:
    """(3,), the albedo of a grey ball in its picture (side, side, 3) under a light (9, 3), by least squares."""
    normal, radius = disc(len(picture))
    inner = radius < INSIDE
    received = sh.irradiance(light, normal[inner]) / np.pi
    return (received * picture[inner]).sum(0) / np.square(received).sum(0)


def pairs_of(folder: Path, only: str) -> list[tuple[Path, Path]]:
    """(grey, chrome) pictures of a folder."""
    grey = sorted(p for p in folder.glob(only) if "gray" in p.name)
    return [(p, q) for p in grey if (q := p.with_name(p.name.replace("gray", "chrome"))).exists()]


def write_job(folder: Path, picture, light, *, surface) -> None:
    """A job folder of a grey ball's picture (side, side, 3), with the true light (9, 3)."""
    folder.mkdir(parents=True, exist_ok=True)
    side = len(picture)
    _, radius = disc(side)
    write_exr(folder / "photo.exr", picture)
    write_png(folder / "mask.png", radius < INSIDE)
    trimesh.creation.icosphere(6, 1.0).export(folder / "ball.ply")
    of = {"material": "surface/plastic"}
    if surface is not None:
        base, roughness = surface
        of = {"material": None, "surface": {"base_color": [base] * 3, "roughness": roughness}}
    camera = {"projection": "orthographic", "width": side, "height": side, "to_world": TO_WORLD.tolist()}
    camera |= dict.fromkeys(("fx", "fy", "cx", "cy"), side / 2)
    job = {"format": "btfsep-job", "version": 1, "image": "photo.exr", "image_colorspace": "linear", "camera": camera}
    job |= {"objects": [{"name": "ball", "mesh": "ball.ply", "mask": "mask.png", **of}], "metres_per_unit": 0.03}
    write_json(folder / "job.json", job)
    write_json(folder / "truth.json", {"coefficients": light.tolist(), "scale": "free"})


def main(arguments) -> int:
    options = parser("balls", __doc__)
    options.add_argument("pairs", type=Path, help="a folder of pictures")
    options.add_argument("jobs", type=Path, help="where their jobs are written")
    options.add_argument("--only", default="*", metavar="GLOB", help="of the pictures' names")
    options.add_argument(
        "--surface",
        nargs=2,
        type=float,
        metavar=("BASE", "ROUGHNESS"),
        help="of the grey ball; else it is some plastic",
    )
    given = options.parse_args(arguments)
    pairs = pairs_of(given.pairs, given.only)
    if not pairs:
        options.error(f'{given.pairs} has no pair of pictures, of which one has "gray" and one "chrome" in its name')
    read = [[read_linear(p).pixels[..., :3] for p in pair] for pair in pairs]
    for (path, _), pictures in zip(pairs, read, strict=True):
        if any(p.shape[0] != p.shape[1] for p in pictures):
            options.error(f"{path} or its chrome is no square that the ball fills")
    lights = [mirrored_light(chrome) for _, chrome in read]
    shares = [reflected_share(grey, light) for (grey, _), light in zip(read, lights, strict=True)]
    tint = np.median(shares, 0)
    for (path, _), (grey, _), light in zip(pairs, read, lights, strict=True):
        write_job(given.jobs / path.stem, grey, light * tint / tint.mean(), surface=given.surface)
    words = ", ".join(f"{t:.3f}" for t in tint)
    print(f"{len(pairs)} jobs; the grey's albedo over the mirror's (red, green, blue): {words}")
    return 0
