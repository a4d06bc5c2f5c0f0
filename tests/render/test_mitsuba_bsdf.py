# SPDX-License-Identifier: GPL-3.0-or-later
"""The plugin ``btf``: its look-up against NumPy's, its sampling by chi-square, energy, reciprocity, in scenes."""

import subprocess
import sys

import numpy as np
import pytest

from btfsep_engine.btf.directions import hemisphere_quadrature, interpolator
from btfsep_engine.btf.formats import writing
from btfsep_engine.render.backend import import_mitsuba
from btfsep_engine.render.mitsuba_bsdf import material_key, register
from tests.render.btf_materials import diffuse, glossy, matte, textured

SIGNIFICANCE = 0.01


@pytest.fixture
def mi():
    mi = import_mitsuba()
    register(mi)
    return mi


@pytest.fixture
def rng():
    return np.random.default_rng(20260101)


def hemisphere(rng, n):
    """n directions all over the upper hemisphere, down to the horizon: (n, 3)."""
    z = rng.uniform(0.002, 1, n)
    phi = rng.uniform(-np.pi, np.pi, n)
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], -1)


def vectors(mi, a):
    return mi.Vector3f(np.ascontiguousarray(np.asarray(a, np.float32).T))


def interaction(mi, wi, uv=None):
    """Surface points in their own frame: eye directions (n, 3), texture coordinates (n, 2)."""
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.wi = vectors(mi, wi)
    si.n, si.sh_frame = mi.Normal3f(0, 0, 1), mi.Frame3f(mi.Vector3f(0, 0, 1))
    si.sh_frame.s, si.sh_frame.t = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    if uv is not None:
        si.uv = mi.Point2f(np.ascontiguousarray(np.asarray(uv, np.float32).T))
    return si


def plugin(mi, material, **options):
    return mi.load_dict({"type": "btf", "material": material_key(material), **options})


@pytest.mark.parametrize("make", [matte, glossy, textured])
def test_the_look_up_is_numpys(mi, make, rng):
    """Directions to the horizon, texture coordinates over several periods and below 0."""
    material = make()
    wi, wo, uv = hemisphere(rng, 4000), hemisphere(rng, 4000), rng.uniform(-500, 500, (4000, 2))
    got = np.array(plugin(mi, material).eval(mi.BSDFContext(), interaction(mi, wi, uv), vectors(mi, wo))).T
    expected = material.abrdf(uv, wo, wi) * wo[:, 2:]
    assert np.abs(got - expected).max() < 1e-4 * np.abs(expected).max()
    if make is textured:
        assert np.abs(expected - material.mean_material().abrdf(uv, wo, wi) * wo[:, 2:]).max() > 0.05  # texels matter
        assert (expected < -0.01).any()  # negative values are kept, as in the kernel


def test_options_scale_the_texture_and_choose_the_mean(mi, rng):
    material = textured()
    wi, wo, uv = hemisphere(rng, 500), hemisphere(rng, 500), rng.uniform(-1, 1, (500, 2))
    si, to = interaction(mi, wi, uv), vectors(mi, wo)
    scaled = np.array(plugin(mi, material, millimetres_per_uv=80.0).eval(mi.BSDFContext(), si, to)).T
    assert scaled == pytest.approx(material.abrdf(uv * 80, wo, wi) * wo[:, 2:], abs=1e-4)
    finer = np.array(plugin(mi, material, millimetres_per_uv=80.0, texel_mm=2.5).eval(mi.BSDFContext(), si, to)).T
    assert finer == pytest.approx(material.abrdf(uv * 160, wo, wi) * wo[:, 2:], abs=1e-4)
    mean = np.array(plugin(mi, material, mean=True).eval(mi.BSDFContext(), si, to)).T
    assert mean == pytest.approx(material.mean_material().abrdf(uv, wo, wi) * wo[:, 2:], abs=1e-4)


def test_both_sides_look_alike_and_nothing_passes_through(mi, rng):
    """The back is the front turned about the tangent: (x, -y, -z)."""
    material, turn = textured(), np.array([1, -1, -1])
    wi, wo, uv = hemisphere(rng, 500), hemisphere(rng, 500), rng.uniform(-50, 50, (500, 2))
    bsdf, context = plugin(mi, material), mi.BSDFContext()
    front = np.array(bsdf.eval(context, interaction(mi, wi, uv), vectors(mi, wo)))
    back = np.array(bsdf.eval(context, interaction(mi, wi * turn, uv), vectors(mi, wo * turn)))
    assert back == pytest.approx(front, abs=1e-5)
    through = bsdf.eval_pdf(context, interaction(mi, wi, uv), vectors(mi, wo * turn))
    assert not np.array(through[0]).any() and not np.array(through[1]).any()


