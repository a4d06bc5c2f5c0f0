# SPDX-License-Identifier: GPL-3.0-or-later
"""`btfsep align`: a camera that is a little off comes back, one that is in place stays."""

import json
import warnings
from dataclasses import replace
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter

from btfsep_engine import sh
from btfsep_engine.btf.library import open_library
from btfsep_engine.commands.align import OVERLAY, RESULT, run_align
from btfsep_engine.commands.estimate import run_estimate
from btfsep_engine.errors import InputError
from btfsep_engine.fit.pose import Frame
from btfsep_engine.imaging import images
from btfsep_engine.job.load import load_job
from btfsep_engine.job.model import Occluder
from btfsep_engine.light.files import read_lighting
from btfsep_engine.pipeline.aligner import Aligner
from btfsep_engine.pipeline.alignment import align, camera_keys, looks_off, with_camera
from btfsep_engine.pipeline.checks import shift_doubt
from btfsep_engine.pipeline.mending import doubted, mends
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from scripts.studies.stage import write_job
from tests.render.scenes import as_mesh, edited, looking_down, off_as_seen, positive_light, scene_of


def potato():
    """No turn of it looks like another."""
    shape = trimesh.creation.icosphere(5)
    x, y, z = shape.vertices.T
    shape.vertices *= (0.75 + 0.2 * np.sin(2.5 * x + 1) * np.cos(3 * y) + 0.12 * np.sin(4 * z + 2 * x))[:, None]
    return shape


def photographed(folder, shape, *, size=96, focal=200.0, seed=0, **lens):
    """Writes a job of a white shape before an uneven wall, shaded in closed form, and gives it as a scene."""
    camera, x = looking_down(size, focal), positive_light(2)
    write_job(folder, shape, camera, mesh="shape.ply", metres=0.05, name="shape")
    edited(folder, camera=lens)
    scene = scene_of(load_job(folder, with_photo=False))
    rows, columns = np.mgrid[: camera.height, : camera.width]
    wall = 0.12 + 0.03 * np.sin(columns / 17) * np.cos(rows / 11)
    image = np.repeat(wall[..., None], 3, 2)
    seen = scene.view.mesh == 0
    points = scene.points(0, region=seen, textured=False)
    image[seen] = 0.8 / np.pi * sh.irradiance(x, points.normal)
    image *= 1 + 0.01 * np.random.default_rng(seed).normal(size=image.shape)
    images.write_exr(folder / "photo.exr", image.astype(np.float32))
    return scene_of(folder)


def frame_of(scene) -> Frame:
    return Frame(scene.job.camera, np.zeros(3), float(np.sqrt((scene.view.mesh >= 0).sum() / np.pi)))


def off_by(scene, pixels):
    """The scene with a camera that seven numbers, in pixels, have moved."""
    lens = frame_of(scene).at(pixels)
    return with_camera(scene, replace(scene.job.camera, fx=lens.fx, fy=lens.fy, to_world=lens.to_world))


def away(scene, camera) -> float:
    """Mean way in pixels of what the true camera sees."""
    points = scene.points(0, textured=False).position
    return np.linalg.norm(camera.project(points) - scene.job.camera.project(points), axis=1).mean()


@pytest.fixture(scope="module")
def potatoes(tmp_path_factory):
    return photographed(tmp_path_factory.mktemp("potato"), potato())


@pytest.mark.parametrize("moved", [(0, 0, 1.5, 3, -2, 0, 0), (1.5, -1, 0, -8, 5, 0, 0), (0, 1, -2, 10, 9, 2, 0)])
def test_a_camera_that_is_off_comes_back(potatoes, moved):
    start = off_by(potatoes, moved)
    found = align(start)
    assert found.aligned
    assert away(potatoes, found.camera) < 0.18 * away(potatoes, start.job.camera)
    assert found.moved_px == pytest.approx(away(potatoes, start.job.camera), rel=0.1)


