# SPDX-License-Identifier: GPL-3.0-or-later
"""The photo behind the camera: as its background, with the render's resolution, and how it is read."""

import bpy

from ..basics.errors import InputError
from ..light import light_picture
from ..photo import camera as pinhole
from ..photo import frames, photo, photo_file, upright
from ..run import buttons, reasons, request, runs
from . import blender_views

TURNED = (
    "the file says that it is to be turned, which Blender does not do: if the photo lies on its side or stands on its "
    "head, turn it in an image editor and open that"
)
PRESS = "its file asks for it to be turned, which Blender does not do: if it lies on its side, press Turn Upright"
READ = {
    "srgb": "read as sRGB",
    "camera": "read by the usual curve of cameras",
    "phone": "read as a phone's own picture",
    "linear": "read as linear light",
    "blender": "its view transform is found from the photo",
    **{name: f"read as a render saved with {each.words}" for name, each in blender_views.VIEWS.items()},
    "unknown": "its tone curve is found from the photo",
}


def background(camera):
    """The picture that is the camera's background already; None where there is none."""
    found = camera.data.background_images if camera is not None and camera.type == "CAMERA" else ()
    return next((b.image for b in found if b.source == "IMAGE" and b.image is not None), None)


def is_behind(scene) -> bool:
    """Whether the photo is shown behind the camera."""
    camera, image = scene.btfsep.camera or scene.camera, scene.btfsep.image
    return (
        image is not None
        and camera is not None
        and camera.data.show_background_images
        and any(b.image == image and b.show_background_image for b in camera.data.background_images)
    )


def read_as(image, curve: str) -> str:
    """How the engine is told to read the photo, in words; ``curve``: the panel's."""
    if photo.of_floats(image):
        return "read as linear light (floats)"
    if curve != "auto":
        return READ[curve]
    space = image.colorspace_settings.name
    if space in photo.LINEAR:
        return READ["linear"]
    if space not in photo.CODED:
        return f"read as {space}, as Blender shows it"
    says = photo.facts_of_image(image)
    if says.is_by_phone:
        return f"read as {space} and as a phone's own picture: the file names one"
    if says.is_by_camera:
        return f"read as {space} and by the usual curve of cameras: the file names one"
    if says.is_render and space == "sRGB":
        return f"the file says that Blender rendered it; {READ['blender']}"
    return f"read as {space}"


def fit_render(scene, size) -> list:
    """Gives the render the photo's ``size`` and square pixels; sentences of what that changed.

    A photo of the region that the render is cropped to stays one.
    """
    render, words = scene.render, []
    if render.pixel_aspect_x != render.pixel_aspect_y:
        render.pixel_aspect_x = render.pixel_aspect_y = 1
        words.append("pixels are square")
    whole = pinhole.shown(scene, size) == (0, 0, *pinhole.render_size(scene))
    if pinhole.shown(scene, size) is None or (whole and pinhole.render_size(scene) != tuple(size)):
        old = pinhole.render_size(scene)
        render.resolution_x, render.resolution_y, render.resolution_percentage = *size, 100
        render.use_crop_to_border = False
        words.append(f"the resolution is {size[0]} x {size[1]}, was {old[0]} x {old[1]}")
    return words


def put_behind(scene, camera, image, size) -> list:
    """Makes ``image``, of ``size``, the background of ``camera``, where the photo was in the camera's picture.

    Gives sentences of what that hides: another picture behind the camera would lie over this one.
    """
    data = camera.data
    data.show_background_images = True
    own = next((b for b in data.background_images if b.source == "IMAGE" and b.image in (image, None)), None)
    own = own or data.background_images.new()
    hidden = [
        b
        for b in data.background_images
        if b != own and b.image and b.source == "IMAGE" and b.display_depth == "BACK" and b.show_background_image
    ]
    for other in hidden:
        other.show_background_image = False
    own.source, own.image, own.show_background_image = "IMAGE", image, True
    own.frame_method, own.display_depth, own.alpha = "FIT", "BACK", 1.0
    own.rotation, own.use_flip_x, own.use_flip_y = 0.0, False, False
    left, top, width, height = pinhole.shown(scene, size) or (0, 0, *pinhole.render_size(scene))
    across, down = pinhole.render_size(scene)
    # Offsets are in units of the picture's longer side; the scale is of what fits into the whole picture.
    longer = max(across, down)
    own.offset = ((left + width / 2 - across / 2) / longer, (down / 2 - top - height / 2) / longer)
    own.scale = max(width / across, height / down)
    if image.source == "SEQUENCE":
        numbers = [frames.split(path.name)[1] for path in frames.family(photo.file_of(image))]
        user = own.image_user
        user.frame_start, user.frame_offset = numbers[0], numbers[0] - 1
        user.frame_duration = numbers[-1] - numbers[0] + 1
    return [f"'{other.image.name}' behind it is hidden" for other in hidden]