@pytest.mark.parametrize("make", [matte, glossy])
@pytest.mark.parametrize("degrees", [0, 40, 84])
def test_samples_follow_their_density(mi, make, degrees):
    """Pearson's chi-square over 16,000 cells of the sphere, by Mitsuba's own test."""
    from mitsuba.chi2 import BSDFAdapter, ChiSquareTest, SphericalDomain

    t = np.radians(degrees)
    wi = mi.Vector3f(*(float(x) for x in (0.8 * np.sin(t), 0.6 * np.sin(t), np.cos(t))))
    material = make()  # it has to live as long as the adapter makes plugins of it
    sample, pdf = BSDFAdapter("btf", {"type": "btf", "material": material_key(material)}, wi=wi)
    # the density has steps: many nodes a cell
    found = ChiSquareTest(
        SphericalDomain(), sample, pdf, sample_dim=3, sample_count=400_000, res=41, ires=24, seed=degrees
    )
    assert found.run(SIGNIFICANCE, test_count=6, quiet=True), found.messages


@pytest.mark.parametrize("make", [matte, glossy, textured])
def test_weights_are_value_by_density_and_pay_off(mi, make, rng):
    material = make()
    wi, uv = hemisphere(rng, 20_000), rng.uniform(0, 100, (20_000, 2))
    bsdf, context, si = plugin(mi, material), mi.BSDFContext(), interaction(mi, wi, uv)
    one, two = mi.Float(rng.random(20_000)), mi.Point2f(rng.random((2, 20_000)))
    drawn, weight = bsdf.sample(context, si, one, two)
    value, density = bsdf.eval_pdf(context, si, drawn.wo)
    wo, weight, density = np.array(drawn.wo).T, np.array(weight), np.array(density)
    assert np.array(drawn.pdf) == pytest.approx(density, rel=1e-5)
    assert np.array(bsdf.eval(context, si, drawn.wo)) == pytest.approx(np.array(value), abs=1e-6)
    assert np.array(bsdf.pdf(context, si, drawn.wo)) == pytest.approx(density, rel=1e-5)
    inside = (density > 0) & (wo[:, 2] > 0)
    assert inside.mean() > 0.999
    expected = (material.abrdf(uv, wo, wi) * wo[:, 2:])[inside] / density[inside, None]
    assert weight.T[inside] == pytest.approx(expected, rel=1e-3, abs=1e-3)
    if make is glossy:  # against cosine-weighted directions, whose weight is pi times the value
        cosine = np.sqrt(1 - rng.random(20_000))
        phi = rng.uniform(-np.pi, np.pi, 20_000)
        r = np.sqrt(1 - cosine**2)
        even = np.pi * material.abrdf(uv, np.stack([r * np.cos(phi), r * np.sin(phi), cosine], -1), wi)
        assert weight.var() < 0.5 * even.var()


@pytest.mark.parametrize("make", [matte, glossy, textured])
def test_the_albedo_is_the_tables(mi, make, rng):
    """Directional albedo by the plugin's samples against a quadrature of the table in NumPy."""
    material = make()
    nodes, weights = hemisphere_quadrature(48)
    for degrees in (10, 60, 88):
        t = np.radians(degrees)
        wi = np.array([np.sin(t), 0, np.cos(t)])
        uv = np.array([13.0, 47.0])
        eye, at = np.broadcast_to(wi, nodes.shape), np.broadcast_to(uv, (len(nodes), 2))
        expected = (material.abrdf(at, nodes, eye) * (weights * nodes[:, 2])[:, None]).sum(0)
        n = 100_000
        si = interaction(mi, np.broadcast_to(wi, (n, 3)), np.broadcast_to(uv, (n, 2)))
        _, weight = plugin(mi, material).sample(
            mi.BSDFContext(), si, mi.Float(rng.random(n)), mi.Point2f(rng.random((2, n)))
        )
        weight = np.array(weight)
        error = weight.std(1) / np.sqrt(n)
        assert (np.abs(weight.mean(1) - expected) < 4.5 * error + 1e-3 * np.abs(expected)).all()


