# SPDX-License-Identifier: GPL-3.0-or-later
"""What nearness makes of a lamp, and what a light has about a direction, against closed form."""

from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.conventions import across
from btfsep_engine.fit.near_lamp import CLOSEST, mounds, nearness
from btfsep_engine.light.lightings import cap_factors


def test_what_nearness_adds_is_the_inverse_square_and_another_direction():
    """Of a surface that answers cos(theta), whose basis images are known in closed form."""
    random = np.random.default_rng(1)
    position, normal = random.normal(size=(50, 3)), random.normal(size=(50, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    lobe = np.repeat([np.pi, 2 * np.pi / 3, np.pi / 4], [1, 3, 5])  # of a clamped cosine, up to order 2
    basis = np.repeat((sh.evaluate(2, normal) * lobe)[:, :, None], 3, 2)
    place, centre = np.array([4.0, -3.0, 5.0]), np.array([0.5, 0.0, -0.5])

    def by_cosine(cosine):
        return lobe @ [1, 0, 0, 0, 0, 0, 0, 0, 0] / (4 * np.pi) + cosine / 2 + 5 / 16 * (3 * cosine**2 - 1) / 2

    away = place - position
    far = np.linalg.norm(away, axis=1)
    d = np.linalg.norm(place - centre)
    there = by_cosine((away * normal).sum(1) / far) * (d / far) ** 2
    expected = there - by_cosine(normal @ (place - centre) / d)
    np.testing.assert_allclose(nearness(basis, position, place, centre), np.repeat(expected[:, None], 3, 1), atol=1e-12)
    np.testing.assert_allclose(nearness(basis, position, 1e7 * place, centre), 0, atol=1e-5)
    (touching,) = nearness(basis[:1], [place], place, np.zeros(3))  # no nearer than a part of the lamp's distance
    assert np.isfinite(touching).all() and np.abs(touching).max() < 1.5 / CLOSEST**2


def test_a_wide_lamp_is_the_sum_of_its_points():
    random = np.random.default_rng(1)
    position, rough = random.normal(size=(20, 3)), 1 / (1 + sh.degrees(9)) ** 2
    basis = random.normal(size=(20, 100, 3)) * rough[:, None]
    place, width = np.array([4.0, -3.0, 30.0]), np.radians(12)
    around = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = np.tan(width) * np.linalg.norm(place) * np.stack([np.cos(around), np.sin(around)], 1)
    points = [place + r @ across(place / np.linalg.norm(place)) for r in ring]
    distance = np.linalg.norm(points[0]) / np.linalg.norm(place)
    each = np.mean([nearness(basis, position, p / distance, np.zeros(3)) for p in points], 0)
    profile = np.polynomial.legendre.legvander(np.cos(width), 9)
    whole = nearness(basis, position, place, np.zeros(3), profile.ravel())
    assert np.linalg.norm(whole - each) < 0.1 * np.linalg.norm(each)
    assert np.linalg.norm(nearness(basis, position, place, np.zeros(3)) - each) > 0.3 * np.linalg.norm(each)


def an_election(discs, lamps=(), *, base=0.2):
    """Of a light of discs (direction, half width, radiance) and lamps, upon even light."""

    def radiance(white, directions):
        out = np.full((len(directions), 3), base)
        for direction, half, much in discs:
            out[directions @ direction > np.cos(half)] += much
        return out

    solution = SimpleNamespace(white=None, model=SimpleNamespace(radiance=radiance))
    photo = SimpleNamespace(level=np.array([1.0, 2.0, 3.0]))
    return SimpleNamespace(solution=solution, photo=photo, lamps=lamps)


def turned(direction, degrees: float):
    return np.cos(np.radians(degrees)) * direction + np.sin(np.radians(degrees)) * across(direction)[0]


def test_what_a_light_has_about_a_lamp():
    towards, half = np.array([0.0, 0.6, 0.8]), np.radians(15)
    area = 2 * np.pi * (1 - np.cos(half))
    (own,) = mounds(an_election([(towards, half, 5.0)]), [towards], 9)
    np.testing.assert_allclose(own.irradiance, 5 * area * np.array([1, 2, 3]), rtol=0.03)  # without the even light
    np.testing.assert_allclose(own.profile, cap_factors(9, area), atol=0.03)
    np.testing.assert_allclose(own.middle, towards, atol=0.01)
    aside = turned(towards, 12)
    (own,) = mounds(an_election([(aside, half / 2, 5.0)], [(aside, np.ones(3))]), [towards], 9)
    np.testing.assert_allclose(own.irradiance, 1 + 5 * 2 * np.pi * (1 - np.cos(half / 2)) * np.arange(1, 4), rtol=0.06)
    np.testing.assert_allclose(own.middle, aside, atol=0.02)
    far = turned(towards, 35)
    (own,) = mounds(an_election([], [(far, np.ones(3))]), [towards], 9)
    assert (own.irradiance == 0).all() and (own.middle == towards).all()


def test_of_two_lamps_each_has_what_is_nearer():
    one = np.array([0.0, 0.0, 1.0])
    other, between = turned(one, 40), turned(one, 22)  # within both cones
    election = an_election([], [(one, np.ones(3)), (between, np.full(3, 2.0)), (other, np.full(3, 4.0))], base=0.0)
    first, second = mounds(election, [one, other], 9)
    assert first.irradiance[0] == pytest.approx(1) and second.irradiance[0] == pytest.approx(6)
