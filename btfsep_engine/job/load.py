# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads a job folder: everything in it is checked here, so that later stages can trust it."""

import hashlib
from pathlib import Path

import numpy as np

from btfsep_engine import MAX_PIXELS
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.conventions import direction_of_angles
from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.job.camera import Camera
from btfsep_engine.job.depth import closing_mesh, mesh_from_depth, shifted_mask
from btfsep_engine.job.meshes import load_mesh
from btfsep_engine.job.model import Job, JobObject, KnownLamp, Occluder, Photo, TriangleMesh
from btfsep_engine.job.photograph import fits, no_photo, read
from btfsep_engine.job.schema import KNOWN_TO, MAX_KNOWN_LAMPS, CameraSchema, JobSchema, SurfaceSchema, parse
from btfsep_engine.storage import atomic

RIGID = 1e-3  # largest departure of a camera's axes from unit length and right angles
SAME_LAMP = 1.0  # degrees between two known lamps: nearer, they are one that is named twice
BASE_COLOUR_SIDE = 2048  # of an image of base colours: larger ones are averaged down
MOST_FINISHES = 16  # of a surface: each has a table of its own
BASE_COLOUR_PIXELS = 2**26  # and these are too many: no camera says how many there are to be


def load_job(
    folder, *, with_photo: bool = True, colorspace: str | None = None, schema: JobSchema | None = None, suns=None
) -> Job:
    """Reads ``folder/job.json`` and all that it names.

    Parameters
    ----------
    folder : the job folder, or the path of the job.json in it
    with_photo : false: the image is not read and need not be there; the photo is black
    colorspace : instead of the job's ``image_colorspace``; None: as it says
    schema : instead of what ``job.json`` says, with the files of the folder (`job.poses`)
    suns : instead of the job's ``known_lamps``, elevation, azimuth and, maybe, accuracy of each, degrees; None: these

    Returns
    -------
    Job; ``warnings`` has, in words, what was left out on the way

    Raises InputError: the first thing that is wrong, in one sentence.
    """
    reader = _Folder(job_folder(folder))
    schema = schema or _schema(reader)
    if colorspace is not None:
        schema = schema.model_copy(update={"image_colorspace": colorspace})
    camera = camera_of(schema.camera)
    directions = [(lamp.direction, lamp.direction_stddev_degrees) for lamp in schema.known_lamps]
    if suns is None:
        lamps = known_lamps(directions, "job.json: known_lamps")
    else:
        lamps = known_lamps([(direction_of_angles(*s[:2]), *(s[2:] or [KNOWN_TO])) for s in suns], "--sun")
    notes: list[str] = []
    photo = _photo(reader, schema, camera, notes) if with_photo else no_photo(camera)
    names = [o.name for o in schema.objects]
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError("job.json: objects", f"two objects have the name '{name}'", "give them different names")
    if schema.depth is None and not schema.objects:
        raise InputError("job.json", "it has neither objects nor depth", "give the geometry of what is in the photo")
    if schema.depth is None:
        if any(schema.depth_shift):
            raise InputError("job.json: depth_shift", "the job has no depth", "leave it out; meshes go by the camera")
        for o in schema.objects:
            if o.mesh is None:
                raise InputError(f"object '{o.name}'", "it has no mesh, and the job has no depth", "name its mesh file")
        objects = tuple(_object(reader, o, camera, notes) for o in schema.objects)
    else:
        objects = (_depth_object(reader, schema, camera),)
        camera = camera.shifted(*schema.depth_shift)
    occluders = tuple(_occluder(reader, o, f"occluders[{i}]", notes) for i, o in enumerate(schema.occluders))
    return Job(
        folder=reader.folder,
        photo=photo,
        camera=camera,
        objects=objects,
        occluders=occluders,
        metres_per_unit=schema.metres_per_unit,
        exposure_ev=schema.exposure_ev,
        digest=reader.digest(),
        warnings=tuple(notes),
        image_colorspace=schema.image_colorspace,
        image_primaries=schema.image_primaries,
        known_lamps=lamps,
    )


