# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs of an unknown or wrongly stated tone curve through the estimate, against the light they were made of."""

import json
from dataclasses import replace
from itertools import cycle

import cv2
import numpy as np
import pytest
import trimesh

from btfsep_engine import sh
from btfsep_engine.btf.model import Lambertian
from btfsep_engine.commands.record import result_record
from btfsep_engine.errors import InputError
from btfsep_engine.fit.stated import expected_error
from btfsep_engine.fit.tone_curve import AGX, CAMERA, LINEAR, OF_RENDERS, SRGB, ToneCurve, log_prior_of_render
from btfsep_engine.imaging import images
from btfsep_engine.imaging.colour_profile import of_primaries
from btfsep_engine.job.model import Photo
from btfsep_engine.job.photograph import read_photo
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline import recognition
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.materials import ObjectMaterial
from btfsep_engine.pipeline.model import first_model, solve_model
from btfsep_engine.pipeline.refine import curves
from btfsep_engine.pipeline.refine.curves import other_curves
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.tone import ANY, OF_BLENDER, Curves, codes_of, sought
from btfsep_engine.progress import Reporter
from btfsep_engine.recognise.recogniser import Recognition
from tests.render.scenes import as_mesh, job_of, looking_down

SETTINGS = choose("draft", bounces=1, directions=128, appearance="mean", order=2, pixels=1000)
LAMP = np.array([0.6, 0.3, 0.74]) / np.linalg.norm([0.6, 0.3, 0.74])


class Grey:
    """A library of one grey material."""

    def __contains__(self, name):
        return True

    def load(self, name):
        return Lambertian(name, np.full(3, 0.5))


def light():
    """A sky and a lamp, (100, 3)."""
    x = 2.5 * sh.evaluate(9, LAMP[None])[0][:, None] * np.ones(3)
    x[0] += 1.0
    return x


@pytest.fixture(scope="module")
def ball():
    """A scene of a grey ball on black, and its radiance (h, w, 3), at most 0.95."""
    mesh = as_mesh(trimesh.creation.icosphere(subdivisions=4, radius=0.8))
    scene = PreparedScene(job_of([mesh], looking_down()), Reporter())
    points = scene.points(0, textured=False)
    values = scene.radiance(points, Grey().load("grey"), SHLighting(light()), directions=512)[:, 0]
    image = np.zeros((96, 96, 3))
    image[points.pixels[:, 0], points.pixels[:, 1]] = values
    image += 0.005 * image.max() * np.random.default_rng(0).normal(size=image.shape)
    return scene, np.clip(0.95 * image / image.max(), 0, 1)


def seen(ball, curve, said, camera="", *, is_render=False):
    """The scene with a photo that ``curve`` coded in 8 bits; what the job says of it, and its file of who made it."""
    scene, image = ball
    codes = np.linspace(0, 1, 1 << 12 if curve is AGX else 1 << 16)  # the ball is grey: so is a column of AgX's
    decoded = curve.decode(np.repeat(codes[:, None], 3, 1))[:, 1] if curve is AGX else curve.decode(codes)
    codes = np.round(np.interp(image, decoded, codes) * 255) / 255
    read = {"linear": LINEAR, "agx": AGX, "camera": CAMERA}.get(said, CAMERA if camera else SRGB)
    out = PreparedScene(scene.job, Reporter())
    photo = Photo(read.decode(codes).astype(np.float32), np.ones(codes.shape[:2], bool), 0, bits=8, camera=camera)
    photo = replace(photo, is_render=is_render)
    out.job = replace(scene.job, photo=photo, image_colorspace=said)
    return out


def off(found) -> float:
    """Relative error up to order 2 with one free scale."""
    x, t = found.lighting.coefficients[:9], light()[:9]
    return float(np.linalg.norm((x * t).sum() / (x * x).sum() * x - t) / np.linalg.norm(t))


@pytest.mark.parametrize("curve", [LINEAR, SRGB, CAMERA])
def test_an_unknown_curve_is_found_and_the_light_with_it(ball, curve):
    scene = seen(ball, curve, "unknown")
    found = estimate(scene, Grey(), SETTINGS, material="grey")
    curves = found.scene.curves
    assert curves.curves[0] == curve and curve.description in found.choice["curve"]
    assert 0.3 < curves.shares[0] < 1
    assert off(found) < 0.15
    if curve is LINEAR:
        assert off(estimate(seen(ball, curve, "srgb"), Grey(), SETTINGS, material="grey")) > 2 * off(found)


