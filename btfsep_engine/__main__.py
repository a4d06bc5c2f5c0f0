# SPDX-License-Identifier: GPL-3.0-or-later
import sys

if not sys.flags.safe_path:
    # the current folder: a json.py among the photographs is not ours to run; what Python itself imports before this
    # line only -P can keep from there
    del sys.path[0]
from btfsep_engine.cli import main

raise SystemExit(main())
