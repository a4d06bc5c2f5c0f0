# SPDX-License-Identifier: GPL-3.0-or-later
"""Surface parametrisations compared: distortion, charts, borders, seconds, and what a material with a grain loses.

scripts/study parametrisation                            seven meshes: docs/results/parametrisation.md, its pictures
scripts/study parametrisation --material fabric/satin-crimson --library FOLDER
scripts/study parametrisation --without-light            distortion and picture only
"""

import os
import tempfile
import time
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.btf.library import open_library
from btfsep_engine.job.model import TriangleMesh
from btfsep_engine.render import parametrise
from scripts.cycles.lights import light_path
from scripts.studies import ROOT, parser, photos, tables
from scripts.studies.estimates import scene_of
from scripts.studies.parametrisation import light
from scripts.studies.parametrisation.quality import Quality, quality

WAYS = {"xatlas": "xatlas charts", "patches": "projected patches", "unwrap": "Blender's unwrap", "own": "its own UV"}
SHAPES = ("torus", "cylinder", "ball")  # of meshes.make, whose own coordinates are a smooth field
STRIPE = 12.0  # millimetres, a dark and a light one
PICTURE = 900  # pixels, three times what is shown


def main(arguments) -> None:
    options = parser("parametrisation", __doc__)
    options.add_argument("--material", default="fabric/denim-twill")
    options.add_argument("--library", type=Path, help="material library; the one that comes with BTFsep")
    options.add_argument("--lights", nargs="+", default=["forest", "studio"], help="Blender's studio lights, or maps")
    options.add_argument("--without-light", action="store_true", help="leave out what a material with a grain loses")
    options.add_argument("--out", type=Path, default=ROOT / "docs" / "results" / "parametrisation.md")
    given = options.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        photos.in_blender("scripts.studies.parametrisation.meshes", {"folder": folder})
        os.environ["BTFSEP_CACHE"] = str(Path(folder) / "cache")  # charts are made here, not remembered
        paths = sorted(Path(folder).glob("*.npz"), key=lambda p: p.stat().st_mtime_ns)
        meshes = {path.stem: read(path) for path in tqdm(paths, desc="meshes")}
    text = distortion_table(meshes)
    draw(given.out.parent / "images" / "parametrisation.png", meshes)
    if not given.without_light:
        text += "\n\n" + light_table(meshes, [light_path(name) for name in given.lights], given)
    print(text)
    tables.fill(given.out, "figures", text)


def read(path):
    """(TriangleMesh, {way: uv (f, 3, 2) metres}, {way: seconds or None})."""
    with np.load(path) as data:
        vertices, faces, normals = data["vertices"], data["faces"], data["normals"]
        own, unwrap, unwrapping = data["own"], data["unwrap"], float(data["seconds"])
    p = vertices[faces]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    kept = area > 1e-9 * area.max()
    mesh = TriangleMesh(vertices, faces[kept].astype(np.int32), normals[kept])
    mappings, seconds = {}, {}
    for way, make in (("xatlas", parametrise._xatlas_uv), ("patches", parametrise._projected_charts)):
        started = time.perf_counter()
        mappings[way] = make(mesh)
        seconds[way] = time.perf_counter() - started
    mappings["unwrap"], seconds["unwrap"] = unwrap[kept].astype(np.float64), unwrapping
    if len(own):
        mappings["own"], seconds["own"] = own[kept].astype(np.float64), None
    for way, uv in mappings.items():
        with_uv = TriangleMesh(mesh.vertices, mesh.faces, mesh.corner_normals, uv.astype(np.float32))
        # as the engine scales them: to the mean texel size
        scaled = parametrise.physical_uv(with_uv, "mesh", millimetres_per_unit=1.0)
        mappings[way] = scaled.astype(np.float64)
    return mesh, mappings, seconds


def distortion_table(meshes) -> str:
    """Medians and 95 % for each mesh and way."""
    rows = []
    for name, (mesh, mappings, seconds) in meshes.items():
        for way, uv in tqdm(mappings.items(), desc=name):
            head = f"{name}, {len(mesh.faces):,}" if way == "xatlas" else ""
            rows.append((head, WAYS[way], *cells(quality(mesh.vertices, mesh.faces, uv), seconds[way])))
    heads = ("mesh, triangles", "", "angle, degrees", "area", "charts", "border", "jump, degrees", "folded", "seconds")
    return tables.table(heads, rows)


