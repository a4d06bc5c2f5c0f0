# SPDX-License-Identifier: GPL-3.0-or-later
"""`btfsep align` of a job with a depth: its photo is shifted back, and nothing else is moved."""

import json

import numpy as np
import pytest

from btfsep_engine.commands.align import OVERLAY, RESULT, run_align
from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.job.load import load_job
from btfsep_engine.pipeline.alignment import align, with_camera
from btfsep_engine.pipeline.mending import mends
from btfsep_engine.progress import Reporter
from scripts.studies.depth import frayed, z_depth
from tests.render.scenes import edited, off_as_seen, positive_light, scene_of
from tests.render.test_alignment import estimated, photographed, potato

NEAR = 0.7  # pixels: the tests' photos have hard edges, of which no pixel shows where in it they lie


@pytest.fixture(scope="module")
def potatoes(tmp_path_factory):
    return photographed(tmp_path_factory.mktemp("potato"), potato())


def shifted(scene, folder, right: int, down: int, *, depth=None, edge=1, **told):
    """Writes a job of the scene's depth, whose photo is shifted by whole pixels, and its folder.

    ``edge`` : how many pixels there are for each of the scene's, along an edge
    """
    depth = z_depth(scene) if depth is None else depth
    image = np.roll(scene.job.photo.radiance, (down, right), (0, 1))
    files = {"photo.exr": image, "depth.exr": depth[..., None].repeat(3, -1).astype(np.float32)}
    folder.mkdir(exist_ok=True)
    for name, pixels in files.items():
        images.write_exr(folder / name, pixels.repeat(edge, 0).repeat(edge, 1))
    images.write_png(folder / "mask.png", 255 * (depth > 0)[..., None].repeat(3, -1).astype(np.uint8))
    surface = {"name": "potato", "mesh": None, "mask": "mask.png" if edge == 1 else None}
    camera = {k: edge * getattr(scene.job.camera, k) for k in ("width", "height", "fx", "fy", "cx", "cy")}
    edited(scene.job.folder, to=folder, camera=camera, depth="depth.exr", objects=[surface], **told)
    return folder


@pytest.mark.parametrize("way", [(3, -2), (-9, 5), (11, 11)])
def test_a_photo_that_is_shifted_comes_back(potatoes, tmp_path, way):
    scene = scene_of(shifted(potatoes, tmp_path / "job", *way))
    found = align(scene)
    assert found.aligned
    assert found.shift == pytest.approx(way, abs=NEAR)
    assert found.moved_px == pytest.approx(np.hypot(*found.shift), rel=1e-6)
    assert (found.degrees, found.focal_percent) == (0, 0)
    np.testing.assert_array_equal(found.camera.to_world, scene.job.camera.to_world)


def test_a_large_photo_is_looked_at_without_a_bias(potatoes, tmp_path):
    """Blocks of pixels stand for one; an even block's middle is no pixel's."""
    found = align(scene_of(shifted(potatoes, tmp_path / "job", 2, -1, edge=6)))
    assert found.shift == pytest.approx((12, -6), abs=1.0)


@pytest.mark.parametrize("worse", [None, frayed])
def test_what_is_in_place_stays(potatoes, tmp_path, worse):
    depth = worse and worse(z_depth(potatoes), np.random.default_rng(1))
    found = align(scene_of(shifted(potatoes, tmp_path / "job", 0, 0, depth=depth)))
    assert not found.aligned
    assert found.shift == (0, 0)
    assert "left as it is" in found.why


def test_the_command_writes_a_job_that_is_shifted(potatoes, tmp_path):
    folder = shifted(potatoes, tmp_path / "job", 5, -3)
    result = run_align(folder, reporter=Reporter())
    assert result["aligned"]
    assert result["depth_shift"] == pytest.approx((5, -3), abs=NEAR)
    assert json.loads((folder / "aligned" / RESULT).read_text())["depth_shift"] == list(result["depth_shift"])
    for name in ("photo.exr", "depth.exr", "mask.png"):
        assert (folder / "aligned" / name).read_bytes() == (folder / name).read_bytes()
    told, new = (json.loads((f / "job.json").read_text()) for f in (folder, folder / "aligned"))
    assert new == told | {"depth_shift": list(result["depth_shift"])}
    picture = images.read_linear(folder / "aligned" / OVERLAY).pixels
    red, green = picture[..., 0] - picture[..., 1] > 0.8, picture[..., 1] - picture[..., 0] > 0.8
    rows, columns = (np.argwhere(green).mean(0) - np.argwhere(red).mean(0)).tolist()
    assert (columns, rows) == pytest.approx((5, -3), abs=1.5)
    again = run_align(folder / "aligned", reporter=Reporter())
    assert not again["aligned"]
    written = load_job(folder / "aligned")
    in_memory = with_camera(scene_of(folder), written.camera).job.objects[0]
    np.testing.assert_array_equal(in_memory.mask, written.objects[0].mask)
    assert (in_memory.mask != load_job(folder).objects[0].mask).any()


def test_a_shifted_depth_is_the_same_surface_elsewhere_in_the_photo(potatoes, tmp_path):
    there = load_job(shifted(potatoes, tmp_path / "a", 0, 0))
    shown = scene_of(shifted(potatoes, tmp_path / "b", 0, 0, depth_shift=[7.0, -4.0]))
    np.testing.assert_array_equal(shown.job.objects[0].mesh.vertices, there.objects[0].mesh.vertices)
    np.testing.assert_array_equal(shown.job.objects[0].mask, np.roll(there.objects[0].mask, (-4, 7), (0, 1)))
    seen = scene_of(there).view.mesh == 0
    assert (np.roll(seen, (-4, 7), (0, 1)) != (shown.view.mesh == 0)).mean() < 0.002
    again = run_align(tmp_path / "b", reporter=Reporter())  # the photo is in the depth's place
    assert again["depth_shift"] == pytest.approx((-7, 4), abs=NEAR)
    assert load_job(tmp_path / "b" / "aligned").camera.cx == pytest.approx(there.camera.cx, abs=NEAR)


def test_a_shift_without_a_depth_is_refused(potatoes, tmp_path):
    folder = shifted(potatoes, tmp_path / "job", 0, 0, depth_shift=[1.0])
    with pytest.raises(InputError, match="depth_shift; it has 1 entries; it needs at least 2"):
        load_job(folder)
    edited(folder, depth=None, depth_shift=[1.0, 0.0])
    with pytest.raises(InputError, match="depth_shift; the job has no depth"):
        load_job(folder)


def test_an_estimate_mends_a_small_shift(potatoes, tmp_path):
    folder = shifted(potatoes, tmp_path / "job", 3, -2)
    left, light, doubts = estimated(folder, "never")
    assert any("do not line up" in doubt for doubt in doubts)
    assert "alignment" not in left["photos"][0]
    mended, better, said = estimated(folder, "auto")
    assert any("the photo is shifted against the depth by " in word for word in said)
    assert mended["photos"][0]["alignment"]["depth_shift"] == pytest.approx((3, -2), abs=NEAR)
    truth = positive_light(2)
    assert off_as_seen(better, truth) < 0.7 * off_as_seen(light, truth)


@pytest.mark.parametrize("way", [(0, 0), (6, 5)])
def test_an_estimate_mends_neither_what_is_in_place_nor_what_is_far_off(potatoes, tmp_path, way):
    scene = scene_of(shifted(potatoes, tmp_path / "job", *way))
    found = align(scene)
    assert found.aligned == any(way)
    assert not mends(scene, found)
