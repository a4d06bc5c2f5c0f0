# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tests with a renderer share."""

import json

import numpy as np
import pytest
import trimesh

from btfsep_engine import images, sh
from tests.render.scenes import as_mesh, looking_down, positive_light


@pytest.fixture
def sphere():
    """A unit sphere, finely tessellated and smooth."""
    return as_mesh(trimesh.creation.icosphere(5))


@pytest.fixture
def sphere_job_folder(tmp_path):
    """A job folder: a white sphere (albedo 0.8) under a light of order 2, shaded in closed form.

    Gives folder, coefficients (9, 3).
    """
    camera, x = looking_down(), positive_light(2)
    rows, columns = np.mgrid[: camera.height, : camera.width]
    origins, directions = camera.rays(columns.ravel() + 0.5, rows.ravel() + 0.5)
    b = (origins * directions).sum(1)
    discriminant = b * b - (origins**2).sum(1) + 1
    hit = discriminant > 0
    normals = origins + (-b - np.sqrt(np.maximum(discriminant, 0)))[:, None] * directions
    image = np.where(hit[:, None], 0.8 / np.pi * sh.irradiance(x, normals), 0.1).reshape(camera.height, camera.width, 3)
    images.write_exr(tmp_path / "photo.exr", image.astype(np.float32))
    trimesh.creation.icosphere(5).export(tmp_path / "sphere.ply")
    job = {
        "format": "btfsep-job",
        "version": 1,
        "image": "photo.exr",
        "camera": {**{k: getattr(camera, k) for k in ("width", "height", "fx", "fy", "cx", "cy")}}
        | {"to_world": camera.to_world.tolist()},
        "objects": [{"name": "ball", "mesh": "sphere.ply"}],
        "metres_per_unit": 0.05,
    }
    (tmp_path / "job.json").write_text(json.dumps(job))
    return tmp_path, x
