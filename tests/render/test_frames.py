# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of a sequence: each as an estimate finds it alone, of things that stand still or move, smoothed or not."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine import sh
from btfsep_engine.btf.departures import departures
from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.model import Lambertian
from btfsep_engine.cli import main
from btfsep_engine.commands import sequence
from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.job.load import load_job
from btfsep_engine.light.files import read_lighting, write_lighting
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline import following
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from tests.render.scenes import ball, bowl, job_of, looking_down, positive_light, scene_of, with_photo

QUICK = ("--material", "reference/white-diffuse", "--preset", "draft", "--pixels", "600", "--align", "never")
LAMP, OTHER = (np.array(d) / np.linalg.norm(d) for d in ([0.6, 0.3, 0.74], [-0.7, 0.1, 0.7]))
POWER, SKY = 2.5, 0.3


def answer(capsys, *command) -> dict:
    """The result of a command."""
    assert main([*map(str, command), *QUICK, "--json"]) == 0
    return json.loads(capsys.readouterr().out.splitlines()[-1])["result"]


def lamp_light(direction=LAMP) -> np.ndarray:
    """(100, 3), an even sky and a lamp."""
    x = POWER * sh.evaluate(9, np.asarray(direction)[None])[0][:, None] * np.ones(3)
    x[0] += SKY * np.sqrt(4 * np.pi)
    return x


def shaded(camera, to_world, direction=LAMP) -> np.ndarray:
    """(h, w, 3), a white unit sphere that ``to_world`` made an ellipsoid, under that light: in closed form."""
    rows, columns = np.mgrid[: camera.height, : camera.width]
    origins, directions = camera.rays(columns.ravel() + 0.5, rows.ravel() + 0.5)
    back = np.linalg.inv(to_world)
    o, d = origins @ back[:3, :3].T + back[:3, 3], directions @ back[:3, :3].T
    a, b, c = (d * d).sum(1), (o * d).sum(1), (o * o).sum(1) - 1
    root = b * b - a * c
    normals = (o + ((-b - np.sqrt(np.maximum(root, 0))) / a)[:, None] * d) @ back[:3, :3]  # inverse transpose, of rows
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    received = np.pi * SKY + POWER * np.maximum(normals @ direction, 0)
    values = np.where(root > 0, 0.8 / np.pi * received, 0.0)
    return np.repeat(values.reshape(camera.height, camera.width, 1), 3, 2)


def turned(degrees: float, axis: int) -> np.ndarray:
    """(4, 4)."""
    out, (i, j) = np.eye(4), [k for k in range(3) if k != axis]
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    out[i, i], out[i, j], out[j, i], out[j, j] = c, -s, s, c
    return out


WHITE = Lambertian("white", np.full(3, 0.8))


def photographed(folder, lights: dict, material=WHITE) -> None:
    """Writes frames of the job in ``folder``, with all interreflections: name -> light (terms, 3); PNGs saturate."""
    scene = PreparedScene(load_job(folder), Reporter())
    points = scene.points(0, textured=False)
    place, random = tuple(points.pixels.T), np.random.default_rng(0)
    (folder / "frames").mkdir()
    for name, x in lights.items():
        lighting, image = SHLighting(x), np.zeros((96, 96, 3), np.float32)
        indirect = scene.indirect([material], lighting, choose("draft"), bounces=8)
        image[place] = scene.radiance(points, material, lighting, directions=256, indirect=indirect)[:, 0]
        image[place] *= random.normal(1, 0.02, (len(points), 1)).astype(np.float32)
        if name.endswith("exr"):
            images.write_exr(folder / "frames" / name, image)
        else:
            images.write_png(folder / "frames" / name, image / np.quantile(image[place], 0.8))


def assert_as_alone(folder, frames, capsys) -> None:
    """Every frame of a sequence is what an estimate makes of its photo, in every digit."""
    job = json.loads((folder / "job.json").read_text())
    for frame in frames:
        (folder / frame["image"]).write_bytes((folder / "frames" / frame["image"]).read_bytes())
        (folder / "job.json").write_text(json.dumps({**job, "image": frame["image"]}))
        alone = answer(capsys, "estimate", folder, "--no-report")
        there = folder / "sequence" / frame["lighting"]
        assert (folder / "result" / "lighting.json").read_bytes() == there.read_bytes(), frame["image"]
        assert frame["lamps"] == alone["lamps"] and frame["residual"] == alone["residual"]
        assert set(frame["warnings"]) == set(alone["warnings"])


