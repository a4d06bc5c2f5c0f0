# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometry as users have it, and things in the way: what a wrong mesh, a covered object, a blur or a veil costs.

scripts/study shapes FOLDER --make --meshes MESHES     takes the plates, once (MESHES: spot, bob, teapot, skull as OBJ)
scripts/study shapes FOLDER

Plates by Cycles of a mesh of one even surface, which the job has, under Blender's studio lights, turned. Then the job's
mesh is replaced by what a user may have of it, or the photo is spoilt as photographs are; everything else stays right.
*Unsaid*: estimates that err more than twice what they state and say nothing that speaks of it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from btfsep_engine.errors import InputError
from btfsep_engine.job.load import load_job
from btfsep_engine.job.meshes import assemble
from btfsep_engine.job.model import TriangleMesh
from btfsep_engine.job.polygons import Polygons
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from btfsep_engine.storage.atomic import write_json
from scripts.cycles.lights import studio_lights
from scripts.studies import parser, photos, plate_light, plate_sets, plates, tables
from scripts.studies.estimates import estimated, kept, worth
from scripts.studies.stability.axes import smoothed
from scripts.studies.stage import as_mesh

SETS = {"first": 1, "second": 2}  # seeds; no constant was chosen by the second
OBJECTS = {
    "first": ("spot.obj", "suzanne", "mx_teapot.obj", "os_skull_low_resolution.obj", "blob", "bob_tri.obj"),
    "second": ("vase", "bob_tri.obj", "cushion", "spot.obj", "knot", "mx_teapot.obj", "pebble", "suzanne"),
}
COLOURS = ((0.55, 0.55, 0.55), (0.3, 0.28, 0.26), (0.7, 0.68, 0.62), (0.4, 0.42, 0.45))
ROUGHNESS = (0.9, 0.9, 0.5, 0.3)
SIZE = 0.15  # metres, of every object
AS_IS = "as it is"
SURE = 2.0  # times what is stated
OF_ALL = ("the photo determines", "the object's colour is not known")  # said of estimates that are right, too


def drawn(name: str) -> list[dict]:
    """The plates of a set, as `scripts.cycles.shapes` takes them."""
    random, out = np.random.default_rng([SETS[name], 77]), []
    lights = sorted(studio_lights())
    for i, thing in enumerate(OBJECTS[name]):
        light, azimuth, height = str(random.choice(lights)), random.uniform(0, 2 * np.pi), random.uniform(0.35, 1.2)
        towards = [np.cos(azimuth) * np.cos(height), -abs(np.sin(azimuth)) * np.cos(height), np.sin(height)]
        k, roughness = random.integers(len(COLOURS)), float(random.choice(ROUGHNESS))
        out.append(
            {
                "name": f"{i:02d}",
                "object": thing,
                "seed": 5 + i,
                "facing": random.uniform(0, 360),
                "surface": {"colour": COLOURS[k], "roughness": roughness, "metallic": 0},
                "light": light,
                "turn": random.uniform(0, 360),
                "sun": {"direction": towards, "irradiance": list(plate_sets.SUNNY * plate_sets.SUN_COLOUR)}
                if i % 3 == 2
                else None,
            }
        )
    return out


@dataclass(frozen=True)
class Case:
    """One thing that is wrong: ``change`` (job, plate's meshes, random numbers) -> job; ``lens`` of the photograph."""

    change: Callable
    lens: str = "plain"


CASES: dict[str, Case] = {}


def with_mesh(job, mesh: TriangleMesh):
    """The job with another mesh for its object, as it is read from a file that has normals."""
    n = np.arange(mesh.faces.size)
    told = mesh.vertices, np.full(len(mesh.faces), 3), mesh.faces.ravel(), mesh.corner_normals.reshape(-1, 3), n
    mesh = assemble("mesh", Polygons(*told))[0]
    return replace(job, objects=(replace(job.objects[0], mesh=mesh), *job.objects[1:]))


def with_photo(job, radiance):
    """The job with other pixels."""
    return replace(job, photo=replace(job.photo, radiance=np.maximum(radiance, 0).astype(np.float32)))


def of_shape(function, *told):
    """A change of the mesh's vertices and faces: smooth normals are made anew."""

    def change(job, meshes, random):
        vertices, faces, _ = meshes["true"]
        return with_mesh(job, as_mesh(trimesh.Trimesh(*function(vertices, faces, random, *told), process=False)))

    return change


