# SPDX-License-Identifier: GPL-3.0-or-later
"""The report's pictures are what they are called, and two renderings are compared with one free scale."""

import numpy as np
import pytest

from btfsep_engine.cli import main
from btfsep_engine.commands import report
from btfsep_engine.commands.compare import psnr
from btfsep_engine.imaging import images
from btfsep_engine.imaging.srgb import srgb_to_linear


def linear(shown):
    return srgb_to_linear(shown / 255.0)


def watched(monkeypatch) -> list:
    """The panels of every row that is written from now on."""
    rows, write = [], report.write_row
    monkeypatch.setattr(report, "write_row", lambda path, panels: rows.append(panels) or write(path, panels))
    return rows


def test_the_difference_is_that_of_photo_and_rendering(sphere_job_folder, monkeypatch):
    folder, _ = sphere_job_folder
    photo = images.read_linear(folder / "photo.exr").pixels.copy()
    photo[40:56, 44:52] *= 0.3  # something that no light makes of a white ball
    images.write_exr(folder / "photo.exr", photo)
    rows = watched(monkeypatch)
    command = ["estimate", str(folder), "--material", "reference/white-diffuse", "--order", "2", "--preset", "draft"]
    assert main([*command, "--json"]) == 0
    (panels,) = rows
    shown, material, light, again, difference = (picture for _, picture in panels)
    assert [p.shape for p in (shown, again, difference, material)] == [(96, 96, 3)] * 4 and light.shape[1] == 256
    outside = (again == 255).all(-1)
    assert 0.05 < outside.mean() < 0.5 and (difference[outside] == 255).all()
    inside = ~outside & (shown.max(-1) < 255)
    expected = np.abs(linear(again) - linear(shown))
    np.testing.assert_allclose(linear(difference)[inside], expected[inside], atol=0.012)  # of two roundings
    assert difference[44:52, 46:50].min() > 60  # where the photo was darkened ...
    assert np.median(difference[inside]) < 60  # ... and not elsewhere
    label = panels[-1][0]
    error = np.linalg.norm(expected[inside]) / np.linalg.norm(linear(shown)[inside])
    assert label.startswith("difference (relative error ")
    assert float(label.split()[-1].rstrip(")")) == pytest.approx(error, abs=0.02)


def test_one_free_scale_for_all_channels():
    truth = np.random.default_rng(0).uniform(0.2, 1.0, (40, 40, 3))
    assert psnr(3 * truth, truth) > 200
    tint = np.array([1.2, 1.0, 0.8])
    scale = (truth**2 * tint).sum() / (truth**2 * tint**2).sum()
    error = np.mean((scale * tint * truth - truth) ** 2)
    assert psnr(tint * truth, truth) == pytest.approx(10 * np.log10(np.percentile(truth, 99) ** 2 / error), abs=0.01)
    assert psnr(tint * truth, truth) < 20
    holed = truth.copy()
    holed[3, 4] = np.nan  # where there is no object
    assert psnr(tint * holed, truth) == pytest.approx(psnr(tint * truth, truth), abs=0.05)


def test_the_light_is_drawn_as_the_map_has_it(sphere_job_folder, monkeypatch):
    """Of order 0 a series is one colour; the fit knows more, and lighting.exr shows it."""
    folder, _ = sphere_job_folder
    photo = images.read_linear(folder / "photo.exr").pixels
    from_the_right = np.linspace(0.05, 1.95, photo.shape[1])[None, :, None]
    images.write_exr(folder / "photo.exr", (photo * from_the_right).astype(np.float32))
    rows = watched(monkeypatch)
    command = ["estimate", str(folder), "--material", "reference/white-diffuse", "--order", "0", "--preset", "draft"]
    assert main([*command, "--json"]) == 0
    drawn = rows[0][2][1].astype(np.float64)
    fine = images.read_linear(folder / "result" / "lighting.exr").pixels.astype(np.float64)
    mean = fine.reshape(128, 2, 256, 2, 3).mean((1, 3))
    expected = report.display(mean, report.exposure(mean, ...)).astype(np.float64)
    assert expected.std((0, 1)).min() > 5
    np.testing.assert_allclose(drawn, expected, atol=6)
