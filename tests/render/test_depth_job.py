# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs with a depth: what the surface receives is what the whole body's visible side receives."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.model import Lambertian
from btfsep_engine.fit.misalignment import silhouette_shift
from btfsep_engine.imaging import images
from btfsep_engine.job.depth import closing_mesh, mesh_from_depth
from btfsep_engine.job.model import JobObject, Occluder
from btfsep_engine.light.files import read_lighting
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.pipeline.basis import basis_images
from btfsep_engine.pipeline.doubts import alignment_doubt
from btfsep_engine.pipeline.settings import TransportSettings
from scripts.studies.depth import z_depth
from tests.render.scenes import answer, as_mesh, edited, job_of, looking_down, off_as_seen, scene_of

WHITE = Lambertian("white", np.full(3, 0.8))


def cup(degrees):
    """A cylinder with a floor and no lid, tilted towards the camera; most of its inside and outside is hidden."""
    wall = trimesh.creation.annulus(0.75, 0.85, 1.6, sections=96)
    floor = trimesh.creation.cylinder(0.8, 0.1, sections=96).apply_translation([0, 0, -0.75])
    shape = trimesh.util.concatenate([wall, floor])
    return as_mesh(
        shape.apply_transform(trimesh.transformations.rotation_matrix(np.radians(degrees), [1, 0, 0])), flat=True
    )


def received(scene, region, *, bounces):
    """Basis images (p, 9, 3) of the white scene at the pixels of ``region``."""
    points = scene.points(0, region=region, textured=False)
    return basis_images(scene, [WHITE], [points], SHBasis(2), TransportSettings(bounces=bounces, directions=512))[0][0]


@pytest.mark.parametrize("degrees", [45, 55])
def test_a_closed_depth_receives_what_the_body_receives(degrees):
    whole = scene_of(job_of([cup(degrees)], looking_down(focal=160.0)))
    depth, camera = z_depth(whole), whole.job.camera
    surface = JobObject("surface", mesh_from_depth(depth, camera))
    closed = replace(surface, unseen=closing_mesh(depth, camera))
    one_sided, closed = (scene_of(replace(whole.job, objects=(o,))) for o in (surface, closed))
    region = whole.regions[0] & one_sided.regions[0] & closed.regions[0]
    assert region.sum() > 0.5 * whole.regions[0].sum()
    for bounces in (1, 6):
        truth = received(whole, region, bounces=bounces)
        without, found = (
            np.square(received(s, region, bounces=bounces) - truth).sum() / np.square(truth).sum()
            for s in (one_sided, closed)
        )
        assert found < 0.5 * without


def highlights(depth, moved):
    """A photo (h, w, 3) with bright spots, and the depth missing at them, but ``moved`` pixels to the right."""
    rows, columns = np.mgrid[: depth.shape[0], : depth.shape[1]]
    image, missing = np.where(depth > 0, 0.3, 0.25), depth.copy()
    for row in (30, 44, 58):
        for column in (30, 44, 58):
            image[(rows - row) ** 2 + (columns - column) ** 2 < 25] = 1.0
            missing[(rows - row) ** 2 + (columns - column - moved) ** 2 < 25] = 0
    return image[..., None] * np.ones(3), missing


def test_holes_in_a_depth_are_no_outlines():
    """A sensor misses highlights, a little beside where they are: that is not how far the camera is off."""
    sphere = as_mesh(trimesh.creation.icosphere(5))
    whole = scene_of(job_of([sphere], looking_down(focal=160.0)))
    photo, depth = highlights(z_depth(whole), 4)
    surface = JobObject("surface", mesh_from_depth(depth, whole.job.camera))
    closed = replace(surface, unseen=closing_mesh(depth, whole.job.camera))
    one_sided, closed = (scene_of(replace(whole.job, objects=(o,))) for o in (surface, closed))
    doubt = alignment_doubt(silhouette_shift(photo, one_sided.shows_objects))
    assert doubt is not None and "4 to the left" in doubt  # were the holes' edges outlines
    assert alignment_doubt(silhouette_shift(photo, closed.shows_objects)) is None
    assert (closed.view.mesh == 0).sum() < 0.9 * (whole.view.mesh == 0).sum()  # and yet nothing is seen in them
    plain = np.where(z_depth(whole) > 0, 0.5, 0.05)[..., None] * np.ones(3)
    assert "4 pixels down" in alignment_doubt(silhouette_shift(np.roll(plain, 4, 0), closed.shows_objects))
    # beside a table the holes are closed as well, and the table is no object
    slab = trimesh.creation.box([20, 20, 0.02]).apply_translation([0, 0, -3])
    beside = scene_of(replace(closed.job, occluders=(Occluder(as_mesh(slab, flat=True), None),)))
    assert set(np.unique(beside.view.mesh)) >= {0, 1, 2}
    assert (beside.shows_objects == np.isin(beside.view.mesh, [0, 2])).all()


def test_the_result_says_what_is_taken_for_true(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    command = ["estimate", folder, "--material", "reference/white-diffuse", "--pixels", "500", "--no-report"]

    def choice():
        return answer(capsys, *command)["choice"]

    assert "geometry" not in choice()  # a mesh is all there is
    images.write_exr(folder / "z.exr", z_depth(scene_of(folder)))
    edited(folder, depth="z.exr", objects=[])
    assert "one side" in choice()["geometry"]


def test_a_depth_is_path_traced_with_what_it_hides(sphere_job_folder, capsys):
    folder, truth = sphere_job_folder
    images.write_exr(folder / "z.exr", z_depth(scene_of(folder)))
    edited(folder, depth="z.exr", objects=[])
    options = ["--transport", "reference", "--samples", "16", "--pixels", "300", "--order", "2", "--no-report"]
    result = answer(capsys, "estimate", folder, "--material", "reference/white-diffuse", *options)
    assert result["transport"]["by"] == "reference"
    assert off_as_seen(read_lighting(result["lighting"]).coefficients, truth) < 0.1
