# SPDX-License-Identifier: GPL-3.0-or-later
"""The stages in order: the only room that knows more than one of them."""
