"""Standard errors of solved loops whose residuals are autocorrelated, as those of a fit that is judged alone."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.batch.alike import Group, Loops
from hystfit.config import first_device
from hystfit.data.batch import Batch
from hystfit.data.dataset import Dataset
from hystfit.fitting.lanes import Stack, objective_at, placed, room
from hystfit.inference.noise.setting import Setting
from hystfit.inference.noise.slow_likelihood import least_squares_root
from hystfit.inference.objective import Objective, flat
from hystfit.inference.residuals import ResidualAnalysis

_NUMBERS = 2**22  # derivatives computed in one call


def slow_information(
    loops: Loops, stack: Stack, z: Float[np.ndarray, "N p"]
) -> tuple[Float[np.ndarray, "N p p"], np.ndarray]:
    """Information about the parameters under slow and independent noise with the statistics of the residuals, in output units.

    Args:
        loops: with equal weights.
        stack: their problems.
        z: estimates, unconstrained.

    Returns:
        The matrices, and of which loops: not where error recurs every loop, or where such noise is not plausible.
    """
    residual, jacobian = _linearized(stack, z)

    def of_group(group: Group, residual: np.ndarray, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        setting = Setting.of(Batch.of(Dataset.of(group.record)))
        pairs = [_information(setting, *pair) for pair in zip(residual, jacobian, strict=True)]
        return np.stack([matrix for matrix, _ in pairs]), np.array([known for _, known in pairs])

    return loops.each(of_group, residual, jacobian)


def _information(
    setting: Setting, residual: Float[np.ndarray, " T"], jacobian: Float[np.ndarray, "T p"]
) -> tuple[np.ndarray, bool]:
    """The matrix of one loop, and whether it is known."""
    on, p = np.asarray(setting.weight)[0] > 0, jacobian.shape[1]
    columns = flat(jacobian[: on.size][on])
    size = np.linalg.norm(columns, axis=0)
    nothing = np.full((p, p), np.nan), False
    if not (np.isfinite(columns).all() and (size > 0).all()):
        return nothing
    analysis = ResidualAnalysis.of(setting, residual[: on.size], lambda: columns / size)
    if (analysis.repeating is not None and analysis.repeating.shown) or analysis.of_errors is None:
        return nothing
    root = least_squares_root(analysis.of_errors, columns)
    return root.T @ root, True


def _linearized(
    stack: Stack, z: Float[np.ndarray, "N p"]
) -> tuple[Float[np.ndarray, "N T"], Float[np.ndarray, "N T p"]]:
    """Residuals and their derivatives with respect to the physical parameters."""
    width = stack.samples * (z.shape[1] + 1)
    size, pieces = min(room(len(z)), 1 << (max(_NUMBERS // width, 1).bit_length() - 1)), []
    for begin in range(0, len(z), size):
        at = np.minimum(np.arange(begin, begin + size), len(z) - 1)
        part = stack.take(at)
        rows = _linearize_rows(*placed((part.objective, z[at]), first_device("cpu")), part.own)
        pieces.append([np.asarray(values)[: len(z) - begin] for values in rows])
    residual, jacobian = (np.concatenate(column) for column in zip(*pieces, strict=True))
    return residual, jacobian


@functools.partial(jax.jit, static_argnums=2)
def _linearize_rows(objective: Objective, z: Array, own: tuple[bool, ...]) -> tuple[Array, Array]:
    def one(k: Array) -> tuple[Array, Array]:
        single = objective_at(objective, own, k)
        residual, jacobian = single.linearize(single.coordinates.physical(z[k]))
        return residual[0], jacobian[0]

    return jax.lax.map(one, jnp.arange(len(z)))
