# SPDX-License-Identifier: GPL-3.0-or-later
"""poses.json: what it says of each frame, and every mistake in one sentence."""

import copy
import json

import numpy as np
import pytest

from btfsep_engine.errors import InputError
from btfsep_engine.job.load import load_job
from btfsep_engine.job.poses import posed_jobs

TURN = [[0, -1, 0, 2], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
POSES = {
    "format": "btfsep-poses",
    "version": 1,
    "frames": {"f1": {"objects": {"cube": {"to_world": TURN}}}, "f2": {"camera": {"to_world": TURN, "fx": 20.0}}},
}


def written(job, tree):
    path = job.write().parent / "poses.json"
    path.write_text(json.dumps(tree))
    return path


def test_a_frame_is_a_job_with_what_it_says_elsewhere(job):
    path = written(job, POSES)
    folder, still = job.folder, load_job(job.folder)
    posed = {name: load_job(folder, with_photo=False, schema=s) for name, s in posed_jobs(path, folder).items()}
    cube = still.objects[0].mesh.vertices
    np.testing.assert_allclose(posed["f1"].objects[0].mesh.vertices, cube @ np.array(TURN)[:3, :3].T + [2, 0, 0])
    assert np.array_equal(posed["f1"].camera.to_world, still.camera.to_world)
    assert np.array_equal(posed["f1"].occluders[0].mesh.vertices, still.occluders[0].mesh.vertices)
    camera = posed["f2"].camera
    assert (camera.fx, camera.fy, camera.width) == (20, 14, 12) and np.array_equal(camera.to_world, TURN)
    assert np.array_equal(posed["f2"].objects[0].mesh.vertices, cube)


@pytest.mark.parametrize(
    ("where", "value", "words"),
    [
        (["format"], "btfsep-job", "it has to say \"format\": \"btfsep-poses\""),
        (["version"], 2, "use a newer BTFsep"),
        (["frames"], [], "frames; it is .*it has to be an object"),
        (["frames", "f1", "object"], {}, "frames.f1.object; this key is not known; did you mean 'objects'"),
        (["frames", "f1", "objects", "cub"], {"to_world": TURN}, "no object 'cub'; did you mean 'cube'"),
        (["frames", "f1", "objects", "cube", "to_world"], TURN[:3], "f1.objects.cube.to_world; it has 3 entries"),
        (["frames", "f1", "objects", "cube", "scale"], 2, "objects.cube.scale; this key is not known"),
        (["frames", "f1", "objects", "cube", "to_world"], np.zeros((4, 4)).tolist(), "cube: to_world; its last row"),
        (["frames", "f1", "objects", "cube", "to_world"], np.diag([1.0, 0, 1, 1]).tolist(), "matrix is singular"),
        (["frames", "f2", "camera", "to_world"], np.diag([2.0, 2, 2, 1]).tolist(), "f2.camera.to_world; its axes"),
        (["frames", "f2", "camera", "fx"], -1.0, "f2.camera.fx; it is -1.0; it has to be greater than"),
        (["frames", "f2", "camera", "k1"], -9.0, "f2.camera; its distortion folds"),
    ],
)  # fmt: skip
def test_mistakes_are_said_in_a_sentence(job, where, value, words):
    tree = copy.deepcopy(POSES)
    place = tree
    for key in where[:-1]:
        place = place[key]
    place[where[-1]] = value
    path = written(job, tree)
    with pytest.raises(InputError, match=words) as error:
        posed_jobs(path, job.folder)
    assert str(error.value).startswith("poses.json") and "\n" not in str(error.value)


def test_what_is_of_one_view_cannot_move(job, rng):
    path = written(job, POSES)
    job.exr("mask.exr", np.ones((8, 12, 3), np.float32))
    masked, deep = job.copy(), job.copy()
    masked["objects"][0]["mask"] = "mask.exr"
    deep |= {"objects": [], "depth": "photo.exr"}
    for tree, words in ((masked, "object 'cube' has a mask"), (deep, "the job has a depth")):
        job.write(tree)
        with pytest.raises(InputError, match=words):
            posed_jobs(path, job.folder)
    with pytest.raises(InputError, match=r"none\.json; there is no such file"):
        posed_jobs(job.folder / "none.json", job.folder)