def test_reciprocity_and_the_adjoint(mi, rng):
    """A symmetric table gives a reciprocal BSDF; of any table, importance is radiance with the directions exchanged."""
    a, b = hemisphere(rng, 2000), hemisphere(rng, 2000)
    there, back = (
        np.array(plugin(mi, glossy()).eval(mi.BSDFContext(), interaction(mi, x), vectors(mi, y))).T / y[:, 2:]
        for x, y in ((a, b), (b, a))
    )
    assert there == pytest.approx(back, rel=1e-3, abs=1e-5)
    uv = rng.uniform(0, 100, (2000, 2))
    bsdf = plugin(mi, textured())
    radiance = np.array(bsdf.eval(mi.BSDFContext(), interaction(mi, a, uv), vectors(mi, b))).T / b[:, 2:]
    context = mi.BSDFContext(mi.TransportMode.Importance)
    importance = np.array(bsdf.eval(context, interaction(mi, b, uv), vectors(mi, a))).T / a[:, 2:]
    exchanged = np.array(bsdf.eval(mi.BSDFContext(), interaction(mi, b, uv), vectors(mi, a))).T / a[:, 2:]
    assert importance == pytest.approx(radiance, rel=1e-3, abs=1e-4)
    assert np.abs(importance - exchanged).max() > 0.05  # this table is not reciprocal: the test can fail


def sphere_scene(mi, bsdf, integrator, *, fov, **depth):
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": integrator, **depth},
            "light": {"type": "constant"},
            "ball": {"type": "sphere", "bsdf": bsdf},
            "sensor": {
                "type": "perspective",
                "fov": fov,
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
            },
        }
    )


def test_a_white_furnace_stays_white(mi):
    """Albedo 1 in even light: the ball cannot be seen."""
    scene = sphere_scene(
        mi, {"type": "btf", "material": material_key(white := diffuse(1.0))}, "path", fov=24.0, max_depth=2
    )
    image = np.array(mi.render(scene, spp=1024))
    assert white is not None and image == pytest.approx(np.ones_like(image), abs=0.03)
    assert image.mean() == pytest.approx(1, abs=0.003)


@pytest.mark.parametrize("integrator", ["path", "direct", "prb"])
def test_a_ball_in_even_light_shows_the_albedo(mi, integrator):
    """The centre of a glossy ball sends the albedo towards the normal, with any integrator."""
    material = glossy()
    depth = {} if integrator == "direct" else {"max_depth": 2, "rr_depth": 10}
    scene = sphere_scene(mi, {"type": "btf", "material": material_key(material)}, integrator, fov=1.0, **depth)
    image = np.array(mi.render(scene, spp=256, seed=3)).reshape(-1, 3)
    taps, weights = interpolator(material.views).weights(np.array([[0.0, 0.0, 1.0]]))
    expected = (material.directional_albedo()[taps[0]] * weights[0][:, None]).sum(0)
    assert image.mean(0) == pytest.approx(expected, rel=0.02)


def test_a_file_and_a_held_material_are_the_same(mi, rng, tmp_path):
    material = textured()
    writing.write(tmp_path / "test.btf", material)
    wi, wo, uv = hemisphere(rng, 300), hemisphere(rng, 300), rng.uniform(-50, 50, (300, 2))
    si = interaction(mi, wi, uv)
    filed = mi.load_dict({"type": "btf", "filename": str(tmp_path / "test.btf")})
    a, b = (np.array(x.eval(mi.BSDFContext(), si, vectors(mi, wo))) for x in (filed, plugin(mi, material)))
    assert a == pytest.approx(b, abs=2e-3)  # files hold half-precision numbers


@pytest.mark.parametrize(
    "properties",
    [
        {},
        {"material": "nobody"},
        {"material": "held", "filename": "a.btf"},
        {"filename": "/nowhere/a.btf"},
        {"material": "held", "tangents": "sideways"},
        {"material": "held", "texel_mm": -1.0},
    ],
)
def test_wrong_parameters_are_refused(mi, properties):
    material = matte()
    if properties.get("material") == "held":
        properties = {**properties, "material": material_key(material)}
    with pytest.raises(Exception, match=r"btf|a\.btf"):
        mi.load_dict({"type": "btf", **properties})


def test_a_scalar_variant_says_what_to_use():
    code = (
        "import mitsuba as mi; mi.set_variant('scalar_rgb')\n"
        "from btfsep_engine.render.mitsuba_bsdf import register\n"
        "register(mi); mi.load_dict({'type': 'btf', 'filename': 'x.btf'})\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert run.returncode == 1 and "use llvm_ad_rgb or cuda_ad_rgb" in run.stderr
