# SPDX-License-Identifier: GPL-3.0-or-later
"""The job folder against Blender's own evaluated meshes and the contract."""

import json

import bpy
import numpy as np
import pytest
import trimesh
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector

from blender_btfsep.basics.errors import InputError
from blender_btfsep.scene import export, meshes
from scripts.cycles import studio


def make_photo(tmp_path, width=96, height=64, name="photo.png", colour=(0.5, 0.25, 0.125)):
    image = bpy.data.images.new("Made", width, height)
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = colour
    image.pixels.foreach_set(pixels.ravel())
    image.filepath_raw = str(tmp_path / name)
    image.file_format = "PNG"
    image.save()
    bpy.data.images.remove(image)
    return tmp_path / name


def add_cube(name="Thing", **transform):
    bpy.ops.mesh.primitive_cube_add(**transform)
    bpy.context.object.name = name
    return bpy.context.object


TRANSFORMS = {
    "as it is": Matrix(),
    "turned": Matrix.LocRotScale((1, 2, 3), Matrix.Rotation(0.7, 3, "X"), (1, 1, 1)),
    "non-uniform": Matrix.LocRotScale((0.3, 0, 1), Matrix.Rotation(-0.4, 3, (1, 2, 3)), (0.5, 2.0, 3.0)),
    "mirrored": Matrix.LocRotScale((0.3, 0, 1), Matrix.Rotation(-0.4, 3, (1, 2, 3)), (-0.5, 2.0, 1.0)),
}


@pytest.mark.parametrize("name", TRANSFORMS)
@pytest.mark.parametrize("smooth", [False, True])
def test_mesh_is_the_evaluated_mesh_in_world_space(scene, add_camera, tmp_path, name, smooth):
    """Against Blender itself: the same transform applied to the mesh, its faces and normals computed anew."""
    camera = add_camera(scene, (0, -9, 0))
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    bpy.ops.mesh.primitive_monkey_add()
    thing = bpy.context.object
    thing.name = "Monkey / 1"
    (thing.data.shade_smooth if smooth else thing.data.shade_flat)()
    subdivision = thing.modifiers.new("Subdivision", "SUBSURF")
    subdivision.levels, subdivision.render_levels = 0, 1
    thing.matrix_world = TRANSFORMS[name]
    bpy.context.view_layer.update()
    path = export.export_job(
        scene, tmp_path / "job", image_path=make_photo(tmp_path), camera=camera, objects=[thing], occluders=[]
    )
    assert subdivision.levels == 0  # the user's scene is as it was
    job = json.loads(path.read_text())
    loaded = trimesh.load(path.parent / job["objects"][0]["mesh"], process=False)

    subdivision.levels = 1
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    reference = bpy.data.meshes.new_from_object(evaluated)
    reference.transform(evaluated.matrix_world)
    if evaluated.matrix_world.is_negative:
        reference.flip_normals()
    reference.calc_loop_triangles()
    corners = np.array([t.vertices for t in reference.loop_triangles])
    points = np.array([v.co for v in reference.vertices])[corners]
    normals = np.array([n.vector for n in reference.corner_normals])
    normals = normals[np.array([t.loops for t in reference.loop_triangles])]

    def as_sorted(positions, shading):
        """Triangles in an order that depends on neither their order nor their first corner."""
        centres = positions.mean(1)
        order = np.lexsort(np.round(centres, 3).T)
        areas = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0]) / 2
        return centres[order], areas[order], shading.mean(1)[order]

    found = as_sorted(np.asarray(loaded.vertices)[loaded.faces], np.asarray(loaded.vertex_normals)[loaded.faces])
    expected = as_sorted(points, normals)
    assert len(found[0]) == len(expected[0]) == 3936
    # Subdivision makes quads that are not flat, and a mirror may change the diagonal: compare what does not depend
    # on it for all, and triangle by triangle where the diagonal is the same.
    same = np.abs(found[0] - expected[0]).max(1) < 2e-3
    assert same.mean() > (0.99 if not name == "mirrored" else 0.5)
    assert np.abs(found[1] - expected[1])[same].max() < 1e-3
    if smooth:
        # Under an uneven scale Blender, asked anew, weighs the faces at a vertex a little differently from what it
        # shows (the normals of the unscaled mesh, turned): near is enough there, the ellipsoid below is exact.
        limit = np.cos(np.radians(1 if name in {"as it is", "turned"} else 20))
        cosine = (
            np.sum(found[2] * expected[2], -1) / np.linalg.norm(found[2], axis=1) / np.linalg.norm(expected[2], axis=1)
        )
        assert (cosine[same] > limit).mean() > 0.98
    total = np.linalg.norm(expected[1], axis=1).sum()
    assert np.linalg.norm(found[1], axis=1).sum() == pytest.approx(total, rel=2e-3)
    assert np.abs(found[1].sum(0)).max() < 0.2 * total  # and it is no inside-out: normals agree with the winding
    assert (np.sum(found[1] * found[2], -1) > 0).mean() > 0.97


