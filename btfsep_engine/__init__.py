# SPDX-License-Identifier: GPL-3.0-or-later
"""BTFsep: illumination from one photograph, known geometry and a library of digitised materials."""

import os

__version__ = "0.1.0"
MAX_PIXELS = 2**27  # of an image that is decoded: 4 GB

# OpenCV reads these when it is loaded, by whichever module comes first
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MAX_PIXELS))
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # its own complaints, on stderr, would stand beside ours
