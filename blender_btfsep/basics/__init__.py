# SPDX-License-Identifier: GPL-3.0-or-later
"""What all rooms of the add-on share; nothing here knows of a job, a light or the engine."""
