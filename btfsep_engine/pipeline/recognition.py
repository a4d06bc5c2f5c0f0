# SPDX-License-Identifier: GPL-3.0-or-later
"""Training on renders of the job's own geometry, and recognising its objects."""

from dataclasses import replace

import numpy as np

from btfsep_engine.btf.surfaces import SURFACES
from btfsep_engine.conventions import grey
from btfsep_engine.light.maps import training_lights
from btfsep_engine.pipeline.like_pixels import is_textured
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import RecognitionSettings
from btfsep_engine.pipeline.verification import CELLS, PLAIN, Verification
from btfsep_engine.recognise.finest import judged_as
from btfsep_engine.recognise.judgement import judgements
from btfsep_engine.recognise.model_file import cached, known_materials
from btfsep_engine.recognise.recogniser import Recogniser, Recognition
from btfsep_engine.recognise.training import METHODS, render_samples, train
from btfsep_engine.recognise.vlad import WORDS
from btfsep_engine.storage import kept
from btfsep_engine.storage.cache import digest
from btfsep_engine.threads import one_thread

WINDOW = 64  # edge in pixels of the windows that a large object is cut down to
KEPT = 0.5  # of all that a process may keep: so much at most are pictures that a training leaves
# One photo of unknown exposure cannot tell two greys apart: white stands for all neutral matte materials. Surfaces by
# numbers have no texture to be trained on: they are candidates of `verification`.
INDISTINGUISHABLE = {"reference/grey18", *SURFACES}

METAL = "surface/metal"


def training_region(region, limit: int) -> np.ndarray:
    """The part of an object that recognition looks at: all of it, or windows spread over it.

    Parameters
    ----------
    region : (h, w) bool
    limit : about the largest number of pixels

    Returns
    -------
    (h, w) bool
    """
    total = int(region.sum())
    if total <= limit:
        return region
    h, w = region.shape
    tiles = {}
    for top in range(0, h, WINDOW):
        for left in range(0, w, WINDOW):
            count = int(region[top : top + WINDOW, left : left + WINDOW].sum())
            if count > WINDOW * WINDOW // 4:
                tiles[top, left] = count
    if not tiles:  # a thin object: no tile is filled enough
        return region
    places, chosen, taken = list(tiles), np.zeros_like(region), 0
    # a stride that has no common factor with the number of tiles visits all of them, far apart
    stride = max(1, int(len(places) * 0.618))
    while np.gcd(stride, len(places)) != 1:
        stride += 1
    for i in range(len(places)):
        top, left = places[(i * stride) % len(places)]
        chosen[top : top + WINDOW, left : left + WINDOW] = region[top : top + WINDOW, left : left + WINDOW]
        taken += tiles[top, left]
        if taken >= limit:
            break
    return chosen


