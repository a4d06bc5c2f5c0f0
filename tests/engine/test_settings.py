# SPDX-License-Identifier: GPL-3.0-or-later
"""The presets: each takes more than the one before, and the paper's is the paper's."""

from dataclasses import asdict, fields, replace
from itertools import combinations, pairwise

import pytest

from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.job.schema import JobSchema
from btfsep_engine.pipeline.settings import CURVES, PRESETS, Settings, changed, choose, meanings
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


def test_every_setting_says_what_it_means_and_every_preset_is_within_the_ranges():
    assert {f.name for f in fields(Settings)} == {*meanings(Settings), "preset"}
    for name, settings in PRESETS.items():
        assert changed(settings, **{n: getattr(settings, n) for n in meanings(Settings)}) == settings, name


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("order", 10, "--order; '10'; choose 0 to 9, or auto"),
        ("order", "first", "--order; 'first'; choose"),
        ("order", 2.5, "--order; '2.5'"),
        ("pixels", "-1", "--pixels; '-1'; choose 0 or more"),
        ("pixels", "auto", "--pixels; 'auto'"),
        ("bounces", True, "--bounces; 'True'; choose 1 to 64, or auto"),
        ("verify", "no", "--verify; 'no'; choose true or false"),
        ("key_light", "always", "--key-light; 'always'; choose one of auto, never"),
    ],
)
def test_what_is_out_of_range_is_named_as_the_option(name, value, words):
    with pytest.raises(InputError) as caught:
        choose(**{name: value})
    assert words in str(caught.value)


def test_texts_of_a_command_line_are_taken_for_what_they_say():
    found = choose("draft", order="0", bounces="auto", pixels="70", colorspace="linear", verify=False)
    assert found == replace(PRESETS["draft"], order=0, bounces="auto", pixels=70, colorspace="linear", verify=False)
    assert isinstance(found.order, int)


def test_a_photos_curves_are_those_of_a_job_and_of_what_reads_it():
    assert list(CURVES) == JobSchema.model_json_schema()["properties"]["image_colorspace"]["enum"]
    assert set(CURVES) == {*images.COLORSPACES, "phone", "blender", "unknown"}


def test_values_that_do_not_go_together():
    with pytest.raises(InputError, match="--robust; with --estimator least-squares"):
        choose("paper", robust=True)
