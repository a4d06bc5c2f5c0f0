# SPDX-License-Identifier: GPL-3.0-or-later
"""What `btfsep` does, a file each; they write the results, `pipeline` finds them."""
