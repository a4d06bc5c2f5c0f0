# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects whose surface is given by numbers, taken for another surface: on a few pixels, to look, and on all."""

from dataclasses import replace

from btfsep_engine.btf.surfaces import GIVEN, Surface
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.pipeline.materials import of_surface
from btfsep_engine.pipeline.model import stand_ins
from btfsep_engine.pipeline.refine.reflectance import FEW, fewer, field_alone, with_material
from btfsep_engine.pipeline.together import fit_together


def asked_of(model, light) -> list[int]:
    """Numbers of the objects whose surfaces may be others than their numbers say, the largest in the picture first."""
    by_kernel = model.problems[0].transport["by"] == "kernel"
    if light.solver is None or model.settings.departures == "never" or not by_kernel:
        return []
    given = [i for i in range(len(model.materials[0])) if is_given(model, i)]
    return sorted(given, key=lambda i: -len(model.problems[0].points[i]))


def is_given(model, i: int) -> bool:
    """Whether an object is what the numbers of its surface make, one roughness all over, and no mirror's stand-in."""
    surface, materials = model.problems[0].scene.job.objects[i].surface, [each[i] for each in model.materials]
    if surface is None or surface.finish is not None:
        return False
    return all(m.is_given and m.name == GIVEN and m.mirror is None for m in materials)


def surface_of(model, i: int) -> Surface:
    """What an object's surface is taken to be by now."""
    return model.materials[0][i].surface or model.problems[0].scene.job.objects[i].surface


def material_of(model, i: int, surface: Surface):
    """What stands for an object with another surface."""
    scene = model.problems[0].scene
    made = of_surface(replace(scene.job.objects[i], surface=surface), scene.job, model.settings)
    return stand_ins([made], model.appearance)[0]


def gains_on_a_few(model, light, i: int):
    """A function Surface -> how much more of the logarithm of the evidence a few of the pixels, under a field alone,
    have with it."""
    settings = replace(model.modelled, order=light.order)
    few = fewer(model.problems, FEW, settings.seed)
    start = field_alone(few, light, settings)

    def gain(surface: Surface) -> float:
        trial = [relit(p, i, material_of(model, i, surface), settings) for p in few]
        return field_alone(trial, light, settings, start=start).evidence - start.evidence

    return gain


def relit(problem, i: int, material, settings):
    """A problem with another material for an object, light between surfaces as it was."""
    points, was, lights = problem.points[i], problem.materials[i], SHBasis(settings.fit_order)
    how = {"directions": problem.transport["directions"]}
    straight, before = (problem.scene.radiance(points, m, lights, **how) for m in (material, was))
    basis = [b + (straight - before) if j == i else b for j, b in enumerate(problem.basis)]
    return problem.made_of([material if j == i else m for j, m in enumerate(problem.materials)], basis)


def on_all(model, light, i: int, surface: Surface):
    """The model with another surface for an object, and its light."""
    material, settings = material_of(model, i, surface), replace(model.modelled, order=light.order)
    problems = with_material(model.problems, i, material, settings)
    answer = fit_together(problems, settings, beside=light.fit)
    materials = tuple([replace(m, surface=surface) if j == i else m for j, m in enumerate(e)] for e in model.materials)
    departed = model.departed | {i: material}
    return replace(model, looks={model.appearance: problems}, materials=materials, departed=departed), answer
