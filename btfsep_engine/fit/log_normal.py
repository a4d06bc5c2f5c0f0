# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of a photograph: the most probable one of the model that the photograph asks for, and what is stated.

Two families stand for election, by evidence (`fit.search`), under one noise model (`fit.products`):

- plain: even light and up to `MOST_LAMPS` lamps, each put where it explains most of what is left;
- rich: light whose logarithm is a Gaussian field (`light.log_field`), with the plain model's lamps or without, and with
  lamps at the field's own peaks.

Lamps whose direction is given stand in all of them, where they are said to be, and cost no evidence. They may come out
as good as dark: then others explain the photo (`without_given`).

A model of few unknowns that explains as much wins: its evidence pays for no unknowns that it does not have. What is
stated are samples of the posterior about the maximum (Laplace, in the white unknowns): the light is their exponential,
so that its ranges are lopsided where light may be bright but not negative. Two things that one photograph cannot tell
are in the samples, too: how light or dark a piece of the material is (`REFLECTANCE`), and whose colour a tint is
(`fit.colour`). And where the plain model is elected, every other sample is the rich one's: it says of directions that
the photo does not show what it says of those that it does, and nobody knows that.
"""

import copy
from dataclasses import replace
from functools import cache, partial

import numpy as np
from scipy.linalg import solve_triangular

from btfsep_engine import sh
from btfsep_engine.fit import colour
from btfsep_engine.fit.elected import Election
from btfsep_engine.fit.election import (
    elect,
    from_elsewhere,
    natural_light,
    next_lamp,
    one_lamp_more,
    onward,
    rough_light,
)
from btfsep_engine.fit.ground import FEW_DIRECTIONS, Ground, WithGround
from btfsep_engine.fit.light_model import LightModel
from btfsep_engine.fit.posterior import HIDDEN, WIDER, hidden_lamps, posterior_samples
from btfsep_engine.fit.products import SINGLE, Basis, Photograph
from btfsep_engine.fit.search import Solution, nearby, solve
from btfsep_engine.fit.sharp_lamp import Sharpened, SharpLight
from btfsep_engine.fit.stated import REFLECTANCE, Fit, Lamp, Stated, decided_unknowns, stated_by
from btfsep_engine.light.log_field import as_vivid, natural_field
from btfsep_engine.linear_algebra import product
from btfsep_engine.threads import one_thread

SAMPLES = 200
GROUND_ROUNDS = 3  # of what a ground departs by and the light that it goes by
FIRST_GROUND_NOISE = 0.04  # of its root mean square
SAME_GROUND = 0.03  # change of what a light predicts of it


class LightSolver:
    """Basis images made ready, solved for any number of photographs of them.

    Parameters
    ----------
    basis : (p, terms, 3) float, A, of order 9
    normals : (p, 3) float, unit, world
    parts : as of `fit.products.Basis`
    order : the order that is reported; it does not change the numbers
    seed : of the samples
    coarsening : how many times less a pixel counts than in an estimate
    given : direction (3,), unit, and its standard deviation, degrees, of each lamp whose direction is given
    hidden : (m,) bool, as of `log_field.LogField`

    Raises
    ------
    InputError
        Without pixels, or where the material reflects nothing.
    """

    def __init__(self, basis, *, normals, order: int, parts=None, seed: int = 0, coarsening=1.0, given=(), hidden=None):
        with one_thread():  # so that the number of threads changes no digit of what is found
            self.basis = Basis(basis, normals, parts)
        self.order, self.seed, self.coarsening = order, seed, coarsening
        self.given = tuple((np.asarray(d, np.float64), float(degrees)) for d, degrees in given)
        self.slopes, self.departing, self.dye, self.stated_colour = None, None, 0.0, False
        self.field = natural_field() if hidden is None else replace(natural_field(), hidden=hidden)

    @property
    def _held(self) -> dict:
        """The lamps that are given, as models have them."""
        return {"lamps": tuple(d for d, _ in self.given), "given": (0.0,) * len(self.given)}

    def with_slopes(self, slopes) -> "LightSolver":
        """The same for photographs that may differ by ``slopes`` (p, k, 3) beside noise (`fit.products.Photograph`)."""
        return self._with(slopes=slopes)

    def with_departing(self, departing) -> "LightSolver":
        """The same where objects may depart from the model ``departing`` (p,) times as far as others."""
        return self._with(departing=departing)

    def with_dye(self, dye) -> "LightSolver":
        """The same of basis images of an object of the tint ``dye``, which the photo says (`colour.split`)."""
        return self._with(dye=np.asarray(dye))

    def with_stated_colour(self) -> "LightSolver":
        """The same of basis images of objects whose colour somebody told (`colour.split`)."""
        return self._with(stated_colour=True)

    def with_vivid(self) -> "LightSolver":
        """The same for light that may have strong colours, other ones from each direction."""
        return self._with(field=as_vivid(self.field))

    def without_given(self, number=None) -> "LightSolver":
        """The same of the same basis images with no lamp given; ``number`` : of the one to leave out alone."""
        return self._with(given=() if number is None else (*self.given[:number], *self.given[number + 1 :]))

    def _with(self, **changes) -> "LightSolver":
        out = copy.copy(self)
        vars(out).update(changes)
        return out

    def solve(self, radiance, *, weights=None, start: Fit | None = None, beside: Fit | None = None) -> Fit:
        """The light of the photograph ``radiance : (p, 3)``, linear.

        Parameters
        ----------
        weights : (p, 3) >= 0, 1 over the variance of a channel of a pixel; None: all 1
        start : of an earlier photograph of much the same light: its model, from its light on, and no other is tried
        beside : of the same photograph by another basis, whose evidence is to be compared with this one's

        Raises
        ------
        InputError
            Without light in the photo.
        """
        with one_thread():
            photo = self._photograph(radiance, weights, beside)
            if start is None:
                return self._fit(photo, *elect(photo, **self._held))
            photo.learn_from(start.election.solution.x)
            return self._onward(photo, start.election)

    def follow(self, radiance, before: Fit, *, weights=None, beside: Fit | None = None) -> Fit:
        """As `solve`, of much the same light as ``before``: its model, from its light on, where `solve` would elect it.

        What the photo misses it learns from itself, as an election does: the answers differ by some hundredths of what
        is stated, as far as a search goes on.
        """
        with one_thread():
            photo = self._photograph(radiance, weights, beside)
            rough_light(photo, **self._held)
            return self._onward(photo, before.election)

    def again(self, radiance, elected: Fit, last: Fit) -> Fit:
        """As `solve`, of a photograph that differs from that of ``elected`` by little more than noise.

        What was learned of that one's misfit, how much its pixels count, and what is stated of its light are this
        one's; the search begins at the light of ``last``, the same or another such photograph's.
        """
        with one_thread():
            known = elected.election
            photo = known.photo.again(radiance)
            best = nearby(photo, known.solution, last.election.solution.white)
            fit = self._fit(photo, best, known.rival, like=elected)
            return replace(fit, state=cache(lambda: moved(elected, fit)))

    def beside_ground(self, radiance, alone: Fit, ground: Ground, *, weights=None, alike: float = 1.0) -> Fit:
        """As `solve`, of what the ``ground`` shows, too.

        ``alone`` : the same photograph's without it; ``alike`` : how many of its places speak as one
        """
        with one_thread():
            photo = self._photograph(radiance, weights, alone)
            photo = WithGround(photo, ground, alone.election.solution, alike=alike)
            best, rival = elect(photo, **self._held)
            for _ in range(GROUND_ROUNDS):
                moved = photo.learn_ground(best.x)
                best = onward(photo, best)
                if moved < SAME_GROUND:
                    break
            return self._fit(photo, best, rival and onward(photo, rival))

    def ground_evidence(self, radiance, alone: Fit, ground: Ground, *, weights=None) -> float:
        """How probable objects and ``ground`` are under the model of ``alone``: quickly, to choose among some.

        By some of the ground's places, in less than half of the time: of 26 grounds another look is the most probable
        on two or three, and the light of 19 plates on glossy tables errs 1.002 times as much.
        """
        with one_thread():
            known = alone.election.solution
            photo = self._photograph(radiance, weights, alone)
            photo = WithGround(photo, ground.thinned, known, directions=FEW_DIRECTIONS)
            photo.learn_from(known.x)
            model = replace(known.model, field=photo.fields[0 if known.model.field.order else 1])
            v = np.concatenate([known.v, FIRST_GROUND_NOISE**2 * photo.energy])
            start = {"white": known.white, "v": v, "discrepancy": known.discrepancy}
            return photo.evidence(solve(photo, model, rounds=GROUND_ROUNDS, **start))

    def first_look(self, radiance, *, weights=None) -> Fit:
        """The rough fit of a field with which `solve` begins: what a fit by another basis stands `beside`."""
        with one_thread():
            photo = self._photograph(radiance, weights, None)
            return self._fit(photo, rough_light(photo, **self._held), None)

    def field_alone(self, radiance, *, weights=None, beside=None, start: Solution | None = None) -> Solution:
        """``radiance`` under a field alone: quickly, what one basis explains more than that which gave ``start``."""
        with one_thread():
            return natural_light(self._photograph(radiance, weights, beside), start=start, **self._held)

    def _photograph(self, radiance, weights, beside: Fit | None, *, kind=Photograph) -> Photograph:
        effective = None if beside is None else beside.election.photo.effective
        how = {"coarsening": self.coarsening, "effective": effective, "slopes": self.slopes, "field": self.field}
        return kind(self.basis, radiance, weights=weights, departing=self.departing, **how)

    def _onward(self, photo: Photograph, before: Election) -> Fit:
        """The light of an earlier election's models, from their lights on; of the rival's when it is asked for."""
        return self._fit(photo, onward(photo, before.solution), before.latest_rival, open_rival=True)

    def _fit(
        self, photo: Photograph, best: Solution, rival: Solution | None, *, open_rival=False, like: Fit | None = None
    ) -> Fit:
        """The Fit of a solution.

        ``rival``, ``open_rival`` : `Election.known_rival` and `Election.is_open`
        ``like`` : of nearly the same light by its model, which decides as many unknowns
        """
        tint = colour.split(best.x[:, 0] * photo.level, self.dye, stated=self.stated_colour, vivid=self.field.vivid)
        unit = photo.level * tint.gain
        election = Election(best, rival, photo, unit, open_rival)
        left = photo.misfit(best.x) * photo.level**2 * self.basis.response**2
        energy = photo.mean_square * photo.level**2 * self.basis.response**2
        return Fit(
            order=self.order,
            all_coefficients=best.whole.T[: self.basis.terms] * unit,
            seen=None if best.model.field.hidden is None else best.x.T[: self.basis.terms] * photo.level,
            state=cache(lambda: self._stated(best, election.rival, unit, tint, photo)),
            residual=float(np.sqrt(left.sum() / energy.sum())),
            residual_per_channel=np.sqrt(left / np.maximum(energy, 1e-300)),
            condition=like.condition if like else self.basis.condition(self.order),
            effective_degrees_of_freedom=like.effective_degrees_of_freedom if like else decided_unknowns(best.factor),
            noise=float(np.sqrt(best.v[:3].sum() / photo.mean_square.sum())),
            tint=tint,
            election=election,
        )

    def with_lamp(self, fit: Fit) -> Fit:
        """The light of the same photograph by the same model and one lamp more, whatever its evidence says."""
        with one_thread():
            known = fit.election
            best = one_lamp_more(known.photo, known.solution, place=next_lamp(known.solution))
            return self._fit(known.photo, best, known.latest_rival, open_rival=known.is_open)

    def brightest_direction(self, fit: Fit) -> np.ndarray:
        """The direction (3,) of the brightest lamp that was found; where none was, that in which one would be put."""
        lamps = [fit.election.lamps[i] for i in fit.election.found]
        if lamps:
            return max(lamps, key=lambda lamp: lamp[1].mean())[0]
        with one_thread():
            best = fit.election.solution
            return next_lamp(best)(best, fit.election.photo)

    def sharp_lamps(self, radiance, fit: Fit, directions, excess, *, weights, start=None) -> SharpLight:
        """A free sky and lamps, of which the first ones have images of their own (`fit.sharp_lamp`).

        Parameters
        ----------
        fit : of the same photograph; weights : (p, 3), as of `solve`
        directions : (k, 3), of all lamps
        excess : (p, j, 3), j <= k: what the first ones' own images have that the basis images do not
        start : SharpLight of such lamps nearby, in this order, from which the search goes on; None: from even light
        """
        with one_thread():
            k, told, own = len(directions), len(self.given), excess.shape[1]
            kind = partial(Sharpened, directions=directions[:own], excess=excess) if own else Photograph
            photo = self._photograph(radiance, weights, fit, kind=kind)
            held = {"lamps": (*self._held["lamps"], *directions), "given": (*self._held["given"], *[0.0] * k)}
            if start is None:
                best = natural_light(photo, **held)
            else:
                best = from_elsewhere(photo, LightModel(photo.fields[0], **held), start.white, start.v)
            lamps = slice(told, told + k)
            irradiances = best.model.lamp(lamps, best.model.parts(best.white)[1][lamps])[1]
            x = best.x.T[: self.basis.terms] * photo.level
            return SharpLight(irradiances * photo.level, x, best.evidence, best.white, best.v)

    def shows(self, direction) -> bool:
        """Whether a lamp in that direction (3,) lights more of the pixels than one that the photo could not know of."""
        field = natural_field()
        response = self.basis.mean_response @ field.to_coefficients
        of_one = self.basis.mean_response @ sh.evaluate(sh.order_of(self.basis.terms), direction)
        return bool(of_one > HIDDEN * response.max() * len(field.directions) / (4 * np.pi))

    def reported_up_to(self, fit: Fit, order: int) -> Fit:
        """The same fit with fewer orders reported."""
        return replace(fit, order=order, condition=self.basis.condition(order))

    @one_thread()
    def _stated(self, best: Solution, rival: Solution | None, unit, tint, photo) -> Stated:
        """What samples of the light's posterior say of it and of its lamps."""
        random = np.random.default_rng(self.seed)
        model = self._loose(best.model)
        whites, lights = posterior_samples(best, SAMPLES, random, model=model)
        lights = lights[:, : self.basis.terms]
        factors = np.exp(REFLECTANCE * random.standard_normal((SAMPLES, 1))) * tint.draw(SAMPLES, random)
        own_light = lights[:, 0].copy()  # what the lamps are a share of: a rival's light has none of them
        if rival is not None:
            others = posterior_samples(rival, len(lights[::2]), random, model=self._loose(rival.model))[1]
            lights[::2] = others[:, : self.basis.terms]
        beside = {"lamps": len(model.lamps), "field": self.field, "shadowed": photo.shadowed}
        hidden = hidden_lamps(self.basis, SAMPLES, random, **beside)
        lights += hidden
        samples = lights * (unit * factors)[:, None]
        lamps = []
        for i, q in enumerate(model.parts(best.white)[1]):
            directions, irradiances = model.lamp(i, model.parts(whites)[1][:, i])
            direction, irradiance = model.lamp(i, q)
            off = np.arccos(np.clip(directions @ direction, -1, 1))
            each = irradiances * unit * factors
            whole = SINGLE * ((own_light + hidden[:, 0]) * unit * factors).mean(1)
            share = each.mean(1) / np.maximum(whole, 1e-300)  # a sample may have no light at all
            own = irradiance * unit
            part = float(own.mean() / (SINGLE * (best.whole[:, 0] * unit).mean()))
            given = i < len(self.given)
            degrees = self.given[i][1] if given else float(np.degrees(np.sqrt(np.square(off).mean())))
            lamps.append(Lamp(direction, own, each.std(0), degrees, part, float(share.std()), given))
        lamps = tuple(sorted(lamps, key=lambda lamp: -lamp.share))
        return stated_by(best.whole.T[: self.basis.terms] * unit, samples, lamps)

    def _loose(self, model: LightModel) -> LightModel:
        """The same with given directions as uncertain as is said: in samples they turn, and the rest follows."""
        if not self.given:
            return model
        turns = tuple(np.radians(degrees) / np.sqrt(2) / WIDER for _, degrees in self.given)
        return replace(model, given=turns)

    def smoother(self, fit: Fit):
        """A function of values (p, 3) that takes out what the light can imitate of them, about the fit's light.

        The derivative of the fit by the photograph: with J of the unknowns, b - A J_x (I + J^T J)^-1 J_x^T A^T N^-1 b.
        """
        best, photo = fit.election.solution, fit.election.photo
        terms, every = self.basis.terms, best.by_unknowns.reshape(*best.x.shape, -1)
        by_light = every[:, :terms].reshape(3 * terms, -1)

        def left(values):
            with one_thread():
                step = product(photo.scores(values, best.v, best.discrepancy).ravel(), by_light)
                step = solve_triangular(best.factor, step, lower=True)
                x = product(by_light, solve_triangular(best.factor.T, step, lower=False))
                return values - self.basis.predicted(x.reshape(3, terms).T * photo.level)

        return left


def moved(before: Fit, now: Fit) -> Stated:
    """What is stated of a light that is another but for noise: the same, about where it is ``now``."""
    stated, step = before.state(), now.all_coefficients - before.all_coefficients
    mean, lamps = float(SINGLE * now.all_coefficients[0].mean()), []
    for lamp in stated.lamps:
        i = int(np.argmax([direction @ lamp.direction for direction, _ in before.election.lamps]))
        direction, irradiance = now.election.lamps[i]
        irradiance = irradiance * now.tint.gain
        share = float(irradiance.mean()) / mean
        lamps.append(replace(lamp, direction=direction, irradiance=irradiance, share=share))
    ranges = {"interval": stated.interval + step, "pattern": stated.pattern + step}
    return replace(stated, samples=stated.samples + step, lamps=tuple(lamps), **ranges)
