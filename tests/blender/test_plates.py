# SPDX-License-Identifier: GPL-3.0-or-later
"""The study of plates: what is photographed is what is said to be, and the light comes from where its truth has it."""

import json

import numpy as np
import pytest
from scipy import ndimage

from blender_btfsep.scene import own_surface
from blender_btfsep.scene.export import export_job
from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.job.load import load_job
from scripts.cycles import angular, materials, neighbours, objects, studio
from scripts.cycles import plates as studio_plates
from scripts.studies import cameras, measures, phones, plate_light, plate_sets, plate_things, plates
from scripts.studies.estimates import scene_of


def test_plates_are_drawn_alike_and_of_all_kinds():
    one, again, other = plate_sets.drawn(1), plate_sets.drawn(1), plate_sets.drawn(2)
    assert one == again and one != other
    kinds = {k for plate in one + other for k in plate["kinds"]}
    assert {"0 px off", "1 px off", "2 px off", "srgb", "agx", "floats", "alone", "on a table"} <= kinds
    assert all(
        np.hypot(*p["off"]) == pytest.approx(int(p["kinds"][0][0]) if p["kinds"][0][0].isdigit() else 0) for p in one
    )


def test_glossy_tables_are_those_of_a_set_that_has_tables_and_jobs_may_tell_them_otherwise():
    plain, glossy = plate_sets.of_set("seventh"), plate_sets.of_set("glossy tables")
    assert [p["name"] for p in glossy] == [p["name"] for p in plain if p["table"]]
    assert {p["table_roughness"] for p in glossy} == set(plate_sets.OF_TABLES)
    scene, bsdfs = studio.clear(), []
    for roughness in (None, 0.3):
        (material,) = studio.add_table(0.0, 1.0, (0.2, 0.3, 0.4), roughness=roughness).data.materials
        bsdfs += [n for n in material.node_tree.nodes if n.type.startswith("BSDF")]
    assert [b.type for b in bsdfs] == ["BSDF_DIFFUSE", "BSDF_PRINCIPLED"] and len(scene.objects) == 2
    assert bsdfs[1].inputs["Roughness"].default_value == pytest.approx(0.3)


def test_lights_are_drawn_from_a_folder_of_maps(tmp_path):
    """Any map stands in for Blender's, in every kind of set, and the truth is the map's."""
    folder = tmp_path / "maps"
    folder.mkdir()
    with pytest.raises(InputError, match=r"it has no \.hdr files; name a folder with maps"):
        plates.main([str(tmp_path), "--maps", str(folder), "--sets", "tenth"])
    images.write_exr(folder / "even.exr", np.full((32, 64, 3), (2.0, 1.0, 0.5), np.float32))
    path = str(folder / "even.exr")
    for name in ("tenth", "stage anew", "unsaid anew", "painted anew", "seventh"):
        here, usual = plate_sets.of_set(name, [path]), plate_sets.of_set(name)
        assert {plate["light"] for plate in here} == {path} and path not in {plate["light"] for plate in usual}
        assert len(here) == plate_sets.COUNT and set(here[0]) == set(usual[0])
    plain = {**plate_sets.of_set("tenth", [path])[0], "sun": None}
    assert plate_light.truth(plain)[0] == pytest.approx(np.sqrt(4 * np.pi) * np.array([2.0, 1.0, 0.5]), rel=1e-3)


def test_plates_of_several_materials_and_their_mean(tmp_path):
    drawn = plate_sets.of_set("several")
    assert [plate | {"more": None} for plate in plate_sets.drawn(4)] == [plate | {"more": None} for plate in drawn]
    scene = studio.clear()
    thing = objects.build("suzanne", seed=0)
    for surface in (drawn[0]["surface"], *drawn[0]["more"]):
        thing.data.materials.append(materials.principled(surface))
    studio_plates.dress(thing.data)
    counts = np.bincount([face.material_index for face in thing.data.polygons], minlength=3)
    assert counts.min() > 0.05 * counts.sum()
    studio.add_camera(scene, objects.vertex_positions(thing.data), resolution=24)
    images.write_exr(tmp_path / "photo.exr", np.ones((24, 24, 3)))
    told = {"image_path": tmp_path / "photo.exr", "objects": [thing], "occluders": []}
    export_job(scene, tmp_path / "job", **told, surfaces={thing.name: own_surface.BLENDER})
    job = load_job(tmp_path / "job")
    mean, told = plates.as_mean(job).objects[0].surface, json.loads((tmp_path / "job" / "job.json").read_text())
    numbers = told["objects"][0]["surface"]  # the add-on's own mean
    assert mean.image is None
    for key in ("roughness", "metallic", "specular"):
        assert getattr(mean, key) == pytest.approx(numbers[key], abs=1e-4)


