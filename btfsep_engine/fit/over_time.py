# SPDX-License-Identifier: GPL-3.0-or-later
"""Smoothing of lights over time, and where it stops: at a jump of the light.

A light becomes the mean of those about it, weighted by a triangle in time and by how precisely each is known (one
number for a whole light: a mean of lights is then a light, positive where they are). Outwards from a frame the mean
ends before the first light that differs from the frame's own by more than both state. What is stated of the mean is
the mean of what is stated, as if all erred alike: frames share material, geometry and prior, and no number of them
averages that out.
"""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine import sh
from btfsep_engine.light.files import Lighting
from btfsep_engine.light.sun import Sun

KNOWN_ORDER = 2  # up to which lights are compared: of more, a photo says little
SAME_LAMP = 10.0  # degrees between what two frames take for one lamp


@dataclass(frozen=True)
class Frame:
    """The light of a frame; ``sky`` : (h, w, 3), the map of it without suns, or None."""

    lighting: Lighting
    sky: np.ndarray | None = None


def windows(items, reach: int):
    """(list, index) for each item: it and up to ``reach`` on both sides; no more are held."""
    held, at = [], 0
    for item in items:
        held.append(item)
        if len(held) > at + reach:
            yield list(held), at
            at += 1
            if at > reach:
                held.pop(0)
                at -= 1
    while at < len(held):
        yield list(held), at
        at += 1
        if at > reach:
            held.pop(0)
            at -= 1


def differ(a: Lighting, b: Lighting) -> bool:
    """Whether some order of two lights differs by more than both state (root mean squares)."""
    for order in range(min(a.order, b.order, KNOWN_ORDER) + 1):
        band = slice(order**2, (order + 1) ** 2)
        apart = np.square(a.coefficients[band] - b.coefficients[band]).sum()
        if apart > (np.square(a.stddev[band]) + np.square(b.stddev[band])).sum():
            return True
    return False


def precision(lighting: Lighting) -> float:
    """1 over the relative variance that is stated of a light, up to the order that is compared."""
    n = sh.term_count(min(lighting.order, KNOWN_ORDER))
    size = np.square(lighting.coefficients[:n]).sum()
    return float(size / max(np.square(lighting.stddev[:n]).sum(), 1e-12 * size, 1e-300))


def shares(lights, at: int, reach: int) -> dict:
    """Number of a light -> its share, > 0, in the mean about number ``at``; they add up to 1."""
    own, weights = lights[at], {}
    for step in (-1, 1):
        for away in range(reach + 1):
            i = at + step * away
            if not 0 <= i < len(lights) or differ(own, lights[i]):
                break
            weights[i] = (1 - away / (reach + 1)) * precision(lights[i])
    total = sum(weights.values())
    return {i: w / total for i, w in weights.items()} if total > 0 else {at: 1.0}


def smoothed(frames: list[Frame], at: int, reach: int) -> tuple[Frame, int]:
    """Frame number ``at`` of several, smoothed over ``reach`` on each side; and of how many it is the mean."""
    own = frames[at]
    share = shares([f.lighting for f in frames], at, reach)
    if len(share) == 1:
        return own, 1

    def mean(of):
        return sum(w * np.asarray(of(frames[i].lighting), np.float64) for i, w in share.items())

    left = {i: list(frames[i].lighting.suns) for i in share}  # each frame's, less those that are told apart in the mean
    suns = []
    for sun in own.lighting.suns:
        same = {i: (share[i], found) for i in share if (found := _taken(left[i], sun)) is not None}
        of_same = sum(w for w, _ in same.values())
        suns.append(
            replace(
                sun,
                direction=sum(w * s.direction for w, s in same.values()),
                irradiance=sum(w * s.irradiance for w, s in same.values()),  # where it is none, it is in the sky
                stddev=sum(w * s.stddev for w, s in same.values()),
                direction_stddev_degrees=sum(w * s.direction_stddev_degrees for w, s in same.values()) / of_same,
                share=None,
                share_stddev=sum(w * s.share_stddev for w, s in same.values()),
            )
        )
    lighting = replace(
        own.lighting,
        coefficients=mean(lambda light: light.coefficients),
        stddev=mean(lambda light: light.stddev),
        interval=None if own.lighting.interval is None else mean(lambda light: light.interval),
        pattern=None if own.lighting.pattern is None else mean(lambda light: light.pattern),
        suns=tuple(suns),
    )
    if own.sky is None:
        return Frame(lighting), len(share)
    h, w = own.sky.shape[:2]
    sky = sum(share[i] * (frames[i].sky + sum(s.to_map(h, w) for s in left[i])) for i in share)
    return Frame(lighting, sky), len(share)


def _taken(suns: list, like: Sun) -> Sun | None:
    """Takes the one that is nearest to a sun out of a list; None where none is near."""
    cosines = [s.direction @ like.direction for s in suns]
    if not cosines or max(cosines) < np.cos(np.radians(SAME_LAMP)):
        return None
    return suns.pop(int(np.argmax(cosines)))
