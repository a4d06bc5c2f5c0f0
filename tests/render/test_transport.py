# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel against closed forms, against a direct quadrature and against Mitsuba's own path tracer."""

import numpy as np
import pytest
import trimesh

from btfsep_engine import sh
from btfsep_engine.btf.directions import ubo2014_directions
from btfsep_engine.btf.model import Lambertian, Mirror, Tabulated
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.light.lightings import EnvironmentMaps, SHBasis, SHLighting
from btfsep_engine.render.backend import import_mitsuba
from btfsep_engine.render.radiosity import Indirect, diffuse_albedo
from btfsep_engine.render.sampling import spread
from btfsep_engine.render.surface import camera_view, surface_points, with_any_tangent, with_texture
from btfsep_engine.render.tracer import Tracer
from btfsep_engine.render.transport import Transport
from tests.render.scenes import as_mesh, job_of, looking_down, positive_light

WHITE = Lambertian("white", np.full(3, 0.8))


def prepared(meshes, camera, *, count=600, directions=1024, textured=False, occluders=()):
    """Tracer, points and kernel of the first object."""
    job = job_of(meshes, camera, occluders=occluders)
    tracer = Tracer([*meshes, *(o.mesh for o in job.occluders)])
    points = surface_points(camera_view(tracer, job), job, 0)
    points = points.take(spread(points, count))
    points = with_texture(points, job, 0) if textured else with_any_tangent(points)
    return tracer, points, Transport(tracer, points, directions=directions, millimetres_per_unit=50.0)


def lobe(omega_i, omega_o):
    """A smooth, anisotropic, coloured BRDF: (…, 3) from local directions (…, 3)."""
    omega_i, omega_o = np.broadcast_arrays(omega_i, omega_o)
    half = omega_i + omega_o
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    gloss = np.exp(-3 * half[..., 0] ** 2 - half[..., 1] ** 2)
    return np.stack([0.1 + gloss, 0.2 + 0.3 * gloss, 0.3 + 0.2 * omega_i[..., 2]], -1)


def tabulated(function) -> Tabulated:
    """``function`` sampled at the directions of UBO2014, one texel."""
    d = ubo2014_directions()
    table = function(d[None, :, :], d[:, None, :]).astype(np.float32)
    return Tabulated("t", "test", np.ones((1, 1, 1), np.float32), table[..., None], d, d, 1.0)


def test_a_white_sphere_has_the_analytic_shading(sphere):
    _, points, transport = prepared([sphere], looking_down())
    x = positive_light(4)
    radiance = np.einsum("pmc,mc->pc", transport.radiance(WHITE, SHBasis(4)), x)
    truth = 0.8 / np.pi * sh.irradiance(x, points.normal)
    assert np.abs(radiance / truth - 1).max() < 0.01


def test_a_constant_table_is_the_diffuse_material(sphere):
    _, _, transport = prepared([sphere], looking_down())
    table = tabulated(lambda i, o: np.full((*np.broadcast_shapes(i.shape, o.shape)[:-1], 3), 0.8 / np.pi))
    expected = transport.radiance(WHITE, SHBasis(3))
    assert np.abs(transport.radiance(table, SHBasis(3)) - expected).max() < 1e-5 * np.abs(expected).max()


def test_a_table_is_interpolated_like_the_function_it_samples(sphere):
    """Against a quadrature of the function itself, with this test's own rotation into the local frame."""
    _, points, transport = prepared([sphere], looking_down(), count=80, directions=4096, textured=True)
    x = positive_light(4)
    got = np.einsum("pmc,mc->pc", transport.radiance(tabulated(lobe), SHBasis(4)), x)
    directions = fibonacci_sphere(4096)
    light = sh.evaluate(4, directions) @ x
    for i in range(len(points)):
        frame = np.stack([points.tangent[i], points.bitangent[i], points.normal[i]])
        omega_i, omega_o = directions @ frame.T, frame @ points.to_eye[i]
        above = omega_i[:, 2] > 0
        weights = lobe(omega_i[above], omega_o) * omega_i[above, 2:] * 4 * np.pi / len(directions)
        assert got[i] == pytest.approx((weights * light[above]).sum(0), rel=0.03, abs=0.03)


def test_texels_are_found_at_their_millimetres(sphere):
    """A texture that varies along u only, read back at the points' own uv."""
    _, points, transport = prepared([sphere], looking_down(), textured=True)
    n, texel = 64, 4.0
    wave = 1 + 0.5 * np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)
    d = ubo2014_directions()
    texels = np.broadcast_to(wave[None, :, None], (n, n, 1)).astype(np.float32)
    table = Tabulated("t", "test", texels, np.full((151, 151, 3, 1), 0.25, np.float32), d, d, texel)
    flat = Tabulated("t", "test", texels[:1, :1] * 0 + 1, table.angular, d, d, texel)
    ratio = transport.radiance(table, SHBasis(0))[:, 0, 0] / transport.radiance(flat, SHBasis(0))[:, 0, 0]
    assert ratio == pytest.approx(1 + 0.5 * np.cos(2 * np.pi * points.uv[:, 0] / (n * texel)), abs=0.01)


