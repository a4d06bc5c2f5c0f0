# SPDX-License-Identifier: GPL-3.0-or-later
"""The objects and materials of the photographs: what the figures rest on has to be what it is said to be."""

from dataclasses import asdict
from types import SimpleNamespace

import bpy
import cv2
import numpy as np
import pytest

from btfsep_engine.errors import InputError
from btfsep_engine.job.load import load_job
from scripts.cycles import materials, objects, shoot, studio
from scripts.studies import photos


def tile(n=128, size_mm=30.0):
    """Smooth periodic maps."""
    c = (np.arange(n) + 0.5) / n
    u, v = np.meshgrid(c, c)
    height = 0.5 * np.sin(2 * np.pi * 2 * u) * np.cos(2 * np.pi * v) + 3.0
    return SimpleNamespace(
        base_colour=np.dstack([u, v, 0.5 * u]), height_mm=height, roughness=0.3 + 0.4 * u, size_mm=size_mm, f0=0.04
    )


def edge_counts(mesh):
    """How many faces meet at each edge."""
    count = np.zeros(len(mesh.edges), int)
    index = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("edge_index", index)
    np.add.at(count, index, 1)
    return count


@pytest.mark.parametrize("name", objects.NAMES)
def test_objects(name):
    studio.clear()
    thing = objects.build(name)
    mesh = thing.data
    positions = objects.vertex_positions(mesh)
    extent = positions.max(0) - positions.min(0)
    assert extent.max() == pytest.approx(0.15, abs=1e-5)
    assert np.abs(positions.max(0) + positions.min(0)).max() < 1e-5
    counts = edge_counts(mesh)
    assert counts.max() == 2
    if name not in ("cloth", "suzanne"):  # the cloth has a hem, the monkey's eyes are open behind
        assert counts.min() == 2
    vertex, corner = objects.triangles(mesh)
    p, q = positions[vertex], objects.corner_uv(mesh)[corner]
    edge = np.stack([p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]], -1)
    normal = np.cross(edge[..., 0], edge[..., 1])
    assert (p[:, 0] * normal).sum() > 0  # faces look outward (their signed volume is positive)

    # the UV map is in metres: lengths along the surface agree to 10 %, areas to 15 %, but for a few faces in a thousand
    e1 = edge[..., 0] / np.linalg.norm(edge[..., 0], axis=1, keepdims=True)
    e2 = np.cross(normal / np.linalg.norm(normal, axis=1, keepdims=True), e1)
    flat = np.einsum("fkc,fce->fke", np.stack([e1, e2], 1), edge)
    stretch = np.linalg.svd(np.stack([q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]], -1) @ np.linalg.inv(flat))[1]
    area = np.linalg.norm(normal, axis=1)
    good = (np.abs(stretch - 1) < 0.1).all(1)
    assert area[good].sum() > 0.95 * area.sum()
    assert np.median(stretch) == pytest.approx(1, abs=0.01)


def test_displacement_is_the_map_along_the_normal():
    """On a ball every displaced vertex stands where the map of its UV says; nothing is torn open."""
    studio.clear()
    base = objects.build("sphere")
    radius = np.linalg.norm(objects.vertex_positions(base.data), axis=1).mean()
    maps = tile()
    thing = materials.displaced(base, "test", maps, face_mm=0.5)
    mesh = thing.data
    assert len(mesh.polygons) > 150_000
    assert edge_counts(mesh).min() == edge_counts(mesh).max() == 2  # welded across the charts of the UV map
    vertex = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", vertex)
    uv = objects.corner_uv(mesh)
    low = np.full((len(mesh.vertices), 2), np.inf)
    high = -low
    np.minimum.at(low, vertex, uv)
    np.maximum.at(high, vertex, uv)
    inner = (high - low).max(1) < 1e-6  # one UV: no seam
    assert inner.mean() > 0.9
    u, v = low[inner].T
    wanted = 0.5 * np.sin(2 * np.pi * 2 * u) * np.cos(2 * np.pi * v)
    lift = 1e3 * (np.linalg.norm(objects.vertex_positions(mesh), axis=1)[inner] - radius)
    assert (
        np.abs(lift - wanted).max() < 0.04
    )  # mm, of an amplitude of 0.5; the map is smoothed to what the mesh can carry
    # one tile of the UV map is size_mm of surface
    corners = objects.triangles(mesh)[1]
    q = uv[corners]
    a, b = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
    tiles = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
    assert tiles * maps.size_mm**2 == pytest.approx(4 * np.pi * (1e3 * radius) ** 2, rel=0.01)


def test_periodic_look_up_is_that_of_a_texture():
    values = np.arange(12.0).reshape(3, 4)
    assert materials.sample_periodic(values, np.array([[0.125, 1 / 6]]))[0] == values[0, 0]
    assert materials.sample_periodic(values, np.array([[0.25, 1 / 6]]))[0] == pytest.approx(0.5)
    assert materials.sample_periodic(values, np.array([[-0.125, 1 + 5 / 6]]))[0] == pytest.approx(values[2, 3])
    wave = np.sin(2 * np.pi * np.arange(64) / 64)[None, :].repeat(64, 0)
    sigma = 2.0
    assert np.allclose(materials.smoothed(wave, sigma), wave * np.exp(-2 * (np.pi * sigma / 64) ** 2))


