# SPDX-License-Identifier: GPL-3.0-or-later
"""The export of a large scene in a Blender of its own, so that the window goes on.

Blender evaluates modifiers and gives its meshes away in the main thread only: a million faces are seconds without a
picture. The scene is written to a file, which takes little, and a second Blender without a window reads it and writes
the job. This file is also what that Blender runs: ``blender --background --python export_child.py -- FILE SCENE LAYER
FOLDER``, which speaks the engine's protocol.
"""

import importlib.util
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import bpy

LARGE = 50_000  # faces, about a tenth of a second of work
MANY_PIXELS = 4_000_000  # of a picture that Blender has to write itself
SUBDIVIDING = {"SUBSURF", "MULTIRES"}
BENDING = {  # modifiers that have as many faces as they are given
    *("ARMATURE", "CAST", "CURVE", "DISPLACE", "HOOK", "LATTICE", "MESH_DEFORM", "SHRINKWRAP", "SIMPLE_DEFORM"),
    *("SMOOTH", "CORRECTIVE_SMOOTH", "LAPLACIANSMOOTH", "SURFACE_DEFORM", "WARP", "WAVE", "WEIGHTED_NORMAL"),
}
SIMULATED = {"CLOTH", "SOFT_BODY", "FLUID", "DYNAMIC_PAINT", "COLLISION", "EXPLODE"}  # what they are is no file's


def wanted(context, settings) -> bool:
    """Whether the export of the panel's scene is for a Blender of its own: where there is a window to freeze."""
    return not bpy.app.background and is_large(context, settings)


def is_large(context, settings) -> bool:
    """Whether the export of a scene takes a while, and a Blender of its own would see the same scene."""
    scene = context.scene
    if scene.rigidbody_world is not None:
        return False
    things = scene.objects
    if any(modifier.type in SIMULATED or getattr(modifier, "bakes", None) for t in things for modifier in t.modifiers):
        return False
    if any(_needs_python(driver) for thing in things for driver in _drivers(thing)):
        return False
    if any(image.packed_file is None for image in painted_images()):
        return False  # a file has no strokes that were not saved
    return _painted_pixels(settings) > MANY_PIXELS or _more_faces_than(
        context, LARGE // 10 if settings.mapping == "UNWRAP" else LARGE
    )


def painted_images() -> list:
    """The images of the file that were changed and not saved, and that something uses."""
    made = {"RENDER_RESULT", "COMPOSITING"}
    return [image for image in bpy.data.images if image.is_dirty and image.users and image.type not in made]


def _drivers(thing):
    return thing.animation_data.drivers if thing.animation_data else ()


def _needs_python(curve) -> bool:
    return curve.driver.type == "SCRIPTED" and not curve.driver.is_simple_expression


def _painted_pixels(settings) -> int:
    """Pixels of the pictures that are no files which are copied as they are."""
    masks = [entry.mask for entry in settings.objects if entry.mask is not None]
    photo = settings.image
    painted = [photo] if photo is not None and (photo.is_dirty or photo.packed_file or photo.source != "FILE") else []
    return sum(image.size[0] * image.size[1] for image in masks + painted)


def _more_faces_than(context, most: int) -> bool:
    """Whether a render has more faces, told by what the viewport has and how much finer a render subdivides."""
    count = 0
    for instance in context.evaluated_depsgraph_get().object_instances:
        if instance.object.type == "MESH":
            count += _faces(instance.object)
        if count > most:
            return True
    return False


def _faces(evaluated) -> int:
    """Faces of an evaluated mesh object in a render.

    Where it is subdivided, and bent at most, they are reckoned from the mesh as it was modelled: Blender leaves the
    viewport's subdivision to the graphics card, and would do all of it again for the number.
    """
    thing, finer, simple = evaluated.original, 0, True
    for modifier in thing.modifiers:
        if modifier.type in SUBDIVIDING and modifier.show_render:
            finer += modifier.render_levels
        simple = simple and modifier.type in SUBDIVIDING | BENDING
    if simple and thing.type == "MESH" and thing.mode != "EDIT":
        return len(thing.data.loops) * 4 ** (finer - 1) if finer else len(thing.data.polygons)
    shown = (m for m in thing.modifiers if m.type in SUBDIVIDING and m.show_render and m.show_viewport)
    return len(evaluated.data.polygons) * 4 ** max(finer - sum(m.levels for m in shown), 0)


def command(file, scene, view_layer, folder) -> tuple:
    """The command line of the Blender that exports."""
    program = bpy.app.binary_path
    blender = (program, "--background", "--factory-startup", "--python", __file__, "--") if program else None
    return (*(blender or (sys.executable, __file__, "--")), str(file), scene.name, view_layer.name, str(folder))


def write(scene, file) -> None:
    """Writes ``scene`` and all that it needs to ``file``."""
    for thing in scene.objects:
        if thing.mode == "EDIT":
            thing.update_from_editmode()
    for image in painted_images():
        if image.packed_file is not None:
            image.pack()  # as it is now: what is written is what was packed
    bpy.data.libraries.write(str(file), {scene}, path_remap="ABSOLUTE", fake_user=False)


def empty() -> None:
    """Has Blender hold nothing: a cube of its own would take the name of the user's.

    The settings stay. Of factory settings Blender takes extensions for switched off, and removes what is installed for
    them, this one's engine among it, in the user's own folders.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def main(file: str, name: str, layer: str, folder: str) -> int:
    """Reads ``file`` and writes the job of its scene; says so in the engine's protocol. Gives the exit status."""
    empty()
    here = Path(__file__).parents[1]
    spec = importlib.util.spec_from_file_location(
        "btfsep_export", here / "__init__.py", submodule_search_locations=[str(here)]
    )
    package = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(package)
    package.register()
    request, errors = (importlib.import_module(f"{spec.name}.{part}") for part in ("run.request", "basics.errors"))
    try:
        with bpy.data.libraries.load(file, link=False) as (_, wanted_of):
            wanted_of.scenes = [name]
        scene = wanted_of.scenes[0]
        where = SimpleNamespace(scene=scene, view_layer=scene.view_layers[layer])
        request.write_job(where, folder=folder, warn=lambda sentence: _say(type="warning", message=sentence))
    except errors.InputError as error:
        _say(type="failed", message=str(error), exit_code=2)
        return 2
    finally:
        package.unregister()
    _say(type="done", result={"folder": folder})
    return 0


def _say(**fields) -> None:
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    arguments = sys.argv[sys.argv.index("--") + 1 :]
    sys.exit(main(*arguments[:4]))  # what else comes is the protocol's --json
