"""Noises of which the sampler of weights draws one in each sweep."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax
import numpy as np

from hystfit.inference.noise.exponential import LEAST_TIME
from hystfit.inference.noise.slow_likelihood import Contrasts, Samples, SlowNoiseFit, slow_solver
from hystfit.inference.priors import AbstractPrior
from hystfit.params.host_arrays import to_device

_STEPS = np.array([-2.4, -1.2, 0.0, 1.2, 2.4])  # of the grid of noises along each axis, in standard deviations
_SHORTEST = 1.001 * LEAST_TIME  # correlation time, samples: just inside the range of its prior


class NoiseGrid(eqx.Module):
    """Noises by their share of the posterior, about the most probable one: ratios of white to slow variance (None: white), and times.

    The shares are those that the residuals of a fit tell, and the weights do not change them: a cut (Plummer 2015, Stat. Comput. 25).
    Hundreds of weights and slow noise otherwise exchange what the model does not describe. On three loops of electrical steel the joint
    posterior has a correlation time of 280 samples, of the 256 in each, and a loss of 157 +- 5 J/m3, where the largest loop has 88.
    """

    models: ClassVar[tuple[str, ...]] = ("iid", "ou")  # noise models that are on such grids
    ratios: Any
    times: Any
    log_shares: Any

    @classmethod
    def one(cls, ratio: float | None = None, time: float = 0.0) -> NoiseGrid:
        """A single noise, by default a white one."""
        return cls(None if ratio is None else np.array([ratio]), np.array([time]), np.zeros(1))

    @classmethod
    def about(cls, fit: SlowNoiseFit, contrasts: Contrasts, prior: AbstractPrior) -> NoiseGrid:
        """Along the principal axes of the logarithms of both; `contrasts` know the noise, `prior` is of the correlation time."""
        place = lambda noise: np.log([(noise.white / noise.slow) ** 2, noise.time])
        center, others = place(fit.noise), np.array([place(noise) for noise in fit.others])
        # Nodes of a 3 x 3 Gauss-Hermite rule: the neighbors of the middle one lie at sqrt(3) standard deviations.
        first, second = (others[5] - others[4]) / np.sqrt(3), (others[7] - others[4]) / np.sqrt(3)
        at = center + (_STEPS[:, None, None] * first + _STEPS[None, :, None] * second).reshape(-1, 2)
        ratios, times = np.exp(at[:, 0]), np.maximum(np.exp(at[:, 1]), _SHORTEST)
        log_shares = (
            np.asarray(jax.vmap(prior.log_density)(to_device(times)))
            + np.log(times)
            - 0.5 * contrasts.at(ratios, times)[0]
        )
        return cls(ratios, times, log_shares - log_shares.max())

    def solvers(self, samples: Samples) -> list[tuple[Any, float]]:
        """For each noise: the inverse covariance over the variance times columns, and the log determinant."""
        if self.ratios is None:
            return [(lambda rows: rows, 0.0)]
        return [slow_solver(samples, ratio, time) for ratio, time in zip(self.ratios, self.times, strict=True)]

    def parameters(self, number: Any, variance: Any, xp: Any = np) -> Any:
        """Parameters of the noise model from numbers and variances [y^2], in the order of its declarations: shape (..., q)."""
        if self.ratios is None:
            return xp.sqrt(variance)[..., None]
        white = xp.sqrt(variance * xp.asarray(self.ratios)[number])
        return xp.stack([white, xp.sqrt(variance), xp.asarray(self.times)[number]], axis=-1)
