# SPDX-License-Identifier: GPL-3.0-or-later
from btfsep_engine.cli import main

raise SystemExit(main())
