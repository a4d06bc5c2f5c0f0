# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of every picture of a sequence: what is seen stands still, or moves as poses say; the light changes.

The first frame goes the way of an estimate; a further one is solved under the model that was chosen there
(`pipeline.following`), on what the process keeps. What is known of each stands beside it, and lights may be smoothed
over time (`fit.over_time`).
"""

import re
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from btfsep_engine.commands.record import determined_words, run_record
from btfsep_engine.conventions import pixel_directions
from btfsep_engine.errors import InputError
from btfsep_engine.fit.over_time import Frame, smoothed, windows
from btfsep_engine.fit.stated import expected_error, shown_error
from btfsep_engine.imaging.images import SUFFIXES
from btfsep_engine.job.load import load_job
from btfsep_engine.job.model import Job, Photo
from btfsep_engine.job.photograph import read_photo
from btfsep_engine.job.poses import posed_jobs
from btfsep_engine.light.files import MAP_SIZE, write_lighting, write_lighting_exr
from btfsep_engine.pipeline.checks import all_doubts
from btfsep_engine.pipeline.estimation import Estimate, found_light
from btfsep_engine.pipeline.following import CHOSEN, FollowedEstimate, Follower
from btfsep_engine.pipeline.light_account import lamp_record
from btfsep_engine.pipeline.mending import mended
from btfsep_engine.pipeline.mirrors import softened, with_mirrors
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.pipeline.standing import on_ground, with_ground
from btfsep_engine.progress import Reporter
from btfsep_engine.storage.atomic import check_folder, remove, write_json

_DIGITS = re.compile(r"([0-9]+)")


def frame_files(pattern) -> list[Path]:
    """The files of a pattern like ``frames/*.exr`` (or a folder), in the order of their names and numbers.

    Raises
    ------
    InputError
        When there are none, or two of them have one stem, which would be one result.
    """
    path = Path(pattern)
    folder, name = (path, "*") if path.is_dir() else (path.parent, path.name)
    found = [p for p in folder.glob(name) if p.is_file() and p.suffix.lower() in SUFFIXES] if folder.is_dir() else []
    if not found:
        raise InputError(f"--images '{pattern}'", "no image matches", "give a pattern in quotes, like 'frames/*.exr'")
    found.sort(key=lambda p: [int(x) if i % 2 else x for i, x in enumerate(_DIGITS.split(p.name))])
    stems = [p.stem for p in found]
    for i, stem in enumerate(stems):
        if stem in stems[:i]:
            raise InputError(f"--images '{pattern}'", f"two frames are named '{stem}'", "match one kind of file only")
    return found


def missing_frames(files) -> str:
    """In words, which numbers are left out between those of the files (the last in each name) at their usual step."""
    names = [_DIGITS.split(file.stem) for file in files]
    if len(names) < 3 or {(*name[:-2], name[-1]) for name in names} != {(*names[0][:-2], names[0][-1])}:
        return ""
    numbers = sorted({int(name[-2]) for name in names})  # 7 and 07 are one
    steps = list(pairwise(numbers)) or [(0, 0)]
    often = Counter(b - a for a, b in steps)
    usual = min(often, key=lambda step: (-often[step], step))
    gaps = [range(a + usual, b, usual) for a, b in steps if b - a > usual]
    count = sum(map(len, gaps))
    if not count or 2 * often[usual] < len(steps):
        return ""
    more = f" and {count - 1} more" * (count > 1)
    return f"there is no photo of frame {gaps[0][0]}{more} between {numbers[0]} and {numbers[-1]}; they get no light"


@dataclass
class FrameReporter(Reporter):
    """What is said of one frame: warnings are its own, times are the run's, and the first one's stages are progress."""

    run: Reporter = field(default_factory=Reporter)
    is_first: bool = False

    def progress(self, stage: str, fraction: float, message: str = "") -> None:
        if self.is_first:
            self.run.progress(stage, fraction, message)


class Frames:
    """The photos of a sequence, solved in their order.

    Parameters
    ----------
    job : without a photo; library, settings, reporter : of the run
    material : a name for all objects; else the job's, else as recognised in the first frame
    poses : stem of a file -> JobSchema, of those in which something is elsewhere than the job says
    """

    def __init__(self, job: Job, library, settings: Settings, *, material, poses, reporter):
        self._asked = settings
        if settings.evidence == "auto":  # of frames that stand still, a ground would take most of the time
            settings = replace(settings, evidence="job")
        self._still, self._library, self._settings, self._material = job, library, settings, material
        self._poses, self._reporter = poses, reporter
        self._pose, self._job = None, job  # of the last frame
        self._scene, self._follower, self._stands = None, None, False
        self._said = []  # warnings of the last frame, without those of its file and of the camera
        self.first = None  # its Estimate

    def estimate(self, file: Path) -> tuple[Estimate, dict]:
        """The light of a frame; and its line of ``sequence.json``, without the light's place."""
        reporter = FrameReporter(seconds=self._reporter.seconds, run=self._reporter, is_first=self.first is None)
        with reporter.timed("reading"):
            self._move_to(self._poses.get(file.stem))
            how = {"colorspace": self._job.image_colorspace, "primaries": self._job.image_primaries}
            photo = read_photo(file, self._job.camera, **how, notes=reporter.warnings)
        begun = time.perf_counter()
        try:
            self._look(photo, reporter)
            said = len(reporter.warnings)
            found = self._light(photo, reporter)
            estimate = found.estimate
            residual, lighting = estimate.fit.residual, estimate.lighting
            with reporter.timed("checks"):
                for doubt in self._said if found.as_before else all_doubts(estimate):
                    reporter.warn(doubt)
            self._said = reporter.warnings[said:]
        except InputError as error:
            self._forget()
            raise InputError(f"{file.name}: {error.what}", error.got, error.do) from error
        seconds = time.perf_counter() - begun
        fit = estimate.fit
        return estimate, {
            "image": file.name,
            "residual": residual,
            "determined": determined_words(lighting.determined, fit.all_determined),
            "expected_error": expected_error(fit.coefficients, fit.samples),
            "expected_error_shown": shown_error(fit),
            "lamps": [lamp_record(lamp) for lamp in fit.lamps],
            "saturated_pixels": photo.saturated,
            "by": found.how,
            "choice": estimate.choice if found.how == CHOSEN else None,
            "warnings": list(reporter.warnings),
            "milliseconds": round(1000 * seconds, 2),
        }

    def _forget(self) -> None:
        """Leaves nothing of a photo that cannot be used to the next one: the scene is looked at anew."""
        self._scene = None
        if self._follower is None:
            self.first, self._stands = None, False

    def _move_to(self, pose) -> None:
        """Puts camera and objects where a JobSchema says; None: where the job does."""
        if pose == self._pose:
            return
        self._pose, self._scene, self._job = pose, None, self._still
        if pose is not None:
            told = {"colorspace": self._settings.colorspace, "suns": self._settings.sun}
            self._job = load_job(self._still.folder, with_photo=False, schema=pose, **told)

    def _look(self, photo: Photo, reporter: Reporter) -> None:
        """Looks at the scene, where it is not the last frame's; its camera goes where this photo has it."""
        if self._scene is None:
            scene = mended(PreparedScene(replace(self._job, photo=photo), reporter), self._settings)
            if self.first is None:
                self._scene = on_ground(scene, self._asked)
                self._stands = self._scene is not scene
            else:  # what the objects stand on in the first frame, they do in all
                scene = with_ground(scene) if self._stands else scene
                self._scene, _ = softened(scene, self.first.materials, self._settings)

    def _light(self, photo: Photo, reporter: Reporter) -> FollowedEstimate:
        """The Estimate of a photo, and what of it was found for it alone (`following.FollowedEstimate`)."""
        if self._follower is None:
            self.first = found_light(self._scene, self._library, self._settings, material=self._material)
            self._scene = with_mirrors(self._scene, self.first.scene.mirrors)
            self._follower = Follower(self.first, self._library)
            return FollowedEstimate(self.first, CHOSEN)
        return self._follower.estimate(self._follower.scene_of(self._scene, photo, reporter))


class Results:
    """What is left of a sequence in a folder, frame by frame, and what is said of it.

    Parameters
    ----------
    out : the folder; with_exr : whether lights are written as maps, too; count : of all photos; reporter : of the run

    Attributes
    ----------
    lines, failed : of ``sequence.json``
    """

    def __init__(self, out: Path, *, with_exr: bool, count: int, reporter):
        self.out, self.with_exr, self._count, self._reporter = out, with_exr, count, reporter
        self.lines, self.failed, self._said = [], [], set()

    def solved(self, files, solver: Frames):
        """(line, Frame) of each file that gets a light. Raises InputError where none does."""
        for file in files:
            try:
                estimate, line = solver.estimate(file)
            except InputError as error:
                self._lost(file, error)
                continue
            for warning in line["warnings"]:
                self._say(warning, file)
            sky = np.float32(estimate.radiance(pixel_directions(*MAP_SIZE))) if self.with_exr else None
            yield line, Frame(estimate.lighting, sky)

    def _say(self, sentence: str, file: Path) -> None:
        kind = _DIGITS.sub("", sentence)  # of a hundred frames each says the same, in other numbers
        if kind not in self._said:
            self._said.add(kind)
            self._reporter.warn(f"{file.name}: {sentence.removeprefix(f'{file.name}: ')}")

    def _lost(self, file: Path, error: InputError) -> None:
        self.failed.append({"image": file.name, "message": str(error)})
        if len(self.failed) == self._count:
            raise error
        self._begin()
        remove(self.out / f"{file.stem}.json", *([self.out / f"{file.stem}.exr"] if self.with_exr else []))
        self._say(f"{error}; it gets no light", file)

    def _begin(self) -> None:
        """Takes away the record of a run before: it would speak of other lights, should this one end early."""
        remove(self.out / "sequence.json")

    def write(self, line: dict, frame: Frame, smoothed_over: int) -> None:
        """Writes a light; ``line`` : of ``sequence.json``, as far as it is known."""
        name, stem = line["image"], Path(line["image"]).stem
        with self._reporter.timed("writing"):
            if not self.lines:
                self._begin()
            write_lighting(self.out / f"{stem}.json", frame.lighting)
            if self.with_exr:
                write_lighting_exr(self.out / f"{stem}.exr", frame.lighting, radiance=lambda _: frame.sky)
        self.lines.append({**line, "lighting": f"{stem}.json", "smoothed_over": smoothed_over})
        self._reporter.progress("photos", (len(self.lines) + len(self.failed)) / self._count, name)


def told(folder, files, settings: Settings, *, poses, reporter) -> tuple[Job, dict]:
    """The job without a photo, and the poses of its frames; what speaks against them is said."""
    if missing := missing_frames(files):
        reporter.warn(f"--images: {missing}")
    posed = {} if poses is None else posed_jobs(poses, folder)
    job = load_job(folder, with_photo=False, colorspace=settings.colorspace, suns=settings.sun)
    for note in job.warnings:
        reporter.warn(note)
    for stem in posed.keys() - {file.stem for file in files}:
        reporter.warn(f"{Path(poses).name}: it says a pose of '{stem}', and no frame is called so")
    return job, posed


def run_sequence(
    folder,
    library,
    settings: Settings,
    *,
    frames,
    material=None,
    poses=None,
    smooth: int = 0,
    out=None,
    with_exr=False,
    reporter,
) -> dict:
    """The whole command: writes FRAME.json for each frame (and FRAME.exr), and sequence.json.

    A photo that cannot be read or used gets no light, which is said; the others do.

    Parameters
    ----------
    folder : job folder; its own image need not be there
    frames : pattern of the pictures, taken by the job's camera and coded as its `image_colorspace` says
    material : a name for all objects; else the job's, else as recognised in the first frame
    poses : file that says where camera and objects are in each frame (`job.poses`); None: as in the job
    smooth : over how many frames on each side lights are smoothed
    out : folder for the results, default ``folder/sequence``
    with_exr : whether the lights are written as maps, too

    Returns
    -------
    dict, the content of sequence.json and ``out``

    Raises
    ------
    InputError
        With another estimator than "map", with order "auto", where maps would take the place of the photos, or where no
        photo gets a light.
    """
    started = time.perf_counter()
    if settings.estimator != "map":
        raise InputError("a sequence", f"--estimator {settings.estimator}", "it goes with --estimator map only")
    if settings.order == "auto":
        raise InputError("a sequence", "--order auto", "give one order for all frames")
    with reporter.stage("reading"):
        files = frame_files(frames)
        job, posed = told(folder, files, settings, poses=poses, reporter=reporter)
    out = Path(out) if out is not None else job.folder / "sequence"
    check_folder(out)
    if with_exr and out.resolve() in {file.resolve().parent for file in files if file.suffix.lower() == ".exr"}:
        raise InputError("--out", "a light's FRAME.exr would take the place of the photo", "name another folder")
    solver = Frames(job, library, settings, material=material, poses=posed, reporter=reporter)
    results = Results(out, with_exr=with_exr, count=len(files), reporter=reporter)
    for held, at in windows(results.solved(files, solver), smooth):
        frame, count = smoothed([each for _, each in held], at, smooth)
        results.write(held[at][0], frame, count)
    took = [line["milliseconds"] for line in results.lines]
    result = {
        "format": "btfsep-sequence",
        "version": 1,
        "objects": [{"name": o.name, **m.record} for o, m in zip(job.objects, solver.first.materials, strict=True)],
        "order": settings.order,
        "smooth": smooth,
        "frames": results.lines,
        **({"failed": results.failed} if results.failed else {}),
        "median_milliseconds_per_further_frame": round(float(np.median(took[1:] or took)), 2),
        **run_record(settings, reporter),
    }
    result["seconds"]["total"] = round(time.perf_counter() - started, 4)
    write_json(out / "sequence.json", result)
    return {**result, "out": str(out)}
