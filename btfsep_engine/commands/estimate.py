# SPDX-License-Identifier: GPL-3.0-or-later
"""`btfsep estimate`: a job's light, written as soon as it is known, then what speaks against it, report and record."""

import time
from pathlib import Path

from btfsep_engine.commands import report
from btfsep_engine.commands.record import result_record
from btfsep_engine.commands.resume import estimate_key
from btfsep_engine.imaging.images import fill_exr
from btfsep_engine.job.load import load_job
from btfsep_engine.light.files import write_lighting
from btfsep_engine.pipeline.estimation import Estimate, found_light, say_doubts
from btfsep_engine.pipeline.mending import mended
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.storage.atomic import check_folder, digest, remove, replacing, write_json


def write_light(out: Path, answer: Estimate, *, earlier) -> list[Path]:
    """Writes ``lighting.json`` and ``lighting.exr`` into ``out``; returns their paths.

    ``earlier`` : files of a run before, which would belong to another light; they go first. On a disk that is full the
    two stay those of that run, both.
    """
    paths = [out / "lighting.json", out / "lighting.exr"]
    with answer.scene.reporter.stage("writing"), replacing(paths[1]) as scratch:
        fill_exr(scratch, answer.map, compressed=False)  # a tenth larger, and written in a tenth of the time
        remove(*earlier)
        write_lighting(paths[0], answer.lighting)
    return paths


def run_estimate(
    folder, library, settings: Settings, *, material=None, out=None, with_report=True, others=(), reporter
) -> dict:
    """The whole command: reads the job, estimates, writes the results.

    The light is written as soon as it is known, then what says more of it; ``result.json`` last: where it is, all is.

    Parameters
    ----------
    folder : job folder
    library : btf.library.Library
    material : a name for all objects, instead of recognition
    out : folder for the results, default ``folder/result``
    others : folders of further jobs, photographs under the same light

    Returns
    -------
    dict, the content of ``result.json`` and ``out``, ``lighting``: paths
    """
    started = time.perf_counter()
    with reporter.stage("reading"):
        jobs = [load_job(each, colorspace=settings.colorspace, suns=settings.sun) for each in (folder, *others)]
        for note in (note for job in jobs for note in job.warnings):
            reporter.warn(note)
    out = Path(out) if out is not None else jobs[0].folder / "result"
    check_folder(out)
    scene, *further = (mended(PreparedScene(job, reporter), settings) for job in jobs)
    answer = found_light(scene, library, settings, material=material, others=further)
    record, picture = out / "result.json", out / "report.png"
    written = write_light(out, answer, earlier=[record, picture])
    lighting, files = str(written[0]), {path.name: digest(path) for path in written}
    # at once: should another run write here meanwhile, the record is not to vouch for what that wrote
    reporter.light(lighting)
    say_doubts(answer)
    if with_report:
        with reporter.stage("report"):
            report.write_estimate_report(picture, answer)
        files[picture.name] = digest(picture)
    with reporter.stage("record"):
        key = estimate_key([job.digest for job in jobs], library, settings, material)
        result = result_record(answer) | {"key": key, "files": files}
        result["seconds"]["total"] = round(time.perf_counter() - started, 4)
        write_json(record, result)
    return {**result, "out": str(out), "lighting": lighting}