def test_the_light_of_a_plate_is_where_its_truth_has_it(tmp_path, monkeypatch, small_light):
    monkeypatch.setattr(studio_plates, "RESOLUTION", 96)
    monkeypatch.setattr(studio_plates, "SAMPLES", 16)
    plate = {
        "name": "00", "object": "suzanne", "seed": 0, "light": small_light("sunset"), "turn": 130.0, "sun": None,
        "table": None,
        "surface": {"colour": (0.5, 0.5, 0.5), "roughness": 0.9, "metallic": 0}, "curve": "agx", "off": [0.0, 0.0],
        "kinds": ["0 px off", "agx", "alone", "matte"],
    }  # fmt: skip
    studio_plates.take(plate, tmp_path / "00")
    row = plates.study(plate, tmp_path, plates.AS_IS)
    assert row["order2"] < 0.3 and row["direction"] < 15 and not row["curve doubted"]
    assert "AgX, as stated" in row["choice"]["curve"]
    taken = plates.study(plate, tmp_path, plates.AS_SRGB)
    assert "sRGB" in taken["choice"]["curve"] and taken["order2"] != row["order2"]
    ways = {way: cameras.study(plate, tmp_path, "Canon EOS 5D II", way) for way in ("as sRGB", "as a camera's")}
    assert ways["as a camera's"]["order2"] < ways["as sRGB"]["order2"] and ways["as sRGB"]["coded"] == "by a camera"
    assert cameras.study(plate, tmp_path, cameras.FLOATS, cameras.AS_STORED)["order2"] < 0.3
    moved = {way: load_job(phones.take(plate, tmp_path, way)).photo.radiance[..., 1] for way in phones.WAYS}
    left, fused, pressed = (np.log(each[moved["left as they are"] > 1e-3] + 1e-4) for each in moved.values())
    assert pressed.std() < 0.8 * left.std() and np.std(fused - left) > 0.02
    assert load_job(tmp_path / "00" / "contrast pressed").image_colorspace == "camera"
    aside = plate | {"turn": plate["turn"] + 90}
    assert measures.order2(plate_light.truth(aside), plate_light.truth(plate)) > 0.4
    # on a table only light from above it is judged, and what is stated of that
    on_table = plate | {"table": (0.3, 0.3, 0.3)}
    below = plates.study(on_table, tmp_path, plates.AS_IS)
    assert below["order2"] != row["order2"] and below["stated2"] < row["stated2"]
    assert below["over"] == below["order2"] / below["stated2"] and below["inside"] == row["inside"]


def test_plates_whose_jobs_do_not_say_all(tmp_path, monkeypatch, small_light):
    drawn = plate_sets.of_set("unsaid")
    assert drawn == plate_sets.of_set("unsaid") != plate_sets.of_set("unsaid again")
    usual = plate_sets.drawn(plate_sets.SETS["unsaid"])
    assert [{k: p[k] for k in usual[0] if k != "kinds"} for p in drawn] == [
        {k: p[k] for k in p if k != "kinds"} for p in usual
    ]
    ratios = np.log(np.divide([p["told"]["colour"] for p in drawn], [p["surface"]["colour"] for p in drawn]))
    assert 0.08 < ratios.mean(1).std() < 0.25 and 0.02 < (ratios - ratios.mean(1, keepdims=True)).std() < 0.12
    assert not any(p["thing"] == "subsurface" and p["surface"]["metallic"] for p in drawn)
    monkeypatch.setattr(studio_plates, "RESOLUTION", 48)
    monkeypatch.setattr(studio_plates, "SAMPLES", 4)
    plain = drawn[0] | {"thing": "as said", "camera": "clean", "curve": "floats", "much": 1.0, "off": [0, 0]}
    plain |= {"object": "sphere", "light": small_light("sunset")}
    pictures = {}
    for name in plate_things.OF_OBJECTS:
        matte = plain["surface"] | {"roughness": 0.9, "metallic": 0}
        studio_plates.take(plain | {"thing": name, "surface": matte}, tmp_path / name)
        pictures[name] = images.read_linear(tmp_path / name / "linear.exr").pixels
        said = load_job(tmp_path / name / "job").objects[0].surface
        assert said.base_color == pytest.approx(plain["told"]["colour"], abs=1e-6)
        assert said.roughness == pytest.approx(plain["told"]["roughness"], abs=1e-6)
    for name in plate_things.OF_OBJECTS[1:]:
        assert np.abs(pictures[name] / pictures["as said"] - 1).max() > 0.1, name


