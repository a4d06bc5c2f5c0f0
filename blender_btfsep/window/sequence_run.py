# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimate Sequence: the light of every photo of a standing camera, as keyframes of the World.

The photos are an image sequence (an image with the source *Image Sequence*), or what a pattern matches.
"""

from pathlib import Path

import bpy
from bpy.props import IntProperty, StringProperty

from ..basics.errors import InputError
from ..light import animation, kept_light, lighting_file
from ..photo import frames, photo
from ..run import request, runs
from ..run.answer import take_materials
from .operators import NeedsScene

OUT = "sequence"  # the results' folder in that of the job


def is_sequence(image) -> bool:
    """Whether ``image`` stands for more than one photo."""
    return image is not None and image.source == "SEQUENCE"


def files_of(image) -> list[Path]:
    """The files of an image sequence, in the order of their numbers.

    Raises InputError when it is no sequence of files, or the engine would take their colours for others than Blender
    does.
    """
    if image is None:
        raise InputError("the photos", "none are chosen", "open an image sequence as the photo")
    if image.source not in {"FILE", "SEQUENCE"}:
        raise InputError(
            f"the photo '{image.name}'", f"its source is {image.source}", "save the photos as an image sequence"
        )
    files = frames.family(photo.file_of(image))
    if not photo.taken_as_is(image, files[0]):
        raise InputError(
            f"the photo '{image.name}'",
            f"a sequence of {files[0].suffix} in the colour space {image.colorspace_settings.name} cannot be read",
            "save the photos as linear EXR",
        )
    return files


def start_of(image, camera, first: int) -> int:
    """The frame at which photo number ``first`` stands: its number, or as the camera's background image shows it."""
    for background in camera.data.background_images if camera is not None else ():
        if background.source == "IMAGE" and background.image == image:
            user = background.image_user
            return first + user.frame_start - 1 - user.frame_offset
    return first


def photos(image, camera, pattern: str, start: int | None) -> tuple[list[Path], int | None]:
    """The photos, and the frame of the first of them (None: its number), from what was asked for."""
    if pattern:
        return frames.matching(pattern), start
    files = files_of(image)
    return files, start_of(image, camera, frames.split(files[0].name)[1]) if start is None else start


def engine_arguments(folder: Path, scene, files, out: Path, *, pattern: str, options=None) -> list:
    """The engine's command for the job in ``folder``; ``options`` as of `request.engine_arguments`."""
    images = pattern or frames.pattern_of(files)
    return request.engine_arguments("sequence", folder, scene, "--images", images, "--out", out, options=options)


def write_world(scene, result: dict, files, start, *, apply: bool, interpolation: str) -> str:
    """Makes the engine's lights the World; gives a sentence about them.

    Parameters
    ----------
    result : dict, the engine's answer
    files : list of Path, the photos
    start : the frame of the first, None: its number
    apply : whether the World is changed
    interpolation : of `animation.apply_sequence`

    Raises InputError when a lighting cannot be read. The World is then as it was.
    """
    folder = Path(result["out"])
    at = dict(zip([p.name for p in files], frames.numbers([p.name for p in files], start=start), strict=True))
    found = [f for f in result["frames"] if f["image"] in at]
    lights = sorted(
        ((at[f["image"]], lighting_file.read(folder / Path(f["lighting"]).name)) for f in found), key=lambda x: x[0]
    )
    if apply:
        animation.apply_sequence(scene, lights, clamp=scene.btfsep.clamp, interpolation=interpolation)
        kept_light.forget(scene)
    worst = max(found, key=lambda f: f["residual"])
    words = (
        f"{len(lights)} lights, frames {lights[0][0]} to {lights[-1][0]}\n"
        f"{worst['image']} fits worst: {100 * worst['residual']:.0f}% of it is not explained"
    )
    if failed := [f["image"] for f in result.get("failed", ())]:
        words += f"\n{len(failed)} photo{'s' if len(failed) > 1 else ''} without a light, first {failed[0]}"
    return words


class BTFSEP_OT_estimate_sequence(NeedsScene, runs.EngineOperator, bpy.types.Operator):
    """Estimate the light of every photo of the image sequence and key it, as nodes of the World"""

    bl_idname = "btfsep.estimate_sequence"
    bl_label = "Estimate Sequence"
    bl_options = {"REGISTER", "UNDO"}
    task = "Estimating the sequence"
    outlives = True
    images: StringProperty(
        name="Images",
        description="Pattern of the photos, as //frames/*.exr. Empty: the image sequence in the panel",
        options={"SKIP_SAVE"},
    )
    frame_start: IntProperty(
        name="First Frame",
        description="Frame of the first photo, where it is not the number in its name",
        options={"SKIP_SAVE"},
    )

    def begin(self, context):
        settings = context.scene.btfsep
        pattern = bpy.path.abspath(self.images)
        start = self.frame_start if self.properties.is_property_set("frame_start") else None
        camera = settings.camera or context.scene.camera
        self._files, self._start = photos(settings.image, camera, pattern, start)
        self._ids = request.ids_of(settings)
        folder = yield from request.job_slices(context, image=self._files[0])
        return engine_arguments(folder, self.scene(), self._files, folder / OUT, pattern=pattern)

    def finish(self, context, result):
        scene = self.scene()
        words = take_materials(scene, result.get("objects"), self._ids)
        apply, interpolation = scene.btfsep.world_mode != "NONE", scene.btfsep.interpolation
        words.append(write_world(scene, result, self._files, self._start, apply=apply, interpolation=interpolation))
        return "\n".join(words)


register, unregister = bpy.utils.register_classes_factory((BTFSEP_OT_estimate_sequence,))
