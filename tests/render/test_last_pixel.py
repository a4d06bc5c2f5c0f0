# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera that is a pixel off comes back by the photo's own edges; one that is in place stays."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.fit.pose import Gain
from btfsep_engine.imaging import images
from btfsep_engine.pipeline.aligner import Aligner
from btfsep_engine.pipeline.alignment import Look, align, first_look
from btfsep_engine.pipeline.marks import grown
from btfsep_engine.pipeline.mending import doubted, mended, mends
from btfsep_engine.pipeline.settings import choose
from scripts.studies.stage import write_job
from tests.render.scenes import looking_down, scene_of
from tests.render.test_alignment import away, off_by, photographed, potato

FINE = 3  # points along a pixel's edge of which it is the mean


def taken(folder, shape, *, size: float = 1.0):
    """A scene whose photo is the mean of finer ones, so that edges pass through pixels; ``size`` : of what it shows,
    over the job's shape."""
    shown = shape.copy()
    shown.vertices *= size
    fine = photographed(folder / "fine", shown, size=96 * FINE, focal=200.0 * FINE).job.photo.radiance
    write_job(folder / "job", shape, looking_down(96, 200.0), mesh="shape.ply", metres=0.05, name="shape")
    photo = fine.reshape(96, FINE, 96, FINE, 3).mean((1, 3))
    images.write_exr(folder / "job" / "photo.exr", photo.astype(np.float32))
    return scene_of(folder / "job")


@pytest.fixture(scope="module")
def potatoes(tmp_path_factory):
    return taken(tmp_path_factory.mktemp("potato"), potato())


@pytest.mark.parametrize(
    "moved", [(0, 0, 0, 0.9, -0.4, 0, 0), (0, 0, 0, -0.7, 0.7, 0, 0), (0.3, -0.2, 0.3, 0.5, 1, 0, 0)]
)
def test_a_pixel_is_found_and_taken_by_an_estimate(potatoes, moved):
    start = off_by(potatoes, moved)
    assert first_look(start).settles
    found = align(start)
    assert found.settled and found.aligned and mends(start, found)
    assert "edges lay beside the outlines" in found.why
    assert away(potatoes, found.camera) < 0.3 * away(potatoes, start.job.camera)
    moved_scene = mended(start, choose())
    assert moved_scene.in_place and not start.in_place
    assert away(potatoes, moved_scene.job.camera) < 0.3 * away(potatoes, start.job.camera)
    assert any("for this estimate the camera is moved" in said for said in start.reporter.warnings)


@pytest.mark.parametrize("moved", [(0, 0, 0, 0, 0, 0, 0), (0, 0, 0, 0.2, -0.15, 0, 0)])
def test_what_is_in_place_stays(potatoes, moved):
    start = off_by(potatoes, moved)
    look = first_look(start)
    assert not look.settles and not look.off and not doubted(start)
    assert mended(start, choose()) is start and start.in_place
    for asked in ("never", "outline"):  # nobody has looked
        assert not mended(off_by(potatoes, moved), choose(align=asked)).in_place


def test_many_edges_are_believed_of_less():
    assert Look(beside=0.65, edges=5).settles and Look(beside=0.5, edges=17).settles
    assert not any(look.settles for look in (Look(beside=0.55, edges=12), Look(beside=0.4, edges=40), Look()))
    assert Look(beside=0.2, edges=8).in_place
    assert not any(look.in_place for look in (Look(), Look(True, 0.2, 8), Look(beside=0.4, edges=8)))


def test_an_object_that_is_a_little_larger_moves_nothing(tmp_path):
    """All its edges lie farther out, by as much: that is its rim, or its size, and no other place."""
    larger = taken(tmp_path, trimesh.creation.icosphere(5), size=1.03)
    found = Aligner(larger).settle(np.zeros(7), hold=0.1)
    assert found.excess < 0.35  # the edges lie 0.6 pixels farther out
    assert np.abs(found.q[3:5]).max() < 0.1
    assert not first_look(larger).settles


def test_the_turn_of_a_ball_stays(tmp_path):
    """Nothing in a picture of a smooth ball says how it is turned."""
    ball = taken(tmp_path, trimesh.creation.icosphere(5))
    start = off_by(ball, (0, 0, 0, 1.0, -0.6, 0, 0))
    found = align(start)
    assert found.settled
    assert found.degrees < 0.5
    assert np.linalg.norm(found.camera.project(np.zeros((1, 3))) - ball.job.camera.width / 2) < 0.25