def test_a_render_saved_with_agx_is_found_said_and_doubted_to_be_one(ball):
    found = estimate(seen(ball, AGX, "unknown"), Grey(), SETTINGS, material="grey")
    assert found.scene.curves.curves[0] is AGX and AGX.description in found.choice["curve"] and off(found) < 0.15
    said = seen(ball, AGX, "agx")
    stated = estimate(said, Grey(), SETTINGS, material="grey")
    assert f"{AGX.description}, as stated" in stated.choice["curve"] and off(stated) < 0.15
    assert not any("tone curve" in each for each in said.reporter.warnings)
    taken = seen(ball, AGX, "auto")
    assert off(estimate(taken, Grey(), SETTINGS, material="grey")) > 1.5 * off(stated)
    (doubt,) = (each for each in taken.reporter.warnings if "as Blender's view transform AgX the light would" in each)
    assert "--colorspace agx" in doubt and "unknown" not in doubt


@pytest.mark.parametrize("said", ["auto", "blender"])
@pytest.mark.parametrize("curve", [AGX, SRGB])
def test_a_file_that_blender_rendered_is_read_by_the_view_that_explains_it(ball, curve, said):
    scene = seen(ball, curve, said, is_render=said == "auto")
    found = estimate(scene, Grey(), SETTINGS, material="grey")
    assert found.scene.curves.curves[0] is curve and off(found) < 0.15
    assert f"of what Blender saved by evidence {curve.description} (" in found.choice["curve"]
    assert not any("tone curve" in each for each in scene.reporter.warnings)
    with pytest.raises(InputError, match="'blender' with --estimator least-squares"):
        estimate(seen(ball, curve, "blender"), Grey(), replace(SETTINGS, estimator="least-squares"), material="grey")


@pytest.mark.parametrize(("change", "among"), [
    ({}, OF_BLENDER), ({"is_render": False}, None), ({"camera": "Canon EOS 6D"}, None), ({"bits": None}, None),
    ({"profile": of_primaries("display-p3")}, None),
])  # fmt: skip
def test_what_is_no_plain_render_is_read_as_before(ball, change, among):
    job = seen(ball, SRGB, "auto", is_render=True).job
    assert sought(replace(job, photo=replace(job.photo, **change))) == among
    assert sought(replace(job, image_colorspace="unknown")) == ANY
    assert sought(replace(job, image_colorspace="srgb")) is None


@pytest.mark.parametrize(("brightest", "best"), [(0.85, "agx"), (1.0, "srgb")])
def test_bright_pixels_speak_against_views_that_roll_highlights_off(brightest, best):
    codes = np.full((50, 50, 3), 0.5)
    codes[0, 0] = 1  # a glint is none
    codes[1, :4, 1] = brightest
    assert max(OF_RENDERS, key=lambda name: log_prior_of_render(name, codes)) == best
    assert all(np.isclose(sum(levels), 1) for _, *levels in OF_RENDERS.values())
    assert np.isclose(sum(usual for usual, *_ in OF_RENDERS.values()), 1)


@pytest.mark.parametrize(("said", "camera"), [("auto", "Canon EOS 6D"), ("camera", "")])
def test_a_cameras_own_picture_is_read_by_its_curve(ball, said, camera):
    scene = seen(ball, CAMERA, said, camera)
    found = estimate(scene, Grey(), SETTINGS, material="grey")
    assert off(found) < 0.1 < off(estimate(seen(ball, CAMERA, "auto"), Grey(), SETTINGS, material="grey")) / 2
    why = f"the file is from {camera}" if camera else "stated"
    assert f"{CAMERA.description}, as {why}" in found.choice["curve"].replace(", as as", ", as")
    assert not any("tone curve" in each for each in scene.reporter.warnings)


