# SPDX-License-Identifier: GPL-3.0-or-later
"""Least squares for the light, and how far two lights are apart."""