def bounding_window(region) -> tuple[slice, slice]:
    """Rows and columns that hold all of ``region`` (h, w) bool."""
    rows, columns = np.flatnonzero(region.any(1)), np.flatnonzero(region.any(0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def training_view(scene: PreparedScene, index: int, region, lights, settings: RecognitionSettings) -> str:
    """All that a training depends on beside the library and the engine's own code: geometry, camera, lights, method."""
    job = scene.job
    seen = job.objects[index]
    return digest(
        [region, scene.view.face[region], scene.view.barycentric[region]],
        [seen.uv, seen.mesh.corner_uv if seen.uv == "mesh" else None, seen.mesh.corner_normals],
        [[m.vertices, m.faces] for m in (seen.mesh, *scene.tracer.meshes)],
        job.camera,
        job.metres_per_unit,
        [lights.names, lights.maps],
        METHODS[settings.recogniser],
        WORDS.read_bytes(),
        [settings.classifier, settings.training_directions, settings.seed],
        *([] if scene.has_colours else ["without colours"]),
    )


def trained_recogniser(scene: PreparedScene, index: int, library, settings: RecognitionSettings) -> Recogniser:
    """The recogniser for one object of the job: from the cache, or trained now.

    Its training images are the job's own geometry, seen by the job's camera, in every material of the library
    under natural light (the paper, section 3.2). Of those that another training of the same view knew, none is made.
    """
    reporter = scene.reporter
    region = training_region(scene.regions[index], settings.training_pixels)
    window = bounding_window(region)
    lights = training_lights(settings.training_turns)
    view, method = training_view(scene, index, region, lights, settings), METHODS[settings.recogniser]
    contents = {name: library.content(name) for name in library.names() if name not in INDISTINGUISHABLE}
    of_images = [light.partition("@")[0] for light in lights.names]

    def make() -> Recogniser:
        known = known_materials(view, contents) if method.ready else {}
        known = {name: (of_images, vectors) for name, vectors in known.items() if len(vectors) == lights.count}
        names = [n for n in contents if n not in known]
        with reporter.stage("training rays"):
            points = scene.points(index, region=region, textured=True)
            transport = scene.transport(points, directions=settings.training_directions)

        # under cells of light is what `Verification` asks for next: kept, of as many as leave room for all else
        each = CELLS.count * 3 * np.float32().nbytes * len(points)
        most = KEPT * kept.STORE.most_bytes / each if settings.verify else 0

        def render(material):
            images = np.full((lights.count, *region[window].shape, 3), np.nan, np.float32)
            more = (CELLS,) if material.mirror_reflectance is None and names.index(material.name) < most else ()
            seen, *_ = transport.radiances(material, lights, *more)
            seen = seen if scene.has_colours else grey(seen)
            images[:, region[window]] = seen.transpose(1, 0, 2)
            return images

        return train(
            render_samples((library.load(n) for n in names), list(lights.names), render, region[window]),
            classifier=settings.classifier,
            seed=settings.seed,
            reporter=reporter,
            method=method,
            expected=len(names) * len(lights.names),
            known=known,
            contents=contents,
        )

    with reporter.stage("training"):
        return cached(digest(view, library.digest), make, view=view)


def recognise_object(scene: PreparedScene, index: int, library, settings: RecognitionSettings) -> Recognition:
    """What an object of the job is made of."""
    recogniser = trained_recogniser(scene, index, library, settings)
    name = scene.job.objects[index].name
    region = training_region(scene.regions[index], settings.training_pixels)
    window = bounding_window(region)
    with scene.reporter.stage("recognition"), one_thread():  # many small products
        verification = Verification(scene, index, region, window, settings) if settings.verify else None
        answer = recognised(scene.job.photo, region, window, recogniser, library, verification, name=name)
        if METAL in (answer.material, answer.stand_in, *(answer.likely or ())):
            answer = without_metal(answer) if is_textured(scene, index, seed=settings.seed) else answer
    if answer.unknown and answer.stand_in:
        scene.reporter.warn(
            f"object '{name}' looks like none of the library's materials (the nearest is {answer.material}): it is "
            f"taken to be of one kind all over, {answer.stand_in}; give its material, or its 'surface', if you know it"
        )
    elif answer.unknown:
        scene.reporter.warn(
            f"object '{name}' looks like none of the library's materials; "
            f"the nearest, {answer.material}, is used (give --material to choose another)"
        )
    elif len(answer.likely or ()) > 1:
        scene.reporter.warn(
            f"object '{name}' may be {several(answer.likely)}: the photo does not rule them out "
            "(give --material, if you know it)"
        )
    return answer


def without_metal(answer: Recognition) -> Recognition:
    """The answer for an object with a texture, which none of it is a metal alike all over; the candidates stay.

    What stands for none of the library's is alike all over, and of coloured things of wood or stone a metal often looks
    the most like: it is dark, and has coloured highlights. On eight photographs of such the light erred 0.29 to 0.62.
    """
    others = [name for name, _ in answer.candidates if name != METAL]
    stand_in = next(name for name in others if name in PLAIN) if answer.stand_in == METAL else answer.stand_in
    likely = answer.likely and tuple(name for name in answer.likely if name != METAL)
    material = next(iter(likely or others)) if answer.material == METAL else answer.material
    return replace(answer, material=material, stand_in=stand_in, likely=likely)


def several(names) -> str:
    """Names for people, "a or b": of many the first three, and how many others."""
    named = " or ".join(names[:3])
    more = len(names) - 3
    return named if more < 1 else f"{named}, or one {'more' if more == 1 else f'of {more} others'}"


def recognised(photo, region, window, recogniser: Recogniser, library, verification, *, name: str) -> Recognition:
    """The answer for one photograph (job.model.Photo); ``verification`` : Verification, or None for the classifier's.

    ``region`` and ``window`` as in Verification; ``name`` : of the object, for errors.
    """
    radiance = np.where(photo.usable[..., None], photo.radiance, np.nan)[window]
    vectors = recogniser.describe(radiance, region[window], what=f"object '{name}'")
    calibrated = recogniser.settings != METHODS["paper"].settings and recogniser.model.kind == "svm"
    if not verification and not calibrated:
        return recogniser.judged(vectors)
    names, cues = candidate_cues(radiance, vectors, recogniser, library, verification)
    model = judged_as(radiance, region[window]) if verification else "votes"
    answer = judgements()[model].answer(names, cues, plain=PLAIN)
    if calibrated:
        return answer
    first = recogniser.judged(vectors)  # the order counts, but the sets are those of another classifier
    doubt = {"likely": None, "unknown": first.unknown, "unknown_score": first.unknown_score}
    return replace(answer, **doubt, stand_in=answer.stand_in if first.unknown else None)


def candidate_cues(radiance, vectors, recogniser: Recogniser, library, verification) -> tuple[tuple[str, ...], dict]:
    """The candidates, the classifier's likeliest first, and {cue: (candidates,) float} of `recognise.judgement`.

    With a ``verification`` `verification.PLAIN` follow them.

    ``radiance`` : (h, w, 3), the window of the photograph, NaN where unusable; ``vectors`` : what it is described as
    """
    names, scores = zip(*recogniser.judged(vectors).candidates, strict=True)
    # a root, because a classifier that is wrong is wrong by far: its training lights did not have this photo's
    cues = {"classifier": -np.sqrt(-np.log(np.clip(scores, 1e-12, 1)))}
    if not verification:
        return names, cues
    return (*names, *PLAIN), verification.cues(names, cues, radiance, library.load)
