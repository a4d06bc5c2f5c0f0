# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs with a depth: what the surface receives is what the whole body's visible side receives."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.model import Lambertian
from btfsep_engine.job.depth import closing_mesh, mesh_from_depth
from btfsep_engine.job.model import JobObject
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.pipeline.basis import basis_images
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from tests.render.scenes import as_mesh, job_of, looking_down

WHITE = Lambertian("white", np.full(3, 0.8))
SETTINGS = choose("draft", bounces=6, directions=512)


def cup(degrees):
    """A cylinder with a floor and no lid, tilted towards the camera; most of its inside and outside is hidden."""
    wall = trimesh.creation.annulus(0.75, 0.85, 1.6, sections=96)
    floor = trimesh.creation.cylinder(0.8, 0.1, sections=96).apply_translation([0, 0, -0.75])
    shape = trimesh.util.concatenate([wall, floor])
    return as_mesh(
        shape.apply_transform(trimesh.transformations.rotation_matrix(np.radians(degrees), [1, 0, 0])), flat=True
    )


def z_depth(scene):
    """(h, w) z-depth of what a scene's camera sees."""
    camera = scene.job.camera
    rows, columns = np.mgrid[: camera.height, : camera.width]
    _, directions = camera.rays(columns.ravel() + 0.5, rows.ravel() + 0.5)
    along = (directions @ -camera.to_world[:3, 2]).reshape(rows.shape)
    return np.where(scene.view.mesh >= 0, scene.view.distance * along, 0)


def received(scene, region, *, bounces):
    """Basis images (p, 9, 3) of the white scene at the pixels of ``region``."""
    points = scene.points(0, region=region, textured=False)
    return basis_images(scene, [WHITE], [points], SHBasis(2), replace(SETTINGS, bounces=bounces))[0][0]


@pytest.mark.parametrize("degrees", [45, 55])
def test_a_closed_depth_receives_what_the_body_receives(degrees):
    whole = PreparedScene(job_of([cup(degrees)], looking_down(focal=160.0)), Reporter())
    depth, camera = z_depth(whole), whole.job.camera
    surface = JobObject("surface", mesh_from_depth(depth, camera))
    closed = replace(surface, unseen=closing_mesh(depth, camera))
    one_sided, closed = (PreparedScene(replace(whole.job, objects=(o,)), Reporter()) for o in (surface, closed))
    region = whole.regions[0] & one_sided.regions[0] & closed.regions[0]
    assert region.sum() > 0.5 * whole.regions[0].sum()
    for bounces in (1, 6):
        truth = received(whole, region, bounces=bounces)
        without, found = (
            np.square(received(s, region, bounces=bounces) - truth).sum() / np.square(truth).sum()
            for s in (one_sided, closed)
        )
        assert found < 0.5 * without
