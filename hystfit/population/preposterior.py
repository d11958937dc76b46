"""How much a further estimate is expected to narrow the posterior of a population, before it is measured.

A device has z ~ N(B'x, Sigma), and a further estimate of it the precision P about z. Given mean and covariance, that estimate is normal
for a new device and for a device already measured, whose z has a normal posterior: estimates drawn from some draws of the population
weigh all draws by their likelihood, without fitting anything again (preposterior analysis: Raiffa and Schlaifer 1961). The mean over the
estimates of the weighted variance of a quantity is its expected posterior variance.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from hystfit.population.devices import DRAWS
from hystfit.population.hierarchy import Hierarchy, correlations_of

_ESTIMATES = 400  # drawn for each candidate, from as many of those draws
_LEAST = 0.02  # effective fraction of the draws below which an expected fall is not known


@dataclasses.dataclass(frozen=True)
class Beliefs:
    """Draws of a population, and of the quantities that are to become known."""

    effects: Float[np.ndarray, "n q p"]  # B, shape (n, q, p)
    covariance: Float[np.ndarray, "n p p"]  # Sigma, shape (n, p, p)
    means: Float[np.ndarray, "D p"]  # means, precisions: of the devices' likelihoods, shapes (D, p) and (D, p, p)
    precisions: Float[np.ndarray, "D p p"]
    design: Float[np.ndarray, "D q"]  # covariates of the devices, shape (D, q)
    quantities: Float[np.ndarray, "n m"]  # values at the draws, shape (n, m)
    # standard normal numbers, the same for all candidates, shape (estimates, p)
    noise: Float[np.ndarray, "estimates p"]

    @classmethod
    def of(
        cls, drawn: Hierarchy, means: np.ndarray, precisions: np.ndarray, design: np.ndarray, seed: int = 0
    ) -> Beliefs:
        """Quantities: logarithms of the standard deviations, correlations (below the diagonal, by row), then the mean device."""
        p, every = means.shape[1], drawn.joined
        kept = np.linspace(0, len(every.effects) - 1, min(DRAWS, len(every.effects))).astype(int)
        effects, covariance = every.effects[kept], every.covariance[kept]
        sd = np.sqrt(np.einsum("nii->ni", covariance))
        below = np.tril_indices(p, -1)
        correlations = correlations_of(covariance)[:, below[0], below[1]]
        quantities = np.concatenate([np.log(sd), correlations, effects[:, 0]], axis=1)
        noise = np.random.default_rng(seed).normal(size=(_ESTIMATES, p))
        return cls(effects, covariance, means, precisions, design, quantities, noise)

    @property
    def sd(self) -> Float[np.ndarray, " m"]:
        """Posterior standard deviations of the quantities."""
        return self.quantities.std(axis=0)

    def of_new(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of a new device at the mean of the covariates, by draw, shapes (n, p) and (n, p, p)."""
        return self.effects[:, 0], self.covariance

    def of_device(self, d: int) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of a measured device given the population and its data, by draw."""
        inverse = np.linalg.inv(self.covariance)
        middle = np.einsum("q,nqp->np", self.design[d], self.effects)
        covariance = np.linalg.inv(self.precisions[d] + inverse)
        pull = self.precisions[d] @ self.means[d] + np.einsum("nij,nj->ni", inverse, middle)
        return np.einsum("nij,nj->ni", covariance, pull), covariance

    def expected_fall(
        self, before: tuple[np.ndarray, np.ndarray], precision: Float[np.ndarray, "p p"]
    ) -> Float[np.ndarray, " m"]:
        """Expected fall of the posterior variances of the quantities by an estimate, as fractions; NaN where the draws are too few.

        Args:
            before: mean and covariance of the device, of `of_new` or `of_device`.
            precision: of the estimate; 0 in directions that it leaves open.
        """
        weights = self._weights(before, precision)
        effective = 1.0 / np.sum(weights**2, axis=1)
        if np.median(effective) < _LEAST * weights.shape[1]:
            return np.full(self.quantities.shape[1], np.nan)
        away = (self.quantities - self.quantities.mean(axis=0)) / np.maximum(self.sd, 1e-300)
        variance = weights @ away**2 - (weights @ away) ** 2
        unbiased = (1 - 1 / weights.shape[1]) / (1 - 1 / effective)  # of finitely many effective draws
        return np.clip(1 - np.mean(unbiased[:, None] * variance, axis=0), 0.0, 1.0)

    def _weights(self, before: tuple[np.ndarray, np.ndarray], precision: np.ndarray) -> np.ndarray:
        """Weights of the draws under estimates drawn from some of them, shape (estimates, n); each row adds up to one."""
        values, vectors = np.linalg.eigh(precision)
        root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T  # of unit noise: root z + N(0, I)
        mean, covariance = before[0] @ root.T, root @ before[1] @ root.T + np.eye(len(values))
        factor = np.linalg.cholesky(covariance)
        at = np.linspace(0, len(mean) - 1, len(self.noise)).astype(int)
        estimates = mean[at] + np.einsum("kij,kj->ki", factor[at], self.noise)
        inverse = np.linalg.inv(factor)
        scores = inverse @ estimates.T - inverse @ mean[:, :, None]  # (n, p, estimates)
        log_w = -0.5 * np.sum(scores**2, axis=1) - np.log(np.einsum("nii->ni", factor)).sum(axis=1)[:, None]
        weights = np.exp(log_w - log_w.max(axis=0)).T
        return weights / weights.sum(axis=1, keepdims=True)
