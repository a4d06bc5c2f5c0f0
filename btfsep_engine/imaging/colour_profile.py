# SPDX-License-Identifier: GPL-3.0-or-later
"""What the colours of an image file mean, where it says so: its primaries, to Rec.709, and its curve.

Read are matrix/TRC and grey profiles (ICC.1:2022, v2 and v4: what cameras, phones and editors write), the chunks cICP,
sRGB, gAMA and cHRM of PNG (third edition, in that order of rank), chromaticities of OpenEXR, and EXIF's R03 (Adobe RGB,
as cameras code it without a profile). Profiles made of tables (scanners', printers') are not followed. Nothing that a
file says is trusted: a profile that cannot be true is one that is not followed.
"""

import struct
from dataclasses import dataclass

import numpy as np

from btfsep_engine.imaging import image_headers

D50 = (0.3457, 0.3585)
D65 = (0.3127, 0.3290)
ACES = (0.32168, 0.33767)
PRIMARIES = {  # x, y of red, green, blue and white
    "rec709": ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06), D65),
    "display-p3": ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060), D65),
    "adobe-rgb": ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06), D65),
    "rec2020": ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046), D65),
    "prophoto-rgb": ((0.734699, 0.265301), (0.159597, 0.840403), (0.036598, 0.000105), D50),
    "acescg": ((0.713, 0.293), (0.165, 0.830), (0.128, 0.044), ACES),
    "aces2065-1": ((0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.0770), ACES),
}
NAMES = {
    "display-p3": "Display P3",
    "adobe-rgb": "Adobe RGB",
    "rec2020": "Rec.2020",
    "prophoto-rgb": "ProPhoto RGB",
    "acescg": "ACEScg",
    "aces2065-1": "ACES2065-1",
}
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
ALIKE = 0.01  # of matrices to Rec.709: what rounding makes of one
ALIKE_CURVE = 0.004  # of linear values
MOST_TAGS = 200
_GRID = np.linspace(0, 1, 257)
_CICP = {1: "rec709", 9: "rec2020", 12: "display-p3"}
_CICP_GAMMA = {4: 2.2, 5: 2.8, 8: 1.0}  # others: as sRGB, which is how they are shown
HDR = {16: "PQ", 18: "HLG"}


@dataclass(frozen=True)
class Curve:
    """Linear values of codes in [0, 1]: a table at even steps, or else a function of ICC's parametric type.

    y = (a x + b)^g + e where x >= d, else c x + f.
    """

    g: float = 1.0
    a: float = 1.0
    b: float = 0.0
    c: float = 1.0
    d: float = 0.0
    e: float = 0.0
    f: float = 0.0
    table: tuple = ()

    def __call__(self, codes) -> np.ndarray:
        """Linear values of ``codes`` (any shape). float64."""
        x = np.asarray(codes, np.float64)
        if self.table:
            return np.interp(x, np.linspace(0, 1, len(self.table)), self.table)
        return np.where(x >= self.d, np.maximum(self.a * x + self.b, 0) ** self.g + self.e, self.c * x + self.f)


SRGB = Curve(2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)


@dataclass(frozen=True)
class Profile:
    """What the colours of a file mean.

    Attributes
    ----------
    name : for people
    to_rec709 : (3, 3) float64, of linear columns (r, g, b); None: they are Rec.709
    curves : `Curve`, one for all channels or one for each; empty: as files of the kind are coded
    hdr : the name of the curve of a display of high range, which is not undone; else empty
    followed : whether it could be understood
    """

    name: str
    to_rec709: np.ndarray | None = None
    curves: tuple[Curve, ...] = ()
    hdr: str = ""
    followed: bool = True

    @property
    def linear(self) -> bool:
        """Whether codes are in proportion to light."""
        return bool(self.curves) and all(np.abs(c(_GRID) - _GRID).max() < ALIKE_CURVE for c in self.curves)

    def decode(self, codes) -> np.ndarray:
        """Linear values, of the file's own primaries, of ``codes`` (..., 1 or 3) in [0, 1]. float64."""
        if len(set(self.curves)) == 1:
            return self.curves[0](codes)
        return np.stack([curve(np.asarray(codes)[..., i]) for i, curve in enumerate(self.curves)], -1)


