# SPDX-License-Identifier: GPL-3.0-or-later
"""The presets: each takes more than the one before, and the paper's is the paper's."""

from dataclasses import asdict
from itertools import combinations, pairwise

import pytest

from btfsep_engine.errors import InputError
from btfsep_engine.pipeline.settings import PRESETS, choose
from btfsep_engine.recognise import METHODS

COSTS = ("pixels", "reflections", "surface_samples", "training_directions", "training_pixels", "training_turns")


def test_draft_balanced_and_accurate_take_more_one_after_the_other():
    for lesser, greater in pairwise(["draft", "balanced", "accurate"]):
        a, b = ([getattr(choose(name), cost) for cost in COSTS] for name in (lesser, greater))
        assert all(x <= y for x, y in zip(a, b, strict=True)), f"{greater} takes less than {lesser}"
        assert sum(x < y for x, y in zip(a, b, strict=True)) >= 3, f"{greater} is hardly more than {lesser}"
    assert choose("balanced").bounces == "auto" and choose("accurate").bounces == choose("accurate").reflections > 1


def test_no_two_presets_are_one():
    for (a, first), (b, second) in combinations(PRESETS.items(), 2):
        assert (first.preset, second.preset) == (a, b)
        assert {k: v for k, v in asdict(first).items() if k != "preset"} != {
            k: v for k, v in asdict(second).items() if k != "preset"
        }


def test_the_papers_preset():
    """Eq. 11 by least squares over all pixels with the mean ABRDF; recognised by the classifier alone, as in 3.2."""
    paper = choose("paper")
    assert (paper.estimator, paper.appearance, paper.pixels, paper.verify) == ("least-squares", "mean", 0, False)
    assert paper.bounces == choose("accurate").bounces  # reflections are part of the paper's renderings
    assert (paper.recogniser, paper.classifier) == ("paper", "svm")
    method = METHODS[paper.recogniser]
    assert (method.encoding.colour_words, method.encoding.sift_words, method.encoding.power) == (150, 250, 1.0)
    assert (method.encoding.root_sift, method.encoding.sift_components) == (False, 0)
    assert (method.as_photos, method.offsets, method.settings.white_balance) == (False, (True,), 0.0)
    assert all(choose(name).recogniser == "tuned" for name in PRESETS if name != "paper")


def test_what_is_not_said_stays_the_presets():
    assert choose("accurate", order=None, seed=3) == choose("accurate", seed=3) != choose("accurate")
    with pytest.raises(InputError, match="draft, balanced, accurate, paper"):
        choose("finest")
