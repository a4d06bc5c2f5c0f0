# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands for the scene in the fit: photographs, points, materials, appearance, reflections; and its light."""

from dataclasses import dataclass, field, replace

import numpy as np

from btfsep_engine.btf.model import Material
from btfsep_engine.errors import InputError
from btfsep_engine.fit.stated import Fit
from btfsep_engine.pipeline.coarse_chroma import chroma_weights
from btfsep_engine.pipeline.like_pixels import as_seen_on_the_whole, like_pixels_words
from btfsep_engine.pipeline.points import chosen_points, names_of, photographed_regions
from btfsep_engine.pipeline.problem import Problem, make_problem
from btfsep_engine.pipeline.real_photo import as_real_photo, left_out_words, scale_words
from btfsep_engine.pipeline.refine import refined
from btfsep_engine.pipeline.refine.order import cross_validated_order, reported_order
from btfsep_engine.pipeline.refine.texture import reason_against, textures
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import LARGEST_ORDER, Settings
from btfsep_engine.pipeline.together import fit_together, stacked
from btfsep_engine.pipeline.tone import with_curves

LEAKS = 1e-3  # of the pixels: a ray in a million slips through a closed mesh, between two triangles


@dataclass(frozen=True)
class Model:
    """What is known of the scene, without its light.

    Attributes
    ----------
    settings : as asked for: order, appearance and bounces may be "auto"
    looks : appearance ("mean" or "textured") -> Problem of each photograph; those that were made
    appearance : the one that is fitted
    bounces : reflections in the basis images
    materials : for each photograph the ObjectMaterial of each object
    untried : why textures are not tried beside the mean ABRDFs, in words; None where they are
    otherwise : (Fit, probability) of lights that the photo may show as well (`refine.parted`)
    highlights : whether the photo shows some that neither the materials nor smooth light explain (`refine.in_front`)
    shaded : a SolvedLight of these problems, and what was found beside it of lamps that some pixels do not see
        (`refine.parted.with_shadows_sought`); None: none were sought
    departed : number of an object -> the Material near its own that stands for it (`refine.reflectance`)
    dust : number of an object -> its colour, that of the dust on it, and the share that it covers (`refine.dusty`)
    """

    settings: Settings
    looks: dict
    appearance: str = "mean"
    bounces: int = 1
    materials: tuple = ()
    untried: str | None = "as asked for"
    departed: dict = field(default_factory=dict)
    dust: dict = field(default_factory=dict)
    otherwise: tuple = ()
    highlights: bool = False
    shaded: tuple | None = None

    @property
    def problems(self) -> list[Problem]:
        """Of each photograph, as fitted."""
        return self.looks[self.appearance]

    @property
    def all_mirror(self) -> bool:
        """Whether all objects mirror: their pictures were put together, and have neither paint nor others' shadows."""
        return bool(self.materials) and all(m.mirror is not None for each in self.materials for m in each)

    @property
    def reporter(self):
        """That of the first scene."""
        return self.problems[0].scene.reporter

    @property
    def modelled(self) -> Settings:
        """The settings with what is modelled where "auto" was asked for; the order stays."""
        return replace(self.settings, appearance=self.appearance, bounces=self.bounces)

    def changed(self, change, *of_each) -> "Model":
        """The same with ``change`` (Problem, its part of each of ``of_each``) -> Problem of every problem."""
        looks = {k: [change(*each) for each in zip(v, *of_each, strict=True)] for k, v in self.looks.items()}
        return replace(self, looks=looks)


def stand_ins(materials: list[Material], appearance: str) -> list[Material]:
    """What stands for materials in the fit: the BTF itself (always where it lines up), or its mean ABRDF."""
    return [m if appearance == "textured" or m.lines_up else m.mean_material() for m in materials]


