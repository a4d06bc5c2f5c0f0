# SPDX-License-Identifier: GPL-3.0-or-later
"""What holds for all rings."""

import signal

# A shell starts what runs in the background with Ctrl-C ignored, and children inherit that: some are to be stopped.
signal.signal(signal.SIGINT, signal.default_int_handler)
