# SPDX-License-Identifier: GPL-3.0-or-later
"""The job folder: a whole one is read as it is, and each thing that can be wrong is said in a sentence."""

import json
import os
import shutil

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from btfsep_engine.errors import InputError
from btfsep_engine.fit.tone_curve import CAMERA, SRGB
from btfsep_engine.imaging import camera_curve, images
from btfsep_engine.imaging.srgb import linear_to_srgb
from btfsep_engine.job.load import load_job
from btfsep_engine.job.model import Job
from btfsep_engine.pipeline.tone import codes_of, curve_read_by
from tests.engine.test_camera_curve import exif, with_exif


def changed(tree, path, value):
    """A tree with the value at "camera.fx" or "objects.0.mask" replaced; Ellipsis removes it."""
    *outer, last = [int(p) if p.isdigit() else p for p in path.split(".")]
    at = tree
    for part in outer:
        at = at[part]
    if value is ...:
        del at[last]
    else:
        at[last] = value
    return tree


def fails(job, words, path=None, value=None):
    """Loading has to fail with one sentence in words; returns it."""
    job.write(changed(job.copy(), path, value) if path else None)
    with pytest.raises(InputError, match=words) as caught:
        load_job(job.folder)
    text = str(caught.value)
    assert "\n" not in text and caught.value.do
    for jargon in ("pydantic", "Traceback", "type=", "validation error", "Errno"):
        assert jargon not in text
    return text


def test_a_whole_job(job):
    result = load_job(job.write())
    assert isinstance(result, Job)
    np.testing.assert_array_equal(result.photo.radiance, job.pixels)
    assert result.photo.usable.all() and result.photo.saturated == 0 and result.warnings == ()
    (cube,) = result.objects
    assert (cube.name, cube.uv, cube.material, cube.mask) == ("cube", "xatlas", None, None)
    assert cube.mesh.faces.shape == (12, 3) and cube.mesh.corner_uv.shape == (12, 3, 2)
    floor = result.occluders[0].mesh
    np.testing.assert_array_equal(floor.vertices.min(0), [-9, -9, -4])
    assert result.occluders[0].name == ""
    assert result.camera.fx == 14 and result.metres_per_unit == 1 and result.exposure_ev == 0
    assert load_job(job.folder / "job.json").digest == result.digest
    assert load_job(job.write(changed(job.copy(), "occluders.0.name", "Floor"))).occluders[0].name == "Floor"


def test_a_camera_with_a_lens_and_one_without_a_centre(job):
    tree = changed(job.copy(), "camera.k1", -0.1)
    lens = load_job(job.write(tree | {"camera": tree["camera"] | {"p2": 0.01}})).camera
    assert (lens.distortion, lens.orthographic) == ((-0.1, 0.0, 0.0, 0.01), False)
    flat = changed(job.copy(), "camera.projection", "orthographic")
    assert load_job(job.write(flat)).camera.orthographic
    job.write(changed(flat, "camera.k1", -0.1))
    with pytest.raises(InputError, match="orthographic and has a lens distortion"):
        load_job(job.folder)


def test_a_photo_of_an_unknown_curve_is_read_as_by_default_and_keeps_its_bits(job):
    cv2.imwrite(str(job.folder / "photo.png"), np.full((8, 12, 3), 128, np.uint8))
    tree = job.copy() | {"image": "photo.png", "image_colorspace": "unknown"}
    found = load_job(job.write(tree))
    assert (found.image_colorspace, found.photo.bits) == ("unknown", 8)
    np.testing.assert_array_equal(found.photo.radiance, load_job(job.folder, colorspace="auto").photo.radiance)
    linear = load_job(job.folder, colorspace="linear")
    assert linear.image_colorspace == "linear"
    np.testing.assert_allclose(linear.photo.radiance, 128 / 255)
    assert load_job(job.write()).photo.bits is None


