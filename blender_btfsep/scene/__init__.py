# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects and what stands around them as a job's files: meshes, materials, bakes."""