@pytest.mark.parametrize("lens", [{"k1": -0.5, "k2": 0.1, "p1": 0.02}, {"projection": "orthographic", "focal": 45.0}])
def test_other_cameras_come_back(tmp_path, lens):
    shown = photographed(tmp_path, potato(), **lens)
    start = off_by(shown, (1.5, -1, 0, -8, 5, 0, 0))
    found = align(start)
    assert away(shown, found.camera) < 0.15 * away(shown, start.job.camera)
    assert found.camera.distortion == shown.job.camera.distortion


def test_what_is_in_place_stays(potatoes):
    found = align(potatoes)
    assert not found.aligned
    assert "left as it is" in found.why
    assert found.camera is potatoes.job.camera


def test_the_way_to_a_worse_place_is_a_loss(potatoes):
    """The way from a better place is a loss, and hardly any way is neither."""
    off = off_by(potatoes, (0, 0, 0, 2, -1, 0, 0))
    back = np.array([0, 0, 0, -2.0, 1.0, 0, 0])
    gain = Aligner(off).gain(back)
    assert gain.outline > 0.02
    assert gain.shading > 0.02
    assert gain.significance > 2
    loss = Aligner(potatoes).gain(-back)
    assert loss.outline < -0.01
    assert loss.shading < -0.01
    assert loss.significance < -2
    still = Aligner(potatoes).gain(0.05 * back)
    assert abs(still.outline + still.shading) < 0.1 * (gain.outline + gain.shading)


def test_the_turn_of_a_ball_stays(tmp_path):
    """Nothing in a picture of a smooth ball says how it is turned."""
    ball = photographed(tmp_path, trimesh.creation.icosphere(5))
    found = align(off_by(ball, (0, 0, 0, 6, -4, 0, 0)))
    assert found.aligned
    assert found.degrees < 1.5
    assert np.linalg.norm(found.camera.project(np.zeros((1, 3))) - ball.job.camera.width / 2) < 0.7


@pytest.mark.parametrize("barer", [True, False])
def test_no_move_leaves_more_of_the_outlines_without_an_edge(potatoes, monkeypatch, barer):
    """However much better the shading goes: of what is overexposed there is none."""
    start = off_by(potatoes, (0, 0, 0, 8, 5, 0, 0))
    before = Aligner(start).left(np.zeros(7))
    q, after = Aligner(start).search(before)
    after = replace(after, outline=before.outline + (0.05 if barer else -0.05))
    monkeypatch.setattr(Aligner, "search", lambda *_: (q, after))
    monkeypatch.setattr(Aligner, "nearby", lambda _: None)
    found = align(start)
    assert found.gain.outline > 0 and found.gain.significance > 3 and found.aligned == (not barer)


def test_no_outline_in_the_picture(tmp_path):
    """An object that fills the picture."""
    full = photographed(tmp_path, trimesh.creation.icosphere(5), focal=900.0)
    found = align(full)
    assert not found.aligned
    assert "too little" in found.why
    assert found.before is None


def test_cut_by_the_frame(tmp_path):
    """The frame is no outline: what lies half outside comes back to where it was, and not to the middle."""
    shape = potato()
    shape.apply_translation([0.75, 0, 0])
    cut = photographed(tmp_path, shape)
    assert (cut.view.mesh[:, -1] >= 0).sum() > 20
    start = off_by(cut, (0, 0, 0, 4, 3, 0, 0))
    assert away(cut, align(start).camera) < 0.35 * away(cut, start.job.camera)


def test_a_photo_without_edges_moves_nothing(potatoes):
    flat = scene_of(potatoes.job)
    even = np.full_like(potatoes.job.photo.radiance, 0.2)
    flat.job = replace(flat.job, photo=replace(flat.job.photo, radiance=even))
    assert not align(flat).aligned


def job_off_by(scene, pixels, folder):
    """The scene's job folder anew, with a camera that seven numbers, in pixels, have moved."""
    source = scene.job.folder
    folder.mkdir()
    edited(source, to=folder, camera=camera_keys(off_by(scene, pixels).job.camera))
    for name in ("photo.exr", "shape.ply"):
        (folder / name).write_bytes((source / name).read_bytes())
    return folder


