# SPDX-License-Identifier: GPL-3.0-or-later
"""What works on this machine."""

import os
import platform

from btfsep_engine import __version__
from btfsep_engine.errors import InputError
from btfsep_engine.render import backend
from btfsep_engine.storage.atomic import check_folder
from btfsep_engine.storage.cache import cache_folder


def examine(library_folder=None) -> dict:
    """Tries the renderer afresh, in a child process, and the material library.

    Gives a dict: ``ok``, ``facts`` (name -> text), and where not ok ``problem`` and ``remedy``.
    """
    facts = {
        "btfsep": __version__,
        "python": f"{platform.python_version()} on {platform.platform()}",
        "processors": str(os.cpu_count()),
        "cache": str(cache_folder()) + _not_kept(),
        "libLLVM": ", ".join(backend.candidates()) or "none found",
        "CUDA driver": "present" if backend.has_cuda_driver() else "none",
    }
    try:
        chosen = backend.choose_backend()
        failure = backend.try_backend(chosen.variant, chosen.library)
        if failure:
            raise InputError("the renderer worked before and fails now", failure, f"remove {backend.remembered()}")
        from btfsep_engine.commands.record import versions

        facts |= {name: str(value) for name, value in versions().items() if name not in ("btfsep", "python")}
        facts["test render"] = f"right, with {chosen.variant} {chosen.library}".strip()
        from btfsep_engine.btf.library import open_library

        opened = open_library(library_folder)
        opened.load(next(iter(opened.entries or opened.names())))
        facts["library"] = f"{len(opened.entries)} materials"
    except InputError as error:
        return {"ok": False, "facts": facts, "problem": f"{error.what} ({error.got})", "remedy": error.do}
    return {"ok": True, "facts": facts}


def _not_kept() -> str:
    """What is to be said of a cache that cannot be written, which no run complains of."""
    try:
        check_folder(cache_folder())
    except InputError as error:
        return f" ({error.got}: each run learns the materials anew; $BTFSEP_CACHE names another folder)"
    return ""
