# SPDX-License-Identifier: GPL-3.0-or-later
"""The job's camera against Blender's own projection and Cycles' renders."""

import itertools

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from blender_btfsep.basics.errors import InputError
from blender_btfsep.photo.camera import distortion, for_photo, intrinsics, render_size, shown, to_world
from btfsep_engine.job.camera import Camera
from scripts.cycles import materials


def project(camera: dict, points):
    """Pixels of world points by the job's own definition, as a reader of the job would do it."""
    inverse = np.linalg.inv(np.array(camera["to_world"]))
    local = np.c_[points, np.ones(len(points))] @ inverse.T
    depth = 1 if camera.get("projection") == "orthographic" else -local[:, 2]
    return np.stack(
        [
            camera["fx"] * local[:, 0] / depth + camera["cx"],
            camera["cy"] - camera["fy"] * local[:, 1] / depth,
        ],
        -1,
    )


CAMERAS = {
    "landscape": {},
    "portrait": {"resolution": (60, 100)},
    "shifted": {"shift": (0.17, -0.23)},
    "shifted portrait": {"resolution": (60, 100), "shift": (-0.11, 0.12)},
    "horizontal fit of a portrait": {"resolution": (60, 100), "fit": "HORIZONTAL", "shift": (0.1, 0.2)},
    "vertical fit": {"fit": "VERTICAL", "shift": (0.1, 0.2)},
    "percentage": {"resolution": (200, 120), "percentage": 50, "shift": (0.1, 0.2)},
    "wide pixels": {"aspect": (2.0, 1.0), "shift": (0.1, 0.2)},
    "tall pixels": {"aspect": (1.0, 1.5), "shift": (-0.1, 0.2)},
    "tall pixels turn landscape into vertical fit": {"aspect": (1.0, 2.5), "shift": (0.3, 0.2)},
    "tall pixels, vertical": {"aspect": (1.0, 1.5), "fit": "VERTICAL", "shift": (-0.1, 0.2)},
    "field of view": {"angle": 1.1, "resolution": (80, 80)},
    "scaled camera": {"scale": (2.0, 0.5, 3.0)},
    "orthographic": {"ortho": 3.7, "shift": (0.17, -0.08)},
    "orthographic portrait of tall pixels": {"ortho": 3.7, "resolution": (60, 100), "aspect": (1.0, 1.5)},
    "a region": {"region": (0.213, 0.777, 0.158, 0.911), "shift": (0.1, 0.2), "resolution": (100, 60)},
    "a region of a portrait": {"region": (0.213, 0.777, 0.25, 0.911), "resolution": (61, 103)},
    "an orthographic region": {"region": (0.213, 0.83, 0.158, 0.9), "ortho": 3.1, "aspect": (1.0, 1.3)},
}


def set_up_camera(scene, add_camera, how):
    camera = add_camera(scene, (3.1, -4.2, 2.3), (0.2, 0.1, -0.1))
    camera.data.sensor_width, camera.data.sensor_height = 36.0, 20.0
    camera.data.lens = 43.0
    camera.data.shift_x, camera.data.shift_y = how.get("shift", (0, 0))
    camera.data.sensor_fit = how.get("fit", "AUTO")
    if "angle" in how:
        camera.data.angle = how["angle"]
    camera.scale = how.get("scale", (1, 1, 1))
    scene.render.resolution_x, scene.render.resolution_y = how.get("resolution", (100, 60))
    scene.render.resolution_percentage = how.get("percentage", 100)
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = how.get("aspect", (1, 1))
    if "ortho" in how:
        camera.data.type, camera.data.ortho_scale = "ORTHO", how["ortho"]
    if "region" in how:
        render = scene.render
        render.use_border = render.use_crop_to_border = True
        for name, share in zip(("min_x", "max_x", "min_y", "max_y"), how["region"], strict=True):
            setattr(render, f"border_{name}", share)
    bpy.context.view_layer.update()
    return camera


@pytest.mark.parametrize("name", CAMERAS)
def test_camera_projects_as_blender_does(scene, add_camera, name):
    camera = set_up_camera(scene, add_camera, CAMERAS[name])
    width, height = render_size(scene)
    job = intrinsics(scene, camera, width, height)
    job["to_world"] = to_world(camera)
    points = np.random.default_rng(0).uniform(-1, 1, (40, 3))
    view = np.array([world_to_camera_view(scene, camera, Vector(p)) for p in points])
    expected = np.stack([view[:, 0] * width, (1 - view[:, 1]) * height], -1)
    found = project(job, points)
    if "scale" in CAMERAS[name]:
        # world_to_camera_view takes the camera's scale along; a render does not (next test), so compare rays instead
        camera.scale = (1, 1, 1)
        bpy.context.view_layer.update()
        view = np.array([world_to_camera_view(scene, camera, Vector(p)) for p in points])
        expected = np.stack([view[:, 0] * width, (1 - view[:, 1]) * height], -1)
    assert np.abs(found - expected).max() < 1e-4


