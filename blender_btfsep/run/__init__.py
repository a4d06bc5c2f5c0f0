# SPDX-License-Identifier: GPL-3.0-or-later
"""One run: what is asked, why it cannot be, the operator that waits, and what is done with the answer."""