def known_lamps(directions, what: str) -> tuple[KnownLamp, ...]:
    """Lamps of ``directions``, each (3,), of any length, with its standard deviation in degrees, checked.

    ``what`` : what to call them in an error. Raises InputError.
    """
    if len(directions) > MAX_KNOWN_LAMPS:
        raise InputError(what, f"it has {len(directions)} lamps", f"name at most {MAX_KNOWN_LAMPS}: the brightest")
    out: list[KnownLamp] = []
    for i, (direction, degrees) in enumerate(directions):
        direction = np.array(direction, np.float64)
        length = float(np.linalg.norm(direction))
        if not (np.isfinite(direction).all() and length > 1e-12):
            got = f"its direction is {direction.tolist()}"
            raise InputError(f"{what}[{i}]", got, "give a vector towards the lamp that is finite and not zero")
        direction = direction / length
        for j, other in enumerate(out):
            if direction @ other.direction > np.cos(np.radians(SAME_LAMP)):
                raise InputError(f"{what}[{i}]", f"it stands where lamp [{j}] stands", "name each lamp once")
        out.append(KnownLamp(direction, float(degrees)))
    return tuple(out)


def job_schema(folder) -> JobSchema:
    """What a job's ``job.json`` says; nothing that it names is looked at. Raises InputError."""
    return _schema(_Folder(job_folder(folder)))


def job_folder(place) -> Path:
    """The folder of a job, of which its job.json may be named, too. InputError where there is none."""
    place = Path(place)
    try:
        if place.name == "job.json" and place.is_file():
            return place.parent
        there, got = place.is_dir(), "there is no such folder"
    except (OSError, ValueError) as error:  # a name that no file can have
        there, got = False, getattr(error, "strerror", None) or str(error)
    if not there:
        raise InputError(f"job {place}", got, "give the folder that has the job.json")
    return place


def job_digest(folder) -> str:
    """`Job.digest` of the job as it is now, of which nothing but ``job.json`` is understood. Raises InputError."""
    reader = _Folder(job_folder(folder))
    schema = _schema(reader)
    named = [schema.image, schema.depth]
    for thing in (*schema.objects, *schema.occluders):
        images_of = [getattr(thing.surface, key, None) for key in ("base_color", "finish")]
        named += [thing.mesh, getattr(thing, "mask", None), *images_of]
    for name in named:
        if isinstance(name, str):
            reader.path(name, "job.json")
    return reader.digest()


class _Folder:
    """Files inside a folder, none outside it, and a hash of all that were used, each as it was before it was read."""

    def __init__(self, folder: Path):
        self.folder, self.root = folder, folder.resolve()
        self.used: dict[str, str] = {}

    def path(self, relative: str, what: str) -> Path:
        """The path of a file that job.json names. InputError unless it is a file inside the folder."""
        inside = InputError(
            what, f"'{relative}' is not inside the job folder", "put the file there and name it relatively"
        )
        plain = relative.replace("\\", "/")
        if plain.startswith("/") or plain[1:2] == ":" or "\0" in plain:
            raise inside
        path = self.folder / plain
        try:
            if not path.resolve().is_relative_to(self.root):
                if ".." in plain.split("/"):
                    raise inside
                got = f"'{relative}' is a link, or lies behind one, that leads out of the job folder"
                raise InputError(what, got, "copy the file there: a job can be moved and packed as it is")
            found, folder = path.is_file(), path.is_dir()
        except (OSError, RuntimeError, ValueError):
            found = folder = False
        if not found:
            got = f"'{relative}' is a folder" if folder else f"there is no file '{relative}' in the job folder"
            raise InputError(what, got, "check the name, or export the job again")
        if plain not in self.used:  # before it is read: a file that changes meanwhile is not the one that is called so
            try:
                self.used[plain] = atomic.digest(path)
            except OSError:  # who reads it says so
                self.used[plain] = ""
        return path

    def read(self, relative: str, what: str) -> bytes:
        return atomic.read_bytes(self.path(relative, what), what)

    def digest(self) -> str:
        """sha256 over the names and the bytes of all files used, hexadecimal."""
        total = hashlib.sha256()
        for name, content in sorted(self.used.items()):
            total.update(f"{name}\0{content}\n".encode())
        return total.hexdigest()


def _schema(reader: _Folder) -> JobSchema:
    return parse(JobSchema, "job.json", reader.read("job.json", "job.json"), kind="a BTFsep job")


