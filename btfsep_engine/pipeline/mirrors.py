# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that mirror the light: what they show of it, as a rougher metal in their place would.

A mirror's pixel shows the light of one direction with all its small lamps, of which a series of order 9, or pixels
chosen here and there, know nothing: fitted as it is, what the series lacks is taken for noise, of which most of the
light then drowns. But a mirror's picture *is* the light, over all directions that it reflects to the camera. So these
are put together, each pixel counted by the solid angle that it reflects, and what a rougher metal would show in that
light, with the same shadows, stands in the place of the picture: it is as smooth as other materials' pictures are, and
low orders lose nothing by it. Light that comes by way of another surface is left out of both.
"""

import copy
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from btfsep_engine import sh
from btfsep_engine.btf.model import Material
from btfsep_engine.btf.surfaces import GIVEN, Surface
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.job.model import JobObject, Photo
from btfsep_engine.pipeline.clipped_lamps import Lamps, Table, as_a_rule, of_one_colour, table_of, whitened
from btfsep_engine.pipeline.materials import ObjectMaterial
from btfsep_engine.pipeline.settings import LARGEST_ORDER, TransportSettings
from btfsep_engine.pipeline.tone import read_by_most_usual, sought
from btfsep_engine.render.homogeneous import homogeneous
from btfsep_engine.render.sampling import thinned
from btfsep_engine.render.surface import SurfacePoints
from btfsep_engine.render.transport import Transport

SHARP = 0.25  # roughness: metals up to it are mirrors, their lobes narrower than the tables' directions lie apart
ROUGH = 0.7  # of what stands for them: its lobe is about as wide as a series of order 9 can tell
METAL = 0.9  # of its share: what is left shows little
CELLS = 2048  # directions, 4 degrees apart
FINE = 65536  # directions, by which pixels are sorted: 0.8 degrees apart
WIDE, REACH = np.radians(4.0), np.radians(8.0)  # of the mean in a cell: of a few pixels, it would not keep their light
AROUND, BESIDE = 19, 7  # cells: one and the next two rings; one and the next ring
SHOWN = 0.25  # of what is in a cell's reach: where less is, another cell stands for it
LACKING = 0.2  # of what a place would show: where more of it is unknown, the place is left out
PLACES = 3000  # of an object
LEAST = 100  # of them: fewer tell nothing, and the object stays as it is
LEAST_REFLECTED = 0.01  # a black mirror shows noise
CLIPPED = 0.01  # of what a place shows, clipped: it shows at least so much, for a lamp may be a hundred times as bright
OFF = 1.0  # pixels that the mesh is off, give or take: edges of a mirror show much of the light in few pixels


@dataclass(frozen=True)
class CellLights:
    """Lights by their radiance in the directions that share out the sphere: cells (n, M, 3)."""

    cells: np.ndarray
    returns = False

    @property
    def count(self) -> int:
        return self.cells.shape[1]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(map(str, range(self.count)))

    def cell_averages(self, directions) -> np.ndarray:
        """(n, M, 3), of the directions that they are of."""
        return self.cells


@dataclass(frozen=True)
class Mirror:
    """An object that mirrors: the light that its pixels show, and where a rougher metal is put into its place.

    Attributes
    ----------
    index : number of the object; alone : whether all objects mirror, so that no other tells what is clipped in it
    pixels : (p, 2) int32, that see the sky in it; fine : (p,) int, where; weights : (p,) their solid angles
    reflectance : (p, 3), of the mirror at these
    filled : (CELLS,) int, the cell that stands for each: the nearest that is shown
    places : (q, 2) int32; transport : to these; material : the rougher metal
    whole : (n, 2) int32, all pixels of the object; nearest : (n,), the place that stands for each
    table : clipped_lamps.Table, by which it may be told how bright what is clipped in it is; or None
    """

    index: int
    alone: bool
    pixels: np.ndarray
    fine: np.ndarray
    weights: np.ndarray
    reflectance: np.ndarray
    filled: np.ndarray
    places: np.ndarray
    transport: Transport
    material: Material
    whole: np.ndarray
    nearest: np.ndarray
    table: Table | None = None

    def light(self, values) -> np.ndarray:
        """(CELLS, 3), what ``values`` (p, 3) of the pixels are in each direction."""
        values = values / self.reflectance
        total = np.stack([np.bincount(self.fine, self.weights * v, FINE) for v in values.T], -1)
        there = np.bincount(self.fine, self.weights, FINE)
        return (mean_kernel() @ total / np.maximum(mean_kernel() @ there, 1e-300)[:, None])[self.filled]

    def coefficients(self, light) -> np.ndarray:
        """((LARGEST_ORDER + 1)**2, 3), of a light (CELLS, 3)."""
        return sh.evaluate(LARGEST_ORDER, fibonacci_sphere(CELLS)).T @ light * (4 * np.pi / CELLS)

    def fine_light(self, values) -> np.ndarray:
        """(FINE, 3), what ``values`` (p, 3) are in each direction, or in the nearest that pixels show."""
        total = np.stack([np.bincount(self.fine, self.weights * v, FINE) for v in (values / self.reflectance).T], -1)
        there = np.bincount(self.fine, self.weights, FINE)
        seen = np.flatnonzero(there)
        nearest = seen[cKDTree(fibonacci_sphere(FINE)[seen]).query(fibonacci_sphere(FINE))[1]]
        return total[nearest] / there[nearest, None]

    def fine_lamps(self, lamps: Lamps, seen, over) -> np.ndarray:
        """(FINE, 3), what ``lamps`` add in each direction to what pixels show (p, 3), ``over`` (p, 3) of it clipped.

        In a lamp of a JPEG some pixels are not clipped: without a mean it would be in specks.
        """
        if not over.any():
            return np.zeros((FINE, 3))
        towards = fibonacci_sphere(FINE)[self.fine]
        added = lamps.added_to(towards)[:, None] * of_one_colour(seen, over, towards, self.weights)
        return self.fine_light(added * self.reflectance)[around()].mean(1)

    @property
    def own(self) -> np.ndarray:
        """(CELLS,) bool, the cells that it shows."""
        return self.filled == np.arange(CELLS)

    @cached_property
    def shares(self) -> np.ndarray:
        """(CELLS,), how much of what lies around each cell is shown."""
        near = tree_of(CELLS).query(fibonacci_sphere(CELLS), k=AROUND)[1]
        return self.own[near].mean(1)

    def shown(self, *lights) -> np.ndarray:
        """(q, lights, 3), at the places, under lights (CELLS, 3)."""
        return self.transport.radiance(self.material, CellLights(np.stack(lights, 1)))

    def clipped_lamps(self, light, lost, over, photo: Photo) -> Lamps:
        """What is clipped in it lacks, where no object tells that does not mirror.

        ``light``, ``lost`` : (CELLS, 3), what is seen, and what of it is clipped; ``over`` : (p, 3) bool, where
        """
        share = float((self.weights @ over).mean()) / (4 * np.pi) if self.alone else 0.0
        lamps = as_a_rule(light, lost * bool(share), share)
        return lamps if self.table is None else self.table.told(lamps, light, lost, photo)


@dataclass(frozen=True)
class MirrorLight:
    """What a mirror's picture says of the light, and what it leaves open.

    Attributes
    ----------
    radiance : (FINE, 3), from directions as near to each other as pixels tell apart; shares : (CELLS,), how far they
        are known around each: 1 where all is shown
    clipped : (k, terms, 3), coefficients of what was added for each patch of clipped pixels
    lamps : clipped_lamps.Lamps, how well that is known
    right, down : (terms, 3), by how much the light changes if the mesh is off by `OFF` pixels
    """

    radiance: np.ndarray
    shares: np.ndarray
    clipped: np.ndarray
    lamps: Lamps
    right: np.ndarray
    down: np.ndarray

    def seen_in(self, radiance, suns=()):
        """The positive ``radiance`` (directions (…, 3) -> (…, 3)) with what the mirror shows where it does.

        ``suns`` : light.sun.Sun that are no part of it
        """

        def detailed(directions):
            directions = np.asarray(directions)
            apart, near = tree_of(CELLS).query(directions, k=BESIDE)
            weight = np.exp(-0.5 * np.square(apart / WIDE))  # else the cells show at the edge of what is shown
            share = np.clip(2 * (weight * self.shares[near]).sum(-1) / weight.sum(-1) - 1, 0, 1)
            for sun in suns:
                beside = np.radians(sun.size_degrees / 2) + REACH
                share = np.where(directions @ sun.direction > np.cos(beside), 0.0, share)
            fine = self.radiance[tree_of(FINE).query(directions)[1]]
            return radiance(directions) * (1 - share[..., None]) + fine * share[..., None]

        return detailed

    def spread(self, count: int, random) -> np.ndarray:
        """(count, terms, 3), by what lights that are as probable differ."""
        right, down = random.normal(size=(2, count, 1, 1))
        brighter = np.expm1(random.normal(size=(count, self.lamps.doubt.shape[1])) @ self.lamps.doubt.T)
        return np.einsum("nk,ktc->ntc", brighter, self.clipped) + right * self.right + down * self.down


def mirror_like(surface: Surface | None) -> bool:
    """Whether a surface's picture is that of the light."""
    return surface is not None and surface.image is None and surface.metallic >= METAL and surface.roughness <= SHARP