def of_modifier(name):
    """The mesh that a modifier made."""
    return lambda job, meshes, random: with_mesh(job, TriangleMesh(*meshes[name]))


def of_photo(function, *told):
    """A change of the photo."""

    def change(job, meshes, random):
        shown = PreparedScene(job, Reporter()).view.mesh >= 0
        image = job.photo.radiance.astype(np.float64)
        return with_photo(job, function(image, shown, random, *told))

    return change


def blurred_mesh(vertices, faces, random, length):
    return smoothed(vertices, vertices, faces, length * SIZE), faces


def scanned(vertices, faces, random, height):
    """Bumps along the normals, of some hundredths of the size in length."""
    bumps = smoothed(random.normal(size=(len(vertices), 1)), vertices, faces, 0.03 * SIZE)
    return vertices + height * SIZE * bumps / bumps.std() * trimesh.Trimesh(
        vertices, faces, process=False
    ).vertex_normals, faces


def hull(vertices, faces, random):
    shape = ConvexHull(vertices)
    corners = vertices[shape.simplices]
    inwards = (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * shape.equations[:, :3]).sum(1)
    return vertices, np.where(inwards[:, None] < 0, shape.simplices[:, ::-1], shape.simplices)


def scaled(vertices, faces, random, factor):
    return vertices * factor, faces


def tip_of(vertices, random):
    """Where an object sticks out most among some directions."""
    return vertices[np.argmax(np.square(vertices - np.median(vertices, 0)).sum(1))]


def without_part(vertices, faces, random, size):
    near = np.linalg.norm(vertices[faces].mean(1) - tip_of(vertices, random), axis=1) < size * SIZE
    return vertices, faces[~near]


def bent(vertices, faces, random, degrees):
    """All that is beyond a plane near the tip is turned about a line in it, the more the farther."""
    middle = np.median(vertices, 0)
    way = tip_of(vertices, random) - middle
    far = np.linalg.norm(way)
    along = (vertices - middle) @ way / far**2
    turn = np.clip((along - 0.25) / 0.5, 0, 1)[:, None] * np.radians(degrees) * np.cross(way, [0.3, 0.2, 1.0]) / far
    pivot = middle + 0.25 * way
    return pivot + Rotation.from_rotvec(turn).apply(vertices - pivot), faces


def holes(vertices, faces, random, share):
    """Round holes of three hundredths of the size."""
    kept, centres = np.ones(len(faces), bool), vertices[faces].mean(1)
    while (~kept).mean() < share:
        kept &= np.linalg.norm(centres - centres[random.integers(len(centres))], axis=1) > 0.03 * SIZE
    return vertices, faces[kept]


def inverted(job, meshes, random):
    vertices, faces, normals = meshes["true"]
    return with_mesh(job, TriangleMesh(vertices, faces[:, ::-1], -normals[:, ::-1]))


def partly_inverted(vertices, faces, random, share):
    """Patches are turned over: with smooth shading, the normals where they meet are anybody's guess."""
    turned, centres = np.zeros(len(faces), bool), vertices[faces].mean(1)
    while turned.mean() < share:
        turned ^= np.linalg.norm(centres - centres[random.integers(len(centres))], axis=1) < 0.12 * SIZE
    return vertices, np.where(turned[:, None], faces[:, ::-1], faces)


def single_inverted(vertices, faces, random, share):
    """Single faces are turned over."""
    return vertices, np.where(random.random(len(faces))[:, None] < share, faces[:, ::-1], faces)


def doubled(job, meshes, random):
    """Every face twice, once from either side."""
    vertices, faces, normals = meshes["true"]
    both = np.concatenate([faces, faces[:, ::-1]]), np.concatenate([normals, -normals[:, ::-1]])
    return with_mesh(job, TriangleMesh(vertices, *both))


def shell(vertices, faces, random, thickness):
    """A second skin inside."""
    normals = trimesh.Trimesh(vertices, faces, process=False).vertex_normals
    inner = vertices - thickness * SIZE * normals
    return np.concatenate([vertices, inner]), np.concatenate([faces, faces[:, ::-1] + len(vertices)])


