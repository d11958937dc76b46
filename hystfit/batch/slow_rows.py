"""Standard errors of solved loops whose residuals are autocorrelated, as those of a fit that is judged alone."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.batch.alike import Group, Loops
from hystfit.data.batch import Batch
from hystfit.data.dataset import Dataset
from hystfit.fitting.solvers.lanes import Stack, room
from hystfit.inference.noise.even_noise import BESIDE
from hystfit.inference.noise.setting import Setting
from hystfit.inference.noise.slow_likelihood import Contrasts, Samples, fit_slow_noises, least_squares_root
from hystfit.inference.objective import flat
from hystfit.inference.residuals import ResidualAnalysis, curves
from hystfit.params.host_arrays import NUMBERS, compiled


def slow_information(
    loops: Loops, stack: Stack, z: Float[np.ndarray, "N p"]
) -> tuple[Float[np.ndarray, "N p p"], np.ndarray]:
    """Information about the parameters at z, under slow and independent noise; and of which loops: not where error recurs every loop."""
    residual, jacobian = _linearized(stack, z)
    return loops.each(_of_group, residual, jacobian)


def _of_group(
    group: Group, residual: Float[np.ndarray, "N T"], jacobian: Float[np.ndarray, "N T p"]
) -> tuple[np.ndarray, np.ndarray]:
    """The matrices of loops over one input, and which are known."""
    samples, p = Samples.of(Setting.on_host(Batch.of(Dataset.of(group.record)))), jacobian.shape[2]
    on = np.flatnonzero(samples.on[0])
    information, known = np.full((len(residual), p, p), np.nan), np.zeros(len(residual), bool)
    size = max(1, BESIDE // ((p + 1) * (p + 2) // 2 * on.size))
    shapes = curves(samples)
    for begin in range(0, len(residual), size):
        at = slice(begin, begin + size)
        information[at], known[at] = _informations(samples, shapes, residual[at][:, on], jacobian[at][:, on])
    return information, known


def _informations(
    samples: Samples,
    shapes: Float[np.ndarray, "n k"],
    residual: Float[np.ndarray, "N n"],
    jacobian: Float[np.ndarray, "N n p"],
) -> tuple[Float[np.ndarray, "N p p"], np.ndarray]:
    """The matrices of loops on the same samples, and which are known."""
    jacobian = flat(jacobian)
    size = np.linalg.norm(jacobian, axis=1, keepdims=True)
    sound = np.isfinite(size).all(axis=(1, 2)) & (size > 0).all(axis=(1, 2))
    columns = jacobian / np.where(sound[:, None, None], size, 1.0)
    information = np.full((len(residual), columns.shape[2], columns.shape[2]), np.nan)
    fits = np.flatnonzero(sound)
    if not fits.size:
        return information, sound
    basis = np.linalg.qr(columns[fits])[0]
    noises = fit_slow_noises(Contrasts(samples, residual[fits], basis, np.zeros((residual.shape[1], 0))))
    for k, noise in zip(fits, noises, strict=True):
        analysis = ResidualAnalysis(
            samples.on, residual[k], lambda: samples, lambda k=k: columns[k], fitted=noise, shapes=shapes
        )
        sound[k] = analysis.of_errors is not None and not (analysis.repeating is not None and analysis.repeating.shown)
        if sound[k]:
            root = least_squares_root(noise, jacobian[k])
            information[k] = root.T @ root
    return information, sound


def _linearized(
    stack: Stack, z: Float[np.ndarray, "N p"]
) -> tuple[Float[np.ndarray, "N T"], Float[np.ndarray, "N T p"]]:
    """Residuals and their derivatives with respect to the physical parameters."""
    width = stack.samples * (z.shape[1] + 1)
    size, pieces = min(room(len(z)), 1 << (max(NUMBERS // width, 1).bit_length() - 1)), []
    for begin in range(0, len(z), size):
        at = np.minimum(np.arange(begin, begin + size), len(z) - 1)
        part = stack.take(at)
        rows = _linearize_rows(part, z[at])
        pieces.append([np.asarray(values)[: len(z) - begin] for values in rows])
    residual, jacobian = (np.concatenate(column) for column in zip(*pieces, strict=True))
    return residual, jacobian


@compiled
def _linearize_rows(stack: Stack, z: Array) -> tuple[Array, Array]:
    def one(k: Array) -> tuple[Array, Array]:
        single = stack.at(k)
        residual, jacobian = single.linearize(single.coordinates.physical(z[k]))
        return residual[0], jacobian[0]

    return jax.lax.map(one, jnp.arange(len(z)))
