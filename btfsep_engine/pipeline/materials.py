# SPDX-License-Identifier: GPL-3.0-or-later
"""What each object is made of: the material that is named, or given by numbers, or as recognised."""

from dataclasses import dataclass

from btfsep_engine.btf.model import Material
from btfsep_engine.btf.surfaces import GIVEN, Surface
from btfsep_engine.job.model import Job, JobObject
from btfsep_engine.pipeline.delighting import de_lit
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import Settings, TransportSettings
from btfsep_engine.render.homogeneous import homogeneous, pictured

# Of how strange a photo is, over that of the strangest of twenty (`judgement.Judged`): of five in six that are rightly
# recognised less; of two in 50 of textures that the library has not.
STRANGE = 0.3


@dataclass(frozen=True)
class ObjectMaterial:
    """The material an object is taken to have, and why.

    Attributes
    ----------
    likely : as of `recogniser.Recognition`
    mirror : the Surface by which it mirrors, where ``material`` is a rougher metal in its place (`pipeline.mirrors`)
    surface : the Surface that it was found to have (`refine.finish`); None: that was not sought, or none explains more
    """

    name: str
    material: Material
    is_given: bool
    candidates: tuple = ()
    unknown: bool = False
    unknown_score: float | None = None
    likely: tuple[str, ...] | None = None
    mirror: Surface | None = None
    surface: Surface | None = None

    @property
    def looks_alike(self) -> bool:
        """Whether it was recognised, and is stranger than the library's own are as a rule: it may be something else."""
        return not self.is_given and (self.unknown or (self.unknown_score or 0.0) > STRANGE)

    @property
    def record(self) -> dict:
        """For JSON."""
        return {
            "material": self.name,
            "class": self.material.material_class,
            "recognised": not self.is_given,
            "unknown": self.unknown,
            "unknown_score": self.unknown_score,
            "likely": self.likely,
            "candidates": [{"name": name, "score": score} for name, score in self.candidates],
            **({"surface": self.surface.numbers()} if self.surface else {}),
        }


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
    """What the numbers of an object's surface make; of an image its mean where ``settings`` ask for mean ABRDFs.

    The light that is found in an image is taken off (`delighting`).
    """
    if not obj.pictured:
        return homogeneous(obj.surface, GIVEN)
    material = pictured(de_lit(obj, settings), GIVEN, obj.mesh, millimetres_per_unit=1000 * job.metres_per_unit)
    return material.mean_material() if settings.appearance == "mean" else material


def object_materials(scene: PreparedScene, library, settings: Settings, *, names) -> list[ObjectMaterial]:
    """The material of every object: the one named, or where ``names`` has None, of its surface, or as recognised."""
    materials = []  # those that are given first: a wrong name must not cost a training
    for index, known in enumerate(given_materials(scene.job, library, settings, names=names)):
        if known is not None:
            materials.append(ObjectMaterial(known.name, known, True))
            continue
        from btfsep_engine.pipeline.recognition import recognise_object  # takes a tenth of a second to import

        answer = recognise_object(scene, index, library, settings)
        doubt = answer.candidates, answer.unknown, answer.unknown_score, answer.likely
        name = answer.stand_in or answer.material
        materials.append(ObjectMaterial(name, library.load(name), False, *doubt))
    return materials


def materials_of_all(scenes, library, settings: Settings, *, name: str | None) -> list[list[ObjectMaterial]]:
    """The materials of every photograph's objects; an object has the same in all of them.

    ``name`` : of the material of all objects, or None
    """
    out, known = [], {}
    for scene in scenes:
        names = [name or o.material or (None if o.surface else known.get(o.name)) for o in scene.job.objects]
        out.append(object_materials(scene, library, settings, names=names))
        if not known:
            known = {o.name: m.name for o, m in zip(scene.job.objects, out[0], strict=True)}
    return out


def changed_materials(scenes, before, after) -> list[str]:
    """Where the photo's own curve showed another material than sRGB, which recognition begins with, in words."""
    found = [
        (o.name, old.name, new.name)
        for scene, olds, news in zip(scenes, before, after, strict=True)
        for o, old, new in zip(scene.job.objects, olds, news, strict=True)
    ]
    return [
        f"object '{name}' was recognised as {new} with the photo read by the tone curve that was found; read as sRGB, "
        f"it looked like {old}; state the curve or the material, if you know one of them"
        for name, old, new in dict.fromkeys(found)
        if old != new
    ]