def split(job, meshes, random):
    """No two faces share a vertex, and the file has no normals."""
    vertices, faces, _ = meshes["true"]
    told = vertices[faces].reshape(-1, 3), np.full(len(faces), 3), np.arange(faces.size)
    return replace(job, objects=(replace(job.objects[0], mesh=assemble("mesh", Polygons(*told))[0]),))


def crossed(vertices, faces, random, share):
    """A ball stands in the object, and out of it a little, as parts of models do."""
    ball = trimesh.creation.icosphere(3, radius=share * SIZE)
    ball.apply_translation(vertices[random.integers(len(vertices))])
    return np.concatenate([vertices, ball.vertices]), np.concatenate([faces, ball.faces + len(vertices)])


def covered(image, shown, random, share, colour):
    """A few long round things before the object, each shaded, until a share of it is hidden."""
    rows, columns = np.nonzero(shown)
    size, level = np.sqrt(shown.sum()), image[shown].mean()
    y, x = np.indices(shown.shape)
    hidden = np.zeros(shown.shape, bool)
    while (hidden & shown).sum() < share * shown.sum():
        i, way = random.integers(len(rows)), random.uniform(0, np.pi)
        along = (x - columns[i]) * np.cos(way) + (y - rows[i]) * np.sin(way)
        across = ((y - rows[i]) * np.cos(way) - (x - columns[i]) * np.sin(way)) / (0.06 * size)
        here = (np.abs(along) < 0.25 * size) & (np.abs(across) < 1)
        shade = level * (0.6 + 0.4 * random.uniform() + 0.5 * across[here])
        image[here] = np.maximum(shade, 0)[:, None] * colour
        hidden |= here
    return image


def defocused(image, shown, random, radius):
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    disc = (x * x + y * y <= radius * radius).astype(np.float64)
    return cv2.filter2D(image, -1, disc / disc.sum(), borderType=cv2.BORDER_REFLECT)


def shaken(image, shown, random, length):
    way, half = random.uniform(0, np.pi), np.linspace(-length / 2, length / 2, 4 * length)
    height, width = shown.shape
    moved = [np.float32([[1, 0, t * np.cos(way)], [0, 1, t * np.sin(way)]]) for t in half]
    each = [cv2.warpAffine(image, m, (width, height), borderMode=cv2.BORDER_REFLECT) for m in moved]
    return np.mean(each, 0)


def vignetted(image, shown, random, loss):
    y, x = (np.indices(shown.shape).T / np.array(shown.shape)).T - 0.5
    return image * (1 - loss * (x * x + y * y) / 0.5)[..., None]


def veiled(image, shown, random, share, colour):
    return image + share * image[shown].mean() * np.array(colour)


def hazy(image, shown, random, share, colour):
    return (1 - share) * image + share * image[shown].mean() * np.array(colour)


def enter(name, change, lens="plain"):
    CASES[name] = Case(change, lens)


enter(AS_IS, lambda job, meshes, random: job)
for part in ("10 %", "2 %", "0.5 %"):
    for looks in ("smooth", "flat"):
        enter(f"{part} of the faces, {looks}", of_modifier(f"{part} of the faces, {looks}"))
for part in ("2 %", "5 %"):
    enter(f"voxels of {part}", of_modifier(f"voxels of {part}"))
    enter(f"smoothed by {part}", of_shape(blurred_mesh, float(part.split()[0]) / 100))
for percent in (0.2, 0.5, 1):
    enter(f"scan's noise of {percent:g} %", of_shape(scanned, percent / 100))