def test_a_photo_that_names_its_camera_is_read_by_the_curve_of_cameras(job):
    (job.folder / "photo.jpg").write_bytes(with_exif(".jpg", exif("Canon", "Canon EOS 6D"), 8, 12))
    job.write(job.copy() | {"image": "photo.jpg"})
    photo, srgb = load_job(job.folder).photo, load_job(job.folder, colorspace="srgb").photo
    assert photo.camera == srgb.camera == "Canon EOS 6D"
    np.testing.assert_allclose(photo.radiance, camera_curve.to_scene(srgb.radiance), rtol=1e-5, atol=1e-6)
    unknown = load_job(job.folder, colorspace="unknown")
    for found, curve in ((load_job(job.folder), CAMERA), (unknown, CAMERA)):
        assert curve_read_by(found) == curve
    np.testing.assert_allclose(codes_of(unknown), linear_to_srgb(srgb.radiance), atol=1e-5)
    (job.folder / "photo.jpg").write_bytes(with_exif(".jpg", exif("", ""), 8, 12))
    assert curve_read_by(load_job(job.folder)) == SRGB


def test_only_what_is_needed_has_to_be_there(job):
    tree = job.copy()
    for key in ("image_colorspace", "exposure_ev", "occluders", "depth", "metres_per_unit"):
        del tree[key]
    tree["objects"] = [{"name": "cube", "mesh": "cube.obj"}]
    result = load_job(job.write(tree))
    assert result.occluders == () and result.objects[0].uv == "xatlas"


def test_the_digest_changes_with_every_file_and_with_nothing_else(job):
    mask = np.full((8, 12), 255, np.uint8)
    cv2.imwrite(str(job.folder / "mask.png"), mask)
    job.tree["objects"][0]["mask"] = "mask.png"
    seen = [load_job(job.write()).digest]
    (job.folder / "note.txt").write_text("not part of the job")
    assert load_job(job.folder).digest == seen[0]
    moved = job.folder.with_name("elsewhere")
    shutil.copytree(job.folder, moved)
    assert load_job(moved).digest == seen[0]
    mask[0, 0] = 0
    cv2.imwrite(str(job.folder / "mask.png"), mask)
    seen.append(load_job(job.folder).digest)
    job.exr("photo.exr", job.pixels * 2)
    seen.append(load_job(job.folder).digest)
    (job.folder / "cube.obj").write_text((job.folder / "cube.obj").read_text() + "# changed\n")
    seen.append(load_job(job.folder).digest)
    seen.append(load_job(job.write(changed(job.copy(), "exposure_ev", 1.0))).digest)
    assert len(set(seen)) == 5


def test_exposure_is_carried_and_not_applied(job):
    result = load_job(job.write(changed(job.copy(), "exposure_ev", 3.0)))
    assert result.exposure_ev == 3
    np.testing.assert_array_equal(result.photo.radiance, job.pixels)


def test_saturated_pixels_are_marked_by_channel_and_counted(job):
    a = np.full((8, 12, 3), 90, np.uint8)
    a[2, 3, 1] = 255
    a[5, 5] = 255
    cv2.imwrite(str(job.folder / "photo.png"), a)
    result = load_job(job.write(changed(job.copy(), "image", "photo.png")))
    assert result.photo.saturated == 2
    assert np.argwhere(~result.photo.usable).tolist() == [[2, 3], [5, 5]]
    # the file's channels are blue, green, red
    assert np.argwhere(result.photo.clipped).tolist() == [[2, 3, 1], [5, 5, 0], [5, 5, 1], [5, 5, 2]]
    assert result.warnings == ("photo.png: 2 of 96 pixels are saturated",)


def test_a_mask(job):
    mask = np.zeros((8, 12), np.uint8)
    mask[2:5, 3:9] = 7
    cv2.imwrite(str(job.folder / "mask.png"), mask)
    result = load_job(job.write(changed(job.copy(), "objects.0.mask", "mask.png")))
    np.testing.assert_array_equal(result.objects[0].mask, mask > 0)


def test_triangles_without_area_are_told(job):
    (job.folder / "cube.obj").write_text((job.folder / "cube.obj").read_text() + "f 1 1 2\n")
    assert "cube.obj: 1 of 13 triangles have no area and are left out" in load_job(job.write()).warnings


