# SPDX-License-Identifier: GPL-3.0-or-later
"""From a job to its lighting: materials, model, light, what refines both, what speaks against them, result files."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from btfsep_engine.btf.surfaces import GIVEN
from btfsep_engine.fit.stated import Fit, mixed
from btfsep_engine.light.files import MAP_SIZE, Lighting, lighting_map
from btfsep_engine.pipeline.alternatives import Alternative, alternatives, mixture, mixture_words
from btfsep_engine.pipeline.black_and_white import COLOURLESS, as_photographed
from btfsep_engine.pipeline.checks import all_doubts
from btfsep_engine.pipeline.delighting import DE_LIT, words_of
from btfsep_engine.pipeline.light_account import colour_words, light_words, sky_radiance
from btfsep_engine.pipeline.materials import changed_materials, materials_of_all
from btfsep_engine.pipeline.mirrors import softened
from btfsep_engine.pipeline.model import Model, first_model, solve_model
from btfsep_engine.pipeline.phone import probabilities, strengths, tones_words, with_tones_undone
from btfsep_engine.pipeline.refine import refined
from btfsep_engine.pipeline.refine.curves import other_curves
from btfsep_engine.pipeline.refine.dusty import dusty
from btfsep_engine.pipeline.refine.each_object import each_object_by_itself
from btfsep_engine.pipeline.refine.finish import finished
from btfsep_engine.pipeline.refine.flash import flash, flash_settled
from btfsep_engine.pipeline.refine.ground import ground
from btfsep_engine.pipeline.refine.in_front import without_things_in_front
from btfsep_engine.pipeline.refine.interreflection import light_between_surfaces
from btfsep_engine.pipeline.refine.key_lights import key_lights
from btfsep_engine.pipeline.refine.layers import layered
from btfsep_engine.pipeline.refine.left_out import left_out
from btfsep_engine.pipeline.refine.limb import limb_brightness
from btfsep_engine.pipeline.refine.look_alike import look_alike
from btfsep_engine.pipeline.refine.mirrored import mirrored
from btfsep_engine.pipeline.refine.misplaced import misplaced
from btfsep_engine.pipeline.refine.misshapen import misshapen
from btfsep_engine.pipeline.refine.near import near_lamps
from btfsep_engine.pipeline.refine.near_between import light_between_near_surfaces
from btfsep_engine.pipeline.refine.painted import painted_surfaces
from btfsep_engine.pipeline.refine.parted import in_parts
from btfsep_engine.pipeline.refine.reflectance import nearer_materials
from btfsep_engine.pipeline.refine.roughness import as_rough_as_seen
from btfsep_engine.pipeline.refine.said_surface import as_the_photo_shows, unlike_surroundings
from btfsep_engine.pipeline.refine.sharp import sharp_lamps
from btfsep_engine.pipeline.refine.shift import shifted
from btfsep_engine.pipeline.refine.surroundings import surroundings
from btfsep_engine.pipeline.refine.uneven import uneven_surfaces
from btfsep_engine.pipeline.refine.veil import veiled
from btfsep_engine.pipeline.refine.vivid import vivid_light
from btfsep_engine.pipeline.scene import PreparedScene, unseen_meshes
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.pipeline.standing import STANDING, STANDS, on_ground
from btfsep_engine.pipeline.together import SolvedLight
from btfsep_engine.pipeline.tone import read_otherwise, refuse_unknown
from btfsep_engine.threads import one_thread

UNSEEN = (
    "a depth shows one side: what lies behind it is taken as solid, closed and of the same material; of shadows and "
    "reflections by what the camera does not see, the stated uncertainty knows nothing"
)
HASTE = {
    "quick": "quick: a ground under the objects, a flash, lamps sharper than the harmonics, lamps nearby, things in "
    "front, shadows of what no job knows and haze were not looked for",
    "least": "least: nothing but light between surfaces was looked for",
}


@dataclass(frozen=True)
class PhotoFit:
    """One photograph of an estimate: its scene, exposure over the first's, and each object's residual and pixels."""

    scene: PreparedScene
    exposure: float
    residuals: list
    pixels: list


@dataclass(frozen=True)
class Estimate:
    """Everything that an estimate found, before it is written.

    Attributes
    ----------
    model, light : as refined
    choice : what was chosen, and why in words
    alternatives : the lights of all materials that the objects may have, where recognition leaves several
    otherwise : (Fit, probability) of the photo with a phone's tones undone farther or less (`pipeline.phone`)
    """

    model: Model
    light: SolvedLight
    choice: dict
    alternatives: tuple[Alternative, ...] = ()
    otherwise: tuple = ()

    @cached_property
    def fit(self) -> Fit:
        """The light's; where there are alternatives, or shadows or tones may be otherwise, with their spread."""
        fit = mixture(self.alternatives) if self.alternatives else self.light.fit
        return mixed(mixed(fit, self.model.otherwise), self.otherwise)

    @property
    def scene(self) -> PreparedScene:
        """The first photograph's, read by the curve that was chosen."""
        return self.model.problems[0].scene

    @property
    def materials(self) -> list:
        """ObjectMaterial of each of its objects."""
        return self.model.materials[0]

    @property
    def settings(self) -> Settings:
        """Those that were used, with what was chosen where they said "auto"."""
        return replace(self.model.modelled, order=self.light.order)

    @property
    def radiance(self):
        """The sky's own radiance (`light_account.sky_radiance`), and what mirrors show of it.

        None where its series is all that is known.
        """
        if self.fit.election is None:
            return None
        sky, shown = sky_radiance(self.fit, self.lighting), self.scene.mirror_lights
        most = max(shown, key=lambda mirror: mirror.shares.mean(), default=None)
        return sky if most is None else most.seen_in(sky, self.lighting.suns)

    @cached_property
    def lighting(self) -> Lighting:
        """The light that is written."""
        fit, exposure_ev = self.fit, self.scene.job.exposure_ev
        known = fit.order, fit.coefficients, fit.stddev, fit.determined
        return Lighting(*known, exposure_ev, self.light.suns, fit.interval, fit.pattern)

    @cached_property
    def map(self) -> np.ndarray:
        """The environment map that is written: (256, 512, 3)."""
        return lighting_map(self.lighting, *MAP_SIZE, radiance=self.radiance)

    @cached_property
    @one_thread()
    def photos(self) -> list[PhotoFit]:
        """How each photograph is explained."""
        out = []
        for problem, exposure in zip(self.model.problems, self.light.exposures, strict=True):
            b = problem.radiance()
            left = b - exposure * problem.predicted(self.fit.shown)
            residuals = [
                float(np.linalg.norm(r) / max(np.linalg.norm(c), 1e-30))
                for r, c in zip(problem.by_object(left), problem.by_object(b), strict=True)
            ]
            out.append(PhotoFit(problem.scene, exposure, residuals, [len(p) for p in problem.points]))
        return out