enter("convex hull", of_shape(hull))
enter("3 % too large", of_shape(scaled, 1.03))
enter("3 % too small", of_shape(scaled, 0.97))
enter("a part is missing", of_shape(without_part, 0.25))
enter("a limb is turned by 20°", of_shape(bent, 20))
enter("holes, 8 %", of_shape(holes, 0.08))
enter("inverted", inverted)
enter("patches inverted", of_shape(partly_inverted, 0.4))
enter("single faces inverted", of_shape(single_inverted, 0.2))
enter("every face twice", doubled)
enter("a second skin", of_shape(shell, 0.01))
enter("loose faces", split)
enter("a ball too many", of_shape(crossed, 0.2))
enter("covered by 6 %", of_photo(covered, 0.06, (1.0, 0.62, 0.5)))
enter("covered by 15 %", of_photo(covered, 0.15, (0.35, 0.8, 0.2)))
enter("defocus, 3 px", of_photo(defocused, 3))
enter("shaken, 5 px", of_photo(shaken, 5))
enter("shaken, 10 px", of_photo(shaken, 10))
enter("vignette, 40 %", of_photo(vignetted, 0.4))
enter("vignette, 70 %", of_photo(vignetted, 0.7))
enter("veil of 10 %", of_photo(veiled, 0.1, (1, 1, 1)))
enter("veil of 40 %", of_photo(veiled, 0.4, (1, 1, 1)))
enter("blue haze, 30 %", of_photo(hazy, 0.3, (0.7, 1.0, 1.5)))
for lens in ("tele", "wide", "cut", "small"):
    enter(f"lens: {lens}", lambda job, meshes, random: job, lens)


def judged(plate, folder: Path, case: str, settings) -> dict:
    """What the estimate of one plate is worth in one case."""
    given, reporter = CASES[case], Reporter()
    packed = np.load(folder / plate["name"] / "meshes.npz")
    names = {k.split("|")[0] for k in packed.files}
    meshes = {n: [packed[f"{n}|{i}"] for i in range(3)] for n in names}
    random = np.random.default_rng([len(case), int(plate["name"]), *case.encode()])
    job = given.change(load_job(folder / plate["name"] / given.lens), meshes, random)
    row = {"plate": plate["name"], "case": case, "failed": ""}
    try:
        found = estimated(PreparedScene(job, reporter), preset=settings.preset, robust=settings.robust)
    except InputError as error:
        return row | {"failed": str(error)}
    row |= worth(found, plate_light.truth(plate), free_scale=True) | {
        "choice": found.choice,
        "said": list(reporter.warnings),
    }
    row |= {"residual": float(found.fit.residual), "over": row["order2"] / row["stated2"]}
    return row | {"unsaid": row["over"] > SURE and not any(not said.startswith(OF_ALL) for said in row["said"])}


COLUMNS = (
    *plates.COLUMNS[:-1],
    ("said", lambda rows: tables.percent([any(not s.startswith(OF_ALL) for s in r["said"]) for r in rows])),
    ("unsaid", lambda rows: sum(r["unsaid"] for r in rows)),
)


def main(arguments) -> int:
    options = parser("shapes", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--make", action="store_true", help="take the plates")
    options.add_argument("--meshes", type=Path, help="folder of the OBJ files, for --make")
    options.add_argument("--sets", nargs="+", choices=list(SETS), default=list(SETS))
    options.add_argument("--only", nargs="+", metavar="CASE", help="cases whose names contain one of these words")
    options.add_argument("--robust", action="store_true", help="leave out pixels that the light does not explain")
    options.add_argument("--keep", type=Path, metavar="FOLDER", help="keeps every estimate's numbers, to go on from")
    options.add_argument("--numbers", type=Path, metavar="FILE", help="write all numbers, JSON")
    given = options.parse_args(arguments)
    for name in given.sets if given.make else ():
        taken = drawn(name)
        for plate in taken:
            if plate["object"].endswith(".obj"):
                plate["object"] = str(given.meshes.resolve() / plate["object"])
        photos.in_blender("scripts.cycles.shapes", {"plates": taken, "folder": str(given.folder.resolve() / name)})
    if given.make:
        return 0
    settings = choose("balanced", robust=given.robust)
    cases = [c for c in CASES if not given.only or any(word in c for word in given.only)]
    todo = [(plate, given.folder.resolve() / name, c) for name in given.sets for c in cases for plate in drawn(name)]
    rows = []
    for plate, folder, case in tqdm(todo):
        name = f"{folder.name} {plate['name']} {case}".replace("/", "-")
        row = kept(given.keep, name, partial(judged, plate, folder, case, settings))
        rows.append({"set": folder.name} | row)
    if given.numbers:
        write_json(given.numbers, rows)
    for row in (r for r in rows if r["failed"]):
        print(f"{row['case']}, {row['set']}/{row['plate']}: {row['failed']}")
    print(tables.summary("case", COLUMNS, tables.groups([r for r in rows if not r["failed"]], "case", every=None)))
    return 0
