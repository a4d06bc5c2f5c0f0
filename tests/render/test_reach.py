# SPDX-License-Identifier: GPL-3.0-or-later
"""From which directions light reaches what is photographed: by rays, and that a fit is told."""

from dataclasses import replace

import numpy as np
import trimesh

from btfsep_engine import sh
from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.model import Lambertian
from btfsep_engine.commands.record import result_record
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.fit.stated import of_reaching
from btfsep_engine.job.model import Occluder
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.checks import uncertainty_doubts
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.problem import make_problem
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.together import hidden_directions, light_solver
from btfsep_engine.render.reach import response
from btfsep_engine.render.sampling import spread
from tests.render.scenes import as_mesh, ball, job_of, looking_down, positive_light, scene_of, with_photo

WHITE = Lambertian("test/white", np.full(3, 0.8))
WHITE_NAME = "reference/white-diffuse"
DIRECTIONS = fibonacci_sphere(400)


def a_ball(*, on_table: bool):
    """A scene and the points of its ball, seen from above; the table is 60 radii wide."""
    plate = trimesh.creation.box([60, 60, 0.02]).apply_translation([0, 0, -1.02])
    occluders = [Occluder(as_mesh(plate, flat=True))] if on_table else []
    scene = scene_of(job_of([ball()], looking_down(), occluders=occluders))
    return scene, scene.points(0, textured=False)


def test_alone_it_is_the_mean_cosine():
    scene, points = a_ball(on_table=False)
    expected = np.maximum(points.normal @ DIRECTIONS.T, 0).mean(0)
    found = response(scene.tracer, points, DIRECTIONS)
    np.testing.assert_allclose(found, expected / expected.max(), atol=0.05)
    assert found.max() == 1


def test_a_plate_is_as_bright_whichever_side_its_faces_say_that_they_are(monkeypatch):
    scene, points = a_ball(on_table=True)
    expected = response(scene.tracer, points, DIRECTIONS)
    plate = scene.tracer.meshes[1]
    monkeypatch.setattr(scene.tracer, "meshes", (scene.tracer.meshes[0], replace(plate, faces=plate.faces[:, ::-1])))
    np.testing.assert_array_equal(response(scene.tracer, points, DIRECTIONS), expected)


def test_a_table_hides_what_is_below_and_shows_by_itself_what_is_behind():
    scene, points = a_ball(on_table=True)
    found = response(scene.tracer, points, DIRECTIONS)
    assert (found[DIRECTIONS[:, 2] < -0.2] < 1e-3).all()
    assert (found[DIRECTIONS[:, 2] > 0.1] > 0.02).all()


def by_way_of_the_table(points, direction, rng):
    """What points of a unit ball show of a beam by way of a white plane below it, by formulas: a mean over them."""
    n = np.repeat(points.normal, 200, 0)
    turn, r = 2 * np.pi * rng.random(len(n)), np.sqrt(rng.random(len(n)))  # as the cosine has it, in n's own frame
    side = np.cross(n, np.where(np.abs(n[:, 2:]) < 0.9, [[0, 0, 1]], [[1, 0, 0]]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    own = np.stack([r * np.cos(turn), r * np.sin(turn), np.sqrt(1 - r * r)], -1)
    ray = own[:, :1] * side + own[:, 1:2] * np.cross(n, side) + own[:, 2:] * n
    place = np.repeat(points.position, 200, 0)
    place = place + ray * ((-1.01 - place[:, 2:]) / np.where(ray[:, 2:] < 0, ray[:, 2:], -1))
    along = place @ direction
    in_shadow = (along < 0) & (np.square(place).sum(1) - along**2 < 1)
    return float(((ray[:, 2] < 0) & (np.abs(place[:, :2]).max(1) < 30) & ~in_shadow).mean() * direction[2])


def test_a_surface_that_the_photo_does_not_show_sends_light_on():
    """Light from the left reaches the ball's right side by way of the table alone."""
    scene, points = a_ball(on_table=True)
    right = points.take(np.flatnonzero(points.normal[:, 0] > 0.6))
    directions = np.array([[-0.8, 0, 0.6], [0.8, 0, 0.6]])
    assert (right.normal @ directions[0]).max() < 0
    left, own = (by_way_of_the_table(right, d, np.random.default_rng(0)) for d in directions)
    found = response(scene.tracer, right, directions)
    assert found[1] == 1
    assert abs(found[0] - left / (np.maximum(right.normal @ directions[1], 0).mean() + own)) < 0.04
    assert found[0] > 0.05


def test_what_is_hidden_is_asked_only_where_something_stands_around():
    for on_table in (False, True):
        scene, points = a_ball(on_table=on_table)
        problem = make_problem(scene, [WHITE], [points.take(spread(points, 300))], choose("draft", directions=256))
        hidden = hidden_directions([problem])
        if not on_table:
            assert hidden is None
            continue
        assert hidden[DIRECTIONS[:, 2] < -0.2].all() and not hidden[DIRECTIONS[:, 2] > 0.1].any()
        np.testing.assert_array_equal(light_solver([problem], choose("draft", order=2)).field.hidden, hidden)
        empty = replace(problem, points=[points.take(np.zeros(0, int))])
        assert hidden_directions([empty]) is None  # which the fit refuses in words


def test_what_is_stated_of_a_thing_on_a_table_is_of_the_light_that_reaches_it():
    scene, points = a_ball(on_table=True)
    light = SHLighting(positive_light(2))
    image = np.zeros((96, 96, 3), np.float32)
    noise = np.random.default_rng(0).normal(1, 0.02, (len(points), 3))
    white = open_library(None).load(WHITE_NAME)
    image[tuple(points.pixels.T)] = scene.radiance(points, white, light, directions=4096)[:, 0] * noise
    job = with_photo(scene.job, image)
    found = estimate(scene_of(job), open_library(None), choose("draft", order=2, bounces=1), material=WHITE_NAME)
    record, fit = result_record(found), found.fit
    shown, whole = (record[key]["order_2"]["median"] for key in ("expected_error_shown", "expected_error"))
    assert shown < 0.7 * whole
    reaching = of_reaching(fit)[0]
    truth = np.pad(positive_light(2), ((0, 91), (0, 0)))
    of_truth = of_reaching(replace(fit, all_coefficients=truth))[0]
    scale = (reaching[:9] * of_truth[:9]).sum() / (reaching[:9] ** 2).sum()
    assert np.linalg.norm(scale * reaching[:9] - of_truth[:9]) < 2 * shown * np.linalg.norm(of_truth[:9])
    below = DIRECTIONS[DIRECTIONS[:, 2] < -0.5]
    assert np.abs(sh.series(reaching, below)).max() < 0.2 * np.abs(sh.series(reaching, -below)).max()
    assert not any("not all of the first four" in said for said in uncertainty_doubts(found))
    by_itself = scene_of(replace(job, occluders=()))
    alone = estimate(by_itself, open_library(None), choose("draft", order=2, bounces=1), material=WHITE_NAME)
    assert result_record(alone)["expected_error_shown"] is None
    assert any("not all of the first four" in said for said in uncertainty_doubts(alone))
