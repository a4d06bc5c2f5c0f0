# SPDX-License-Identifier: GPL-3.0-or-later
"""Plates of scans: the texture of the job has the light in it that is said, and the photo shows the one without."""

import numpy as np
import pytest

from btfsep_engine.conventions import luminance
from btfsep_engine.job.load import load_job
from btfsep_engine.render.texels import texels_on
from scripts.cycles import materials, objects, scans, studio
from scripts.cycles import plates as studio_plates
from scripts.studies import plate_sets, plates

BELOW, HORIZON = 0.2, 0.6


@pytest.fixture(scope="module")
def a_scan(tmp_path_factory, small_light):
    """A plate of a painted ball that was scanned under an overcast sky, and its folder."""
    (plate, *_) = [p for p in plate_sets.of_set("scanned") if p["scan"]["sky"] and p["thing"] == "painted"]
    plate |= {"object": "sphere", "table": None, "curve": "floats", "off": [0, 0], "scan": {"sky": [BELOW, HORIZON]}}
    plate["light"], folder = small_light("sunset"), tmp_path_factory.mktemp("scans")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(studio_plates, "RESOLUTION", 64)
        patch.setattr(studio_plates, "SAMPLES", 4)
        patch.setattr(scans, "SIDE", 128)
        patch.setattr(scans, "SAMPLES", 64)
        studio_plates.take(plate, folder / plate["name"])
    return plate, folder


def test_they_are_drawn_alike_and_of_both_lights():
    drawn = plate_sets.of_set("scanned")
    assert drawn == plate_sets.of_set("scanned") != plate_sets.of_set("scanned again")
    assert {plate["thing"] for plate in drawn} == {"painted", "mottled"}
    own = [plate["scan"]["sky"] is None for plate in drawn]
    assert 0.1 < np.mean(own) < 0.7
    for plate, in_own_light in zip(drawn, own, strict=True):
        said = "scanned in the photo's light" if in_own_light else "under an overcast sky"
        assert plate["kinds"][-1] == said and not plate["surface"]["metallic"] and plate["surface"]["roughness"] >= 0.5


def test_the_light_in_a_texture_is_that_of_the_sky(a_scan):
    """On a ball, which sees all of the sky above its horizon: the irradiance of the sky's own ramp."""
    plate, folder = a_scan
    mesh, clean, lit = told(folder / plate["name"])
    texels = texels_on(mesh, len(clean))
    seen = [luminance(image.reshape(-1, 3)[texels.number].astype(float)) for image in (clean, lit)]
    up = texels.normal[:, 2]
    bins = np.digitize(up, np.linspace(-0.95, 0.95, 11))
    found = np.array([np.median((seen[1] / seen[0])[bins == k]) for k in range(12)])
    expected = irradiance(np.array([up[bins == k].mean() for k in range(12)]))
    np.testing.assert_allclose(found / found.mean(), expected / expected.mean(), rtol=0.05)
    assert seen[1].mean() == pytest.approx(seen[0].mean(), rel=0.05)  # as bright in the mean
    assert len(np.unique(clean.reshape(-1, 3)[texels.number].round(2), axis=0)) >= 2  # painted


def told(folder):
    """The mesh of a plate, and the textures that its jobs "clean" and "job" have."""
    first, second = (load_job(folder / name).objects[0] for name in ("clean", "job"))
    np.testing.assert_array_equal(first.mesh.vertices, second.mesh.vertices)
    return second.mesh, first.surface.image, second.surface.image


def irradiance(up) -> np.ndarray:
    """Of the ramp of `scans.sky` on a level that looks up by this cosine, by brute force."""
    random = np.random.default_rng(0)
    omega = random.standard_normal((40_000, 3))
    omega /= np.linalg.norm(omega, axis=1, keepdims=True)
    sky = np.interp((omega[:, 2] + 1) / 2, [0.48, 0.52, 1.0], [BELOW, HORIZON, 1.0])
    normal = np.stack([np.sqrt(1 - up**2), np.zeros_like(up), up], 1)
    return (np.maximum(normal @ omega.T, 0) * sky).mean(1)


def test_jobs_tell_it_with_light_without_or_in_the_mean(a_scan):
    plate, folder = a_scan
    clean, settings = plates.told(plate, folder, plates.CLEAN)
    assert not settings
    lit, settings = plates.told(plate, folder, plates.NOT_DE_LIT)
    assert settings == {"delight": "never"}
    as_it_is, settings = plates.told(plate, folder, plates.AS_IS)
    assert not settings
    images = [job.objects[0].surface.image for job in (clean, lit, as_it_is)]
    np.testing.assert_array_equal(images[1], images[2])
    assert not np.allclose(images[0], images[1], atol=0.05)
    mean, _ = plates.told(plate, folder, plates.AS_MEAN)
    colour = mean.objects[0].surface
    assert colour.image is None and colour.roughness == pytest.approx(plate["surface"]["roughness"])
    texels = texels_on(lit.objects[0].mesh, len(images[1]))
    laid = images[1].reshape(-1, 3)[texels.number].mean(0)
    np.testing.assert_allclose(colour.base_color, laid, rtol=0.1)


def test_a_remeshed_thing_is_as_far_off_as_is_said():
    """A ball of radius 75 mm: its vertices lie so far from it, on both sides, and no farther than all together."""
    drawn = plate_sets.of_set("remeshed")
    assert drawn == plate_sets.of_set("remeshed") != plate_sets.of_set("remeshed again")
    off = {}
    for waves, noise in ((0.0, 0.0), (0.006, 0.0), (0.0, 0.001)):
        studio.clear()
        ball = objects.build("sphere", seed=1, view=studio.VIEW_FROM)
        ball.data.materials.append(materials.white())
        mesh = drawn[0]["mesh"] | {"face": 0.015, "waves": waves, "noise": noise, "smoothed": 0, "triangles": 0}
        scans.remeshed(ball, **mesh)
        off[waves, noise] = np.linalg.norm(objects.vertex_positions(ball.data), axis=1) - 0.075
        assert len(ball.data.materials) == 1 and all(face.use_smooth for face in ball.data.polygons)
    assert np.abs(off[0.0, 0.0]).max() < 0.0005
    assert np.sqrt(np.square(off[0.006, 0.0]).mean()) == pytest.approx(0.15 * 0.006 * np.sqrt(1.25 / 2), rel=0.3)
    assert off[0.0, 0.001].std() == pytest.approx(0.15 * 0.001, rel=0.2)
    ball = objects.build("sphere", seed=1, view=studio.VIEW_FROM)
    scans.remeshed(ball, **drawn[0]["mesh"] | {"triangles": 3000})
    assert len(ball.data.polygons) == pytest.approx(3000, rel=0.05)
