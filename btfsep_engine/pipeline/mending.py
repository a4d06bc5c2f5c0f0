# SPDX-License-Identifier: GPL-3.0-or-later
"""An estimate's own alignment: where geometry and photo do not go together, and no farther than it can be wrong.

The job's files stay as they are; `btfsep align` makes a job of it.
"""

from btfsep_engine.pipeline.checks import shift_doubt
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import PhotoSettings
from btfsep_engine.threads import one_thread

MOST_PIXELS, MOST_DEGREES = 20.0, 20.0  # of a move, in pixels of a picture of `aligner.SIDE`
OUTLINES = 0.05  # of the objective, that outlines gain by a move of which they had not spoken before: shading alone has
# led away from the true camera on two of 96 plates (0.001 and 0.011), and to it where outlines gain 0.06 and more
MOST_OF_A_DEPTH = 5.0  # of a shift: 4 pixels, and what is found beside them


def doubted(scene: PreparedScene, align: str = "auto") -> bool:
    """Whether the photo's outline lies elsewhere than the geometry's, or both ask for another camera.

    ``align`` : "auto" or "outline", as of the settings: of the latter, only the first
    """
    if shift_doubt(scene) is not None or align == "outline":
        return shift_doubt(scene) is not None
    from btfsep_engine.pipeline.alignment import looks_off

    return looks_off(scene)


def mends(scene: PreparedScene, alignment) -> bool:
    """Whether an estimate takes an `alignment.Alignment` of its scene."""
    from btfsep_engine.pipeline.aligner import OFF, SIDE

    if not alignment.aligned or not doubted(scene):
        return False
    if alignment.shift is not None:
        return alignment.moved_px <= MOST_OF_A_DEPTH
    camera = scene.job.camera
    moved = alignment.moved_px / max(1.0, max(camera.width, camera.height) / SIDE)
    clear = alignment.settled or (moved >= OFF and alignment.gain.outline >= OUTLINES)
    return (clear or shift_doubt(scene) is not None) and moved <= MOST_PIXELS and alignment.degrees <= MOST_DEGREES


@one_thread()  # a search is of many small products, which several threads make slower
def mended(scene: PreparedScene, settings: PhotoSettings) -> PreparedScene:
    """The scene with its camera in line with the photo, and a warning that says so; else the scene itself.

    ``mended_by`` of what is returned is the Alignment, or None.
    """
    if settings.align == "never":
        return scene
    from btfsep_engine.pipeline.alignment import align, first_look, with_camera

    with scene.reporter.stage("alignment"):
        alignment = align(scene) if doubted(scene, settings.align) else None
    if alignment is None:
        scene.in_place = settings.align == "auto" and first_look(scene).in_place
        return scene
    if not mends(scene, alignment):
        return scene
    out = with_camera(scene, alignment.camera)
    out.mended_by, out.in_place = alignment, alignment.settled
    turned = f" and {alignment.degrees:.1f}°" if alignment.shift is None else ""
    moved = "camera is moved" if alignment.shift is None else "photo is shifted against the depth"
    scene.reporter.warn(
        f"geometry and photo did not line up: for this estimate the {moved} by {alignment.moved_px:.1f} pixels{turned} "
        f"({alignment.why}); the job stays as it is; btfsep align writes one that is in line"
    )
    return out


def mending_record(scene: PreparedScene) -> dict | None:
    """For ``result.json``: what was moved, and the camera that stood for the job's; None where nothing was."""
    alignment = scene.mended_by
    if alignment is None:
        return None
    from btfsep_engine.pipeline.alignment import camera_keys

    moved = {"moved_px": alignment.moved_px, "degrees": alignment.degrees, "focal_percent": alignment.focal_percent}
    if alignment.shift is None:
        return moved | {"camera": camera_keys(alignment.camera)}
    return moved | {"depth_shift": alignment.shift}
