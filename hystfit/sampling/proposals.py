"""A mixture of t distributions that is fitted to a density by population Monte Carlo (Cappe et al. 2008, Stat. Comput. 18).

In the coordinates of `hystfit.sampling.target` most posteriors are nearly normal. No gradients are needed, and the densities of many
draws are computed together.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp, softmax
from scipy.stats import genpareto

from hystfit.params.host_arrays import to_device
from hystfit.sampling.target import ROWS, Target, log_densities_and_z

_FREEDOM = 10.0  # of the t distributions; 5 was no better
_WIDER = 1.1  # times the scale of the weighted places of a component: weights stay bounded where a posterior is skewed
_COMPONENTS = 5  # one alone leaves places with 80 to 2400 times the mean weight in the skewed tails of slow noise, five at most 70
_ALONE = 3  # rounds of one component, which finds place and scale
_ROUNDS = 12  # at most
_LEAST = 5 * ROWS  # draws of a round: 200 are too few to tell a funnel
# Draws of a round for each number in a mixture. Rounds of 1000 draws left two components for the 14 parameters of a piezo record, and 3 %
# of the draws that they offered were effective.
_EACH = 5
_PLACES = 3  # effective, for each dimension, that a covariance needs
_FLAT = 1e-6  # power of weights that leaves them equal
_RECENT = 4  # rounds that a mixture is fitted to
_STEADY = 0.5  # effective fraction of the draws of two rounds after which no further ones follow


@dataclasses.dataclass(frozen=True)
class Mixture:
    """A mixture of k t distributions over the coordinates q of a target; a root times its transpose is a scale matrix."""

    share: Float[np.ndarray, " k"]
    center: Float[np.ndarray, "k d"]
    root: Float[np.ndarray, "k d d"]

    def components(self, q: Float[np.ndarray, "n d"]) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, "k n"]]:
        """Log density of each component times its share, up to a constant, and squared distances from its center in its scale."""
        distances = np.sum(np.linalg.solve(self.root, q.T - self.center[..., None]) ** 2, axis=1)
        levels = np.log(self.share) - np.linalg.slogdet(self.root)[1]
        falls = 0.5 * (_FREEDOM + q.shape[1]) * np.log1p(distances / _FREEDOM)
        return levels[:, None] - falls, distances

    def log_density(self, q: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """Up to a constant."""
        return np.asarray(logsumexp(self.components(q)[0], axis=0))

    @property
    def round_size(self) -> int:
        """Number of draws of a round: several for each number in the mixture, and a multiple of `ROWS`."""
        k, d = self.center.shape
        return max(_LEAST, ROWS * math.ceil(_EACH * k * (d + 1) * (d + 2) / 2 / ROWS))

    def draw(self, rng: np.random.Generator, n: int) -> Float[np.ndarray, "n d"]:
        """Independent draws."""
        which = rng.choice(len(self.share), n, p=self.share)
        normal = np.einsum("nij,nj->ni", self.root[which], rng.normal(size=(n, self.center.shape[1])))
        return self.center[which] + np.sqrt(_FREEDOM / rng.chisquare(_FREEDOM, n))[:, None] * normal

    def refitted(self, batch: Batch) -> Mixture | None:
        """One step of population Monte Carlo to weighted places; None where they determine no component."""
        levels, distances = self.components(batch.q)
        parts = batch.tempered * softmax(levels, axis=0)  # of each place in each component
        pulls = parts * (_FREEDOM + batch.q.shape[1]) / (_FREEDOM + distances)
        found = []
        for part, pull in zip(parts, pulls, strict=True):
            share, center = part.sum(), pull @ batch.q / max(pull.sum(), np.finfo(float).tiny)
            if share**2 >= _PLACES * batch.q.shape[1] * np.sum(part**2) > 0:
                away = batch.q - center
                found.append((share, center, _WIDER * np.linalg.cholesky((pull * away.T) @ away / share)))
        if not found:
            return None
        share, center, root = (np.array(values) for values in zip(*found, strict=True))
        return Mixture(share / share.sum(), center, root)

    def split(self, batch: Batch, rng: np.random.Generator) -> Mixture:
        """As many components as there may be, of the scale of the first, about weighted places."""
        more = _COMPONENTS - 1
        center = np.concatenate([self.center[:1], batch.q[rng.choice(len(batch.q), more, p=batch.weights)]])
        return Mixture(np.full(1 + more, 1 / (1 + more)), center, np.repeat(self.root[:1], 1 + more, axis=0))


@dataclasses.dataclass(frozen=True)
class Batch:
    """Places q with their z, the log density of the target there, and logarithms of importance weights (`score`)."""

    q: Float[np.ndarray, "n d"]
    z: Float[np.ndarray, "n d"]
    log_density: Float[np.ndarray, " n"]
    score: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, target: Target, mixture: Mixture, rng: np.random.Generator, n: int) -> Batch:
        """`n` draws of a mixture, a multiple of `ROWS`."""
        q = mixture.draw(rng, n)
        parts = [log_densities_and_z(target, to_device(rows)) for rows in q.reshape(-1, ROWS, q.shape[1])]
        density, z = (np.concatenate([np.asarray(part[k]) for part in parts]) for k in (0, 1))
        density = np.nan_to_num(density, nan=-np.inf, posinf=-np.inf)
        return cls(q, z, density, density - mixture.log_density(q))

    @classmethod
    def joined(cls, batches: list[Batch]) -> Batch:
        """Batches, end to end."""
        names = (field.name for field in dataclasses.fields(cls))
        return cls(*(np.concatenate([getattr(batch, name) for batch in batches]) for name in names))

    @property
    def balanced(self) -> Batch:
        """The same places, weighted as far as they are effective: batches of several mixtures can be joined."""
        if not self.effective:
            return self
        return dataclasses.replace(self, score=self.score - logsumexp(self.score) + np.log(self.effective))

    @functools.cached_property
    def weights(self) -> Float[np.ndarray, " n"]:
        """Importance weights that sum to one; zero where no place has a density."""
        return softmax(self.score) if np.isfinite(self.score).any() else np.zeros(len(self.q))

    @property
    def tempered(self) -> Float[np.ndarray, " n"]:
        """Weights to the power, at most one, that leaves as many effective as a covariance needs (Koblents and Miguez 2015)."""
        power, enough = 1.0, 2 * _PLACES * self.q.shape[1]
        while power > _FLAT and len(self.q) * efficiency(power * self.score) < enough:
            power *= 0.9
        return softmax(power * self.score) if self.effective else self.weights

    @property
    def effective(self) -> float:
        """Effective number of places (Kish)."""
        return len(self.q) * efficiency(self.score)


def efficiency(score: Float[np.ndarray, " n"]) -> float:
    """Effective fraction of places with these logarithms of importance weights (Kish)."""
    return float(1 / (score.size * np.sum(softmax(score) ** 2))) if np.isfinite(score).any() else 0.0


def tail_shape(score: Float[np.ndarray, " n"]) -> float:
    """Shape k of the generalized Pareto distribution of the largest weights (Vehtari et al. 2024, J. Mach. Learn. Res. 25)."""
    largest = np.sort(np.exp(score - score.max()))[-int(3 * score.size**0.5) - 1 :]
    return float(genpareto.fit(largest[1:] - largest[0], floc=0)[0])


def adapted(target: Target, rng: np.random.Generator) -> tuple[Mixture, Batch] | None:
    """A mixture fitted to a target, and the draws of the last rounds, balanced; None where none is found."""
    d, batches = len(target.center), []
    mixture = Mixture(np.ones(1), np.zeros((1, d)), _WIDER * np.eye(d)[None])
    for number in range(1, _ROUNDS + 1):
        batches.append(Batch.of(target, mixture, rng, mixture.round_size))
        steady = min(efficiency(batch.score) for batch in batches[-2:]) >= _STEADY
        recent = Batch.joined([batch.balanced for batch in batches[-_RECENT:]])
        if number == _ROUNDS or (number > _ALONE + 2 and steady):
            return mixture, recent
        if not recent.effective:
            break
        following = mixture.split(recent, rng) if number == _ALONE else mixture.refitted(recent)
        if following is None:
            break
        mixture = following
    return None
