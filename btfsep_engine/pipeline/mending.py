# SPDX-License-Identifier: GPL-3.0-or-later
"""An estimate's own small alignment: where its doubt of geometry and photo speaks, and no farther than it can be wrong.

The job's files stay as they are; `btfsep align` makes a job of it.
"""

from btfsep_engine.pipeline.checks import shift_doubt
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import PhotoSettings

MOST_PIXELS, MOST_DEGREES = 6.0, 4.0  # of a move: 4 pixels and 2 degrees, and what is found beside them
MOST_OF_A_DEPTH = 5.0  # of a shift: 4 pixels, and what is found beside them


def mends(scene: PreparedScene, alignment) -> bool:
    """Whether an estimate takes an `alignment.Alignment` of its scene."""
    most = MOST_PIXELS if alignment.shift is None else MOST_OF_A_DEPTH
    small = alignment.moved_px <= most and alignment.degrees <= MOST_DEGREES
    return alignment.aligned and small and shift_doubt(scene) is not None


def mended(scene: PreparedScene, settings: PhotoSettings) -> PreparedScene:
    """The scene with its camera in line with the photo, and a warning that says so; else the scene itself.

    ``mended_by`` of what is returned is the Alignment, or None.
    """
    if settings.align == "never" or shift_doubt(scene) is None:
        return scene
    from btfsep_engine.pipeline.alignment import align, with_camera  # most photos are in line, and start without it

    with scene.reporter.stage("alignment"):
        alignment = align(scene)
    if not mends(scene, alignment):
        return scene
    out = with_camera(scene, alignment.camera)
    out.mended_by = alignment
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
