# SPDX-License-Identifier: GPL-3.0-or-later
"""Studies: what the estimate is worth beside other methods, and where it fails."""