@pytest.fixture
def bowl_frames(sphere_job_folder):
    """A job of a white bowl, which lights itself, and four frames: under an even light, lamps, and saturated."""
    folder, _ = sphere_job_folder
    mesh = bowl()
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(folder / "sphere.ply")
    other = lamp_light(OTHER) + np.pad(positive_light(2, seed=5), ((0, 91), (0, 0)))
    photographed(
        folder, {"1.exr": positive_light(2), "2.exr": lamp_light(), "3.exr": other, "4.png": positive_light(2)}
    )
    return folder


def test_a_frame_has_the_light_of_an_estimate_in_every_digit(bowl_frames, capsys, monkeypatch):
    folder = bowl_frames
    monkeypatch.setattr(following, "WORSE", np.inf)
    frames = answer(capsys, "sequence", folder, "--images", folder / "frames" / "*")["frames"]
    assert [f["image"] for f in frames] == ["1.exr", "2.exr", "3.exr", "4.png"]
    assert "are modelled" in frames[0]["choice"]["interreflections"]  # which a further frame is not asked
    found = ["model chosen", "model chosen", "light elected", "light elected"]  # the second's lamp is new
    assert [f["by"] for f in frames] == found and [f["choice"] is None for f in frames] == [False, False, True, True]
    assert frames[1]["lamps"] and read_lighting(folder / "sequence" / "2.json").suns
    assert any("saturated" in w for w in frames[3]["warnings"])
    assert_as_alone(folder, frames, capsys)


