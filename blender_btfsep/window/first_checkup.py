# SPDX-License-Identifier: GPL-3.0-or-later
"""Asks the engine once by itself whether it works, some seconds after the add-on was switched on for the first time.

On most Windows and macOS machines something has to be installed first, which is better known before there is a photo.
"""

import bpy

from ..basics.errors import InputError
from ..engine import checkup, engine_process
from ..run import runs

SOON, LOOK = 3.0, 0.5  # seconds after switching on; between looks

_process = None


def _first_time():
    """A timer: asks the engine, and looks whether it has answered."""
    global _process
    if _process is None:
        try:
            _process = runs.start_engine(["doctor"], stays=False)
        except InputError as error:
            checkup.take_failure(str(error))
            return None
    for message in _process.poll():
        if isinstance(message, engine_process.Done):
            checkup.take(message.result)
        elif isinstance(message, engine_process.Failed):
            checkup.take_failure(message.message)
    if _process.over:
        _process = None
        return None
    return LOOK


def register():
    if not bpy.app.background and not checkup.findings():
        bpy.app.timers.register(_first_time, first_interval=SOON, persistent=True)


def unregister():
    global _process
    if bpy.app.timers.is_registered(_first_time):
        bpy.app.timers.unregister(_first_time)
    if _process is not None:
        _process.kill()
    _process = None
