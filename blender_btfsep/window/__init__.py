# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons and what the user sets; each starts a run or changes the scene, undoably."""
