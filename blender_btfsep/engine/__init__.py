# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine as a child process: where it is, what it can be told, how long it takes, whether it works."""
