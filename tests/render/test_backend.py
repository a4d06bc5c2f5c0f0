# SPDX-License-Identifier: GPL-3.0-or-later
"""The choice of libLLVM, with real libraries and with files that are none."""

import os
import subprocess
import sys
import tempfile

import numpy
import pytest

from btfsep_engine.commands import record
from btfsep_engine.errors import InputError
from btfsep_engine.render import backend
from btfsep_engine.storage import cache

RENDERS = """
import os
before = os.environ.get("HOME")
from btfsep_engine.render.backend import import_mitsuba
mi = import_mitsuba()
print(float((mi.Float([0.25, 0.75]) * 2).numpy()[0] * 2), os.environ.get("HOME") == before)
"""


REWRITTEN = """
import linecache
from btfsep_engine.render.backend import import_mitsuba
mi = import_mitsuba()
import drjit
box = mi.load_dict(mi.cornell_box())
def sources():  # that were read to be rewritten
    return [name for name in linecache.cache if name.endswith("prb.py")]
print(len(sources()), drjit.syntax is drjit.ast.syntax)
image = mi.render(box, spp=1, integrator=mi.load_dict({"type": "prb"}))
print(len(sources()), image.numpy().mean() > 0)
"""


@pytest.fixture(autouse=True)
def fresh(tmp_path, monkeypatch):
    """An empty cache, and no memory of an earlier choice."""
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "cache"))
    for remembered in (backend.choose_backend, backend.kernel_home):
        remembered.cache_clear()
    yield
    for remembered in (backend.choose_backend, backend.kernel_home):
        remembered.cache_clear()


def test_this_machine_has_a_backend_and_remembers_it():
    chosen = backend.choose_backend()
    assert chosen.variant in (backend.LLVM_VARIANT, backend.CUDA_VARIANT)
    assert str(cache.read(backend.remembered())["library"]) == chosen.library


def test_what_mitsuba_differentiates_with_is_rewritten_when_it_is_first_called():
    run = subprocess.run([sys.executable, "-P", "-c", REWRITTEN], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["0", "True", "1", "True"]


def test_a_library_that_is_none_is_refused_with_a_remedy(tmp_path, monkeypatch):
    fake = tmp_path / "libLLVM-99.so"
    fake.write_bytes(b"not a library")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(fake))
    monkeypatch.setenv("BTFSEP_VARIANT", backend.LLVM_VARIANT)
    with pytest.raises(
        InputError, match=r"the renderer cannot start; tried .*libLLVM-99.so .*install one that works"
    ) as caught:
        backend.choose_backend()
    assert "unset it" in str(caught.value)  # the others were not tried
    assert not backend.remembered().exists()


def test_no_library_at_all_is_told(monkeypatch):
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setenv("BTFSEP_VARIANT", backend.LLVM_VARIANT)
    monkeypatch.setattr(backend, "LIBRARY_PATTERNS", ("/nonexistent/libLLVM*",))
    with pytest.raises(InputError, match="no libLLVM was found") as caught:
        backend.choose_backend()
    assert "unset" not in str(caught.value)


def test_a_graphics_card_is_asked_where_no_library_renders(monkeypatch):
    """Here there is none: that it was tried is told. Where a library renders, it is not asked."""
    monkeypatch.delenv("BTFSEP_VARIANT", raising=False)
    monkeypatch.setattr(backend, "has_cuda_driver", lambda: True)
    assert backend.choose_backend().variant == backend.LLVM_VARIANT
    backend.choose_backend.cache_clear()
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(backend, "LIBRARY_PATTERNS", ())
    monkeypatch.setattr(backend, "try_backend", lambda variant, library="": f"{variant} was tried")
    with pytest.raises(InputError, match=r"tried cuda_ad_rgb \(cuda_ad_rgb was tried\); install one that works"):
        backend.choose_backend()


