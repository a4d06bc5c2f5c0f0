# SPDX-License-Identifier: GPL-3.0-or-later
"""Image files: read, written, and what their headers, colours and curves mean."""
