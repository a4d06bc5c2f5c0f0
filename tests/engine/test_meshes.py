# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes from PLY and OBJ: against trimesh, against known shapes, and every way in which a file can be wrong."""

import struct

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from btfsep_engine.errors import InputError
from btfsep_engine.job.meshes import load_mesh

TETRA = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
TETRA_FACES = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]


def ply(form, vertices, faces, *, properties=("x", "y", "z"), kind="float", index="int", count="uchar"):
    """The bytes of a PLY, written value by value."""
    head = [f"ply\nformat {form} 1.0\ncomment made by a test\nelement vertex {len(vertices)}"]
    head += [f"property {kind} {p}" for p in properties]
    head += [f"element face {len(faces)}\nproperty list {count} {index} vertex_indices\nend_header\n"]
    head = "\n".join(head).encode()
    if form == "ascii":
        rows = [" ".join(repr(float(x)) for x in v) for v in vertices]
        rows += [" ".join(str(i) for i in [len(f), *f]) for f in faces]
        return head + "\n".join(rows).encode() + b"\n"
    order = "<" if form == "binary_little_endian" else ">"
    letter = {"float": "f", "double": "d", "int": "i", "uint": "I", "ushort": "H", "uchar": "B"}
    body = b"".join(struct.pack(f"{order}{len(v)}{letter[kind]}", *v) for v in vertices)
    for f in faces:
        body += struct.pack(f"{order}{letter[count]}{len(f)}{letter[index]}", len(f), *f)
    return head + body


def geometric_normals(mesh):
    p = mesh.vertices[mesh.faces]
    n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    return n / np.linalg.norm(n, axis=-1, keepdims=True)


def area(mesh):
    p = mesh.vertices[mesh.faces]
    return np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=-1).sum() / 2


def load(tmp_path, data, name="m.ply", **options):
    path = tmp_path / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return load_mesh(path, **options)[0]


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("types", [("float", "int", "uchar"), ("double", "uint", "ushort")])
def test_ply_of_every_form(tmp_path, form, types):
    kind, index, count = types
    mesh = load(tmp_path, ply(form, TETRA, TETRA_FACES, kind=kind, index=index, count=count))
    np.testing.assert_array_equal(mesh.vertices, TETRA)
    np.testing.assert_array_equal(mesh.faces, TETRA_FACES)
    assert mesh.corner_uv is None and mesh.vertices.dtype == np.float64 and mesh.faces.dtype == np.int32


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_polygons_of_different_sizes(tmp_path, form):
    """A square, a triangle and a pentagon in one plane: the area says that all is there once."""
    angles = 2 * np.pi * np.arange(5) / 5
    vertices = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]]
    vertices += [[5 + np.cos(a), np.sin(a), 0] for a in angles]
    mesh = load(tmp_path, ply(form, vertices, [[0, 1, 2, 3], [1, 4, 2], [5, 6, 7, 8, 9]], kind="double"))
    assert len(mesh.faces) == 2 + 1 + 3
    assert area(mesh) == pytest.approx(1 + 0.5 + 2.5 * np.sin(2 * np.pi / 5))
    np.testing.assert_allclose(geometric_normals(mesh), np.tile([0, 0, 1], (6, 1)), atol=1e-12)


def test_a_concave_quadrilateral_is_cut_along_the_right_diagonal(tmp_path):
    arrow = [[0, 0, 0], [2, 2, 0], [0, 0.5, 0], [-2, 2, 0]]  # concave at the third corner; area 1
    for shift in range(4):
        mesh = load(tmp_path, ply("ascii", arrow, [np.roll([0, 1, 2, 3], shift).tolist()]))
        assert area(mesh) == pytest.approx(1)
        np.testing.assert_allclose(geometric_normals(mesh)[:, 2], 1)


def test_ply_agrees_with_trimesh(tmp_path):
    shape = trimesh.creation.icosphere(3)
    shape.export(tmp_path / "s.ply", vertex_normal=True)
    mesh, dropped = load_mesh(tmp_path / "s.ply")
    assert dropped == 0
    np.testing.assert_allclose(mesh.vertices, shape.vertices, atol=1e-6)
    np.testing.assert_array_equal(mesh.faces, shape.faces)
    np.testing.assert_allclose(mesh.corner_normals, shape.vertex_normals[shape.faces], atol=1e-6)


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_ply_uv_per_vertex(tmp_path, names):
    data = np.concatenate([TETRA, TETRA[:, :2] * 0.5 + 0.25], -1)
    mesh = load(tmp_path, ply("binary_little_endian", data, TETRA_FACES, properties=("x", "y", "z", *names)))
    np.testing.assert_allclose(mesh.corner_uv, data[np.array(TETRA_FACES)][..., 3:])