SINGULAR = [[1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
SCALED = [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 4], [0, 0, 0, 1]]
MIRRORED = [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
PROJECTIVE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 1, 1]]


@pytest.mark.parametrize(("path", "value", "words"), [
    ("format", "other-job", 'its format is "other-job"; it has to say "format": "btfsep-job"'),
    ("format", ..., "it has no 'format'"),
    ("version", 2, "its version is 2; use a newer BTFsep"),
    ("version", "1", 'its version is "1"'),
    ("version", True, "its version is true"),
    ("version", ..., "it has no 'version'"),
    ("imgae", "x", "imgae; this key is not known; did you mean 'image'?"),
    ("camera.focal", 1, "camera.focal; this key is not known; choose one of 'width'"),
    ("objects.0.msk", "m.png", r"objects\[0\].msk; this key is not known; did you mean 'mask'?"),
    ("occluders.0.mseh", "m.ply", r"occluders\[0\].mseh; this key is not known; did you mean 'mesh'?"),
    ("image", ..., "image; it is missing"),
    ("camera", ..., "camera; it is missing"),
    ("camera.fx", ..., "camera.fx; it is missing"),
    ("camera.fx", "700", 'camera.fx; it is "700"; it has to be a number'),
    ("camera.fx", True, "camera.fx; it is true; it has to be a number"),
    ("camera.fx", 1e-300, "it has to be greater than 1e-06"),
    ("image", "caf\udce9.exr", "it has to be a text of Unicode"),
    ("camera.fx", -1.0, "it has to be greater than 1e-06"),
    ("camera.fx", float("nan"), "camera.fx; it is nan; it has to be a finite number"),
    ("camera.cx", float("inf"), "camera.cx"),
    ("camera.width", 12.5, "camera.width; it is 12.5; it has to be a whole number"),
    ("camera.width", 0, "camera.width"),
    ("camera.width", 10**30, "camera.width"),
    ("camera.width", 13, "12 x 8 pixels and the camera 13 x 8"),
    ("camera.to_world", [[1, 0], [0, 1]], "camera.to_world"),
    ("camera.to_world", SINGULAR, "the matrix is singular"),
    ("camera.to_world", [[0, 0, 0, 0]] * 3 + [[0, 0, 0, 1]], "the matrix is singular"),
    ("camera.to_world", SCALED, "not of length 1 and at right angles"),
    ("camera.to_world", MIRRORED, "mirrors the scene"),
    ("camera.to_world", PROJECTIVE, "last row"),
    ("camera.to_world.0.0", float("nan"), "finite number"),
    ("camera.to_world.0.0", 1e308, "camera.to_world"),
    ("camera.to_world.0.3", 1e300, "far away"),
    ("camera.k1", "0", 'camera.k1; it is "0"; it has to be a number'),
    ("camera.k1", -9.0, "camera; its distortion folds the picture over"),
    ("camera.k3", 0.1, "camera.k3; this key is not known"),
    ("camera.projection", "ortho", "did you mean 'orthographic'?"),
    ("image", 3, "image; it is 3; it has to be a text"),
    ("image", None, "image; it is null; it has to be a text"),
    ("image", "", "image; it is empty"),
    ("image", "none.exr", "no file 'none.exr' in the job folder"),
    ("image", ".", "is a folder"),
    ("image", "x" * 999, "no file"),
    ("image", "job.json", "this is not an image"),
    ("image", "../job/photo.exr/../photo.exr/", "no file|not inside"),
    ("image", "../photo.exr", "not inside the job folder"),
    ("image", "a/../../photo.exr", "not inside the job folder"),
    ("image", "/etc/hostname", "not inside the job folder"),
    ("image", "C:\\photo.exr", "not inside the job folder"),
    ("image", "..\\photo.exr", "not inside the job folder"),
    ("image", "photo\0.exr", "not inside the job folder"),
    ("image_colorspace", "sRGB", "image_colorspace; it is \"sRGB\"; did you mean 'srgb'?"),
    ("image_colorspace", "liner", "did you mean 'linear'?"),
    ("image_colorspace", 7, "choose one of 'auto', 'srgb', 'camera', 'phone', 'linear', 'blender', 'agx', "),
    ("objects", [], "neither objects nor depth"),
    ("objects", {}, "objects; it is {}; it has to be a list"),
    ("objects.0", "cube.obj", r"objects\[0\]; it is \"cube.obj\"; it has to be an object"),
    ("objects.0.name", "", r"objects\[0\].name; it is empty"),
    ("objects.0.mesh", "photo.exr", "photo.exr; this is neither a PLY nor an OBJ"),
    ("objects.0.mesh", "none.ply", "object 'cube': mesh; there is no file 'none.ply'"),
    ("objects.0.mesh", "../cube.obj", "not inside the job folder"),
    ("objects.0.mesh", None, "it has no mesh, and the job has no depth"),
    ("objects.0.uv", "xatlass", r"objects\[0\].uv; it is \"xatlass\"; did you mean 'xatlas'?"),
    ("objects.0.uv", "abf", "choose one of 'xatlas', 'mesh'"),
    ("objects.0.to_world", SINGULAR, "object 'cube': to_world; the matrix is singular"),
    ("objects.0.to_world", PROJECTIVE, "last row"),
    ("objects.0.mask", "none.png", "object 'cube': mask; there is no file 'none.png'"),
    ("objects.0.mask", "cube.obj", "this is not an image"),
    ("objects.0.mask", False, "it has to be a text"),
    ("occluders.0.to_world", SINGULAR, r"occluders\[0\]: to_world; the matrix is singular"),
    ("metres_per_unit", 0, "metres_per_unit; it is 0; it has to be greater than 0"),
    ("metres_per_unit", -1.0, "greater than 0"),
    ("metres_per_unit", 10**400, "metres_per_unit"),
    ("exposure_ev", 1e6, "it has to be at most 100"),
    ("depth", "photo.exr", "both depth and meshes"),
    ("known_lamps", [[0, 0, 1]], r"known_lamps\[0\]; it is \[0, 0, 1\]; it has to be an object"),
    ("known_lamps", [{}], r"known_lamps\[0\].direction; it is missing"),
    ("known_lamps", [{"direction": [0, 1]}], r"known_lamps\[0\].direction; it has 2 entries"),
    ("known_lamps", [{"direction": [0.0, float("nan"), 1.0]}], r"direction\[1\]; it is nan; .* a finite number"),
    ("known_lamps", [{"direction": [0.0, float("inf"), 1.0]}], r"known_lamps\[0\].direction\[1\]"),
    ("known_lamps", [{"direction": [0, 0.0, 0]}], r"known_lamps\[0\]; its direction is \[0.0, 0.0, 0.0\]"),
    ("known_lamps", [{"direction": [0, 0, 1], "direction_stddev_degrees": -1.0}], "it has to be at least 0"),
    ("known_lamps", [{"direction": [0, 0, 1], "direction_stddev_degrees": 90.0}], "it has to be at most 45"),
    ("known_lamps", [{"direction": [0, 0, 1], "power": 3.0}], r"known_lamps\[0\].power; this key is not known"),
    ("known_lamps", [{"direction": [1, i, 0]} for i in range(9)], "known_lamps; it has 9 entries; it needs at most 8"),
    ("known_lamps", [{"direction": [1, 0, 0]}, {"direction": [5.0, 0.01, 0]}], "it stands where lamp"),
])  # fmt: skip
def test_what_is_wrong_in_job_json(job, path, value, words):
    fails(job, words, path, value)