def test_an_unknown_variant_is_refused(monkeypatch):
    monkeypatch.setenv("BTFSEP_VARIANT", "scalar_rgb")
    with pytest.raises(InputError, match="BTFSEP_VARIANT; scalar_rgb; set it to llvm_ad_rgb or cuda_ad_rgb"):
        backend.choose_backend()


def test_on_windows_a_driver_is_seen_by_its_library(tmp_path, monkeypatch):
    """Its users have no toolkit, and so no CUDA_PATH."""
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setenv("SystemRoot", str(tmp_path))
    assert not backend.has_cuda_driver()
    (tmp_path / "System32").mkdir()
    (tmp_path / "System32" / "nvcuda.dll").touch()
    assert backend.has_cuda_driver()


def test_a_damaged_memory_is_ignored():
    remembered = backend.remembered()
    remembered.parent.mkdir(parents=True)
    remembered.write_text("{damaged")
    chosen = backend.choose_backend()
    assert str(cache.read(remembered)["variant"]) == chosen.variant


@pytest.mark.parametrize(
    ("name", "version"),
    [("libLLVM-15.so", (15,)), ("libLLVM.so.19.1", (19, 1)), ("libLLVM-14.0.6.so.1", (14, 0, 6)), ("libLLVM.so", ())],
)
def test_versions_are_read_from_names(name, version):
    assert backend.llvm_version(f"/usr/lib/{name}") == version


def test_a_package_that_has_another_name_is_no_crash(monkeypatch):
    """As OpenCV's, of which there are four."""
    monkeypatch.setattr(record, "PACKAGES", ("numpy", "opencv-of-another-name"))
    record.versions.cache_clear()
    try:
        found = record.versions()
    finally:
        record.versions.cache_clear()
    assert found["numpy"] == numpy.__version__ and found["opencv-of-another-name"] == "unknown"


@pytest.mark.parametrize("home", [None, "", "relative", "/nonexistent/home", "a file"])
@pytest.mark.parametrize("cached", [True, False])
def test_a_home_that_is_missing_or_cannot_be_written_is_no_obstacle(tmp_path, home, cached):
    """In a process of its own: Dr.Jit begins once, and would end it. Nothing is left where the command runs."""
    (tmp_path / "file").write_text("no folder")
    environment = os.environ | {
        "BTFSEP_CACHE": str(tmp_path / ("cache" if cached else "file")),
        "TMPDIR": str(tmp_path),
    }
    environment.pop("HOME", None)
    if home is not None:
        environment["HOME"] = str(tmp_path / "file") if home == "a file" else home
    (tmp_path / "here").mkdir()
    run = subprocess.run(
        [sys.executable, "-c", RENDERS], cwd=tmp_path / "here", env=environment, capture_output=True, text=True
    )
    assert run.returncode == 0 and run.stdout.split() == ["1.0", "True"], run.stderr
    assert not list((tmp_path / "here").iterdir()) and not list(tmp_path.glob("btfsep-*"))
    assert (tmp_path / "cache" / ".drjit").is_dir() == (tmp_path / "cache").exists() == cached


def test_where_no_folder_can_be_written_that_is_said(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("no folder")
    for name in ("HOME", "BTFSEP_CACHE"):
        monkeypatch.setenv(name, str(tmp_path / "file"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "file"))
    backend.kernel_home.cache_clear()
    with pytest.raises(InputError, match="temporary folder can be written; set HOME or BTFSEP_CACHE"):
        backend.kernel_home()


def test_a_user_without_a_home_has_a_cache_that_is_never_there(monkeypatch):
    monkeypatch.delenv("BTFSEP_CACHE")
    monkeypatch.setattr(cache, "user_cache_dir", lambda *_, **__: "~/.cache/btfsep")
    with pytest.raises(InputError, match="cannot write"):
        cache.write(cache.cache_folder() / "kind" / "key.entry", {})
    assert cache.read(cache.cache_folder() / "kind" / "key.entry") is None