def test_what_a_thing_departs_from_its_material_by_stays(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    rough = departures(WHITE)[1].material
    photographed(folder, {"1.exr": lamp_light(), "2.exr": lamp_light(OTHER)}, rough)
    frames = answer(capsys, "sequence", folder, "--images", folder / "frames" / "*")["frames"]
    assert "roughness" in frames[0]["choice"]["reflectance"] and frames[1]["choice"] is None
    assert_as_alone(folder, frames, capsys)


def test_beside_things_of_an_unknown_grey_each_frame_whose_light_moves_chooses_it(
    sphere_job_folder, capsys, monkeypatch
):
    folder, _ = sphere_job_folder
    monkeypatch.setattr(following, "AS_WELL", 0.2)  # by so much the noise of so few pixels may vary
    trimesh.creation.box([6, 6, 0.1]).apply_translation([0, 0, -1.1]).export(folder / "floor.ply")
    job = json.loads((folder / "job.json").read_text())
    (folder / "job.json").write_text(json.dumps({**job, "occluders": [{"mesh": "floor.ply"}]}))
    photographed(folder, {"1.exr": lamp_light(), "2.exr": lamp_light(OTHER), "3.exr": lamp_light(OTHER)})
    *frames, still = answer(capsys, "sequence", folder, "--images", folder / "frames" / "*")["frames"]
    assert all("by evidence a grey of" in f["choice"]["surroundings"] for f in frames)
    assert_as_alone(folder, frames, capsys)
    assert still["by"] == "light followed" and still["choice"] is None and still["warnings"] == frames[1]["warnings"]
    before, after = (read_lighting(folder / "sequence" / f["lighting"]) for f in (frames[1], still))
    np.testing.assert_array_equal(after.stddev, before.stddev)
    np.testing.assert_allclose(after.interval - after.coefficients, before.interval - before.coefficients, atol=1e-6)
    assert (after.coefficients != before.coefficients).all()


def test_a_frame_that_the_model_explains_much_worse_chooses_its_own(bowl_frames, capsys, monkeypatch):
    monkeypatch.setattr(following, "WORSE", 0.0)
    frames = answer(capsys, "sequence", bowl_frames, "--images", bowl_frames / "frames" / "[23].exr")["frames"]
    assert all(f["lamps"] and "are modelled" in f["choice"]["interreflections"] for f in frames)


def test_no_light_is_followed_that_hangs_on_a_ground_or_on_a_lamps_image_in_another_view():
    """By a ground that is evidence in no view; by a lamp's own image, which was settled there, in the same one."""
    job = with_photo(job_of([ball()], looking_down()), shaded(looking_down(), np.eye(4)))
    settings = choose("draft", bounces=1, directions=128, pixels=300, order=2)
    first = estimate(scene_of(job), open_library(None), settings, material="reference/white-diffuse")
    model, light, (problem,) = first.model, first.light, first.model.problems
    corrected = replace(problem, correction=np.zeros((len(problem.pixels), 3)))

    def followed(last):
        follower = following.Follower(last, None)
        return [follower._again(first.scene) is not None, follower._followed(model, None) is not None]

    assert followed(first) == [True, True]
    assert followed(replace(first, light=replace(light, alone=light.fit))) == [False, False]
    of_lamp = replace(model, looks={model.appearance: [corrected]})
    assert followed(replace(first, model=of_lamp)) == [True, False]


def test_the_main_direction_is_still_on_a_still_scene(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    clean, random = shaded(looking_down(), np.eye(4)), np.random.default_rng(3)
    (folder / "frames").mkdir()
    for i in range(12):
        noisy = clean + 0.02 * clean.max() * random.normal(size=clean.shape)
        images.write_exr(folder / "frames" / f"{i}.exr", np.maximum(noisy, 0).astype(np.float32))
    result = answer(capsys, "sequence", folder, "--images", folder / "frames" / "*.exr")
    lights = [read_lighting(folder / "sequence" / f["lighting"]) for f in result["frames"]]
    main_directions = np.array([light.coefficients[[3, 1, 2]].mean(1) for light in lights])
    main_directions /= np.linalg.norm(main_directions, axis=1, keepdims=True)
    middle = main_directions.mean(0) / np.linalg.norm(main_directions.mean(0))
    off = np.degrees(np.arccos(np.clip(main_directions @ middle, -1, 1)))
    assert 0 < np.sqrt(np.mean(off**2)) <= 0.5
    suns = np.array([light.suns[0].direction for light in lights])  # told apart in each
    assert np.degrees(np.arccos(np.clip(suns @ LAMP, -1, 1))).max() < 2
    followed = [i for i, frame in enumerate(result["frames"]) if frame["by"] == "light followed"]
    assert len(followed) > 6
    (folder / "photo.exr").write_bytes((folder / "frames" / f"{followed[-1]}.exr").read_bytes())
    alone = read_lighting(answer(capsys, "estimate", folder, "--no-report")["lighting"])
    off = (lights[followed[-1]].coefficients - alone.coefficients) / alone.stddev
    assert 0 < np.abs(off).max() < 0.03
    elected = max(i for i in range(followed[-1]) if i not in followed)
    np.testing.assert_array_equal(lights[followed[-1]].stddev, lights[elected].stddev)


def test_lights_are_smoothed_but_not_across_a_jump(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    (folder / "frames").mkdir()
    random = np.random.default_rng(4)
    for i in range(5):
        clean = shaded(looking_down(), np.eye(4), LAMP if i < 3 else OTHER)
        noisy = clean * random.normal(1, 0.03, clean.shape)
        images.write_exr(folder / "frames" / f"{i}.exr", noisy.astype(np.float32))

    def lights(*options):
        result = answer(capsys, "sequence", folder, "--images", folder / "frames" / "*.exr", *options)
        found = [read_lighting(folder / "sequence" / f["lighting"]).coefficients for f in result["frames"]]
        return np.array(found), [f["smoothed_over"] for f in result["frames"]], result["smooth"]

    plain, counts, smooth = lights()
    assert counts == [1] * 5 and smooth == 0
    even, counts, smooth = lights("--smooth", "3", "--exr")
    assert counts == [3, 3, 3, 2, 2] and smooth == 3
    assert np.ptp(even[:3], axis=0).max() < 0.7 * np.ptp(plain[:3], axis=0).max()
    for part in (slice(3), slice(3, 5)):  # each within the lights of its own side
        assert (even[part] >= plain[part].min(0) - 1e-9).all() and (even[part] <= plain[part].max(0) + 1e-9).all()
    drawn = sh.project_map(images.read_linear(folder / "sequence" / "1.exr").pixels, 2)
    assert np.linalg.norm(drawn - even[1][:9]) < 0.03 * np.linalg.norm(drawn)  # the map is of the same light


def test_things_and_camera_that_move_as_is_known_see_one_light(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    x, camera, frames = lamp_light(), looking_down(), {}
    long = np.diag([1.0, 0.5, 0.7, 1])
    moved = turned(50, 2) @ turned(20, 0) @ long
    moved[:3, 3] = 0.2, -0.1, 0.1
    aside = replace(camera, to_world=turned(-35, 1) @ camera.to_world, fx=180.0, fy=180.0)
    for name, (seen_by, place) in {
        "a": (camera, long),
        "b": (camera, moved),
        "c": (aside, turned(70, 1) @ long),
    }.items():
        image = shaded(seen_by, place)
        noise = np.random.default_rng(0).normal(1, 0.02, image.shape)
        (folder / "frames").mkdir(exist_ok=True)
        images.write_exr(folder / "frames" / f"{name}.exr", (image * noise).astype(np.float32))
        frames[name] = {"objects": {"ball": {"to_world": place.tolist()}}}
    frames["c"]["camera"] = {"fx": 180.0, "fy": 180.0, "to_world": aside.to_world.tolist()}
    poses = folder / "poses.json"
    poses.write_text(json.dumps({"format": "btfsep-poses", "version": 1, "frames": frames}))
    command = ["sequence", folder, "--images", folder / "frames" / "*.exr"]
    result = answer(capsys, *command, "--poses", poses)
    lights = [read_lighting(folder / "sequence" / f["lighting"]) for f in result["frames"]]
    for light, frame in zip(lights, result["frames"], strict=True):
        low, high = light.interval[:, :9]
        assert frame["residual"] < 0.04 and ((low <= x[:9]) & (x[:9] <= high)).mean() > 0.85
        (lamp,) = light.suns
        assert np.degrees(np.arccos(lamp.direction @ LAMP)) < 2
    still = answer(capsys, *command)
    assert min(f["residual"] for f in still["frames"]) > 3 * max(f["residual"] for f in result["frames"])


def test_a_sequence_that_stops_leaves_no_record_of_other_lights(sphere_job_folder, capsys, monkeypatch):
    folder, _ = sphere_job_folder
    photographed(folder, {"1.exr": positive_light(2), "2.exr": lamp_light()})
    run = ["sequence", str(folder), "--images", str(folder / "frames" / "*.exr"), "--preset", "draft"]
    assert main(run) == 0
    written = []

    def full(path, light):
        written.append(path)
        if len(written) == 2:
            raise InputError(str(path), "no space left on device", "free some space")
        write_lighting(path, light)

    monkeypatch.setattr(sequence, "write_lighting", full)
    assert main(run) == 2 and len(written) == 2
    assert sorted(p.name for p in (folder / "sequence").iterdir()) == ["1.json", "2.json"]


def test_photos_that_cannot_be_used_get_no_light_and_the_others_do(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    photographed(folder, {f"{i}.exr": positive_light(2, seed=i) for i in (2, 3, 4, 6)})
    frames, black = folder / "frames", np.zeros((96, 96, 3), np.float32)
    command = "sequence", folder, "--images", frames / "*.exr"
    whole = answer(capsys, *command)
    assert "failed" not in whole and len(whole["frames"]) == 4
    alone = {f["image"]: (folder / "sequence" / f["lighting"]).read_bytes() for f in whole["frames"]}
    images.write_exr(frames / "1.exr", black)  # a fade from black
    (frames / "3.exr").write_bytes(b"")
    images.write_exr(frames / "5.exr", np.full_like(black, np.nan))
    others = folder / "sequence" / "take.json"  # of a name with dots no part is another's
    others.write_text("{}")
    (frames / "take.7.exr").write_bytes(b"")
    (folder / "sequence" / "take.7.json").write_text("{}")
    result = answer(capsys, *command)
    assert [f["image"] for f in result["frames"]] == ["2.exr", "4.exr", "6.exr"]
    assert [f["image"] for f in result["failed"]] == ["1.exr", "3.exr", "5.exr", "take.7.exr"]
    assert all(f["image"] in f["message"] for f in result["failed"])
    said = [w for w in result["warnings"] if w.endswith("it gets no light")]
    assert [w.split(":")[0] for w in said] == [f["image"] for f in result["failed"]]
    # what is left of an earlier run would pass for its light
    left = ["2.json", "4.json", "6.json", "sequence.json", "take.json"]
    assert sorted(p.name for p in (folder / "sequence").iterdir()) == left
    assert (folder / "sequence" / "2.json").read_bytes() == alone["2.exr"]  # as if it had been the first
    for name in ("2.exr", "4.exr", "6.exr"):
        (frames / name).write_bytes(b"")
    assert main([*map(str, command), *QUICK]) == 2
    assert not (folder / "sequence" / "sequence.json").exists()  # it would speak of lights that are gone
    assert "take.7.exr" in capsys.readouterr().err


def test_maps_of_lights_take_the_place_of_no_photo(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    photographed(folder, {"1.exr": positive_light(2)})
    photo = (folder / "frames" / "1.exr").read_bytes()
    run = ["sequence", str(folder), "--images", str(folder / "frames" / "*.exr"), "--preset", "draft"]
    assert main([*run, "--exr", "--out", str(folder / "frames")]) == 2
    assert "would take the place of the photo" in capsys.readouterr().err
    assert (folder / "frames" / "1.exr").read_bytes() == photo


def test_a_warning_names_its_frame_once(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    photographed(folder, {"1.exr": positive_light(2), "2.png": positive_light(2), "4.exr": positive_light(2)})
    result = answer(capsys, "sequence", folder, "--images", folder / "frames" / "*", "--preset", "draft")
    saturated = next(w for w in result["warnings"] if "saturated" in w)
    assert saturated.count("2.png") == 1
    assert "--images: there is no photo of frame 3 between 1 and 4; they get no light" in result["warnings"]
