# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads a ``poses.json``: where camera and objects are in each frame of a sequence."""

from pathlib import Path

from btfsep_engine.errors import InputError
from btfsep_engine.job.load import camera_of, job_schema, placed
from btfsep_engine.job.schema import CameraSchema, JobSchema, PoseSchema, PosesSchema, nearest, parse
from btfsep_engine.storage import atomic


def posed_jobs(path, folder) -> dict[str, JobSchema]:
    """Name of a frame -> what the ``job.json`` of ``folder`` would say of it; all of the file is checked.

    Raises InputError: the first thing that is wrong, in one sentence; a job that cannot move.
    """
    path, job = Path(path), job_schema(folder)
    poses = parse(PosesSchema, path.name, atomic.read_bytes(path, path.name), kind="a BTFsep file of poses")
    if job.depth is not None:
        raise InputError(path.name, "the job has a depth, which is of one view", "give the geometry as meshes")
    for o in job.objects:
        if o.mask is not None:
            got = f"object '{o.name}' has a mask, which is of one view"
            raise InputError(path.name, got, "leave the mask out of the job")
    return {frame: _posed(job, pose, f"{path.name}: frames.{frame}") for frame, pose in poses.frames.items()}


def _posed(job: JobSchema, pose: PoseSchema, name: str) -> JobSchema:
    """The job with what a pose says; ``name`` : what to call the pose in an error."""
    known = [o.name for o in job.objects]
    for each, place in pose.objects.items():
        if each not in known:
            raise InputError(f"{name}.objects", f"the job has no object '{each}'", nearest(each, known))
        placed(place.to_world, f"{name}.objects.{each}")
    moved = {} if pose.camera is None else pose.camera.model_dump(exclude_none=True)
    camera = CameraSchema(**{**job.camera.model_dump(), **moved})
    camera_of(camera, name=f"{name}.camera")
    objects = [
        o.model_copy(update={"to_world": pose.objects[o.name].to_world}) if o.name in pose.objects else o
        for o in job.objects
    ]
    return job.model_copy(update={"camera": camera, "objects": objects})