def test_lamps_whose_direction_is_known(job):
    job.tree["known_lamps"] = [{"direction": [0, 3, 4]}, {"direction": [-1e-3, 0, 0], "direction_stddev_degrees": 5.0}]
    first, second = load_job(job.write()).known_lamps
    np.testing.assert_allclose([first.direction, second.direction], [[0, 0.6, 0.8], [-1, 0, 0]])
    assert (first.degrees, second.degrees) == (1.0, 5.0)
    # by angles, instead of these: up, then from +X towards +Y
    first, second = load_job(job.folder, suns=[(30.0, 90.0), (0.0, -90.0, 3.0)]).known_lamps
    np.testing.assert_allclose(first.direction, [0, np.sqrt(3) / 2, 0.5], atol=1e-12)
    np.testing.assert_allclose(second.direction, [0, -1, 0], atol=1e-12)
    assert (first.degrees, second.degrees) == (1.0, 3.0)
    with pytest.raises(InputError, match=r"--sun\[1\]; it stands where lamp \[0\] stands"):
        load_job(job.folder, suns=[(30.0, 10.0), (30.2, 370.0)])
    with pytest.raises(InputError, match="--sun; it has 9 lamps; name at most 8"):
        load_job(job.folder, suns=[(0.0, 10.0 * i) for i in range(9)])


