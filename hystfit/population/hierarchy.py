"""The second stage of a population: mean and covariance of the devices' parameters, by conjugate Gibbs sampling.

Device d has parameters z_d ~ N(X_d B, Sigma), and its data give z_d through a likelihood that is nearly normal with mean m_d and
precision P_d. In turns

    z_d | B, Sigma      normal,
    B | z, Sigma        normal (flat prior),
    Sigma | z, a        inverse Wishart, and a | Sigma inverse gamma,

which is the prior of Huang and Wand (2013, Bayesian Analysis 8:439): half-t on every standard deviation, uniform on every correlation
for two degrees of freedom. Where devices differ less than the errors of their fits, these steps are short: two more move all devices
together with the mean, and all deviations together with a standard deviation (Liu and Sabatti 2000, Biometrika 87:353). Where the
likelihood of a device is not normal, draws from it under a known prior are the proposals of a Metropolis step (Lunn et al. 2013, Journal
of the Royal Statistical Society C 62:551).
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from jaxtyping import Float

_NU = 2.0  # degrees of freedom of the half-t: correlations are uniform
_SCALE = 1.0  # of the half-t: a factor e between devices, or a natural scale of the data
_BURN = 0.25  # of the draws, before the first one that is kept
_STEP = 0.7  # of the logarithm of a standard deviation that is scaled together with the deviations
_RIDGE = 1e-9  # relative to the precision of the population, for directions that a device's data do not determine


@dataclasses.dataclass(frozen=True)
class Pool:
    """Draws from the posterior of one device under a prior of its own.

    Attributes:
        z: shape (n, p).
        log_prior: of that prior at the draws, shape (n,).
    """

    z: Float[np.ndarray, "n p"]
    log_prior: Float[np.ndarray, " n"]


@dataclasses.dataclass(frozen=True)
class Hierarchy:
    """Draws of a population.

    Attributes:
        effects: B, shape (chains, draws, q, p); the first row is the mean device.
        covariance: Sigma, shape (chains, draws, p, p).
        z: of the devices, shape (chains, draws, D, p).
    """

    effects: np.ndarray
    covariance: np.ndarray
    z: np.ndarray


def draw_hierarchy(
    means: Float[np.ndarray, "D p"],
    precisions: Float[np.ndarray, "D p p"],
    design: Float[np.ndarray, "D q"],
    *,
    pools: dict[int, Pool] | None = None,
    chains: int = 4,
    draws: int = 1000,
    thin: int = 1,
    seed: int = 0,
) -> Hierarchy:
    """Draw mean, covariance and devices.

    Args:
        means: maxima of the devices' likelihoods.
        precisions: curvatures there; a direction without information has none.
        design: covariates of the devices, the first column of ones.
        pools: draws of the devices, by number, whose likelihood is not normal.
        chains, draws: of the sampler; a quarter as many come before.
        thin: steps for each draw.
        seed: of the random numbers.
    """
    each = [
        _Chain(means, precisions, design, pools or {}, np.random.default_rng([seed, number])).run(draws, thin)
        for number in range(chains)
    ]
    return Hierarchy(*(np.stack(parts) for parts in zip(*each, strict=True)))


class _Chain:
    """One chain: its data, and the present values."""

    def __init__(
        self,
        means: np.ndarray,
        precisions: np.ndarray,
        design: np.ndarray,
        pools: dict[int, Pool],
        rng: np.random.Generator,
    ):
        self.precisions, self.design, self.pools, self.rng = precisions, design, pools, rng
        self.means = means
        self.free = np.setdiff1d(np.arange(len(means)), sorted(pools))  # devices whose values can be moved
        self.pull = np.einsum("dij,dj->di", precisions, means)
        self.inverse = np.linalg.inv(design.T @ design)
        self.root = np.linalg.cholesky(self.inverse)
        p = means.shape[1]
        # Devices that a direction leaves open start at the weighted mean of the others.
        weight = np.einsum("dii->di", precisions)
        center = np.sum(weight * means, axis=0) / np.maximum(weight.sum(axis=0), 1e-300)
        known = weight > 1e-6 * weight.max(axis=0)
        self.z = np.where(known, means, center)
        spread = np.maximum(self.z.std(axis=0), 1e-3)
        self.covariance = np.diag((spread * np.exp(rng.normal(0, 0.5, p))) ** 2)
        self.effects = self.inverse @ design.T @ self.z
        self.at = {d: int(rng.integers(len(pool.z))) for d, pool in pools.items()}
        self.prior_scale = np.ones(p)

    def run(self, draws: int, thin: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Kept draws of B, Sigma and z."""
        kept: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        for k in range(-int(_BURN * draws * thin), draws * thin):
            self._devices()
            self._effects()
            self._covariance()
            self._shift()
            self._scale()
            if k >= 0 and k % thin == 0:
                kept.append((self.effects, self.covariance, self.z))
        effects, covariance, z = (np.stack(part) for part in zip(*kept, strict=True))
        return effects, covariance, z

    def _devices(self) -> None:
        inverse = np.linalg.inv(self.covariance)
        middle = self.design @ self.effects
        total = self.precisions + inverse * (1 + _RIDGE)
        factor = np.linalg.cholesky(total)
        mean = np.linalg.solve(total, (self.pull + middle @ inverse)[..., None])[..., 0]
        noise = self.rng.normal(size=mean.shape)
        self.z = mean + np.linalg.solve(np.swapaxes(factor, 1, 2), noise[..., None])[..., 0]
        for d, pool in self.pools.items():
            other = int(self.rng.integers(len(pool.z)))
            pair = np.array([self.at[d], other])
            away = pool.z[pair] - middle[d]
            score = -0.5 * np.einsum("ki,ij,kj->k", away, inverse, away) - pool.log_prior[pair]
            if np.log(self.rng.uniform()) < score[1] - score[0]:
                self.at[d] = other
            self.z[d] = pool.z[self.at[d]]

    def _effects(self) -> None:
        mean = self.inverse @ self.design.T @ self.z
        noise = self.rng.normal(size=mean.shape)
        self.effects = mean + self.root @ noise @ np.linalg.cholesky(self.covariance).T

    def _covariance(self) -> None:
        count, p = self.z.shape
        away = self.z - self.design @ self.effects
        shape = (_NU + p) / 2
        rate = _NU * np.diag(np.linalg.inv(self.covariance)) + _SCALE**-2
        self.prior_scale = rate / self.rng.gamma(shape, size=p)
        scale = 2 * _NU * np.diag(1 / self.prior_scale) + away.T @ away
        # Bartlett's decomposition of the Wishart matrix, a tenth of the time of scipy.stats.invwishart.
        lower = np.tril(self.rng.normal(size=(p, p)), -1)
        lower[np.diag_indices(p)] = np.sqrt(self.rng.chisquare(_NU + p - 1 + count - np.arange(p)))
        root = np.linalg.solve(lower, np.linalg.cholesky(scale).T)
        self.covariance = root.T @ root

    def _shift(self) -> None:
        """Move the mean and all devices together, which the population leaves free."""
        if self.pools:
            return
        total = self.precisions.sum(axis=0)
        total = total + _RIDGE * np.trace(total) * np.eye(len(total))
        factor = np.linalg.cholesky(total)
        mean = np.linalg.solve(total, (self.pull - np.einsum("dij,dj->di", self.precisions, self.z)).sum(axis=0))
        shift = mean + np.linalg.solve(factor.T, self.rng.normal(size=mean.size))
        self.z = self.z + shift
        self.effects = self.effects + np.eye(len(self.effects))[0][:, None] * shift

    def _scale(self) -> None:
        """Scale one standard deviation after another together with the deviations from the mean."""
        p, middle, free = self.z.shape[1], self.design @ self.effects, self.free
        inverse = np.linalg.inv(self.covariance)
        z, curvature = self.z.copy(), self.precisions[free]
        slope = np.einsum("dij,dj->di", curvature, z[free] - self.means[free])
        steps, levels = _STEP * self.rng.normal(size=p), np.log(self.rng.uniform(size=p))
        factors = np.ones(p)
        for k in range(p):
            c = math.exp(steps[k])
            move = (c - 1) * (z[free, k] - middle[free, k])
            gain = (1 - _NU - p) * steps[k] - float(move @ slope[:, k] + 0.5 * (move * move) @ curvature[:, k, k])
            before, after = _NU * inverse[k, k] + _SCALE**-2, _NU * inverse[k, k] / c**2 + _SCALE**-2
            gain += 0.5 * (_NU + p) * math.log(before / after)
            new = inverse
            if self.pools:
                scale = np.ones(p)
                scale[k] = c
                new = inverse / scale[:, None] / scale
                for d in self.pools:
                    away = z[d] - middle[d]
                    gain += 0.5 * float(away @ (inverse - new) @ away) - steps[k]
            if levels[k] < gain:
                z[free, k] += move
                slope += curvature[:, :, k] * move[:, None]
                factors[k] = c
                if self.pools:
                    inverse = new
        self.z, self.covariance = z, self.covariance * factors[:, None] * factors