def of_primaries(name: str) -> Profile:
    """The profile of primaries in `PRIMARIES`, coded as files are."""
    return Profile(NAMES.get(name, name), _to_rec709(xyz_of(*PRIMARIES[name])))


def of_file(data: bytes) -> Profile | None:
    """What the bytes of a PNG, JPEG, TIFF or WebP say of their colours; None: nothing, or that they are sRGB."""
    coded = image_headers.coding(data)
    try:
        if coded.cicp is not None:
            return _of_cicp(coded.cicp)
        if coded.icc is not None:
            return _plain(_of_icc(coded.icc))
        if coded.is_srgb:
            return None
        if coded.gamma or coded.chromaticities:
            return _plain(_of_numbers(coded.gamma, coded.chromaticities))
        return _plain(of_primaries("adobe-rgb"), (Curve(563 / 256),)) if coded.is_adobe else None
    except (ValueError, struct.error, KeyError, IndexError, np.linalg.LinAlgError):
        return Profile("its colour profile", followed=False)


def of_chromaticities(numbers) -> Profile | None:
    """What x and y of red, green, blue and white, as OpenEXR states them, say; None: that it is Rec.709."""
    try:
        return _plain(_of_numbers(None, tuple(float(n) for n in numbers)))
    except (ValueError, TypeError, np.linalg.LinAlgError):
        return Profile("its chromaticities", followed=False)


def xyz_of(red, green, blue, white) -> np.ndarray:
    """(3, 3) XYZ of the primaries of x and y, relative to white of Y = 1 that is adapted to D65 (Bradford)."""
    columns = np.stack([_xyz(*each) for each in (red, green, blue)], -1)
    if abs(np.linalg.det(columns)) < 1e-4:
        raise ValueError("the primaries lie on a line")
    return _adapted(white, D65) @ (columns * np.linalg.solve(columns, _xyz(*white)))


def _xyz(x: float, y: float) -> np.ndarray:
    """Of Y = 1; of an x and y that no colour has ValueError."""
    if not (np.isfinite([x, y]).all() and abs(x) <= 2 and 1e-5 < abs(y) <= 2):
        raise ValueError("no chromaticity")
    return np.array([x / y, 1.0, (1 - x - y) / y])


def _adapted(white, to) -> np.ndarray:
    """(3, 3): XYZ under one white to XYZ under another, both of x and y."""
    gain = (BRADFORD @ _xyz(*to)) / (BRADFORD @ _xyz(*white))
    if not (np.isfinite(gain).all() and gain.min() > 0.1 and gain.max() < 10):
        raise ValueError("no white")
    return np.linalg.inv(BRADFORD) @ (gain[:, None] * BRADFORD)


def _to_rec709(xyz) -> np.ndarray | None:
    """To Rec.709 from the XYZ under D65 of primaries, grey exactly kept; None: they are Rec.709."""
    matrix = np.linalg.solve(xyz_of(*PRIMARIES["rec709"]), xyz)
    white = matrix.sum(1)
    if not (np.isfinite(matrix).all() and np.abs(white - 1).max() < 0.5 and np.abs(matrix).max() < 20):
        raise ValueError("no primaries")
    matrix = matrix / white[:, None]
    if abs(np.linalg.det(matrix)) < 1e-3:
        raise ValueError("the primaries lie on a line")
    return None if np.abs(matrix - np.eye(3)).max() < ALIKE else matrix


def _plain(profile: Profile, curves=None) -> Profile | None:
    """A profile with a curve that is sRGB's left out; None where nothing is left."""
    curves = profile.curves if curves is None else curves
    for curve in curves:
        values = curve(_GRID)
        if not np.isfinite(values).all() or np.diff(values).min() < -1e-6 or abs(values[-1] - 1) > 0.05:
            raise ValueError("no curve")
    if all(np.abs(curve(_GRID) - SRGB(_GRID)).max() < ALIKE_CURVE for curve in curves):
        curves = ()
    plain = profile.to_rec709 is None and not curves
    return None if plain else Profile(profile.name, profile.to_rec709, curves)