def test_ply_uv_per_face_corner(tmp_path):
    text = ply("ascii", TETRA[:3], []).decode().replace("face 0", "face 1")
    text = text.replace("vertex_indices", "vertex_indices\nproperty list uchar float texcoord")
    mesh = load(tmp_path, text + "3 0 1 2 6 0.1 0.2 0.3 0.4 0.5 0.6\n")
    np.testing.assert_allclose(mesh.corner_uv, [[[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]]], rtol=1e-6)


OBJ = """mtllib ../../../../etc/passwd
usemtl nothing
o one
v 0 0 0
v 1 0 0 # a comment
v 1 1 0 1.0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1 0
vn 0 0 1
"""


@pytest.mark.parametrize("face", [
    "f 1 2 3 4", "f 1/1 2/2 3/3 4/4", "f 1//1 2//1 3//1 4//1", "f 1/1/1 2/2/1 3/3/1 4/4/1", "f -4 -3 -2 -1",
    "f -4/-4/-1 -3/-3/-1 -2/-2/-1 -1/-1/-1", "f 1/1 2/2 \\\n 3/3 4/4", "f 1/1/1 2 3/3 4//1", "f 1 2 3\nf 1/1 3/3 4/4",
])  # fmt: skip
def test_obj_faces_of_every_form(tmp_path, face):
    for newline in ("\n", "\r\n"):
        mesh = load(tmp_path, (OBJ + face + "\n").replace("\n", newline), "m.obj")
        assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
        np.testing.assert_allclose(mesh.corner_normals, np.tile([0, 0, 1], (2, 3, 1)))
        if face.count("/") in (4, 8) and "//" not in face and "f 1 " not in face:
            np.testing.assert_allclose(mesh.corner_uv, mesh.vertices[mesh.faces][..., :2])
        if "/" not in face:
            assert mesh.corner_uv is None


