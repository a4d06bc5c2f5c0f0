# SPDX-License-Identifier: GPL-3.0-or-later
"""Recognition of the material of an object in a photo (the paper, section 3.2); see ``docs/results/recognition.md``."""

from btfsep_engine.imaging import images  # noqa: F401  before OpenCV: it says what that may decode
from btfsep_engine.recognise.recogniser import Recogniser, Recognition
from btfsep_engine.recognise.training import METHODS, Method, TrainingImage, render_samples, train

__all__ = ["METHODS", "Method", "Recogniser", "Recognition", "TrainingImage", "render_samples", "train"]
