"""Judgment of many solved loops at once: those whose fit is beyond doubt.

A loop is plain where its residuals are no larger than the noise of its output, and where its errors are those of a regular least-squares
problem: no bound, no undetermined direction, no outlier near. The verdict of `hystfit.fit` on such a loop is `Status.OK`. Its standard
errors are those of independent noise where its residuals are white, else those of slow noise. Every other loop is judged alone.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from hystfit.batch.alike import Common, Group, Loops
from hystfit.batch.slow_rows import slow_information
from hystfit.data.steady_cycle import steady_rows
from hystfit.fitting.lanes import Ends, Stack, device_for, placed, room
from hystfit.fitting.verdict import turns_back
from hystfit.inference.autocorrelation import correlated_rows
from hystfit.models.simulation import run
from hystfit.params.coordinates import BOTH, Coordinates
from hystfit.params.relative_size import relative_size
from hystfit.quality.loops import reversals
from hystfit.quality.rows import curve_errors, row_noise, sound_rows
from hystfit.results.accuracy import persistent_error

# Limits stricter than those of a fit that is judged alone, so that the verdict is the same.
_OF_NOISE = 1.9  # times the noise: largest rms error
_OF_CURVE = 0.5  # of the error of a single-valued curve: largest rms error
_PERCENT = 2.9  # of the range: largest rms error
_DEGREE = 7  # of that curve
_LASTING, _STANDS_OUT = (
    0.95,
    2.8,
)  # percent of the range, and times the rms error elsewhere: of a half cycle unlike the others
_SHORT = 0.035  # of the samples, which must not carry half of the squared error
_TAILS = 2.8  # largest excess kurtosis of the differences of residuals
_LEAST_EIGENVALUE = 1e-10  # of the scaled normal matrix, relative to the largest
_OPEN = 0.9  # largest standard error of a direction, beside the parameters' own size
_REACH, _FAR = 2.05, 8.0  # standard errors to the next bound; of a linear parameter
_FEWEST = 64  # residuals
_NUMBERS = 2**24  # of outputs simulated in one call
_SLOW = 0.95  # percent of the range: largest rms error of a loop under slow noise, whose device may change where it is larger
_AT_BOUND = 2e-4  # relative distance to a bound


class Judged(NamedTuple):
    """Results of N loops; those of loops that are not plain mean nothing.

    Attributes:
        plain: which loops are beyond doubt.
        slow: of these, those with autocorrelated residuals.
        close: which are described as well as a usable fit is, without a parameter at its bound: another start would not end lower.
        x, stderr: estimates and standard errors, shape (N, p).
        rmse, percent, largest_percent: rms error [y]; and in percent of the range, beside the largest error.
    """

    plain: np.ndarray
    slow: np.ndarray
    close: np.ndarray
    x: Float[np.ndarray, "N p"]
    stderr: Float[np.ndarray, "N p"]
    rmse: Float[np.ndarray, " N"]
    percent: Float[np.ndarray, " N"]
    largest_percent: Float[np.ndarray, " N"]


def sound_outputs(group: Group) -> np.ndarray:
    """Which outputs are finite, vary, and have no fault that a fit would leave out, over an input that turns, shape (N,), bool."""
    y = group.y
    if not turns_back([group.record]):
        return np.zeros(len(y), bool)
    finite = np.isfinite(y).all(axis=1)
    rows = np.where(finite[:, None], y, np.sin(np.arange(y.shape[1])))  # keeps warnings away from rows that are out
    varies = np.ptp(rows, axis=1) > 1e-12 * np.abs(rows).max(axis=1)
    return finite & varies & sound_rows(rows, row_noise(rows))


def judge_plain(common: Common, loops: Loops, ends: Ends, stack: Stack) -> Judged:
    """Results of solved loops with sound outputs.

    Args:
        common: what the loops have in common.
        loops: outputs, group by group.
        ends: of their descents.
        stack: their problems.
    """
    z, coordinates = ends.normal.z, stack.objective.coordinates
    x = coordinates.physical(z, np)
    described, white, close, rmse, percent, largest = loops.each(_accuracy, predicted(stack, z))
    samples = loops.each(lambda group: np.full(len(group.y), np.count_nonzero(group.record.used)))
    scale, slope = np.asarray(coordinates.scale), coordinates.slope(z, np)
    with np.errstate(all="ignore"):
        gram = ends.normal.matrix / slope[:, :, None] / slope[:, None, :]
        variance = 2 * ends.normal.cost / np.maximum(samples - x.shape[1], 1)
        stderr, inside, regular = _errors(common, x, scale, gram, variance)
        good = ends.converged & described & regular
        slow = good & ~white & (percent < _SLOW)
        if (at := np.flatnonzero(slow)).size:
            information, slow[at] = slow_information(loops.take(at), stack.take(at), z[at])
            stderr[at], _, regular = _errors(common, x[at], scale[at], information, np.ones(at.size))
            slow[at] &= regular
    return Judged(good & white | slow, slow, ends.converged & inside & close, x, stderr, rmse, percent, largest)


def _accuracy(group: Group, predicted: Float[np.ndarray, "N T"]) -> tuple[np.ndarray, ...]:
    """Which loops are described beyond doubt, and with white residuals, and which well enough; and the errors of `Judged`."""
    record, used = group.record, group.record.used
    y = group.y[:, used]
    residual = predicted[:, : len(record)][:, used] - y
    span, rmse = np.ptp(y, axis=1), np.sqrt(np.mean(residual**2, axis=1))
    percent = 100 * rmse / span
    with np.errstate(all="ignore"):
        largest = 100 * np.abs(residual).max(axis=1) / span
        close = np.isfinite(residual).all(axis=1) & (percent < _PERCENT)
        close &= rmse < _OF_CURVE * curve_errors(record.u[used], y, _DEGREE)
        good = close & (rmse < _OF_NOISE * row_noise(group.y))
        good &= _is_even(np.where(good[:, None], residual, 0.0), record.u, used, span)
        white = ~correlated_rows(np.where(good[:, None], residual, 0.0))
    if record.weight[used].min() < record.weight[used].max():
        good[:] = close[:] = False
    steady = steady_rows(record.u, group.y)[1]
    return good & ~steady, white, close & ~steady, rmse, percent, largest


def _is_even(
    residual: Float[np.ndarray, "N m"], u: Float[np.ndarray, " T"], used: np.ndarray, span: Float[np.ndarray, " N"]
) -> np.ndarray:
    """Which residuals are without heavy tails, without a stretch or an end of the record unlike the rest, shape (N,), bool."""
    squares = residual**2
    total = squares.sum(axis=1)
    plain = np.full(len(residual), residual.shape[1] >= _FEWEST)
    change = np.diff(residual, axis=1)
    change = (change - change.mean(axis=1, keepdims=True)) ** 2
    plain &= np.mean(change**2, axis=1) / np.mean(change, axis=1) ** 2 - 3 < _TAILS
    sums = np.cumsum(squares, axis=1)
    width = int(_SHORT * residual.shape[1]) + 1
    plain &= (sums[:, width:] - sums[:, :-width]).max(axis=1) < 0.5 * total
    size = persistent_error(residual)
    largest, place = size.max(axis=1), np.flatnonzero(used)[np.argmax(size, axis=1)]
    turns = reversals(u, 0.02 * float(np.ptp(u)))
    if turns.size:
        for inside in (np.flatnonzero(used) <= turns[0], np.flatnonzero(used) >= turns[-1]):
            rest = np.sqrt((total - squares[:, inside].sum(axis=1)) / max(int((~inside).sum()), 1))
            here = np.isin(place, np.flatnonzero(used)[inside])
            plain &= ~(here & (100 * largest > _LASTING * span) & (largest > _STANDS_OUT * rest))
    return plain


def _errors(
    common: Common,
    x: Float[np.ndarray, "N p"],
    scale: Float[np.ndarray, "N p"],
    gram: Float[np.ndarray, "N p p"],
    variance: Float[np.ndarray, " N"],
) -> tuple[Float[np.ndarray, "N p"], np.ndarray, np.ndarray]:
    """Standard errors; which loops are inside their bounds, and which problems are regular, shape (N,), bool.

    The information about x is `gram` over `variance`; `scale` is that of the parameters.
    """
    space = common.setup.problem.space
    size = np.sqrt(np.einsum("npp->np", gram))
    sound = np.isfinite(gram).all(axis=(1, 2)) & (size > 0).all(axis=1)
    gram, size = np.where(sound[:, None, None], gram, np.eye(x.shape[1])), np.where(sound[:, None], size, 1.0)
    inverse = np.linalg.inv(gram / size[:, :, None] / size[:, None, :]) / size[:, :, None] / size[:, None, :]
    stderr = np.sqrt(variance[:, None] * np.einsum("npp->np", inverse))
    others = ~space.offsets
    centered = gram[:, others][:, :, others]
    if space.offsets.any():
        across = gram[:, space.offsets][:, :, others]
        centered = centered - across.swapaxes(1, 2) @ np.linalg.solve(
            gram[:, space.offsets][:, :, space.offsets], across
        )
    length = np.sqrt(np.maximum(np.einsum("npp->np", centered), 1e-300))
    unit = centered / length[:, :, None] / length[:, None, :]
    values = np.linalg.eigvalsh(np.where(np.isfinite(unit), unit, 0.0))
    regular = sound & (values[:, 0] > _LEAST_EIGENVALUE * values[:, -1])
    relative = relative_size(space, x, scale)
    part = np.linalg.inv(np.where(regular[:, None, None], centered, np.eye(int(others.sum()))))
    part = variance[:, None, None] * part / relative[:, others][:, :, None] / relative[:, others][:, None, :]
    regular &= np.linalg.eigvalsh(np.where(np.isfinite(part), part, 1e9))[:, -1] < _OPEN**2
    regular &= (stderr[:, space.offsets] < _OPEN * relative[:, space.offsets]).all(axis=1)
    room = np.minimum(x - space.lower, space.upper - x)
    width = np.where(space.kinds == BOTH, space.upper - space.lower, scale)
    inside = np.all(room > _AT_BOUND * width, axis=1)
    regular &= inside
    regular &= (room > np.where(space.linear, _FAR, _REACH) * stderr).all(axis=1)
    return stderr, inside, regular


def predicted(stack: Stack, z: Float[np.ndarray, "N p"]) -> Float[np.ndarray, "N T"]:
    """Output of each loop's model over its input, padded as the batch is."""
    u, dt = (np.asarray(rows)[..., 0, :] for rows in (stack.objective.batch.u, stack.objective.batch.dt))
    return simulated(stack, z, u, dt)