def test_finishes_that_jobs_do_not_know(tmp_path, monkeypatch, small_light):
    drawn = plate_sets.of_set("finished")
    assert drawn == plate_sets.of_set("finished") != plate_sets.of_set("finished again")
    assert {(plate["thing"], plate["surface"]["metallic"]) for plate in plate_sets.of_set("dusty")} == {("dusty", 0)}
    assert {p["thing"] for p in drawn} == set(plate_things.OF_FINISHES)
    assert all(p["surface"]["metallic"] for p in drawn if p["thing"] == "brushed")
    assert not any(p["surface"]["metallic"] for p in drawn if p["thing"] in ("velvet", "wax", "frosted"))
    monkeypatch.setattr(studio_plates, "RESOLUTION", 48)
    monkeypatch.setattr(studio_plates, "SAMPLES", 16)
    plain = drawn[0] | {"curve": "floats", "much": 1.0, "off": [0, 0], "table": None, "sun": None}
    plain |= {"object": "sphere", "light": small_light("sunset"), "told": drawn[0]["surface"]}
    pictures = {}
    for metallic in (0, 1):
        own = {"colour": (0.3, 0.1, 0.1), "roughness": 0.5, "metallic": metallic}
        for name in ("as said", *(("brushed",) if metallic else plate_things.OF_FINISHES)):
            studio_plates.take(plain | {"thing": name, "surface": own}, tmp_path / f"{name} {metallic}")
            pictures[name] = images.read_linear(tmp_path / f"{name} {metallic}" / "linear.exr").pixels
            said = load_job(tmp_path / f"{name} {metallic}" / "job").objects[0].surface
            assert said.base_color == pytest.approx(plain["told"]["colour"], abs=1e-6)
            if name != "as said":
                assert np.abs(pictures[name] - pictures["as said"]).max() > 0.1 * pictures["as said"].max(), name
    # dust lies on top, and nowhere else
    up, down = (slice(0, 20), slice(30, 48))
    first = tmp_path / "as said 0" / "linear.exr"
    change = np.abs(pictures["dusty"] - images.read_linear(first).pixels).max(-1)
    assert change[up].max() > 5 * np.median(change[down])


@pytest.mark.parametrize("name", angular.NAMES)
def test_things_of_few_flat_faces(name):
    studio.clear()
    mesh = angular.build(name, seed=3).data
    assert np.ptp(objects.vertex_positions(mesh), axis=0).max() == pytest.approx(objects.LARGEST_SIDE)
    normals = np.array([p.normal for p in mesh.polygons])
    corners = np.array([mesh.corner_normals[i].vector for p in mesh.polygons for i in p.loop_indices])
    own = np.repeat(normals, [p.loop_total for p in mesh.polygons], axis=0)
    flat = (corners * own).sum(1)
    assert flat.min() > np.cos(np.radians(5))  # no shading runs over a hard edge
    if name not in ("tin", "gem"):  # a gem may have faces that hardly lean
        assert flat.min() == pytest.approx(1, abs=1e-4)
    middles = np.array([p.center for p in mesh.polygons])
    if name in ("carton", "tin", "gem"):  # convex: faces look outwards
        assert ((middles - middles.mean(0)) * normals).sum(1).min() > 0


def test_sets_of_things_of_few_flat_faces():
    drawn, usual = plate_sets.of_set("angular"), plate_sets.drawn(plate_sets.SETS["angular"])
    assert {p["object"] for p in drawn} == set(angular.NAMES) == set(plate_things.FLAT)
    assert [p | {"object": None, "kinds": None} for p in drawn] == [p | {"object": None, "kinds": None} for p in usual]


