# SPDX-License-Identifier: GPL-3.0-or-later
"""Measuring the active object's material into a material library: its maps are baked, the engine measures them."""

import os
import re
import shutil
import tempfile
from pathlib import Path

import bpy
from bpy.props import BoolProperty, FloatProperty, StringProperty

from ..basics.errors import InputError
from ..engine import engine_settings, preferences
from ..run import buttons, runs
from ..scene import bake, surroundings
from . import library, properties

RESOLUTION = 512  # pixels along an edge of the baked maps


def material_of(thing):
    """The active material of an object. Raises InputError."""
    if thing is None:
        raise InputError("the active object", "there is none", "select the object whose material is to be measured")
    if thing.active_material is None:
        raise InputError(f"object '{thing.name}'", "it has no material", "give it one, or select another object")
    return thing.active_material


def default_name(material) -> str:
    """The material's name as the library takes names: letters, digits, dots, - and _."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", material.name).strip("-.") or "material"


def class_in(name: str) -> str:
    """The class that a material's name tells; empty where it tells none."""
    return next((kind for kind in engine_settings.CLASSES_OF_MATERIAL if kind in name.lower()), "")


def library_folder(folder: str = "") -> Path:
    """Where a measured material goes: ``folder``, else the preferences' library. Raises InputError."""
    folder = folder or preferences.get().library
    if not folder:
        raise InputError(
            "the material library",
            "none is chosen, and the engine's own is not written to",
            "choose a folder as Library, or in the preferences of BTFsep; it is made if it is not there",
        )
    return Path(bpy.path.abspath(folder)).absolute()


def write_maps(scene, thing, material, folder, *, size_mm: float, height_mm: float = 0.0, resolution=RESOLUTION):
    """Bakes the maps of ``material`` on ``thing`` into ``folder``.

    Parameters
    ----------
    scene : its unit scale says what a millimetre is
    thing : bpy.types.Object; its UV maps' names and its scale are used
    size_mm : edge of the square that is measured; UV 0 to 1, object coordinates around the origin
    height_mm : 0: as the material says; else what the lowest and the highest place differ by

    Returns
    -------
    options for the engine, warnings. Raises InputError
    """
    if not 0 <= height_mm <= size_mm:
        raise InputError("the height", f"{height_mm:g} mm", "give 0 (as the material says) to the size of the patch")
    gone = surroundings.missing_images(material, relief=True)
    if gone:
        cure = "find it (File > External Data > Find Missing Files)"
        raise InputError(f"material '{material.name}'", surroundings.GONE.format(gone[0].name), cure)
    millimetres = 1000 * scene.unit_settings.scale_length
    names = [layer.name for layer in thing.data.uv_layers] if thing.type == "MESH" else []
    grown = abs(thing.matrix_world.determinant()) ** (1 / 3)
    maps = bake.bake_material(
        material, size=size_mm / millimetres, resolution=resolution, uv_names=names or ("UVMap",), scale=grown
    )
    return bake.write_maps(maps, folder, millimetres=millimetres, height_mm=height_mm), maps.warnings


def engine_arguments(maps, name: str, library: Path, baked, properties, options=None) -> list:
    """The engine's command for baked maps, ``baked`` of :func:`write_maps`; ``options``: as of `request`."""
    told = engine_settings.engine_options(engine_settings.MEASURE, properties, options)
    return ["library", "measure", "--maps", maps, "--name", name, *baked, *told, "--library", library]


class BTFSEP_OT_measure_material(buttons.Greyed, runs.EngineOperator, bpy.types.Operator):
    """Measure the active object's material into the material library, as a BTF that photos can be matched with"""

    bl_idname = "btfsep.measure_material"
    bl_label = "Measure Material"
    bl_options = {"REGISTER"}
    task = "Measuring"

    name: StringProperty(
        name="Name", description="Its name in the library. Empty: the material's", options={"SKIP_SAVE"}
    )
    height_mm: FloatProperty(
        name="Height",
        description="From the lowest to the highest place, in millimetres. 0: as the material says",
        min=0,
    )
    library: StringProperty(
        name="Library",
        description="Folder of the library, made if it is not there. Empty: the preferences' one",
        subtype="DIR_PATH",
    )
    ask: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})

    @staticmethod
    def reason(context) -> str:
        if runs.is_running():
            return runs.RUNNING
        return "" if context.object and context.object.active_material else "Select an object that has a material"

    def invoke(self, context, event):
        if bpy.app.background or not self.ask:
            return super().invoke(context, event)
        material = material_of(context.object)
        self.name = self.name or default_name(material)
        self.material_class = class_in(material.name) or self.material_class
        self.library = self.library or preferences.get(context).library
        self._asked = True
        return context.window_manager.invoke_props_dialog(self, width=340)

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        for name in ASKED:
            empty = {"placeholder": "Choose a folder"} if name == "library" else {}
            layout.prop(self, name, **empty)
        words = engine_settings.measuring_words(self.size_mm, self.texels, self.samples, os.cpu_count() or 1)
        layout.label(text=words, icon="TIME")
        layout.label(text="Blender stays usable; what is measured is kept if it is stopped")

    def execute(self, context):
        if not getattr(self, "_asked", False):
            return super().execute(context)
        chosen = {name: getattr(self, name) for name in ASKED}
        try:
            bpy.ops.btfsep.measure_material("INVOKE_DEFAULT", ask=False, **chosen)  # the dialog ends, the run begins
        except RuntimeError as error:  # what the run has reported already
            self.report({"ERROR"}, str(error).removeprefix("Error: ").strip())
            return {"CANCELLED"}
        return {"FINISHED"}

    def begin(self, context):
        thing = context.object
        material = material_of(thing)
        library = library_folder(self.library)
        self._folder = Path(tempfile.mkdtemp(prefix="btfsep-maps-", dir=bpy.app.tempdir))
        try:
            baked, warnings = write_maps(
                context.scene, thing, material, self._folder, size_mm=self.size_mm, height_mm=self.height_mm
            )
        except InputError:
            self._clear()
            raise
        for warning in warnings:
            runs.run_state().warnings.add().name = warning
            self.report({"WARNING"}, warning)
        return engine_arguments(self._folder, self.name or default_name(material), library, baked, self)

    def _end(self, context, last):
        self._clear()
        return super()._end(context, last)

    def cancel(self, context):
        if not hasattr(self, "_folder"):
            return  # it is the dialog that is left: nothing was begun
        super().cancel(context)
        self._clear()

    def _clear(self):
        shutil.rmtree(self._folder, ignore_errors=True)

    def finish(self, context, result):
        if not result.get("measured", True):
            return f"{result['name']} is in the library already, measured in the same way"
        library.forget()
        return f"{result['name']} is in {result['library']}; relief {result['relief_mm']:.2g} mm"


_own = BTFSEP_OT_measure_material.__annotations__
_shown = {"name": _own["name"]} | properties.engine_properties(engine_settings.MEASURE) | _own  # in the dialog's order
BTFSEP_OT_measure_material.__annotations__ = _shown
ASKED = tuple(name for name in _shown if name != "ask")  # what the dialog shows


register, unregister = bpy.utils.register_classes_factory((BTFSEP_OT_measure_material,))
