# SPDX-License-Identifier: GPL-3.0-or-later
"""Bidirectional texture functions: the material in memory, its files, the library, procedural meso-structure."""
