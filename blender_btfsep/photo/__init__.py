# SPDX-License-Identifier: GPL-3.0-or-later
"""The photo and its camera: files, frames, what they say of themselves. Nothing here asks the engine."""
