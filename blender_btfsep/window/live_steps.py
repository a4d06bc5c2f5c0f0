# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of undo that `live` makes, where lamps or nodes come with a light: each goes with the user's step before.

Such a step has to be: what no step knows, Blender frees with the next step back. But nobody asked for it. So one undo
takes it back together with what it followed, and one redo brings both. And none is made while there may be something
to redo: it would end that, as every step does.

Blender tells that something was undone, but neither which step is the present one nor when one is made. So each of ours
has a number, which is in the scene from that step on, and how far back the present one is, is counted.
"""

import contextlib
import time

import bpy
from bpy.app.handlers import persistent

from ..run import between_steps
from . import live_changes

ECHO = 0.3  # seconds within which Blender tells again of what an undo has changed, or a light
KEPT = 64  # steps that are remembered: more than Blender keeps as a rule

_placed: dict = {}  # number of a step of ours -> what stood where then
_before = 0  # the number of the last one before an undo
_back = 0  # how many steps the present one is behind the newest
_followed: set = set()  # values of ``_back`` at which what a redo would bring next is ours
_next = ""  # what is to be done once more: "undo" or "redo"
_moved, _echo = 0.0, False  # when something changed that is not the user's doing, and whether that is yet to be told
_later = False  # whether there were changes of the user's since the last step that is known here


def close(scene, *, follows: bool = True) -> bool:
    """Makes a step of the light that `live` has just given, where it needs one; gives whether it is one.

    ``follows`` : whether it goes with the step before
    """
    given()
    if not between_steps.is_open():
        return False
    number = scene.btfsep.live_step
    if follows:
        scene.btfsep.live_step = _newest() + 1
    if not between_steps.close("Live"):
        scene.btfsep.live_step = number
        return False
    if follows:
        _placed[scene.btfsep.live_step] = live_changes.placed(scene)
    for old in sorted(_placed)[:-KEPT]:
        del _placed[old]
    _stand()
    return True


def may_redo() -> bool:
    """Whether the user could redo something."""
    windows = bpy.context.window_manager.windows
    with bpy.context.temp_override(window=windows[0]) if windows else contextlib.nullcontext():
        return bpy.ops.ed.redo.poll()


def given() -> None:
    """A light has been put into the scene, of which Blender is yet to tell."""
    global _moved, _echo
    _moved, _echo = time.monotonic(), True


def _newest() -> int:
    return max((scene.btfsep.live_step for scene in bpy.data.scenes), default=0)


def _stand() -> None:
    global _later
    given()
    _later = False


def _is_unchanged(number: int) -> bool:
    """Whether all stands where it stood with a step of ours: what was undone since is no more than that."""
    then = _placed.get(number)
    return then is None or any(live_changes.placed(each) == then for each in bpy.data.scenes)


def _once_more(what: str) -> None:
    global _next
    _next = what
    if not bpy.app.timers.is_registered(_go_on):  # not here: other add-ons are yet to be told of this one
        bpy.app.timers.register(_go_on, first_interval=0.0)


def _go_on():
    global _next
    what, _next = _next, ""
    windows = bpy.context.window_manager.windows
    if what and not any(getattr(window, "modal_operators", ()) for window in windows):
        with bpy.context.temp_override(window=windows[0]) if windows else contextlib.nullcontext():
            step = getattr(bpy.ops.ed, what)
            if step.poll():
                step()
    return 0.0 if _next else None


@persistent
def _heard(scene, depsgraph):
    global _later, _echo
    if depsgraph.mode == "VIEWPORT":
        _later = _later or (not _echo and time.monotonic() - _moved > ECHO)
        _echo = False


@persistent
def _undo_pre(*_):
    global _before, _back
    _before = _newest()
    if not may_redo():  # what was counted before was cut off by a step of the user's
        _back = 0
        _followed.clear()


@persistent
def _undo_post(*_):
    global _back
    _back += 1
    if _newest() < _before:
        if _later or not _is_unchanged(_before):
            _followed.clear()  # several at once, by Undo History: where they lie is not known
        else:
            _followed.add(_back)
            _once_more("undo")
    _stand()


@persistent
def _redo_post(*_):
    global _back
    _back -= 1
    _stand()
    if _back in _followed:
        _once_more("redo")


@persistent
def _load_post(*_):
    _placed.clear()
    _followed.clear()


HANDLERS = (
    *(("undo_pre", _undo_pre), ("undo_post", _undo_post)),
    *(("redo_post", _redo_post), ("load_post", _load_post), ("depsgraph_update_post", _heard)),
)


def register():
    for when, handler in HANDLERS:
        getattr(bpy.app.handlers, when).append(handler)


def unregister():
    if bpy.app.timers.is_registered(_go_on):
        bpy.app.timers.unregister(_go_on)
    for when, handler in HANDLERS:
        getattr(bpy.app.handlers, when).remove(handler)
