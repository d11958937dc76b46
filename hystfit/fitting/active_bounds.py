"""Errors of estimates next to bounds.

With the bounds as prior information, the parameters are normal about the unconstrained optimum of the linear model, truncated at the
bounds. A standard error is the root mean square distance of this density from the estimate. Moments of the truncated normal follow by
expectation propagation (Cunningham, Hennig and Lacoste-Julien 2011, arXiv 1111.6832), which is exact for one bound.
"""

from __future__ import annotations

import numpy as np
import scipy  # loads its subpackages when they are first used
from jaxtyping import Float

from hystfit.fitting.polish import ROUNDING

_STEPS, _SETTLED, _DAMPED = 60, 1e-5, 0.7


def about_estimate(
    information: Float[np.ndarray, "p p"],
    slope: Float[np.ndarray, " p"],
    room: Float[np.ndarray, " p"],
    side: Float[np.ndarray, " p"],
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"]]:
    """Mean E[d] and second moments E[d d'] of the density exp(-d'I d / 2 - s'd) of deviations d from the estimate, within bounds.

    Args:
        information: I, about all parameters.
        slope: s, of the negative log likelihood at the estimate.
        room: distance to the bound, infinite without one.
        side: 1 for a lower bound, -1 for an upper bound.
    """
    near, others = np.isfinite(room), ~np.isfinite(room)
    inverse = np.linalg.pinv(information[np.ix_(others, others)], rcond=ROUNDING, hermitian=True)
    follow = np.zeros((side.size, int(near.sum())))
    follow[near] = np.diag(side[near])
    follow[others] = -inverse @ information[np.ix_(others, near)] * side[near]
    curvature = follow.T @ information @ follow + ROUNDING * np.diag(np.diag(information)[near])
    mean, covariance = truncated_moments(curvature, follow.T @ slope, -room[near])
    free = np.zeros(side.size)
    free[others] = -inverse @ slope[others]
    mean = follow @ mean + free
    moments = follow @ covariance @ follow.T + np.outer(mean, mean)
    moments[np.ix_(others, others)] += inverse
    return mean, moments


def truncated_moments(
    precision: Float[np.ndarray, "k k"], slope: Float[np.ndarray, " k"], low: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"]]:
    """Mean and covariance of the density exp(-d'P d / 2 - s'd) over d >= low.

    Args:
        precision: P, positive semidefinite.
        slope: s.
        low: lower limits.
    """
    if not slope.size:
        return slope, precision
    scale = 1 / np.maximum(np.sqrt(np.maximum(np.diag(precision), 1e-300)), slope)
    P, s, low = precision * scale * scale[:, None] + 1e-8 * np.eye(slope.size), slope * scale, low / scale
    width = np.ones(s.size)  # of the factors that stand for the bounds: precision, and that times mean
    shift = low + 1.0
    for _ in range(_STEPS):
        covariance = np.linalg.inv(P + np.diag(width))
        mean, variance = covariance @ (shift - s), np.diag(covariance)
        left = np.maximum(1 / variance - width, 1e-12)
        center = (mean / variance - shift) / left
        wanted, spread = _truncated(center, 1 / left, low)
        new_width = np.maximum(1 / spread - left, 0.0)
        width, shift = (
            width + _DAMPED * (new_width - width),
            shift + _DAMPED * (wanted / spread - center * left - shift),
        )
        if np.max(np.abs(wanted - mean) / np.sqrt(spread)) < _SETTLED:
            break
    covariance = np.linalg.inv(P + np.diag(width))
    return scale * (covariance @ (shift - s)), covariance * scale * scale[:, None]


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