def camera_of(schema: CameraSchema, *, name: str = "job.json: camera") -> Camera:
    """The camera that a file says, checked; ``name`` : what to call it in an error. Raises InputError."""
    if schema.width * schema.height > MAX_PIXELS:
        got = f"{schema.width} x {schema.height} pixels"
        raise InputError(name, got, f"at most {MAX_PIXELS // 10**6} million are taken")
    to_world = np.array(schema.to_world, np.float64)
    what = f"{name}.to_world"
    if not np.array_equal(to_world[3], [0, 0, 0, 1]):
        raise InputError(what, "its last row is not 0 0 0 1", "write it row by row, camera to world")
    axes = to_world[:3, :3]
    huge = np.abs(axes).max() > 1e9  # no rotation, and its products would overflow
    determinant = np.inf if huge else np.linalg.det(axes)
    if abs(determinant) < 1e-9:
        raise InputError(what, "the matrix is singular", "give the camera's position and rotation")
    if huge or np.abs(axes.T @ axes - np.eye(3)).max() > RIGID:
        raise InputError(what, "its axes are not of length 1 and at right angles", "leave out scale and shear")
    if determinant < 0:
        raise InputError(what, "it mirrors the scene", "the camera looks along its -Z with +X right and +Y up")
    if np.abs(to_world[:3, 3]).max() > 1e15:
        raise InputError(what, "the camera is absurdly far away", "check its position")
    lens = (schema.k1, schema.k2, schema.p1, schema.p2)
    orthographic = schema.projection == "orthographic"
    size = schema.width, schema.height, schema.fx, schema.fy, schema.cx, schema.cy
    camera = Camera(*size, to_world, lens, orthographic)
    if orthographic and any(lens):
        got = "it is orthographic and has a lens distortion"
        raise InputError(name, got, "leave k1, k2, p1 and p2 out, or undistort the photo")
    if camera.folded:
        got = "its distortion folds the picture over before its edge"
        raise InputError(name, got, "check k1, k2, p1 and p2: they belong to coordinates over fx and fy")
    return camera


def _photo(reader: _Folder, schema: JobSchema, camera: Camera, notes: list) -> Photo:
    path = reader.path(schema.image, "job.json: image")
    coding = schema.image_colorspace, schema.image_primaries
    return read(path, schema.image, coding, camera, notes)


def placed(matrix, what: str):
    """An object's ``to_world`` (4, 4) float64, checked, or None. Raises InputError."""
    if matrix is None:
        return None
    matrix = np.array(matrix, np.float64)
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise InputError(f"{what}: to_world", "its last row is not 0 0 0 1", "write it row by row, object to world")
    size = np.abs(matrix[:3, :3]).max()
    if not 0 < size < 1e15 or abs(np.linalg.det(matrix[:3, :3] / size)) < 1e-12:
        raise InputError(f"{what}: to_world", "the matrix is singular", "no axis may be scaled to zero")
    return matrix


def _mesh(reader: _Folder, schema, what: str, notes: list) -> TriangleMesh:
    path = reader.path(schema.mesh, f"{what}: mesh")
    mesh, dropped = load_mesh(path, to_world=placed(schema.to_world, what), name=schema.mesh)
    if dropped:
        notes.append(f"{schema.mesh}: {dropped} of {dropped + len(mesh.faces)} triangles have no area and are left out")
    return mesh


def _mask(reader: _Folder, schema, camera: Camera):
    if schema.mask is None:
        return None
    path = reader.path(schema.mask, f"object '{schema.name}': mask")
    fits(images.declared_size(path), schema.mask, camera)
    mask = images.read_mask(path)
    fits(mask.shape[::-1], schema.mask, camera)
    if not mask.any():
        raise InputError(schema.mask, "the mask is empty", "paint what may be used white, or set it to null")
    return mask


def _object(reader: _Folder, schema, camera: Camera, notes: list) -> JobObject:
    mesh = _mesh(reader, schema, f"object '{schema.name}'", notes)
    if schema.uv == "mesh" and mesh.corner_uv is None:
        raise InputError(schema.mesh, "it has no usable UV map, and uv is 'mesh'", "export its UV map or use 'xatlas'")
    surface = _object_surface(reader, schema, mesh)
    uv = schema.uv if surface is None or surface.image is None else "mesh"
    return JobObject(schema.name, mesh, _mask(reader, schema, camera), schema.material, uv, surface=surface)


def _occluder(reader: _Folder, schema, what: str, notes: list) -> Occluder:
    mesh = _mesh(reader, schema, what, notes)
    surface = _surface(reader, schema.surface, mesh, what)
    if surface is not None and any(surface.emission):
        notes.append(f"{what}: surface; it has emission, which is left out; what it reflects is followed")
    return Occluder(mesh, surface, schema.evidence, schema.name or "")


def _object_surface(reader: _Folder, schema, mesh: TriangleMesh) -> Surface | None:
    """The surface of an object to fit."""
    if schema.surface is None:
        return None
    what = f"object '{schema.name}'"
    if schema.material is not None:
        raise InputError(what, "it has a material and a surface", "keep one of them")
    if any(schema.surface.emission):
        raise InputError(f"{what}: surface", "it has emission", "leave it out: what shines tells nothing of the light")
    return _surface(reader, schema.surface, mesh, what)