def test_two_objects_of_one_name(job):
    job.tree["objects"].append(dict(job.tree["objects"][0]))
    fails(job, "two objects have the name 'cube'")


def test_absurdly_many_objects(job):
    job.tree["objects"] = [{"name": str(i), "mesh": "cube.obj"} for i in range(1001)]
    fails(job, "objects; it has 1001 entries; it needs at most 1000")


@pytest.mark.parametrize(("text", "words"), [
    (b"", "the file is empty|not valid JSON"),
    (b"{", "line 1 is not valid JSON"),
    (b"{\n\"format\": 'x'}", "line 2 is not valid JSON"),
    (b"[1, 2]", "does not hold a JSON object"),
    (b"null", "does not hold a JSON object"),
    (b"\xff\xfe\x00", "not a JSON file"),
    (b"[" * 100000, "not a JSON file|not valid JSON"),
    (b'{"a": 1, "a": 2}', "the key 'a' stands there twice"),
    (b'{"version": ' + b"9" * 5000 + b"}", "not a JSON file"),
])  # fmt: skip
def test_job_json_that_is_none(job, text, words):
    (job.folder / "job.json").write_bytes(text)
    with pytest.raises(InputError, match=words):
        load_job(job.folder)


def test_a_byte_order_mark_is_no_fault(job):
    job.write()
    text = (job.folder / "job.json").read_bytes()
    (job.folder / "job.json").write_bytes(b"\xef\xbb\xbf" + text)
    load_job(job.folder)