def test_obj_numbers_that_count_back_from_where_they_stand(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 5\nv 1 0 5\nv 0 1 5\nf -3 -2 -1\n"
    mesh = load(tmp_path, text, "m.obj")
    assert mesh.faces.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_obj_uv_seam_gives_one_vertex_two_uv(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0 0\nvt .5 0\nvt 0 .5\nvt .9 .9\nf 1/1 2/2 3/3\nf 3/4 2/2 4/1\n"
    mesh = load(tmp_path, text, "m.obj")
    assert len(mesh.vertices) == 4
    np.testing.assert_allclose(mesh.corner_uv[0, 2], [0, 0.5])
    np.testing.assert_allclose(mesh.corner_uv[1, 0], [0.9, 0.9])


def test_file_normals_are_kept_and_turned_with_the_object(tmp_path):
    """Normals of a plane that say something else than its geometry, under a shear: by the inverse transpose."""
    n = np.array([0.3, -0.4, np.sqrt(0.75)])
    data = [[*p, *n] for p in [[0, 0, 0], [1, 0, 0], [0, 1, 0]]]
    m = np.eye(4)
    m[:3, :3] = [[2, 0.5, 0], [0, 1, 0.3], [0.1, 0, 0.5]]
    m[:3, 3] = [1, 2, 3]
    file = ply("ascii", data, [[0, 1, 2]], properties=("x", "y", "z", "nx", "ny", "nz"))
    mesh = load(tmp_path, file, to_world=m)
    expected = np.linalg.inv(m[:3, :3]).T @ n
    np.testing.assert_allclose(mesh.corner_normals[0, 1], expected / np.linalg.norm(expected), atol=1e-6)
    np.testing.assert_allclose(mesh.vertices[1], m[:3, :3] @ [1, 0, 0] + m[:3, 3])


def test_normals_that_are_zero_fall_back_to_the_geometry(tmp_path):
    data = [[*p, 0, 0, 0] for p in TETRA]
    mesh = load(tmp_path, ply("ascii", data, TETRA_FACES, properties=("x", "y", "z", "nx", "ny", "nz")))
    np.testing.assert_allclose(mesh.corner_normals, geometric_normals(mesh)[:, None].repeat(3, 1), atol=1e-6)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("length", ["1e-30", "1e30", "1e200"])
def test_normals_in_a_file_may_have_any_length(tmp_path, length):
    text = f"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn {length} 0 {length}\nf 1//1 2//1 3//1\n"
    mesh = load(tmp_path, text, "m.obj")
    np.testing.assert_allclose(mesh.corner_normals, np.tile(np.sqrt([0.5, 0, 0.5]), (1, 3, 1)), atol=1e-6)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("value", ["inf", "-inf", "nan"])
def test_normals_that_are_no_numbers_fall_back_to_the_geometry(tmp_path, value):
    mesh = load(tmp_path, f"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 {value}\nf 1//1 2//1 3//1\n", "m.obj")
    np.testing.assert_allclose(mesh.corner_normals, geometric_normals(mesh)[:, None].repeat(3, 1), atol=1e-6)


@pytest.mark.parametrize("with_normals", [False, True])
def test_a_mirroring_transform_keeps_the_outside_outside(tmp_path, with_normals):
    shape = trimesh.creation.icosphere(2)
    shape.export(tmp_path / "s.ply", vertex_normal=with_normals)
    m = np.diag([-1.0, 1, 1, 1])
    m[:3, :3] = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix() @ m[:3, :3]
    m[:3, 3] = [5, 0, 0]
    mesh, _ = load_mesh(tmp_path / "s.ply", to_world=m)
    outward = mesh.vertices[mesh.faces] - m[:3, 3]
    assert ((geometric_normals(mesh)[:, None] * outward).sum(-1) > 0.9).all()
    assert ((mesh.corner_normals * outward).sum(-1) > 0.9).all()


def test_smooth_under_30_degrees_flat_above(tmp_path):
    for sections, smooth in ((24, True), (9, False)):  # 15 and 40 degrees between the sides of a tube
        tube = trimesh.creation.cylinder(1.0, 2.0, sections=sections)
        tube.export(tmp_path / "t.ply", vertex_normal=False)
        mesh, _ = load_mesh(tmp_path / "t.ply")
        flat = geometric_normals(mesh)
        side = np.abs(flat[:, 2]) < 0.5
        radial = mesh.vertices[mesh.faces] * [1, 1, 0]
        radius = np.linalg.norm(radial, axis=-1, keepdims=True)
        radial = radial / np.where(radius > 0, radius, 1)
        if smooth:
            np.testing.assert_allclose(mesh.corner_normals[side], radial[side], atol=1e-5)
        else:
            np.testing.assert_allclose(mesh.corner_normals[side], flat[side][:, None].repeat(3, 1), atol=1e-6)
        np.testing.assert_allclose(mesh.corner_normals[~side], flat[~side][:, None].repeat(3, 1), atol=1e-6)


def test_smoothing_goes_across_vertices_at_one_place(tmp_path):
    """A sphere whose triangles share no vertices is as smooth as one whose triangles do."""
    shape = trimesh.creation.icosphere(3)
    soup = trimesh.Trimesh(
        shape.triangles.reshape(-1, 3), np.arange(3 * len(shape.faces)).reshape(-1, 3), process=False
    )
    soup.export(tmp_path / "soup.ply", vertex_normal=False, encoding="ascii")
    mesh, _ = load_mesh(tmp_path / "soup.ply")
    p = mesh.vertices[mesh.faces]
    assert ((mesh.corner_normals * p).sum(-1) > 0.9995).all()


def test_triangles_without_area_are_dropped_and_counted(tmp_path):
    path = tmp_path / "m.ply"
    path.write_bytes(ply("ascii", [*TETRA, [2, 0, 0]], [*TETRA_FACES, [0, 0, 1], [0, 1, 4], [1, 2, 2]]))
    mesh, dropped = load_mesh(path)
    assert (len(mesh.faces), dropped) == (4, 3)


TWO = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


@pytest.mark.parametrize(("data", "words"), [
    ("", "the file is empty"),
    ("hello world\n", "neither a PLY nor an OBJ"),
    (b"\0\1\2" * 50, "neither a PLY nor an OBJ"),
    (TWO, "no faces"),
    (TWO + "f 1 2\n", "no faces"),
    (TWO + "f 1 2 4\n", "face 0 names vertex 3, and there are 3"),
    (TWO + "f 1 2 3\nf 1 2 0\n", "face 1 names vertex -1"),
    (TWO + "f 1 2 -9\n", "face 0 names vertex"),
    (TWO + "f 1 2 99999999999999999999999\n", "face 0 names vertex"),
    (TWO + "f 1 2 x\n", "numbers|corner"),
    (TWO + "f 1/1/1/1 2/2/2/2 3/3/3/3\n", "corner"),
    ("v 0 0 zero\n" + TWO + "f 1 2 3\n", "numbers"),
    ("v 0 0 nan\n" + TWO + "f 2 3 4\n", "1 vertices are NaN or infinite, first number 0"),
    ("v 0 0 1e999\n" + TWO + "f 2 3 4\n", "1 vertices are NaN or infinite"),
    (TWO + "f 1 1 1\n", "has an area"),
    ("v 0 0 0\nv 1e300 0 0\nv 0 1 0\nf 1 2 3\n", "as far as"),
    (ply("ascii", TETRA, []), "no faces"),
    (ply("ascii", TETRA, [[0, 1, 7]]), "names vertex 7"),
    (ply("ascii", TETRA, [[0, 1, 2.5]]), "not whole"),
    (ply("binary_little_endian", TETRA, TETRA_FACES)[:-2], "truncated"),
    (ply("binary_little_endian", TETRA, [*TETRA_FACES, [0, 1, 2, 3]])[:-2], "truncated"),
    (ply("ascii", TETRA, TETRA_FACES)[:-7], "truncated"),
    (ply("ascii", TETRA, TETRA_FACES).replace(b"end_header", b"end"), "no end"),
    (ply("ascii", TETRA, TETRA_FACES).replace(b"ascii", b"morse"), "line 'format morse"),
    (ply("ascii", TETRA, TETRA_FACES).replace(b"format ascii 1.0\n", b""), "no format"),
    (ply("ascii", TETRA, TETRA_FACES).replace(b"float x", b"float a"), "no vertices"),
    (ply("ascii", TETRA, TETRA_FACES).replace(b"vertex 4", b"vertex 99999999999"), "it claims 99999999999"),
    (ply("ascii", TETRA, TETRA_FACES).replace(b"vertex 4", b"vertex -4"), "it claims -4"),
    (ply("binary_little_endian", TETRA, [], count="int").replace(b"face 0", b"face 9") + b"\xff\xff\xff\x7f", "absurd"),
])  # fmt: skip
def test_what_is_wrong_is_said(tmp_path, data, words):
    with pytest.raises(InputError, match=words) as caught:
        load(tmp_path, data, "m.dat")
    assert caught.value.what == "m.dat" and caught.value.do


def test_damage_is_an_error_or_a_mesh_never_another_exception(tmp_path, rng):
    files = [
        ply(f, TETRA, [*TETRA_FACES, [0, 1, 2, 3]]) for f in ("ascii", "binary_little_endian", "binary_big_endian")
    ]
    files.append((OBJ + "f 1/1/1 2/2/1 3/3/1 4/4/1\n").encode())
    for data in files:
        for _ in range(150):
            broken = bytearray(data)
            for at in rng.integers(0, len(data), rng.integers(1, 4)):
                broken[at] = rng.integers(0, 256)
            broken = broken[: rng.integers(1, len(broken) + 1)] if rng.random() < 0.3 else broken
            try:
                mesh = load(tmp_path, bytes(broken), "m.dat")
                assert np.isfinite(mesh.corner_normals).all() and mesh.faces.max() < len(mesh.vertices)
            except InputError as error:
                assert error.what == "m.dat"


@pytest.mark.parametrize("name", ["spot", "bob_tri", "mx_sphere", "mx_teapot", "hollowcube", "os_skull_low_resolution"])
def test_real_meshes_agree_with_trimesh(test_data, name):
    path = test_data / "meshes" / f"{name}.obj"
    if not path.is_file():
        pytest.skip(f"no {path.name}")
    mesh, dropped = load_mesh(path)
    theirs = trimesh.load(path, process=False, force="mesh", skip_materials=True)
    assert len(mesh.faces) + dropped == len(theirs.faces)
    assert area(mesh) == pytest.approx(theirs.area, rel=1e-9)
    np.testing.assert_allclose(mesh.vertices[mesh.faces].min((0, 1)), theirs.triangles.min((0, 1)))
    np.testing.assert_allclose(np.linalg.norm(mesh.corner_normals, axis=-1), 1, atol=1e-5)
    facing = (mesh.corner_normals * geometric_normals(mesh)[:, None]).sum(-1)
    assert np.mean(facing > 0.5) > 0.99


def partly_turned(share, seed=3):
    """A ball of which patches are turned over, with the smooth normals that its faces then have: obj lines, ball."""
    ball = trimesh.creation.icosphere(3)
    random, turned = np.random.default_rng(seed), np.zeros(len(ball.faces), bool)
    while turned.mean() < share:
        turned ^= ball.triangles_center @ ball.face_normals[random.integers(len(ball.faces))] > 0.93
    faces = np.where(turned[:, None], ball.faces[:, ::-1], ball.faces)
    normals = trimesh.Trimesh(ball.vertices, faces, process=False).vertex_normals
    lines = [*(f"v {x} {y} {z}" for x, y, z in ball.vertices), *(f"vn {x} {y} {z}" for x, y, z in normals)]
    return lines, faces, ball


@pytest.mark.parametrize("normals", [False, True])
def test_faces_turned_over_beside_their_neighbours(tmp_path, normals):
    """Smooth normals between faces that are turned opposite ways are no mean of theirs."""
    lines, faces, ball = partly_turned(0.3)
    corner = "{0}//{0}" if normals else "{0}"
    lines = [line for line in lines if normals or not line.startswith("vn")]
    lines += ["f " + " ".join(corner.format(i + 1) for i in face) for face in faces]
    mesh = load(tmp_path, "\n".join(lines), "ball.obj")
    own = geometric_normals(mesh)
    outwards = np.sign((own * mesh.vertices[mesh.faces].mean(1)).sum(1))
    assert abs(outwards.sum()) == len(faces)  # all one way
    true = mesh.vertices[mesh.faces]  # of the unit ball
    cosine = (mesh.corner_normals * true).sum(-1) * np.sign(outwards[0])
    assert cosine.min() > np.cos(np.radians(2))
    assert np.abs(mesh.vertices[mesh.faces] - ball.vertices[faces]).min() == 0


def test_a_surface_that_lies_twice_at_the_same_place_stays_as_it_is(tmp_path):
    """Along its outer edge the two run in the same direction, and yet neither is turned over beside the other."""
    n = 12
    x, y = np.meshgrid(np.arange(n) / n, np.arange(n) / n)
    points = np.stack([x, y, 0.3 * x * y], -1).reshape(-1, 3)
    first = np.arange(n * n).reshape(n, n)[:-1, :-1].ravel()
    quads = np.stack([first, first + 1, first + n + 1, first + n], -1)
    normals = np.stack([-0.3 * y, -0.3 * x, np.ones_like(x)], -1).reshape(-1, 3)
    normals[first[0]] *= -1  # what makes anybody look
    vertices = np.tile(np.concatenate([points, normals], 1), (2, 1))
    both = np.concatenate([quads, quads + n * n])
    mesh = load(tmp_path, ply("ascii", vertices, both, properties=("x", "y", "z", "nx", "ny", "nz"), kind="double"))
    assert (geometric_normals(mesh)[:, 2] > 0).all()
    assert np.mean(mesh.corner_normals[..., 2] > 0.9) > 0.98


def test_a_band_with_one_side_stays_as_it_is(tmp_path):
    n = 40
    t = np.linspace(0, 2 * np.pi, n, endpoint=False)
    way = np.stack([np.cos(t), np.sin(t), 0 * t], -1)
    across = np.cos(t / 2)[:, None] * way + np.sin(t / 2)[:, None] * np.array([0, 0, 1.0])
    points = np.stack([way - 0.2 * across, way + 0.2 * across], 1).reshape(-1, 3)
    quads = [[2 * i, 2 * i + 1, 2 * i + 3, 2 * i + 2] for i in range(n - 1)] + [[2 * n - 2, 2 * n - 1, 0, 1]]
    mesh = load(tmp_path, ply("ascii", points, quads, kind="double"))
    np.testing.assert_array_equal(np.sort(mesh.faces, 1)[0], [0, 1, 3])
    assert np.isfinite(mesh.corner_normals).all() and len(mesh.faces) == 2 * n
