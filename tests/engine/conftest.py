# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tests without a renderer share: seeded numbers, a small job folder, real data where there are some."""

import copy
import json
import os
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

CUBE = """# a cube: quads, its own uv
v -1 -1 -1
v 1 -1 -1
v 1 1 -1
v -1 1 -1
v -1 -1 1
v 1 -1 1
v 1 1 1
v -1 1 1
vt 0 0
vt 1 0
vt 1 1
vt 0 1
f 4/1 3/2 2/3 1/4
f 5/1 6/2 7/3 8/4
f 1/1 2/2 6/3 5/4
f 2/1 3/2 7/3 6/4
f 3/1 4/2 8/3 7/4
f 4/1 1/2 5/3 8/4
"""


@pytest.fixture
def rng():
    return np.random.default_rng(20260101)


@pytest.fixture
def test_data() -> Path:
    """The folder named by BTFSEP_TEST_DATA (CONTRIBUTING.md); the test is skipped where it is not set."""
    folder = os.environ.get("BTFSEP_TEST_DATA", "")
    if not folder or not Path(folder).is_dir():
        pytest.skip("BTFSEP_TEST_DATA does not name a folder with real meshes and maps")
    return Path(folder)


def _write_rgb_exr(path, pixels, channels="RGB", **attributes):
    """Writes (h, w, n) floats with OpenEXR itself, one channel a letter, as float32 or float16."""
    planes = {c: np.ascontiguousarray(pixels[..., i]) for i, c in enumerate(channels)}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **attributes}
    OpenEXR.File(header, planes).write(str(path))


@pytest.fixture
def write_rgb_exr():
    return _write_rgb_exr


class JobFolder:
    """A valid job folder of 12 x 8 pixels, to break one thing of it at a time."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.tree = {
            "format": "btfsep-job",
            "version": 1,
            "image": "photo.exr",
            "image_colorspace": "auto",
            "exposure_ev": 0.0,
            "camera": {
                "width": 12,
                "height": 8,
                "fx": 14.0,
                "fy": 14.0,
                "cx": 6.0,
                "cy": 4.0,
                "to_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]],
            },
            "objects": [
                {"name": "cube", "mesh": "cube.obj", "to_world": None, "mask": None, "material": None, "uv": "xatlas"}
            ],
            "occluders": [{"mesh": "cube.obj", "to_world": [[9, 0, 0, 0], [0, 9, 0, 0], [0, 0, 1, -3], [0, 0, 0, 1]]}],
            "depth": None,
            "metres_per_unit": 1.0,
        }
        self.pixels = np.linspace(0.1, 3, 12 * 8 * 3, dtype=np.float32).reshape(8, 12, 3)
        self.exr("photo.exr", self.pixels)
        (folder / "cube.obj").write_text(CUBE)

    def exr(self, name, pixels, channels="RGB"):
        _write_rgb_exr(self.folder / name, pixels, channels)

    def write(self, tree=None):
        """Writes job.json and returns the folder."""
        (self.folder / "job.json").write_text(json.dumps(self.tree if tree is None else tree))
        return self.folder

    def copy(self):
        return copy.deepcopy(self.tree)


@pytest.fixture
def job(tmp_path) -> JobFolder:
    folder = tmp_path / "job"
    folder.mkdir()
    return JobFolder(folder)
