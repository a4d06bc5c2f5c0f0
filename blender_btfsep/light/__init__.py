# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that was found: World, lamps, its card and files, and how it is kept with the scene."""