def test_normals_stay_perpendicular_under_uneven_scale(scene):
    """A sphere squeezed into an ellipsoid: its normals are known in closed form. Mirrored, too."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32)
    mesh = bpy.context.object.data
    mesh.shade_smooth()
    for scale in ((1, 2, 0.5), (-1, 2, 0.5), (-1, -2, -0.5)):
        got = meshes.triangles_of_mesh(mesh, Matrix.Diagonal((*scale, 1)))
        expected = got["positions"] / np.square(scale)
        expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
        assert np.sum(expected * got["normals"], -1).min() > np.cos(np.radians(1.0))
        p = got["positions"]
        face = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        assert (np.sum(face * expected.mean(1), -1) > 0).all()


def test_flat_smooth_and_custom_normals_survive_the_file(scene, tmp_path, add_camera):
    camera = add_camera(scene, (0, -9, 0))
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    photo = make_photo(tmp_path)
    cube = add_cube()

    def exported():
        path = export.export_job(scene, tmp_path / "job", image_path=photo, camera=camera, objects=[cube], occluders=[])
        return trimesh.load(path.parent / "Thing.ply", process=False)

    flat = exported()
    assert len(flat.vertices) == 24
    assert np.allclose(flat.face_normals[:, None], flat.vertex_normals[flat.faces])
    cube.data.shade_smooth()
    smooth = exported()
    # the primitive's UV map has seams, and a corner may stand in the file once a UV
    assert np.allclose(smooth.vertex_normals, smooth.vertices / np.sqrt(3), atol=1e-6)
    lean = Vector((0.2, 0.3, 0.9)).normalized()
    cube.data.normals_split_custom_set([lean] * len(cube.data.loops))
    assert np.allclose(exported().vertex_normals, lean, atol=2e-4)


def test_uv_map_that_is_active_for_rendering_is_written(scene, tmp_path, add_camera):
    from btfsep_engine.job import meshes as engine_meshes  # the reader on the other side of the contract

    camera = add_camera(scene, (0, -9, 0))
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    cube = add_cube()
    other = cube.data.uv_layers.new(name="Other")
    values = np.random.default_rng(0).uniform(size=(len(cube.data.loops), 2)).astype(np.float32)
    other.uv.foreach_set("vector", values.ravel())
    other.active_render = True
    export.export_job(
        scene, tmp_path / "job", image_path=make_photo(tmp_path), camera=camera, objects=[cube], occluders=[]
    )
    cube.data.calc_loop_triangles()
    loops = np.array([t.loops for t in cube.data.loop_triangles])
    assert engine_meshes is not None
    raw = trimesh.load(tmp_path / "job" / "Thing.ply", process=False).metadata["_ply_raw"]["vertex"]["data"]
    faces = trimesh.load(tmp_path / "job" / "Thing.ply", process=False).faces
    found = np.stack([raw["s"], raw["t"]], -1).reshape(-1, 2)[faces]
    assert np.array_equal(np.sort(found.reshape(-1, 2), 0), np.sort(values[loops].reshape(-1, 2), 0))
    assert np.array_equal(found, values[loops])


def test_the_job_says_what_the_contract_says(scene, tmp_path, add_camera):
    camera = add_camera(scene, (0, -9, 0))
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    scene.unit_settings.scale_length = 0.01
    one, two = add_cube("Wood block"), add_cube("Wood_block")
    path = export.export_job(
        scene,
        tmp_path / "job",
        image_path=make_photo(tmp_path),
        camera=camera,
        objects=[one, two],
        occluders=[],
        materials={"Wood block": "wood/oak"},
    )
    job = json.loads(path.read_text())
    assert {key: job[key] for key in ("format", "version", "image", "image_colorspace", "depth")} == {
        "format": "btfsep-job",
        "version": 1,
        "image": "photo.png",
        "image_colorspace": "auto",
        "depth": None,
    }
    assert job["metres_per_unit"] == pytest.approx(0.01)
    assert [(o["name"], o["mesh"], o["material"]) for o in job["objects"]] == [
        ("Wood block", "Wood_block.ply", "wood/oak"),
        ("Wood_block", "Wood_block_2.ply", None),
    ]
    assert sorted(p.name for p in path.parent.iterdir()) == sorted(
        ["job.json", "photo.png", "Wood_block.ply", "Wood_block_2.ply"]
    )


def test_the_engine_reads_the_job(scene, tmp_path, add_camera):
    """The reader on the other side of the contract sees the points where Blender has them."""
    from btfsep_engine.job.load import load_job

    camera = add_camera(scene, (2, -6, 1.5))
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    cube = add_cube()
    path = export.export_job(
        scene, tmp_path / "job", image_path=make_photo(tmp_path), camera=camera, objects=[cube], occluders=[]
    )
    job = load_job(path.parent)
    assert job.photo.radiance.shape == (64, 96, 3)
    # sRGB-coded 0.5, 0.25, 0.125 by the standard's formula, as 8-bit values
    coded = np.round(np.array([0.5, 0.25, 0.125]) * 255) / 255
    assert np.allclose(job.photo.radiance[0, 0], ((coded + 0.055) / 1.055) ** 2.4, atol=2e-3)
    mesh = job.objects[0].mesh
    assert len(mesh.faces) == 12 and np.allclose(np.abs(mesh.vertices), 1)
    corners = mesh.vertices[mesh.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 4
    assert np.allclose(flat[:, None], mesh.corner_normals, atol=1e-5)
    expected = world_to_camera_view(scene, camera, Vector((1, -1, 1)))
    origin, ray = job.camera.rays([expected.x * 96], [(1 - expected.y) * 64])
    to_corner = np.array([1, -1, 1]) - origin[0]
    assert np.allclose(ray[0], to_corner / np.linalg.norm(to_corner), atol=1e-5)


def test_photos_that_are_no_plain_file_are_saved_linear(scene, tmp_path, add_camera):

    camera = add_camera(scene, (0, -9, 0))
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    cube = add_cube()
    image = bpy.data.images.new("Painted", 96, 64, float_buffer=True)
    pixels = np.random.default_rng(0).uniform(0, 4, (64, 96, 4)).astype(np.float32)
    pixels[..., 3] = 1
    image.pixels.foreach_set(pixels.ravel())
    path = export.export_job(scene, tmp_path / "job", image_path=image, camera=camera, objects=[cube], occluders=[])
    job = json.loads(path.read_text())
    assert (job["image"], job["image_colorspace"]) == ("photo.exr", "linear")
    assert np.allclose(studio.read_image(path.parent / "photo.exr"), pixels[::-1, :, :3], rtol=1e-5)
    assert len(bpy.data.scenes) == 1

    linear = bpy.data.images.load(str(make_photo(tmp_path)))
    linear.colorspace_settings.name = "Non-Color"
    linear.pack()
    path = export.export_job(scene, tmp_path / "job2", image_path=linear, camera=camera, objects=[cube], occluders=[])
    job = json.loads(path.read_text())
    assert (job["image"], job["image_colorspace"]) == ("photo.png", "linear")
    assert (path.parent / "photo.png").read_bytes() == (tmp_path / "photo.png").read_bytes()


def test_the_photos_curve_goes_with_whole_numbers_only(scene, tmp_path, add_camera):
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    camera, cube = add_camera(scene, (0, -9, 0)), add_cube()
    given = {"camera": camera, "objects": [cube], "occluders": [], "curve": "unknown"}
    path = export.export_job(scene, tmp_path / "job", image_path=make_photo(tmp_path), **given)
    assert json.loads(path.read_text())["image_colorspace"] == "unknown"
    painted = bpy.data.images.new("Painted", 96, 64, float_buffer=True)
    path = export.export_job(scene, tmp_path / "job2", image_path=painted, **given)
    assert json.loads(path.read_text())["image_colorspace"] == "linear"


def surface_and_texture(path):
    """Triangles and texture triangles of a job's only object: (f, 3, 3) and (f, 3, 2), or None without UVs."""
    mesh = trimesh.load(path.parent / json.loads(path.read_text())["objects"][0]["mesh"], process=False)
    uv = getattr(mesh.visual, "uv", None)
    return mesh.triangles, None if uv is None else np.asarray(uv)[mesh.faces]