def test_no_folder_and_no_job_in_it(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        load_job(tmp_path / "none")
    with pytest.raises(InputError, match=r"no file 'job\.json'"):
        load_job(tmp_path)


@pytest.mark.skipif(os.name != "posix", reason="symbolic links")
def test_links_that_lead_out_of_the_folder_are_refused(job, tmp_path):
    shutil.copy(job.folder / "photo.exr", tmp_path / "outside.exr")
    (job.folder / "link.exr").symlink_to(tmp_path / "outside.exr")
    fails(job, "'link.exr' is a link, or lies behind one, that leads out of the job folder", "image", "link.exr")
    (job.folder / "round.exr").symlink_to(job.folder / "round.exr")
    fails(job, "no file", "image", "round.exr")
    os.mkfifo(job.folder / "pipe.exr")
    fails(job, "no file", "image", "pipe.exr")


def test_pixels_that_are_not_finite_are_counted_and_the_first_is_named(job):
    job.pixels[3, 7, 1] = np.nan
    job.pixels[6, 2] = np.inf
    job.exr("photo.exr", job.pixels)
    fails(job, "photo.exr; 2 pixels are NaN or infinite, first x 7, y 3")


def test_a_photo_that_is_white_all_over(job):
    cv2.imwrite(str(job.folder / "photo.png"), np.full((8, 12, 3), 255, np.uint8))
    fails(job, "every pixel is saturated or transparent", "image", "photo.png")


def test_masks_that_are_wrong(job):
    cv2.imwrite(str(job.folder / "small.png"), np.full((4, 12), 255, np.uint8))
    fails(job, "it has 12 x 4 pixels and the camera 12 x 8", "objects.0.mask", "small.png")
    cv2.imwrite(str(job.folder / "black.png"), np.zeros((8, 12), np.uint8))
    fails(job, "the mask is empty", "objects.0.mask", "black.png")


@pytest.mark.parametrize("what", ["image", "objects.0.mask"])
def test_what_is_not_of_the_cameras_size_is_not_even_decoded(job, monkeypatch, what):
    """A good PNG of 40 kB whose pixels would take 200 MB: its header is enough."""
    cv2.imwrite(str(job.folder / "large.png"), np.zeros((6000, 6000), np.uint8))
    assert (job.folder / "large.png").stat().st_size < 50_000
    monkeypatch.setattr(images, "_decode", lambda *_: pytest.fail("decoded"))
    fails(job, "large.png; it has 6000 x 6000 pixels and the camera 12 x 8", what, "large.png")


def test_a_camera_of_more_pixels_than_any_image_may_have(job):
    job.tree["camera"] |= {"width": 20000, "height": 20000}
    fails(job, "job.json: camera; 20000 x 20000 pixels; at most 134 million")


def test_uv_of_a_mesh_that_has_none(job):
    (job.folder / "bare.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    job.tree["objects"][0] |= {"uv": "mesh", "mesh": "bare.obj"}
    fails(job, "bare.obj; it has no usable UV map")


def test_a_truncated_photo(job):
    data = (job.folder / "photo.exr").read_bytes()
    (job.folder / "photo.exr").write_bytes(data[:-50])
    fails(job, "truncated or damaged")


def depth_job(job, depth):
    job.tree |= {"depth": "depth.exr", "objects": []}
    job.exr("depth.exr", np.asarray(depth, np.float32)[..., None], "Z")
    return job


def test_depth_instead_of_meshes(job):
    depth = np.full((8, 12), 4.0)
    depth[:, 9:] = np.inf
    result = load_job(depth_job(job, depth).write())
    (surface,) = result.objects
    assert surface.name == "surface" and surface.mesh.corner_uv is None and len(surface.mesh.faces) == 2 * 7 * 8
    cv2.imwrite(str(job.folder / "mask.png"), np.full((8, 12), 255, np.uint8))
    job.tree["objects"] = [{"name": "wall", "mesh": None, "mask": "mask.png", "material": "felt/a"}]
    (wall,) = load_job(job.write()).objects
    assert (wall.name, wall.material) == ("wall", "felt/a") and wall.mask.all()


def test_depths_that_are_wrong(job):
    depth = np.full((8, 12), 4.0)
    depth[2, 5] = np.nan
    fails(depth_job(job, depth), "depth.exr; 1 depths are NaN or negative, first x 5, y 2")
    fails(depth_job(job, -np.ones((8, 12))), "96 depths are NaN or negative")
    fails(depth_job(job, np.zeros((8, 12))), "no surface in it")
    fails(depth_job(job, np.ones((8, 11))), "it has 11 x 8 pixels and the camera 12 x 8")
    job.exr("depth.exr", np.ones((8, 12, 2), np.float32), "UA")
    fails(job, "no channel in it is a depth")


JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.sampled_from(["cube.obj", "..", "/"]),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)


def places(tree, at=()):
    """The paths of all nodes of a JSON tree."""
    yield at
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ():
        yield from places(value, (*at, key))


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_change_of_job_json_gives_a_job_or_an_input_error(job, data):
    tree = job.copy()
    for _ in range(data.draw(st.integers(1, 2))):
        *outer, last = data.draw(st.sampled_from([p for p in places(tree) if p]))
        at = tree
        for part in outer:
            at = at[part]
        what = data.draw(st.sampled_from(["replace", "remove", "add"]))
        if what == "replace":
            at[last] = data.draw(JSON)
        elif what == "remove":
            del at[last]
        elif isinstance(at, dict):
            at[data.draw(st.text(max_size=6))] = data.draw(JSON)
        if not any(p for p in places(tree)):
            break
    (job.folder / "job.json").write_text(json.dumps(tree))
    try:
        assert isinstance(load_job(job.folder), Job)
    except InputError as error:
        assert "\n" not in str(error)
