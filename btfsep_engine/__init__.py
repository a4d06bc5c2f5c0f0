# SPDX-License-Identifier: GPL-3.0-or-later
"""BTFsep: illumination from one photograph, known geometry and a library of digitised materials."""

__version__ = "0.1.0"
