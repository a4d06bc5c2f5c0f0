# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a material of a library is what the index says, and what can exist."""

from btfsep_engine.btf import linear, reciprocity
from btfsep_engine.btf.formats.ubo2014 import open_btf
from btfsep_engine.btf.library import Library
from btfsep_engine.btf.model import Material, Tabulated
from btfsep_engine.errors import InputError

MAX_RECIPROCITY_ERROR = 0.3  # measured materials have up to 0.2
MAX_NEGATIVE = 0.01  # of the mean ABRDF's mean; factors overshoot a little


def check(library: Library, name: str) -> dict:
    """Looks a material over.

    Gives a dict: ``name``, ``ok``, ``problems`` (sentences), and as far as it could be read: ``albedo`` (least and
    largest directional-hemispherical reflectance of the mean ABRDF), ``reciprocity_error``, ``cosine`` (what the
    header says and what reciprocity says).

    Raises InputError: the library has no material of this name.
    """
    problems, facts = [], {}
    if name not in library.entries:
        problems = _physical(library.load(name), facts)  # a reference material, a surface by numbers, or InputError
        return {"name": name, "ok": not problems, "problems": problems, **facts}
    try:
        material = library.load(name)
        file = open_btf(library.folder / library.entries[name].file)
        problems += _against_index(library.entries[name], material)
        said = "included" if file.header.cosine_in_data else "excluded"
        found = linear.check_reciprocity(file).verdict
        facts["cosine"] = {"header": said, "reciprocity": found}
        if found not in (said, "unclear"):
            problems.append(f"the header says that the cosine is {said}, reciprocity says that it is {found}")
        problems += _physical(material, facts)
    except InputError as error:
        problems.append(f"{error.got} ({error.what})")
    return {"name": name, "ok": not problems, "problems": problems, **facts}


def _against_index(entry, material: Tabulated) -> list:
    problems = []
    if tuple(material.texels.shape[:2]) != tuple(entry.texels) or material.texels.shape[2] != entry.components:
        problems.append("texels or components are not those of the index")
    if abs(material.texel_mm / entry.texel_mm - 1) > 1e-3:
        problems.append(f"a texel is {material.texel_mm:.4g} mm, the index says {entry.texel_mm:.4g}")
    return problems


def _physical(material: Material, facts: dict) -> list:
    problems, albedo, table = [], material.directional_albedo(), material.table
    facts["albedo"] = [round(float(albedo.min()), 4), round(float(albedo.max()), 4)]
    if not albedo.max() < 1:
        problems.append(f"it reflects {albedo.max():.1%} of the light from some views, more than comes")
    error = reciprocity.reciprocity_error(table.mean_abrdf, table.views, table.lights)
    facts["reciprocity_error"] = round(error, 4)
    if error > MAX_RECIPROCITY_ERROR:
        problems.append(f"its mean is not reciprocal: relative error {error:.2f}")
    mean = table.mean_abrdf
    if mean.min() < -MAX_NEGATIVE * abs(mean.mean()):
        problems.append(f"its mean reflectance is negative for some directions ({mean.min():.2g})")
    return problems
