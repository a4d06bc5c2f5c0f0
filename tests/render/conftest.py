# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tests with a renderer share."""

import numpy as np
import pytest
import trimesh

from btfsep_engine.imaging import images
from btfsep_engine.pipeline.refine import parted
from scripts.studies.stage import shaded_ball, write_job
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
    write_job(tmp_path, trimesh.creation.icosphere(5), camera, mesh="sphere.ply", metres=0.05, name="ball")
    images.write_exr(tmp_path / "photo.exr", shaded_ball(camera, x))
    return tmp_path, x


@pytest.fixture(scope="module")
def no_parts_with_edges():
    """Shadows and paints with edges explain some of this, too, and are asked elsewhere (`test_parted`)."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parted, "POOR", np.inf)
        yield
