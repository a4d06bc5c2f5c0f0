# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's view transforms by which a photo may have been saved, as the engine names them (its `blender_views`)."""

from typing import NamedTuple

from ..light import kept_light
from ..photo import photo


class View(NamedTuple):
    """A view transform and its look, as colour management names them."""

    transform: str
    look: str = "None"

    @property
    def words(self) -> str:
        """For people."""
        look = self.look.removeprefix("AgX - ")
        return self.transform + ("" if look == "None" else f", {look}")


VIEWS = {
    "agx": View("AgX"),
    "agx-punchy": View("AgX", "AgX - Punchy"),
    "agx-medium-high-contrast": View("AgX", "AgX - Medium High Contrast"),
    "agx-high-contrast": View("AgX", "AgX - High Contrast"),
    "filmic": View("Filmic"),
    "khronos": View("Khronos PBR Neutral"),
}
FOUND, OTHERS = "Blender's view transform {} (probability", "; also possible"  # the engine's words


def of_photo(scene) -> View | None:
    """The view that the scene's photo was, or is to be, read as saved by; None: by none."""
    settings = scene.btfsep
    if settings.image is None or photo.of_floats(settings.image):
        return None
    if settings.curve not in ("auto", "blender", "unknown"):
        return VIEWS.get(settings.curve)
    light = kept_light.kept(scene)
    said = [each.partition(OTHERS)[0] for each in (kept_light.card(light).get("details", ()) if light else ())]
    return next((view for view in VIEWS.values() if any(FOUND.format(view.words) in each for each in said)), None)
