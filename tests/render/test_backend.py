# SPDX-License-Identifier: GPL-3.0-or-later
"""The choice of libLLVM, with real libraries and with files that are none."""

import pytest

from btfsep_engine import cache
from btfsep_engine.errors import InputError
from btfsep_engine.render import backend


@pytest.fixture(autouse=True)
def fresh(tmp_path, monkeypatch):
    """An empty cache, and no memory of an earlier choice."""
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "cache"))
    backend.choose_backend.cache_clear()
    yield
    backend.choose_backend.cache_clear()


def test_this_machine_has_a_backend_and_remembers_it():
    chosen = backend.choose_backend()
    assert chosen.variant in (backend.LLVM_VARIANT, backend.CUDA_VARIANT)
    assert str(cache.read(backend.remembered())["library"]) == chosen.library


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
