# SPDX-License-Identifier: GPL-3.0-or-later
"""A job in memory: plain data that every later stage reads and none changes."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.imaging.colour_profile import Profile
from btfsep_engine.job.camera import Camera


@dataclass(frozen=True)
class TriangleMesh:
    """Triangles in world space.

    Attributes
    ----------
    vertices : (v, 3) float64, world units
    faces : (f, 3) int32
    corner_normals : (f, 3, 3) float32, unit, the shading normals at the corners
    corner_uv : (f, 3, 2) float32, or None where the file has none
    """

    vertices: np.ndarray
    faces: np.ndarray
    corner_normals: np.ndarray
    corner_uv: np.ndarray | None = None


@dataclass(frozen=True)
class JobObject:
    """One object to fit. ``mask`` is (h, w) bool or None (all that the camera sees of it).

    ``unseen`` closes a surface that was made from a depth (`depth.closing_mesh`); None: the mesh is all there is.
    ``surface`` : what it is made of, by numbers, or None. One with an image has a mesh with ``corner_uv``, and ``uv``
    "mesh".
    """

    name: str
    mesh: TriangleMesh
    mask: np.ndarray | None = None
    material: str | None = None
    uv: str = "xatlas"
    unseen: TriangleMesh | None = None
    surface: Surface | None = None

    @property
    def pictured(self) -> bool:
        """Whether an image says the base colours of its surface."""
        return self.surface is not None and self.surface.image is not None


@dataclass(frozen=True)
class Occluder:
    """Geometry that casts shadows and reflects light and is not fitted.

    ``surface`` : what it is made of, by numbers (one with an image has a mesh with ``corner_uv``), or None: not known.
    ``evidence`` : whether its own pixels tell of the light. ``name`` : for people; empty: it has none.
    ``supposed`` : of one that the job has not, and only the photo shows (`pipeline.standing`), how far from its middle
    the photo is believed to show it, world units; 0: the job has it.
    """

    mesh: TriangleMesh
    surface: Surface | None = None
    evidence: bool = False
    name: str = ""
    supposed: float = 0.0


@dataclass(frozen=True)
class KnownLamp:
    """A lamp far away: its direction, (3,) float64, unit, world, to it, and the standard deviation of that, degrees."""

    direction: np.ndarray
    degrees: float


@dataclass(frozen=True)
class Photo:
    """The photograph.

    Attributes
    ----------
    radiance : (h, w, 3) float32, linear Rec.709, finite, in the image's own scale (``exposure_ev`` is not applied)
    usable : (h, w) bool, false where a channel is saturated or the pixel is not opaque
    saturated : number of saturated pixels
    clipped : (h, w, 3) bool, channels of opaque pixels that were at least as bright as stored; None: none were
    bits : of the file's codes, 8 or 16; None: floats
    coarse_chroma : whether the file has colours at less resolution than brightness
    camera : maker and model of the camera that the file says it is from; empty: it says none
    profile : what its colours were taken to mean; None: what files of its kind mean, of Rec.709's primaries
    is_render : whether the file says that Blender rendered it
    is_jpeg : whether it is a JPEG
    flash : whether the file says that a flash fired; None: it says nothing
    """

    radiance: np.ndarray
    usable: np.ndarray
    saturated: int
    clipped: np.ndarray | None = None
    bits: int | None = None
    coarse_chroma: bool = False
    camera: str = ""
    profile: Profile | None = None
    is_render: bool = False
    is_jpeg: bool = False
    flash: bool | None = None


@dataclass(frozen=True)
class Job:
    """A validated job. ``digest`` is a hash of everything read; ``folder`` is where it came from.

    ``warnings`` says in words what was left out while reading; ``image_colorspace`` is one of
    `images.COLORSPACES`, or "unknown" (the photo is then read as by "auto"), "phone" (as by "camera") or "blender" (as
    by "srgb");
    ``image_primaries`` as of `images.read_linear`.
    """

    folder: Path
    photo: Photo
    camera: Camera
    objects: tuple[JobObject, ...]
    occluders: tuple[Occluder, ...]
    metres_per_unit: float
    exposure_ev: float
    digest: str
    warnings: tuple[str, ...] = ()
    image_colorspace: str = "auto"
    image_primaries: str = "auto"
    known_lamps: tuple[KnownLamp, ...] = ()
