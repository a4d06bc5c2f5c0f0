# SPDX-License-Identifier: GPL-3.0-or-later
"""A ground that the job does not have and the photo shows: found by the objects' shadow, and no other way."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.imaging import images
from btfsep_engine.job.depth import closing_mesh, mesh_from_depth
from btfsep_engine.job.model import Camera, JobObject, Occluder
from btfsep_engine.light.files import read_lighting
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline import estimation, standing
from btfsep_engine.pipeline.estimation import estimate, found_light
from btfsep_engine.pipeline.materials import materials_of_all
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.standing import NEAR, STANDING, ground_under, on_ground, shown_up_to, with_plane
from btfsep_engine.render.reference import Reference
from btfsep_engine.render.surface import surface_points
from scripts.studies.depth import z_depth
from scripts.studies.ground import above
from scripts.studies.stage import write_job
from tests.render.scenes import answer, as_mesh, ball, edited, job_of, positive_light, scene_of, with_photo

WHITE = "reference/white-diffuse"
COLOUR = (0.6, 0.4, 0.25)
SIZE = 96


def from_above(x=0.0, y=-6.0, z=3.0, *, orthographic=False) -> Camera:
    """A camera that looks at the origin, which a unit ball fills a third of."""
    back = np.array([x, y, z]) / np.linalg.norm([x, y, z])
    right = np.cross([0, 0, 1.0], back)
    right /= np.linalg.norm(right)
    to_world = np.eye(4)
    to_world[:3, :3], to_world[:3, 3] = np.stack([right, np.cross(back, right), back], 1), (x, y, z)
    focal = SIZE / 6 if orthographic else SIZE
    return Camera(SIZE, SIZE, focal, focal, SIZE / 2, SIZE / 2, to_world, orthographic=orthographic)


def a_job(camera=None, *, floor=(), meshes=()):
    job = job_of(meshes or [ball()], camera or from_above(), occluders=floor)
    return replace(job, objects=tuple(replace(o, material=WHITE) for o in job.objects))


def a_table(height=-1.0, half=4.0, surface=None) -> Occluder:
    box = trimesh.creation.box([2 * half, 2 * half, 0.02]).apply_translation([0, 0, height - 0.01])
    return Occluder(as_mesh(box, flat=True), surface)


def path_traced(job, light, *, samples=128) -> np.ndarray:
    """What the camera of a job sees under a light (terms, 3), with three reflections; black where nothing is."""
    scene, image = scene_of(job), np.zeros((SIZE, SIZE, 3), np.float32)
    rows, columns = np.nonzero(scene.view.mesh >= 0)
    reference = Reference(job, scene.tracer, [open_library(None).load(WHITE)] * len(job.objects), bounces=4)
    seen = reference.radiance(np.stack([rows, columns], 1), SHLighting(light), samples=samples)
    image[rows, columns] = seen.radiance[:, 0]
    return image


@pytest.fixture(scope="module")
def standing_ball():
    """The job of a ball of which the photo shows that it stands on a table; the job has none. And the light."""
    light = positive_light(2)
    table = a_table(surface=Surface(COLOUR, roughness=1.0, specular=0.0))
    return with_photo(a_job(), path_traced(a_job(floor=[table]), light)), light


def off_above(x, truth) -> float:
    """Relative error of what comes from above of a light (terms, 3), with one free scale."""
    x, true = above(x), above(np.pad(truth, ((0, 91), (0, 0))))
    return float(np.linalg.norm(x * (x * true).sum() / (x * x).sum() - true) / np.linalg.norm(true))


def looked(job) -> float:
    scene, ground = scene_of(job), ground_under(job.objects)
    return shown_up_to(scene.with_occluder(ground, with_plane(scene.view, job, ground), met=False), ground)


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("place", [(0.0, -6.0, 3.0), (5.0, 2.0, 1.5), (-1.0, 0.5, 7.0)])
def test_the_plane_is_where_rays_meet_it(place, orthographic):
    job = a_job(from_above(*place, orthographic=orthographic))
    scene, ground = scene_of(job), ground_under(job.objects)
    found, traced = with_plane(scene.view, job, ground), scene_of(replace(job, occluders=(ground,)))
    seen = found.mesh == 1
    assert seen.sum() > 1000 and (traced.view.mesh[seen] == 1).all()
    points, true = (surface_points(v, traced.job, 1, region=seen) for v in (found, traced.view))
    np.testing.assert_allclose(points.position, true.position, atol=0.01)  # a tenth of a pixel
    np.testing.assert_allclose(found.distance[seen], traced.view.distance[seen], rtol=3e-3)
    assert (points.normal == [0, 0, 1]).all() and np.allclose(points.position[:, 2], -1, atol=1e-3)
    near = np.linalg.norm(points.position[:, :2], axis=1)
    assert near.max() < 4 and (traced.view.mesh[~seen] != 0).sum() == ((scene.view.mesh < 0) & ~seen).sum()
    np.testing.assert_array_equal(found.mesh == 0, scene.view.mesh == 0)


def test_a_table_is_found_by_the_shadow_on_it_and_has_its_colour(standing_ball):
    job, light = standing_ball
    assert looked(job) == NEAR[0]
    found = estimate(scene_of(job), open_library(None), choose("balanced", pixels=600))
    assert found.choice["standing"] == STANDING
    (ground,) = found.scene.job.occluders
    assert ground.supposed and np.allclose(ground.mesh.vertices[:, 2], -1, atol=1e-3)
    np.testing.assert_allclose(found.scene.occluder_albedos[0], COLOUR, rtol=0.15)
    without = estimate(scene_of(job), open_library(None), choose("balanced", pixels=600, evidence="job"))
    assert "standing" not in without.choice and not without.scene.job.occluders
    errors = [off_above(one.fit.all_coefficients, light) for one in (found, without)]
    assert errors[0] < min(0.1, 0.7 * errors[1])


def test_of_a_small_table_less_is_believed_to_be_of_it(standing_ball):
    job, light = standing_ball
    table = a_table(half=3.0, surface=Surface(COLOUR, roughness=1.0, specular=0.0))
    photo = path_traced(a_job(floor=[table]), light)
    checks = np.indices((SIZE, SIZE)).sum(0)[..., None] // 6 % 2
    for behind in (3 * checks, np.full_like(checks, 0.3, float)):  # over the table's brightness
        image = np.where(photo.any(-1, keepdims=True), photo, photo.max() * behind)
        scene = scene_of(with_photo(job, image.astype(np.float32)))
        assert looked(scene.job) == NEAR[1]
    found = on_ground(scene, choose())
    points = surface_points(found.view, found.job, 1, region=found.view.mesh == 1)
    assert np.linalg.norm(points.position[:, :2], axis=1).max() < 2 * NEAR[1] + 0.01 and len(points) > 200


def test_what_lies_behind_a_thing_that_stands_on_nothing_is_no_ground(standing_ball):
    job, light = standing_ball
    alone = path_traced(a_job(), light)
    rows, columns = np.mgrid[:SIZE, :SIZE] / SIZE
    random = np.random.default_rng(3)
    blotches = np.kron(random.uniform(0.2, 1, (12, 12)), np.ones((8, 8)))
    stripes = 0.3 + 0.1 * np.sin(12 * (rows + columns) + 4.5)  # shadows imitate a third of them, and nothing else does
    for behind in (rows, 1 - rows, columns, 0.3 + 0.1 * np.sin(4 * rows), blotches, stripes):
        there = np.where(alone.any(-1, keepdims=True), alone, behind[..., None].astype(np.float32))
        scene = scene_of(with_photo(job, there))
        assert on_ground(scene, choose()) is scene


def test_what_is_all_alike_or_black_or_not_there_says_nothing(standing_ball):
    job, _ = standing_ball
    (object_pixels,) = scene_of(job).regions
    photo = job.photo.radiance
    for image in (np.where(object_pixels[..., None], photo, level) for level in (0.0, 0.4)):
        assert not looked(with_photo(job, image))
    assert not looked(with_photo(job, photo, object_pixels))  # as of a photo that is cut out


def test_a_camera_below_sees_no_ground(standing_ball):
    job, _ = standing_ball
    below = replace(job, camera=from_above(0, -6, -3))
    assert not looked(below)
    scene = scene_of(below)
    assert not (with_plane(scene.view, below, ground_under(below.objects)).mesh == 1).any()


@pytest.mark.parametrize(
    "told",
    [{"evidence": "job"}, {"evidence": "never"}, {"refine": "quick"}, {"estimator": "least-squares"}],
    ids=lambda told: next(iter(told)),
)
def test_it_is_not_looked_for_where_that_was_refused(standing_ball, told):
    scene = scene_of(standing_ball[0])
    assert on_ground(scene, choose()) is not scene
    assert on_ground(scene, choose(**told)) is scene


def test_a_job_that_says_what_stands_around_is_believed(standing_ball):
    job, _ = standing_ball
    far = a_table(height=30.0)
    scene = scene_of(replace(job, occluders=(far,)))
    assert on_ground(scene, choose()) is scene


def test_the_scene_goes_back_to_what_its_job_says(standing_ball):
    scene = scene_of(standing_ball[0])
    assert scene.occluder_albedos == []
    stands = on_ground(scene, choose())
    assert len(stands.occluder_albedos) == 1 and stands.seen != scene.seen and stands.tracer is not scene.tracer
    assert (stands.shows_objects == (scene.view.mesh >= 0)).all() and (stands.view.mesh == 1).any()
    assert (stands.regions[0] == scene.regions[0]).all()
    again = stands.as_in_job()
    assert again.job == replace(stands.job, occluders=()) and again.seen == scene.seen
    assert (again.view.mesh == scene.view.mesh).all() and again.tracer is scene.tracer
    assert scene.as_in_job() is scene and not scene.job.occluders


def test_recognition_knows_nothing_of_it(standing_ball, monkeypatch):
    """So that what was learned of an object serves, whatever it stands on."""
    job, seen = standing_ball[0], []

    def noted(scenes, *given, **told):
        seen.extend(len(scene.job.occluders) for scene in scenes)
        return materials_of_all(scenes, *given, **told)

    monkeypatch.setattr(estimation, "materials_of_all", noted)
    found = found_light(scene_of(job), open_library(None), choose("balanced", pixels=300), refinements=())
    assert seen == [0] and len(found.scene.job.occluders) == 1


def test_two_things_stand_on_the_ground_of_the_lower_one():
    other = trimesh.creation.icosphere(3, 0.5).apply_translation([2.0, 0.5, -0.2])
    ground = ground_under(a_job(meshes=[ball(), as_mesh(other)]).objects)
    assert np.allclose(ground.mesh.vertices[:, 2], -1, atol=1e-3)
    low, high = ground.mesh.vertices.min(0)[:2], ground.mesh.vertices.max(0)[:2]
    np.testing.assert_allclose((low + high) / 2, [0.75, 0], atol=0.02)
    np.testing.assert_allclose(high - low, 2 * standing.REACH * 3.5, rtol=0.01)
    # a vertex of no face is of no object
    mesh = ball()
    stray = replace(mesh, vertices=np.concatenate([mesh.vertices, [[0, 0, -9]]]))
    assert np.allclose(ground_under(a_job(meshes=[stray]).objects).mesh.vertices[:, 2], -1, atol=1e-3)


def test_behind_a_depth_the_plane_is_counted_before_the_unseen_side():
    whole = scene_of(a_job())
    depth, camera = z_depth(whole), whole.job.camera
    side = JobObject("side", mesh_from_depth(depth, camera), unseen=closing_mesh(depth, camera))
    job = replace(whole.job, objects=(side,))
    scene, ground = scene_of(job), ground_under(job.objects)
    found, traced = with_plane(scene.view, job, ground).mesh, scene_of(replace(job, occluders=(ground,))).view.mesh
    assert (traced == 2).any()  # the unseen side, at the outline
    near = found >= 0
    assert (found[near] != traced[near]).mean() < 1e-3  # a ray may slip between two triangles


def test_what_the_first_frame_stands_on_all_do_and_a_command_says_so(standing_ball, tmp_path, capsys):
    job, light = standing_ball
    write_job(tmp_path, trimesh.creation.icosphere(4), job.camera, mesh="ball.ply", metres=0.05, name="ball")
    edited(tmp_path, first={"material": WHITE})
    table = a_table(surface=Surface(COLOUR, roughness=1.0, specular=0.0))
    turned = light * np.where(np.arange(9) == 3, -1, 1)[:, None]
    (tmp_path / "frames").mkdir()
    for name, x in (("1.exr", light), ("2.exr", turned)):
        images.write_exr(tmp_path / "frames" / name, path_traced(a_job(floor=[table]), x))
    shutil.copy(tmp_path / "frames" / "1.exr", tmp_path / "photo.exr")
    alone = answer(capsys, "estimate", tmp_path, "--no-report")
    assert STANDING in alone["warnings"]
    assert alone["choice"]["standing"] == STANDING and alone["choice"]["ground"].startswith("used as evidence")
    assert "standing" not in answer(capsys, "estimate", tmp_path, "--no-report", "--evidence", "job")["choice"]
    draft = answer(capsys, "estimate", tmp_path, "--no-report", "--preset", "draft")
    assert "standing" not in draft["choice"] and "under the objects" in draft["choice"]["refine"]
    aside = from_above(5.0, -3.0, 2.5)  # in a third frame
    images.write_exr(tmp_path / "frames" / "3.exr", path_traced(a_job(aside, floor=[table]), light))
    poses = {"3": {"camera": {"to_world": aside.to_world.tolist()}}}
    (tmp_path / "poses.json").write_text(json.dumps({"format": "btfsep-poses", "version": 1, "frames": poses}))
    command = ["sequence", tmp_path, "--images", tmp_path / "frames" / "*", "--poses", tmp_path / "poses.json"]
    first, *others = answer(capsys, *command)["frames"]
    assert first["choice"]["standing"] == STANDING
    assert all(frame["choice"] is None or frame["choice"]["standing"] == STANDING for frame in others)
    assert all(STANDING in frame["warnings"] for frame in (first, *others))
    for frame, x in zip((first, *others), (light, turned, light), strict=True):
        assert off_above(read_lighting(tmp_path / "sequence" / frame["lighting"]).coefficients, x) < 0.2