def softened(scene, materials, settings: TransportSettings):
    """A scene with the pictures of what mirrors as a rougher metal's, and its objects' materials with these metals.

    A photo by an unknown curve stays as it is: what its values add up to is not known. So does one that is fitted by
    path tracing, in which surfaces light each other, and an object that may be of other materials, too.

    Parameters
    ----------
    scene : PreparedScene
    materials : ObjectMaterial of each object

    Returns
    -------
    PreparedScene, list of ObjectMaterial; the same where nothing mirrors
    """
    if settings.transport != "kernel" or scene.job.image_colorspace == "unknown":
        return scene, materials
    surfaces = [mirror_surface(o, m) for o, m in zip(scene.job.objects, materials, strict=True)]
    alone = None not in surfaces
    found = [_mirror(scene, i, surface, alone) for i, surface in enumerate(surfaces) if surface is not None]
    found = [mirror for mirror in found if mirror is not None]
    if found and sought(scene.job):  # what a rougher metal would show has no codes by which light could judge curves
        scene = read_by_most_usual(scene)
    materials = list(materials)
    for mirror in found:
        stands_for = materials[mirror.index].material
        metal = replace(mirror.material, name=stands_for.name, material_class=stands_for.material_class)
        materials[mirror.index] = replace(materials[mirror.index], material=metal, mirror=surfaces[mirror.index])
    table = table_of(scene, [m.material for m in materials], settings) if alone and found else None
    return with_mirrors(scene, [replace(mirror, table=table) for mirror in found]), materials