def test_what_texture_draws_is_no_gain(potatoes):
    """Blotches on object and wall have edges of their own, but no place nearby goes better."""
    blotches = gaussian_filter(np.random.default_rng(1).normal(size=potatoes.view.mesh.shape), 2.0)
    photo = potatoes.job.photo.radiance * np.exp(0.3 / blotches.std() * blotches)[..., None]
    blotched = scene_of(potatoes.job)
    blotched.job = replace(blotched.job, photo=replace(blotched.job.photo, radiance=photo.astype(np.float32)))
    found = align(blotched)
    assert abs(found.gain.outline + found.gain.shading) < 0.01
    assert found.gain.significance < 3
    assert not found.aligned


def test_the_command_writes_a_job_that_can_be_used(potatoes, tmp_path):
    folder = job_off_by(potatoes, (0, 0, 1, 5, -3, 0, 0), tmp_path / "job")
    result = run_align(folder, reporter=Reporter())
    assert result["aligned"]
    assert result["objective"]["after"]["outline"] < result["objective"]["before"]["outline"]
    assert result["gain"]["outline"] > 0
    assert result["gain"]["significance"] > 3
    again = load_job(folder / "aligned")
    assert away(potatoes, again.camera) < 0.6
    assert json.loads((folder / "aligned" / RESULT).read_text())["moved_px"] == result["moved_px"]
    picture = images.read_linear(folder / "aligned" / OVERLAY).pixels
    red, green = picture[..., 0] - picture[..., 1] > 0.8, picture[..., 1] - picture[..., 0] > 0.8
    assert red.sum() > 30
    assert green.sum() > 30
    with pytest.raises(InputError, match="the job's own folder"):
        run_align(folder, out=folder, reporter=Reporter())


def estimated(folder, align):
    """What an estimate of a white job finds: its result, its light, and what it warned of."""
    told, reporter = choose("draft", pixels=800, align=align, key_light="never"), Reporter()
    name = "reference/white-diffuse"
    result = run_estimate(folder, open_library(None), told, material=name, with_report=False, reporter=reporter)
    return result, read_lighting(result["lighting"]).coefficients, reporter.warnings


def test_an_estimate_mends_what_its_own_doubt_speaks_of(potatoes, tmp_path):
    folder = job_off_by(potatoes, (0, 1, 0, 3, -2, 0, 0), tmp_path / "job")
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    left, light, doubts = estimated(folder, "never")
    assert any("do not line up" in doubt for doubt in doubts)
    assert "alignment" not in left["photos"][0]
    mended, better, said = estimated(folder, "auto")
    assert [word for word in said if "for this estimate the camera is moved" in word]
    assert not any("do not line up: the outlines" in word for word in said)
    assert away(potatoes, replace(potatoes.job.camera, **kept_camera(mended))) < 0.6
    truth = positive_light(2)
    assert off_as_seen(better, truth) < min(off_as_seen(light, truth), 0.04)  # unmended it knows of a shift
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == files


def kept_camera(result) -> dict:
    """The camera of the first photograph in ``result.json``."""
    kept = result["photos"][0]["alignment"]["camera"]
    return kept | {"to_world": np.array(kept["to_world"])}


def test_an_estimate_leaves_what_is_in_place(potatoes, tmp_path):
    result, _, said = estimated(job_off_by(potatoes, (0, 0, 0, 0, 0, 0, 0), tmp_path / "job"), "auto")
    assert "alignment" not in result["photos"][0]
    assert not any("do not line up" in word for word in said)


@pytest.mark.parametrize("moved", [(0, 0, 0, 10, 8, 0, 0), (5, -5, 3, 0, 0, 0, 0)])
def test_an_estimate_mends_what_is_far_off_and_what_is_turned(potatoes, tmp_path, moved):
    folder = job_off_by(potatoes, moved, tmp_path / "job")
    mended, light, said = estimated(folder, "auto")
    assert [word for word in said if "for this estimate the camera is moved" in word]
    start = off_by(potatoes, moved).job.camera
    assert away(potatoes, replace(start, **kept_camera(mended))) < 0.5 * away(potatoes, start)
    assert off_as_seen(light, positive_light(2)) < 0.06


