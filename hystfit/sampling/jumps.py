"""Jumps between trajectories of NUTS: Metropolis steps to places that do not depend on the present one (Tierney 1994, Ann. Stat. 22).

In the coordinates of an adapted chain many posteriors are nearly normal. A draw from a t distribution fitted there is accepted about
every other time, and the densities of many such draws are computed together: each costs a sixtieth of a trajectory (11 and 680 us for
2000 samples of a Bouc-Wen model with slow noise). So one draw in ten is the end of a trajectory, and the others are ends of four
jumps. Where trajectories of the warm-up diverge, or importance weights tell that the t distribution does not cover the posterior, all
draws are ends of trajectories.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hystfit.params.host_arrays import to_device
from hystfit.sampling.target import Target, log_densities

CHUNK = 50  # draws in one compiled call, and between two writes to disk
_TRIES = 4  # jumps for each draw
_EVERY = 10  # draws, of which the first is the end of a trajectory
_FREEDOM = 10.0  # of the t distribution
_WIDER = 1.25  # times the standard deviations of the posterior: else chains stay in its skewed tails for long
_ROUNDS = 3  # of 200 weighted draws each, which improve a fit to the positions of a warm-up
_CHECKS = 5  # of 200 draws each, by which the last fit is judged: 200 are too few to tell a funnel
_EFFICIENT = 0.3  # effective fraction of draws: 0.5 to 0.7 for posteriors of Bouc-Wen models, at most 0.25 for funnels


class Jumps(eqx.Module):
    """A t distribution over the coordinates q of a chain, wider than the posterior.

    Attributes:
        center: its mean.
        root: times its transpose the covariance; and the inverse of it.
    """

    center: Float[Array, " d"]
    root: Float[Array, "d d"]
    inverse: Float[Array, "d d"]

    @classmethod
    def of(cls, center: Float[np.ndarray, " d"], root: Float[np.ndarray, "d d"]) -> Jumps:
        """From center and root."""
        return cls(to_device(center), to_device(root), to_device(np.linalg.inv(root)))

    @classmethod
    def about(cls, positions: Float[np.ndarray, "n d"], weights: Float[np.ndarray, " n"]) -> Jumps:
        """About positions with weights."""
        weights = weights / weights.sum()
        center = weights @ positions
        away = positions - center
        return cls.of(center, _WIDER * np.linalg.cholesky((weights * away.T) @ away))

    def log_density(self, q: Any, xp: Any = jnp) -> Any:
        """Up to a constant, at q of shape (..., d); `xp` is the module of the arrays."""
        e = (q - xp.asarray(self.center)) @ xp.asarray(self.inverse).T
        return -0.5 * (_FREEDOM + q.shape[-1]) * xp.log1p(xp.sum(e**2, axis=-1) / (_FREEDOM - 2))

    def offers(self, target: Target, key: Array) -> Offers:
        """Jumps for one chunk; outside traced code."""
        # By NumPy: JAX takes two seconds to compile draws of gamma variables.
        rng, n, d = np.random.default_rng(np.asarray(jax.random.key_data(key))), CHUNK * _TRIES, self.center.shape[0]
        stretch = np.sqrt((_FREEDOM - 2) / rng.chisquare(_FREEDOM, n))
        q = np.asarray(self.center) + stretch[:, None] * rng.normal(size=(n, d)) @ np.asarray(self.root).T
        density = np.asarray(log_densities(target, to_device(q)))
        score = density - self.log_density(q, np)
        offered = (to_device(v.reshape(CHUNK, _TRIES, *v.shape[1:])) for v in (q, density, score))
        return Offers(self, to_device(np.arange(CHUNK) % _EVERY > 0), tuple(offered))

    def taken(self, key: Array, position: Array, density: Array, offered: Any) -> tuple[Array, Array]:
        """Place and log density after one Metropolis step to each of the offered (places, log densities, scores), one after another."""
        levels = jnp.log(jax.random.uniform(key, offered[1].shape))

        def attempt(here: tuple[Array, ...], at: tuple[Array, ...]) -> tuple[tuple[Array, ...], None]:
            (*there, level) = at
            return tuple(jnp.where(level < there[-1] - here[-1], b, a) for a, b in zip(here, there, strict=True)), None

        here = (position, density, density - self.log_density(position))
        (position, density, _), _ = jax.lax.scan(attempt, here, (*offered, levels))
        return position, density


class Offers(eqx.Module):
    """Jumps for a chunk of draws.

    Attributes:
        jumps: their distribution.
        on: which draws end jumps, not a trajectory.
        offered: places, the log densities of the target there, and scores, the logarithms of importance weights; four for each draw.
    """

    jumps: Jumps
    on: Bool[Array, " n"]
    offered: tuple[Float[Array, "n k d"], Float[Array, "n k"], Float[Array, "n k"]]

    @classmethod
    def none(cls, d: int) -> Offers:
        """All draws end trajectories."""
        zeros, places = to_device(np.zeros((CHUNK, _TRIES))), to_device(np.zeros((CHUNK, _TRIES, d)))
        nowhere = Jumps.of(np.zeros(d), np.eye(d))
        return cls(nowhere, to_device(np.zeros(CHUNK, dtype=bool)), (places, zeros, zeros))


def fitted(target: Target, positions: Float[np.ndarray, "n d"], key: Array) -> Jumps | None:
    """Jumps fitted to positions of a chain; None where they do not cover the posterior well enough."""
    places, counts = positions, np.ones(len(positions))
    for k in range(_ROUNDS):
        if counts.sum() < 2 * places.shape[1]:
            return None
        q, weights = _weighted(target, Jumps.about(places, counts), [jax.random.fold_in(key, k)])
        places, counts = np.concatenate([places, q]), np.concatenate([counts, weights / np.sum(weights**2)])
    jumps = Jumps.about(places, counts)
    q, weights = _weighted(target, jumps, [jax.random.fold_in(key, _ROUNDS + k) for k in range(_CHECKS)])
    return jumps if 1 / np.sum(weights**2) >= _EFFICIENT * len(q) else None


def _weighted(target: Target, jumps: Jumps, keys: list[Array]) -> tuple[np.ndarray, np.ndarray]:
    """Places, and importance weights that sum to one."""
    offered = [jumps.offers(target, key).offered for key in keys]
    q, score = (np.concatenate([np.asarray(part[k]) for part in offered]) for k in (0, 2))
    score = np.nan_to_num(score.ravel(), nan=-np.inf, posinf=-np.inf)
    weights = np.exp(score - max(score.max(), np.finfo(float).min))
    return q.reshape(-1, q.shape[-1]), weights / max(weights.sum(), 1.0)