def test_weights_are_the_values_of_the_material(sphere):
    """Texels, views and lights of a factorised material, against its own look-up in NumPy."""
    _, points, transport = prepared([sphere], looking_down(), textured=True)
    random, d = np.random.default_rng(4), ubo2014_directions()
    angular = random.random((151, 151, 3, 5), np.float32)
    table = Tabulated("t", "test", random.random((6, 7, 5), np.float32), angular, d, d, 40.0)
    point, direction = random.integers(0, len(points), 3000), random.integers(0, 1024, 3000)
    frame = np.stack([points.tangent, points.bitangent, points.normal], 1)[point]
    to_light = (frame @ transport.directions[direction][..., None])[..., 0]
    to_eye = (frame @ points.to_eye[point][..., None])[..., 0]
    above = to_light[:, 2] > 1e-3
    expected = table.abrdf(points.uv[point], to_light, to_eye) * to_light[:, 2:] * (4 * np.pi / 1024)
    got = np.stack(transport.weights(table).of_pairs(points, point, direction), -1)
    assert above.sum() > 1000 and (got[to_light[:, 2] <= 0] == 0).all()
    assert np.abs(got - expected)[above].max() < 1e-3 * expected.max()


def test_a_mirror_shows_the_light_from_where_it_reflects(sphere):
    _, points, transport = prepared([sphere], looking_down())
    got = transport.radiance(Mirror("m", np.array([1.0, 0.5, 0.25])), SHBasis(6))
    incident = -points.to_eye
    reflected = incident - 2 * (incident * points.normal).sum(1, keepdims=True) * points.normal
    expected = sh.evaluate(6, reflected)[..., None] * [1.0, 0.5, 0.25]
    assert np.abs(got - expected).max() < 1e-5


def test_transport_is_linear_in_the_light(sphere):
    _, _, transport = prepared([sphere], looking_down(), count=50)
    x = positive_light(5)
    whole = transport.radiance(tabulated(lobe), SHLighting(x))[:, 0]
    parts = np.einsum("pmc,mc->pc", transport.radiance(tabulated(lobe), SHBasis(5)), x)
    assert np.abs(whole - parts).max() < 1e-4 * whole.max()


def test_turning_everything_changes_nothing():
    """Object, camera and light turned together about a slanted axis give the same radiance."""
    shape = trimesh.creation.torus(1.0, 0.45, major_sections=48, minor_sections=24)
    turn = trimesh.transformations.rotation_matrix(1.1, [1, 2, 0.5])
    camera = looking_down()
    turned_camera = type(camera)(**{**vars(camera), "to_world": turn @ camera.to_world})
    table, results = tabulated(lambda i, o: lobe(i, o)[..., [2, 2, 2]]), []
    for transform, view in ((np.eye(4), camera), (turn, turned_camera)):
        mesh = as_mesh(shape.copy().apply_transform(transform))
        _, points, transport = prepared([mesh], view, count=10**6)
        x = sh.rotation_matrix(3, transform[:3, :3]) @ positive_light(3)
        results.append((points.pixels, np.einsum("pmc,mc->pc", transport.radiance(table, SHBasis(3)), x)))
    (pixels, first), (turned_pixels, second) = results
    same = {tuple(p): r for p, r in zip(pixels, first, strict=True)}
    pairs = [(same[tuple(p)], r) for p, r in zip(turned_pixels, second, strict=True) if tuple(p) in same]
    a, b = np.array(pairs).transpose(1, 0, 2)
    assert len(pairs) > 300
    assert np.abs(a - b).max() < 0.03 * a.max() and np.abs(a - b).mean() < 0.006 * a.mean()


def mitsuba_photo(meshes, albedo, sky, camera, *, depth, spp):
    """The same scene by Mitsuba's path tracer: (h, w, 3)."""
    mi = import_mitsuba()
    scene = {"type": "scene", "integrator": {"type": "path", "max_depth": depth, "rr_depth": 100}}
    # Mitsuba's maps have +Y up and u = atan2(x, -z) / 2 pi: its (x, y, z) is our (y, z, x)
    bitmap = mi.Bitmap(np.ascontiguousarray(sky, np.float32))
    to_world = mi.ScalarTransform4f(np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]]))
    scene["sky"] = {"type": "envmap", "bitmap": bitmap, "to_world": to_world}
    for i, mesh in enumerate(meshes):
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(
            {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}}}
        )
        shape = mi.Mesh(f"m{i}", len(mesh.vertices), len(mesh.faces), properties, has_vertex_normals=True)
        params = mi.traverse(shape)
        normals = np.zeros((len(mesh.vertices), 3), np.float32)
        normals[mesh.faces.ravel()] = mesh.corner_normals.reshape(-1, 3)
        params["vertex_positions"] = mi.Float(mesh.vertices.astype(np.float32).ravel())
        params["vertex_normals"] = mi.Float(normals.ravel())
        params["faces"] = mi.UInt32(mesh.faces.astype(np.uint32).ravel())
        params.update()
        scene[f"m{i}"] = shape
    fov = np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))
    eye = camera.to_world[:3, 3]
    scene["sensor"] = {
        "type": "perspective",
        "fov": float(fov),
        "to_world": mi.ScalarTransform4f().look_at(eye.tolist(), [0, 0, 0], [0, 1, 0]),
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
        },
    }
    return np.array(mi.render(mi.load_dict(scene), spp=spp))


