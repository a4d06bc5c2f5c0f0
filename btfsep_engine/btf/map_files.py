# SPDX-License-Identifier: GPL-3.0-or-later
"""Which file of a folder is which texture map, by the names in use (ambientCG, Poly Haven, Substance, Blender)."""

import re
from dataclasses import dataclass
from pathlib import Path

from btfsep_engine.errors import InputError
from btfsep_engine.imaging.images import SUFFIXES

MAX_FILES = 10_000  # in a folder; more is no folder of maps
WORDS = {
    "base colour": "basecolor basecolour albedo diffuse diff diffusecolor color colour col",
    "height": "height heightmap displacement disp displace bump bumpmap",
    "roughness": "roughness rough rgh",
    "gloss": "gloss glossiness glossy smoothness",
    "normal": "normal normals normalmap nor nrm norm normalgl normaldx nrmgl nrmdx",
    "metallic": "metallic metalness metal",
    # known, and not used: a file called "leather_ao_rough_preview" is then not taken for roughness
    "other": "ao ambientocclusion occlusion opacity alpha mask specular spec emission "
    "emissive preview thumbnail thumb arm orm rma idmap cavity curvature translucency transmission anisotropy",
}
KIND = {word: kind for kind, words in WORDS.items() for word in words.split()}
OPENGL, DIRECTX = {"gl", "opengl", "ogl", "normalgl", "nrmgl"}, {"dx", "directx", "d3d", "normaldx", "nrmdx"}
CONVENTIONS = ("auto", "opengl", "directx")


@dataclass(frozen=True)
class MapFiles:
    """The maps of a folder; a kind that is not there is None.

    Attributes
    ----------
    base_colour, height, roughness, gloss, normal, metallic : Path or None
    normal_convention : "opengl" or "directx" where the file's name says it, else "auto"
    """

    base_colour: Path | None = None
    height: Path | None = None
    roughness: Path | None = None
    gloss: Path | None = None
    normal: Path | None = None
    normal_convention: str = "auto"
    metallic: Path | None = None

    def file_names(self) -> dict:
        """kind -> file name, of those that are measured."""
        rough = self.roughness or self.gloss
        paths = {"base colour": self.base_colour, "height": self.height, "normal": self.normal}
        paths["metallic"] = self.metallic
        paths["roughness" if self.roughness else "gloss"] = rough
        return {kind: path.name for kind, path in paths.items() if path}


def words_of(stem: str) -> list:
    """The words of a file's name, lower case: "Leather008_2K-PNG_NormalGL" -> leather008, 2k, png, normal, gl."""
    stem = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", stem)
    return [word for word in re.split(r"[^A-Za-z0-9]+", stem.lower()) if word]


def kind_of(stem: str) -> str | None:
    """The kind of map that a file's name says, by its last telling word ("rough_wood_diff" is a base colour)."""
    words = words_of(stem)
    for i in range(len(words) - 1, -1, -1):
        for word in (words[i - 1] + words[i] if i else "", words[i]):
            if word in KIND:
                return KIND[word]
    return None


def find_maps(folder, *, normal_convention: str = "auto") -> MapFiles:
    """Finds the maps of one material.

    Parameters
    ----------
    folder : with the maps, and possibly other files
    normal_convention : "auto", "opengl" or "directx"; decides between two normal maps

    Raises InputError: no such folder; base colour, roughness (or gloss), or height and normal both missing; two files
    of a kind.
    """
    folder = Path(folder)
    if normal_convention not in CONVENTIONS:
        raise InputError(
            "the convention of the normal map", f"'{normal_convention}'", f"choose from {', '.join(CONVENTIONS)}"
        )
    try:
        names = sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file())
    except OSError as error:
        raise InputError(f"the maps' folder {folder}", error, "give the folder that holds them") from error
    if len(names) > MAX_FILES:
        raise InputError(f"the maps' folder {folder}", f"it holds {len(names)} images", "give one material's folder")
    found = {kind: [p for p in names if kind_of(p.stem) == kind] for kind in WORDS}
    found["normal"] = _of_convention(found["normal"], normal_convention)
    for kind in ("base colour", "height", "roughness", "gloss", "normal", "metallic"):
        if len(found[kind]) > 1:
            raise InputError(
                f"the maps' folder {folder}",
                f"{len(found[kind])} files could be the {kind} map: {_listed(found[kind])}",
                "leave one of them in the folder",
            )
    missing = []
    if not found["base colour"]:
        missing.append("base colour (named like basecolor, albedo or diffuse)")
    if not found["roughness"] and not found["gloss"]:
        missing.append("roughness (or gloss; a plain grey picture will do)")
    if not found["height"] and not found["normal"]:
        missing.append("height (named like height, displacement or bump) or normal")
    if missing:
        there = f"among its images {_listed(names)}" if names else "it holds no images"
        raise InputError(
            f"the maps' folder {folder}", f"{there}: no map is named as {' nor '.join(missing)}", "add it or rename it"
        )
    one = {kind: paths[0] if paths else None for kind, paths in found.items()}
    by_name = _convention_of(one["normal"]) if one["normal"] else "auto"
    return MapFiles(
        base_colour=one["base colour"],
        height=one["height"],
        roughness=one["roughness"],
        gloss=one["gloss"],
        normal=one["normal"],
        normal_convention=by_name if normal_convention == "auto" else normal_convention,
        metallic=one["metallic"],
    )


def _convention_of(path: Path) -> str:
    words = set(words_of(path.stem))
    return "opengl" if words & OPENGL else "directx" if words & DIRECTX else "auto"


def _of_convention(paths, wanted: str) -> list:
    """Of normal maps in both conventions the wanted one (OpenGL unless told); otherwise all."""
    conventions = sorted(_convention_of(p) for p in paths)
    if conventions == ["directx", "opengl"]:
        return [p for p in paths if _convention_of(p) == ("directx" if wanted == "directx" else "opengl")]
    return paths


def _listed(paths, most: int = 8) -> str:
    names = [p.name for p in paths[:most]]
    return ", ".join(names) + (f" and {len(paths) - most} more" if len(paths) > most else "")
