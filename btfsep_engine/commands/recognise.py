# SPDX-License-Identifier: GPL-3.0-or-later
"""`btfsep recognise` and `btfsep train`: the materials of a job's objects, and their recognisers."""

from btfsep_engine.commands.record import run_record
from btfsep_engine.pipeline.black_and_white import as_photographed
from btfsep_engine.pipeline.materials import object_materials
from btfsep_engine.pipeline.recognition import trained_recogniser
from btfsep_engine.pipeline.scene import read_scene
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.pipeline.tone import curve_read_by, sought


def run_train(folder, library, settings: Settings, *, reporter) -> dict:
    """Trains (or finds in the cache) the recogniser of every object."""
    (scene,), library = as_photographed([read_scene(folder, reporter)], library)
    objects = []
    for index, obj in enumerate(scene.job.objects):
        recogniser = trained_recogniser(scene, index, library, settings)
        objects.append(
            {
                "name": obj.name,
                "materials": len(recogniser.materials),
                "held_out_accuracy": recogniser.model.held_out_accuracy,
            }
        )
    return {"objects": objects, **run_record(settings, reporter)}


def run_recognise(folder, library, settings: Settings, *, reporter) -> dict:
    """Recognises the material of every object, also of those whose material the job names."""
    scene = read_scene(folder, reporter)
    if sought(scene.job):
        reporter.warn(
            f"the photo's tone curve is unknown: it was read as {curve_read_by(scene.job).description}; an estimate "
            "finds it, and recognises by it"
        )
    (scene,), library = as_photographed([scene], library)
    found = object_materials(scene, library, settings, names=[None] * len(scene.job.objects))
    objects = [{"name": o.name, **m.record} for o, m in zip(scene.job.objects, found, strict=True)]
    return {"objects": objects, **run_record(settings, reporter)}