class BTFSEP_OT_use_photo(buttons.Greyed, buttons.AtOnce, bpy.types.Operator):
    """Put the photo behind the camera and give the render its resolution; or take the photo that is the background"""

    bl_idname = "btfsep.use_photo"
    bl_label = "Use Photo"
    bl_options = {"REGISTER", "UNDO"}

    @staticmethod
    def reason(context) -> str:
        scene, settings = context.scene, context.scene.btfsep
        camera = settings.camera or scene.camera
        image = settings.image or background(camera)
        no_photo = reasons.no_single_picture(image) if image else "Open the photo first"
        return reasons.of_camera(camera) or no_photo

    def do(self, context):
        return use(context)


class BTFSEP_OT_turn_upright(buttons.Greyed, buttons.AtOnce, bpy.types.Operator):
    """Take an upright copy of the photo, as its file asks for, and use that; it is kept in the .blend"""

    bl_idname = "btfsep.turn_upright"
    bl_label = "Turn Upright"
    bl_options = {"REGISTER", "UNDO"}

    @staticmethod
    def reason(context) -> str:
        scene, settings = context.scene, context.scene.btfsep
        if runs.is_running():
            return runs.RUNNING
        if upright.orientation_of(settings.image) == 1:
            return "The photo's file does not ask for it to be turned"
        return reasons.of_camera(settings.camera or scene.camera)

    def do(self, context):
        settings = context.scene.btfsep
        camera, image = settings.camera or context.scene.camera, settings.image
        settings.image = upright.copy_of(image)
        for behind in camera.data.background_images:
            if behind.image == image:
                behind.image = settings.image
        return use(context)


def use(context) -> str:
    """Puts the photo behind the camera and gives the render its resolution; what was done, in a sentence."""
    scene, settings = context.scene, context.scene.btfsep
    camera = settings.camera or scene.camera
    image = settings.image or background(camera)
    size = photo.size_of(image)
    if not all(size):
        raise InputError(f"the photo '{image.name}'", *f"it {photo.lacks_pixels(image)}".split(": "))
    settings.image = image
    words = fit_render(scene, size)
    words += put_behind(scene, camera, image, size)
    file = photo.file_at(image, camera, scene.frame_current)
    light_picture.small(image, file)  # for the picture of the light, later
    if upright.orientation_of(image) != 1:
        words.append(PRESS)
    elif not image.packed_file and file is not None and photo_file.facts_of(file).orientation != 1:
        words.append(TURNED)
    for space in views(context):
        through(space, camera)
    show_outlines(scene)
    return "; ".join([f"'{image.name}' is behind '{camera.name}'", *words, read_as(image, settings.curve)])


def show_outlines(scene) -> None:
    """Lays the photo over the objects of the list, with their outlines: all that follows depends on how they lie."""
    state = runs.run_state()
    if state.overlay == "OFF" and request.listed(scene.btfsep) and is_behind(scene):
        state.overlay = "OUTLINE"


def views(context) -> list:
    """The space of the 3D view that a button is in, else of the screen's largest, if any."""
    if context.space_data is not None and context.space_data.type == "VIEW_3D":
        return [context.space_data]
    areas = [area for area in context.screen.areas if area.type == "VIEW_3D"] if context.screen else []
    return [max(areas, key=lambda area: area.width * area.height).spaces.active] if areas else []


def through(space, camera) -> None:
    """Has a 3D view look through ``camera``."""
    if camera is None:
        return
    if space.camera != camera:
        space.use_local_camera, space.camera = True, camera
    space.region_3d.view_perspective = "CAMERA"


register, unregister = bpy.utils.register_classes_factory((BTFSEP_OT_use_photo, BTFSEP_OT_turn_upright))
