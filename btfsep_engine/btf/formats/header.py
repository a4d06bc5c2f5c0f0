# SPDX-License-Identifier: GPL-3.0-or-later
"""The part that all UBO2014 ``.btf`` files share: signature, texts, directions, texel counts."""

from dataclasses import dataclass, field

import numpy as np

from btfsep_engine.btf.formats.mapped import Cursor
from btfsep_engine.conventions import local_direction

FMF_SIGNATURES = (b"!FMF12FCER", b"!FMF06FCR", b"!FMF06FC")  # the longest match wins
DFMF_SIGNATURES = (b"!DFMF08FCR",)
UNSUPPORTED = {
    b"!PVF06FC": "it holds a factorisation per view (PVF), which is not supported",
    b"!BDIF06R2!": "it is an uncompressed measurement (BDI), which is not supported",
}
CONVERT = "convert it to FMF or DFMF with the University of Bonn's btflib, or download the resampled .btf file"
MAX_TEXELS = 4096 * 4096
MAX_DIRECTIONS = 1024  # in a list; UBO2014 has 151


@dataclass(frozen=True)
class Header:
    """What a ``.btf`` file says about itself, before the factors.

    Attributes
    ----------
    signature : str
    pixels_per_mm : float, 0 when the file does not say
    cosine_in_data : bool, cos(theta_i) is multiplied into the data
    channels : tuple of str
    views, lights : (n, 3) float64, unit, local frame
    width, height : texels
    setup, xml : str, free text
    rgb_scale : 3 floats; no known reader applies them
    height_mm : (h, w) float32, the height map of ``!FMF12FCER`` files, or None
    """

    signature: str
    pixels_per_mm: float
    cosine_in_data: bool
    channels: tuple
    views: np.ndarray
    lights: np.ndarray
    width: int
    height: int
    setup: str = ""
    xml: str = ""
    rgb_scale: tuple = (1.0, 1.0, 1.0)
    height_mm: np.ndarray | None = field(default=None, repr=False)


def read_common(cursor: Cursor) -> Header:
    """The :class:`Header` of the file that ``cursor`` is at the beginning of; the cursor then stands at the payload.

    Raises InputError: another kind of file, one that is cut short, or one that contradicts itself.
    """
    start = bytes(cursor.data[:10])
    signature = next((s for s in FMF_SIGNATURES + DFMF_SIGNATURES if start.startswith(s)), None)
    if signature is None:
        for known, words in UNSUPPORTED.items():
            if start.startswith(known):
                raise cursor.fail(words, CONVERT)
        raise cursor.fail("it does not begin like a UBO2014 .btf file", "give a file of the !FMF or !DFMF kind")
    begin = cursor.at = len(signature)
    struct_size, version = cursor.unpack("II", "the header")
    setup, _, _ = (cursor.text(80, "the header") for _ in range(3))  # the other two: the sensor, the light source
    pixels_per_mm = cursor.unpack("f", "the header")
    rgb_scale = cursor.unpack("3f", "the header")
    cosine = bool(cursor.unpack("I", "the header")) if version > 1 else False
    xml = cursor.text(cursor.unpack("I", "the header"), "the XML text") if version > 2 else ""
    channels = ("R", "G", "B")
    if version > 3:
        count = cursor.unpack("I", "the header")
        if count != 3:
            raise cursor.fail(f"{count} colour channels; only RGB is supported", "give an RGB file")
        channels = tuple(cursor.text(cursor.unpack("I", "a name"), "a channel's name") for _ in range(count))
    if cursor.at != begin + struct_size:
        raise cursor.fail("the header's length does not agree with its content")
    if not (np.isfinite(pixels_per_mm) and 0 <= pixels_per_mm < 1e4):
        raise cursor.fail(f"it claims {pixels_per_mm} pixels per millimetre; 0 to 10000 can be")
    views, lights = _read_directions(cursor)
    width, height = cursor.unpack("II", "the texel counts")
    if not (0 < width and 0 < height and width * height <= MAX_TEXELS):
        raise cursor.fail(f"it claims {width} x {height} texels; 1 to {MAX_TEXELS} are supported")
    if signature.endswith(b"R"):
        rotations = cursor.unpack("I", "the local frames")
        cursor.skip(rotations * 36, "the local frames")
    return Header(
        signature=signature.decode(),
        pixels_per_mm=pixels_per_mm,
        cosine_in_data=cosine,
        channels=channels,
        views=views,
        lights=lights,
        width=width,
        height=height,
        setup=setup,
        xml=xml,
        rgb_scale=rgb_scale,
    )


def _read_directions(cursor: Cursor):
    """Views (n, 3) and the light list (m, 3), which has to be the same in every view."""
    count = cursor.unpack("I", "the views")
    if not 1 <= count <= MAX_DIRECTIONS:
        raise cursor.fail(f"{count} view directions; 1 to {MAX_DIRECTIONS} are supported")
    views, lights = [], None
    for _ in range(count):
        views.append(cursor.unpack("2f", "a view direction"))
        n = cursor.unpack("I", "the lights")
        if n < 1:
            raise cursor.fail("it has a view without lights")
        here = cursor.array("<f4", (n, 2), "the light directions")
        if n > MAX_DIRECTIONS:
            raise cursor.fail(f"{n} light directions; 1 to {MAX_DIRECTIONS} are supported")
        if lights is not None and not (len(lights) == n and np.array_equal(lights, here)):
            raise cursor.fail("views with different light lists are not supported", CONVERT)
        lights = here
    angles = [np.array(views, np.float64), np.array(lights, np.float64)]
    for a in angles:
        if not np.isfinite(a).all() or np.abs(a).max() > 100:
            raise cursor.fail("it has directions that are not finite")
        if a[:, 0].min() < -1e-6 or a[:, 0].max() >= np.pi / 2:
            raise cursor.fail("it has directions at or below the horizon")
    return tuple(local_direction(*a.T) for a in angles)
