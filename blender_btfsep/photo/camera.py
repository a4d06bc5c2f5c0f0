# SPDX-License-Identifier: GPL-3.0-or-later
"""A Blender camera as the job's: fx fy cx cy in pixels, its lens's distortion, and its rigid place in the world."""

import numpy as np

from ..basics.errors import InputError

TYPES = ("PERSP", "ORTHO")  # of cameras that have a pinhole's or a parallel projection
OFF_CENTRE = 0.005  # of the width: the centre of a clip's distortion may be so far from the camera's


def render_size(scene) -> tuple[int, int]:
    """Width and height of a render of ``scene`` in pixels, as Blender rounds them."""
    render = scene.render
    percentage = render.resolution_percentage
    return render.resolution_x * percentage // 100, render.resolution_y * percentage // 100


def render_region(scene) -> tuple[int, int, int, int]:
    """Left, top, width and height of what a render of ``scene`` keeps of the camera's picture, in its pixels."""
    render, (width, height) = scene.render, render_size(scene)
    if not (render.use_border and render.use_crop_to_border):
        return 0, 0, width, height
    # in single precision, as Blender: 0.83 of 100 pixels are 83
    left, right = (int(np.float32(share) * np.float32(width)) for share in (render.border_min_x, render.border_max_x))
    bottom, top = (int(np.float32(share) * np.float32(height)) for share in (render.border_min_y, render.border_max_y))
    return left, height - top, right - left, top - bottom


