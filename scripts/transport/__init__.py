# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of scripts/bench_transport: each measures, and returns its tables as they stand on docs/speed.md."""
