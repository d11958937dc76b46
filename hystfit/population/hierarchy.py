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
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from hystfit.outcome import Note

_NU = 2.0  # degrees of freedom of the half-t, whose scale is a factor e between devices or a natural scale: correlations are uniform
_BURN = 0.25  # of the draws, before the first one that is kept
_STEP = 0.7  # of the logarithm of a standard deviation that is scaled together with the deviations
_RIDGE = 1e-9  # relative to the precision of the population, for directions that a device's data do not determine


@dataclasses.dataclass(frozen=True)
class Pool:
    """Draws z, (n, p), from the posterior of one device under a prior of its own, and why they do not stand for it."""

    z: Float[np.ndarray, "n p"]
    log_prior: Float[np.ndarray, " n"]
    problems: tuple[Note, ...] = ()


@dataclasses.dataclass(frozen=True)
class Hierarchy:
    """Draws of a population, (chains, draws, ...): effects (q, p), the mean device first, covariance (p, p), and devices' z (D, p)."""

    effects: np.ndarray
    covariance: np.ndarray
    z: np.ndarray

    @property
    def joined(self) -> Hierarchy:
        """The draws of all chains one after the other: the first two axes of each array as one."""
        return Hierarchy(*(draws.reshape(-1, *draws.shape[2:]) for draws in (self.effects, self.covariance, self.z)))


