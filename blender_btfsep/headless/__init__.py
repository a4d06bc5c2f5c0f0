# SPDX-License-Identifier: GPL-3.0-or-later
"""Without a window: the words of `blender --command btfsep`."""