RENDERED = ["shifted portrait", "tall pixels", "vertical fit", "scaled camera", "percentage"]
RENDERED += [name for name in CAMERAS if "region" in name or "ortho" in name]


@pytest.mark.parametrize("name", RENDERED)
def test_camera_projects_as_cycles_renders(scene, add_camera, render, name):
    """A small bright ball must appear where the job says: the only judge of the pixel grid is a picture."""
    camera = set_up_camera(scene, add_camera, CAMERAS[name])
    centre = Vector((0.35, -0.2, 0.3))
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, radius=0.12, location=centre)
    bpy.context.object.data.materials.append(materials.shaded("Glow", "ShaderNodeEmission")[0])
    picture = render(scene)[..., 0]
    job = for_photo(scene, camera, picture.shape[::-1])
    job["to_world"] = to_world(camera)
    y, x = np.indices(picture.shape) + 0.5
    seen = np.array([(picture * x).sum(), (picture * y).sum()]) / picture.sum()
    # The outline of a ball is not centred on the image of its centre: average the images of its points instead.
    offsets = np.random.default_rng(1).normal(size=(20000, 3))
    offsets *= 0.12 / np.linalg.norm(offsets, axis=1, keepdims=True)
    outline = project(job, np.array(centre) + offsets)
    middle = (outline.min(0) + outline.max(0)) / 2
    assert np.abs(seen - middle).max() < 0.06


def test_a_photo_of_another_size_scales_the_camera(scene, add_camera):
    camera = set_up_camera(scene, add_camera, CAMERAS["shifted"])
    small, large = for_photo(scene, camera, (100, 60)), for_photo(scene, camera, (300, 180))
    for key in ("fx", "fy", "cx", "cy"):
        assert large[key] == pytest.approx(3 * small[key])
    with pytest.raises(InputError, match="the scene renders 100 x 60"):
        for_photo(scene, camera, (100, 70))


def test_a_panorama_is_refused(scene, add_camera):
    camera = add_camera(scene, (0, -5, 0))
    camera.data.type = "PANO"
    with pytest.raises(InputError, match="choose a perspective or orthographic camera"):
        intrinsics(scene, camera, 10, 10)


def test_which_part_of_the_picture_a_photo_shows(scene, add_camera):
    camera = set_up_camera(scene, add_camera, {"region": (0.2, 0.5, 0.25, 0.75), "resolution": (100, 80)})
    assert shown(scene, (30, 40)) == shown(scene, (90, 120)) == (20, 20, 30, 40)
    assert shown(scene, (100, 80)) == shown(scene, (50, 40)) == (0, 0, 100, 80)
    assert shown(scene, (50, 50)) is None
    part, whole = for_photo(scene, camera, (90, 120)), for_photo(scene, camera, (300, 240))
    assert (part["fx"], part["cx"]) == pytest.approx((whole["fx"], whole["cx"] - 60))
    assert (part["fy"], part["cy"]) == pytest.approx((whole["fy"], whole["cy"] - 60))
    scene.render.use_crop_to_border = False
    with pytest.raises(InputError, match="the scene renders 100 x 80"):
        for_photo(scene, camera, (30, 40))


@pytest.fixture
def filmed(scene, add_camera, tmp_path):
    """A camera before a movie clip of 160 x 120 pixels, whose picture holds each pixel's place (y downwards)."""
    camera = add_camera(scene, (0, -5, 0))
    scene.render.resolution_x, scene.render.resolution_y = 160, 120
    rows, columns = np.mgrid[:120, :160] + 0.5
    image = bpy.data.images.new("places", 160, 120, float_buffer=True, is_data=True)
    places = np.stack([columns, rows, np.ones_like(rows), np.ones_like(rows)], -1)[::-1]
    image.pixels.foreach_set(places.astype(np.float32).ravel())
    image.filepath_raw, image.file_format = str(tmp_path / "places.exr"), "OPEN_EXR"
    image.save()
    clip = bpy.data.movieclips.load(str(tmp_path / "places.exr"))
    lens = clip.tracking.camera
    lens.sensor_width, lens.units, lens.focal_length = 36.0, "MILLIMETERS", 30.0
    lens.k1 = lens.k2 = lens.k3 = 0.0
    camera.data.sensor_width, camera.data.lens = 36.0, 30.0
    background = camera.data.background_images.new()
    background.source, background.clip = "MOVIE_CLIP", clip
    return camera, lens


LENSES = {
    "polynomial": {"distortion_model": "POLYNOMIAL", "k1": -0.2, "k2": 0.05},
    "Brown": {"distortion_model": "BROWN", "brown_k1": -0.15, "brown_p1": 0.03, "brown_p2": -0.02},
}