def view_problem(scene: PreparedScene, materials: list[Material], settings: Settings) -> Problem:
    """What any photo of a view is fitted with, whatever it shows; ``materials`` : of each object."""
    textured = settings.appearance == "textured"
    points = chosen_points(scene, settings, regions=scene.regions, textured=textured)
    return make_problem(scene, stand_ins(materials, settings.appearance), points, settings)


def first_model(scenes: list[PreparedScene], materials, settings: Settings) -> Model:
    """The simplest model of photographs: mean ABRDFs and light that comes straight, unless the settings ask for more.

    With a prior, unknown tone curves (`pipeline.tone`), clipped channels and the scales of recognised objects
    (`pipeline.real_photo`) are settled here.

    Raises
    ------
    InputError
        Where no pixel of a photograph is usable, or no light gets to one.
    """
    untried = reason_against(scenes, materials, settings)
    appearance = "textured" if settings.appearance == "textured" else "mean"
    # path tracing has interreflections for nothing; the kernel looks first whether they are needed
    straight = settings.bounces == "auto" and settings.transport == "kernel"
    model = Model(settings, {}, appearance, 1 if straight else settings.reflections, materials, untried)
    textured, points = untried is None or appearance == "textured", []
    for scene in scenes:
        regions = photographed_regions(scene, settings)
        points.append(chosen_points(scene, settings, regions=regions, textured=textured))
        if not any(len(p) for p in points[-1]):
            raise InputError(
                names_of(scene),
                "every pixel that shows it is saturated or transparent",
                "give a photo with a shorter exposure, or one that is opaque where the object is",
            )
    shown = [stand_ins([m.material for m in each], appearance) for each in materials]
    problems = [make_problem(*each, model.modelled) for each in zip(scenes, shown, points, strict=True)]
    for problem in problems:
        if np.mean([basis[:, 0].any(1).mean() for basis in problem.basis if len(basis)]) <= LEAKS:
            raise InputError(
                names_of(problem.scene),
                "it reflects no light from outside towards the camera",
                "check that the camera is not inside closed geometry, and that the material is not black",
            )
    if settings.estimator == "map":
        problems = with_curves([replace(p, weights=chroma_weights(p)) for p in problems], settings)
        if appearance == "mean":  # the texture is in no basis images
            problems = [as_seen_on_the_whole(p, settings) for p in problems]
        recognised = [[not m.is_given for m in each] for each in materials]
        problems = [as_real_photo(p, settings, recognised=r) for p, r in zip(problems, recognised, strict=True)]
    looks = {appearance: problems}
    if untried is None:
        how = replace(model.modelled, appearance="textured")
        of_btfs = [stand_ins([m.material for m in each], "textured") for each in materials]
        alone = [p.of_single_pixels() for p in problems]  # the texture is in its basis images
        looks["textured"] = [p.of_materials(each, how) for p, each in zip(alone, of_btfs, strict=True)]
    return replace(model, looks=looks)


def solve_model(model: Model, *, beside: Fit | None = None):
    """The light of a model, of the appearance and the order that are asked for, or with "auto" of those that suit.

    ``beside`` : as of `fit_together`

    Returns
    -------
    Model with the appearance that was chosen, SolvedLight, and what was chosen: {what: why in words}
    """
    settings, problems = model.settings, model.problems
    choice = {"scale": scale_words(problems)}
    if settings.robust:
        choice["robust"] = left_out_words(problems)
    with model.reporter.stage("fit"):
        if settings.order == "auto":
            settings = replace(settings, order=LARGEST_ORDER)
            if settings.estimator == "least-squares":
                basis, blocks = stacked(problems)
                b = np.concatenate([p.radiance() for p in problems])
                order, choice["order"] = cross_validated_order(basis, b, blocks, LARGEST_ORDER, seed=settings.seed)
                settings = replace(settings, order=order)
        light = fit_together(problems, settings, beside=beside)
        model, light, choice = refined(model, light, choice, (textures, reported_order))
    if words := like_pixels_words(model.problems):
        choice["pixels"] = words
    return model, light, choice
