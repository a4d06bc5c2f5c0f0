# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender objects as triangles in world space, modifiers applied as a render would apply them."""

from contextlib import contextmanager

import bpy
import numpy as np

SURFACE_TYPES = {"MESH", "CURVE", "SURFACE", "FONT", "META"}
STRANDS = {"CURVES": "hair", "POINTCLOUD": "points", "VOLUME": "volume"}  # what a render shows that has no faces
FINE, FINEST = 100_000, 6  # faces that take the place of those of a pixel's size, and the levels that make them
VIEWPORT = ("hide_viewport", "show_instancer_for_viewport", "show_viewport", ".levels")  # what a render has of its own


def has_surface(thing) -> bool:
    """Whether an object may have faces: of its own, or those of a collection that it instances."""
    if thing.type in SURFACE_TYPES:
        return True
    held = thing.instance_collection if thing.instance_type == "COLLECTION" else None
    return held is not None and any(has_surface(each) for each in held.all_objects)


def names_of(things) -> list:
    """A name for each object: its own, or with its library's where another of them has that, too."""
    own = [thing.name for thing in things]
    return [thing.name if own.count(thing.name) == 1 else thing.name_full for thing in things]


def triangles_of_mesh(mesh, matrix) -> dict | None:
    """The triangles of an evaluated ``bpy.types.Mesh`` under ``matrix : (4, 4)``.

    Returns
    -------
    dict with "positions" (f, 3, 3) float64, "normals" (f, 3, 3) float64 unit (smooth, flat or custom, as shown),
    "vertex" (f, 3) int, "uv" (f, 3, 2) float32 or None (the UV map that is active for rendering); None if there
    are no faces. Corners run counter-clockwise seen from outside, also under a mirroring matrix.
    """
    mesh.calc_loop_triangles()
    faces = len(mesh.loop_triangles)
    if not faces:
        return None
    loops = np.empty(3 * faces, np.int32)
    mesh.loop_triangles.foreach_get("loops", loops)
    vertex = np.empty(3 * faces, np.int32)
    mesh.loop_triangles.foreach_get("vertices", vertex)
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    normals = np.empty(3 * len(mesh.loops), np.float32)
    mesh.corner_normals.foreach_get("vector", normals)

    matrix = np.asarray(matrix, np.float64)
    linear = matrix[:3, :3]
    world = points.reshape(-1, 3).astype(np.float64) @ linear.T + matrix[:3, 3]
    # Normals turn with the cofactor matrix, det(M) M^-T, without its sign: outward stays outward when mirrored.
    cofactor = np.array(
        [np.cross(linear[1], linear[2]), np.cross(linear[2], linear[0]), np.cross(linear[0], linear[1])]
    )
    mirrored = np.linalg.det(linear) < 0
    turned = normals.reshape(-1, 3).astype(np.float64) @ (-cofactor if mirrored else cofactor).T
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    turned = np.divide(turned, length, out=np.zeros_like(turned), where=length > 0)

    uv = None
    layer = next((layer for layer in mesh.uv_layers if layer.active_render), None)
    if layer is not None:
        flat = np.empty(2 * len(mesh.loops), np.float32)
        layer.uv.foreach_get("vector", flat)
        uv = flat.reshape(-1, 2)[loops].reshape(-1, 3, 2)
    result = {
        "positions": world[vertex].reshape(-1, 3, 3),
        "normals": turned[loops].reshape(-1, 3, 3),
        "vertex": vertex.reshape(-1, 3).astype(np.int64),
        "uv": uv,
    }
    if mirrored:
        result = {key: None if value is None else value[:, ::-1] for key, value in result.items()}
    return result


def joined(parts: list[dict]) -> dict:
    """Several meshes as one. Texture coordinates are kept only where all have them."""
    if len(parts) == 1:
        return parts[0]
    offset, vertex = 0, []
    for part in parts:
        vertex.append(part["vertex"] + offset)
        offset += int(part["vertex"].max()) + 1
    whole = {key: np.concatenate([part[key] for part in parts]) for key in ("positions", "normals", "materials")}
    whole["vertex"] = np.concatenate(vertex)
    whole["areas"] = {}
    for part in parts:
        for material, area in part["areas"].items():
            whole["areas"][material] = whole["areas"].get(material, 0.0) + area
    has_uv = all(part["uv"] is not None for part in parts)
    whole["uv"] = np.concatenate([part["uv"] for part in parts]) if has_uv else None
    return whole


