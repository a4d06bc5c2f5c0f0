# SPDX-License-Identifier: GPL-3.0-or-later
"""``.btf`` files as materials: read one, look at its header, write one. The parts are in :mod:`btf.formats`.

In a file, cos(theta_i) may be multiplied in (the header's flag says so); in memory it never is.
"""

from btfsep_engine.btf.formats.header import Header
from btfsep_engine.btf.formats.ubo2014 import open_btf
from btfsep_engine.btf.formats.writing import write
from btfsep_engine.btf.linear import CLASSES, to_material
from btfsep_engine.btf.model import Tabulated

__all__ = ["CLASSES", "Header", "read", "read_header", "write"]


def read(path, data=None, **options) -> Tabulated:
    """Reads a ``.btf`` file into memory.

    Parameters
    ----------
    path : path of the file
    data : its bytes, where they are mapped already
    options : name, material_class, cosine, components, flip_v, reporter of :func:`btf.linear.to_material`

    Raises
    ------
    InputError
        Not such a file, cut short, inconsistent, not finite, or of a kind that is not supported.
    """
    return to_material(open_btf(path, data), **options)


def read_header(path) -> Header:
    """The :class:`Header` of a ``.btf`` file, with its height map (mm) when it holds one. Errors as :func:`read`."""
    return open_btf(path).header
