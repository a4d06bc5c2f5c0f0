# SPDX-License-Identifier: GPL-3.0-or-later
import sys

if not sys.flags.safe_path:
    del sys.path[0]  # the current folder: a json.py among the photographs is not ours to run
from btfsep_engine.cli import main

raise SystemExit(main())