def test_patterned_plates_stand_on_two_colours_and_jobs_have_the_mean(tmp_path, monkeypatch, small_light):
    drawn = plate_sets.of_set("patterned")
    assert drawn == plate_sets.of_set("patterned") != plate_sets.of_set("patterned again")
    assert all(plate["table"] is not None and plate["kinds"][-1] == plate["pattern"]["kind"] for plate in drawn)
    assert {plate["pattern"]["kind"] for plate in drawn} == set(plate_sets.PATTERNS)
    monkeypatch.setattr(studio_plates, "RESOLUTION", 64)
    monkeypatch.setattr(studio_plates, "SAMPLES", 16)
    plate = drawn[0] | {"table": (0.8,) * 3, "sun": None, "curve": "floats", "off": [0, 0]}
    plate |= {"object": "sphere", "light": small_light("sunset")}
    pattern = {"other": [0.2] * 3, "size": 0.08, "turn": 0.3, "told": (0.5, 0.4, 0.3)}
    pictures = {}
    for kind in (None, *plate_sets.PATTERNS):
        more = {} if kind is None else {"pattern": pattern | {"kind": kind}}
        studio_plates.take({k: v for k, v in plate.items() if k != "pattern"} | more, tmp_path / str(kind))
        pictures[kind] = images.read_linear(tmp_path / str(kind) / "linear.exr").pixels.mean(-1)
        (table,) = load_job(tmp_path / str(kind) / "job").occluders
        assert table.surface.base_color == pytest.approx(pattern["told"] if kind else plate["table"], abs=1e-6)
    table = scene_of(tmp_path / "None" / "job").view.mesh == 1
    darker = {kind: (pictures[kind] / pictures[None])[ndimage.binary_erosion(table)] for kind in plate_sets.PATTERNS}
    for kind, ratio in darker.items():
        assert ratio.std() > 0.04 and 0.2 < ratio.mean() < 1, kind
    assert 0.25 < (darker["checks"] < 0.45).mean() < 0.75 and (darker["tiles"] > 0.9).mean() > 0.6


def test_what_a_camera_adds_to_a_plate():
    even, edge = np.full((64, 64, 3), 0.5, np.float32), np.zeros((64, 64, 3), np.float32)
    edge[:, 32:] = 1
    darkened = studio_plates.through(even, "vignette", 1.0, 0)
    assert darkened[31, 31, 0] == pytest.approx(0.5, rel=0.01) and darkened[0, 0, 0] == pytest.approx(0.2, rel=0.05)
    noisy = studio_plates.through(even, "grain", 0.0, 0)
    assert noisy.mean() == pytest.approx(0.5, rel=0.01) and noisy.std() == pytest.approx(0.015, rel=0.05)
    soft, glare = (studio_plates.through(edge, kind, 1.0, 0) for kind in ("soft", "glare"))
    assert 0.1 < soft[32, 31, 0] < 0.5 and soft[32, 20, 0] < 1e-4
    assert 0.005 < glare[32, 20, 0] < 0.05 and glare.mean() == pytest.approx(0.5, rel=0.01)
    for kind in ("soft", "glare", "clean"):
        assert studio_plates.through(even, kind, 1.0, 0) == pytest.approx(even, abs=1e-6)


def test_painted_plates_have_two_colours_and_jobs_their_mean():
    drawn = plate_sets.of_set("painted")
    assert drawn == plate_sets.of_set("painted") != plate_sets.of_set("painted again")
    dark = [plate for plate in drawn if "dimmed" in plate]
    assert 8 < len(dark) < 24 and all(1 <= len(plate["lamps"]) <= 3 and plate["sun"] is None for plate in dark)
    for plate in drawn:
        mean = (np.array(plate["surface"]["colour"]) + plate["paint"]) / 2
        assert not np.allclose(plate["surface"]["colour"], plate["paint"])
        assert np.abs(np.log(np.array(plate["told"]["colour"]) / mean)).max() < 0.8  # by eye
        assert not plate["surface"]["metallic"] and "metal" not in plate["kinds"]


def test_a_painted_plate_shows_both_colours_in_pieces(tmp_path, monkeypatch, small_light):
    monkeypatch.setattr(studio_plates, "RESOLUTION", 64)
    monkeypatch.setattr(studio_plates, "SAMPLES", 16)
    white = {"colour": (0.8, 0.8, 0.8), "roughness": 0.9, "metallic": 0}
    plate = plate_sets.of_set("painted")[0] | {"surface": white, "paint": [0.2] * 3, "told": white, "table": None}
    plate |= {"curve": "floats", "off": [0, 0], "lamps": [], "dimmed": 1.0, "much": 0.5}
    plate["light"] = small_light("sunset")
    pictures = []
    for thing in ("as said", "painted"):
        studio_plates.take(plate | {"thing": thing}, tmp_path / thing)
        pictures.append(images.read_linear(tmp_path / thing / "linear.exr").pixels.mean(-1))
    seen = scene_of(tmp_path / "painted" / "job").regions[0]
    darker = (pictures[1] / pictures[0])[ndimage.binary_erosion(seen, iterations=2)]
    assert 0.25 < (darker < 0.5).mean() < 0.75  # half of it is painted,
    assert ((darker < 0.4) | (darker > 0.75)).mean() > 0.85  # and hardly anything is between