def mirror_surface(thing: JobObject, made_of: ObjectMaterial) -> Surface | None:
    """The numbers of what an object mirrors by; None: it does not, or may be of something else."""
    if made_of.mirror is not None or len(made_of.likely or ()) > 1:
        return made_of.mirror
    if made_of.material.mirror_reflectance is not None:
        return Surface(tuple(made_of.material.mirror_reflectance), roughness=0.0, metallic=1.0)
    return thing.surface if made_of.name == GIVEN and mirror_like(thing.surface) else None


def with_mirrors(scene, mirrors):
    """A PreparedScene with the pictures of ``mirrors``, of its objects, as a rougher metal's."""
    if not mirrors:
        return scene
    out = copy.copy(scene)
    out.mirrors, out.regions = tuple(mirrors), list(scene.regions)
    for mirror in mirrors:
        out.regions[mirror.index] = np.zeros_like(scene.regions[mirror.index])
        out.regions[mirror.index][tuple(mirror.places.T)] = True
    return with_picture(out, scene.job.photo)


def with_picture(scene, photo: Photo):
    """A copy of a PreparedScene with another photo, in it the pictures of its mirrors as a rougher metal's."""
    out = copy.copy(scene)
    photo, out.mirror_lights = picture(scene.mirrors, photo)
    out.job = replace(scene.job, photo=photo)
    return out


def picture(mirrors, photo: Photo) -> tuple[Photo, tuple[MirrorLight, ...]]:
    """A photo with the pictures of ``mirrors`` as a rougher metal's, and what each says of the light."""
    if not mirrors:
        return photo, ()
    radiance, usable, mirror_lights = photo.radiance.copy(), photo.usable.copy(), []
    clipped = np.zeros(radiance.shape, bool) if photo.clipped is None else photo.clipped.copy()
    for mirror in mirrors:
        at, to = tuple(mirror.pixels.T), tuple(mirror.whole.T)
        values = photo.radiance[at].astype(np.float64)
        over = clipped[at]
        light, lost = mirror.light(values), mirror.light(values * over)
        white = whitened(values * over / mirror.reflectance) * mirror.reflectance
        own = mirror.light(white) * mirror.own[:, None]
        lamps = mirror.clipped_lamps(light, own, over, photo)
        more = lamps.parts(own)
        shown, at_least = np.moveaxis(mirror.shown(light + more.sum(0), lost), 1, 0)
        radiance[to] = shown[mirror.nearest]
        clipped[to] = (not mirror.alone) & (at_least > CLIPPED * shown)[mirror.nearest]
        usable[to] = ~clipped[to].any(-1)
        moved = [OFF * _slope(photo.radiance, mirror.pixels, step) for step in ((0, 1), (1, 0))]
        fine = mirror.fine_light(values) + mirror.fine_lamps(lamps, values / mirror.reflectance, over)
        brighter = np.reshape([mirror.coefficients(each) for each in more], (-1, (LARGEST_ORDER + 1) ** 2, 3))
        open_to = map(mirror.coefficients, map(mirror.light, moved))
        mirror_lights.append(MirrorLight(fine, mirror.shares, brighter, lamps, *open_to))
    # sums of light are no codes: no curve is sought by them
    clipped = clipped if clipped.any() else None
    return replace(photo, radiance=radiance, usable=usable, clipped=clipped, bits=None), tuple(mirror_lights)


