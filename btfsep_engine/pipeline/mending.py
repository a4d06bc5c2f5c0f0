# SPDX-License-Identifier: GPL-3.0-or-later
"""An estimate's own small alignment: where its doubt of geometry and photo speaks, and no farther than it can be wrong.

The job's files stay as they are; `btfsep align` makes a job of it.
"""

from btfsep_engine.pipeline.checks import shift_doubt
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import PhotoSettings

MOST_PIXELS, MOST_DEGREES = 6.0, 4.0  # of a move: 4 pixels and 2 degrees, and what is found beside them
MOST_OF_A_DEPTH = 5.0  # of a shift: 4 pixels, and what is found beside them


def mends(scene: PreparedScene, found) -> bool:
    """Whether an estimate takes an `alignment.Alignment` of its scene."""
    most = MOST_PIXELS if found.shift is None else MOST_OF_A_DEPTH
    small = found.moved_px <= most and found.degrees <= MOST_DEGREES
    return found.aligned and small and shift_doubt(scene) is not None


def mended(scene: PreparedScene, settings: PhotoSettings) -> PreparedScene:
    """The scene with its camera in line with the photo, and a warning that says so; else the scene itself.

    ``mended_by`` of what is returned is the Alignment, or None.
    """
    if settings.align == "never" or shift_doubt(scene) is None:
        return scene
    from btfsep_engine.pipeline.alignment import align, with_camera  # most photos are in line, and start without it

    with scene.reporter.stage("alignment"):
        found = align(scene)
    if not mends(scene, found):
        return scene
    out = with_camera(scene, found.camera)
    out.mended_by = found
    turned = f" and {found.degrees:.1f}°" if found.shift is None else ""
    moved = "camera is moved" if found.shift is None else "photo is shifted against the depth"
    scene.reporter.warn(
        f"geometry and photo did not line up: for this estimate the {moved} by {found.moved_px:.1f} pixels{turned} "
        f"({found.why}); the job stays as it is; btfsep align writes one that is in line"
    )
    return out


def mending_record(scene: PreparedScene) -> dict | None:
    """For ``result.json``: what was moved, and the camera that stood for the job's; None where nothing was."""
    found = scene.mended_by
    if found is None:
        return None
    from btfsep_engine.pipeline.alignment import camera_keys

    moved = {"moved_px": found.moved_px, "degrees": found.degrees, "focal_percent": found.focal_percent}
    return moved | ({"camera": camera_keys(found.camera)} if found.shift is None else {"depth_shift": found.shift})