def test_samples_are_a_mixture_over_the_curves_that_are_nearly_as_probable(ball):
    scene, material = seen(ball, LINEAR, "linear"), ObjectMaterial("grey", Grey().load("grey"), True)
    model, light, _ = solve_model(first_model([scene], [[material]], SETTINGS))
    fit = light.fit
    codes, two = codes_of(scene.job), (LINEAR, ToneCurve(0.5))
    scene.curves = Curves(codes, two, np.array([0.6, 0.4]))
    mixed = other_curves(model, light)[1].fit
    assert mixed.samples.shape == fit.samples.shape
    np.testing.assert_array_equal(mixed.samples[:120], fit.samples[:120])
    np.testing.assert_array_equal(mixed.coefficients, fit.coefficients)
    other = np.median(mixed.samples[120:, : mixed.terms], 0)  # the light by the other curve
    inside = [((f.interval[0] <= other) & (other <= f.interval[1])).mean() for f in (fit, mixed)]
    assert inside[1] > 0.95 > 0.9 > inside[0]
    assert mixed.stddev.mean() > fit.stddev.mean()
    scene.curves = Curves(codes, two, np.array([0.99, 0.01]))
    assert other_curves(model, light)[1].fit is fit


@pytest.mark.parametrize(("said", "true", "doubted"), [
    ("auto", LINEAR, True), ("linear", SRGB, True), ("auto", SRGB, False), ("linear", LINEAR, False),
])  # fmt: skip
def test_a_curve_that_explains_far_less_than_another_is_doubted(ball, said, true, doubted):
    scene = seen(ball, true, said)
    estimate(scene, Grey(), SETTINGS, material="grey")
    assert any("tone curve is doubtful" in each for each in scene.reporter.warnings) == doubted


@pytest.mark.parametrize(("said", "less", "doubted"), [
    ("linear", 1.0, True), ("linear", 3.0, False), ("auto", 1.0, False),
])  # fmt: skip
def test_that_eight_bits_are_linear_is_believed_where_they_look_it(ball, monkeypatch, said, less, doubted):
    """Where it is not, what is stated is of the light by the curve that they may have."""
    logs = cycle([0.0, -less, -less - 1, -less - 1])
    scenes = [seen(ball, LINEAR if said == "linear" else SRGB, said) for _ in range(2)]
    plain = estimate(scenes[0], Grey(), SETTINGS, material="grey")
    monkeypatch.setattr(curves, "log_probability", lambda *_: next(logs))
    found = estimate(scenes[1], Grey(), SETTINGS, material="grey")
    warned = [each for each in scenes[1].reporter.warnings if "tone curve is doubtful" in each]
    assert [("as sRGB" in each and "hardly ever linear" in each) for each in warned] == [True] * doubted
    np.testing.assert_array_equal(found.fit.coefficients, plain.fit.coefficients)
    stated, usual = (expected_error(e.fit.all_coefficients, e.fit.samples)["order_2"]["median"] for e in (found, plain))
    assert stated > 1.8 * usual if doubted else stated == usual


def solved(scene):
    """The problems of a scene of the grey ball, and its light, as first found."""
    model, light, _ = solve_model(first_model([scene], [[ObjectMaterial("grey", Grey().load("grey"), True)]], SETTINGS))
    return model.problems, light


def test_a_cameras_curve_is_not_doubted_where_srgb_explains_no_more(ball, monkeypatch):
    """Only beside linear codes sRGB is far more usual."""
    problems, found = solved(seen(ball, CAMERA, "camera"))
    logs = cycle([0.0, -0.5])  # by the camera's curve, and by sRGB
    monkeypatch.setattr(curves, "log_probability", lambda *_: next(logs))
    assert curves.curve_doubts(problems, found) == []
    logs = cycle([0.0, 5.0])
    (said,) = curves.curve_doubts(problems, replace(found, exposures=[1.1]))  # asked anew
    assert "as sRGB the light would explain it far better" in said


def test_how_probable_a_curve_is_does_not_depend_on_a_photos_exposure(ball, monkeypatch):
    problems, found = solved(seen(ball, SRGB, "linear"))
    logs, probability = [], curves.log_probability
    monkeypatch.setattr(curves, "log_probability", lambda *about: logs.append(probability(*about)) or logs[-1])
    for exposure in (1.0, 3.0):
        curves.curve_doubts(problems, replace(found, exposures=[exposure]))
    assert len(logs) == 8
    np.testing.assert_allclose(logs[4:], logs[:4], rtol=1e-6)


