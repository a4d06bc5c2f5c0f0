# SPDX-License-Identifier: GPL-3.0-or-later
"""Files on disk, and what a process keeps: whole or not there, one writer at a time, bounded."""