def angles(triangles):
    """(f, 3) corner angles, radians."""
    a, b = np.roll(triangles, -1, 1) - triangles, np.roll(triangles, 1, 1) - triangles
    return np.arccos(np.clip((a * b).sum(2) / np.linalg.norm(a, axis=2) / np.linalg.norm(b, axis=2), -1, 1))


@pytest.mark.parametrize("editing", [False, True])
def test_blenders_unwrap_is_of_a_copy_and_keeps_angles_and_sizes(scene, tmp_path, add_camera, editing):
    camera = add_camera(scene, (0, -9, 0))
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    bpy.ops.mesh.primitive_monkey_add(location=(1000, 0, 0))
    monkey = bpy.context.object
    kept = [tuple(corner.vector) for corner in monkey.data.uv_layers[0].uv]
    scenes, meshes_before, objects = len(bpy.data.scenes), len(bpy.data.meshes), len(bpy.data.objects)
    if editing:
        bpy.ops.object.mode_set(mode="EDIT")
    try:
        path = export.export_job(
            scene, tmp_path / "job", image_path=make_photo(tmp_path), camera=camera, objects=[monkey], mapping="UNWRAP"
        )
        assert monkey.mode == ("EDIT" if editing else "OBJECT")
    finally:
        if editing:
            bpy.ops.object.mode_set(mode="OBJECT")
    assert json.loads(path.read_text())["objects"][0]["uv"] == "mesh"
    assert (len(bpy.data.scenes), len(bpy.data.meshes), len(bpy.data.objects)) == (scenes, meshes_before, objects)
    assert bpy.context.scene == scene and bpy.context.object == monkey
    assert [tuple(corner.vector) for corner in monkey.data.uv_layers[0].uv] == kept
    triangles, uv = surface_and_texture(path)
    wrong = np.degrees(np.abs(angles(triangles) - angles(uv.astype(np.float64)))).mean()
    assert wrong < 5  # the monkey's own UVs: 12; without seams 30
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    ratio = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )
    assert np.percentile(ratio, 95) < 2 * np.percentile(ratio, 5)


