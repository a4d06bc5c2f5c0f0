# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a job is done already: what its results themselves say, whoever made them.

``result.json`` comes last of a result set. It holds the digests of the other files (``files``) and the `estimate_key`
of what they were made from (``key``). A job is done when these agree with the files beside it and the job as it is now.
"""

import json
from pathlib import Path

from btfsep_engine import __version__
from btfsep_engine.errors import InputError
from btfsep_engine.job.load import job_digest
from btfsep_engine.storage import atomic, cache

MOST_BYTES = 64 << 20  # of a result.json


def estimate_key(job_digests, library, settings, material: str | None) -> str:
    """Changes when an estimate would: with any file of its jobs, the settings, the materials, the engine's version."""
    return cache.digest("estimate", __version__, list(job_digests), library.digest, settings, material)


def finished_result(job, out, library, settings, *, material=None, with_report=True) -> dict | None:
    """The content of ``out/result.json`` where all of that result set is whole and of this job as it is now.

    None where anything of it is missing, damaged, or of another job, other settings or another version.
    """
    try:
        record = _read(Path(out) / "result.json")
        files = record["files"]
        wanted = {"lighting.json", "lighting.exr", *(["report.png"] if with_report else [])}
        if not wanted <= files.keys() or any(name != Path(name).name for name in files):
            return None
        if record["key"] != estimate_key([job_digest(job)], library, settings, material):
            return None
        whole = all(atomic.digest(Path(out) / name) == content for name, content in files.items())
        return record if whole else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, InputError):
        return None


def _read(path: Path) -> dict:
    """What is in a result.json; any error of the above where it is none."""
    if path.stat().st_size > MOST_BYTES or not path.is_file():  # a pipe would be waited for
        raise ValueError("no result")
    return json.loads(path.read_bytes())
