# SPDX-License-Identifier: GPL-3.0-or-later
"""``btfsep chart``: every setting on one chart, its front, and what is wrong in one sentence."""

import json
import sys

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.cli import main
from btfsep_engine.commands.chart_picture import write_chart
from btfsep_engine.commands.tradeoff import Point, pareto_front, variations
from btfsep_engine.imaging import images
from btfsep_engine.light.files import exactly, write_lighting


def test_the_front_is_what_nothing_beats():
    seconds, errors = [1, 2, 3, 2, 1, 4], [5, 4, 4, 3, 5, 1]
    # 2: as accurate as 1 and slower; 1: as fast as 3 and worse; equals stand side by side
    assert pareto_front(seconds, errors).tolist() == [True, False, False, True, True, True]


def test_every_preset_and_every_setting_that_trades_is_there():
    axes = {axis for axis, _, _ in variations()}
    assert axes >= {"preset", "pixels", "directions", "bounces", "appearance", "components", "estimator, order"}
    assert len({name for _, name, _ in variations()}) == len(variations())


def test_a_chart_of_a_white_sphere(sphere_job_folder, capsys, tmp_path):
    folder, truth = sphere_job_folder
    write_lighting(tmp_path / "truth.json", exactly(truth))
    arguments = ["--material", "reference/white-diffuse", "--repeats", "1", "--quick", "--paper-samples", "2"]
    code = main(["chart", str(folder), *arguments, "--truth", str(tmp_path / "truth.json"), "--json"])
    result = json.loads(capsys.readouterr().out.splitlines()[-1])["result"]
    assert code == 0 and result["reference"] == "truth"
    by_name = {p["name"]: p for p in result["points"]}
    assert 0 < by_name["balanced"]["error"] < 0.5 and all(p["seconds"] > 0 for p in result["points"])
    paper = [p for p in result["points"] if p["axis"] == "paper"]
    assert len(paper) == 1 and paper[0]["paper_ratio"] == 1
    assert by_name["balanced"]["paper_ratio"] == pytest.approx(paper[0]["seconds"] / by_name["balanced"]["seconds"])
    best = min(result["points"], key=lambda p: p["error"])
    assert best["front"] and any(not p["front"] for p in result["points"])
    kept = json.loads((folder / "result" / "chart.json").read_text())
    assert kept["points"] == result["points"]
    picture = images.read_linear(folder / "result" / "chart.png").pixels
    assert min(picture.shape[:2]) > 400 and np.ptp(picture) > 0.5


def test_a_truth_of_too_low_an_order_is_refused(sphere_job_folder, capsys, tmp_path):
    folder, truth = sphere_job_folder
    write_lighting(tmp_path / "truth.json", exactly(truth[: sh.term_count(1)]))
    assert main(["chart", str(folder), "--truth", str(tmp_path / "truth.json")]) == 2
    assert "give order 2 or more" in capsys.readouterr().err


def test_without_matplotlib_it_says_what_to_install_and_a_plan_is_drawn(sphere_job_folder, capsys, monkeypatch):
    folder, _ = sphere_job_folder
    monkeypatch.delitem(sys.modules, "btfsep_engine.commands.chart_picture")
    for name in ["matplotlib", *(m for m in sys.modules if m.startswith("matplotlib."))]:
        monkeypatch.setitem(sys.modules, name, None)
    assert main(["chart", str(folder)]) == 2
    assert "install it: pip install 'btfsep[chart]'" in capsys.readouterr().err
    assert main(["plan", str(folder), "--material", "reference/white-diffuse", "--pixels", "300"]) == 0
    assert images.read_linear(folder / "plan" / "plan.png").pixels.shape[0] > 500


def test_a_folder_may_be_named_like_a_formula(tmp_path):
    points = [Point("pixels", "250", s, e, 1.0, True, np.zeros((9, 3))) for s, e in ((1.0, 0.2), (2.0, 0.1))]
    write_chart(tmp_path / "chart.png", points, reference="truth", title=r"shots $\frac{1}$: leather")
    assert (tmp_path / "chart.png").stat().st_size > 1000
