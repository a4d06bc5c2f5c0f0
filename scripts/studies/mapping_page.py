# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures the parametrisations and writes the page about them."""

import re
import time

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot

from btfsep_engine.btf.library import open_library
from btfsep_engine.job.model import TriangleMesh
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.progress import Reporter
from btfsep_engine.render import parametrise
from scripts.studies import mapping_light
from scripts.studies.mappings import Quality, quality

WAYS = {"xatlas": "xatlas charts", "patches": "projected patches", "unwrap": "Blender's unwrap", "own": "its own UV"}
SHAPES = ("torus", "cylinder", "ball")  # of mapped_meshes, whose own coordinates are a smooth field
STRIPE = 12.0  # millimetres, a dark and a light one
PICTURE = 900  # pixels, three times what is shown
START, END = "<!-- figures: from here -->", "<!-- figures: to here -->"


def write(folder, options) -> None:
    """Reads the meshes of `mapped_meshes.make` in ``folder``, measures, and fills in the page ``options.out``."""
    found, meshes = {}, {}
    for path in sorted(folder.glob("*.npz"), key=lambda p: p.stat().st_mtime_ns):
        meshes[path.stem] = mesh, mappings, seconds = read(path)
        found[path.stem] = {way: (quality(mesh.vertices, mesh.faces, uv), seconds[way]) for way, uv in mappings.items()}
        print(f"{path.stem}: measured", flush=True)
    text = distortion_table(found, meshes)
    picture = options.out.parent / "images" / "parametrisation.png"
    draw(picture, meshes)
    if not options.without_light:
        text += "\n" + light_table(meshes, (folder / "lights.txt").read_text().split("\n"), options)
    print(text)
    fill(options.out, text)


def fill(path, text: str) -> None:
    """Puts the tables between the page's marks; what people wrote around them stays."""
    page = path.read_text() if path.exists() else f"# Surface parametrisation\n\n{START}\n{END}\n"
    path.write_text(re.sub(f"{START}.*{END}", lambda _: f"{START}\n{text}{END}", page, flags=re.DOTALL))


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


def distortion_table(found, meshes) -> str:
    """Medians and 95 % for each mesh and way."""
    lines = [
        "| mesh, triangles | | angle, degrees | area | charts | border | jump, degrees | folded | seconds |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, ways in found.items():
        count = len(meshes[name][0].faces)
        for way, (q, seconds) in ways.items():
            lines.append(f"| {f'{name}, {count:,}' if way == 'xatlas' else ''} | {WAYS[way]} | {cells(q, seconds)} |")
    return "\n".join(lines) + "\n"


def cells(q: Quality, seconds) -> str:
    """A row's figures."""
    folded = f"{100 * q.folded:.1f} %" if q.folded >= 5e-4 else "0"
    jump = f"{q.jump:.0f}" if q.border > 0 else "–"
    return (
        f"{q.angle[0]:.1f}, {q.angle[1]:.1f} | {q.area[0]:.2f}, {q.area[1]:.2f} | {q.charts} | {q.border:.1f} | "
        f"{jump} | {folded} | {'–' if seconds is None else f'{seconds:.2f}'}"
    )


def light_table(meshes, lights, options) -> str:
    """What a material with a grain loses, for the grain along the parallels and along the meridians."""
    material = open_library(options.library).load(options.material)
    lines = [
        f"Material {options.material}; errors are of the estimated light up to order 2, one number for each light.",
        "",
        "| shape, grain | | radiance off, away from borders | within 3 mm of one | error by the frames alone "
        "| with the texels |",
        "|---|---|---|---|---|---|",
    ]
    names = {"own": "as in the photo", **{w: WAYS[w] for w in ("xatlas", "patches", "unwrap")}}
    names |= {"crosswise": "as in the photo, 90° turned", mapping_light.MEAN: "none: mean ABRDF"}
    for shape in SHAPES:
        mesh, mappings, _ = meshes[shape]
        for grain, way in (("around", lambda uv: uv), ("along", mapping_light.turned)):
            chosen = mappings | {"own": way(mappings["own"])}
            chosen["crosswise"] = mapping_light.turned(chosen["own"])
            ordered = {k: chosen[k] for k in names if k in chosen}
            result = mapping_light.losses(mesh, ordered, material, lights)
            for k, (which, loss) in enumerate(result.items()):
                head = f"{shape}, {grain}" if k == 0 else ""
                near = "–" if np.isnan(loss.near) else f"{loss.near:.3f}"
                errors = " | ".join(", ".join(f"{e:.2f}" for e in loss.errors[kind]) for kind in mapping_light.KINDS)
                lines.append(f"| {head} | {names[which]} | {loss.away:.3f} | {near} | {errors} |")
            print(f"{shape}, {grain}: estimated", flush=True)
    return "\n".join(lines) + "\n"


def draw(path, meshes) -> None:
    """Stripes along u on every mesh (a column each) by every way (a row each)."""
    figure, axes = pyplot.subplots(
        len(WAYS), len(meshes), figsize=(1.75 * len(meshes), 1.8 * len(WAYS)), dpi=120, layout="constrained"
    )
    figure.get_layout_engine().set(w_pad=0.01, h_pad=0.01, wspace=0, hspace=0)
    for column, (name, (mesh, mappings, _)) in zip(axes.T, meshes.items(), strict=True):
        column[0].set_title(name, fontsize=10)
        for place, way in zip(column, WAYS, strict=True):
            place.set(xticks=[], yticks=[])
            place.spines[:].set_visible(False)
            if name == next(iter(meshes)):
                place.set_ylabel(WAYS[way], fontsize=10)
            if way in mappings:
                place.imshow(striped(mesh, mappings[way]), interpolation="antialiased")
            else:
                place.text(0.5, 0.5, "none", ha="center", va="center", transform=place.transAxes, color="#888888")
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path)
    pyplot.close(figure)


def striped(mesh, uv) -> np.ndarray:
    """(h, w, 3) uint8: dark and light stripes that run along u, warm and cool squares along them, lit from the eye."""
    scene = PreparedScene(mapping_light.job_with(mesh, uv, size=PICTURE), Reporter())
    points = scene.points(0, region=scene.view.mesh == 0, textured=True)
    light = 0.25 + 0.75 * np.clip((points.normal * points.to_eye).sum(1), 0, 1)[:, None]
    across = (np.floor(points.uv[:, 1] / (STRIPE / 2)) % 2)[:, None]
    along = (np.floor(points.uv[:, 0] / (2 * STRIPE)) % 2)[:, None]
    colour = np.where(across > 0, np.where(along > 0, [0.93, 0.86, 0.72], [0.72, 0.83, 0.93]), [0.16, 0.22, 0.32])
    out = np.ones((*scene.view.mesh.shape, 3))
    out[points.pixels[:, 0], points.pixels[:, 1]] = colour * light
    smaller = out.reshape(PICTURE // 3, 3, PICTURE // 3, 3, 3).mean((1, 3))
    rows, columns = (np.flatnonzero((smaller < 1).any((2, k))) for k in (1, 0))
    return (255 * smaller[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]).astype(np.uint8)