def _surface(reader: _Folder, schema: SurfaceSchema | None, mesh: TriangleMesh, what: str) -> Surface | None:
    if schema is None:
        return None
    numbers = {k: getattr(schema, k) for k in ("roughness", "metallic", "specular", "coat", "coat_roughness")}
    numbers |= {"sheen_roughness": schema.sheen_roughness, "left_out": tuple(schema.left_out)}
    numbers |= {k: tuple(getattr(schema, k)) for k in ("sheen", "emission")}
    if not isinstance(schema.base_color, str):
        if schema.finish is not None:
            got = "it has a finish, and its base_color is no image"
            raise InputError(f"{what}: surface", got, "give an image of base colours of the same size")
        return Surface(tuple(schema.base_color), **numbers)
    image = _base_colours(reader.path(schema.base_color, f"{what}: surface"), schema.base_color)
    if mesh.corner_uv is None:
        raise InputError(
            f"{what}: surface", "its base_color is an image, and the mesh has no UV map", "export one, or give a colour"
        )
    finish = None if schema.finish is None else _finish(reader.path(schema.finish, f"{what}: surface"), schema, image)
    surface = Surface(image=image, finish=finish, **numbers)
    if len(surface.kinds()) > MOST_FINISHES:
        got = f"it has {len(surface.kinds())} kinds of roughness, metallic and specular, and {MOST_FINISHES} may be"
        raise InputError(schema.finish, got, "group those that are alike")
    return surface


def _finish(path: Path, schema: SurfaceSchema, image) -> np.ndarray:
    """(n, n, 3) float32, numbers as they are, in [0, 1], of the size of an ``image`` of base colours."""
    values = images.read_linear(path, colorspace="linear", primaries="rec709", max_pixels=BASE_COLOUR_PIXELS).pixels
    if values.shape != image.shape:
        got = f"it has {values.shape[1]} x {values.shape[0]} pixels and {schema.base_color} {len(image)} x {len(image)}"
        raise InputError(schema.finish, got, "write both square and of one size")
    if not ((values >= 0) & (values <= 1)).all():
        raise InputError(schema.finish, "some of its numbers are not within 0 and 1", "write shares")
    return values


def _base_colours(path: Path, name: str) -> np.ndarray:
    """(n, n, 3) float32, linear, in [0, 1]."""
    pixels = images.read_linear(path, max_pixels=BASE_COLOUR_PIXELS).pixels
    good = (pixels >= -1e-3) & (pixels <= 1 + 1e-3)  # and no NaN; halves round
    if not good.all():
        rows, columns = np.nonzero(~good.all(-1))
        got = f"{len(rows)} of its colours are not within 0 and 1, first x {columns[0]}, y {rows[0]}"
        raise InputError(name, got, "a base colour is a share of light; no light may be in it")
    return images.resized(np.clip(pixels, 0, 1), min(max(pixels.shape[:2]), BASE_COLOUR_SIDE))


def _depth_object(reader: _Folder, schema: JobSchema, camera: Camera) -> JobObject:
    if any(o.mesh is not None for o in schema.objects):
        raise InputError("job.json", "it has both depth and meshes of objects", "keep one of them")
    if len(schema.objects) > 1:
        raise InputError("job.json: objects", "a job with depth has one surface", "keep one object")
    path = reader.path(schema.depth, "job.json: depth")
    fits(images.declared_size(path), schema.depth, camera)
    depth = images.read_depth(path)
    fits(depth.shape[::-1], schema.depth, camera)
    bad = np.isnan(depth) | (depth < 0)
    if bad.any():
        rows, columns = np.nonzero(bad)
        got = f"{len(rows)} depths are NaN or negative, first x {columns[0]}, y {rows[0]}"
        raise InputError(schema.depth, got, "write 0 or inf where nothing is")
    mesh = mesh_from_depth(depth, camera)
    if mesh is None:
        raise InputError(schema.depth, "there is no surface in it", "write the z-depth in world units")
    unseen = closing_mesh(depth, camera)
    if not schema.objects:
        return JobObject("surface", mesh, unseen=unseen)
    o = schema.objects[0]
    if o.to_world is not None or o.uv == "mesh":
        raise InputError(f"object '{o.name}'", "a surface from depth takes no to_world and no uv 'mesh'", "remove them")
    surface = _object_surface(reader, o, mesh)
    mask = _mask(reader, o, camera)
    mask = None if mask is None else shifted_mask(mask, *schema.depth_shift)
    return JobObject(o.name, mesh, mask, o.material, unseen=unseen, surface=surface)
