# SPDX-License-Identifier: GPL-3.0-or-later
"""Lightings: bases, environment maps, the natural lights for training, and their files."""
