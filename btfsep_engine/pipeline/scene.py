# SPDX-License-Identifier: GPL-3.0-or-later
"""A job ready for transport: its rays' scene, what the camera sees, and the pixels of each object."""

import copy
from dataclasses import replace
from functools import cached_property

import numpy as np

from btfsep_engine.job.load import load_job
from btfsep_engine.job.model import Job
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.light.sun import Sun
from btfsep_engine.pipeline.settings import TransportSettings
from btfsep_engine.render.beams import beam_radiance, lamp_radiance
from btfsep_engine.render.homogeneous import reflected_share
from btfsep_engine.render.outlines import Outlines, outlines
from btfsep_engine.render.radiosity import MOST, Indirect, diffuse_albedo
from btfsep_engine.render.sampling import REGION, thinned
from btfsep_engine.render.surface import (
    SurfacePoints,
    View,
    camera_view,
    object_region,
    surface_points,
    with_any_tangent,
    with_texture,
)
from btfsep_engine.render.tracer import Tracer, tracer_of
from btfsep_engine.render.transport import Transport
from btfsep_engine.storage import kept

INDIRECT_DIRECTIONS = 128  # light from other surfaces is smooth
SUN_DIRECTIONS = 12  # over a sun's disc
GREY, BRIGHTEST = 0.3, 0.8  # what things reflect as a rule, and at most but for white
MIRRORED = 9  # order of the series as which a mirror shows a sun: a ray never hits it


def unseen_meshes(job: Job) -> list:
    """(number of the object, mesh) of what closes surfaces that were made from a depth."""
    return [(i, o.unseen) for i, o in enumerate(job.objects) if o.unseen is not None]


def _tracer_of(job: Job) -> Tracer:
    beside = [*(o.mesh for o in job.occluders), *(mesh for _, mesh in unseen_meshes(job))]
    first = len(job.objects)
    return tracer_of([*(o.mesh for o in job.objects), *beside], range(first, first + len(job.occluders)))