@pytest.mark.parametrize(
    "moved, off",
    [
        ((0, 0, 0, 0, 0, 0, 0), False),
        ((0.4, 0, 0, 0.5, 0, 0, 0), False),
        ((5, -5, 3, 0, 0, 0, 0), True),
        ((0, 0, 0, -6, 4, 0, 0), True),
    ],
)
def test_the_first_look_tells_a_camera_that_is_off_from_one_in_place(potatoes, moved, off):
    assert looks_off(off_by(potatoes, moved)) == off


@pytest.mark.parametrize("spoilt", ["black", "transparent", "nearly all transparent"])
def test_of_a_photo_that_shows_nothing_nothing_is_moved(potatoes, spoilt):
    scene, photo = off_by(potatoes, (0, 0, 0, -6, 4, 0, 0)), potatoes.job.photo
    usable = photo.usable & (np.arange(photo.usable.shape[1]) > (83 if spoilt.startswith("nearly") else 1000))
    changed = {"radiance": 0 * photo.radiance} if spoilt == "black" else {"usable": usable}
    scene.job = replace(scene.job, photo=replace(photo, **changed))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not looks_off(scene) and not align(scene).aligned


def test_a_place_about_which_outlines_waver_is_one_and_one_that_goes_on_is_none(potatoes, monkeypatch):
    """Each set of marks says another tenth of a pixel; what they agree on is the middle."""
    aligner, start = Aligner(potatoes), np.zeros(7)
    place, aside = np.array([0, 0, 0, 1, -1, 0, 0]), np.array([0, 0, 0, 0.2, 0, 0, 0])

    def settling(to):
        calls = count()
        monkeypatch.setattr(aligner, "settle", lambda q, **_: SimpleNamespace(q=to(q, next(calls))))
        return aligner.at_rest(start, about=start, hold=0.1)

    found, rests = settling(lambda q, i: place + (-1) ** i * aside)
    assert rests and np.abs(found - place).max() < 0.15
    assert not settling(lambda q, i: q + place)[1]


def test_a_draft_looks_at_the_outline_alone(potatoes):
    turned, aside = off_by(potatoes, (5, -5, 3, 0, 0, 0, 0)), off_by(potatoes, (0, 0, 0, -6, 4, 0, 0))
    assert choose("draft").align == "outline" and choose().align == "auto"
    assert doubted(aside, "outline") and not doubted(turned, "outline") and doubted(turned)


def test_no_estimate_moves_a_camera_farther_than_an_alignment_is_sure_of(potatoes):
    scene = off_by(potatoes, (0, 0, 0, 10, 8, 0, 0))
    found = align(scene)
    assert mends(scene, found)
    assert not mends(scene, replace(found, moved_px=25.0)) and not mends(scene, replace(found, degrees=25.0))
    assert not mends(scene, replace(found, aligned=False))


def test_shading_alone_moves_no_camera_whose_outlines_are_in_place(potatoes):
    scene = off_by(potatoes, (5, -5, 3, 0, 0, 0, 0))
    found = align(scene)
    assert shift_doubt(scene) is None and mends(scene, found)
    assert not mends(scene, replace(found, gain=replace(found.gain, outline=0.01)))


def test_a_tables_edge_says_nothing_of_where_the_objects_lie(tmp_path):
    scene = photographed(tmp_path, potato(), size=160, focal=100.0)
    slab = trimesh.creation.box([20, 20, 0.02]).apply_translation([0, 10, -2])  # its edge crosses the picture
    scene = scene_of(replace(scene.job, occluders=(Occluder(as_mesh(slab, flat=True), None),)))
    table = scene.view.mesh == 1
    assert table[:, [0, -1]].any(0).all() and not table.all()
    said = []
    for right, down in ((6, 0), (0, 0), (0, 4)):  # of the whole photo; of the table's edge alone
        photo = scene.job.photo.radiance.copy()
        photo[np.roll(table, down, 0) & (scene.view.mesh != 0)] = 5.0
        moved = replace(scene.job.photo, radiance=np.roll(photo, right, 1))
        said.append(shift_doubt(scene_of(replace(scene.job, photo=moved))))
    assert "6 to the right" in said[0] and said[1:] == [None, None]