def simulated(stack: Stack, z: Float[np.ndarray, "N p"], u: np.ndarray, dt: np.ndarray) -> Float[np.ndarray, "N T"]:
    """Output of each loop's model over an input, shape (T,), or over inputs of their own, shape (N, T)."""
    device = device_for(len(z))
    coordinates = stack.objective.coordinates
    scales, z = np.asarray(coordinates.scale), np.asarray(z)
    out, size = np.empty((len(z), u.shape[-1])), min(room(len(z)), max(1, _NUMBERS // u.shape[-1]))
    for begin in range(0, len(z), size):
        at = np.minimum(np.arange(begin, begin + size), len(z) - 1)
        inputs = (u, dt) if u.ndim == 1 else (u[at], dt[at])
        rows = _simulated(*placed((coordinates, scales[at], z[at], *inputs), device), device.platform != "cpu")
        part = out[begin : begin + size]
        part[:] = np.asarray(rows)[: len(part)]
    return out


@functools.partial(jax.jit, static_argnums=5)
def _simulated(
    coordinates: Coordinates, scales: Array, z: Array, u: Array, dt: Array, together: bool
) -> Float[Array, "N T"]:
    def one(scale: Array, z: Array, u: Array, dt: Array) -> Array:
        return run(eqx.tree_at(lambda c: c.scale, coordinates, scale).tree(z), u, dt)[0]

    rows = (scales, z) if u.ndim == 1 else (scales, z, u, dt)
    of_row = (lambda scale, z: one(scale, z, u, dt)) if u.ndim == 1 else one
    return jax.vmap(of_row)(*rows) if together else jax.lax.map(lambda row: of_row(*row), rows)
