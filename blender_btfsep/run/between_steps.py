# SPDX-License-Identifier: GPL-3.0-or-later
"""Data-blocks that come between two of Blender's steps of undo: of a light that `live` or a run under way has written.

A step back frees what no step knows and leaves alone what no step has otherwise: that would go on pointing to what is
gone, and Blender crashes. So they become a step of their own, at the latest before anything is undone.
"""

import contextlib

import bpy
from bpy.app.handlers import persistent

KINDS = ("worlds", "node_groups", "images", "objects", "lights", "collections", "actions")
OF_ONE_THING = ("EDIT", "PARTICLE")  # modes whose steps of undo have nothing but what is edited

_made: set = set()  # session ids of what no step of undo has
_gone = False  # whether the last step has objects or nodes that are gone since


def _there() -> dict:
    return {each.session_uid: each for kind in KINDS for each in getattr(bpy.data, kind)}


@contextlib.contextmanager
def writing(earlier=()):
    """What is made in here is in no step of undo, until :func:`known`.

    ``earlier`` : session ids of what was made before, is in no step either, and may be used here
    """
    global _gone
    before = _there()
    told = {number for number, each in before.items() if isinstance(each, bpy.types.Object | bpy.types.NodeTree)}
    try:
        yield
    finally:
        after = _there().keys()
        _made.update(after - (before.keys() - set(earlier)))
        _gone = _gone or bool(told - set(earlier) - after)


def known() -> None:
    """A step of undo has all of it, or has it in a moment."""
    global _gone
    _gone = False
    _made.clear()


def is_open() -> bool:
    """Whether there is anything that no step of undo has, or is anything gone that one has."""
    return _gone or bool(_made & _there().keys())


def close(message: str) -> bool:
    """Makes a step of undo of it, unless the user is in the midst of something; gives whether it did."""
    windows = bpy.context.window_manager.windows
    if not is_open() or any(getattr(window, "modal_operators", ()) for window in windows):
        return False
    with bpy.context.temp_override(window=windows[0]) if windows else contextlib.nullcontext():
        if bpy.context.mode.startswith(OF_ONE_THING):
            return False
        bpy.ops.ed.undo_push(message=message)
    known()
    return True


@persistent
def _before(*_):
    """Something is to be undone or redone."""
    found = _there()
    ours = [found[number] for number in _made if number in found]
    known()
    if ours and bpy.context.mode.startswith(OF_ONE_THING):
        bpy.data.batch_remove(ours)  # the light comes anew with the next answer
    elif ours:
        bpy.ops.ed.undo_push(message="Light")


@persistent
def _left(*_):
    known()


HANDLERS = (("undo_pre", _before), ("redo_pre", _before), ("load_post", _left))


def register():
    for when, handler in HANDLERS:
        getattr(bpy.app.handlers, when).append(handler)


def unregister():
    known()
    for when, handler in HANDLERS:
        getattr(bpy.app.handlers, when).remove(handler)