def compositing(scene):
    """An empty tree of compositing nodes, and its end, which has an input "Image": since Blender 5 that of a group."""
    if hasattr(scene, "compositing_node_group"):
        tree = scene.compositing_node_group = bpy.data.node_groups.new("lens", "CompositorNodeTree")
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        return tree, tree.nodes.new("NodeGroupOutput")
    scene.use_nodes = True
    scene.node_tree.nodes.clear()
    return scene.node_tree, scene.node_tree.nodes.new("CompositorNodeComposite")


@pytest.mark.parametrize("model", LENSES)
def test_the_lens_of_a_clip_distorts_as_blender_does(scene, filmed, render, model):
    """Blender's own Movie Distortion gives, at each pixel, the place that was there before the lens."""
    camera, lens = filmed
    for name, value in LENSES[model].items():
        setattr(lens, name, value)
    said = []
    job = for_photo(scene, camera, (160, 120))
    found = distortion(scene, camera, job, warn=said.append)
    assert "the photo is taken to have" in said[0]
    tree, end = compositing(scene)
    nodes = [tree.nodes.new(f"CompositorNode{kind}") for kind in ("MovieClip", "MovieDistortion")]
    nodes[0].clip = nodes[1].clip = bpy.data.movieclips[0]
    if hasattr(nodes[1], "distortion_type"):
        nodes[1].distortion_type = "DISTORT"
    else:
        nodes[1].inputs["Type"].default_value = "Distort"
    nodes.append(end)
    for one, other in itertools.pairwise(nodes):
        tree.links.new(one.outputs["Image"], other.inputs["Image"])
    places = render(scene)
    sizes = (job[key] for key in ("width", "height", "fx", "fy", "cx", "cy"))
    rows, columns = np.mgrid[:120, :160] + 0.5
    engine = Camera(*sizes, np.eye(4), tuple(found.values()))
    local = (places[..., :2] - [job["cx"], job["cy"]]) / [job["fx"], -job["fy"]]
    seen = engine.project(np.concatenate([local, -np.ones((120, 160, 1))], -1).reshape(-1, 3)).reshape(120, 160, 2)
    inside = ((places[..., :2] > 8) & (places[..., :2] < [152, 112]) & (places[..., 2:] > 0.99)).all(-1)
    assert inside.mean() > 0.5
    # the node's picture is larger than what it is given, and lies a few pixels aside, or halves: nothing of the lens
    off = (seen - np.stack([columns, rows], -1))[inside]
    aside = np.median(off, 0)
    np.testing.assert_allclose(2 * aside, np.round(2 * aside), atol=0.1)
    assert np.abs(off - aside).max() < 0.3
    assert np.abs(seen - places[..., :2])[inside].max() > 4


def test_a_lens_of_another_focal_length_and_size_is_the_same_lens(scene, filmed):
    camera, lens = filmed
    lens.k1, lens.k2 = -0.2, 0.05
    small = distortion(scene, camera, for_photo(scene, camera, (160, 120)))
    large = distortion(scene, camera, for_photo(scene, camera, (320, 240)))
    assert large == pytest.approx(small)
    camera.data.lens = 60.0  # the distortion is the clip's, in its own pixels
    longer = distortion(scene, camera, for_photo(scene, camera, (160, 120)))
    assert longer["k1"] == pytest.approx(4 * small["k1"])
    assert longer["k2"] == pytest.approx(16 * small["k2"])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"k1": 0.1, "k3": 0.02}, "has more terms"),
        ({"distortion_model": "DIVISION", "division_k1": 0.1}, "the model Division"),
        ({"k1": 0.1, "principal_point": (0.2, 0.0)}, "10.0 % of the width"),
        ({"k1": 0.1, "pixel_aspect": 1.5}, "not square"),
    ],
)
def test_a_lens_that_is_not_the_jobs_is_said(scene, filmed, changes, words):
    camera, lens = filmed
    for name, value in changes.items():
        setattr(lens, name, value)
    said = []
    assert distortion(scene, camera, for_photo(scene, camera, (160, 120)), warn=said.append) == {}
    (sentence,) = said
    assert words in sentence


def test_no_lens_is_no_lens(scene, filmed):
    camera, lens = filmed
    pinhole, said = for_photo(scene, camera, (160, 120)), []
    assert distortion(scene, camera, pinhole, warn=said.append) == {}
    lens.k1 = 0.1
    camera.data.background_images[0].clip_user.use_render_undistorted = True
    assert distortion(scene, camera, pinhole, warn=said.append) == {}
    assert not said


def test_a_mirrored_camera_is_refused(scene, add_camera):
    camera = add_camera(scene, (0, -5, 0))
    camera.scale = (-1, 1, 1)
    bpy.context.view_layer.update()
    with pytest.raises(InputError, match="negative"):
        to_world(camera)
