# SPDX-License-Identifier: GPL-3.0-or-later
"""Honest test photographs: Cycles renders truly displaced objects under Blender's own studio lights.

Imported as ``scripts.cycles`` (the name ``cycles`` alone is Blender's). Nothing here uses the engine's renderer
or its material tables: the photographs and the estimates come from two different renderers and two different
models of a material.
"""

COVERAGE = "coverage.npy"  # beside a photograph: (h, w), how much of each pixel shows the object
