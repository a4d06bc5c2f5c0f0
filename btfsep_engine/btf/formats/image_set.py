# SPDX-License-Identifier: GPL-3.0-or-later
"""UBO2003, ATRIUM and UTIA: a material as 81 x 81 images, in a folder or a zip.

The angles are in the names: ``… tl000 pl000 tv030 pv030.jpg`` or with ``_`` in place of the spaces; tl and pl are
theta and phi of the light, tv and pv of the view, in degrees. Integer pixels are gamma-coded, floats linear. A value of
1 is taken as that of a white diffuse surface that the light strikes straight on: f cos(theta_i) = value / pi.

ATRIUM's Radiance files say ``+X 256 -Y 256`` (columns first) and mean rows, from the bottom up.
"""

import re
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from btfsep_engine.btf import reciprocity
from btfsep_engine.btf.directions import UBO2003_RINGS, ubo2003_directions
from btfsep_engine.btf.factorise import StreamingFactoriser
from btfsep_engine.btf.formats.archive import Members, scratch_folder
from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.progress import Reporter

NAME = re.compile(r"tl(\d{1,3}).*?pl(\d{1,3}).*?tv(\d{1,3}).*?pv(\d{1,3})", re.IGNORECASE)
RADIANCE = (".hdr", ".rgbe", ".pic")
SUFFIXES = (*images.SUFFIXES, *RADIANCE)
RADIANCE_COLUMNS_FIRST = re.compile(rb"\n\+X (\d{1,6}) -Y (\d{1,6})\n")
MAX_PIXELS = 1024 * 1024  # of one image
BLOCK = 16 << 20  # values factorised at once
ANGLES = [(theta, i * 360 // count) for theta, count, _ in zip(*UBO2003_RINGS, strict=True) for i in range(count)]
COUNT = len(ANGLES)  # 81


@dataclass(frozen=True)
class Imported:
    """What the images hold.

    Attributes
    ----------
    texels : (h, w, k) float32, row 0 the smallest v
    angular : (81, 81, 3, k) float32, f cos(theta_i) in 1/sr as in the images: the cosine is in it or not
    directions : (81, 3), of views and of lights
    reciprocity : Reciprocity of the mean ABRDF
    relative_error : of the factors against the images
    """

    texels: np.ndarray
    angular: np.ndarray
    directions: np.ndarray
    reciprocity: reciprocity.Reciprocity
    relative_error: float


def direction_index(theta: int, phi: int) -> int | None:
    """The place of a direction (degrees) in the list of 81, None where it is not in it."""
    angles = theta, phi % 360 if theta else 0
    return ANGLES.index(angles) if angles in ANGLES else None


def find_images(members: Members) -> dict:
    """(view, light) -> name of the member.

    Raises InputError: directions that are not in the list, two images of one pair, pairs without an image.
    """
    found = {}
    for name in members.names:
        path = PurePosixPath(name.replace("\\", "/"))
        match = NAME.search(path.name)
        if match is None or path.suffix.lower() not in SUFFIXES:
            continue
        tl, pl, tv, pv = map(int, match.groups())
        pair = direction_index(tv, pv), direction_index(tl, pl)
        if None in pair:
            raise InputError(
                f"{members.source}: {path.name}",
                "its angles are not in the list of 81 directions",
                "give 81 x 81 images",
            )
        if pair in found:
            raise InputError(
                f"{members.source}: {path.name}", f"{found[pair]} has the same angles", "remove one of them"
            )
        found[pair] = name
    missing = COUNT * COUNT - len(found)
    if missing:
        v, l = next((v, l) for v in range(COUNT) for l in range(COUNT) if (v, l) not in found)
        angles = [f"{t:03.0f} p{s}{p:03.0f}" for s, (t, p) in zip("vl", (ANGLES[v], ANGLES[l]), strict=True)]
        raise InputError(
            str(members.source),
            f"{missing} of {COUNT * COUNT} images are missing, the first of them tv{angles[0]} tl{angles[1]}",
            "give the folder or zip of one whole material (names with tl… pl… tv… pv…)",
        )
    return found


def import_images(
    source,
    *,
    components: int,
    gamma: float | None = None,
    scale: float = 1.0,
    flip_v: bool = False,
    reporter: Reporter | None = None,
) -> Imported:
    """Reads a folder or zip of 81 x 81 images, view by view, and factorises it.

    Parameters
    ----------
    source : folder or zip
    components : k at most
    gamma : of integer pixels, value = code^gamma; None: sRGB
    scale : multiplies all values
    flip_v : the images have the smallest v at the top
    reporter : told the progress as stage "import"

    Raises InputError: images that are missing, unreadable, of different sizes or too large; values that are not finite.
    """
    reporter, directions = reporter or Reporter(), ubo2003_directions()
    if not 0 < scale < np.inf or not (gamma is None or 0.1 <= gamma <= 10):
        raise InputError("scale or gamma", "they have to be positive", "leave them out, or give 1 and 2.2")
    with Members(source) as members, scratch_folder() as scratch:
        found = find_images(members)
        reader = _Reader(members, scratch / "fixed.hdr", gamma)
        height, width, _ = reader.read(found[0, 0]).shape
        at_once = max(1, min(COUNT, BLOCK // (3 * height * width)))
        blocks = COUNT * -(-COUNT // at_once)
        kept = int(np.clip(np.ceil(6 * components / blocks), 1, 8))
        factoriser = StreamingFactoriser(height * width, components, kept_columns=kept)
        for view in range(COUNT):
            for start in range(0, COUNT, at_once):
                lights = range(start, min(start + at_once, COUNT))
                block = np.empty((height, width, len(lights), 3), np.float32)
                for i, light in enumerate(lights):
                    image = reader.read(found[view, light])
                    block[:, :, i] = image if flip_v else image[::-1]
                block *= scale / np.pi
                factoriser.add(block.reshape(height * width, -1))
            reporter.progress("import", (view + 1) / COUNT)
    factors = factoriser.finish()
    angular = factors.angular.reshape(COUNT, COUNT, 3, -1)
    mean = angular @ factors.texels.mean(0)
    return Imported(
        texels=factors.texels.reshape(height, width, -1),
        angular=angular,
        directions=directions,
        reciprocity=reciprocity.check(mean, directions, directions),
        relative_error=factors.relative_error,
    )


class _Reader:
    """Reads the images of one material: linear, all of one size."""

    def __init__(self, members: Members, scratch: Path, gamma: float | None):
        self.members, self.scratch, self.gamma, self.shape = members, scratch, gamma, None

    def read(self, name: str) -> np.ndarray:
        """(h, w, 3) float32, the top row first."""
        with self.members.file(name) as path:
            try:
                path, upside_down = self._mended(path)
                space, primaries = ("auto", "auto") if self.gamma is None else ("linear", "rec709")
                image = images.read_linear(path, colorspace=space, primaries=primaries, max_pixels=MAX_PIXELS)
                coded = self.gamma is not None and path.suffix.lower() not in (*RADIANCE, ".exr")
            except InputError as error:
                raise InputError(f"{self.members.source}: {name}", error.got, error.do) from error
        pixels = image.pixels**self.gamma if coded else image.pixels
        if not np.isfinite(pixels).all():
            raise self._bad(name, "it holds NaN or infinite pixels")
        if self.shape not in (None, pixels.shape):
            raise self._bad(name, f"{pixels.shape[1]} x {pixels.shape[0]} pixels; others have another size")
        self.shape = pixels.shape
        return pixels[::-1] if upside_down else pixels

    def _mended(self, path: Path):
        """The path of a file that can be read, and whether its rows then come from the bottom up."""
        try:
            with path.open("rb") as handle:
                start = handle.read(4096)
                match = RADIANCE_COLUMNS_FIRST.search(start) if start.startswith(b"#?") else None
                if match is None:
                    return path, False
                line = b"\n-Y %s +X %s\n" % (match[2], match[1])
                self.scratch.unlink(missing_ok=True)  # writing over a file would wait for the disk
                self.scratch.write_bytes(start[: match.start()] + line + start[match.end() :] + handle.read())
        except OSError as error:
            raise InputError(path.name, error, "check the file") from error
        return self.scratch, True

    def _bad(self, name: str, got: str) -> InputError:
        return InputError(f"{self.members.source}: {name}", got, "download or export the images again")
