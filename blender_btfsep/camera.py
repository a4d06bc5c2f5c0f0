# SPDX-License-Identifier: GPL-3.0-or-later
"""A Blender camera as a pinhole: fx fy cx cy in pixels, and its rigid place in the world."""

import numpy as np

from .errors import InputError


def render_size(scene) -> tuple[int, int]:
    """Width and height of a render of ``scene`` in pixels, as Blender rounds them."""
    render = scene.render
    percentage = render.resolution_percentage
    return render.resolution_x * percentage // 100, render.resolution_y * percentage // 100


def intrinsics(scene, camera, width: int, height: int) -> dict:
    """The pinhole of ``camera`` (a camera object) for a picture of ``width`` x ``height`` pixels.

    The render settings of ``scene`` give the pixel aspect. All of sensor fit and shift follow Blender's own
    ``BKE_camera_params_compute_viewplane``: focal length and shift are measured in units of the fitted side.

    Returns
    -------
    dict with "width", "height", "fx", "fy", "cx", "cy": pixels; (0, 0) is the top left corner of the picture,
    the centre of the first pixel is (0.5, 0.5)

    Raises
    ------
    InputError
        When the camera is no perspective camera.
    """
    data = camera.data
    if data.type != "PERSP":
        raise InputError(f"camera '{camera.name}'", f"its type is {data.type}", "choose a perspective camera")
    aspect = scene.render.pixel_aspect_y / scene.render.pixel_aspect_x
    fit = data.sensor_fit
    if fit == "AUTO":
        fit = "HORIZONTAL" if width >= aspect * height else "VERTICAL"
    # With AUTO the sensor's width is what is fitted to the longer side, even if that side is the height.
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    fitted = width if fit == "HORIZONTAL" else aspect * height  # pixel widths
    focal = fitted * data.lens / sensor
    return {
        "width": width,
        "height": height,
        "fx": focal,
        "fy": focal / aspect,
        "cx": width / 2 - data.shift_x * fitted,
        "cy": height / 2 + data.shift_y * fitted / aspect,
    }


def to_world(camera) -> np.ndarray:
    """(4, 4) float64, camera to world, rigid: Blender ignores the scale of a camera.

    ``camera`` is the evaluated camera object. Raises InputError when it is mirrored.
    """
    matrix = np.array(camera.matrix_world, np.float64)
    if np.linalg.det(matrix[:3, :3]) <= 0:
        raise InputError(f"camera '{camera.name}'", "its scale is negative or zero", "apply the camera's scale")
    u, _, vt = np.linalg.svd(matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0))
    rigid = np.eye(4)
    rigid[:3, :3] = u @ vt
    rigid[:3, 3] = matrix[:3, 3]
    return rigid


def for_photo(scene, camera, size: tuple[int, int]) -> dict:
    """The pinhole for a photo of ``size`` (width, height), whatever the scene's resolution, if the shapes agree.

    Raises InputError when the aspect of the photo is not that of the render settings.
    """
    width, height = size
    render_width, render_height = render_size(scene)
    # One pixel of rounding on either side is no other shape.
    if abs(width * render_height - height * render_width) > max(width, height, render_width, render_height):
        raise InputError(
            "the photo",
            f"it is {width} x {height}, the scene renders {render_width} x {render_height}",
            "set the scene's resolution to the photo's, so that the camera sees what the photo shows",
        )
    return intrinsics(scene, camera, width, height)