def test_what_is_clipped_stays_as_bright_as_it_was_taken_for_by_every_curve(ball):
    """The largest code says by no curve how bright it was."""
    scene = seen(ball, SRGB, "srgb")
    photo, limit = scene.job.photo, 0.7
    clipped = photo.radiance >= limit
    photo = replace(photo, radiance=np.minimum(photo.radiance, limit).astype(np.float32), clipped=clipped)
    scene.job = replace(scene.job, photo=photo)
    (problem,), _ = solved(scene)
    other = curves._read_by(LINEAR, problem, photo.radiance, lambda some: codes_of(scene.job, some))
    there = problem.clipped
    assert 0 < there.mean() < 0.5 and problem.radiance()[there].min() >= limit - 1e-6
    np.testing.assert_array_equal(other.radiance()[there], problem.radiance()[there])
    assert (other.radiance()[~there] != problem.radiance()[~there]).mean() > 0.9


def test_no_jpeg_is_said_to_be_linear(ball, tmp_path):
    """However much it looks like it; and a file says that it is one."""
    scene = seen(ball, LINEAR, "auto")
    scene.job = replace(scene.job, photo=replace(scene.job.photo, is_jpeg=True))
    estimate(scene, Grey(), SETTINGS, material="grey")
    assert not any("as linear" in each for each in scene.reporter.warnings)
    images.write_png(tmp_path / "a.png", scene.job.photo.radiance)
    coded = cv2.imread(str(tmp_path / "a.png"))
    assert cv2.imwrite(str(tmp_path / "a.jpg"), coded)
    camera = scene.job.camera
    assert [read_photo(tmp_path / name, camera).is_jpeg for name in ("a.png", "a.jpg")] == [False, True]


def test_a_curve_is_asked_once_of_a_light(ball, monkeypatch):
    """And anew of a light of other exposures, or where the photo is another."""
    answer = estimate(seen(ball, SRGB, "linear"), Grey(), SETTINGS, material="grey")
    problems, found, asked = answer.model.problems, answer.light, []
    probability = curves.log_probability
    monkeypatch.setattr(curves, "log_probability", lambda *about: asked.append(1) or probability(*about))
    said = curves.curve_doubts(problems, found)
    assert len(said) == 1 and not asked  # the estimate has asked
    assert curves.curve_doubts(problems, replace(found, suns=())) == said and not asked
    curves.curve_doubts([replace(p) for p in problems], found)
    assert len(asked) == 4  # the curve that it was read by, and three others
    curves.curve_doubts(problems, replace(found, exposures=[1.1]))
    assert len(asked) == 8


def looks_like(scene, index, library, settings):
    """A stand-in for recognition: by how dark the photo's darker half is, as by any feature that a curve changes."""
    shown = scene.job.photo.radiance[scene.regions[index]]
    name = "darker" if np.percentile(shown, 25) < 0.48 * np.percentile(shown, 90) else "lighter"
    return Recognition(name, ((name, 1.0),), False, 0.0)


@pytest.mark.parametrize("curve", [LINEAR, SRGB])
def test_an_object_is_recognised_by_the_curve_that_was_found(ball, monkeypatch, curve):
    """The same ball, whatever curve its photo has been through; read as sRGB a linear photo is too dark."""
    monkeypatch.setattr(recognition, "recognise_object", looks_like)
    scene = seen(ball, curve, "unknown")
    as_srgb = looks_like(scene, 0, None, None).material
    assert as_srgb == ("lighter" if curve is SRGB else "darker")
    found = estimate(scene, Grey(), SETTINGS)
    assert [m.name for m in found.materials] == ["lighter"]
    said = [each for each in scene.reporter.warnings if "was recognised as" in each]
    assert len(said) == (curve is not SRGB) and all("as lighter" in each and "like darker" in each for each in said)


def test_least_squares_cannot_find_a_curve(ball):
    with pytest.raises(InputError, match="--colorspace"):
        estimate(seen(ball, SRGB, "unknown"), Grey(), choose("paper", pixels=500), material="grey")


def test_what_was_chosen_is_in_the_result(ball):
    found = estimate(seen(ball, LINEAR, "linear"), Grey(), SETTINGS, material="grey")
    record = result_record(found)
    assert json.loads(json.dumps(record["choice"]))["curve"] == "the photo's tone curve is linear, as stated"
