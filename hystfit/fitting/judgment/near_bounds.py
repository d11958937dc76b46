"""The linear model about an estimate with bounds nearby or a ridge, whose moments are the errors of its parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy  # loads its subpackages when they are first used
from jaxtyping import Float

from hystfit.fitting.solvers.levenberg_marquardt import ROUNDING
from hystfit.inference.linearization import Linearization
from hystfit.inference.residuals import FEW
from hystfit.params.space import ParameterSpace

_REST = 1e-11  # part of a column that an offset does not explain, below which it is rounding errors
_ROUNDS, _SETTLED = 100, 1e-3  # of the share of a ridge that is known


class Information(NamedTuple):
    """Information about the parameters: (R'R + penalty) / variance."""

    root: np.ndarray  # R, shape (n, p) or (N, n, p)
    variance: Any  # of its rows, or one for each estimate, shape (N,)
    penalty: np.ndarray  # of a regularization, shape (p, p) or (N, p, p)


class NearBounds(NamedTuple):
    """N linear models with bounds and a penalty about estimates, on the same centered columns of unit length.

    A ridge that was chosen for its predictions can be far stronger than what is known about the weights: as prior information it
    would then say that they are smaller than the estimate of their own size. The share of it that counts is the one of largest
    evidence, one for each array of weights: number of determined weights over their power (MacKay 1992, Bayesian
    interpolation, eq. 21), at most 1. The rest of the ridge is a known error of the estimate.
    """

    x: np.ndarray  # estimates, shape (N, k)
    # information of independent noise, which decides where the unconstrained optimum is, shape (k, k)
    normal: np.ndarray
    penalty: np.ndarray  # added to it, shape (N, k, k)
    slope: np.ndarray  # of the cost with the penalty, shape (N, k)
    known: np.ndarray  # information about the parameters, shape (N, k, k)
    prior: np.ndarray  # what the penalty adds to it, shape (N, k, k)
    room: np.ndarray  # distances to the bounds, infinite without one, shape (N, k)
    sides: np.ndarray  # 1 for a lower bound, -1 for an upper bound, shape (k,)
    back: np.ndarray  # takes these parameters to physical ones, shape (k, k)

    @classmethod
    def of(
        cls,
        space: ParameterSpace,
        x: np.ndarray,
        on_bound: np.ndarray,
        rows: np.ndarray,
        information: Information,
        slope: Callable[[], np.ndarray],
        penalty: np.ndarray,
        acts: np.ndarray,
    ) -> NearBounds | None:
        """None where there is neither a bound nearby nor a penalty, or too many bounds are near.

        At N estimates x, shape (N, p), some parameters are `on_bound`. `rows` are the Jacobian of what was minimized, or its triangular
        factor, shape (n, p); `penalty` is added to its normal matrix, shape (N, p, p), and `slope` makes the slope of the whole cost, shape
        (N, p); `acts` tells which parameters have an influence, shape (p,).
        """
        below, above = distances_to_bounds(space, x)
        room = np.where(space.linear, np.minimum(below, above), np.inf)
        room = np.where(on_bound, 0.0, room)[:, acts]
        near = np.isfinite(room[0]).sum()
        # The share of a ridge takes inverses of as many weights: of more than 500 without a bound nearby it counts in full.
        if near > FEW or not (near or penalty.any()) or (not near and room.shape[1] > 500):
            return None
        columns, back = centered(rows[:, acts], space.offsets[acts])
        size = np.linalg.norm(columns, axis=0)
        back, unit, square = back / size, columns / size, 1 / np.outer(size, size)
        root, variance = information.root[..., acts] @ back, np.asarray(information.variance)
        return cls(
            x[:, acts] * size,
            unit.T @ unit,
            penalty[:, acts][..., acts] * square,
            slope()[:, acts] / size,
            root.swapaxes(-1, -2) @ root / variance[..., None, None] * np.ones((len(x), 1, 1)),
            information.penalty[..., acts, :][..., acts] * square / variance[..., None, None] * np.ones((len(x), 1, 1)),
            room * size,
            np.where(below < above, 1.0, -1.0)[0, acts],
            back,
        )

    def take(self, rows: np.ndarray) -> NearBounds:
        """Some of the models."""
        own = {name: getattr(self, name)[rows] for name in ("x", "penalty", "slope", "known", "prior", "room")}
        return self._replace(**own)

    def deviation(self, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means and second moments of the deviations from the estimates (`about_estimate`), with some share of the ridge known, (N, k)."""
        # The estimate is off the unconstrained one by normal^-1 slope, whatever the noise.
        counted = shared(self.penalty, share)
        normal, slope = self.normal + counted, self.slope + ((counted - self.penalty) @ self.x[..., None])[..., 0]
        known = self.known + shared(self.prior, share)
        away = np.linalg.pinv(normal, rcond=1e-14, hermitian=True) @ slope[..., None]
        return about_estimate(known, (known @ away)[..., 0], self.room, self.sides)

    def share(self, array: np.ndarray) -> np.ndarray:
        """Shares of the ridges of largest evidence, shape (N, k); `array` has the number of the array of each parameter."""
        share, member = np.ones(self.x.shape), (array[:, None] == np.arange(array.max(initial=-1) + 1)).astype(float)
        moving = np.flatnonzero(self.prior.any(axis=(1, 2)))
        for _ in range(_ROUNDS if moving.size else 0):
            some, before = self.take(moving), share[moving]
            mean, moments = some.deviation(before)
            ridge = np.einsum("npp->np", some.prior)
            power = ridge * (some.x + mean) ** 2
            determined = (ridge > 0) - before * ridge * (np.einsum("npp->np", moments) - mean**2)
            number, size = determined @ member, power @ member
            after = np.clip(number / np.maximum(size, 1e-300), 0.0, 1.0) @ member.T
            share[moving] = after
            moving = moving[~np.all(np.abs(after - before) <= _SETTLED * after, axis=1)]
            if not moving.size:
                break
        return share

    def moments(self, share: np.ndarray, acts: np.ndarray) -> np.ndarray:
        """Second moments about the estimates in physical units, shape (N, p, p); zero for parameters without influence."""
        moments = self.back @ self.deviation(share[:, acts])[1] @ self.back.T
        inside = np.zeros((len(share), acts.size, acts.size))
        at = np.flatnonzero(acts)
        inside[:, at[:, None], at] = 0.5 * (moments + moments.swapaxes(1, 2))  # a saved fit keeps one half
        return inside


def shared(penalty: Float[np.ndarray, "*n p p"], share: Float[np.ndarray, "*n p"]) -> Float[np.ndarray, "*n p p"]:
    """A penalty of which a share of each parameter counts."""
    root = np.sqrt(share)
    return penalty * root[..., None] * root[..., None, :]


def centered(J: np.ndarray, offsets: np.ndarray, ridge: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Columns of J, (n, p), without what the offsets of records explain, and the matrix from errors of the new parameters to the old ones.

    Columns that are offsets, shape (p,), stay, as do columns that these explain altogether. `ridge` are squares of the only entries of
    further rows of J, one for each column, zero for the offsets, shape (p,).
    """
    back = np.eye(J.shape[1])
    if not offsets.any():
        return J, back
    some = J[:, offsets]
    explained = np.linalg.pinv(some, ROUNDING * max(some.shape)) @ J
    rest = some @ explained
    np.subtract(J, rest, out=rest)
    length = lambda columns: np.hypot(np.linalg.norm(columns, axis=0), np.sqrt(ridge))
    explained[:, offsets | (length(rest) <= _REST * length(J))] = 0.0
    kept = ~explained.any(axis=0)
    rest[:, kept] = J[:, kept]
    back[offsets] -= explained
    return rest, back


def centered_lengths(linear: Linearization, offsets: np.ndarray) -> np.ndarray:
    """Length of every column of `centered` derivatives, shape (p,), in two passes over their blocks."""
    at = np.flatnonzero(offsets)
    products, squares = np.zeros((at.size, linear.size)), np.zeros(linear.size)
    for rows in linear.blocks():
        acting = rows[:, at].any(axis=0)
        products[acting] += rows[:, at[acting]].T @ rows
        squares += np.einsum("np,np->p", rows, rows)
    whole = np.sqrt(squares)
    if not at.size:
        return whole
    explained, squares = np.linalg.lstsq(products[:, at], products, rcond=None)[0], np.zeros(linear.size)
    explained[:, at] = 0.0
    for rows in linear.blocks():
        acting = rows[:, at].any(axis=0)
        rest = rows - rows[:, at[acting]] @ explained[acting]
        squares += np.einsum("np,np->p", rest, rest)
    rest = np.sqrt(squares)
    return np.where(rest <= _REST * whole, whole, rest)


def distances_to_bounds(space: ParameterSpace, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances of each parameter to its lower and its upper bound, in the shape of x."""
    return x - space.lower, space.upper - x


_PROPAGATIONS, _UNCHANGED, _DAMPED = 60, 1e-5, 0.7


def about_estimate(
    information: Float[np.ndarray, "N p p"],
    slope: Float[np.ndarray, "N p"],
    room: Float[np.ndarray, "N p"],
    side: Float[np.ndarray, " p"],
) -> tuple[Float[np.ndarray, "N p"], Float[np.ndarray, "N p p"]]:
    """Means E[d] and second moments E[d d'] of N densities exp(-d'I d / 2 - s'd) of deviations d from the estimates, within bounds.

    With the bounds as prior information, the parameters are normal about the unconstrained optimum of the linear model, truncated at the
    bounds. A standard error is the root mean square distance of this density from the estimate. Moments of the truncated normal follow
    by expectation propagation (Cunningham, Hennig and Lacoste-Julien 2011, arXiv 1111.6832), which is exact for one bound.

    Args:
        information: I, about all parameters.
        slope: s, of the negative log likelihood at the estimate.
        room: distance to the bound, infinite without one; of the same parameters in all of them.
        side: 1 for a lower bound, -1 for an upper bound.
    """
    near, others = np.flatnonzero(np.isfinite(room[0])), np.flatnonzero(np.isinf(room[0]))
    count = len(slope)
    inverse = np.linalg.pinv(information[:, others[:, None], others], rcond=ROUNDING, hermitian=True)
    follow = np.zeros((count, side.size, near.size))
    follow[:, near] = np.diag(side[near])
    follow[:, others] = -inverse @ information[:, others[:, None], near] * side[near]
    back = follow.swapaxes(1, 2)
    diagonal = np.einsum("npp->np", information)[:, near]
    curvature = back @ information @ follow + ROUNDING * diagonal[:, None] * np.eye(near.size)
    mean, covariance = truncated_moments(curvature, (back @ slope[..., None])[..., 0], -room[:, near])
    mean = (follow @ mean[..., None])[..., 0]
    mean[:, others] -= (inverse @ slope[:, others, None])[..., 0]
    moments = follow @ covariance @ back + mean[:, :, None] * mean[:, None, :]
    moments[:, others[:, None], others] += inverse
    return mean, moments


def truncated_moments(
    precision: Float[np.ndarray, "N k k"], slope: Float[np.ndarray, "N k"], low: Float[np.ndarray, "N k"]
) -> tuple[Float[np.ndarray, "N k"], Float[np.ndarray, "N k k"]]:
    """Means and covariances of N densities exp(-d'P d / 2 - s'd) over d >= low; the precision P is positive semidefinite, s the slope."""
    if not slope.size:
        return slope, precision
    unit = np.eye(slope.shape[1])
    scale = 1 / np.maximum(np.sqrt(np.maximum(np.einsum("npp->np", precision), 1e-300)), slope)
    P, s, low = precision * scale[:, None] * scale[:, :, None] + 1e-8 * unit, slope * scale, low / scale
    width = np.ones(s.shape)  # of the factors that stand for the bounds: precision, and that times mean
    shift = low + 1.0
    moving = np.arange(len(s))
    for _ in range(_PROPAGATIONS):
        covariance = np.linalg.inv(P[moving] + width[moving, None] * unit)
        mean = (covariance @ (shift - s)[moving, :, None])[..., 0]
        variance = np.einsum("npp->np", covariance)
        left = np.maximum(1 / variance - width[moving], 1e-12)
        center = (mean / variance - shift[moving]) / left
        wanted, spread = _truncated(center, 1 / left, low[moving])
        new_width = np.maximum(1 / spread - left, 0.0)
        width[moving] += _DAMPED * (new_width - width[moving])
        shift[moving] += _DAMPED * (wanted / spread - center * left - shift[moving])
        moving = moving[~(np.max(np.abs(wanted - mean) / np.sqrt(spread), axis=1) < _UNCHANGED)]
        if not moving.size:
            break
    covariance = np.linalg.inv(P + width[:, None] * unit)
    mean = (covariance @ (shift - s)[..., None])[..., 0]
    return scale * mean, covariance * scale[:, None] * scale[:, :, None]


def _truncated(mean: np.ndarray, variance: np.ndarray, low: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance of normal numbers above a limit."""
    deviation = np.sqrt(variance)
    z = np.clip((mean - low) / deviation, -1e70, 1e70)  # whose powers do not overflow
    far = z < -30  # where the differences below would cancel
    near, away = np.where(far, 0.0, z), np.where(far, z, -30.0)
    hazard = np.exp(-0.5 * near**2 - 0.5 * np.log(2 * np.pi) - scipy.special.log_ndtr(near))
    ratio = np.where(far, -1 / away + 2 / away**3, near + hazard)
    spread = np.where(far, 1 / away**2 - 6 / away**4, 1 - hazard * (hazard + near))
    return low + deviation * ratio, variance * np.maximum(spread, 1e-300)