def test_softboxes_stand_where_the_truth_has_them(tmp_path):
    """What a small white ball at the middle receives from the picture's lamps is what the truth says."""
    plates_of_set = plate_sets.of_set("softboxes")
    assert plates_of_set == plate_sets.of_set("softboxes") != plate_sets.of_set("softboxes again")
    assert {len(plate["boxes"]) for plate in plates_of_set} == {1, 2, 3}
    box = {"direction": [0.6, 0.0, 0.8], "distance": 0.5, "edge": 0.2, "radiance": [3.0, 2.0, 1.0]}
    light = plate_light.box_light(box, 9)
    solid_angle = 0.2**2 / 0.5**2 * (1 - 0.2**2 / 0.5**2 / 4)  # of a square, to the second order
    np.testing.assert_allclose(np.sqrt(4 * np.pi) * light[0], solid_angle * np.array([3, 2, 1]), rtol=0.01)
    np.testing.assert_allclose(
        light[1:4, 0] / light[0, 0], np.sqrt(3) * np.array([0, 0.8, -0.6]), atol=0.02
    )  # y, z, -x
    corners = plate_light.of_box(box, plate_light.CORNERS)
    np.testing.assert_allclose(np.linalg.norm(corners - np.roll(corners, 1, 0), axis=1), 0.2)
    studio.clear()
    there = studio.add_box(corners, box["radiance"])
    np.testing.assert_allclose([tuple(v.co) for v in there.data.vertices], corners, atol=1e-6)
    emission = next(n for n in there.data.materials[0].node_tree.nodes if n.type == "EMISSION").inputs
    assert emission["Strength"].default_value * np.array(emission["Color"].default_value[:3]) == pytest.approx(
        [3, 2, 1]
    )
    assert not there.visible_camera


def test_a_flash_gives_what_the_truth_has_of_it(tmp_path, monkeypatch, small_light):
    """A white thing under a flash alone: what faces it at the middle is as bright as its irradiance makes it."""
    monkeypatch.setattr(studio_plates, "RESOLUTION", 64)
    monkeypatch.setattr(studio_plates, "SAMPLES", 16)
    plates_of_set = plate_sets.of_set("flash")
    assert plates_of_set == plate_sets.of_set("flash") != plate_sets.of_set("flash again")
    assert not any(plate["sun"] for plate in plates_of_set)
    white = {"colour": (0.8, 0.8, 0.8), "roughness": 1, "metallic": 0}
    plate = plates_of_set[1] | {"object": "sphere", "surface": white, "table": None, "curve": "floats", "off": [0, 0]}
    plate["light"] = small_light("sunset")
    place, dark = np.array(plate["flash"]["place"]), plate | {"dimmed": 0.0}
    assert 0.5 < np.linalg.norm(place) < 0.6
    studio_plates.take(dark, tmp_path)
    shown = images.read_linear(tmp_path / "linear.exr").pixels.mean(-1)
    # the ball's nearest point is closer by its radius; plastic's skin takes and gives a few hundredths
    nearest = (np.linalg.norm(place) / (np.linalg.norm(place) - 0.075)) ** 2
    expected = 0.8 / np.pi * nearest * np.mean(plate["flash"]["irradiance"])
    assert shown.max() == pytest.approx(expected, rel=0.15)
    light, towards = plate_light.truth(dark), place / np.linalg.norm(place)
    around = light[1:4].mean(1)[[2, 0, 1]] / light[0].mean() / np.sqrt(3) * [-1, -1, 1]
    assert np.abs(np.abs(around) - np.abs(towards)).max() < 1e-6
    assert np.sqrt(4 * np.pi) * light[0].mean() == pytest.approx(np.mean(plate["flash"]["irradiance"]))


