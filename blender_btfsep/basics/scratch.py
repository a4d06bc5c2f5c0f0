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


def save_exr(image, path, *, raw: bool = False) -> None:
    """Saves what Blender shows of ``image``, linear Rec.709 with alpha, 32 bit, through a scene of its own.

    ``raw``: the numbers as they are, without alpha.
    """
    with scratch() as own:
        scene = own(bpy.data.scenes.new("BTFsep picture"))
        settings = scene.render.image_settings
        settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGB" if raw else "RGBA"
        if raw:
            scene.view_settings.view_transform = "Raw"
        else:  # the working space may be another
            settings.color_management = "OVERRIDE"
            settings.linear_colorspace_settings.name = "Linear Rec.709"
        image.save_render(str(path), scene=scene)
