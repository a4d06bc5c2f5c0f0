# SPDX-License-Identifier: GPL-3.0-or-later
"""The job folder: its schema, its photograph, its geometry."""