def left_as_it_is(model: Model, light: SolvedLight):
    """Says what was not refined: textures that are not worth it, what takes long, geometry that nobody sees or has."""
    words = {} if model.untried is None else {"appearance": model.untried}
    if model.settings.refine in HASTE:
        words["refine"] = HASTE[model.settings.refine]
    if any(unseen_meshes(problem.scene.job) for problem in model.problems):
        words["geometry"] = UNSEEN
    if any(o.supposed for problem in model.problems for o in problem.scene.job.occluders):
        words[STANDS] = STANDING
    things = zip(model.problems[0].scene.job.objects, model.materials[0], strict=True)
    if said := words_of([thing for thing, made_of in things if made_of.name == GIVEN], model.settings):
        words[DE_LIT] = said
    return model, light, words


REFINEMENTS = (
    as_the_photo_shows,
    light_between_surfaces,
    without_things_in_front,
    in_parts,
    each_object_by_itself,
    left_as_it_is,
    flash,
    finished,
    as_rough_as_seen,
    layered,
    vivid_light,
    nearer_materials,
    shifted,
    limb_brightness,
    flash_settled,
    near_lamps,
    light_between_near_surfaces,
    sharp_lamps,
    veiled,
    dusty,
    painted_surfaces,
    uneven_surfaces,
    ground,
    key_lights,
    other_curves,
    surroundings,
    mirrored,
    left_out,
    misshapen,
    unlike_surroundings,
    look_alike,
    misplaced,
)
# On 32 plates these took half of the time; left out of a draft, whose camera stays, they cost its light nothing in the
# mean (0.97 times the error). What they are worth to an estimate: `scripts/study refinements`.
SLOW = (in_parts, without_things_in_front, flash, near_lamps, sharp_lamps, veiled)
# And what a draft need not wait for whose preset follows in a moment: without these its light errs 1.02 times as much
MORE = (
    finished,
    as_rough_as_seen,
    layered,
    dusty,
    vivid_light,
    nearer_materials,
    shifted,
    limb_brightness,
    painted_surfaces,
    uneven_surfaces,
    ground,
    other_curves,
)


def refinements_of(settings: Settings, of=REFINEMENTS) -> tuple:
    """Those of some refinements that the settings ask for."""
    left_out = {"all": (), "quick": SLOW, "least": (*SLOW, *MORE)}[settings.refine]
    return tuple(r for r in of if r not in left_out)


