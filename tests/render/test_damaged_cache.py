# SPDX-License-Identifier: GPL-3.0-or-later
"""A whole estimate on a cache whose files are damaged: no word about it, and the same light."""

import json

import numpy as np
import trimesh

from btfsep_engine.cli import main
from btfsep_engine.commands.record import versions
from btfsep_engine.light.files import read_lighting
from btfsep_engine.render import backend
from btfsep_engine.storage import cache
from btfsep_engine.storage.kept import STORE


def wrong_shape(path):
    arrays = cache.read(path)
    np.savez(path.with_suffix(".npz"), **{name: a[..., :1] if a.ndim else a for name, a in arrays.items()})
    path.with_suffix(".npz").rename(path)


def not_a_number(path):
    """One of the largest array's floats, or a text's letter."""
    largest = max(cache.read(path).values(), key=lambda a: a.nbytes)
    data = bytearray(path.read_bytes())
    at = data.index(largest.tobytes())
    data[at : at + 4] = b"\xff" * 4
    path.write_bytes(data)


def a_folder(path):
    path.unlink()
    (path / "inside").mkdir(parents=True)


DAMAGES = (
    not_a_number,
    lambda path: path.write_bytes(b""),
    lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3]),
    wrong_shape,
    a_folder,
    lambda path: path.with_suffix(".copy").rename(path),  # another entry
)


def test_every_kind_of_damage_is_mended_without_a_word(sphere_job_folder, capsys, tmp_path, monkeypatch):
    """Textures, for the charts; in a new process's state, for the choice of the renderer."""
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "cache"))
    folder, _ = sphere_job_folder
    fine = trimesh.load(folder / "sphere.ply", process=False)
    radius = float(np.linalg.norm(fine.vertices, axis=1).mean())
    # charts of the fine ball take most of an estimate, and they are laid anew for each damage
    trimesh.creation.icosphere(3, radius=radius).export(folder / "sphere.ply")
    options = ["--material", "felt/green-coarse", "--preset", "draft", "--appearance", "textured", "--no-report"]

    def estimated():
        backend.choose_backend.cache_clear()
        versions.cache_clear()
        STORE.forget()
        assert main(["estimate", str(folder), *options, "--json"]) == 0
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        return read_lighting(json.loads(said.out.splitlines()[-1])["result"]["lighting"]).coefficients

    first = estimated()
    entries = sorted((tmp_path / "cache").rglob("*.entry"))
    assert [p.parent.name for p in entries] == ["backend", "charts"]
    whole = {p: p.read_bytes() for p in entries}
    for damage in DAMAGES:
        for i, path in enumerate(entries):
            path.with_suffix(".copy").write_bytes(whole[entries[i - 1]])
            damage(path)
            assert cache.read(path) is None
        np.testing.assert_allclose(estimated(), first, rtol=1e-5, atol=1e-6)
        assert all(cache.read(path) is not None for path in entries)
    for change in (lambda a: np.full_like(a, np.nan), lambda a: a[..., :1], lambda a: np.array(["a", "b"])):
        for path in entries:  # whole, and not what it should be
            path.write_bytes(whole[path])
            arrays = cache.read(path)
            cache.write(path, {n: change(a) if a.dtype.kind == "f" else np.zeros(3) for n, a in arrays.items()})
        np.testing.assert_allclose(estimated(), first, rtol=1e-5, atol=1e-6)


def test_doctor_says_where_nothing_can_be_kept(capsys, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "file" / "cache"))
    assert main(["doctor"]) == 0
    assert "is no folder: each run learns the materials anew" in capsys.readouterr().out
