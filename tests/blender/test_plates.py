# SPDX-License-Identifier: GPL-3.0-or-later
"""The study of plates: what is photographed is what is said to be, and the light comes from where its truth has it."""

import numpy as np
import pytest

from scripts.cycles import plates as studio_plates
from scripts.studies import cameras, plates


def test_plates_are_drawn_alike_and_of_all_kinds():
    one, again, other = plates.drawn(1), plates.drawn(1), plates.drawn(2)
    assert one == again and one != other
    kinds = {k for plate in one + other for k in plate["kinds"]}
    assert {"0 px off", "1 px off", "2 px off", "srgb", "agx", "floats", "alone", "on a table"} <= kinds
    assert all(
        np.hypot(*p["off"]) == pytest.approx(int(p["kinds"][0][0]) if p["kinds"][0][0].isdigit() else 0) for p in one
    )


def test_the_light_of_a_plate_is_where_its_truth_has_it(tmp_path, monkeypatch):
    monkeypatch.setattr(studio_plates, "RESOLUTION", 96)
    monkeypatch.setattr(studio_plates, "SAMPLES", 16)
    plate = {
        "name": "00", "object": "suzanne", "seed": 0, "light": "sunset", "turn": 130.0, "sun": None, "table": None,
        "surface": {"colour": (0.5, 0.5, 0.5), "roughness": 0.9, "metallic": 0}, "curve": "agx", "off": [0.0, 0.0],
        "kinds": ["0 px off", "agx", "alone", "matte"],
    }  # fmt: skip
    studio_plates.take(plate, tmp_path / "00")
    row = plates.study(plate, tmp_path, plates.AS_IS)
    assert row["error"] < 0.3 and row["direction"] < 15 and not row["curve doubted"]
    assert "AgX, as stated" in row["choice"]["curve"]
    taken = plates.study(plate, tmp_path, plates.AS_SRGB)
    assert "sRGB" in taken["choice"]["curve"] and taken["error"] != row["error"]
    ways = {way: cameras.study(plate, tmp_path, "Canon EOS 5D II", way) for way in ("as sRGB", "as a camera's")}
    assert ways["as a camera's"]["error"] < ways["as sRGB"]["error"] and ways["as sRGB"]["coded"] == "by a camera"
    assert cameras.study(plate, tmp_path, cameras.FLOATS, cameras.AS_STORED)["error"] < 0.3
    aside = plate | {"turn": plate["turn"] + 90}
    assert plates.order2(plates.truth(aside), plates.truth(plate)) > 0.4