def cells(q: Quality, seconds) -> tuple:
    """A row's figures."""
    return (
        f"{q.angle[0]:.1f}, {q.angle[1]:.1f}",
        f"{q.area[0]:.2f}, {q.area[1]:.2f}",
        q.charts,
        f"{q.border:.1f}",
        f"{q.jump:.0f}" if q.border > 0 else "–",
        f"{100 * q.folded:.1f} %" if q.folded >= 5e-4 else "0",
        "–" if seconds is None else f"{seconds:.2f}",
    )


def light_table(meshes, lights, given) -> str:
    """What a material with a grain loses, for the grain along the parallels and along the meridians."""
    material, rows = open_library(given.library).load(given.material), []
    names = {"own": "as in the photo", **{w: WAYS[w] for w in ("xatlas", "patches", "unwrap")}}
    names |= {"crosswise": "as in the photo, 90° turned", light.MEAN: "none: mean ABRDF"}
    grains = {"around": lambda uv: uv, "along": light.turned}
    for shape, grain in tqdm([(s, g) for s in SHAPES for g in grains], desc="light"):
        mesh, mappings, _ = meshes[shape]
        chosen = mappings | {"own": grains[grain](mappings["own"])}
        chosen["crosswise"] = light.turned(chosen["own"])
        result = light.losses(mesh, {k: chosen[k] for k in names if k in chosen}, material, lights)
        for k, (which, (away, near, off)) in enumerate(result.items()):
            near = "–" if np.isnan(near) else f"{near:.3f}"
            errors = (", ".join(f"{e:.2f}" for e in off[kind]) for kind in light.KINDS)
            rows.append((f"{shape}, {grain}" if k == 0 else "", names[which], f"{away:.3f}", near, *errors))
    heads = ("shape, grain", "", "radiance off, away from borders", "within 3 mm of one", "error by the frames alone")
    words = f"Material {given.material}; errors are of the estimated light up to order 2, one number for each light."
    return f"{words}\n\n{tables.table((*heads, 'with the texels'), rows)}"


def draw(path, meshes) -> None:
    """Stripes along u on every mesh (a column each) by every way (a row each)."""
    figure = tables.figure(1.75 * len(meshes), 1.8 * len(WAYS), dpi=120)
    axes = figure.subplots(len(WAYS), len(meshes), squeeze=False)
    figure.get_layout_engine().set(w_pad=0.01, h_pad=0.01, wspace=0, hspace=0)
    for column, (name, (mesh, mappings, _)) in zip(axes.T, meshes.items(), strict=True):
        column[0].set_title(name, fontsize=10)
        for place, way in zip(column, WAYS, strict=True):
            tables.empty(place)
            if way in mappings:
                place.imshow(striped(mesh, mappings[way]), interpolation="antialiased")
            else:
                place.text(0.5, 0.5, "none", ha="center", va="center", transform=place.transAxes, color="#888888")
    for place, words in zip(axes[:, 0], WAYS.values(), strict=True):
        place.set_ylabel(words, fontsize=10)
    tables.save(figure, path)


def striped(mesh, uv) -> np.ndarray:
    """(h, w, 3) uint8: dark and light stripes that run along u, warm and cool squares along them, lit from the eye."""
    scene = scene_of(light.job_with(mesh, uv, size=PICTURE))
    points = scene.points(0, region=scene.view.mesh == 0, textured=True)
    shade = 0.25 + 0.75 * np.clip((points.normal * points.to_eye).sum(1), 0, 1)[:, None]
    across = (np.floor(points.uv[:, 1] / (STRIPE / 2)) % 2)[:, None]
    along = (np.floor(points.uv[:, 0] / (2 * STRIPE)) % 2)[:, None]
    colour = np.where(across > 0, np.where(along > 0, [0.93, 0.86, 0.72], [0.72, 0.83, 0.93]), [0.16, 0.22, 0.32])
    out = np.ones((*scene.view.mesh.shape, 3))
    out[points.pixels[:, 0], points.pixels[:, 1]] = colour * shade
    smaller = out.reshape(PICTURE // 3, 3, PICTURE // 3, 3, 3).mean((1, 3))
    rows, columns = (np.flatnonzero((smaller < 1).any((2, k))) for k in (1, 0))
    return (255 * smaller[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]).astype(np.uint8)