def _materials(positions, mesh, slots) -> dict:
    """ "materials", (f,) of each triangle (the original one, or None), and "areas", {of each: its area}."""
    slot = np.empty(len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("material_index", slot)
    area = np.linalg.norm(np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0]), axis=1) / 2
    own = np.array([each.material and each.material.original for each in slots] or [None], object)
    slot = np.minimum(slot, len(own) - 1)  # a number beyond the last slot stands for the last one
    areas = {}
    for material, total in zip(own, np.bincount(slot, area, len(own)), strict=True):
        if total > 0:
            areas[material] = areas.get(material, 0.0) + float(total)
    return {"materials": own[slot], "areas": areas}


def without(part: dict, material) -> dict | None:
    """Triangles of `gather` without those of ``material`` (or None: of no material); None where no others are left."""
    areas = {each: area for each, area in part["areas"].items() if each != material}
    if not areas:
        return None
    kept, arrays = part["materials"] != material, ("positions", "normals", "vertex", "materials", "uv")
    left = {key: part[key] if part[key] is None else part[key][kept] for key in arrays}
    return {**left, "areas": areas}


def gather(depsgraph, owners) -> dict:
    """The triangles of each object in ``owners`` (original objects), with all that it instances.

    Returns
    -------
    dict, object name -> dict as triangles_of_mesh gives, "materials", (f,) Material or None, and "areas", {of each: its
    area}; objects without faces are absent
    """
    wanted = {owner.name_full for owner in owners}
    parts: dict[str, list] = {}
    for instance in depsgraph.object_instances:
        owner = (instance.parent if instance.is_instance else instance.object).original
        if owner.name_full not in wanted or not instance.show_self:
            continue
        evaluated = instance.object
        if evaluated.type not in SURFACE_TYPES:
            continue
        mesh = evaluated.to_mesh()
        if mesh is None:
            continue
        part = triangles_of_mesh(mesh, instance.matrix_world)
        if part is not None:
            part |= _materials(part["positions"], mesh, evaluated.material_slots)
        evaluated.to_mesh_clear()
        if part is not None:
            parts.setdefault(owner.name_full, []).append(part)
    return {name: joined(list_of) for name, list_of in parts.items()}


def rendered_objects(view_layer) -> set:
    """The objects of ``view_layer`` that a render shows, whatever the viewport hides.

    A collection that is excluded or not rendered hides what is in it, below it too; an object that is also elsewhere is
    shown. Holdout and indirect-only collections count: what is in them casts shadows.
    """
    found = set()

    def walk(layer):
        if layer.exclude or layer.collection.hide_render:
            return
        found.update(thing for thing in layer.collection.objects if not thing.hide_render)
        for child in layer.children:
            walk(child)

    walk(view_layer.layer_collection)
    return found


def render_occluders(view_layer, depsgraph, excluded) -> list:
    """The objects that a render shows and that cast shadows, without those in ``excluded``. Original objects."""
    rendered = {thing.name_full for thing in rendered_objects(view_layer) - set(excluded) if thing.visible_shadow}
    found = {}
    for instance in depsgraph.object_instances:
        owner = (instance.parent if instance.is_instance else instance.object).original
        if owner.name_full in rendered and instance.object.type in SURFACE_TYPES:
            found[owner.name_full] = owner
    return [found[name] for name in sorted(found)]


def not_as_rendered(things) -> list:
    """Sentences about objects whose modifiers `as_rendered` cannot have as a render has them: linked ones."""

    def differs(modifier):
        levels = getattr(modifier, "levels", 0) != getattr(modifier, "render_levels", 0)
        return modifier.show_viewport != modifier.show_render or (levels and modifier.show_render)

    linked = sorted(t.name for t in things if t.library is not None and any(differs(m) for m in t.modifiers))
    return [
        f"object '{name}' is linked from another file: its modifiers are as the viewport has them" for name in linked
    ]


def without_faces(depsgraph, owners, others) -> dict:
    """What a render shows of ``owners``, or grows on them, and of ``others``, that has no faces.

    Gives {original object: words}.
    """
    wanted, found = {*owners, *others}, {}
    for instance in depsgraph.object_instances:
        owner = (instance.parent if instance.is_instance else instance.object).original
        words = STRANDS.get(instance.object.type)
        if words and owner in wanted:
            grown_on = owner.data.surface if owner.type == "CURVES" else None
            found[grown_on if grown_on in owners else owner] = words
    for owner in wanted:
        for modifier in owner.modifiers:
            grown = modifier.particle_system.settings if modifier.type == "PARTICLE_SYSTEM" else None
            if grown and modifier.show_render and (grown.type, grown.render_type) == ("HAIR", "PATH") and grown.count:
                found[owner] = STRANDS["CURVES"]
    return found


