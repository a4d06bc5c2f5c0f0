# SPDX-License-Identifier: GPL-3.0-or-later
"""Sun lamps of a lighting.json that make no sense are refused in words."""

import json

import pytest

from blender_btfsep.basics.errors import InputError
from blender_btfsep.light import lighting_file


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"direction": [1, 0]}, "'direction' of 'sun'"),
        ({"direction": [0, 0, 3]}, "no unit vector"),
        ({"irradiance": [1, -1, 1]}, "negative"),
        ({"irradiance": [1, float("nan"), 1]}, "'irradiance' of 'sun'"),
        ({"size_degrees": 999}, "'size_degrees'"),
        ({"sky": [[1, 1, 1]]}, "'sky' has 1 rows"),
    ],
)
def test_a_sun_that_makes_no_sense_is_refused_in_words(sunny, change, words):
    data = json.loads(sunny[0].read_text())
    data["sun"] |= change
    with pytest.raises(InputError, match=words):
        lighting_file.validate(data)
    with pytest.raises(InputError, match="'sun' is no object"):
        lighting_file.validate(data | {"sun": 3})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"direction": [1, 0]}, r"'direction' of 'lamps\[2\]'"),
        ({"direction": [0, 0, 3]}, "no unit vector"),
        ({"direction": [1e300, 0, 0]}, "no unit vector|three finite numbers"),
        ({"irradiance": [1, -1, 1]}, "negative"),
        ({"irradiance": [1, 1e39, 1]}, "three finite numbers"),
        ({"irradiance": [1, 10**400, 1]}, "three finite numbers"),
        ({"irradiance": None}, "three finite numbers"),
        ({"size_degrees": "wide"}, "'size_degrees'"),
    ],
)
def test_a_lamp_of_several_that_makes_no_sense_is_refused_in_words(lamplit, change, words):
    data = json.loads(lamplit[0].read_text())
    data["suns"]["lamps"][2] |= change
    with pytest.raises(InputError, match=words):
        lighting_file.validate(data)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"lamps": []}, "no list of 1 to 64"),
        ({"lamps": {"0": 1}}, "no list of 1 to 64"),
        ({"lamps": [3]}, r"'lamps\[0\]' is no object"),
        ({"sky": [[1, 1, 1]]}, "'sky' has 1 rows"),
        ({"sky": None}, "'sky' has no list"),
    ],
)
def test_suns_that_make_no_sense_are_refused_in_words(lamplit, change, words):
    data = json.loads(lamplit[0].read_text())
    with pytest.raises(InputError, match="'suns' is no object"):
        lighting_file.validate(data | {"suns": [3]})
    with pytest.raises(InputError, match="no list of 1 to 64"):
        lighting_file.validate(data | {"suns": data["suns"] | {"lamps": data["suns"]["lamps"] * 22}})
    data["suns"] |= change
    with pytest.raises(InputError, match=words):
        lighting_file.validate(data)


def test_a_number_of_ten_thousand_digits_is_refused_in_words(tmp_path):
    (tmp_path / "l.json").write_text('{"order": ' + "9" * 10_000 + "}")
    with pytest.raises(InputError, match="not JSON"):
        lighting_file.read(tmp_path / "l.json")