def test_the_objects_own_map_is_used_or_missed_in_words(scene, tmp_path, add_camera):
    camera = add_camera(scene, (0, -9, 0))
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    cube, photo = add_cube(), make_photo(tmp_path)
    given = {"image_path": photo, "camera": camera, "objects": [cube]}
    path = export.export_job(scene, tmp_path / "own", **given, mapping="OWN")
    assert json.loads(path.read_text())["objects"][0]["uv"] == "mesh"
    own = sorted({tuple(np.round(corner.vector, 5)) for corner in cube.data.uv_layers[0].uv})
    assert sorted(set(map(tuple, np.round(surface_and_texture(path)[1].reshape(-1, 2), 5).tolist()))) == own
    path = export.export_job(scene, tmp_path / "charts", **given)
    assert json.loads(path.read_text())["objects"][0]["uv"] == "xatlas"
    cube.data.uv_layers.remove(cube.data.uv_layers[0])
    cube.data.update_tag()
    bpy.context.view_layer.update()
    with pytest.raises(InputError, match="it has no UV map"):
        export.export_job(scene, tmp_path / "none", **given, mapping="OWN")


def test_objects_of_one_name_are_two_objects(photographed, tmp_path):
    """One of the file, one linked from another file, which has its own names."""
    from blender_btfsep.run import request

    settings, own = photographed.btfsep, photographed.btfsep.objects[0].object
    twin = own.copy()
    twin.name = "Body"
    bpy.data.libraries.write(str(tmp_path / "other.blend"), {twin}, fake_user=True)
    bpy.data.objects.remove(twin)
    own.name = "Body"
    with bpy.data.libraries.load(str(tmp_path / "other.blend"), link=True) as (_, wanted):
        wanted.objects = ["Body"]
    linked = wanted.objects[0]
    photographed.collection.objects.link(linked)
    bpy.context.view_layer.update()
    settings.objects.add().object = linked
    settings.objects[0].material, settings.objects[1].material = "wood/oak", "stone/slate"
    found = json.loads((request.write_job(bpy.context) / "job.json").read_text())
    said = [(thing["name"], thing["material"]) for thing in found["objects"]]
    assert said == [("Body", "wood/oak"), (linked.name_full, "stone/slate")]
    assert len({thing["mesh"] for thing in found["objects"]}) == 2 and found["occluders"] == []
    ids = request.ids_of(settings)
    assert set(ids.values()) == {own.session_uid, linked.session_uid}
    assert [entry.object for entry in request.fitted(settings, ids).values()] == [own, linked]