def _named(matrix, otherwise: str) -> str:
    """The usual name of primaries, by their matrix to Rec.709."""
    for name, words in NAMES.items():
        known = _to_rec709(xyz_of(*PRIMARIES[name]))
        if matrix is not None and np.abs(matrix - known).max() < 3 * ALIKE:
            return words
    return otherwise


def _of_cicp(numbers: bytes) -> Profile | None:
    primaries, transfer = numbers[:2]
    if transfer in HDR:
        return Profile(f"an HDR display ({HDR[transfer]})", hdr=HDR[transfer])
    if primaries not in _CICP:
        raise ValueError("other primaries")
    curves = (Curve(_CICP_GAMMA[transfer]),) if transfer in _CICP_GAMMA else ()
    return _plain(of_primaries(_CICP[primaries]), curves)


def _of_numbers(gamma, chromaticities) -> Profile:
    """Of the exponent by which codes become light, and of x, y of red, green, blue and white; each may be missing."""
    matrix = None
    if chromaticities:
        x, y = chromaticities[::2], chromaticities[1::2]
        matrix = _to_rec709(xyz_of(*zip(x, y, strict=True)))
    if gamma is not None and not 0.2 < gamma < 5:
        raise ValueError("no exponent")
    sure = gamma is not None and abs(gamma - 2.2) > 0.1  # 2.2 is how sRGB is said in a number
    return Profile(_named(matrix, "the file's own primaries"), matrix, (Curve(gamma),) if sure else ())


def _of_icc(data: bytes) -> Profile:
    """Of the bytes of a profile. Raises ValueError, struct.error or IndexError where it is none that is followed."""
    if data[36:40] != b"acsp" or data[20:24] != b"XYZ ":
        raise ValueError("no profile of a matrix")
    (count,) = struct.unpack(">I", data[128:132])
    tags = {}
    for i in range(min(count, MOST_TAGS)):
        kind, at, length = struct.unpack(">4sII", data[132 + 12 * i : 144 + 12 * i])
        tags[kind] = data[at : at + length]
    if b"cicp" in tags and tags[b"cicp"][9] in HDR:
        return Profile(f"an HDR display ({HDR[tags[b'cicp'][9]]})", hdr=HDR[tags[b"cicp"][9]])
    if data[16:20] == b"GRAY":
        return Profile("a grey profile", curves=(_curve(tags[b"kTRC"]),))
    if data[16:20] != b"RGB " or b"rXYZ" not in tags:
        raise ValueError("no profile of a matrix")
    colorants = []
    for kind in (b"rXYZ", b"gXYZ", b"bXYZ"):
        colorants.append(np.array(struct.unpack(">3i", tags[kind][8:20])) / 65536)
    matrix = _to_rec709(_adapted(D50, D65) @ np.stack(colorants, -1))
    curves = tuple(_curve(tags[kind]) for kind in (b"rTRC", b"gTRC", b"bTRC"))
    return Profile(_named(matrix, "its colour profile"), matrix, curves)


def _curve(data: bytes) -> Curve:
    """Of a tag: a table, an exponent or a parametric function."""
    if data[:4] == b"curv":
        (count,) = struct.unpack(">I", data[8:12])
        if count == 0:
            return Curve()
        if count == 1:
            return Curve(_exponent(struct.unpack(">H", data[12:14])[0] / 256))
        if count > 65536:
            raise ValueError("a long table")
        return Curve(table=tuple(np.array(struct.unpack(f">{count}H", data[12 : 12 + 2 * count])) / 65535))
    if data[:4] != b"para":
        raise ValueError("no curve")
    (kind,) = struct.unpack(">H", data[8:10])
    count = {0: 1, 1: 3, 2: 4, 3: 5, 4: 7}.get(kind, 0)
    g, *p = (n / 65536 for n in struct.unpack(f">{count}i", data[12 : 12 + 4 * count]))
    g = _exponent(g)
    if kind == 0:
        return Curve(g)
    if kind in (1, 2):  # 0, or a constant, where a x + b is negative
        floor = p[2] if kind == 2 else 0.0
        return Curve(g, p[0], p[1], 0.0, -p[1] / p[0] if p[0] else 0.0, floor, floor)
    return Curve(g, *p)


def _exponent(g: float) -> float:
    if not 0.1 < g < 10:
        raise ValueError("no exponent")
    return g
