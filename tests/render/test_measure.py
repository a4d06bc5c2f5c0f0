# SPDX-License-Identifier: GPL-3.0-or-later
"""Measuring from texture maps into a library: closed form, seed, going on after a kill, other readers, the command."""

import json
import os
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pysmtb.btf
import pytest

from btfsep_engine.btf import library
from btfsep_engine.cli import main
from btfsep_engine.commands import measure as measuring
from btfsep_engine.commands.measure import MeasureSettings, measure_maps
from btfsep_engine.conventions import local_direction
from btfsep_engine.errors import InputError
from btfsep_engine.imaging.images import write_exr
from btfsep_engine.progress import Reporter
from tests.render.progress_lines import assert_whole_run

N = 24
DIRECTIONS = local_direction(
    np.radians([0, 30, 30, 30, 60, 60, 60, 60, 75]), np.radians([0, 0, 120, 240, 10, 100, 190, 280, 45])
)
SMALL = MeasureSettings(texels=12, components=6, mesh=N)


def write_maps(folder, *, rough=0.6, bumpy=True):
    """Waves under stripes, as EXR; returns the folder."""
    u, v = np.meshgrid(*[(np.arange(N) + 0.5) / N * 2 * np.pi] * 2)
    colour = np.stack([0.4 + 0.2 * np.sin(2 * u), 0.3 + 0.1 * np.cos(v), np.full_like(u, 0.1)], -1)
    height = 0.5 + 0.3 * np.sin(2 * u + v) if bumpy else np.full((N, N), 0.5)
    if not bumpy:
        colour[:] = (0.6, 0.3, 0.1)
    for name, a in (("basecolor", colour), ("height", height), ("roughness", np.full((N, N), rough))):
        write_exr(folder / f"{name}.exr", a.astype(np.float32))
    return folder


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """A cache folder of the test's own, with what is known of the backend."""
    from btfsep_engine.render.backend import remembered

    known = remembered()
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "cache"))
    if known.is_file():
        remembered().parent.mkdir(parents=True)
        remembered().write_bytes(known.read_bytes())
    return tmp_path / "cache"


def run(maps, into, settings=SMALL, **options):
    options = {"name": "x", "material_class": "leather", "size_mm": 10.0, "height_mm": 1.0} | options
    return measure_maps(maps, library=into, settings=settings, directions=DIRECTIONS, **options)


def kept(cache):
    return sorted((cache / "measure").rglob("*.part")) if (cache / "measure").is_dir() else []


def test_flat_lambertian_maps_give_albedo_over_pi(tmp_path):
    """No layer (f0 = 0): the base colour over pi, from every view under every light, in the stored file."""
    settings = MeasureSettings(texels=16, components=3, mesh=N, f0=0.0)
    result = run(write_maps(tmp_path, bumpy=False), tmp_path / "lib", settings)
    assert result["relief_mm"] == 0 and result["measured"]
    material = library.open_library(tmp_path / "lib").load("leather/x")
    value = np.einsum("yxk,vlck->vlc", material.texels, material.angular) / 256
    np.testing.assert_allclose(value, np.broadcast_to(np.array([0.6, 0.3, 0.1]) / np.pi, value.shape), rtol=7e-3)
    np.testing.assert_allclose(material.views, DIRECTIONS, atol=1e-6)
    assert material.texel_mm == pytest.approx(10 / 16)


def test_pysmtb_reads_the_file(tmp_path):
    result = run(write_maps(tmp_path), tmp_path / "lib")
    meta, data = pysmtb.btf.read_ubo_btf_dfmf(str(tmp_path / "lib" / result["file"]))
    assert (meta.width, meta.height, meta.num_views, meta.num_lights) == (12, 12, 9, 9)
    assert meta.cosine_in_data and meta.ppmm == pytest.approx(12 / 10) and meta.color_model == 0
    np.testing.assert_allclose(np.array(meta.views_3d).reshape(-1, 3), DIRECTIONS, atol=1e-6)
    theirs = [sxv.astype(float) @ u.astype(float).T for u, sxv in zip(data.U, data.SxV, strict=True)]
    theirs = np.stack(theirs, -1).reshape(12, 12, 9, 9, 3)
    assert theirs.mean() > 0.02
    material = library.open_library(tmp_path / "lib").load("leather/x")
    assert material.texels.shape[2] == 6  # one spatial factor for the three channels: not three times as many
    ours = np.einsum("yxk,vlck->yxvlc", material.texels, material.angular) * DIRECTIONS[:, 2, None]
    np.testing.assert_allclose(theirs, ours, atol=1e-5)


def test_the_seed_decides_every_bit(tmp_path):
    maps = write_maps(tmp_path)
    files = {}
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        settings = MeasureSettings(texels=12, components=6, mesh=N, seed=seed)
        result = run(maps, tmp_path / name, settings)
        files[name] = (tmp_path / name / result["file"]).read_bytes()
    assert files["a"] == files["b"] != files["c"]


KILLED = """
    import os, signal, sys
    import numpy as np
    from btfsep_engine.progress import Reporter
    from tests.render import test_measure as t

    class Kill(Reporter):
        def progress(self, stage, fraction, message=""):
            if stage == "measure" and fraction > 0.7:
                os.kill(os.getpid(), signal.SIGKILL)

    t.run(sys.argv[1], sys.argv[2], reporter=Kill(), every=2)
"""


class Count(Reporter):
    """Counts the views that are measured."""

    def __init__(self):
        super().__init__()
        self.views = 0

    def progress(self, stage, fraction, message=""):
        self.views += stage == "measure" and bool(message)


