# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of materials: UBO2014's ``.btf`` (reading and writing), and folders or zips of images."""