def _slope(radiance, pixels, step) -> np.ndarray:
    """(p, 3) float64, by how much values change from a pixel to the next, a ``step`` of rows and columns away."""
    ahead, behind = ((pixels + sign * np.array(step)).clip(0, np.array(radiance.shape[:2]) - 1) for sign in (1, -1))
    return (radiance[tuple(ahead.T)].astype(np.float64) - radiance[tuple(behind.T)]) / 2


def rougher(surface: Surface) -> Surface:
    """The metal whose picture stands for a mirror's: what the mirror's own lobe widens is counted."""
    alpha = np.hypot(ROUGH**2, surface.roughness**2)  # widths add in squares
    return replace(surface, roughness=float(np.sqrt(alpha)), metallic=1.0)


def _mirror(scene, index: int, surface: Surface, alone: bool) -> Mirror | None:
    """The Mirror of an object with a surface's numbers; None where it shows too little of the light."""
    photo, directions = scene.job.photo, fibonacci_sphere(CELLS)
    points = scene.points(index, textured=False)
    towards = scene.transport(points, directions=1).reflected_directions()
    at, weights = tuple(points.pixels.T), solid_angles(points, towards, photo.usable.shape)
    use = photo.usable[at] if photo.clipped is None else photo.usable[at] | photo.clipped[at].any(-1)
    use &= (weights > 0) & scene.tracer.sees_sky(points.position, points.flat_normal, towards)
    if not use.any():
        return None
    fine = tree_of(FINE).query(towards[use])[1]
    there = mean_kernel() @ np.bincount(fine, weights[use], FINE)
    shown = there > SHOWN * np.asarray(mean_kernel().sum(1)).ravel() * (4 * np.pi / FINE)
    if not shown.any():
        return None
    nearest = cKDTree(directions[shown]).query(directions)[1]
    cosine = np.clip((points.normal * points.to_eye).sum(1), 0, 1)[use, None]
    base = np.asarray(surface.base_color)
    reflectance = np.maximum(base + (1 - base) * (1 - cosine) ** 5, LEAST_REFLECTED)
    parts = points.pixels[use], fine, weights[use], reflectance, np.flatnonzero(shown)[nearest]
    some = scene.points(index, region=thinned(scene.regions[index], PLACES), textured=False)
    material = homogeneous(rougher(surface), GIVEN)
    seen = np.repeat(shown[:, None], 3, 1)
    looked_at = scene.transport(some, directions=CELLS).radiance(
        material, CellLights(np.stack([seen, seen * 0 + 1], 1))
    )
    known, all_round = looked_at[..., 1].T
    good = np.flatnonzero(known > (1 - LACKING) * np.maximum(all_round, 1e-30))
    if len(good) < LEAST:
        return None
    some = some.take(good)
    nearest = cKDTree(some.pixels).query(points.pixels)[1]
    of_places = some.pixels, scene.transport(some, directions=CELLS), material
    return Mirror(index, alone, *parts, *of_places, points.pixels, nearest)


@lru_cache(maxsize=2)
def tree_of(count: int) -> cKDTree:
    """Of ``count`` directions that share out the sphere."""
    return cKDTree(fibonacci_sphere(count))


@lru_cache(maxsize=1)
def around() -> np.ndarray:
    """(FINE, AROUND) int, the nearest of each of `FINE` directions."""
    return tree_of(FINE).query(fibonacci_sphere(FINE), k=AROUND)[1]


@lru_cache(maxsize=1)
def mean_kernel() -> csr_matrix:
    """(CELLS, FINE), what directions count in the mean of a cell."""
    coarse, fine = tree_of(CELLS), tree_of(FINE)
    apart = coarse.sparse_distance_matrix(fine, 2 * np.sin(REACH / 2), output_type="coo_matrix").tocsr()
    apart.data = np.exp(-0.5 * np.square(apart.data / WIDE))
    return apart


def solid_angles(points: SurfacePoints, towards, shape) -> np.ndarray:
    """(p,) of the directions ``towards`` (p, 3) that pixels show, from their neighbours'; 0 where these are none.

    ``shape`` : (h, w), of the picture
    """
    grid = np.full((*shape, 3), np.nan)
    grid[tuple(points.pixels.T)] = towards
    steps = []
    for axis in (0, 1):
        ahead = np.diff(grid, axis=axis, append=np.nan)
        behind = np.diff(grid, axis=axis, prepend=np.nan)
        one = np.where(np.isnan(ahead), behind, ahead)
        steps.append((one + np.where(np.isnan(behind), one, behind)) / 2)
    area = np.linalg.norm(np.cross(*steps), axis=-1)[tuple(points.pixels.T)]
    return np.where(np.isfinite(area), area, 0.0)