def test_edges_of_other_things_move_nothing(potatoes):
    """Blotches all over the picture, stronger than the object is before the wall."""
    spots = np.kron(np.random.default_rng(5).uniform(0.05, 1.0, (32, 32)), np.ones((3, 3)))[..., None]
    scene = scene_of(potatoes.job)
    photo = np.repeat(spots, 3, 2).astype(np.float32)
    scene.job = replace(scene.job, photo=replace(scene.job.photo, radiance=photo))
    found = align(scene)
    assert not (found.settled and found.aligned)


def test_a_few_edges_of_something_behind_are_outvoted(potatoes):
    """A bright thing that ends two pixels beside a part of the outline."""
    scene, seen = scene_of(potatoes.job), potatoes.view.mesh == 0
    photo = potatoes.job.photo.radiance.copy()
    rows, columns = np.mgrid[:96, :96]
    bright = ~grown(seen, 2) & (columns > rows + 32)
    photo[bright] = 3.0
    scene.job = replace(scene.job, photo=replace(scene.job.photo, radiance=photo))
    aligner = Aligner(scene)
    beside = aligner.edges.beside(*along(aligner))[0]
    assert (beside > 1.0).mean() > 0.06
    found = aligner.settle(np.zeros(7), hold=0.1)
    assert np.abs(found.q[3:5]).max() < 0.12


def along(aligner):
    """Where an aligner's outlines lie in its picture, and the ways across them."""
    misfit = aligner.misfit(np.zeros(7), 2)
    return aligner.job.camera.project(misfit.outline), misfit.across


def test_where_outlines_tell_nothing_shading_does(potatoes):
    """No edge is known: the objects' shading alone leads a part of the way, against the hold."""
    start = off_by(potatoes, (0, 0, 0, 1.0, -0.6, 0, 0))
    aligner = Aligner(start)
    aligner.edges.usable[:] = 0
    found = aligner.settle(np.zeros(7), hold=0.2)
    assert found.edges == 0
    assert away(potatoes, aligner.frame.at(found.q)) < 0.6 * away(potatoes, start.job.camera)


@pytest.mark.parametrize("spoken", [{"gain": Gain(-0.01, -0.01, -1.0, -1.0)}, {"asks": True}])
def test_edges_alone_move_nothing_against_outlines_and_shading(potatoes, monkeypatch, spoken):
    aligner = Aligner(off_by(potatoes, (0, 0, 0, 0.9, -0.4, 0, 0)))
    assert aligner.nearby() is not None
    for name, word in spoken.items():
        monkeypatch.setattr(aligner, name, lambda q, word=word: word)
    assert aligner.nearby() is None


def test_a_search_ends_on_the_edges(potatoes):
    """What outlines and shading lead to from afar lies up to a pixel beside the true place; edges bring it back."""
    start = off_by(potatoes, (0, 1, -2, 10, 9, 2, 0))
    aligner = Aligner(start)
    q, left = aligner.search(aligner.left(np.zeros(7)))
    assert aligner.settle(q, hold=0.1).excess < 0.15
    assert away(potatoes, aligner.frame.at(q)) < 0.5
    assert left.outline < aligner.left(np.zeros(7)).outline


def test_a_picture_that_is_mostly_black_is_looked_at_as_any_other(potatoes):
    """An object of which a lamp lights a third, before nothing: as floats, all else is 0."""
    start, photo = off_by(potatoes, (0, 0, 0, 1.5, -1.0, 0, 0)), potatoes.job.photo.radiance.copy()
    photo[potatoes.view.mesh < 0] = 0
    photo[:, :60] = 0
    start.job = replace(start.job, photo=replace(start.job.photo, radiance=photo))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        first_look(start)
        found = align(start)
    assert np.isfinite(found.camera.to_world).all()
    assert found.before is not None and np.isfinite([found.before.outline, found.before.shading]).all()


def test_a_draft_does_not_look_for_a_pixel(potatoes):
    start = off_by(potatoes, (0, 0, 0, 0.9, -0.4, 0, 0))
    assert mended(start, choose("draft")) is start
