# SPDX-License-Identifier: GPL-3.0-or-later
"""Sets of candidates: they hold the right one as often as they say, and are empty where nothing is like the photo."""

import numpy as np
import pytest

from btfsep_engine.pipeline.verification import EXPLANATIONS, IS_PLAIN, SIMILARITIES
from btfsep_engine.recognise.judgement import Judgement, judged, judgements, utilities

NAMES = tuple("abcdef")


def photographs(rng, count, *, spread=1.0):
    """Utilities (count, 6) of which the right one's, the first, is larger by 2, give or take ``spread``."""
    out = rng.normal(size=(count, len(NAMES)))
    out[:, 0] += rng.normal(2.0, spread, count)
    return out


def strangeness(utilities, none):
    return np.sort([-np.log(judged(u, none, np.zeros(20)).probabilities[0]) for u in utilities])


def test_probabilities_are_those_of_a_multinomial_regression(rng):
    u = rng.normal(size=6)
    found = judged(u, 0.7, np.arange(30.0))
    total = np.exp(u).sum() + np.exp(0.7)
    np.testing.assert_allclose(found.probabilities, np.exp(u) / total)
    assert found.none == pytest.approx(np.exp(0.7) / total)


@pytest.mark.parametrize("none", [-20.0, 0.0, 1.5])
def test_sets_hold_the_right_material_as_often_as_they_say(none):
    """Over many tables of 60 photographs, whatever the scores mean: the coverage of a new one is 95 % or a bit more."""
    rng, held = np.random.default_rng(1), []
    for _ in range(400):
        known = strangeness(photographs(rng, 60), none)
        held += [judged(u, none, known).likely[0] for u in photographs(rng, 5)]
    assert 0.935 < np.mean(held) < 0.975


def test_a_set_has_what_the_photo_does_not_tell_apart_and_nothing_else(rng):
    known = strangeness(photographs(rng, 200, spread=0.1), 0.0)
    model = Judgement({"cue": 1.0}, 0.0, known)
    answer = model.answer(NAMES, {"cue": np.array([4.0, 3.9, -3, -3, -3, -3])})
    assert answer.likely == ("a", "b") and not answer.unknown and answer.unknown_score < 1
    assert answer.material == "a" and sum(score for _, score in answer.candidates) == pytest.approx(1)
    sure = model.answer(NAMES, {"cue": np.array([8.0, 0, -3, -3, -3, -3])})
    assert sure.likely == ("a",)


def test_nothing_like_the_photo_is_unknown(rng):
    known = strangeness(photographs(rng, 200, spread=0.1), 0.0)
    model = Judgement({"cue": 1.0}, 0.0, known)
    answer = model.answer(NAMES, {"cue": np.array([-4.0, -5, -6, -6, -6, -6])})
    assert answer.unknown and answer.likely == () and answer.unknown_score > 1 and answer.material == "a"


@pytest.mark.parametrize(
    ("library", "plain", "unknown", "material", "likely"),
    [
        (-4.0, 4.0, True, "a", ("surface/plastic",)),  # like nothing that the library has
        (3.9, 4.0, False, "surface/plastic", ("surface/plastic", "a")),  # the photo does not tell them apart
        (4.0, -4.0, False, "a", ("a",)),
        (-5.0, -6.0, True, "a", ()),  # like nothing at all: the likeliest of the plain ones, for want of a better
    ],
)
def test_a_plain_surface_may_be_it_and_is_none_of_the_librarys(rng, library, plain, unknown, material, likely):
    model = Judgement({"cue": 1.0}, 0.0, strangeness(photographs(rng, 200, spread=0.1), 0.0))
    names = ("a", "b", "surface/matte", "surface/plastic")
    answer = model.answer(names, {"cue": np.array([library, -9.0, -9.0, plain])}, plain=names[2:])
    assert answer.unknown is unknown and answer.material == material and answer.likely == likely
    assert answer.stand_in == ("surface/plastic" if unknown else None) and (answer.unknown_score > 1) is unknown


def test_the_limit_of_strangeness_is_where_the_p_value_crosses_the_level(rng):
    for count in (19, 20, 59, 200):
        known = np.sort(rng.exponential(size=count))
        for u in rng.normal(0, 3, (200, 6)):
            found = judged(u, 0.0, known)
            assert ((found.strangeness > 1) == ~found.likely).all()


def test_of_few_photographs_nothing_is_ruled_out():
    found = judged(np.array([-50.0, -60.0]), 0.0, np.linspace(0, 1, 18))
    assert found.likely.all() and (found.strangeness == 0).all()


def test_the_shipped_table_is_of_enough_lights_and_asks_for_cues_that_there_are():
    explained = {"classifier", *EXPLANATIONS}
    every = explained | {*SIMILARITIES}
    every |= {IS_PLAIN}
    cues = {"verified": every, "spoilt": every, "grainy": every, "explained": explained, "votes": {"classifier"}}
    for name, model in judgements().items():
        assert set(model.weights) == cues[name] and len(model.strangeness) >= 19
        assert (np.diff(model.strangeness) >= 0).all() and np.isfinite(model.strangeness).all()
    assert utilities({"a": 2.0, "b": 1.0}, {"a": [1, 2], "b": [3, 4]}).tolist() == [5, 8]
