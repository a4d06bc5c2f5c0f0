# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray tracing and light transport; the only room that imports mitsuba and drjit."""
