# SPDX-License-Identifier: GPL-3.0-or-later
"""BTFsep in Blender: the light of a photograph as the scene's World."""

import atexit

import bpy

from . import command
from .engine import preferences
from .light import group_ahead
from .panels import light_panel
from .panels import photo_panels as panels
from .run import between_steps, runs
from .window import (
    alignment,
    example,
    first_checkup,
    icons,
    importer,
    known_suns,
    library,
    library_assets,
    light_controls,
    light_operators,
    live,
    live_steps,
    looking,
    mask,
    measure,
    mending,
    object_list,
    operators,
    outlines,
    properties,
    sequence_run,
    use_photo,
)

MODULES = (
    icons,
    properties,
    preferences,
    first_checkup,
    library,
    library_assets,
    group_ahead,
    between_steps,
    operators,
    alignment,
    use_photo,
    example,
    outlines,
    object_list,
    mask,
    light_operators,
    looking,
    mending,
    known_suns,
    importer,
    light_controls,
    measure,
    sequence_run,
    live_steps,
    live,
    panels,
    light_panel,
    command,
)


def register():
    for module in MODULES:
        module.register()
    if getattr(bpy.app, "module", False):
        # Blender as a Python module hangs when it ends while property callbacks are registered.
        atexit.register(unregister)


def unregister():
    atexit.unregister(unregister)
    if not hasattr(bpy.types.Scene, "btfsep"):
        return  # done already: where a process ends, Blender and atexit both ask for it
    runs.stop_now()
    for module in reversed(MODULES):
        module.unregister()