def test_a_killed_run_goes_on_and_gives_the_identical_file(tmp_path, cache):
    maps = write_maps(tmp_path)
    result = run(maps, tmp_path / "whole")
    whole = (tmp_path / "whole" / result["file"]).read_bytes()
    assert kept(cache) == []
    program = [sys.executable, "-c", textwrap.dedent(KILLED), str(maps), str(tmp_path / "resumed")]
    died = subprocess.run(program, check=False, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})
    assert died.returncode == -signal.SIGKILL
    assert len(kept(cache)) == 3 and not (tmp_path / "resumed").exists()
    count = Count()
    result = run(maps, tmp_path / "resumed", reporter=count)
    assert count.views == 3  # of 9; six were kept
    assert (tmp_path / "resumed" / result["file"]).read_bytes() == whole
    assert kept(cache) == []


def test_damaged_checkpoints_are_made_again(tmp_path, cache):
    class Stop(Reporter):
        def progress(self, stage, fraction, message=""):
            if stage == "measure" and fraction == 1.0:
                raise KeyboardInterrupt

    maps = write_maps(tmp_path)
    result = run(maps, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        run(maps, tmp_path / "again", reporter=Stop(), every=2)
    parts = kept(cache)
    assert [p.name for p in parts] == ["0000.part", "0001.part", "0002.part", "0003.part"]
    data = parts[1].read_bytes()
    parts[1].write_bytes(bytes(32) + data[32:])  # not the digest of what follows
    parts[3].write_bytes(parts[3].read_bytes()[:-500])
    count = Count()
    again = run(maps, tmp_path / "again", reporter=count)
    assert count.views == 7
    pair = [(tmp_path / f / r["file"]).read_bytes() for f, r in (("whole", result), ("again", again))]
    assert pair[0] == pair[1]


def test_other_maps_or_settings_do_not_take_up_these_checkpoints():
    from btfsep_engine.btf.procedural import Maps

    a = np.full((4, 4), 0.5, np.float32)
    maps = Maps("leather/x", np.stack([a] * 3, -1), a * 0, a, 10.0)
    other = Maps("leather/x", np.stack([a] * 3, -1), a * 0 + np.float32(1e-7), a, 10.0)
    settings = [SMALL, MeasureSettings(texels=12, components=6, mesh=N, seed=1)]
    keys = {measuring.measurement_digest(m, s, d) for m in (maps, other) for s in settings for d in (DIRECTIONS, -a)}
    assert len(keys) == 8


def test_where_nothing_can_be_kept_the_run_goes_on(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "file"))
    reporter = Reporter()
    run(write_maps(tmp_path), tmp_path / "lib", reporter=reporter, every=2)
    assert sum("have to start anew" in w for w in reporter.warnings) == 1


def test_what_is_there_stays_and_a_name_is_taken_once(tmp_path):
    maps = write_maps(tmp_path)
    run(maps, tmp_path / "lib")
    count = Count()
    assert run(maps, tmp_path / "lib", reporter=count)["measured"] is False and count.views == 0
    other = MeasureSettings(texels=8, components=6, mesh=N)
    with pytest.raises(InputError, match="the library has one of this name"):
        run(maps, tmp_path / "lib", other)
    assert run(maps, tmp_path / "lib", other, replace_old=True)["texels"] == [8, 8]
    opened = library.open_library(tmp_path / "lib")
    assert list(opened.entries) == ["leather/x"] and opened.load("leather/x").texels.shape[:2] == (8, 8)
    assert len(list((tmp_path / "lib").glob("*.btf"))) == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"name": "../x"}, "the name 'leather/../x'"),
        ({"name": ""}, "the name"),
        ({"material_class": "reference"}, "reference"),
        ({"settings": MeasureSettings(texels=4)}, "--texels; '4'; choose 8 to 1024"),
        ({"settings": MeasureSettings(samples=0)}, "--samples; '0'"),
        ({"settings": MeasureSettings(seed=-1)}, "--seed; '-1'"),
    ],
)
def test_bad_options_are_refused_before_the_work(tmp_path, options, words):
    with pytest.raises(InputError) as caught:
        run(write_maps(tmp_path), tmp_path / "lib", options.pop("settings", SMALL), **options)
    assert words in str(caught.value) and not (tmp_path / "lib").exists()


def test_texels_follow_the_size_unless_given():
    assert [MeasureSettings().checked(mm).texels for mm in (5, 30, 60, 80, 500)] == [80, 80, 120, 160, 160]
    assert MeasureSettings(texels=16).checked(500).texels == 16


def test_the_command(tmp_path, capsys, monkeypatch):
    """As a user runs it, with few directions in the place of UBO2014's."""
    monkeypatch.setattr(measuring, "ubo2014_directions", lambda: DIRECTIONS)
    maps, lib = str(write_maps(tmp_path)), str(tmp_path / "lib")
    command = ["library", "measure", "--maps", maps, "--name", "waves", "--class", "stone", "--size-mm", "10"]
    assert main([*command, "--height-mm", "1", "--library", lib, "--texels", "12", "--components", "5", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["fraction"] for line in lines if line["type"] == "progress" and line["message"]] == [
        round((i + 1) / 9, 4) for i in range(9)
    ]
    assert_whole_run(lines, "measure")
    result = lines[-1]["result"]
    speed = result["speed"]
    assert speed["rays"] > 9 * 9 * 144 and speed["rays_per_second"] == pytest.approx(
        speed["rays"] / speed["seconds"], rel=0.2
    )
    assert result["name"] == "stone/waves" and result["components"] == 5 and result["texels"] == [12, 12]
    assert main(["library", "show", "stone/waves", "--library", lib]) == 0
    assert main([*command, "--library", lib]) == 2
    assert "error: the height of the patch; it is not given" in capsys.readouterr().err