def estimate(scene: PreparedScene, library, settings: Settings, **how) -> Estimate:
    """Recognises what is not given, solves for the light that all objects share, and says what speaks against it.

    ``how`` : as of `found_light`
    """
    answer = found_light(scene, library, settings, **how)
    say_doubts(answer)
    return answer


@one_thread()
def found_light(
    scene: PreparedScene, library, settings: Settings, *, material=None, others=(), refinements=None
) -> Estimate:
    """`estimate` without what speaks against it, which changes nothing of the light.

    Parameters
    ----------
    material : name, of all objects, whatever the job says of theirs; None: as it says
    others : PreparedScenes of further photographs under the same light, each with an exposure of its own
    refinements : what the model may need beside its simplest form, in turn; None: what the settings ask for
    """
    scenes = [scene, *others]
    names = [[material or o.material for o in each.job.objects] for each in scenes]
    scenes, library = as_photographed(scenes, library, names=names)
    tones = strengths(scenes, settings)
    refuse_unknown(scenes, settings)
    usual, *more = tones
    scenes = [on_ground(each, settings) for each in scenes]
    read = [with_tones_undone(each.as_in_job(), usual) for each in scenes]
    materials = materials_of_all(read, library, settings, name=material)

    def found(strength, refinements) -> Estimate:
        read = [with_tones_undone(each, strength) for each in scenes]
        return _of_materials(read, materials, library, settings, material, refinements)

    if not more:
        answer = found(usual, refinements)
        return answer if usual is None else replace(answer, choice=answer.choice | {"tones": tones_words({})})
    whole = refinements_of(settings) if refinements is None else tuple(refinements)
    quick = whole if settings.refine != "all" else tuple(r for r in whole if r not in (*SLOW, ground))
    return _elected(found, tones, quick, whole)


def _elected(found, tones, quick, whole) -> Estimate:
    """The Estimate with a phone's tones undone as far as is most probable, in what is stated those of the others, too.

    ``found`` : (strength, refinements) -> Estimate; ``quick`` refinements are enough to choose by, ``whole`` : all
    """
    fits, kept = {}, {}
    for strength in tones:
        one = found(strength, quick)
        fits[strength] = one.fit
        if quick == whole:  # else it goes, and its photo with it, which may be large
            kept[strength] = one
    shares = probabilities({strength: fit.residual for strength, fit in fits.items()})
    best = max(shares, key=shares.get)
    answer = kept.get(best) or found(best, whole)
    others = tuple((fits[strength], shares[strength]) for strength in tones if strength != best)
    return replace(answer, choice=answer.choice | {"tones": tones_words(shares)}, otherwise=others)


def _of_materials(scenes, materials, library, settings: Settings, material, refinements) -> Estimate:
    """`found_light` of scenes whose objects' ``materials`` are known, as far as the photos' tone curves are."""
    reporter = scenes[0].reporter

    def modelled(scenes, materials) -> Model:
        with reporter.stage("transport"):
            each = [softened(*one, settings) for one in zip(scenes, materials, strict=True)]
            return first_model(*map(list, zip(*each, strict=True)), settings)

    model = modelled(scenes, materials)
    # photos read by the curve that was chosen; those of mirrors as they were taken
    read = [s if p.scene.mirrors else p.scene for s, p in zip(scenes, model.problems, strict=True)]
    if any(not m.is_given for each in materials for m in each) and any(map(read_otherwise, read)):
        anew = materials_of_all([each.as_in_job() for each in read], library, settings, name=material)
        changes = changed_materials(scenes, materials, anew)
        for change in changes:
            reporter.warn(change)
        if changes:
            model = modelled(scenes, anew)
    return light_of(model, library, refinements)


@one_thread()
def light_of(model: Model, library, refinements=None) -> Estimate:
    """The light of a model in its simplest form, and what refines both; nothing is recognised."""
    refinements = refinements_of(model.settings) if refinements is None else refinements
    model, light, choice = refined(*solve_model(model), refinements)
    colour = colour_words(light.fit) if model.problems[0].scene.has_colours else COLOURLESS
    choice |= {"light": light_words(light.fit), "colour": colour}
    with model.reporter.stage("alternatives"):
        others = tuple(alternatives(model, light, library))
    if others:
        choice["materials"] = mixture_words(others)
    return Estimate(model, light, choice, others)


def say_doubts(answer: Estimate) -> None:
    """Warns of what speaks against an estimate."""
    reporter = answer.scene.reporter
    with reporter.stage("checks"):
        doubts = all_doubts(answer)
    for doubt in doubts:
        reporter.warn(doubt)
