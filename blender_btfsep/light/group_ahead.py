# SPDX-License-Identifier: GPL-3.0-or-later
"""The node group of a light that is on its way, made piece by piece: all at once it would hold the window up.

Nothing points to it until the light comes, so that a step back, which frees it, leaves nothing that would. Who holds
pieces of it does: it is given up before anything is undone, and what the user has purged is not touched any more.
"""

import time

import bpy
from bpy.app.handlers import persistent

from . import sh_nodes

PIECE = 0.02  # seconds of work at once

_pieces = None  # of the group that is being made
_made = (0, -1, False)  # its session id, its order, whether it is finished


def go_on(order: int) -> bool:
    """Does a piece of the group of ``order``; gives whether it is finished."""
    global _pieces, _made
    tree = _found()
    if tree is None or _made[1] != order:
        give_up()
        _pieces = sh_nodes.group_in_pieces(order)
        _made = (next(_pieces).session_uid, order, False)
    end = time.monotonic() + PIECE
    while not _made[2] and time.monotonic() < end:
        if next(_pieces, None) is None:
            _made, _pieces = (*_made[:2], True), None
    return _made[2]


def take(order: int) -> bpy.types.ShaderNodeTree:
    """The group of ``order``: the one that was begun, finished now if need be, or a new one."""
    global _made
    tree = _found()
    if tree is None or _made[1] != order:
        give_up()
        return sh_nodes.build_group(order)
    for _ in _pieces or ():
        pass
    _let_go()
    return tree


def waiting() -> set:
    """The session id of what was made, if there is any: no step of undo may have it."""
    return set() if _found() is None else {_made[0]}


def give_up() -> None:
    """It is not wanted any more."""
    tree = _found()
    _let_go()
    if tree is not None:
        bpy.data.node_groups.remove(tree)


def _let_go() -> None:
    global _pieces, _made
    _pieces, _made = None, (0, -1, False)


def _found():
    """The group that was begun, unless it is gone, or somebody's."""
    trees = (tree for tree in bpy.data.node_groups if tree.session_uid == _made[0] and not tree.users)
    return next(trees, None) if _made[0] else None


@persistent
def _before(*_):
    """What is there may be another in a moment: what is not wanted then, goes with the next light's orphans."""
    _let_go()


HANDLERS = ("undo_pre", "redo_pre", "load_pre")


def register():
    for when in HANDLERS:
        getattr(bpy.app.handlers, when).append(_before)


def unregister():
    give_up()
    for when in HANDLERS:
        getattr(bpy.app.handlers, when).remove(_before)
