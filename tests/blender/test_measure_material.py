# SPDX-License-Identifier: GPL-3.0-or-later
"""A material's maps baked from its nodes, the scene left as it was, and the engine's run behind them."""

import json
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from blender_btfsep.basics.errors import InputError
from blender_btfsep.light.advice import advice
from blender_btfsep.scene import bake
from blender_btfsep.window import measure
from scripts.cycles import studio

N = 64
SIZE_MM = 40.0
MEAN_OF_PIXEL = 0.02  # a pixel's value is the mean of some places in it


@pytest.fixture
def thing(scene):
    """An object with a material of its own; what the scene shows is a cube, not the square that is measured."""
    bpy.ops.mesh.primitive_cube_add(size=0.1)
    cube = bpy.context.object
    cube.data.materials.append(new_material("Checked Noise!"))
    return cube


def new_material(name):
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    return material


class Nodes:
    """Short words for building a node tree."""

    def __init__(self, material):
        self.tree = material.node_tree
        self.shader, self.output = self.tree.nodes["Principled BSDF"], self.tree.nodes["Material Output"]

    def add(self, kind, **inputs):
        node = self.tree.nodes.new("ShaderNode" + kind)
        for name, value in inputs.items():
            self.put(value, node.inputs[name.replace("_", " ")])
        return node

    def put(self, value, target):
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, target)
        else:
            target.default_value = value

    def waves(self):
        """0.5 + 0.5 sin(2 pi (2 u + v)) of the UV map."""
        uv = self.add("SeparateXYZ", Vector=self.add("TexCoord").outputs["UV"])
        phase = self.math("MULTIPLY_ADD", uv.outputs["X"], 4 * np.pi, self.math("MULTIPLY", uv.outputs["Y"], 2 * np.pi))
        return self.math("MULTIPLY_ADD", self.math("SINE", phase), 0.5, 0.5)

    def math(self, operation, *values):
        node = self.tree.nodes.new("ShaderNodeMath")
        node.operation = operation
        for target, value in zip(node.inputs, values, strict=False):
            self.put(value, target)
        return node.outputs[0]


def grid():
    return np.meshgrid(*[(np.arange(N) + 0.5) / N] * 2)


def expected_waves():
    u, v = grid()
    return 0.5 + 0.5 * np.sin(2 * np.pi * (2 * u + v))


def baked(thing, **options):
    return bake.bake_material(thing.active_material, size=0.04, resolution=N, **options)


def checker(nodes):
    """Checks of 4 x 4 over the square, in UV."""
    return nodes.add(
        "TexChecker",
        Vector=nodes.add("TexCoord").outputs["UV"],
        Scale=4.0,
        Color1=(0.6, 0.3, 0.1, 1),
        Color2=(0.05, 0.1, 0.2, 1),
    ).outputs["Color"]


def expected_checker():
    u, v = grid()
    first = ((np.floor(4 * u) + np.floor(4 * v)) % 2 == 1)[..., None]  # Blender begins with Color2
    return np.where(first, [0.6, 0.3, 0.1], [0.05, 0.1, 0.2])


