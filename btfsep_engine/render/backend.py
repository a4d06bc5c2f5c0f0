# SPDX-License-Identifier: GPL-3.0-or-later
"""Which Mitsuba variant and which libLLVM this machine gets.

Some pairs of Dr.Jit and libLLVM abort the whole process, so a library is tried in a child process first and
only then loaded here. The choice is remembered in the cache folder until a candidate or Mitsuba changes.
"""

import atexit
import glob
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, fields
from functools import lru_cache, wraps
from pathlib import Path

from btfsep_engine.errors import InputError
from btfsep_engine.loading import loading
from btfsep_engine.storage import cache
from btfsep_engine.threads import at_most

LLVM_VARIANT, CUDA_VARIANT = "llvm_ad_rgb", "cuda_ad_rgb"
TRIAL_SECONDS = 120
LIBRARY_PATTERNS = (
    "/usr/lib/*/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib64/llvm*/lib*/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
    "C:/Program Files/LLVM/bin/LLVM-C.dll",
)
INSTALL = {
    "win32": "winget install LLVM.LLVM",
    "darwin": "brew install llvm",
    "linux": "Debian, Ubuntu: sudo apt-get install libllvm19, or libllvm15; Fedora: sudo dnf install llvm-libs",
}
"""Platform -> how a libLLVM is had there, in one command."""
# Renders a lit sphere: what Dr.Jit compiles, Embree traces and libLLVM must survive.
TRIAL = """
import json, sys
import mitsuba as mi
mi.set_variant(sys.argv[1])
scene = mi.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 3},
    "light": {"type": "constant"}, "shape": {"type": "sphere", "bsdf": {"type": "diffuse"}},
    "sensor": {"type": "perspective", "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
               "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}}})
import numpy as np
image = np.array(mi.render(scene, spp=16))
centre = float(image[8, 8].mean())
assert np.isfinite(image).all() and 0.4 < centre < 0.6, centre
import drjit as dr
print(json.dumps({"ok": True, "centre": centre}))
"""


@dataclass(frozen=True)
class Backend:
    """A variant that was seen to render. ``library`` is the libLLVM's path, "" for CUDA."""

    variant: str
    library: str
    llvm: str


def llvm_version(path: str) -> tuple[int, ...]:
    """The version that a library's file name carries, () where it has none."""
    found = re.search(r"libLLVM[-.](?:so\.)?(\d+(?:\.\d+)*)", os.path.basename(path))
    return tuple(int(part) for part in found.group(1).split(".")) if found else ()


def named_library() -> str:
    """The libLLVM that the environment asks for, "" where it asks for none."""
    return os.environ.get("DRJIT_LIBLLVM_PATH", "")


def candidates() -> list[str]:
    """libLLVM files of this machine, newest first, one for each real file; DRJIT_LIBLLVM_PATH alone if it is set."""
    if named_library():
        return [named_library()]
    by_real = {}
    for pattern in LIBRARY_PATTERNS:
        for path in sorted(glob.glob(pattern)):
            real = os.path.realpath(path)
            if os.path.isfile(real) and (real not in by_real or llvm_version(path) > llvm_version(by_real[real])):
                by_real[real] = path
    return sorted(by_real.values(), key=llvm_version, reverse=True)


def try_backend(variant: str, library: str = "") -> str:
    """Renders a sphere in a child process.

    Gives "" when the image is right, else one line that says what happened.
    """
    env = os.environ | {"HOME": kernel_home()}
    if library:
        env["DRJIT_LIBLLVM_PATH"] = library
    try:
        run = subprocess.run(  # -P: nothing is imported from the current folder
            [sys.executable, "-P", "-c", TRIAL, variant], env=env, capture_output=True, text=True, timeout=TRIAL_SECONDS
        )
    except subprocess.TimeoutExpired:
        return f"no answer in {TRIAL_SECONDS} s"
    if run.returncode == 0 and '"ok": true' in run.stdout:
        return ""
    lines = [line for line in run.stderr.strip().splitlines() if line.strip()]
    # a shared library that is missing stands above the error that it led to
    lines = [line for line in lines if "cannot open shared object file" in line][:1] or lines
    how = f"killed by signal {-run.returncode}" if run.returncode < 0 else f"exit status {run.returncode}"
    return f"{how}: {lines[-1].strip()[:200]}" if lines else how


@lru_cache(maxsize=1)
def kernel_home() -> str:
    """Where Dr.Jit keeps its compiled kernels, in `.drjit`: HOME, or a folder of the cache, or one for this process.

    Dr.Jit ends the process where it cannot make that folder.

    Raises InputError: no folder at all can be written.
    """
    home = os.environ.get("HOME", "")
    if os.name == "nt":  # there it is another, which is always made
        return home
    for folder in (Path(home), cache.cache_folder()):
        with suppress(OSError):
            if folder.is_absolute():
                (folder / ".drjit").mkdir(parents=str(folder) != home, exist_ok=True)
                if os.access(folder / ".drjit", os.W_OK | os.X_OK):
                    return str(folder)
    try:
        own = tempfile.mkdtemp(prefix="btfsep-")
    except OSError:
        raise InputError(
            "the renderer cannot start",
            "neither the home nor the cache nor a temporary folder can be written",
            f"set HOME or {cache.ENVIRONMENT} to a folder that can be written",
        ) from None
    atexit.register(shutil.rmtree, own, ignore_errors=True)
    return own


