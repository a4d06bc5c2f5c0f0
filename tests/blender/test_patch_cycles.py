# SPDX-License-Identifier: GPL-3.0-or-later
"""The virtual gonioreflectometer against Cycles: the same displaced patch, sun and view, mean radiance.

``scripts/study check-patch`` does the same with more patches and pairs, and prints what the documentation says.
"""

import numpy as np
import pytest

from btfsep_engine.btf.procedural import maps
from btfsep_engine.conventions import local_direction
from btfsep_engine.render.microfacet import layer_albedo
from btfsep_engine.render.patch import Patch
from scripts.cycles import patch_scene
from scripts.studies.check_patch import waves

# degrees; none in the list of 151
VIEWS = local_direction(*np.radians([(5, 20), (41, 0), (48, 201), (66, 95)]).T)
LIGHTS = local_direction(*np.radians([(12, 0), (33, 92), (46, 180), (58, 31), (69, 255)]).T)


def compare(m, tmp_path, *, samples, views=VIEWS, lights=LIGHTS, layer=None):
    """Mean radiances of both, (views, lights, 3)."""
    patch_scene.build(m, layer=layer)
    ours = np.stack([b.mean(1).T for b in Patch(m, lights).views(views, texels=64, samples=4)])
    options = {"size_mm": m.size_mm, "samples": samples}
    image = tmp_path / "image.exr"
    theirs = [[patch_scene.mean_radiance(v, l, image, **options) for l in lights] for v in views]
    return ours, np.array(theirs)


@pytest.mark.parametrize(
    ("base", "f0", "metallic", "limit", "worst"),
    [
        ((0.7, 0.4, 0.1), 0.0, None, 0.01, 0.05),
        ((0.5, 0.2, 0.05), 0.04, None, 0.01, 0.08),
        ((0.9, 0.6, 0.3), 0.04, 1.0, 0.01, 0.15),
    ],
)
def test_waves(base, f0, metallic, limit, worst, tmp_path):
    layer = layer_albedo(f0) if f0 and not metallic else None
    ours, theirs = compare(waves(base, f0, metallic=metallic), tmp_path, samples=8, layer=layer)
    error = np.abs(ours / theirs - 1)
    assert np.median(error) < limit, error
    assert error.max() < worst


@pytest.mark.parametrize("name", ["leather/brown-grain", "carpet/cut-wine"])
def test_materials_of_the_library(name, tmp_path):
    """Against a plain Principled BSDF, whose coupling of base and layer is not reciprocal."""
    ours, theirs = compare(maps(name, 192), tmp_path, samples=8, views=VIEWS[1:3], lights=LIGHTS[1:4])
    assert np.median(np.abs(ours / theirs - 1)) < 0.03
