# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps' own images: what points show of one lamp alone, far away or near, beside what basis images have of it."""

from dataclasses import dataclass

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import across
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.pipeline.basis import USUAL
from btfsep_engine.render.beams import beam_radiance, lamp_radiance

RING = np.radians(1.5)  # about a lamp: its image is the mean of those around it
AFAR, NEARBY = 6, 3  # how many that are; of one nearby each is made by itself


@dataclass(frozen=True)
class OwnImage:
    """A lamp's image by itself, of all photographs' pixels, for an irradiance of 1 (at the objects' middle).

    Attributes
    ----------
    direction : (3,), to the lamp, unit
    image : (p, 3), the mean over a ring about it; slopes : (2, p, 3), by the angles `across` it, radians
    spread : (p, 3), standard deviation over the ring
    excess : (p, 3), the image less what the basis images have of a lamp far away
    """

    direction: np.ndarray
    image: np.ndarray
    slopes: np.ndarray
    spread: np.ndarray
    excess: np.ndarray


def image_from_afar(problems, direction) -> OwnImage:
    """Of a lamp far away towards a direction (3,)."""
    direction = direction / np.linalg.norm(direction)
    beams = direction + _ring(AFAR) @ across(direction)
    beams /= np.linalg.norm(beams, axis=1, keepdims=True)
    each = [_shown(p, lambda *of, unit: beam_radiance(*of, beams, millimetres_per_unit=unit)) for p in problems]
    return _own_image(problems, direction, np.concatenate(each))


def image_from_nearby(problems, place, centre) -> OwnImage:
    """Of a lamp at a ``place`` (3,); its irradiance is that at ``centre`` (3,), on what faces it."""
    away = place - centre
    distance = np.linalg.norm(away)
    places = place + distance * _ring(NEARBY) @ across(away / distance)

    def under_each(tracer, points, material, *, unit):
        falloff = [np.square(distance) / np.square(points.position - each).sum(1)[:, None] for each in places]
        lit = [lamp_radiance(tracer, points, material, each, millimetres_per_unit=unit) for each in places]
        return np.stack([a * b for a, b in zip(lit, falloff, strict=True)], 1)

    return _own_image(problems, away / distance, np.concatenate([_shown(p, under_each) for p in problems]))


def _ring(count: int) -> np.ndarray:
    """(1 + count, 2): the middle, and places around it, radians."""
    turns = 2 * np.pi / count * np.arange(count)
    return np.concatenate([np.zeros((1, 2)), np.tan(RING) * np.stack([np.cos(turns), np.sin(turns)], 1)])


def _shown(problem, image_of) -> np.ndarray:
    """(p, lamps, 3) float64 of ``image_of`` (tracer, points, material, unit=) of every object."""
    scene = problem.scene
    things = zip(problem.points, problem.materials, strict=True)
    each = [image_of(scene.tracer, *of, unit=scene.millimetres_per_unit) for of in things]
    return np.concatenate(each).astype(np.float64)


def _own_image(problems, direction, each) -> OwnImage:
    """``each`` : (p, 1 + k, 3), of the lamp itself and of those in a ring about it."""
    aside = _ring(each.shape[1] - 1)
    slopes = np.einsum("ka,pkc->apc", aside / np.square(aside).sum(0), each)
    image = each.mean(1)
    excess = image - np.concatenate([straight_by_order(p, direction) for p in problems])
    return OwnImage(direction, image, slopes, each.std(1), excess)


def straight_by_order(problem, direction) -> np.ndarray:
    """(p, 3) float64, what the basis images of a problem have of a beam of irradiance 1 that comes straight.

    By the directions of its own basis images, so that their errors are in it, too.
    """
    order = sh.order_of(problem.basis[0].shape[1])
    towards = sh.evaluate(order, np.asarray(direction)[None])[0].astype(np.float32)
    straight = problem.transport["bounces"] == 1 and problem.transport["by"] == "kernel"
    how, out = {"directions": problem.transport.get("directions", USUAL)}, []
    for points, material, basis in zip(problem.points, problem.materials, problem.basis, strict=True):
        if material.mirror_reflectance is not None:  # it shows nothing of light without extent
            out.append(np.zeros((len(points), 3)))
            continue
        if not straight:
            basis = problem.scene.radiance(points, material, SHBasis(order), **how)
        out.append(np.einsum("ptc,t->pc", basis, towards))
    return np.concatenate(out).astype(np.float64)