def intrinsics(scene, camera, width: float, height: float) -> dict:
    """The pinhole, or the orthographic camera, that ``camera`` (a camera object) is for a picture of so many pixels.

    The render settings of ``scene`` give the pixel aspect. All of sensor fit and shift follow Blender's own
    ``BKE_camera_params_compute_viewplane``: focal length and shift are measured in units of the fitted side.

    Returns
    -------
    dict with "width", "height", "fx", "fy", "cx", "cy": pixels; (0, 0) is the top left corner of the picture,
    the centre of the first pixel is (0.5, 0.5). Of an orthographic camera "projection" says so, and "fx" and "fy" are
    pixels in a world unit.

    Raises InputError when the camera is of another type.
    """
    data = camera.data
    if data.type not in TYPES:
        got = f"its type is {data.type}"
        raise InputError(f"camera '{camera.name}'", got, "choose a perspective or orthographic camera")
    aspect = scene.render.pixel_aspect_y / scene.render.pixel_aspect_x
    fit = data.sensor_fit
    if fit == "AUTO":
        fit = "HORIZONTAL" if width >= aspect * height else "VERTICAL"
    # With AUTO the sensor's width is what is fitted to the longer side, even if that side is the height.
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    fitted = width if fit == "HORIZONTAL" else aspect * height  # pixel widths
    focal = fitted / data.ortho_scale if data.type == "ORTHO" else fitted * data.lens / sensor
    return {
        "width": width,
        "height": height,
        "fx": focal,
        "fy": focal / aspect,
        "cx": width / 2 - data.shift_x * fitted,
        "cy": height / 2 + data.shift_y * fitted / aspect,
        **({"projection": "orthographic"} if data.type == "ORTHO" else {}),
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


def shown(scene, size: tuple[int, int]):
    """Left, top, width and height of the part of the camera's picture that a photo of ``size`` (width, height) shows.

    It is the render's region where the render is cropped to it and the photo has its shape; a photo of the whole
    picture's very size is whole. None where the photo's shape is neither's.
    """
    whole = (0, 0, *render_size(scene))
    for part in (whole,) if tuple(size) == whole[2:] else (render_region(scene), whole):
        # One pixel of rounding on either side is no other shape.
        if abs(size[0] * part[3] - size[1] * part[2]) <= max(*size, *part[2:]):
            return part
    return None


def for_photo(scene, camera, size: tuple[int, int]) -> dict:
    """The camera for a photo of ``size`` (width, height), whatever the scene's resolution, if the shapes agree.

    Raises InputError when the aspect of the photo is not that of the render settings.
    """
    part = shown(scene, size)
    if part is None:
        _, _, width, height = render_region(scene)
        raise InputError(
            "the photo",
            f"it is {size[0]} x {size[1]}, the scene renders {width} x {height}",
            "set the scene's resolution to the photo's, so that the camera sees what the photo shows",
        )
    left, top, width, height = part
    across, down = size[0] / width, size[1] / height
    whole = render_size(scene)
    out = intrinsics(scene, camera, whole[0] * size[0] / width, whole[1] * size[1] / height)
    return {
        **out,
        "width": size[0],
        "height": size[1],
        "cx": out["cx"] - left * across,
        "cy": out["cy"] - top * down,
    }


def clip_of(scene, camera):
    """The movie clip that is the camera's background, as it was filmed; None where none is, or an undistorted one."""
    for background in camera.data.background_images:
        clip = scene.active_clip if background.use_camera_clip else background.clip
        if background.source == "MOVIE_CLIP" and clip and not background.clip_user.use_render_undistorted:
            return clip
    return None


def distortion(scene, camera, pinhole: dict, *, warn=lambda sentence: None) -> dict:
    """The lens of the movie clip behind ``camera``, as "k1", "k2", "p1", "p2" of the job; {} where there is none.

    Parameters
    ----------
    pinhole : of `for_photo`
    warn : told what the photo is taken to have, or why the clip's lens is not the job's
    """
    clip = clip_of(scene, camera)
    if clip is None:
        return {}
    lens = clip.tracking.camera
    k, p, higher = (0.0, 0.0), (0.0, 0.0), [0.0]
    if lens.distortion_model == "POLYNOMIAL":
        k, higher = (lens.k1, lens.k2), [lens.k3]
    elif lens.distortion_model == "BROWN":
        k, higher = (lens.brown_k1, lens.brown_k2), [lens.brown_k3, lens.brown_k4]
        p = -lens.brown_p2, lens.brown_p1  # libmv has y upwards, and them the other way round
    else:
        names = {"DIVISION": ("division_k1", "division_k2"), "NUKE": ("nuke_k1", "nuke_k2")}
        higher = [getattr(lens, name) for name in names.get(lens.distortion_model, ())] or [1.0]
    if not any((*k, *p, *higher)):
        return {}
    told = f"clip '{clip.name}' has a lens distortion"
    across = pinhole["width"] / clip.size[0] if clip.size[0] else 1.0
    off = np.array(lens.principal_point_pixels) * [1, -1] + [0, clip.size[1]]
    off = np.hypot(*(off * across - [pinhole["cx"], pinhole["cy"]])) / pinhole["width"]
    reason = ""
    if any(higher):
        reason = f"the model {lens.distortion_model.capitalize()} with these values has more terms than k1, k2, p1, p2"
    elif "projection" in pinhole:
        reason = "the camera is orthographic"
    elif abs(clip.size[0] * pinhole["height"] - clip.size[1] * pinhole["width"]) > max(*clip.size, pinhole["width"]):
        reason = "the photo has another shape"
    elif lens.pixel_aspect != 1 or abs(pinhole["fx"] / pinhole["fy"] - 1) > 1e-6:
        reason = "its pixels are not square"
    elif off > OFF_CENTRE:
        reason = f"its centre is {100 * off:.1f} % of the width from where the camera has it"
    if reason:
        warn(f"{told}, which is not exported: {reason}; undistort the photo")
        return {}
    warn(f"{told}, which the photo is taken to have; if it is undistorted, tick the background's Render Undistorted")
    zoom = pinhole["fx"] / (lens.focal_length_pixels * across)
    k1, k2, p1, p2 = k[0] * zoom**2, k[1] * zoom**4, p[0] * zoom, p[1] * zoom
    return {"k1": k1, "k2": k2, "p1": p1, "p2": p2}
