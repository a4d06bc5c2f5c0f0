# SPDX-License-Identifier: GPL-3.0-or-later
"""What each candidate explains of the photo under the light that it implies: recognition by re-rendering.

The classifier has seen the materials under its training lights, never under the photo's. But each candidate says what
that light is: the most probable one for its mean ABRDF and the photo's pixels. How probable that makes the photo is the
first cue, the evidence: a wrong candidate needs a light of unusual shape; how far the light's colour is from those of
natural light and lamps is the second, the tint. For the likeliest by these and the classifier the BTF is rendered under
that light, and compared with the photo by statistics of its texture (`recognise.contrast`): a light that explains the
shading does not explain the texture. `recognise.judgement` says what all of it is worth.

Beside the library's materials stand surfaces that are alike all over (`PLAIN`): most things of plastic, paint and metal
are none of the library's, and what they do not have is texture. Their colour is free: no light is unusual for them.
A mirror shows whatever light is asked of it. It is compared with the photo as it looks under natural lights, one by
one: sharp as these are, all over, and the sharper the nearer to the outline.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import chain, islice

import numpy as np
from scipy.spatial import cKDTree

from btfsep_engine import sh
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.btf.surfaces import SURFACES
from btfsep_engine.conventions import fibonacci_sphere, grey
from btfsep_engine.fit.abreast import near_lights, solve_abreast
from btfsep_engine.fit.colour import base_colour, tint_of
from btfsep_engine.fit.election import natural_light
from btfsep_engine.fit.products import Basis, Photograph
from btfsep_engine.fit.search import STEPS, Solution
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.light.log_field import coarse_field, even_field
from btfsep_engine.light.maps import training_lights
from btfsep_engine.linear_algebra import product
from btfsep_engine.recognise.contrast import Contrast, contrast_of, unlike
from btfsep_engine.recognise.finest import CLEAR, Finest, as_kept, finest
from btfsep_engine.recognise.judgement import judgements, utilities
from btfsep_engine.recognise.masked import Masked
from btfsep_engine.render.homogeneous import homogeneous
from btfsep_engine.render.parametrise import physical_uv
from btfsep_engine.render.sampling import choose_pixels
from btfsep_engine.render.surface import with_texture
from btfsep_engine.storage import kept
from btfsep_engine.threads import one_thread

EXPLAINED = 24  # the first of the classifier's; others keep what the worst of these has
RENDERED = 8  # of these, the likeliest ...
AT_ONCE = 2  # are compared: most of it is OpenCV's, which waits for nobody
HOPELESS = 6.0  # ... but none that is so far behind the first, in the logarithm of its odds
PIXELS = 1000  # of the fit of the light
ORDER = 6  # of its coefficients
NEARBY = 2  # steps from another material's light to a rough one,
SEARCHED = 4, STEPS  # and from there, at its first noise and at the one that is found then
FIELD = 7, 4, sh.term_count(ORDER), 192  # of its logarithm: orders of lightness and of colours; directions
EXPLANATIONS = ("evidence", "tint")
PLAIN = tuple(SURFACES)  # candidates beside a library's,
ROUGHNESSES = {"surface/plastic": (0.2, 0.4), "surface/metal": (0.3, 0.5)}  # each the best of its kind
BESIDE = 3.0  # roots of evidence, as the cue has it: kinds that are so far behind another are not rendered
DYED, BASE = "surface/plastic", 0.5  # of a colour, whose gloss has none: of a metal, as of what is matte, it is all one
IS_PLAIN = "plain"  # the cue that says so, -1: how probable such a thing is beside one of the library's
SIMILARITIES = ("contrast", "tails", "correlation", "together", "directed", "coarse")
# standard deviations of the mean's log2 R / B and log2 G / sqrt(R B) in natural light and lamps: nine maps show 0.21
# and 0.09, lamps and nights more
TINT = (0.35, 0.15)


@dataclass(frozen=True)
class Explained:
    """The light under which a material explains a photo best.

    Attributes
    ----------
    light : (CELLS, 3), in the photo's unit, the radiance of each of `Cells`; positive, where a series would ring about
        a lamp and go negative
    colour : (3,), the light's mean radiance
    evidence : logarithm of how probable the photo is
    effective : how many independent channels its misfit was taken to have: evidences are compared where it is the same
    solution : of the fit
    """

    light: np.ndarray
    colour: np.ndarray
    evidence: float
    effective: float
    solution: Solution


@dataclass(frozen=True)
class Photographed:
    """What candidates are compared with.

    Attributes
    ----------
    seen : recognise.masked.Masked, the pixels of the region that have a value in the photograph
    contrast : recognise.contrast.Contrast
    finest : recognise.finest.Finest
    """

    seen: Masked
    contrast: Contrast
    finest: Finest

    def beside(self, picture) -> Contrast:
        """Of a picture (n, 3) of its pixels, as its camera would have kept it."""
        return contrast_of(as_kept(np.asarray(picture, np.float32), self.seen, self.finest), self.seen)


@dataclass(frozen=True)
class Plain:
    """A kind of `PLAIN`: the best of its ``material``s, grey, and how it is ``explained``.

    ``evidence`` : the largest, in the colour that the object may have
    """

    material: Tabulated
    explained: Explained
    evidence: float


class CoarselyLit(Photograph):
    """The products of a photograph with basis images of `ORDER`."""

    @property
    def fields(self):
        """As of `Photograph`."""
        return coarse_field(*FIELD), even_field()


def lights_from(other: Solution, photos) -> list[Solution]:
    """The most probable fields of photographs by several bases, from the light of another basis on."""
    if not photos:
        return []
    white, v, near = near_lights(photos, other, NEARBY)
    for photo, x in zip(photos, near, strict=True):
        photo.learn_from(x)
    return solve_abreast(photos, other.model, white=white, v=v, steps=SEARCHED)


@dataclass(frozen=True)
class Cells:
    """``count`` lights that share out the sphere: each is 1 where it is the nearest, and 0 elsewhere.

    An object's images under them are the same for every photograph; their mixture is a picture in any smooth light.
    """

    count: int
    returns = True

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(fibonacci_sphere(self.count))

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"cell {i}" for i in range(self.count))

    def radiance(self, directions) -> np.ndarray:
        return (self.nearest(directions)[:, None] == np.arange(self.count))[..., None].astype(float)

    def cell_averages(self, directions) -> np.ndarray:
        """Point values: a direction counts for the cell that it lies in."""
        return self.radiance(directions)

    def nearest(self, directions) -> np.ndarray:
        """(n,) int, the cell of each direction (n, 3)."""
        return self._tree.query(np.asarray(directions))[1]

    def means(self, radiance, directions) -> np.ndarray:
        """(m, count, 3), the mean in each cell of the ``radiance`` (m, 3, n) of directions (n, 3), spread over the
        sphere."""
        inside = self.radiance(directions)[..., 0]
        return np.swapaxes(radiance @ (inside / np.maximum(inside.sum(0), 1)), 1, 2)


CELLS = Cells(64)  # of the light that a candidate is rendered under


class Verification:
    """The rays of one object, for as many photographs of it as there are.

    Parameters
    ----------
    scene : PreparedScene
    index : of the object
    region : (h, w) bool, pixels that recognition looks at
    window : two slices, the part of the photograph that holds ``region``
    settings : RecognitionSettings
    """

    def __init__(self, scene, index: int, region, window, settings):
        obj, unit = scene.job.objects[index], scene.millimetres_per_unit

        def chosen():
            points = with_texture(scene.bare_points(index, region=region), scene.job, index)
            return points, points.take(choose_pixels(points, PIXELS, seed=settings.seed))

        physical_uv(obj.mesh, obj.uv, millimetres_per_unit=unit, reporter=scene.reporter)  # says what is to be said
        parts = [scene.seen, index, np.packbits(region), region.shape, obj.uv, float(unit), settings.seed]
        self.points, few = kept.recalled("candidates' points", parts, chosen)
        self.transport = scene.transport(self.points, directions=settings.training_directions)
        self.few_transport = scene.transport(few, directions=settings.training_directions)
        self.region, self.window, self.has_colours = region[window], window, scene.has_colours
        self.every = False  # whether candidates are rendered, not the likeliest alone

    def cues(self, names, votes, radiance, load) -> dict:
        """{cue: (candidates + `PLAIN`,) float} of the materials ``names``, the classifier's likeliest first.

        Parameters
        ----------
        votes : {cue: (candidates,) float}, what the classifier says of them; of `PLAIN` it knows nothing
        radiance : (h, w, 3), the window of the photograph, NaN where a pixel is unusable
        load : material name -> Material
        """
        count, last = len(names), len(names[:EXPLAINED])
        materials = [load(name) for name in names[:EXPLAINED]]
        (first,) = self.explained(materials[:1], radiance)  # the others' lights are looked for from there on
        surfaces = {name: _surfaces(name) for name in PLAIN}
        others = iter(self.explained([*materials[1:], *chain(*surfaces.values())], radiance, first))
        explained = [first, *islice(others, last - 1)]
        plain = [
            self.plain(name, list(zip(m, islice(others, len(m)), strict=True)), radiance, first)
            for name, m in surfaces.items()
        ]
        evidence = np.array([*(e.evidence for e in explained), *(p.evidence for p in plain)])
        materials, explained = materials + [p.material for p in plain], explained + [p.explained for p in plain]
        # a mirror shows whatever light is asked of it: that it can look like the photo says nothing
        mirrors = np.array([m.mirror_reflectance is not None for m in materials])
        evidence[mirrors] = np.minimum(evidence[mirrors], evidence[~mirrors].max())
        below = -np.sqrt(np.maximum(evidence.max() - evidence, 0))  # half of a chi^2's size, of which a root is normal
        found = {"evidence": below[:last], "tint": np.array([-unusual(e.colour) for e in explained[:last]])}
        cues = {cue: _of_all(values, range(last), count) for cue, values in found.items()}
        odds = utilities(judgements()["explained"].weights, votes | cues)
        likely = [i for i in np.argsort(-odds, kind="stable") if i < last]
        kinds = list(range(last, len(materials)))
        if not self.every:
            enough = odds[likely[0]] - HOPELESS
            likely = [i for i in likely[:RENDERED] if odds[i] > enough or mirrors[i]]
            kinds = [i for i in kinds if below[i] >= below[last:].max() - BESIDE]
        seen = Masked(self.region, self.region & np.isfinite(radiance).all(-1))
        of_photo = seen.values_of(radiance)
        photo = Photographed(seen, contrast_of(of_photo, seen), finest(of_photo, seen))
        similar = self.similarities([(materials[i], explained[i].light) for i in (*likely, *kinds)], photo)
        each = {cue: np.array([s[cue] for s in similar]) for cue in SIMILARITIES}
        cues |= {cue: _of_all(values[: len(likely)], likely, count) for cue, values in each.items()}
        if mirrors.any():
            for cue, value in self.similarity_of_mirrors(photo).items():
                cues[cue][np.flatnonzero(mirrors)] = value
        numbers = np.array(kinds) - last
        of_plain = {cue: _of_all(values[len(likely) :], numbers, len(PLAIN)) for cue, values in each.items()}
        of_plain |= {cue: np.zeros(len(PLAIN)) for cue in (*votes, "tint")} | {"evidence": below[last:]}
        out = {cue: np.append(values, of_plain[cue]) for cue, values in (votes | cues).items()}
        return out | {IS_PLAIN: np.append(np.zeros(count), -np.ones(len(PLAIN)))}

    def explained(self, materials, radiance, beside: Explained | None = None) -> list[Explained]:
        """What each of ``materials`` explains by its mean ABRDF of the photograph's window, ``radiance`` (h, w, 3).

        ``beside`` : another material's, with whose evidence these are compared
        """
        if not materials:
            return []
        rows, columns = (self.few_transport.points.pixels - [s.start for s in self.window]).T
        b = radiance[rows, columns]
        good, effective = np.isfinite(b).all(-1), beside and beside.effective
        with one_thread():
            photos = [CoarselyLit(self._basis(each, good), b[good], effective=effective) for each in materials]
            if beside is None:
                lights = [natural_light(photo, rounds=2) for photo in photos]
            else:
                lights = lights_from(beside.solution, photos)
        each = list(zip(photos, lights, strict=True))
        radiance = np.array([best.radiance * photo.level[:, None] for photo, best in each])
        cells = CELLS.means(radiance, lights[0].model.field.directions)
        return [
            Explained(light, best.x[:, 0] * photo.level, best.evidence, photo.effective, best)
            for (photo, best), light in zip(each, cells, strict=True)
        ]

    def plain(self, name: str, each, radiance, beside: Explained) -> Plain:
        """The best of a kind of `PLAIN`, of ``each`` (material, Explained); all else as of `explained`."""
        material, best = max(each, key=lambda one: one[1].evidence)
        evidence = best.evidence
        if name == DYED and unusual(best.colour) > 1:
            dyed = replace(material.surface, base_color=tuple(BASE * base_colour(tint_of(best.colour))))
            (there,) = self.explained([homogeneous(dyed, name)], radiance, beside)
            evidence = max(evidence, there.evidence)
        return Plain(material, best, evidence)

    def _basis(self, material, good) -> Basis:
        """The basis images of a material's mean ABRDF at the few points that are ``good`` (n,) bool.

        Of all points they are the same for every photograph, and kept.
        """

        def made(which=slice(None)):
            images = self.few_transport.radiance(material.mean_material(), SHBasis(ORDER))
            basis = Basis(images[which], self.few_transport.points.normal[which])
            _ = basis.axes  # is kept with it
            return basis

        return kept.recalled("candidate", [self.few_transport.key, material], made) if good.all() else made(good)

    def similarities(self, candidates, photo: Photographed) -> list[dict[str, float]]:
        """`similarity` of each of ``candidates`` (material, light), two at a time; of mirrors NaN."""
        images = [
            self.transport.radiance(material, CELLS) if material.mirror_reflectance is None else None
            for material, _ in candidates
        ]

        def of_one(candidate, under) -> dict[str, float]:
            if under is None:
                return dict.fromkeys(SIMILARITIES, np.nan)
            return self.similarity(*candidate, under, photo)

        with ThreadPoolExecutor(AT_ONCE) as beside:
            return list(beside.map(of_one, candidates, images))

    def similarity(self, material, light, under, photo: Photographed) -> dict[str, float]:
        """`SIMILARITIES` of the photograph and a material under a light: how unlike they look, each <= 0.

        ``under`` : (p, `CELLS`, 3), the material's images under these
        """
        light = light.astype(np.float32)
        pixels = np.stack([product(under[..., c], light[:, c]) for c in range(3)], 1)
        differences = unlike(photo.beside(pixels[photo.seen.valid[self.region]]), photo.contrast)
        return {name: -differences[name] for name in SIMILARITIES}

    def similarity_of_mirrors(self, photo: Photographed) -> dict[str, float]:
        """`SIMILARITIES` of the photograph and a mirror: of each, that of the natural light that is nearest in it.

        Which light a mirror shows nobody knows: the one that the photo implies is the photo itself, always.
        """
        valid = photo.seen.valid

        def made() -> list[Contrast]:
            pictures = self.transport.mirrored(training_lights(1))[valid[self.region]]
            pictures = pictures if self.has_colours else grey(pictures)
            return [photo.beside(picture) for picture in np.moveaxis(pictures, 1, 0)]

        if photo.finest.model == CLEAR:
            parts = [self.transport.key, np.packbits(valid), *valid.shape, self.has_colours]
            natural = kept.recalled("mirrors", parts, made)
        else:  # each such photo has lost something else
            natural = made()
        differences = [unlike(each, photo.contrast) for each in natural]
        return {name: -min(each[name] for each in differences) for name in SIMILARITIES}


@lru_cache(maxsize=len(PLAIN))
def _surfaces(name: str) -> list[Tabulated]:
    """Those of a kind of `PLAIN`."""
    roughnesses = ROUGHNESSES.get(name, (SURFACES[name].roughness,))
    return [homogeneous(replace(SURFACES[name], roughness=roughness), name) for roughness in roughnesses]


def unusual(colour) -> float:
    """How far the colour (3,) of a light is from grey, in `TINT`s: the root of twice a negative log probability."""
    red, green, blue = np.log2(np.maximum(colour, 1e-6 * np.max(colour)))
    return float(np.hypot((red - blue) / TINT[0], (green - (red + blue) / 2) / TINT[1]))


def _of_all(values, indices, count: int) -> np.ndarray:
    """Of ``count`` candidates: ``values`` at ``indices``, their mean where NaN, the lowest for those not looked at."""
    known = np.isfinite(values)
    if not known.any():
        return np.zeros(count)
    out = np.full(count, np.nanmin(values))
    out[list(indices)] = np.where(known, values, np.nanmean(values))
    return out
