"""Errors of estimates next to bounds.

With the bounds as prior information, the parameters are normal about the unconstrained optimum of the linear model, truncated at the
bounds. A standard error is the root mean square distance of this density from the estimate. Moments of the truncated normal follow by
expectation propagation (Cunningham, Hennig and Lacoste-Julien 2011, arXiv 1111.6832), which is exact for one bound.
"""

from __future__ import annotations

import numpy as np
import scipy  # loads its subpackages when they are first used
from jaxtyping import Float

from hystfit.fitting.levenberg_marquardt import ROUNDING

_STEPS, _SETTLED, _DAMPED = 60, 1e-5, 0.7


def about_estimate(
    information: Float[np.ndarray, "N p p"],
    slope: Float[np.ndarray, "N p"],
    room: Float[np.ndarray, "N p"],
    side: Float[np.ndarray, " p"],
) -> tuple[Float[np.ndarray, "N p"], Float[np.ndarray, "N p p"]]:
    """Means E[d] and second moments E[d d'] of N densities exp(-d'I d / 2 - s'd) of deviations d from the estimates, within bounds.

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
    """Means and covariances of N densities exp(-d'P d / 2 - s'd) over d >= low.

    Args:
        precision: P, positive semidefinite.
        slope: s.
        low: lower limits.
    """
    if not slope.size:
        return slope, precision
    unit = np.eye(slope.shape[1])
    scale = 1 / np.maximum(np.sqrt(np.maximum(np.einsum("npp->np", precision), 1e-300)), slope)
    P, s, low = precision * scale[:, None] * scale[:, :, None] + 1e-8 * unit, slope * scale, low / scale
    width = np.ones(s.shape)  # of the factors that stand for the bounds: precision, and that times mean
    shift = low + 1.0
    moving = np.arange(len(s))
    for _ in range(_STEPS):
        covariance = np.linalg.inv(P[moving] + width[moving, None] * unit)
        mean = (covariance @ (shift - s)[moving, :, None])[..., 0]
        variance = np.einsum("npp->np", covariance)
        left = np.maximum(1 / variance - width[moving], 1e-12)
        center = (mean / variance - shift[moving]) / left
        wanted, spread = _truncated(center, 1 / left, low[moving])
        new_width = np.maximum(1 / spread - left, 0.0)
        width[moving] += _DAMPED * (new_width - width[moving])
        shift[moving] += _DAMPED * (wanted / spread - center * left - shift[moving])
        moving = moving[~(np.max(np.abs(wanted - mean) / np.sqrt(spread), axis=1) < _SETTLED)]
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