def has_cuda_driver() -> bool:
    """True where an NVIDIA driver's library or device is present; on Windows the toolkit, CUDA_PATH, is not needed."""
    system = Path(os.environ.get("SystemRoot", "C:/Windows")) / "System32"
    signs = {"win32": [system / "nvcuda.dll"], "linux": ["/dev/nvidiactl", "/usr/lib/wsl/lib/libcuda.so.1"]}
    return any(os.path.exists(sign) for sign in signs.get(sys.platform, ()))


def _fingerprint() -> str:
    """Changes whenever the choice may: Mitsuba, the libraries, their files, the CUDA driver."""
    files = [(path, os.stat(path).st_size if os.path.exists(path) else -1) for path in candidates()]
    # by their files: the versions' names take longer to look up than the rest of the choice
    specs = [importlib.util.find_spec(name) for name in ("mitsuba", "drjit")]
    engines = [(spec.origin, os.stat(spec.origin).st_mtime_ns) for spec in specs if spec and spec.origin]
    return json.dumps([engines, files, has_cuda_driver(), os.environ.get("BTFSEP_VARIANT"), sys.executable])


@lru_cache(maxsize=1)
def choose_backend() -> Backend:
    """The newest libLLVM that renders; where there is none, or BTFSEP_VARIANT asks for it, CUDA.

    A processor of many cores is as fast (``docs/results/speed.md``), and does not share its memory with what else
    renders: where a graphics card's is full, Dr.Jit ends the process.

    Raises InputError when nothing on this machine can render; it names what was tried and how to mend it.
    """
    fingerprint = _fingerprint()
    names = [field.name for field in fields(Backend)]
    kept = cache.read(remembered(), dict.fromkeys(["fingerprint", *names], cache.TEXT))
    if kept is not None and str(kept["fingerprint"]) == fingerprint:
        return Backend(**{name: str(kept[name]) for name in names})
    backend = _try_all()
    with suppress(InputError):  # a cache that cannot be written only costs the trial next time
        cache.write(remembered(), {"fingerprint": fingerprint, **asdict(backend)})
    return backend


def remembered() -> Path:
    """The cache entry that holds the choice."""
    return cache.cache_folder() / "backend" / "choice.entry"


def _try_all() -> Backend:
    wanted = os.environ.get("BTFSEP_VARIANT", "")
    if wanted not in ("", LLVM_VARIANT, CUDA_VARIANT):
        raise InputError("BTFSEP_VARIANT", wanted, f"set it to {LLVM_VARIANT} or {CUDA_VARIANT}, or unset it")
    failures = []
    if wanted in ("", LLVM_VARIANT):
        for library in candidates():
            failure = try_backend(LLVM_VARIANT, library)
            if not failure:
                return Backend(LLVM_VARIANT, library, ".".join(map(str, llvm_version(library))))
            failures.append(f"{library} ({failure})")
    if wanted == CUDA_VARIANT or (not wanted and has_cuda_driver()):
        failure = try_backend(CUDA_VARIANT)
        if not failure:
            return Backend(CUDA_VARIANT, "", "")
        failures.append(f"{CUDA_VARIANT} ({failure})")
    missing = next((word.rstrip(":") for f in failures for word in f.split() if "libatomic" in word), None)
    if missing:
        remedy = "install it (Debian, Ubuntu: apt-get install libatomic1)"
        raise InputError("the renderer cannot start", f"{missing} is missing", remedy)
    alone = "DRJIT_LIBLLVM_PATH names the only one that is tried: unset it, or " if failures and named_library() else ""
    raise InputError(
        "the renderer cannot start",
        "no libLLVM was found on this machine" if not failures else "tried " + ", ".join(failures),
        f"{alone}install one that works ({INSTALL.get(sys.platform, INSTALL['linux'])}) "
        "or set DRJIT_LIBLLVM_PATH to its file",
    )


@lru_cache(maxsize=1)
def import_mitsuba():
    """The mitsuba module with its variant set; the first call chooses the backend. Raises InputError as above."""
    backend = choose_backend()
    if backend.library:
        os.environ["DRJIT_LIBLLVM_PATH"] = backend.library
    home = os.environ.get("HOME")
    os.environ["HOME"] = kernel_home()  # read once, when Dr.Jit begins
    try:
        with loading(), _syntax_later():
            import mitsuba

            mitsuba.set_variant(backend.variant)
    finally:
        if home is None:
            del os.environ["HOME"]
        else:
            os.environ["HOME"] = home
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba


@contextmanager
def _syntax_later():
    """A context in which ``@drjit.syntax`` rewrites a function when that is first called.

    Mitsuba's differentiable integrators have ten, which an estimate never calls: a quarter of what loading it takes.
    """
    import drjit

    at_once = drjit.syntax

    def later(function=None, **how):
        if function is None:
            return lambda function: later(function, **how)
        rewritten = lru_cache(maxsize=1)(lambda: at_once(function, **how))
        return wraps(function)(lambda *given, **named: rewritten()(*given, **named))

    drjit.syntax = later
    try:
        yield
    finally:
        drjit.syntax = at_once


def limit_threads(count: int) -> None:
    """This process uses at most ``count`` threads, in Dr.Jit and in the linear algebra: several share the machine."""
    import_mitsuba()
    import drjit

    at_most(count)
    drjit.set_thread_count(count)
