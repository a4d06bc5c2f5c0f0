# SPDX-License-Identifier: GPL-3.0-or-later
"""What recognition sees of photographs by Cycles, kept beside each of them: for learning what it is worth, and judging.

The cues of a photograph's candidates (`pipeline.recognition.candidate_cues`) are those of an estimate with the same
preset, and know nothing of what is made of them. Each photograph is asked twice: with all materials of the library, and
without its own, as if the library had never had it (its dictionaries and the kernel of its classifier have seen it).
"""

import inspect
import json
import zlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from btfsep_engine.conventions import grey
from btfsep_engine.imaging.srgb import linear_to_srgb, srgb_to_linear
from btfsep_engine.job.load import load_job
from btfsep_engine.pipeline import recognition
from btfsep_engine.pipeline.black_and_white import without_colours
from btfsep_engine.pipeline.verification import PLAIN, Verification
from btfsep_engine.recognise.finest import judged_as
from btfsep_engine.recognise.judgement import TABLE
from btfsep_engine.recognise.model_file import source_digest
from btfsep_engine.storage.atomic import write_text
from btfsep_engine.storage.cache import digest
from scripts.studies.estimates import scene_of
from scripts.studies.photos import Photograph

SINGLE = ("small", "noisy", "jpeg", "blurred", "grey", "scaled")  # flaws
FLAWS = ("clean", *SINGLE, "all three")  # noisy, jpeg and blurred
BLUR, NOISE, QUALITY = (0.6, 1.6), (0.05, 0.2), (30, 80)  # pixels; of the region's mean; of JPEG
SCALE = (0.4, 0.9)  # of its pixels a photo had along an edge, before it was enlarged


class Remembering(Verification):
    """A verification that renders each material once for a photograph, however often it is asked."""

    def __init__(self, *scene_and_more):
        super().__init__(*scene_and_more)
        self.known: dict = {}

    def explained(self, materials, radiance, beside=None):
        keys = [("explained", m.name, getattr(m, "surface", None)) for m in materials]  # of one name are several plain
        new = [i for i, key in enumerate(keys) if key not in self.known]
        found = super().explained([materials[i] for i in new], radiance, beside)
        self.known.update(zip((keys[i] for i in new), found, strict=True))
        return [self.known[key] for key in keys]

    def similarity(self, material, *about):
        key = "similarity", material.name, getattr(material, "surface", None)
        if key not in self.known:
            self.known[key] = super().similarity(material, *about)
        return self.known[key]


