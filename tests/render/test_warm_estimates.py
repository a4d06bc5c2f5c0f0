# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that has seen other jobs answers as one that has just begun: every number, bit for bit."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from threadpoolctl import threadpool_limits

from btfsep_engine.cli import main
from btfsep_engine.imaging import images
from btfsep_engine.storage import kept

ROOT = Path(__file__).resolve().parents[2]
TIMING = ("seconds", "peak_memory_mb", "out", "lighting", "job_digest", "digests", "files")
OPTIONS = ("--preset", "draft", "--no-report")


# Where the process that goes on has several threads for its matrices: their number changes no digit.
ALONE = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def answers(out: Path) -> dict:
    """All that an estimate wrote, without what it took."""
    record = json.loads((out / "result.json").read_text(encoding="utf-8"))
    written = {name: (out / name).read_bytes() for name in ("lighting.json", "lighting.exr")}
    return written | {"record": {k: v for k, v in record.items() if k not in TIMING}}


@pytest.fixture
def jobs(sphere_job_folder, tmp_path_factory):
    """[(job folder, material)]: two photos, one saturated, two cameras, geometries and materials."""
    source, _ = sphere_job_folder
    shape = trimesh.load(source / "sphere.ply")
    shape.update_faces(shape.triangles_center[:, 2] < 0.2)
    shape.remove_unreferenced_vertices()
    job, photo = json.loads((source / "job.json").read_text()), images.read_linear(source / "photo.exr").pixels
    turned = np.array(job["camera"]["to_world"]) @ np.diag([-1.0, -1, 1, 1])
    cameras = {"above": job["camera"], "turned": {**job["camera"], "to_world": turned.tolist()}}
    folders = []
    for geometry, camera, name in (
        ("ball", "above", "photo.exr"),
        ("ball", "above", "bright.png"),
        ("bowl", "above", "photo.exr"),
        ("bowl", "turned", "bright.png"),
    ):
        folder = tmp_path_factory.mktemp("job")
        if name.endswith("png"):
            images.write_png(folder / name, photo / np.percentile(photo, 85))
        else:
            images.write_exr(folder / name, photo)
        (folder / "sphere.ply").write_bytes((source / "sphere.ply").read_bytes())
        if geometry == "bowl":
            shape.export(folder / "sphere.ply")
        (folder / "job.json").write_text(json.dumps({**job, "image": name, "camera": cameras[camera]}))
        folders.append(folder)
    white, leather = "reference/white-diffuse", "leather/brown-grain"
    return list(zip([*folders, folders[0]], [white, leather, white, white, leather], strict=True))


def test_the_order_of_jobs_changes_no_answer(jobs, tmp_path, capsys, monkeypatch, all_cores):
    def estimate(number, out):
        folder, material = jobs[number]
        return ["estimate", str(folder), "--material", material, *OPTIONS, "--out", str(out / str(number))]

    fresh = []
    for number in range(len(jobs)):  # as a process that has just begun
        command = [sys.executable, "-P", "-m", "btfsep_engine", *estimate(number, tmp_path / "fresh")]
        subprocess.run(command, check=True, cwd=ROOT, capture_output=True, env=ALONE)
        fresh.append(answers(tmp_path / "fresh" / str(number)))
    assert len({each["lighting.json"] for each in fresh}) == len(jobs)  # they are different questions
    assert any("modelled" in each["record"]["choice"]["interreflections"] for each in fresh)
    assert any("saturated" in str(each["record"]["warnings"]) for each in fresh)
    for seed, most_bytes in enumerate((kept.STORE.most_bytes, 4 << 20)):  # what is kept serves all, and hardly one
        monkeypatch.setattr(kept.STORE, "most_bytes", most_bytes)
        kept.STORE.forget()
        recalled = kept.STORE.recalled
        for number in np.random.default_rng(seed).permutation(np.repeat(np.arange(len(jobs)), 2 - seed)):
            with threadpool_limits(2, user_api="blas"):
                assert main(estimate(int(number), tmp_path / "warm")) == 0
            found = answers(tmp_path / "warm" / str(number))
            different = [k for k, v in fresh[number]["record"].items() if found["record"].get(k) != v]
            assert not different and found == fresh[number], (number, different)
            assert kept.STORE.bytes <= most_bytes
        assert kept.STORE.recalled > recalled
