"""How well solved loops over one input are described, row by row, and which of them are described beyond doubt.

Many loops of a map are judged on the GPU that has solved them; all others on the CPU, by the same functions.
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.batch.alike import Group, Loops
from hystfit.batch.simulated_rows import chunks, shared_and_own, simulate_rows, simulated
from hystfit.data.steady_cycle import steady_rows
from hystfit.fitting.judgment.fit_warnings import BEGINS, SHORT
from hystfit.fitting.solvers.lanes import Stack, device_for, placed
from hystfit.inference.autocorrelation import correlated_rows
from hystfit.inference.blocks import chosen
from hystfit.inference.residuals import TAILS
from hystfit.params.coordinates import Coordinates
from hystfit.quality.baselines import DEGREE, USABLE, VISIBLE
from hystfit.quality.faults import MAD_TO_RMS
from hystfit.quality.loops import clear_reversals, turns_back
from hystfit.results.accuracy import NOISY, persistent_error

_ON_CURVE = 2**9  # samples on which a curve is fitted: its error is known to 3 %
_ENOUGH = 2**11  # differences whose median is taken: it is known to 3 %
_LIMIT = 3  # samples at the largest or smallest output: a saturated sensor shows four
_SPARSE = 0.9  # noise by differences of order 6 over that of order 3, below which it still contains the signal
_ROUNDED = 0.06  # of the least step between neighbors: noise below it may be rounding
_SPIKE, _OF_RANGE = 9.0, 0.028  # times the noise, and of the range, that an outlier stands out from both neighbors


def row_noise(steps: Float[Any, "N T"], largest: Float[Any, " N"], xp: Any = np) -> Float[Any, " N"]:
    """RMS of white noise in each row, from differences of order 2 to 6 of the steps between samples; NaN where uncertain, or rounding."""
    change, sizes, difference = xp.abs(steps), [], steps
    least_step = xp.min(xp.where(change > 0, change, xp.inf), axis=1)
    for order in range(2, 7):
        difference = difference[:, 1:] - difference[:, :-1]
        size = xp.abs(difference[:, :: _stride(difference.shape[1], _ENOUGH)])
        middle = size.shape[1] // 2
        # Of single numbers a selection takes 0.6 of its time; on a GPU a sort takes less.
        median = (np.partition(size.astype("f4"), middle) if xp is np else xp.sort(size))[:, middle]
        sizes.append(MAD_TO_RMS * median / math.sqrt(math.comb(2 * order, order)))
    least = xp.min(xp.stack(sizes), axis=0)
    floor = xp.maximum(_ROUNDED * least_step, 1e-15 * largest)
    return xp.where((least > floor) & (sizes[-1] >= _SPARSE * sizes[1]), least, xp.nan)


def sound_rows(y: Float[Any, "N T"], low: Any, high: Any, xp: Any = np) -> tuple[Any, Float[Any, " N"]]:
    """Which rows, between `low` and `high`, have known noise and no sample that may be clipped or an outlier, bool; and their noise."""
    stays = xp.maximum(*(xp.count_nonzero(y == end[:, None], axis=1) for end in (low, high))) > _LIMIT
    steps = y[:, 1:] - y[:, :-1]
    noise, back = row_noise(steps, xp.maximum(-low, high), xp), -steps
    # The smaller of two steps in opposite directions, a peak or a dip; of the same direction it is negative.
    pairs = ((steps[:, :-1], back[:, 1:]), (back[:, :-1], steps[:, 1:]))
    apart = xp.maximum(*(xp.minimum(before, after).max(axis=1) for before, after in pairs))
    spiky = apart > xp.maximum(_SPIKE * xp.nan_to_num(noise), _OF_RANGE * (high - low))
    return xp.isfinite(noise) & ~stays & ~spiky, noise


def polynomials(u: Float[np.ndarray, " T"], degree: int) -> Float[np.ndarray, "m k"]:
    """Orthonormal polynomials over the input for `curve_errors`, on at most 512 samples at even distances."""
    u = u[:: _stride(u.size, _ON_CURVE)]
    low, high = u.min(), u.max()
    return np.linalg.qr(np.polynomial.legendre.legvander((2 * u - low - high) / (high - low), degree))[0]


def curve_errors(basis: Float[Any, "m k"], y: Float[Any, "N T"], xp: Any = np) -> Float[Any, " N"]:
    """RMS error of the best of these polynomials over the input, for each row."""
    y = y[:, :: _stride(y.shape[1], _ON_CURVE)]
    rest = y - (y @ basis) @ basis.T
    return xp.sqrt(xp.mean(rest**2, axis=1))


def _stride(samples: int, most: int) -> int:
    return -(-samples // most)


# Part of a limit of a fit that is judged alone, up to which the same verdict is beyond doubt.
MARGIN = 0.93
_OF_CURVE = 0.5  # of the error of a single-valued curve: largest rms error
_FEWEST = 64  # samples


class Soundness(NamedTuple):
    """Of N outputs: which are finite, vary, and have no fault that a fit would leave out; and their noise, NaN where uncertain."""

    sound: np.ndarray
    noise: Float[np.ndarray, " N"]


class Accuracy(NamedTuple):
    """Of N solved loops: which are described beyond doubt, of these those with white residuals, and the rest as in `Judged`."""

    described: Any
    white: Any
    close: Any
    rmse: Any
    percent: Any
    largest_percent: Any


class _Frame(NamedTuple):
    """What loops over one input share: samples that count, polynomials over them, how many come before the first and last turning point."""

    at: np.ndarray
    basis: np.ndarray
    first: Any
    last: Any

    @classmethod
    def of(cls, group: Group) -> _Frame:
        record = group.record
        at, turns = np.flatnonzero(record.used), clear_reversals(record.u)
        first, last = np.searchsorted(at, [turns[0] + 1, turns[-1]]) if turns.size else (np.int64(0), np.int64(at.size))
        return cls(at, polynomials(chosen(record.u, record.used), DEGREE), first, last)


def soundness(loops: Loops) -> Soundness:
    """Of all loops, over inputs that turn."""
    together = _on_gpu(loops)
    if together is None:
        return Soundness(*loops.each(lambda group: _only_turning(group, *_sound(group.y))))
    y = loops.groups[0].y
    parts = chunks(len(y), y.shape[1])
    rows = [[np.asarray(v)[:count] for v in _sound_on_device(placed(y[at], together))] for at, count in parts]
    return Soundness(*_only_turning(loops.groups[0], *map(np.concatenate, zip(*rows, strict=True))))


def _only_turning(group: Group, sound: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return sound & turns_back([group.record]), noise


def _on_gpu(loops: Loops) -> Any:
    """The device where loops over one input are judged; None for the CPU."""
    device = device_for(len(loops))
    return None if device.platform == "cpu" or len(loops.groups) > 1 else device


def _sound(y: Float[Any, "N T"], xp: Any = np) -> tuple[Any, Any]:
    if y.shape[1] < _FEWEST:
        return xp.zeros(len(y), bool), xp.full(len(y), xp.nan)
    finite, rows = xp.isfinite(y).all(axis=1), y
    if xp is not np or not finite.all():  # keeps warnings away from rows that are out
        rows = xp.where(finite[:, None], y, np.sin(np.arange(y.shape[1])))
    low, high = rows.min(axis=1), rows.max(axis=1)
    sound, noise = sound_rows(rows, low, high, xp)
    return finite & (high - low > 1e-12 * xp.maximum(-low, high)) & sound, noise


_sound_on_device = jax.jit(functools.partial(_sound, xp=jnp))


def accuracy(loops: Loops, stack: Stack, z: Float[np.ndarray, "N p"], noise: Float[np.ndarray, " N"]) -> Accuracy:
    """Of solved loops with sound outputs."""
    device = _on_gpu(loops)
    if device is None:
        u, dt = (np.asarray(rows)[..., 0, :] for rows in (stack.objective.batch.u, stack.objective.batch.dt))
        return accuracy_of(loops, simulated(*shared_and_own(stack.objective.coordinates), z, u, dt), noise)
    found = _of_group_on_device(loops.groups[0], stack.objective.coordinates, z, noise, device)
    return Accuracy(*loops.each(_only_even, *found))


def accuracy_of(loops: Loops, predicted: Float[np.ndarray, "N T"], noise: Float[np.ndarray, " N"]) -> Accuracy:
    """`accuracy` of predicted outputs, which may be padded."""
    return Accuracy(*loops.each(_only_even, *loops.each(_of_group, predicted, noise)))


def _only_even(group: Group, *found: np.ndarray) -> Accuracy:
    """Without loops whose samples count unequally, or which begin in a steady state."""
    one, record = Accuracy(*found), group.record
    weight = chosen(record.weight, record.used)
    fits = ~steady_rows(record.u, group.y)[1] & (weight.min() == weight.max())
    return one._replace(described=one.described & fits, close=one.close & fits)


def _of_group(group: Group, predicted: np.ndarray, noise: np.ndarray) -> Accuracy:
    with np.errstate(all="ignore"):
        return _accuracy(_Frame.of(group), group.y, predicted[:, : len(group.record)], noise)


def _of_group_on_device(group: Group, coordinates: Coordinates, z: Any, noise: np.ndarray, device: Any) -> Accuracy:
    (one, scales), record = shared_and_own(coordinates), group.record
    shared = placed((one, record.u, record.dt, _Frame.of(group)), device)
    rows = []
    for at, count in chunks(len(z), len(record)):
        part = _accuracy_on_device(*shared, *placed((scales[at], z[at], group.y[at], noise[at]), device))
        rows.append([np.asarray(v)[:count] for v in part])
    return Accuracy(*map(np.concatenate, zip(*rows, strict=True)))


@jax.jit
def _accuracy_on_device(
    coordinates: Coordinates, u: Array, dt: Array, frame: _Frame, scales: Array, z: Array, y: Array, noise: Array
) -> Accuracy:
    return _accuracy(frame, y, simulate_rows(coordinates, scales, z, u, dt, together=True), noise, jnp)


def _accuracy(frame: _Frame, y: Any, predicted: Any, noise: Any, xp: Any = np) -> Accuracy:
    """Of loops over one input; `xp` is the module of the arrays."""
    if frame.at.size < y.shape[1]:
        y, predicted = y[:, frame.at], predicted[:, frame.at]
    residual = predicted - y
    span, squares = y.max(axis=1) - y.min(axis=1), residual**2
    rmse = xp.sqrt(xp.mean(squares, axis=1))
    percent, largest = 100 * rmse / span, 100 * xp.abs(residual).max(axis=1) / span
    close = xp.isfinite(rmse) & (percent < MARGIN * USABLE) & (rmse < _OF_CURVE * curve_errors(frame.basis, y, xp))
    good = close & (rmse < MARGIN * NOISY * noise)
    if xp is not np or not good.all():
        residual, squares = (xp.where(good[:, None], values, 0.0) for values in (residual, squares))
    good &= _is_even(frame, residual, squares, span, xp)
    return Accuracy(good, ~correlated_rows(residual, xp), close, rmse, percent, largest)


def _is_even(
    frame: _Frame, residual: Float[Any, "N m"], squares: Float[Any, "N m"], span: Float[Any, " N"], xp: Any
) -> Any:
    """Which residuals are without heavy tails, without a stretch or an end of the record unlike the rest, shape (N,), bool."""
    samples = residual.shape[1]
    change = residual[:, 1:] - residual[:, :-1]
    change = (change - change.mean(axis=1, keepdims=True)) ** 2
    kurtosis = xp.vecdot(change, change) / (samples - 1) / xp.mean(change, axis=1) ** 2
    plain = (kurtosis - 3 < MARGIN * TAILS) & (samples >= _FEWEST)
    sums, width = xp.cumsum(squares, axis=1), int(SHORT / MARGIN * samples) + 1
    total = sums[:, -1]
    plain &= (sums[:, width:] - sums[:, :-width]).max(axis=1) < 0.5 * total
    size = persistent_error(residual, xp)
    largest, place = size.max(axis=1), xp.argmax(size, axis=1)
    begin = xp.where(frame.first > 0, sums[:, frame.first - 1], 0.0)
    end = total - xp.where(frame.last > 0, sums[:, frame.last - 1], 0.0)
    ends = ((place < frame.first, begin, frame.first), (place >= frame.last, end, samples - frame.last))
    for inside, part, count in ends:
        rest = xp.sqrt((total - part) / xp.maximum(samples - count, 1))
        plain &= ~(inside & (100 * largest > MARGIN * VISIBLE * span) & (largest > MARGIN * BEGINS * rest))
    return plain
