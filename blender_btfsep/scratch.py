# SPDX-License-Identifier: GPL-3.0-or-later
"""Data that is made to work with and is gone afterwards."""

from contextlib import contextmanager

import bpy


@contextmanager
def scratch():
    """Gives a function ``own(data) -> data``; what it was given is removed on leaving, whatever happens.

    By ``batch_remove``: ``bpy.data.scenes.remove`` looks at the context's window, and Blender 4.3 dies of it where
    there is none, as in ``blender --background FILE --command``.
    """
    owned = []

    def own(data):
        owned.append(data)
        return data

    try:
        yield own
    finally:
        bpy.data.batch_remove(owned)
