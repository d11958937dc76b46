"""Bias of one-step regression from noise on the output, estimated from its residuals.

Noise n_k enters the response as n_k - n_(k-1) and the regressor of alpha as -a n_(k-1) (explicit) or -a (n_k + n_(k-1)) / 2
(midpoint). With variance s^2 the expected normal equations are those of the truth plus s^2 times

    explicit  sum a^2      on the diagonal entry of alpha (attenuation),   sum a   on its right side (attraction to 1/a);
    midpoint  sum a^2 / 2  on the diagonal entry of alpha,                 nothing on its right side.

Faster sampling leaves sum a unchanged and reduces the information on alpha, so explicit regression gets worse; midpoint
regression has no such term. s^2 follows from the residuals: where noise dominates, neighbors have the covariance -s^2.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.identify.duhem_regression import DuhemRegressor, Rows
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.quality.faults import CLEAR

_SERIOUS = 0.1  # relative bias of alpha above which a warning is given


@dataclasses.dataclass(frozen=True)
class NoiseBias:
    """Output noise and its effect on the rate.

    Attributes:
        noise: standard deviation of white output noise [y]; 0 where the residuals show none.
        alpha: identified rate [1/u].
        corrected: rate without the expected effect of the noise [1/u]; None where the noise is too large to correct for.
        theta: all scaled parameters corrected likewise, shape (p,), or None.
        explicit: whether the regressors are explicit.
    """

    noise: float
    alpha: float
    corrected: float | None
    theta: np.ndarray | None
    explicit: bool

    @property
    def relative(self) -> float | None:
        """(identified - corrected) / corrected; None without a corrected rate."""
        return None if self.corrected is None else self.alpha / self.corrected - 1.0

    @property
    def serious(self) -> bool:
        """Whether the bias of the rate exceeds 10 %."""
        return self.relative is None or abs(self.relative) > _SERIOUS

    def note(self, unit: str) -> Note | None:
        """A warning with the remedy where the bias is serious; `unit` is that of the output."""
        if not self.serious:
            return None
        size = f"noise of {self.noise:.3g}{f' {unit}' if unit else ''} (standard deviation, from the residuals)"
        effect = (
            "is too large to identify the rate alpha"
            if self.relative is None
            else f"biases the rate alpha by about {self.relative:+.0%}"
        )
        first = "use midpoint regressors (scheme='midpoint'); " if self.explicit else ""
        return warn(
            Code.NOISE_BIAS,
            f"{size} {effect}: {first}output-error least squares (method='lm') has no such bias; where the regression must stay "
            "linear, use hystfit.identify.integrated_regression or bias_compensated",
        )


def noise_bias(regressor: DuhemRegressor, rows: Rows, theta: np.ndarray, weight: np.ndarray | None = None) -> NoiseBias:
    """Noise level and bias of a least-squares estimate.

    Args:
        regressor: of the rows.
        rows: the regression, K rows.
        theta: its least-squares solution, shape (p,).
        weight: of each row, shape (K,); None weights all alike.
    """
    regressor, rows, theta = regressor.scaled(rows, theta)
    weight = np.ones(rows.target.size) if weight is None else weight
    explicit, k = regressor.scheme == "explicit", regressor.m
    lever = float(regressor.half / regressor.step)
    variance = _noise_variance(regressor, rows, theta) / lever**2  # of W, the scaled output
    normal = rows.phi.T @ (weight[:, None] * rows.phi)
    column = np.linalg.lstsq(normal, np.eye(regressor.p)[k], rcond=None)[0]
    attraction = variance * lever * np.sum(weight * rows.travel) if explicit else 0.0
    attenuation = variance * np.sum(weight * rows.travel**2) * (1.0 if explicit else 0.5)
    remaining = 1.0 - column[k] * attenuation
    alpha = float(theta[k])
    corrected = (alpha - column[k] * attraction) / remaining if remaining > 0 else np.nan
    half, noise = float(regressor.half), float(np.sqrt(variance) * regressor.size)
    if not (np.isfinite(corrected) and corrected > 0):
        return NoiseBias(noise, alpha / half, None, None, explicit)
    full = theta - column * (attraction - attenuation * corrected)
    return NoiseBias(noise, alpha / half, float(corrected) / half, full, explicit)


def _noise_variance(regressor: DuhemRegressor, rows: Rows, theta: np.ndarray) -> float:
    """Variance of white noise in the target, from the covariance of neighboring residuals; 0 unless that is clearly negative."""
    e = rows.target - rows.phi @ theta
    e = e - e.mean()
    pairs = np.flatnonzero(np.diff(rows.at) == 1)
    if pairs.size < 10:
        return 0.0
    drive = theta[regressor.m] * rows.travel * float(regressor.step / regressor.half)
    # e_k = n_k (1 + later) - n_(k-1) (1 - earlier), and neighbors share n_k
    later, earlier = (0.0 * drive, drive) if regressor.scheme == "explicit" else (0.5 * drive, 0.5 * drive)
    share = np.mean((1 + later[pairs]) * (1 - earlier[pairs + 1]))
    covariance = float(np.mean(e[pairs] * e[pairs + 1]))
    significant = -covariance > CLEAR * float(np.mean(e**2)) / np.sqrt(pairs.size)
    return -covariance / share if significant and share > 0 else 0.0
