# SPDX-License-Identifier: GPL-3.0-or-later
"""A material library: a folder of ``.btf`` files and ``index.json``, which says what they are.

The index is written last, so that a library which is being built is the one before or the one after, never half.
"""

import difflib
import json
import stat
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from btfsep_engine.btf import linear
from btfsep_engine.btf.formats.mapped import map_file, sha256
from btfsep_engine.btf.model import Lambertian, Material, Mirror, Tabulated
from btfsep_engine.btf.surfaces import GIVEN, SURFACES
from btfsep_engine.errors import InputError
from btfsep_engine.storage import atomic, kept
from btfsep_engine.storage.cache import digest
from btfsep_engine.storage.lock import locked

INDEX = "index.json"
MAX_INDEX_BYTES = 16 << 20
NAME = r"^[a-z0-9]+/[A-Za-z0-9_][A-Za-z0-9._-]*$"  # not "..", nothing that a command takes for an option
REFERENCE = {  # materials of every library, without a file; a new kind of material (btf/model.py) is named here
    "reference/white-diffuse": Lambertian("reference/white-diffuse", np.full(3, 0.8)),
    "reference/grey18": Lambertian("reference/grey18", np.full(3, 0.18)),
    "reference/chrome": Mirror("reference/chrome", np.array([0.55, 0.556, 0.554])),
}
Side = Annotated[int, Field(gt=0, le=1 << 24)]


class Entry(BaseModel):
    """One material of a library."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False, defer_build=True)

    name: str = Field(pattern=NAME, max_length=100)
    material_class: str = Field(alias="class", max_length=50)
    file: str = Field(pattern=r"^[A-Za-z0-9_-][A-Za-z0-9._-]*\.btf$", max_length=150)  # a plain name: no way out
    texel_mm: float = Field(gt=0, lt=1000)
    texels: tuple[Side, Side]  # height, width
    components: int = Field(gt=0, le=4096)
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    size: int = Field(gt=0, lt=1 << 53)  # bytes
    relative_error: float | None = Field(None, ge=0)  # of the factorisation against the measurement, its noise included
    source: str = Field("", max_length=300)  # what it was imported from
    made_by: str = Field("", max_length=300)  # digest of settings and maps; a build with the same one is not repeated


class Index(BaseModel):
    """``index.json``."""

    format: Literal["btfsep-library"]
    version: Literal[1]
    materials: list[Entry] = Field(max_length=100_000)


@dataclass(frozen=True)
class Library:
    """An opened library.

    Attributes
    ----------
    folder : Path
    entries : dict, name -> :class:`Entry`, in the index's order; the reference materials and the surfaces by numbers
        are not among them
    """

    folder: Path
    entries: dict

    def names(self) -> list:
        """All names that :meth:`load` takes: the library's, the reference materials', those of surfaces by numbers."""
        return [*self.entries, *(name for name in (*REFERENCE, *SURFACES) if name not in self.entries)]

    @property
    def digest(self) -> str:
        """A hash of every material's name and content, for the keys of caches."""
        return digest([(e.name, e.sha256) for e in sorted(self.entries.values(), key=lambda e: e.name)])

    def without_colours(self) -> "Library":
        """The same materials as a black-and-white photo shows them."""
        return GreyLibrary(self.folder, self.entries)

    def content(self, name: str) -> str:
        """A text that tells a material's content from others'."""
        return self.entries[name].sha256 if name in self.entries else name

    def load(self, name: str) -> Material:
        """The material called ``name``.

        Raises InputError: an unknown name (the nearest is suggested); a file that is missing or not the one in the
        index.
        """
        if name in self.entries:
            return self._load_file(self.entries[name])
        if name in REFERENCE:
            return REFERENCE[name]
        if name in SURFACES:
            from btfsep_engine.render.homogeneous import homogeneous  # the renderer takes long to import

            return homogeneous(SURFACES[name], name)
        raise unknown_material(name, self.names())

    def _load_file(self, entry: Entry) -> Tabulated:
        path = self.folder / entry.file
        try:
            found = path.stat()
        except OSError:
            return self._read_file(entry, path)
        parts = [str(path.absolute()), found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns]
        parts += [entry.name, entry.material_class, entry.sha256, entry.size]
        return kept.recalled("material", parts, lambda: self._read_file(entry, path))

    def _read_file(self, entry: Entry, path: Path) -> Tabulated:
        try:
            data = map_file(path)
        except InputError as error:
            raise InputError(
                f"material '{entry.name}'", f"{path}: {error.got}", "build or download the library again"
            ) from error
        if len(data) != entry.size or sha256(data) != entry.sha256:
            raise InputError(
                f"material '{entry.name}'",
                f"{path} is not the file in the index",
                "build or download the library again",
            )
        # the bytes that were hashed, whatever is put in the file's place meanwhile
        return linear.read(path, data=data, name=entry.name, material_class=entry.material_class)

    def show(self, name: str) -> dict:
        """Facts about a material: name, class, kind, mean albedo (3 floats, under light from everywhere), for those
        with a file file, size (bytes), texels, texel_mm, patch_mm, components, relative_error, and for surfaces by
        numbers these.

        Raises InputError as :meth:`load`.
        """
        material = self.load(name)
        facts = {"name": name, "class": material.material_class, "kind": type(material).__name__.lower()}
        facts["mean_albedo"] = [round(float(v), 4) for v in material.diffuse_albedo()]
        entry = self.entries.get(name)
        if entry is None:
            return facts | (SURFACES[name].numbers() if name in SURFACES else {})
        return facts | {
            "file": entry.file,
            "size": entry.size,
            "texels": list(entry.texels),
            "texel_mm": entry.texel_mm,
            "patch_mm": [round(n * entry.texel_mm, 3) for n in entry.texels],
            "components": entry.components,
            "directions": [len(material.views), len(material.lights)],
            "relative_error": entry.relative_error,
        }


