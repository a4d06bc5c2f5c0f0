# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials that nobody has to recognise: those that are named, and those that a job gives by numbers."""

from btfsep_engine.btf.model import Material
from btfsep_engine.btf.surfaces import GIVEN
from btfsep_engine.job.model import Job, JobObject
from btfsep_engine.pipeline.settings import TransportSettings
from btfsep_engine.render.homogeneous import homogeneous, pictured


def given_materials(job: Job, library, settings: TransportSettings, *, names) -> list[Material | None]:
    """For every object the material named; where ``names`` has None the one of its surface, or None without one.

    Raises
    ------
    InputError
        A name that the library does not have; an image on UVs without area.
    """
    return [
        library.load(name) if name is not None else o.surface and of_surface(o, job, settings)
        for o, name in zip(job.objects, names, strict=True)
    ]


def of_surface(obj: JobObject, job: Job, settings: TransportSettings) -> Material:
    """What the numbers of an object's surface make; of an image its mean where ``settings`` ask for mean ABRDFs."""
    if not obj.pictured:
        return homogeneous(obj.surface, GIVEN)
    material = pictured(obj.surface, GIVEN, obj.mesh, millimetres_per_unit=1000 * job.metres_per_unit)
    return material.mean_material() if settings.appearance == "mean" else material
