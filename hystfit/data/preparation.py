"""Columns of a record, and their changes before a fit: checks, time from a sampling rate, coarse clocks, smoothing, integration."""

from __future__ import annotations

import dataclasses
import weakref
from typing import Any

import numpy as np

from hystfit.errors import DataError

_STAMPS = 20  # from which two lengths of steps are no chance
EVEN = 0.02  # deviation of a time step from the usual one, as a part of it, which the rounding of a clock may make


def real_numbers(values: Any) -> np.ndarray:
    """A new array of floating-point numbers, masked values NaN."""
    array = np.asanyarray(values)
    if np.iscomplexobj(array):
        raise TypeError("complex numbers: give the real column that was measured, such as y.real")
    if isinstance(array, np.ma.MaskedArray):
        return array.astype(np.float64).filled(np.nan)  # type: ignore[attr-defined]
    return np.array(values, dtype=np.float64)


@dataclasses.dataclass(frozen=True)
class CoarseClock:
    """Time stamps that are written less often than samples are taken: their step, and the samples that share one (median)."""

    step: float
    samples: float

    @classmethod
    def of(cls, t: np.ndarray) -> CoarseClock | None:
        """The coarse clock of non-decreasing stamps, shape (T,); None where at least two of three steps are positive, or steps vary."""
        steps = np.diff(t)
        moves = np.flatnonzero(steps > 0)
        if moves.size < 2 or (steps == 0).sum() < steps.size / 3:
            return None
        step = float(np.median(steps[moves]))
        if np.mean(np.abs(steps[moves] - step) <= 0.01 * step) < 0.9:
            return None
        return cls(step, float(np.median(np.diff(moves))))


@dataclasses.dataclass(frozen=True)
class RoundedStamps:
    """Time stamps of evenly spaced samples, which were written with few digits; their resolution is a power of ten."""

    resolution: float
    start: float
    interval: float

    @classmethod
    def of(cls, t: np.ndarray) -> RoundedStamps | None:
        """The even samples whose non-decreasing stamps these are; None where rounding does not explain their steps, or hardly changes them.

        Steps of rounded stamps differ by their resolution, and no stamp is more than half of it from its sample: a clock that really
        jitters has steps of more than two lengths.
        """
        if t.size < _STAMPS:
            return None
        steps = np.diff(t)
        resolution = float(np.ptp(steps))
        if resolution <= EVEN * float(np.median(steps)):
            return None
        power = np.log10(resolution)
        if abs(power - np.round(power)) > EVEN:
            return None
        number = np.arange(t.size) - 0.5 * (t.size - 1)
        interval = float(number @ t / (number @ number))
        off = t - interval * number
        if np.ptp(off) > (1 + EVEN) * resolution:
            return None
        middle = 0.5 * float(off.min() + off.max())
        return cls(float(10.0 ** np.round(power)), middle + interval * float(number[0]), interval)

    def samples(self, count: int) -> np.ndarray:
        """Times of the samples, shape (count,)."""
        return self.start + self.interval * np.arange(count)


def interval_of(rate: float | None, dt: float | None) -> float | None:
    """Sampling interval [s] from a sampling rate [Hz] or an interval [s]; None where neither is given."""
    if rate is not None and dt is not None:
        raise DataError("rate= and dt= both give the sampling interval: leave one out")
    for name, value, unit in (("sampling rate", rate, "Hz"), ("sampling interval", dt, "s")):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise DataError(f"the {name} must be a positive number of {unit}, got {value:g}")
    return dt if rate is None else 1 / rate


def smooth(values: np.ndarray, length: int) -> np.ndarray:
    """Zero-phase smoothing of even, finite samples: a parabola fitted to each `length` (odd, at least 5), evaluated in their middle.

    The first and last half length lie on the parabola of the first and last `length` samples.
    """
    if length < 5 or length % 2 == 0:
        raise DataError(f"the smoothing length must be an odd number of at least 5 samples, got {length}")
    if length > values.size:
        raise DataError(f"a smoothing length of {length} samples exceeds the {values.size} samples")
    half, powers = length // 2, np.vander(np.linspace(-1, 1, length), 3)
    Q = np.linalg.qr(powers)[0]  # as by `scipy.signal.savgol_filter`, whose import takes 0.5 s
    first, last = (Q @ (Q.T @ end) for end in (values[:length], values[-length:]))
    return np.concatenate([first[:half], np.convolve(values, Q @ Q[half], "valid"), last[half + 1 :]])


def integral(values: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Integral of finite values over the time t by the trapezoidal rule, 0 at the first sample, shape (T,)."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])


_columns = weakref.WeakValueDictionary[int, np.ndarray]()  # those of all records, by their identity


def column(name: str, values: object) -> np.ndarray:
    """Numbers of shape (T,) that cannot be written to, so that later changes of the argument do not reach the record.

    A copy, except of the column of another record. An array of the user may have views that can be written to, although it cannot.
    """
    if (known := _columns.get(id(values))) is not None and known is values and not known.flags.writeable:
        return known
    try:
        array = real_numbers(values)
    except (TypeError, ValueError) as error:
        raise DataError(f"{name} must be numbers: {error}") from error
    if array.ndim != 1:
        raise DataError(f"{name} must be one-dimensional, got shape {array.shape}")
    array.flags.writeable = False
    _columns[id(array)] = array
    return array


def check_columns(record: str, u: np.ndarray, y: np.ndarray, t: np.ndarray | None, weight: np.ndarray) -> None:
    """Refuse columns of one dimension, see `Record`, that no model can be driven through or compared with; `record` is its name."""
    columns = {"u": u, "y": y, "weight": weight} | ({} if t is None else {"t": t})
    if len({values.size for values in columns.values()}) != 1:
        listed = ", ".join(f"{name} {values.size}" for name, values in columns.items())
        raise DataError(f"record {record!r}: the columns differ in length ({listed})")
    if u.size < 2:
        raise DataError(f"record {record!r} has {u.size} sample(s); a loop needs at least two")
    if not np.isfinite(u).all():
        bad = ~np.isfinite(u)
        raise DataError(
            f"record {record!r}: the input is not finite at {bad.sum()} samples, first at sample {int(np.argmax(bad))}; "
            "a model cannot be driven through a gap: remove those rows or split the record"
        )
    finite = np.isfinite(y)
    if not finite.all() and np.isinf(y).any():
        raise DataError(f"record {record!r}: the output is infinite at {int(np.isinf(y).sum())} samples")
    if not finite.any():
        raise DataError(f"record {record!r}: the output has no finite value")
    if t is not None and not (np.isfinite(t[0]) and np.isfinite(t[-1]) and (np.diff(t) >= 0).all()):
        at = int(np.argmax(~(np.diff(t) >= 0))) + 1
        raise DataError(f"record {record!r}: time is not finite or decreases at sample {at}")
    if not (0 <= weight.min() and weight.max() < np.inf):
        raise DataError(f"record {record!r}: weights must be finite and not negative")
