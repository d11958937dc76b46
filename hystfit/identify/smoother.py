"""Rauch-Tung-Striebel smoother of the unscented filter: states and parameters given the whole record."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hystfit.config import verb
from hystfit.data.record import Record
from hystfit.identify.base import Info, Sample
from hystfit.identify.ukf import Ukf, UkfState

_RANK = 1e-13  # of the largest eigenvalue: directions below it have no variance (one state is a function of others)


class Smoothed(NamedTuple):
    """A filtered and smoothed record.

    Attributes:
        filtered: mean of [state, z] after each sample, shape (T, n).
        mean: smoothed mean, shape (T, n).
        covariance: smoothed covariance, shape (T, n, n); optimistic, as that of the filter.
        info: diagnostics of the filter, leaves of shape (T, ...).
        state: of the filter after the last sample.
    """

    filtered: Float[Array, "T n"]
    mean: Float[Array, "T n"]
    covariance: Float[Array, "T n n"]
    info: Info
    state: UkfState


@verb
def smooth(ukf: Ukf, record: Record) -> Smoothed:
    """Filter a record, then smooth it backward.

    Memory is of the order T n^2: a few megabytes for 1e4 samples of ten coordinates.
    """
    return _smooth(ukf, Sample.stream([record]))


@eqx.filter_jit
def _smooth(ukf: Ukf, stream: Sample) -> Smoothed:
    def forward(state: UkfState, sample: Sample) -> tuple[UkfState, tuple[UkfState, Info]]:
        state, info = ukf.update(state, sample)
        return state, (state, info)

    last, (states, info) = jax.lax.scan(forward, ukf.init(), stream)
    final = jax.tree.map(lambda leaf: leaf[-1], states)
    end = (final.mean, final.root @ final.root.T - _added(ukf, stream, -1))

    def backward(after: tuple[Array, Array], step: tuple[UkfState, Sample, Array]) -> tuple[tuple, tuple]:
        mean, covariance = _back(ukf, *step, *after)
        return (mean, covariance), (mean, covariance)

    before = jax.tree.map(lambda leaf: leaf[:-1], states)
    following = jax.tree.map(lambda leaf: leaf[1:], stream)
    added = jax.vmap(lambda k: _added(ukf, stream, k))(jnp.arange(stream.u.size - 1))
    _, (means, covariances) = jax.lax.scan(backward, end, (before, following, added), reverse=True)
    mean = jnp.concatenate([means, end[0][None]])
    covariance = jnp.concatenate([covariances, end[1][None]])
    return Smoothed(states.mean, mean, covariance, info, last)


def _added(ukf: Ukf, stream: Sample, k: int | Array) -> Float[Array, "n n"]:
    """Covariance of the process noise that the root after sample k includes."""
    before = stream.u[jnp.maximum(jnp.asarray(k) % stream.u.size - 1, 0)]
    still = jnp.abs(stream.u[k] - before) <= ukf.still
    held = ukf.resting & still & ~stream.first[k]
    return jnp.diag(jnp.where(held, 0.0, ukf.walk) ** 2)


def _back(
    ukf: Ukf, state: UkfState, sample: Sample, added: Array, mean: Array, covariance: Array
) -> tuple[Array, Array]:
    """One step backward: gain = cov(now, next) cov(next)^-1; process noise enters between this sample and the step."""
    points = ukf.scheme.points(state.mean, state.root)
    moved, _ = ukf.propagate(state, sample.u, sample.dt)
    predicted = ukf.scheme.mean(moved)
    deviations, moved_deviations = points - state.mean, moved - predicted
    weight = ukf.scheme.weights(ukf.scheme.central_weight, points)[:, None]
    with_noise = state.root @ state.root.T
    filtered = with_noise - added
    predicted_covariance = (moved_deviations * weight).T @ moved_deviations
    gain = (deviations * weight).T @ moved_deviations @ _inverse(predicted_covariance)
    gain = filtered @ _inverse(with_noise) @ gain
    smoothed = filtered + gain @ (covariance - predicted_covariance) @ gain.T
    return state.mean + gain @ (mean - predicted), 0.5 * (smoothed + smoothed.T)


def _inverse(matrix: Array) -> Array:
    """Pseudo-inverse of a covariance, scaled to a unit diagonal first: coordinates differ in units."""
    scale = jnp.sqrt(jnp.maximum(jnp.diag(matrix), 1e-300))
    values, vectors = jnp.linalg.eigh(matrix / (scale[:, None] * scale[None, :]))
    inverse = jnp.where(values > _RANK * values[-1], 1.0 / jnp.where(values > 0, values, 1.0), 0.0)
    return (vectors * inverse) @ vectors.T / (scale[:, None] * scale[None, :])