class View:
    """All photographs of one object with one flaw: its geometry is traced and trained on once."""

    def __init__(self, photograph: Photograph, library, settings, flaw: str = "clean"):
        self.library, self.scene = library, scene_of(photograph.folder, uv="xatlas")
        if flaw == "small":
            camera = self.scene.job.camera
            self.scene = self.scene.at_most(-(-max(camera.width, camera.height) // 2))
        elif flaw == "grey":
            self.library, self.scene = library.without_colours(), without_colours(self.scene)
        self.region = recognition.training_region(self.scene.regions[0], settings.training_pixels)
        self.window = recognition.bounding_window(self.region)
        self.recogniser = recognition.trained_recogniser(self.scene, 0, self.library, settings)
        self.verification = Remembering(self.scene, 0, self.region, self.window, settings)
        self.object = photograph.object

    def cues(self, radiance, *, without: str | None = None) -> dict:
        """{"names": candidates, "cues": {cue: values}} of a photograph (h, w, 3), NaN where a pixel is unusable."""
        recogniser = self.recogniser if without is None else self.recogniser.without(without)
        seen = radiance[self.window]
        vectors = recogniser.describe(seen, self.region[self.window])
        names, cues = recognition.candidate_cues(seen, vectors, recogniser, self.library, self.verification)
        return {"names": names, "cues": {cue: np.round(values, 4).tolist() for cue, values in cues.items()}}


@dataclass(frozen=True)
class Seen:
    """A photograph's cues with all materials, and without its own (None: the library never had it).

    ``model`` : which of `judgement.judgements` it is judged by
    """

    photograph: Photograph
    known: dict
    left_out: dict | None
    model: str = "verified"

    def of_candidates(self, *, left_out: bool = False, plain: bool = True) -> tuple[tuple[str, ...], dict]:
        """The names of the candidates, and their cues; ``plain`` : with those of `verification.PLAIN`."""
        found = self.left_out if left_out else self.known
        some = [i for i, name in enumerate(found["names"]) if plain or name not in PLAIN]
        cues = {cue: np.asarray(values)[some] for cue, values in found["cues"].items()}
        return tuple(found["names"][i] for i in some), cues


def flawed(radiance, region, flaw: str, random) -> np.ndarray:
    """A photograph as a worse camera would have kept it; NaN where it is saturated."""
    radiance = np.asarray(radiance, np.float32)
    if flaw == "grey":
        return grey(radiance)
    if flaw == "small":  # as of `PreparedScene.at_most`
        h, w = (n // 2 for n in radiance.shape[:2])
        return radiance[: 2 * h, : 2 * w].reshape(h, 2, w, 2, 3).mean((1, 3))
    image, every = np.nan_to_num(radiance), flaw == "all three"
    if flaw == "scaled":
        h, w = radiance.shape[:2]
        before = tuple(round(random.uniform(*SCALE) * n) for n in (w, h))
        reduced = cv2.resize(image, before, interpolation=cv2.INTER_AREA)
        return np.maximum(cv2.resize(reduced, (w, h), interpolation=cv2.INTER_CUBIC), 0)
    if flaw == "blurred" or every:
        image = cv2.GaussianBlur(image, (0, 0), random.uniform(*BLUR))
    if flaw == "noisy" or every:
        shot = np.sqrt(np.maximum(image, 0) * image[region].mean())
        image = image + random.uniform(*NOISE) * shot * random.standard_normal(image.shape).astype(np.float32)
    if flaw == "jpeg" or every:
        white = np.percentile(image[region], 99) / 0.9
        coded = (linear_to_srgb(np.clip(image / white, 0, 1)) * 255).round().astype(np.uint8)
        how = [cv2.IMWRITE_JPEG_QUALITY, int(random.integers(*QUALITY))]
        coded = cv2.imdecode(cv2.imencode(".jpg", coded, how)[1], cv2.IMREAD_COLOR)
        image = np.where((coded == 255).any(-1, keepdims=True), np.nan, white * srgb_to_linear(coded / 255))
        image = image.astype(np.float32)
    return image


def cues_of(
    photographs: list[Photograph], library, settings, *, flaw: str = "clean", every: bool = False
) -> list[Seen]:
    """The cues of photographs, those of an object together; what is kept beside them already is not made again.

    ``every`` : candidates are rendered, not the likeliest alone
    """
    code = Path(inspect.getfile(Verification)).read_bytes()  # no training depends on it, and so no digest
    weights = b"" if every else TABLE.read_bytes()  # they say which candidates are worth a rendering
    key, out, view = digest(source_digest(), code, library.digest, settings, every, weights), [], None
    for photograph in photographs:
        path = photograph.folder / f"cues-{flaw.replace(' ', '-')}.json"
        kept = json.loads(path.read_text()) if path.exists() else {}
        if kept.get("key") != key:
            if view is None or view.object != photograph.object:
                view = View(photograph, library, settings, flaw)
                view.verification.every = every
            photo = load_job(photograph.folder).photo
            radiance = np.where(photo.usable[..., None], photo.radiance, np.nan)
            if flaw != "clean":
                random = np.random.default_rng(zlib.crc32(f"{photograph.folder.name} {flaw}".encode()))
                radiance = flawed(radiance, view.region, flaw, random)
            view.verification.known.clear()
            has = photograph.material in view.recogniser.materials
            known = view.cues(radiance)  # first, so that lights are looked for from where an estimate does
            left_out = view.cues(radiance, without=photograph.material) if has else None
            kept = {"key": key, "known": known, "left_out": left_out}
            kept["model"] = judged_as(radiance[view.window], view.region[view.window])
            write_text(path, json.dumps(kept))
        out.append(Seen(photograph, kept["known"], kept["left_out"], kept["model"]))
    return out


def seen_in(shots) -> list[Photograph]:
    """The photographs of ``shots`` (photos.Shot) that have been taken."""
    made = [Path(shot.folder) for shot in shots]
    return [Photograph(f, *f.name.split("_")) for f in made if (f / "job.json").exists()]
