# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of the real window for the user guide: a photo is used, the example estimated, each step photographed.

    blender --factory-startup --python scripts/cycles/window.py -- FOLDER

in a Blender with a window (an Xvfb of 1600 x 1490 will do), with ImageMagick's ``import`` and a checkout that has its
.venv. FOLDER gets overlay.jpg (the 3D view), library.png, and of the example panel.png (the sidebar), report.png and
rendered.png.
"""

import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

import bpy

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import blender_btfsep  # noqa: E402
from blender_btfsep.run import runs  # noqa: E402

PHOTO = (900, 700)
COLOUR = (0.32, 0.09, 0.05, 1)


def window():
    return bpy.context.window_manager.windows[0]


def view():
    """The 3D view's area, its sidebar and its main region."""
    area = max((a for a in window().screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width * a.height)
    return area, *(next(r for r in area.regions if r.type == kind) for kind in ("UI", "WINDOW"))


def in_view():
    area, _, region = view()
    return bpy.context.temp_override(window=window(), area=area, region=region)


def picture(path, region=None, *, below: int = 0) -> None:
    """Photographs the screen, or a region's part of it without its lowest ``below`` pixels."""
    crop = []
    if region is not None:
        top = window().height - region.y - region.height
        crop = ["-crop", f"{region.width}x{region.height - below}+{region.x}+{top}"]
    subprocess.run(["import", "-window", "root", *crop, "+repage", str(path)], check=True)


def photographed(folder) -> str:
    """Makes the scene, a head in the morning sun, and its photograph; gives the photo's path."""
    scene = bpy.context.scene
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    bpy.data.objects.remove(bpy.data.objects["Light"])
    with in_view():
        bpy.ops.mesh.primitive_monkey_add(rotation=(-0.5, 0, 0.6))
        bpy.ops.object.shade_smooth()
    head = bpy.context.view_layer.objects.active
    head.name = "Head"  # the example's has Blender's own name
    head.modifiers.new("Smooth", "SUBSURF").render_levels = 2
    own = bpy.data.materials.new("Clay")
    own.use_nodes = True
    shader = own.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value, shader.inputs["Roughness"].default_value = COLOUR, 0.6
    head.data.materials.append(own)
    camera = scene.camera
    camera.data.lens = 70
    outside, scene.world = scene.world, bpy.data.worlds.new("Outside")
    scene.world.use_nodes = True
    tree = scene.world.node_tree
    sky = tree.nodes.new("ShaderNodeTexEnvironment")
    sky.image = bpy.data.images.load(
        str(Path(bpy.utils.system_resource("DATAFILES", path="studiolights")) / "world" / "sunrise.exr")
    )
    tree.links.new(sky.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    render = scene.render
    render.engine, render.resolution_x, render.resolution_y = "CYCLES", *PHOTO
    scene.cycles.samples, scene.cycles.use_denoising = 96, False
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.exposure = -0.7
    render.filepath = str(Path(folder) / "photo.png")
    bpy.ops.render.render(write_still=True)
    render.engine, render.resolution_x, render.resolution_y = "BLENDER_EEVEE_NEXT", 1920, 1080
    if render.engine != "BLENDER_EEVEE_NEXT":
        render.engine = "BLENDER_EEVEE"  # its name from 5.0 on
    scene.world, scene.view_settings.view_transform, scene.view_settings.exposure = outside, "AgX", 0.0
    return render.filepath


def steps(out: Path):
    """The pictures one after the other; yields the seconds to wait before the next step."""
    blender_btfsep.register()
    state, settings = runs.run_state(), bpy.context.scene.btfsep
    settings.image = bpy.data.images.load(photographed(tempfile.mkdtemp()))
    settings.curve = "srgb"  # it was saved with Standard, which a dark picture does not tell
    area, side, region = view()
    area.spaces.active.show_region_ui = True
    with in_view():
        bpy.ops.btfsep.add_objects()
        bpy.ops.btfsep.use_photo()
    yield 1.0
    with in_view():
        bpy.ops.view3d.view_center_camera()
    side.active_panel_category = "BTFsep"
    state.overlay = "OUTLINE"
    yield 2.0
    picture(out / "overlay.jpg", region, below=region.height // 12)
    state.overlay, settings.objects[0].source = "OFF", "LIBRARY"
    yield 1.0
    while not state.library and not state.library_error:
        yield 1.0
    settings.objects[0].material = "leather/brown-grain"
    area.tag_redraw()
    yield 2.0
    picture(out / "library.png", side, below=side.height // 3)
    with in_view():
        bpy.ops.btfsep.open_example()
    yield 1.0
    with in_view():
        bpy.ops.btfsep.estimate("INVOKE_DEFAULT")
    while state.running:
        yield 1.0
    if state.error:
        raise RuntimeError(state.error)
    area.tag_redraw()
    yield 2.0
    picture(out / "panel.png", side, below=side.height // 20)
    with in_view():
        bpy.ops.btfsep.show_report()
    yield 3.0
    picture(out / "report.png")
    for other in bpy.context.window_manager.windows[1:]:
        with bpy.context.temp_override(window=other):
            bpy.ops.wm.window_close()
    with in_view():
        bpy.ops.btfsep.rendered_view()
    yield 40.0
    picture(out / "rendered.png")


def main() -> None:
    out = Path(sys.argv[sys.argv.index("--") + 1])
    out.mkdir(parents=True, exist_ok=True)
    preferences = bpy.context.preferences
    preferences.view.show_splash, preferences.use_preferences_save = False, False
    going = steps(out)

    def step():
        try:
            return next(going)
        except StopIteration:
            pass
        except Exception:
            traceback.print_exc()
        bpy.ops.wm.quit_blender()
        return None

    bpy.app.timers.register(step, first_interval=2.0)


main()