def test_an_object_that_is_edited_is_as_rendered(scene):
    """In edit mode Blender shows no armature's bend, nor what else is switched off there, and one shape key alone."""
    thing = add_cube()
    smooth = thing.modifiers.new("Smooth", "SUBSURF")
    smooth.levels = smooth.render_levels = 2
    smooth.show_in_editmode = False
    thing.shape_key_add(name="Basis")
    key = thing.shape_key_add(name="Tall")
    for point in key.data:
        point.co.z *= 3
    key.value, thing.active_shape_key_index = 0.5, 0

    def shape():
        with meshes.as_rendered(bpy.context.view_layer, {thing}):
            bpy.context.view_layer.update()
            return meshes.gather(bpy.context.view_layer.depsgraph, [thing])["Thing"]["positions"]

    there = shape()
    bpy.ops.object.mode_set(mode="EDIT")
    edited = shape()
    assert edited.shape == there.shape and np.allclose(np.ptp(edited, (0, 1)), np.ptp(there, (0, 1)), atol=1e-5)
    assert thing.mode == "EDIT" and not smooth.show_in_editmode and not thing.use_shape_key_edit_mode
    bpy.ops.object.mode_set(mode="OBJECT")


def test_wrong_scenes_are_refused_in_words(scene, tmp_path, add_camera):
    photo = make_photo(tmp_path)
    cube = add_cube()
    job = tmp_path / "job"
    with pytest.raises(InputError, match="the camera"):
        export.export_job(scene, job, image_path=photo, objects=[cube])
    camera = add_camera(scene, (0, -9, 0))
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    with pytest.raises(InputError, match="none is chosen"):
        export.export_job(scene, job, image_path=photo, objects=[])
    with pytest.raises(InputError, match="it has no surface"):
        export.export_job(scene, job, image_path=photo, objects=[camera])
    with pytest.raises(InputError, match="no such file"):
        export.export_job(scene, job, image_path=tmp_path / "absent.png", objects=[cube])
    (tmp_path / "broken.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"broken.png"):
        export.export_job(scene, job, image_path=tmp_path / "broken.png", objects=[cube])
    empty = bpy.data.objects.new("Empty mesh", bpy.data.meshes.new("Empty mesh"))
    scene.collection.objects.link(empty)
    with pytest.raises(InputError, match="'Empty mesh'; it has no faces"):
        export.export_job(scene, job, image_path=photo, objects=[empty])
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="File exists; choose a folder that can be written, or do not keep jobs"):
        export.export_job(scene, tmp_path / "file", image_path=photo, objects=[cube])
    cube.scale = (0, 0, 0)
    with pytest.raises(InputError, match="it has no area: its scale is zero"):
        export.export_job(scene, job, image_path=photo, objects=[cube], surfaces={cube.name: "BLENDER"})
    assert not (job / "job.json").exists()
