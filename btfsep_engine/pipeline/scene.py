# SPDX-License-Identifier: GPL-3.0-or-later
"""A job ready for transport: its rays' scene, what the camera sees, and the pixels of each object."""

import numpy as np

from btfsep_engine.job.model import Job
from btfsep_engine.light.point_lights import DirectionalLights, PointLights
from btfsep_engine.render.point_transport import point_radiance
from btfsep_engine.render.radiosity import Indirect, diffuse_albedo
from btfsep_engine.render.surface import (
    SurfacePoints,
    camera_view,
    object_region,
    surface_points,
    with_any_tangent,
    with_texture,
)
from btfsep_engine.render.tracer import Tracer
from btfsep_engine.render.transport import Transport

INDIRECT_DIRECTIONS = 128  # light from other surfaces is smooth


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
        with reporter.stage("geometry"):
            self.tracer = Tracer([*(o.mesh for o in job.objects), *job.occluders])
            self.view = camera_view(self.tracer, job)
            self.regions = [object_region(self.view, job, i) for i in range(len(job.objects))]

    @property
    def millimetres_per_unit(self) -> float:
        """Millimetres in one world unit of the job."""
        return 1000 * self.job.metres_per_unit

    def points(self, index: int, *, region=None, textured: bool) -> SurfacePoints:
        """Surface points of an object, ready for `Transport`; all of its region unless one is given."""
        region = self.regions[index] if region is None else region
        points = surface_points(self.view, self.job, index, region=region)
        return with_texture(points, self.job, index, reporter=self.reporter) if textured else with_any_tangent(points)

    def transport(self, points: SurfacePoints, *, directions: int) -> Transport:
        """The kernel for these points."""
        return Transport(self.tracer, points, directions=directions, millimetres_per_unit=self.millimetres_per_unit)

    def indirect(self, materials, lightings, *, bounces: int, seed: int = 0) -> Indirect | None:
        """Light between surfaces, or None where one bounce is all that is asked for.

        ``materials`` has one Material (or None, unknown: black) per object; occluders are black.
        """
        if bounces < 2:
            return None
        black = np.zeros(3)
        albedos = [black if m is None else diffuse_albedo(m) for m in materials] + [black] * len(self.job.occluders)
        return Indirect(self.tracer, albedos, lightings, bounces=bounces - 1, seed=seed)

    def radiance(self, points: SurfacePoints, material, lightings, *, directions: int, indirect=None) -> np.ndarray:
        """Radiance (p, M, 3) float32 of points, interreflections included where ``indirect`` is given."""
        if isinstance(lightings, PointLights | DirectionalLights):  # without interreflections
            return point_radiance(
                self.tracer, points, material, lightings, millimetres_per_unit=self.millimetres_per_unit
            )
        out = self.transport(points, directions=directions).radiance(material, lightings)
        if indirect is not None:
            out += indirect.reflected(self.transport(points, directions=INDIRECT_DIRECTIONS), material)
        return out

    def photo_at(self, points: SurfacePoints) -> np.ndarray:
        """The photograph's radiance (p, 3) float32 at the points' pixels."""
        return self.job.photo.radiance[points.pixels[:, 0], points.pixels[:, 1]]

    def usable(self, points: SurfacePoints) -> np.ndarray:
        """Which points' pixels are not saturated: (p,) bool."""
        return self.job.photo.usable[points.pixels[:, 0], points.pixels[:, 1]]