def agree_on_checks(found):
    """Exactly within the checks; at their edges Blender 5 takes a sample or two of a pixel's neighbour."""
    expected = expected_checker()
    inside = np.tile(np.isin(np.arange(N) % (N // 4), [0, N // 4 - 1], invert=True), (N, 1))
    inside &= inside.T
    assert inside.sum() > 0.7 * N * N
    np.testing.assert_allclose(found[inside], expected[inside], atol=1e-4)
    np.testing.assert_allclose(found, expected, atol=0.15)


def test_a_checker_with_a_bump_of_noise(thing):
    """Colour and constant roughness exactly; the bump's height is the noise, read here by a bake of its own."""
    nodes = Nodes(thing.active_material)
    noise = nodes.add("TexNoise", Vector=nodes.add("TexCoord").outputs["UV"], Scale=3.0)
    height = noise.outputs["Fac"] if "Fac" in noise.outputs else noise.outputs["Factor"]
    bump = nodes.add("Bump", Height=height, Distance=0.002, Strength=0.5)
    nodes.put(checker(nodes), nodes.shader.inputs["Base Color"])
    nodes.put(0.35, nodes.shader.inputs["Roughness"])
    nodes.put(bump.outputs["Normal"], nodes.shader.inputs["Normal"])
    found = baked(thing)
    agree_on_checks(found.base_colour)
    np.testing.assert_allclose(found.roughness, 0.35, atol=1e-6)
    assert found.normal is None and found.f0 == pytest.approx(0.04, abs=1e-4) and not found.warnings

    other = new_material("noise alone")
    again = Nodes(other)
    noise = again.add("TexNoise", Vector=again.add("TexCoord").outputs["UV"], Scale=3.0)
    again.put(noise.outputs[0], again.shader.inputs["Roughness"])
    alone = bake.bake_material(other, size=0.04, resolution=N).roughness
    assert np.ptp(alone) > 0.2
    np.testing.assert_allclose(found.height, 0.5 * 0.002 * alone, atol=1e-7)
    bump.invert = True
    np.testing.assert_allclose(baked(thing).height, -0.5 * 0.002 * alone, atol=1e-7)


def test_displacement_is_height_times_scale_from_the_middle(thing):
    nodes = Nodes(thing.active_material)
    displacement = nodes.add("Displacement", Height=nodes.waves(), Midlevel=0.25, Scale=0.004)
    nodes.put(displacement.outputs[0], nodes.output.inputs["Displacement"])
    expected = (expected_waves() - 0.25) * 0.004
    np.testing.assert_allclose(baked(thing, scale=3.0).height, 3 * expected, atol=0.004 * 3 * MEAN_OF_PIXEL)
    displacement.space = "WORLD"
    np.testing.assert_allclose(baked(thing, scale=3.0).height, expected, atol=0.004 * MEAN_OF_PIXEL)
    bump = nodes.add("Bump", Height=nodes.waves(), Distance=0.001, Strength=1.0)
    nodes.put(bump.outputs[0], nodes.shader.inputs["Normal"])
    both = expected + 0.001 * expected_waves()
    np.testing.assert_allclose(baked(thing).height, both, atol=0.005 * MEAN_OF_PIXEL)


def test_roughness_follows_its_map_also_past_reroutes(thing):
    nodes = Nodes(thing.active_material)
    reroute = nodes.tree.nodes.new("NodeReroute")
    nodes.put(nodes.waves(), reroute.inputs[0])
    nodes.put(reroute.outputs[0], nodes.shader.inputs["Roughness"])
    found = baked(thing)
    np.testing.assert_allclose(found.roughness, expected_waves(), atol=MEAN_OF_PIXEL)
    assert "The material is measured as flat" in [advice(w).short for w in found.warnings] and not found.height.any()


def test_a_normal_map_is_given_on_as_it_is(thing, tmp_path):
    """Tangent space of the square: u along +x, v along +y."""
    u, v = grid()
    slope = 0.3 * np.stack([np.cos(2 * np.pi * (2 * u + v)) * 2, np.cos(2 * np.pi * (2 * u + v))], -1)
    n = np.concatenate([-slope, np.ones((N, N, 1))], -1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    image = bpy.data.images.new("n", N, N, float_buffer=True, is_data=True)
    image.pixels.foreach_set(np.concatenate([n / 2 + 0.5, np.ones((N, N, 1))], -1).astype(np.float32).ravel())
    nodes = Nodes(thing.active_material)
    texture = nodes.tree.nodes.new("ShaderNodeTexImage")
    texture.image, texture.interpolation = image, "Closest"
    thing.data.uv_layers[0].name = "Mine"
    normal_map = nodes.add("NormalMap", Color=texture.outputs["Color"])
    normal_map.uv_map = "Mine"
    nodes.put(normal_map.outputs[0], nodes.shader.inputs["Normal"])
    found = baked(thing, uv_names=["Mine"])
    assert found.height is None
    np.testing.assert_allclose(found.normal, n, atol=0.015)
    options = bake.write_maps(found, tmp_path / "maps", millimetres=1000)
    assert "--height-mm" not in options and (tmp_path / "maps" / "normal_gl.exr").is_file()


def state():
    """How many there are of everything, and what the user sees of the scene."""
    counts = {
        name: len(getattr(bpy.data, name))
        for name in dir(bpy.data)
        if isinstance(getattr(bpy.data, name), bpy.types.bpy_prop_collection)
    }
    context = bpy.context
    nodes = [
        (m.name, m.users, [(n.name, n.type, n.select) for n in m.node_tree.nodes], len(m.node_tree.links))
        for m in bpy.data.materials
        if m.node_tree
    ]
    seen = context.scene.name, context.object.name, [o.name for o in context.selected_objects], context.mode
    return counts, nodes, seen, [(s.name, s.render.engine, s.cycles.samples) for s in bpy.data.scenes]


def test_the_scene_is_as_it_was(thing, tmp_path):
    nodes = Nodes(thing.active_material)
    nodes.put(checker(nodes), nodes.shader.inputs["Base Color"])
    before = state()
    measure.write_maps(
        bpy.context.scene, thing, thing.active_material, tmp_path / "maps", size_mm=SIZE_MM, resolution=N
    )
    assert state() == before
    nodes.put(nodes.add("BsdfDiffuse").outputs[0], nodes.output.inputs["Surface"])
    before = state()
    with pytest.raises(InputError):
        baked(thing)
    assert state() == before


def test_what_is_written_is_in_millimetres_and_the_right_way_up(thing, scene, tmp_path):
    scene.unit_settings.scale_length = 0.01  # a unit is a centimetre
    nodes = Nodes(thing.active_material)
    displacement = nodes.add("Displacement", Height=nodes.waves(), Scale=0.3)
    displacement.space = "WORLD"
    nodes.put(displacement.outputs[0], nodes.output.inputs["Displacement"])
    options, _ = measure.write_maps(
        scene, thing, thing.active_material, tmp_path / "maps", size_mm=SIZE_MM, resolution=N
    )
    assert options[options.index("--height-mm") + 1] == 1
    height = studio.read_image(tmp_path / "maps" / "height.exr")[::-1, :, 0]
    expected = 3.0 * (expected_waves() - expected_waves().mean())
    np.testing.assert_allclose(height, expected, atol=3 * MEAN_OF_PIXEL)
    measure.write_maps(
        scene, thing, thing.active_material, tmp_path / "maps", size_mm=SIZE_MM, height_mm=1.5, resolution=N
    )
    assert np.ptp(studio.read_image(tmp_path / "maps" / "height.exr")[..., 0]) == pytest.approx(1.5, rel=1e-3)


def spoil(nodes, material, how):
    if how == "no surface":
        nodes.tree.links.clear()
        return "nothing is at its Surface; connect a Principled BSDF"
    if how == "another shader":
        nodes.put(nodes.add("BsdfDiffuse").outputs[0], nodes.output.inputs["Surface"])
        return "'Diffuse BSDF', which cannot be measured"
    if how == "no output":
        nodes.tree.nodes.remove(nodes.output)
        return "it has no Material Output"
    if how == "a vector":
        nodes.put(nodes.add("VectorDisplacement").outputs[0], nodes.output.inputs["Displacement"])
        return "'Vector Displacement', which gives no height"
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    node = nodes.tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    nodes.put(node.outputs[0], nodes.output.inputs["Surface"])
    return "its surface is the group 'Group'; ungroup it"


@pytest.mark.parametrize("how", ["no surface", "another shader", "no output", "a vector", "group"])
def test_a_bad_material_gets_a_sentence(thing, how):
    words = spoil(Nodes(thing.active_material), thing.active_material, how)
    with pytest.raises(InputError) as caught:
        baked(thing)
    assert words in str(caught.value) and "material 'Checked Noise!'" in str(caught.value)


@pytest.mark.parametrize("place", ["Base Color", "Displacement"])
def test_a_map_whose_file_is_gone_is_not_measured_pink(thing, scene, tmp_path, place):
    nodes, picture = Nodes(thing.active_material), bpy.data.images.new("rust", 8, 8)
    picture.source, picture.filepath = "FILE", str(tmp_path / "rust.png")
    (map_ := nodes.add("TexImage")).image = picture
    nodes.put(map_.outputs["Color"], (nodes.output if place == "Displacement" else nodes.shader).inputs[place])
    with pytest.raises(InputError, match="the file of image 'rust' is not there; find it"):
        measure.write_maps(scene, thing, thing.active_material, tmp_path / "maps", size_mm=SIZE_MM, resolution=N)
    assert not (tmp_path / "maps").exists()


def test_what_is_not_measured_is_said(thing):
    nodes = Nodes(thing.active_material)
    nodes.put(1.0, nodes.shader.inputs["Coat Weight"])
    nodes.put(nodes.add("Attribute").outputs["Color"], nodes.shader.inputs["Base Color"])
    said = " ".join(baked(thing).warnings)
    assert "Coat Weight is not measured" in said and "'Attribute' looks at the object" in said


def test_metal_is_baked_and_the_engine_finds_it(thing, tmp_path):
    from btfsep_engine.btf.map_files import find_maps
    from btfsep_engine.btf.texture_maps import read_maps

    nodes = Nodes(thing.active_material)
    nodes.put((0.94, 0.7, 0.3, 1), nodes.shader.inputs["Base Color"])
    assert baked(thing).metallic is None
    nodes.put(nodes.waves(), nodes.shader.inputs["Metallic"])
    found = baked(thing)
    np.testing.assert_allclose(found.metallic, expected_waves(), atol=MEAN_OF_PIXEL)
    bake.write_maps(found, tmp_path / "maps", millimetres=1000)
    assert find_maps(tmp_path / "maps").metallic.name == "metallic.exr"
    read = read_maps(tmp_path / "maps", name="stone/x", size_mm=40.0, height_mm=1.0, resolution=N).maps
    np.testing.assert_allclose(read.metallic, found.metallic, atol=1e-3)


RESULT = {"name": "stone/checks", "file": "stone_checks.btf", "library": "there", "relief_mm": 0.5, "measured": True}


def test_the_button_bakes_and_starts_the_engine(thing, fake_engine, tmp_path):
    log = tmp_path / "log"
    fake_engine(log=str(log), lines=[{"type": "done", "result": RESULT}])
    library = str(tmp_path / "lib")
    before = state()
    options = {"name": "checks", "material_class": "stone", "size_mm": 25.0, "library": library, "texels": 40}
    assert bpy.ops.btfsep.measure_material(**options) == {"FINISHED"}
    assert state() == before
    run = bpy.context.window_manager.btfsep
    assert "stone/checks" in run.summary and not run.error and any("flat" in w.name for w in run.warnings)
    arguments = json.loads(log.read_text())
    assert arguments[:2] == ["library", "measure"]
    given = dict(zip(arguments[2:-1:2], arguments[3:-1:2], strict=True))
    assert (given["--name"], given["--class"], given["--library"]) == ("checks", "stone", library)
    assert float(given["--size-mm"]) == 25 and given["--texels"] == "40" and float(given["--f0"]) == pytest.approx(0.04)
    assert not (tmp_path / given["--maps"]).exists()  # removed with the run


def test_the_button_needs_a_library_and_a_material(thing, fake_engine):
    with pytest.raises(RuntimeError, match="the material library; none is chosen"):
        bpy.ops.btfsep.measure_material()
    thing.data.materials.clear()
    with pytest.raises(RuntimeError, match="Select an object that has a material"):
        bpy.ops.btfsep.measure_material()
    assert measure.default_name(bpy.data.materials["Checked Noise!"]) == "Checked-Noise"


def test_the_command_line(thing, fake_engine, tmp_path, capsys):
    from blender_btfsep import command

    log, maps, lib = tmp_path / "log", tmp_path / "maps", tmp_path / "lib"
    engine = fake_engine(log=str(log), lines=[{"type": "done", "result": RESULT}])
    bpy.context.preferences.addons["blender_btfsep"].preferences.library = str(tmp_path / "another")
    words = ["measure", "--engine", engine, "--class", "stone", "--size-mm", "25", "--resolution", "32"]
    assert command.main([*words, "--library", str(lib), "--maps", str(maps), "--object", "Cube", "--seed", "7"]) == 0
    assert str(lib / "stone_checks.btf") in capsys.readouterr().out
    arguments = json.loads(log.read_text())
    assert arguments[arguments.index("--name") + 1] == "Checked-Noise"
    assert arguments[arguments.index("--seed") + 1] == "7" and arguments.count("--library") == 1
    assert arguments[arguments.index("--library") + 1] == str(lib)
    assert sorted(p.name for p in maps.iterdir()) == ["basecolor.exr", "height.exr", "roughness.exr"]
    for faulty, said in (
        (["--object", "Teapot"], "object 'Teapot'"),
        (["--material", "Nothing"], "it has no material 'Nothing'; choose from 'Checked Noise!'"),
        (["--height-mm", "26"], "the height; 26 mm"),
        (["--resolution", "9"], "9 pixels"),
    ):
        assert command.main([*words, *faulty]) == 2
        error = capsys.readouterr().err
        assert error.startswith("error: ") and said in error and error.count("\n") == 1
    thing.data.materials.clear()
    assert command.main(words) == 2
    assert "object 'Cube'; it has no material" in capsys.readouterr().err


def test_the_engine_reads_what_was_baked(thing, scene, tmp_path):
    """The same places, the same millimetres on both sides."""
    from btfsep_engine.btf.texture_maps import read_maps

    nodes = Nodes(thing.active_material)
    displacement = nodes.add("Displacement", Height=nodes.waves(), Scale=0.002)
    displacement.space = "WORLD"
    nodes.put(displacement.outputs[0], nodes.output.inputs["Displacement"])
    nodes.put(checker(nodes), nodes.shader.inputs["Base Color"])
    options, _ = measure.write_maps(scene, thing, thing.active_material, tmp_path / "m", size_mm=SIZE_MM, resolution=N)
    height_mm = float(options[options.index("--height-mm") + 1])
    found = read_maps(tmp_path / "m", name="stone/x", size_mm=SIZE_MM, height_mm=height_mm, resolution=N).maps
    expected = 2.0 * (expected_waves() - expected_waves().mean())
    np.testing.assert_allclose(found.height_mm, expected, atol=2 * MEAN_OF_PIXEL)
    agree_on_checks(found.base_colour)


def test_the_class_is_told_by_the_name():
    assert [measure.class_in(name) for name in ("Brown Leather", "METAL.003", "Wallpaper old", "Material")] == [
        "leather",
        "metal",
        "wallpaper",
        "",
    ]


def test_a_material_whose_name_tells_no_class_begins_as_plastic(addon):
    asked = bpy.ops.btfsep.measure_material.get_rna_type().properties["material_class"]
    assert asked.default == "plastic" in asked.enum_items.keys()


def test_a_dialog_that_lacks_its_library_says_so(addon, thing):
    """In the words of the run that it begins, no traceback; an operator has no annotations in Python 3.14."""
    operator, said = measure.BTFSEP_OT_measure_material, []
    known = bpy.ops.btfsep.measure_material.get_rna_type().properties
    assert {*measure.ASKED, "ask", "rna_type"} == set(known.keys())
    given = {name: known[name].default for name in measure.ASKED} | {"name": "cloth"}
    dialog = SimpleNamespace(**given, _asked=True, report=lambda *told: said.append(told))
    assert operator.execute(dialog, bpy.context) == {"CANCELLED"}
    ((kind, sentence),) = said
    assert kind == {"ERROR"} and sentence.startswith("the material library; none is chosen")