@pytest.mark.parametrize("way", ["left", "right", "up", "down"])
def test_the_picture_cuts_off_what_it_is_to(way, tmp_path, monkeypatch, small_light):
    monkeypatch.setattr(studio_plates, "RESOLUTION", 64)
    monkeypatch.setattr(studio_plates, "SAMPLES", 1)
    plate = plate_sets.of_set("cut")[0] | {"object": "sphere", "table": None, "curve": "floats", "off": [0, 0]}
    plate["light"] = small_light("sunset")
    studio_plates.take(plate | {"cut": {"way": way, "beyond": 0.3, "fill": 0.9}}, tmp_path)
    seen = scene_of(tmp_path / "job").view.mesh == 0
    sides = {"left": seen[:, 0], "right": seen[:, -1], "up": seen[0], "down": seen[-1]}
    assert sides.pop(way).sum() > 40 and not any(side.any() for side in sides.values())
    cut = seen.any(0) if way in ("left", "right") else seen.any(1)
    assert cut.sum() == pytest.approx(0.7 * 0.9 * 64, abs=2)


def test_a_paper_sweep_rises_behind_the_object():
    plates_of_set = plate_sets.of_set("sweep")
    assert all(plate["table"] in plate_sets.PAPERS and plate["boxes"] for plate in plates_of_set)
    studio.clear()
    sweep = studio.add_sweep(-0.1, 1.2, (0.8, 0.8, 0.8), behind=0.3, bend=0.1)
    points = np.array([tuple(v.co) for v in sweep.data.vertices])
    away, up = points[:, 1], points[:, 2]
    assert up[away <= 0.3] == pytest.approx(-0.1) and up.max() == pytest.approx(0.5)
    bent = (away > 0.31) & (up < -0.01)
    np.testing.assert_allclose(np.hypot(away[bent] - 0.3, up[bent] - 0.0), 0.1, atol=1e-6)
    from_camera = -np.array(studio.VIEW_FROM[:2])
    turned = np.array(sweep.matrix_world)[:2, 1]
    np.testing.assert_allclose(turned, from_camera / np.linalg.norm(from_camera), atol=1e-6)


def test_what_stands_beside_an_object_is_in_the_light_around_it(tmp_path, monkeypatch, small_light):
    """A map from the middle is the true light where nothing stands there; a wall has its colour, and hides a sun."""
    monkeypatch.setattr(neighbours, "SIZE", (64, 32))
    monkeypatch.setattr(neighbours, "SAMPLES", 64)
    monkeypatch.setattr(studio_plates, "RESOLUTION", 32)
    monkeypatch.setattr(studio_plates, "SAMPLES", 1)
    drawn = plate_sets.of_set("neighbours")
    assert drawn == plate_sets.of_set("neighbours") != plate_sets.of_set("neighbours again")
    assert [len(plate["neighbour"]["quads"]) for plate in drawn] == [1, 5] * (plate_sets.COUNT // 2)
    for plate in drawn:  # no camera is inside of it, nor is it before the object
        assert not plate_light.hides(plate["neighbour"], plate_sets.CAMERA)
    plate = {**drawn[0], "object": "sphere", "table": (0.5, 0.5, 0.5), "curve": "floats", "off": [0, 0]}
    plate |= {"light": small_light("sunset"), "turn": 70.0, "sun": None, "name": "00"}
    far = 100 * np.array([(0, 1, -1), (0, 1, 1), (0, 2, 1), (0, 2, -1)])  # along +Y, and seen edge on from the middle
    studio_plates.take(plate | {"neighbour": {"quads": [far.tolist()], "colour": (0.5, 0.5, 0.5)}}, tmp_path / "00")
    assert (tmp_path / "00" / "linear.exr").exists()
    around = plate_light.truth(plate, tmp_path)[:16]
    alone = plate_light.truth({k: v for k, v in plate.items() if k != "neighbour"})[:16]
    assert np.linalg.norm(around - alone) < 0.06 * np.linalg.norm(alone)
    wall = 0.3 * np.array([(1, -4, -4), (1, 4, -4), (1, 4, 4), (1, -4, 4)])  # towards +X
    sunny = plate | {"neighbour": {"quads": [wall.tolist()], "colour": (0.0, 0.6, 0.0)}, "name": "01"}
    studio_plates.take(sunny, tmp_path / "01")
    seen = images.read_linear(tmp_path / "01" / "around.exr").pixels
    middle = seen[16, 32]  # +X
    assert middle[1] > 0.01 and max(middle[0], middle[2]) < 1e-5
    irradiance = [5.0, 5.0, 5.0]
    towards, away = ({"direction": [x, 0.0, 0.6], "irradiance": irradiance} for x in (0.8, -0.8))
    none, hidden, there = (plate_light.truth(sunny | {"sun": sun}, tmp_path) for sun in (None, towards, away))
    np.testing.assert_array_equal(hidden, none)
    np.testing.assert_allclose((there - none)[0] * np.sqrt(4 * np.pi), irradiance)