@pytest.mark.parametrize(("bounces", "depth"), [(1, 2), (20, -1)])
def test_a_concave_scene_equals_mitsubas_path_tracer(bounces, depth):
    """A bowl with a ball in it, white, under a sky with a lamp: shadows (and reflections) as a path tracer has them."""
    bowl = trimesh.creation.icosphere(5)
    bowl.update_faces(bowl.triangles_center[:, 2] < 0.1)
    ball = trimesh.creation.icosphere(4, 0.4).apply_translation([0.2, 0.1, -0.5])
    meshes = [as_mesh(ball), as_mesh(bowl, flat=True)]
    camera = looking_down()
    sky = np.full((32, 64, 3), 0.3)
    sky[4:10, 8:20] = [6.0, 4.0, 3.0]  # high up, on one side: its shadow is seen
    tracer, points, transport = prepared(meshes, camera, count=400, directions=4096)
    lights = EnvironmentMaps(sky[None], ("sky",))
    got = transport.radiance(WHITE, lights)[:, 0]
    if bounces > 1:
        indirect = Indirect(tracer, [np.full(3, 0.8)] * 2, lights, bounces=bounces)
        got = got + indirect.reflected(transport, WHITE)[:, 0]
    photo = mitsuba_photo(meshes, [0.8] * 3, sky, camera, depth=depth, spp=512)
    truth = photo[points.pixels[:, 0], points.pixels[:, 1]]
    assert got.mean(0) == pytest.approx(truth.mean(0), rel=0.02)
    # pixel by pixel: the path tracer's noise, and pixels that a shadow's edge divides
    assert np.sqrt(((got - truth) ** 2).mean()) < 0.06 * truth.mean()


def test_a_white_bowl_under_a_white_sky_has_the_known_brightness():
    """Half a sphere sees half of itself from everywhere: E = pi L / 2 / (1 - albedo / 2)."""
    bowl = trimesh.creation.icosphere(5)
    bowl.update_faces(bowl.triangles_center[:, 2] < 0)
    tracer, _, transport = prepared([as_mesh(bowl)], looking_down(), count=300, directions=512)
    lights = SHBasis(0)
    indirect = Indirect(tracer, [np.full(3, 0.8)], lights, bounces=40)
    both = transport.radiance(WHITE, lights) + indirect.reflected(transport, WHITE)
    assert both[:, 0] * np.sqrt(4 * np.pi) == pytest.approx(0.5 * 0.8 / (1 - 0.4), rel=0.03)


def test_the_albedo_of_a_table_is_that_of_the_function():
    assert diffuse_albedo(tabulated(lambda i, o: np.full((151, 151, 3), 0.25))) == pytest.approx(
        0.25 * np.pi, rel=0.005
    )
    # f = cos_i cos_o / 4: (1 / 4 pi) (2 pi / 3)^2
    table = tabulated(lambda i, o: np.repeat(i[..., 2:] * o[..., 2:] / 4, 3, -1) * np.ones((151, 151, 1)))
    assert diffuse_albedo(table) == pytest.approx(np.pi / 9, rel=0.02)


def test_other_materials_sizes_and_lights_compile_nothing():
    """Values and sizes are data of the kernels: only a new kind of question may cost a compilation."""
    import_mitsuba()
    import drjit as dr

    def run(shape, table, *, count, directions, order, textured):
        tracer, _, transport = prepared(
            [as_mesh(shape)], looking_down(), count=count, directions=directions, textured=textured
        )
        transport.radiance(table, SHBasis(order))
        indirect = Indirect(tracer, [np.full(3, 0.5)], SHBasis(order), bounces=3)
        assert indirect.reflected(transport, table).any()

    random, d = np.random.default_rng(0), ubo2014_directions()[:127]
    other = Tabulated(
        "o", "test", random.random((8, 9, 5), np.float32), random.random((127, 127, 3, 5), np.float32), d, d, 1.0
    )
    torus = trimesh.creation.torus
    run(torus(1.0, 0.4), tabulated(lobe), count=300, directions=256, order=2, textured=False)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        run(torus(0.8, 0.3), other, count=517, directions=333, order=3, textured=True)
        run(torus(1.2, 0.4), tabulated(lobe), count=401, directions=1024, order=4, textured=True)
        kernels = [k for k in dr.kernel_history() if k["type"] is dr.KernelType.JIT]
    assert len(kernels) > 4
    assert all(k["cache_hit"] for k in kernels)
