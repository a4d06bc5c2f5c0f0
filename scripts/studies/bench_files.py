# SPDX-License-Identifier: GPL-3.0-or-later
"""What a BTF file of UBO2014's size costs: opening, decoding, recompressing.

scripts/study bench-files       --side 400 and --components 101 are UBO2014's

The file is synthetic: a glossy, textured, bumpy material in the log domain, written as ``!FMF12FCER``.
"""

import struct
import tempfile
from pathlib import Path

import numpy as np

from btfsep_engine.btf import linear
from btfsep_engine.btf.directions import ubo2014_angles, ubo2014_directions
from btfsep_engine.btf.formats.ubo2014 import open_btf
from btfsep_engine.btf.recompress import recompress
from scripts.studies import parser
from scripts.studies.measures import seconds_of, timed


def log_factors(side: int, k: int, rng):
    """(pairs * 3, k) and (texels, k): the log of a bumpy glossy surface, its components of falling weight."""
    d = ubo2014_directions()
    half = d[:, None] + d[None]
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    base = np.log((0.2 / np.pi + 0.5 * half[..., 2] ** 30) * d[:, 2]).reshape(-1)
    slope = np.stack([half[..., 0], half[..., 1], *(half[..., i] * half[..., j] for i, j in ((0, 0), (1, 1), (0, 1)))])
    waves = rng.normal(0, 1, (k - 6, 3)) * [4, 4, 4]
    patterns = np.concatenate([slope.reshape(5, -1), np.sin(half.reshape(-1, 3) @ waves.T).T])
    angular = np.empty((len(base), 3, k), np.float32)
    angular[:, :, 0] = base[:, None] + np.array([0.1, -0.2, -0.6])
    angular[:, :, 1:] = patterns.T[:, None] * rng.uniform(0.8, 1.2, (3, k - 1))
    spatial = rng.normal(0, 1, (side * side, k)).astype(np.float32)
    spatial *= (0.8 / np.sqrt(np.arange(1, k + 1)) / np.arange(1, k + 1) ** 0.3).astype(np.float32)
    spatial[:, 0] = 1
    return angular.reshape(-1, k), spatial


def write_log_file(path: Path, side: int, k: int, rng) -> None:
    """A ``!FMF12FCER`` file with dynamic range reduction, half floats."""
    angular, spatial = log_factors(side, k, rng)
    angles = ubo2014_angles().astype("<f4")
    lights = struct.pack("<I", len(angles)) + angles.tobytes()
    names = b"".join(struct.pack("<I", 1) + c for c in (b"R", b"G", b"B"))
    body = bytes(240) + struct.pack("<4fIII", 6.0, 1, 1, 1, 1, 0, 3) + names
    with path.open("wb") as out:
        out.write(b"!FMF12FCER" + struct.pack("<II", len(body) + 8, 4) + body + struct.pack("<I", len(angles)))
        out.write(b"".join(a.tobytes() + lights for a in angles))
        out.write(struct.pack("<IIIBIII", side, side, 0, 2, 1, 0, 0))
        out.write(struct.pack("<IBIII", k, 2, k, len(angular), len(spatial)) + bytes(2 * k))
        out.write(angular.astype("<f2").tobytes() + spatial.astype("<f2").tobytes())


def main(arguments) -> None:
    options = parser("bench-files", __doc__)
    options.add_argument("--side", type=int, default=400)
    options.add_argument("--components", type=int, default=101)
    options.add_argument("--kept", type=int, nargs="*", default=[8, 16, 32, 64])
    given = options.parse_args(arguments)

    def least(function):
        return seconds_of(function, 3, of=np.min)[0][0]

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.btf"
        write_log_file(path, given.side, given.components, np.random.default_rng(1))
        size = path.stat().st_size / 1e6
        print(f"file of {size:.1f} MB, {given.side} x {given.side} texels, {given.components} components")
        print(f"  opened in {1e3 * least(lambda: open_btf(path)):.2f} ms")
        file = open_btf(path)
        texel, whole = [23 * given.side + 17], slice(None)
        seconds = least(lambda: file.decode(texel, whole))
        print(f"  one texel's ABRDF, 151 x 151, decoded in {1e3 * seconds:.1f} ms")
        print(f"  one texture decoded in {1e3 * least(lambda: file.decode(whole, [40 * 151 + 70])):.0f} ms")
        seconds, found = timed(lambda: linear.check_reciprocity(file))
        print(f"  reciprocity in {seconds[0]:.1f} s: {found.verdict} ({found.as_stored:.2f}, {found.divided:.2f})")
        for k in given.kept:
            seconds, factors = timed(lambda k=k: recompress(file.decode, file.texels, file.pairs, components=k))
            size = 2 * k * (file.texels + 3 * file.pairs) / 1e6
            words = f"{size:5.1f} MB: error {factors.relative_error:.4f}, {seconds[0]:.1f} s"
            print(f"  {k:3} linear components, {words}", flush=True)