def correlations_of(covariance: np.ndarray) -> np.ndarray:
    """Correlations of covariances, shape (n, p, p)."""
    sd = np.sqrt(np.einsum("nii->ni", covariance))
    return covariance / (sd[:, :, None] * sd[:, None, :])


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

    Given are the maxima of the devices' likelihoods and the curvatures there (a direction without information has none), their covariates,
    the first column of ones, and draws of the devices, by number, whose likelihood is not normal. A quarter as many draws come before those
    of each chain, and `thin` steps before each.
    """
    chain = _Chains(means, precisions, design, pools or {}, [np.random.default_rng([seed, k]) for k in range(chains)])
    return Hierarchy(*chain.run(draws, thin))


class _Chains:
    """Chains side by side, each with random numbers of its own: their data, and the present values with an axis of chains in front."""

    def __init__(
        self,
        means: np.ndarray,
        precisions: np.ndarray,
        design: np.ndarray,
        pools: dict[int, Pool],
        sources: Sequence[np.random.Generator],
    ):
        self.means, self.precisions, self.design, self.pools, self.sources = means, precisions, design, pools, sources
        self.free = np.setdiff1d(np.arange(len(means)), sorted(pools))  # devices whose values can be moved
        self.pull = np.einsum("dij,dj->di", precisions, means)
        self.inverse = np.linalg.inv(design.T @ design)
        self.root = np.linalg.cholesky(self.inverse)
        p = means.shape[1]
        # Devices that a direction leaves open start at the weighted mean of the others.
        weight = np.einsum("dii->di", precisions)
        center = np.sum(weight * means, axis=0) / np.maximum(weight.sum(axis=0), 1e-300)
        z = np.where(weight > 1e-6 * weight.max(axis=0), means, center)
        spread = np.maximum(z.std(axis=0), 1e-3) * np.exp(self._each(lambda rng: rng.normal(0, 0.5, p)))
        self.z = np.repeat(z[None], len(sources), axis=0)
        self.covariance = spread[:, :, None] ** 2 * np.eye(p)
        self.effects = self.inverse @ design.T @ self.z
        self.at = {d: self._each(lambda rng, pool=pool: rng.integers(len(pool.z))) for d, pool in pools.items()}

    def _each(self, draw: Callable[[np.random.Generator], Any]) -> np.ndarray:
        """Random numbers of every chain."""
        return np.stack([draw(rng) for rng in self.sources])

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
        effects, covariance, z = (np.stack(part, axis=1) for part in zip(*kept, strict=True))
        return effects, covariance, z

    def _devices(self) -> None:
        inverse = np.linalg.inv(self.covariance)
        middle = self.design @ self.effects
        total = self.precisions + inverse[:, None] * (1 + _RIDGE)
        mean = np.linalg.solve(total, (self.pull + middle @ inverse)[..., None])[..., 0]
        noise = self._each(lambda rng: rng.normal(size=mean.shape[1:]))
        self.z = mean + np.linalg.solve(np.linalg.cholesky(total).swapaxes(2, 3), noise[..., None])[..., 0]
        for d, pool in self.pools.items():
            pair = np.stack([self.at[d], self._each(lambda rng, pool=pool: rng.integers(len(pool.z)))], axis=1)
            away = pool.z[pair] - middle[:, None, d]
            score = -0.5 * np.einsum("cki,cij,ckj->ck", away, inverse, away) - pool.log_prior[pair]
            taken = np.log(self._each(lambda rng: rng.uniform())) < score[:, 1] - score[:, 0]
            self.at[d] = np.where(taken, pair[:, 1], pair[:, 0])
            self.z[:, d] = pool.z[self.at[d]]

    def _effects(self) -> None:
        mean = self.inverse @ self.design.T @ self.z
        noise = self._each(lambda rng: rng.normal(size=mean.shape[1:]))
        self.effects = mean + self.root @ noise @ np.linalg.cholesky(self.covariance).swapaxes(1, 2)

    def _covariance(self) -> None:
        _, count, p = self.z.shape
        diagonal = np.arange(p)
        away = self.z - self.design @ self.effects
        shape = (_NU + p) / 2
        rate = _NU * np.linalg.inv(self.covariance)[:, diagonal, diagonal] + 1
        scale = away.swapaxes(1, 2) @ away
        scale[:, diagonal, diagonal] += 2 * _NU * self._each(lambda rng: rng.gamma(shape, size=p)) / rate
        # Bartlett's decomposition of the Wishart matrix, a tenth of the time of scipy.stats.invwishart.
        lower = np.tril(self._each(lambda rng: rng.normal(size=(p, p))), -1)
        lower[:, diagonal, diagonal] = np.sqrt(self._each(lambda rng: rng.chisquare(_NU + p - 1 + count - diagonal)))
        root = np.linalg.solve(lower, np.linalg.cholesky(scale).swapaxes(1, 2))
        self.covariance = root.swapaxes(1, 2) @ root

    def _shift(self) -> None:
        """Move the mean and all devices together, which the population leaves free."""
        if self.pools:
            return
        total = self.precisions.sum(axis=0)
        total = total + _RIDGE * np.trace(total) * np.eye(len(total))
        pull = (self.pull - np.einsum("dij,cdj->cdi", self.precisions, self.z)).sum(axis=1)
        noise = self._each(lambda rng: rng.normal(size=len(total)))
        shift = np.linalg.solve(total, pull.T) + np.linalg.solve(np.linalg.cholesky(total).T, noise.T)
        self.z = self.z + shift.T[:, None]
        self.effects = self.effects.copy()
        self.effects[:, 0] += shift.T

    def _scale(self) -> None:
        """Scale one standard deviation after another together with the deviations from the mean."""
        p, middle, free = self.z.shape[2], self.design @ self.effects, self.free
        new = inverse = np.linalg.inv(self.covariance)
        z, curvature = self.z.copy(), self.precisions[free]
        slope = np.einsum("dij,cdj->cdi", curvature, z[:, free] - self.means[free])
        steps = _STEP * self._each(lambda rng: rng.normal(size=p))
        levels = np.log(self._each(lambda rng: rng.uniform(size=p)))
        factors = np.ones_like(steps)
        for k in range(p):
            c = np.exp(steps[:, k])
            move = (c - 1)[:, None] * (z[:, free, k] - middle[:, free, k])
            gain = (1 - _NU - p) * steps[:, k]
            gain -= np.sum(move * (slope[:, :, k] + 0.5 * move * curvature[:, k, k]), axis=1)
            own = _NU * inverse[:, k, k]
            gain += 0.5 * (_NU + p) * np.log((own + 1) / (own / c**2 + 1))
            if self.pools:
                shrunk = np.ones_like(steps)
                shrunk[:, k] = 1 / c
                new = inverse * shrunk[:, :, None] * shrunk[:, None]
                for d in self.pools:
                    away = z[:, d] - middle[:, d]
                    gain += 0.5 * np.einsum("ci,cij,cj->c", away, inverse - new, away) - steps[:, k]
            taken = levels[:, k] < gain
            move *= taken[:, None]
            z[:, free, k] += move
            slope += curvature[:, :, k] * move[:, :, None]
            factors[:, k] = np.where(taken, c, 1.0)
            if self.pools:
                inverse = np.where(taken[:, None, None], new, inverse)
        self.z, self.covariance = z, self.covariance * factors[:, :, None] * factors[:, None]
