# SPDX-License-Identifier: GPL-3.0-or-later
"""The most probable light of a model, and how probable the model is.

With theta the white unknowns, the rows R, y of `fit.products` and r(theta) = R x(theta) - y,

    min  (|r|^2 + |theta|^2) / 2                                     by Gauss and Newton, damped (Levenberg, Marquardt),
    log evidence = -min - log det(I + J^T J) / 2 - sum n_c log(v_c) / (2 h) - rest terms          (Laplace),

J the derivative of r at the maximum. There are mostly fewer rows than unknowns: a step and the determinant are those
of (rows, rows), (I + J^T J)^-1 = I - J^T (I + J J^T)^-1 J, and steps are in single precision. The noise v is what is
left over, found again as the light is; it is never less than `FLOOR`: no model of a material is better.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import lapack

from btfsep_engine.fit.light_model import LightModel
from btfsep_engine.fit.products import NEARLY_RIGHT, Photograph, Rows
from btfsep_engine.linear_algebra import cholesky, lower_gram, product

STEPS = 40  # of one search; 5 to 15 are usual
ROUNDS = 6  # of the noise
FLOOR = 0.05  # of a channel's root mean square
FIRST_NOISE = 0.3  # of it: where a search without a guess begins
SETTLED = 0.05  # of the logarithm of the noise
GAIN = 3e-3  # of the logarithm of the probability: less is no step worth taking
EXACT = 0.02  # discrepancy of a model that is as good as exact
EXACT_COST = 12.0  # of the logarithm of the evidence: how much less probable such a model is
LAMP_COST = 5.0  # of the logarithm of the evidence: how much less probable one more lamp is, wherever it stands
VIVID_COST = 10.0  # of it: of light of strong colours, which few photographs show
BESIDE_COST, BESIDE = 20.0, 15.0  # of it, of a lamp so near (degrees) to one whose direction is given: it is that one
NEAR = 0.3  # of the same: after so small a gain,
AGAIN = 3  # so many steps are made with the slopes that are there, and the gradient anew: a fifth of the cost
LONGEST = 1.0  # of any white unknown, in a step that rests on slopes alone
SLOWER = 100  # their last gain is so many times less than a whole step's may be: they close in slowly
FEW = 4  # whole steps, after those by slopes that are known, to a light that is there but for noise: one is usual
STIFFEST = 1e5  # of the damping
ROUNDED = 1e-6  # of the largest value of a matrix in single precision, that its smallest are wrong by


@dataclass(frozen=True)
class Solution:
    """The most probable light of one model.

    Attributes
    ----------
    model : LightModel
    white : (unknowns,), theta
    x : (3, terms), coefficients of all light that reaches what is photographed; radiance : (3, n), of the field
    v : (3,), noise; discrepancy : of the model of the photo, D; rows : Rows at both
    evidence : its logarithm
    steps : of the search
    slopes : J, in single precision; small_factor : of I + J J^T or I + J^T J, the smaller one, the same, lower
    """

    model: LightModel
    white: np.ndarray
    x: np.ndarray
    radiance: np.ndarray
    v: np.ndarray
    discrepancy: float
    rows: Rows
    evidence: float
    steps: int
    slopes: np.ndarray
    small_factor: np.ndarray

    @property
    def whole(self) -> np.ndarray:
        """(3, terms), coefficients of all of the light, be it hidden or not."""
        return self.x if self.model.field.hidden is None else self.model.whole(self.white)

    @cached_property
    def jacobian(self) -> np.ndarray:
        """(rows, unknowns), J."""
        return self.model.jacobian(self.white, self.radiance, self.rows.root)

    @cached_property
    def by_unknowns(self) -> np.ndarray:
        """(3 * terms, unknowns), derivatives of the coefficients ``x``, channel by channel."""
        return self.model.jacobian(self.white, self.radiance, [np.eye(self.x.shape[1])] * 3)

    @cached_property
    def factor(self) -> np.ndarray:
        """(unknowns, unknowns), lower Cholesky factor of I + J^T J."""
        return cholesky(_and_one(product(self.jacobian.T, self.jacobian)))

    @cached_property
    def inverse(self) -> np.ndarray:
        """(unknowns, unknowns), (I + J^T J)^-1, in single precision."""
        root = lapack.dtrtri(self.factor.T, lower=0)[0].astype(np.float32)
        return product(root, root.T)

    def beside(self, seen) -> tuple[float, float, np.ndarray]:
        """What light of images ``seen`` (rows,) does beside this one, as far as images are linear in the unknowns.

        Returns
        -------
        slope, curvature : of |r|^2 / 2 + |theta|^2 / 2 by its strength; (unknowns,), theta's answer to strength 1
        """
        r = self.rows.residual(self.x)
        answer = -answer_to(self.slopes, self.small_factor, product(seen.astype(np.float32), self.slopes))
        return float(seen @ r), float(seen @ (seen + product(self.slopes, answer))), answer


def solve(
    photo: Photograph, model: LightModel, *, white=None, v=None, discrepancy=NEARLY_RIGHT, rounds=ROUNDS, steps=STEPS
) -> Solution:
    """The most probable light of ``photo``.

    Parameters
    ----------
    white, v : where the search begins; None: even light, and a large noise
    discrepancy : D of `fit.products`
    rounds, steps : of the noise, and of the light at each
    """
    white = np.zeros(model.unknowns) if white is None else white
    floor = FLOOR**2 * photo.noise_unit
    v = np.maximum(FIRST_NOISE**2 * photo.noise_unit if v is None else v, floor)
    all_steps = 0
    for left in reversed(range(rounds)):
        rows = photo.rows(v, discrepancy)
        by_direction = model.field.by_direction(rows.root, np.float32)
        white, x, radiance, lowest, taken = _minimised(rows, model, white, steps, by_direction)
        all_steps += taken
        now = np.maximum(photo.noise(x, v, discrepancy), floor)
        settled = np.abs(np.log(now / v)).max() < SETTLED
        if settled or not left:  # what is stated is all at one noise
            break
        v = now
    slopes = model.jacobian(white, radiance, rows.root, by_direction)
    return solution(photo, model, white, (x, radiance), v, discrepancy, rows, lowest, all_steps, slopes)


def solution(photo, model, white, light, v, discrepancy, rows, lowest, steps, slopes) -> Solution:
    """The Solution at the most probable unknowns of a model, with its evidence.

    ``light`` : x and radiance there; ``lowest`` : (|r|^2 + |theta|^2) / 2; all else as in Solution
    """
    factor = small_factor(lower_gram(slopes), 0.0)
    evidence = (
        -lowest
        - 0.5 * rows.rest
        - float(np.log(np.diag(factor)).sum(dtype=np.float64))
        - rows.log_determinant
        - 0.5 * float((photo.noise_count * np.log(v)).sum()) / photo.coarsening
        - LAMP_COST * model.found
        - BESIDE_COST * model.beside(white, BESIDE)
        - EXACT_COST * (discrepancy < NEARLY_RIGHT)
        - VIVID_COST * model.field.vivid
    )
    return Solution(model, white, *light, v, discrepancy, rows, evidence, steps, slopes, factor)


def nearby(photo: Photograph, best: Solution, white) -> Solution:
    """The most probable light of ``photo``, which differs from the photograph of ``best`` by little more than noise.

    At that one's noise, and by its slopes as far as these lead. Where more than noise changed, the search is not ended.

    ``white`` : where it begins
    """
    rows = photo.rows(best.v, best.discrepancy)
    by_direction = best.model.field.by_direction(rows.root, np.float32)
    known = best.slopes, best.small_factor
    white, x, radiance, _, steps = _minimised(rows, best.model, white, FEW, by_direction, known)
    return replace(best, white=white, x=x, radiance=radiance, rows=rows, steps=steps)


def _and_one(gram, more=0.0) -> np.ndarray:
    """The matrix with 1 + ``more`` added to its diagonal, in place."""
    np.einsum("ii->i", gram)[:] += 1 + more
    return gram


def small_factor(gram, damping: float) -> np.ndarray:
    """The factor of (1 + damping) I + ``gram``, in single precision, both in the lower triangle alone."""
    if not len(gram):
        return gram
    lower, failed = lapack.spotrf(_and_one(gram.copy("F"), damping), lower=1, overwrite_a=1, clean=0)
    more = ROUNDED * float(np.diag(gram).max())
    while failed:  # its values span more than single precision does; of many that are alike, more than the largest says
        if not np.isfinite(more):
            raise np.linalg.LinAlgError("the matrix of a fit has values that are no numbers")
        lower, failed = lapack.dpotrf(_and_one(gram.astype(np.float64), damping + more), lower=1)
        lower, more = lower.astype(np.float32), 10 * more
    return lower


def _minimised(rows: Rows, model: LightModel, white, most: int, by_direction, known=None):
    """theta, x, radiance, (|r|^2 + |theta|^2) / 2, and the steps that were taken.

    ``known`` : J nearby and the factor of I + J J^T or I + J^T J, by which the first steps go; None: found at once
    """
    x, radiance = model.light(white)
    r = rows.residual(x)
    now, damping, steps, again = 0.5 * (r @ r + white @ white), 1e-2, 0, 0
    if known is not None:
        (jacobian, lower), damping, again = known, 0.0, AGAIN
    ends = np.cumsum([len(y) for y in rows.target])[:-1]
    while steps < most or again:
        if not again:
            steps += 1
            jacobian = model.jacobian(white, radiance, rows.root, by_direction)
            gram = lower_gram(jacobian)
            gradient = product(r.astype(np.float32), jacobian) + white
            lower = small_factor(gram, damping)
        else:
            gradient = model.gradient(white, radiance, rows.root, by_direction, np.split(r, ends)) + white
        while True:
            moved = white - answer_to(jacobian, lower, gradient, damping)
            x_there, radiance_there = model.light(moved)
            r_there = rows.residual(x_there)
            there = 0.5 * (r_there @ r_there + moved @ moved)
            if there < now or again or damping > STIFFEST:
                break
            damping = max(5 * damping, 1e-3)
            lower = small_factor(gram, damping)
        if not there < now:
            if again:
                again = 0
                continue
            break
        gain = now - there
        white, x, radiance, r, now = moved, x_there, radiance_there, r_there, there
        unit = max(1.0, 0.01 * now)
        if gain < GAIN * unit / (SLOWER if again else 1):
            break
        again = again - 1 if again else AGAIN * (gain < NEAR * unit)
        if not again:
            damping = damping / 8 if damping > 1e-5 else 0.0
    return white, x, radiance, now, steps


def answer_to(jacobian, lower, gradient, damping=0.0) -> np.ndarray:
    """((1 + damping) I + J^T J)^-1 g; ``lower`` : of J J^T or J^T J, the smaller one, by `small_factor`."""
    if not len(lower):  # a photo that says nothing
        return gradient / (1 + damping)
    if len(lower) == len(gradient):
        return lapack.spotrs(lower, gradient.astype(np.float32), lower=1)[0].astype(float)
    seen, _ = lapack.spotrs(lower, product(jacobian, gradient.astype(np.float32)), lower=1)
    return (gradient - product(seen, jacobian)) / (1 + damping)