class PreparedScene:
    """A job's geometry in the ray tracer and the pixels that show each object.

    Parameters
    ----------
    job : Job
    reporter : progress.Reporter

    Raises
    ------
    InputError
        When the camera does not see one of the objects.
    """

    def __init__(self, job: Job, reporter):
        self.job, self.reporter = job, reporter
        self.curves = None  # tone.Curves, where the photo's was unknown and is chosen
        self.tones = None  # how far tones that a phone moved place by place are undone (phone.py); None: not asked
        self.greys = None  # surroundings.Greys, where occluders were of an unknown grey and it is chosen
        self.mirrors = ()  # mirrors.Mirror, of objects whose pictures in the photo are a rougher metal's
        self.mirror_lights = ()  # mirrors.MirrorLight, by these pictures
        self.mended_by = None  # alignment.Alignment, where the camera is not the job's
        self.in_place = False  # whether the photo's own edges say that the camera is
        self.colours = {}  # number of an occluder -> (3,), as the photo shows it and the job does not, or not so
        self.has_colours = True  # whether the photo has any, and all that is in it (`black_and_white`)
        self.grey = GREY  # what occluders reflect of which the job does not say it
        with reporter.stage("geometry"):
            self.tracer = _tracer_of(job)
            self.look()

    def look(self) -> None:
        """Finds what the job's camera sees: `view`, `regions`, and `seen`, what these depend on (`kept.content`).

        Raises InputError where it does not see one of the objects.
        """
        job = self.job
        self.seen = kept.content([self.tracer.key, job.camera, [o.mask for o in job.objects]])

        def looked():
            view = camera_view(self.tracer, job)
            return view, [object_region(view, job, i) for i in range(len(job.objects))]

        self.view, self.regions = kept.recalled("view", self.seen, looked)

    def with_occluder(self, occluder, view: View, *, met: bool = True) -> "PreparedScene":
        """The same scene with one occluder more, which hides nothing of the objects from the camera.

        ``view`` : what the camera sees then; ``met`` : whether rays meet it, too, which those from the camera need not
        """
        out = copy.copy(self)
        vars(out).pop("_known_albedos", None)
        out.job, out.view = replace(self.job, occluders=(*self.job.occluders, occluder)), view
        if met:
            out.tracer = _tracer_of(out.job)
        out.seen = kept.content([self.seen, out.tracer.key, view.mesh])
        return out

    def as_in_job(self) -> "PreparedScene":
        """The same scene without what only the photo shows of its surroundings (`with_occluder`)."""
        own = tuple(o for o in self.job.occluders if not o.supposed)
        if len(own) == len(self.job.occluders):
            return self
        out = copy.copy(self)
        vars(out).pop("_known_albedos", None)
        out.job = replace(self.job, occluders=own)
        out.tracer = _tracer_of(out.job)
        out.look()
        return out

    @property
    def outlines(self) -> Outlines:
        """Where surfaces end in the picture."""
        return kept.recalled("outlines", self.seen, lambda: outlines(self.view, self.job))

    @property
    def shows_objects(self) -> np.ndarray:
        """(h, w) bool, the pixels that show an object, or what closes the holes of its depth."""
        first, beside = len(self.job.objects), len(self.job.occluders)
        return (self.view.mesh >= 0) & ((self.view.mesh < first) | (self.view.mesh >= first + beside))

    @property
    def has_unknown(self) -> bool:
        """Whether there is an occluder of which the job does not say what it is made of."""
        return any(o.surface is None and k not in self.colours for k, o in enumerate(self.job.occluders))

    def with_grey(self, albedo: float) -> "PreparedScene":
        """The same scene with such occluders of this grey."""
        out = copy.copy(self)
        out.grey = albedo
        return out

    def with_colours(self, colours: dict) -> "PreparedScene":
        """The same scene with occluders of these colours, {number: (3,)}."""
        out = copy.copy(self)
        out.colours = {**self.colours, **colours}
        return out

    @cached_property
    def _known_albedos(self) -> list:
        return [None if o.surface is None else np.clip(reflected_share(o.surface), 0, MOST) for o in self.job.occluders]

    @property
    def occluder_albedos(self) -> list:
        """Of each occluder (3,), or (n, n, 3) by its UVs: what it reflects of light from all sides."""
        known = [np.full(3, self.grey) if a is None else a for a in self._known_albedos]
        return [self.colours.get(k, a) for k, a in enumerate(known)]

    @property
    def millimetres_per_unit(self) -> float:
        """Millimetres in one world unit of the job."""
        return 1000 * self.job.metres_per_unit

    def at_most(self, side: int) -> "PreparedScene":
        """The same scene as a smaller camera sees it, no edge of its picture above ``side`` pixels; traces nothing.

        Each of its pixels shows the surface in the middle of a block of pixels, and the photo's mean over the block.
        """
        camera, photo = self.job.camera, self.job.photo
        edge = -(-max(camera.width, camera.height) // side)
        if edge < 2:
            return self
        w, h = camera.width // edge, camera.height // edge  # what is left at the right and below is cut off
        if not w or not h:
            return self
        rows, columns = edge // 2 + edge * np.arange(h), edge // 2 + edge * np.arange(w)
        place = np.ix_(rows, columns)

        def blocks(image):
            return image[: h * edge, : w * edge].reshape(h, edge, w, edge, *image.shape[2:])

        out = copy.copy(self)
        out.seen = kept.content([self.seen, edge])
        out.view = View(**{name: image[place] for name, image in vars(self.view).items()})
        out.regions = [region[place] for region in self.regions]
        out.job = replace(
            self.job,
            camera=replace(
                camera,
                width=w,
                height=h,
                fx=camera.fx / edge,
                fy=camera.fy / edge,
                cx=(camera.cx - edge // 2 - 0.5) / edge + 0.5,
                cy=(camera.cy - edge // 2 - 0.5) / edge + 0.5,
            ),
            photo=replace(
                photo,
                radiance=blocks(photo.radiance).mean((1, 3)),
                usable=blocks(photo.usable).all((1, 3)),
                clipped=None if photo.clipped is None else blocks(photo.clipped).any((1, 3)),
            ),
            objects=tuple(replace(o, mask=None if o.mask is None else o.mask[place]) for o in self.job.objects),
        )
        return out

    def points(self, index: int, *, region=None, textured: bool) -> SurfacePoints:
        """Surface points of an object, ready for `Transport`; all of its region unless one is given."""
        return self.laid(self.bare_points(index, region=region), index, textured=textured)

    def bare_points(self, index: int, *, region=None) -> SurfacePoints:
        """The same without tangents."""
        region = self.regions[index] if region is None else region
        return surface_points(self.view, self.job, index, region=region)

    def footprint(self, index: int) -> float:
        """Edge in world units of what a pixel shows of an object, as a rule."""

        def usual() -> float:
            return float(np.median(self.bare_points(index, region=thinned(self.regions[index], REGION)).footprint))

        return kept.recalled("footprint", [self.seen, index], usual)

    def laid(self, points: SurfacePoints, index: int, *, textured: bool) -> SurfacePoints:
        """Points with tangents, and with the places of a texture where one is wanted or known."""
        if textured or self.job.objects[index].pictured:
            return with_texture(points, self.job, index, reporter=self.reporter)
        return with_any_tangent(points)

    def transport(self, points: SurfacePoints, *, directions: int) -> Transport:
        """The kernel for these points."""
        return Transport(self.tracer, points, directions=directions, millimetres_per_unit=self.millimetres_per_unit)

    def indirect(self, materials, lightings, settings: TransportSettings, *, bounces: int) -> Indirect | None:
        """Light between surfaces, or None where one bounce is all that is asked for.

        The samples and their seed are the settings', so that one network serves all of an estimate. ``materials`` has
        one Material (or None, unknown: black) per object, its unseen side included.
        """
        if bounces < 2:
            return None
        black = np.zeros(3)
        albedos = [black if m is None else diffuse_albedo(m) for m in materials]
        unseen = [albedos[i] for i, _ in unseen_meshes(self.job)]
        albedos += [*self.occluder_albedos, *unseen]
        samples, seed = settings.surface_samples, settings.seed
        return Indirect(self.tracer, albedos, lightings, bounces=bounces - 1, samples=samples, seed=seed)

    def radiance(self, points: SurfacePoints, material, lightings, *, directions: int, indirect=None) -> np.ndarray:
        """Radiance (p, M, 3) float32 of points, interreflections included where ``indirect`` is given."""
        out = self.transport(points, directions=directions).radiance(material, lightings)
        if indirect is None:
            return out
        return out + indirect.reflected(self.transport(points, directions=INDIRECT_DIRECTIONS), material)

    def received(self, index: int, points: SurfacePoints, material, indirect: Indirect) -> np.ndarray:
        """Radiance (p, M, 3) or (p, 1, 3) float32 of points of an object by what surfaces send each other.

        None of an object whose picture was put together of what it mirrors of the sky.
        """
        if any(mirror.index == index for mirror in self.mirrors):
            return np.zeros((len(points), 1, 3), np.float32)
        return indirect.reflected(self.transport(points, directions=INDIRECT_DIRECTIONS), material)

    def sun_radiance(self, points: SurfacePoints, material, *suns: Sun) -> np.ndarray:
        """Radiance (p, 3) float32 of points under suns alone, with their own shadows, without interreflections."""
        if material.mirror_reflectance is not None:
            light = SHLighting(sum((sun.coefficients(MIRRORED) for sun in suns), np.zeros(((MIRRORED + 1) ** 2, 3))))
            return self.radiance(points, material, light, directions=INDIRECT_DIRECTIONS)[:, 0]
        out = np.zeros((len(points), 3), np.float32)
        for sun in (sun for sun in suns if sun.near):
            towards = sun.directions(SUN_DIRECTIONS)
            for place in sun.near.centre + sun.near.distance * towards:
                falloff = np.square(sun.near.distance / np.linalg.norm(place - points.position, axis=1))
                unit = self.millimetres_per_unit
                seen = lamp_radiance(self.tracer, points, material, place, millimetres_per_unit=unit)
                out += seen * (falloff[:, None] * sun.irradiance / len(towards)).astype(np.float32)
        suns = [sun for sun in suns if not sun.near]
        beams = [sun.directions(SUN_DIRECTIONS) for sun in suns]
        strength = [np.tile(sun.irradiance / len(each), (len(each), 1)) for sun, each in zip(suns, beams, strict=True)]
        per_beam = beam_radiance(
            self.tracer,
            points,
            material,
            np.concatenate([*beams, np.zeros((0, 3))]),
            millimetres_per_unit=self.millimetres_per_unit,
        )
        return out + np.einsum("pnc,nc->pc", per_beam, np.concatenate([*strength, np.zeros((0, 3))]).astype(np.float32))

    def usable(self, points: SurfacePoints) -> np.ndarray:
        """Which points' pixels are not saturated: (p,) bool."""
        return self.job.photo.usable[points.pixels[:, 0], points.pixels[:, 1]]


def read_scene(folder, reporter) -> PreparedScene:
    """A job folder, ready for transport; what speaks against it is said. Raises InputError where it cannot be read."""
    with reporter.stage("reading"):
        job = load_job(folder)
        for note in job.warnings:
            reporter.warn(note)
    return PreparedScene(job, reporter)