class GreyLibrary(Library):
    """A library of the same names, whose materials have no colours."""

    def without_colours(self) -> "GreyLibrary":
        return self

    def content(self, name: str) -> str:
        return f"{super().content(name)} without colours"

    @property
    def digest(self) -> str:
        return digest(super().digest, "without colours")

    def load(self, name: str) -> Material:
        material = super().load(name)
        return kept.recalled("without colours", [material], material.without_colours)


def open_library(path=None) -> Library:
    """Opens a library folder; None: the one that is shipped.

    Raises InputError: no such folder, no index in it, or an index that is not valid.
    """
    folder = Path(str(resources.files("btfsep_engine") / "data" / "library")) if path is None else Path(path)
    index_path = folder / INDEX
    try:
        found = index_path.stat()
        if found.st_size > MAX_INDEX_BYTES or not stat.S_ISREG(found.st_mode):  # reading a pipe would wait for ever
            raise InputError(str(index_path), "it is too large, or no file, for an index", "give a library's folder")
        index = Index.model_validate_json(index_path.read_bytes())
    except OSError as error:
        raise InputError(
            f"library {folder}",
            f"it has no readable {INDEX} ({error.strerror})",
            "give a library's folder, or make one: btfsep library build",
        ) from error
    except ValidationError as error:
        first = error.errors()[0]
        got = ": ".join(filter(None, (".".join(str(part) for part in first["loc"]), first["msg"])))
        raise InputError(str(index_path), got, "build or download the library again") from error
    entries = {entry.name: entry for entry in index.materials}
    if len(entries) != len(index.materials):
        raise InputError(str(index_path), "two materials have the same name", "rename one of them")
    return Library(folder, entries)


def entries_of(folder) -> dict:
    """The entries of a library's index, name -> :class:`Entry`; empty where there is no index yet."""
    return dict(open_library(folder).entries) if (Path(folder) / INDEX).exists() else {}


@contextmanager
def changing(folder):
    """Yields the entries of ``folder``, read under a lock; what the block makes of them is the new index.

    Two processes may add to one folder at once: each sees what the other has added. On an error nothing is written.
    """
    with locked(folder):
        entries = entries_of(folder)
        yield entries
        _write_index(Path(folder), entries)


def _write_index(folder: Path, entries: dict) -> None:
    ordered = [entries[name].model_dump(by_alias=True, mode="json") for name in sorted(entries)]
    index = {"format": "btfsep-library", "version": 1, "materials": ordered}
    atomic.write_text(folder / INDEX, json.dumps(index, indent=1) + "\n")


def unknown_material(name: str, names) -> InputError:
    """The error of a name that a library does not have; ``names``: those that it has."""
    if name == GIVEN:
        return InputError(
            f"material '{name}'", "it is made from the key 'surface' of an object", "give that key in every job"
        )
    from btfsep_engine.btf import procedural  # a library that has all that it is asked for starts without it

    if name in procedural.NAMES:
        return InputError(
            f"material '{name}'", "it is not in the library", f"make it: btfsep library build FOLDER --only {name}"
        )
    near = difflib.get_close_matches(name, names, 1, 0.0)
    hint = f"did you mean '{near[0]}'? " if near else ""
    return InputError(f"material '{name}'", "it is not in the library", f"{hint}btfsep library list shows all names")


def is_whole(folder: Path, entry: Entry) -> bool:
    """Whether the file of an entry is there and is what the index says."""
    path = folder / entry.file
    return path.is_file() and path.stat().st_size == entry.size and atomic.digest(path) == entry.sha256
