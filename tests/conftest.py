# SPDX-License-Identifier: GPL-3.0-or-later
"""What holds for all rings."""

import signal

# A shell starts what is to run in the background with Ctrl-C ignored; children inherit that, and some are to be stopped.
signal.signal(signal.SIGINT, signal.default_int_handler)