def _levels_in_render(thing, modifier, scene) -> int:
    """How often a render subdivides; where Cycles does down to a pixel's size, as often as is fine enough here."""
    adaptive = getattr(modifier, "use_adaptive_subdivision", False) or (
        getattr(getattr(thing, "cycles", None), "use_adaptive_subdivision", False)
        and scene.cycles.feature_set == "EXPERIMENTAL"
    )
    last = thing.modifiers[-1] == modifier
    if not (adaptive and last and scene.render.engine == "CYCLES" and thing.type == "MESH"):
        return modifier.render_levels
    finer = int(np.log2(max(FINE / max(len(thing.data.polygons), 1), 1)) / 2)
    return max(modifier.render_levels, min(finer, FINEST))


_changing = 0


def is_as_rendered() -> bool:
    """Whether `as_rendered` or `unheard` lasts: what Blender then says has changed is not the user's doing."""
    return _changing > 0


@contextmanager
def unheard():
    """While it lasts, nobody takes what Blender says has changed for the user's doing."""
    global _changing
    _changing += 1
    try:
        yield
    finally:
        _changing -= 1


@contextmanager
def as_rendered(view_layer, objects, *, chosen=()):
    """While it lasts, the viewport shows what a render would: what is hidden, and the modifiers of ``objects``.

    ``chosen`` are shown in any case: what the photo shows may be hidden in the render, as a stand-in is.
    """
    global _changing
    changed = []

    def put(owner, name, value):
        old = getattr(owner, name)
        if old != value:
            changed.append((owner, name, old))
            setattr(owner, name, value)

    def show(layer):
        """Lifts what hides a collection in the viewport; gives whether a chosen object is in it."""
        put(layer, "hide_viewport", False)
        below = [show(child) for child in layer.children]
        holds = any(below) or any(thing in chosen for thing in layer.collection.objects)
        if holds:
            put(layer.collection, "hide_viewport", False)
        return holds

    hidden = [thing for thing in view_layer.objects if thing.hide_get(view_layer=view_layer)]
    _changing += 1
    try:
        for thing in bpy.data.objects:
            for driver in thing.animation_data.drivers if thing.animation_data else ():
                if driver.data_path.endswith(VIEWPORT):  # it would have the last word
                    put(driver, "mute", True)
        for collection in bpy.data.collections:  # all of them: instances show those that the scene has not
            put(collection, "hide_viewport", collection.hide_render)
        for thing in bpy.data.objects:
            put(thing, "hide_viewport", thing.hide_render and thing not in chosen)
            put(thing, "show_instancer_for_viewport", thing.show_instancer_for_render)
        show(view_layer.layer_collection)
        for thing in hidden:
            thing.hide_set(False, view_layer=view_layer)
        for thing in objects:
            if thing.library is not None:
                continue  # linked from another file: as that file shows it
            edited = thing.mode == "EDIT"  # it has modifiers and shape keys of its own choice there
            if edited and thing.type == "MESH":
                put(thing, "use_shape_key_edit_mode", True)
            for modifier in thing.modifiers:
                put(modifier, "show_viewport", modifier.show_render)
                if edited:
                    put(modifier, "show_in_editmode", modifier.show_render)
                if isinstance(modifier, bpy.types.SubsurfModifier):
                    put(modifier, "levels", _levels_in_render(thing, modifier, view_layer.id_data))
                elif isinstance(modifier, bpy.types.MultiresModifier):
                    put(modifier, "levels", modifier.render_levels)
            data = thing.data
            for finer in ("resolution", "resolution_u", "resolution_v"):  # of metaballs; of curves, where 0 is the same
                if getattr(data, f"render_{finer}", 0) and data.library is None:
                    put(data, finer, getattr(data, f"render_{finer}"))
            for system in thing.particle_systems:
                if system.settings.library is None:
                    put(system.settings, "display_percentage", 100)
        render = view_layer.id_data.render
        if render.use_simplify:
            put(render, "simplify_subdivision", render.simplify_subdivision_render)
            put(render, "simplify_child_particles", render.simplify_child_particles_render)
        yield
    finally:
        try:
            for owner, name, old in reversed(changed):
                setattr(owner, name, old)
            for thing in hidden:
                thing.hide_set(True, view_layer=view_layer)
            if changed or hidden:
                view_layer.update()
        finally:
            _changing -= 1
