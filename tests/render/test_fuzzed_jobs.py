# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole estimates of jobs that are spoilt at random: each is done or has failed in words; none is a bug, none hangs.

BTFSEP_FUZZ says how many, other than the usual few.
"""

import copy
import json
import os
import random
import shutil
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from btfsep_engine.cli.batch import EstimateTask, estimate_job
from btfsep_engine.cli.worker import Worker
from btfsep_engine.imaging import images
from btfsep_engine.pipeline.settings import choose

CASES = int(os.environ.get("BTFSEP_FUZZ", "40"))
VALUES = [None, True, -1, 0, 1, 3, 1e-308, 1e-9, 1e9, 1e308, -1e308, 2**63, 10**400, float("nan"), float("inf")]
VALUES += ["", "a", "auto", "..", "../photo.exr", "/", "photo.exr", "sphere.ply", "caf\udce9", "\0", "x" * 5000, "🙂"]
VALUES += [[], {}, [[]], [1], [0, 0, 0], [[1, 0, 0, 0]] * 4, {"base_color": [0.5] * 3}, {"roughness": -1}]
LENGTHS = [0, 1, 7, 100, 400]


@pytest.fixture
def job(sphere_job_folder):
    """A job with everything that a job may name."""
    folder, _ = sphere_job_folder
    fields = json.loads((folder / "job.json").read_text())
    images.write_png(folder / "mask.png", np.ones((fields["camera"]["height"], fields["camera"]["width"], 3)))
    told = {"mask": "mask.png", "material": "reference/white-diffuse", "to_world": None, "uv": "xatlas"}
    fields["objects"][0] |= told
    shutil.copy(folder / "sphere.ply", folder / "other.ply")
    away = [[1, 0, 0, 3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    surface = {"base_color": [0.2, 0.3, 0.4], "roughness": 0.5, "metallic": 0, "specular": 0.5}
    fields["occluders"] = [{"mesh": "other.ply", "to_world": away, "surface": surface}]
    fields |= {"image_colorspace": "auto", "exposure_ev": 0.0, "depth": None}
    fields["camera"] |= {"projection": "perspective", "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0}
    (folder / "job.json").write_text(json.dumps(fields))
    return folder


def places(tree, path=()):
    """The path of every value in a tree of JSON."""
    yield path
    inside = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in inside:
        yield from places(value, (*path, key))


def spoil_json(job: Path, chance: random.Random) -> str:
    tree = json.loads((job / "job.json").read_text())
    said = []
    for _ in range(chance.choice([1, 1, 1, 2, 3])):
        *above, last = chance.choice([p for p in places(tree) if p])
        holder = tree
        for key in above:
            holder = holder[key]
        how = chance.choice(["value", "value", "value", "number", "gone", "twice", "new"])
        value = chance.choice(VALUES)
        if how == "number" and isinstance(holder[last], int | float) and not isinstance(holder[last], bool):
            value = holder[last] * chance.choice([-1, 0.5, 2, 10, 1000, 1e-6]) + chance.choice([0, 0.5])
        if how == "gone":
            holder.pop(last)
        elif how == "twice" and isinstance(holder, list):
            holder.append(copy.deepcopy(holder[last]))
        elif how == "new" and isinstance(holder, dict):
            holder["unknown"] = value
        else:
            holder[last] = value
        said.append(f"{[*above, last]} {how} {str(value)[:40]!r}")
    (job / "job.json").write_text(json.dumps(tree))
    return "; ".join(said)


def spoil_file(job: Path, chance: random.Random) -> str:
    path = job / chance.choice(["job.json", "photo.exr", "sphere.ply", "mask.png", "other.ply"])
    data = bytearray(path.read_bytes())
    how = chance.choice(["bits", "bits", "bits", "head", "cut", "more", "swapped", "gone", "folder", "loop", "pipe"])
    if how in ("bits", "head"):
        for _ in range(chance.choice([1, 2, 30])):
            data[chance.randrange(min(len(data), 400) if how == "head" else len(data))] = chance.randrange(256)
    elif how == "cut":
        del data[chance.choice([*LENGTHS, len(data) // 2, len(data) - 1]) :]
    elif how == "more":
        data += chance.randbytes(chance.choice(LENGTHS))
    elif how == "swapped":
        data = bytearray((job / chance.choice(["job.json", "photo.exr", "sphere.ply", "mask.png"])).read_bytes())
    path.unlink()
    if how == "folder":
        path.mkdir()
    elif how == "loop":
        path.symlink_to(path.name)
    elif how == "pipe":
        os.mkfifo(path)
    elif how != "gone":
        path.write_bytes(data)
    return f"{path.name} {how}"


@pytest.mark.skipif(os.name != "posix", reason="pipes in folders")
def test_a_spoilt_job_is_done_or_has_failed_in_words(job, tmp_path_factory):
    room, wrong, ends = tmp_path_factory.mktemp("room"), [], set()
    settings = choose("draft", order=2, pixels=300)
    with closing(Worker(most_mb=3000)) as worker:
        for seed in range(CASES):
            chance = random.Random(seed)
            spoilt = room / f"{seed}"
            shutil.copytree(job, spoilt)
            said = chance.choice([spoil_json, spoil_file])(spoilt, chance)
            task = EstimateTask(spoilt, spoilt / "result", settings, with_report=seed % 4 == 0)
            end = worker.run(estimate_job, task, time_limit=120)
            ends.add(end.exit_code)
            in_words = end.exit_code == 0 or (end.exit_code == 2 and end.message.count(";") >= 1)
            if not in_words or "\n" in end.message:
                wrong.append(f"seed {seed}: {said}: {end.exit_code} {end.message[:300]}")
            shutil.rmtree(spoilt)
    assert not wrong, "\n".join(wrong)
    assert ends == {0, 2}