def test_the_scene_is_a_fair_photograph(tmp_path, small_light):
    """The object fills the frame; the photo shows the displaced object, the known one is not rendered."""
    scene, camera, base, photo = studio.make_scene(
        "blob", "x/test", small_light("city"), resolution=64, maps=tile(), face_mm=0.5
    )
    assert base.hide_render and not photo.hide_render
    picture = studio.render_photo(scene, tmp_path / "photo.exr", 4)
    assert picture.shape == (64, 64, 3) and np.isfinite(picture).all() and picture.max() > 0
    before = scene.cycles.samples, scene.cycles.max_bounces
    mask = studio.object_mask(scene)
    assert (scene.cycles.samples, scene.cycles.max_bounces) == before and not scene.render.film_transparent
    rows, columns = np.nonzero(mask > 0.5)
    edges = (rows.min(), 63 - rows.max(), columns.min(), 63 - columns.max())
    assert min(edges) >= 3 and max(min(edges[:2]), min(edges[2:])) < 25
    assert min(edges[2:]) <= 7 or min(edges[:2]) <= 7
    assert 0.3 < mask.mean() < 0.7
    assert camera.location.z > 0.05  # from above


def test_the_same_scene_is_lit_by_the_world_that_it_is_given(tmp_path):
    scene, _, _, _ = studio.make_scene("sphere", "white", "city", resolution=32)
    scene.world = bpy.data.worlds.new("even")
    tree = materials.node_tree(scene.world)
    background = tree.nodes.new("ShaderNodeBackground")
    background.inputs["Color"].default_value = (0.25, 0.5, 1.0, 1)
    tree.links.new(background.outputs[0], tree.nodes.new("ShaderNodeOutputWorld").inputs["Surface"])
    picture = studio.render_photo(scene, tmp_path / "even.exr", 64)
    # a white furnace: a convex ball under even light is albedo times the light
    assert picture[16, 16] == pytest.approx(0.8 * np.array([0.25, 0.5, 1.0]), rel=0.03)
    assert picture[0, 0] == pytest.approx([0.25, 0.5, 1.0], rel=1e-3)


def test_what_is_added_lights_as_it_says(tmp_path):
    """A dark studio: a sun of irradiance pi, and a near ball of as much at the centre, on a white matte ball."""
    sun_from = np.array([0.3, -0.8, 0.5]) / np.linalg.norm([0.3, -0.8, 0.5])
    scene, camera, _, _ = studio.make_scene("sphere", "white", None, resolution=48)
    facing = np.array(camera.matrix_world)[:3, 2]  # the normal in the middle of the picture
    near = 6 * sun_from - facing  # in radii, from there to the ball
    length, radius = np.linalg.norm(near), 0.075
    for add, expected in (
        (lambda: studio.add_sun(sun_from, [np.pi] * 3, degrees=0.54), sun_from @ facing),
        (lambda: studio.add_ball(6 * radius * sun_from, 0.12 * radius, 2500), 36 * near @ facing / length**3),
    ):
        added = add()
        picture = studio.render_photo(scene, tmp_path / "lit.exr", 64)
        bpy.data.objects.remove(added)
        assert picture[22:26, 22:26].mean() == pytest.approx(0.8 * expected, rel=0.04)
    assert studio.render_photo(scene, tmp_path / "dark.exr", 4).max() == 0


@pytest.mark.parametrize("wrong", [{"object": "suzane"}, {"material": "leather/brown"}])
def test_a_photograph_of_what_there_is_not_is_refused_before_any_is_taken(tmp_path, wrong):
    good = photos.shot(tmp_path, "blob", "white", None)
    shots = [asdict(good), asdict(good) | wrong]
    with pytest.raises(InputError, match=next(iter(wrong.values()))) as error:
        shoot.shoot(shots, resolution=8, samples=1)
    assert "blob" in error.value.do or "white" in error.value.do
    assert not any(tmp_path.iterdir())


def test_a_texture_set_by_others_is_photographed_as_it_is(tmp_path, monkeypatch):
    """Cycles shows the set's own colour, and the job has the mesh's UVs in its tiles."""
    monkeypatch.setattr(materials, "MOST_FACES", 100_000)
    sets = tmp_path / "sets" / "tile"
    sets.mkdir(parents=True)
    for name, value in (("color", (40, 160, 200)), ("height", (128,) * 3), ("roughness", (230,) * 3)):
        cv2.imwrite(str(sets / f"{name}.png"), np.full((64, 64, 3), value, np.uint8))  # blue first
    maps = {"folder": str(sets), "size_mm": 60.0, "height_mm": 1.0}
    shoot.shoot([asdict(photos.shot(tmp_path, "blob", "others/tile", "city", maps=maps))], resolution=32, samples=16)
    job = load_job(tmp_path / "blob_others-tile_city")
    red, green, blue = job.photo.radiance[12:20, 12:20].reshape(-1, 3).mean(0)
    assert red > 1.2 * green > 1.2 * 4 * blue
