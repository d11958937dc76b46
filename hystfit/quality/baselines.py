"""Errors of plain descriptions of the data, with which the error of a fit is compared."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.quality.faults import noise_rms

_DEGREE = 7  # of the single-valued curve
_PLAYS = 10
_BLOCK = 2**16  # samples whose columns are held at once
_Part = tuple[np.ndarray, np.ndarray]
_Before = tuple[float, np.ndarray] | None
_Columns = Callable[[np.ndarray, _Before], np.ndarray]
_SPARE = 4  # samples for each unknown of the plays, below which their error would be that of an overfit


@dataclasses.dataclass(frozen=True)
class Baselines:
    """Root mean square errors of plain descriptions, on the samples that count, and the extent of these samples [y].

    Attributes:
        span: largest minus smallest measured output.
        noise: rms noise as the differences of neighboring samples show it; None where they still contain the signal.
        line: of the best straight line over the input.
        curve: of the best single-valued curve over the input (a polynomial), without hysteresis.
        plays: of ten plays and a cubic curve; None where the samples are too few.
    """

    span: float
    noise: float | None
    line: float
    curve: float
    plays: float | None

    @classmethod
    def of(cls, train: Dataset, test: Sequence[Record] | None = None, *, refit_offset: bool = False) -> Baselines:
        """Fit the plain descriptions, with an offset for each record.

        Args:
            test: records to judge; those fitted by default. One that was not fitted has the offset of the first record.
        """
        judged = list(train if test is None else test)
        frame = _Frame.of(train)
        own = {record.name: k for k, record in enumerate(train)}
        y = np.concatenate([record.y[record.used] for record in judged])

        keep = (
            functools.cache if sum(map(len, train)) <= _BLOCK else lambda make: make
        )  # of long records no columns are kept

        def error(columns: _Columns) -> float:
            @keep
            def parts(k: int) -> list[_Part] | Iterator[_Part]:
                made = _parts(columns, frame.place(train[k]), train[k], k, len(own))
                return list(made) if keep is functools.cache else made

            theta = _least_squares(part for k in range(len(train)) for part in parts(k))
            squares = 0.0
            for record in judged:
                k = own.get(record.name, 0)
                mine = parts(k) if record is train[k] else _parts(columns, frame.place(record), record, k, len(own))
                miss = np.concatenate([measured - rows @ theta for rows, measured in mine])
                squares += float(np.sum((miss - (miss.mean() if refit_offset else 0.0)) ** 2))
            return float(np.sqrt(squares / y.size))

        samples = sum(int(record.used.sum()) for record in train)
        enough = samples >= _SPARE * (_PLAYS + 3 + len(own))
        return cls(float(np.ptp(y)), _noise(judged), error(_line), error(_curve), error(_plays) if enough else None)


@dataclasses.dataclass(frozen=True)
class _Frame:
    """Range of the fitted inputs, on which columns are scaled."""

    middle: float
    half: float

    @classmethod
    def of(cls, data: Dataset) -> _Frame:
        low, high = min(float(r.u[r.used].min()) for r in data), max(float(r.u[r.used].max()) for r in data)
        return cls(0.5 * (low + high), 0.5 * (high - low) or 1.0)

    def place(self, record: Record) -> np.ndarray:
        """Input in -1..1 over the fitted range, shape (T,)."""
        return (record.u - self.middle) / self.half


def _least_squares(parts: Iterable[_Part]) -> np.ndarray:
    """Solution by normal equations: few scaled columns, of which only the misfit counts; a tenth of the time of an SVD."""
    gram, right = 0.0, 0.0
    for rows, measured in parts:
        gram, right = gram + rows.T @ rows, right + rows.T @ measured
    size = np.sqrt(np.diag(gram))
    size[size == 0] = 1.0
    return np.linalg.lstsq(gram / np.outer(size, size), right / size, rcond=1e-13)[0] / size


def _parts(columns: _Columns, place: np.ndarray, record: Record, number: int, count: int) -> Iterator[_Part]:
    """Columns with one offset for each of `count` records, and outputs, at the samples that count, block by block.

    Args:
        place: inputs, shape (T,).
    """
    before = None
    for start in range(0, place.size, _BLOCK):
        at = slice(start, start + _BLOCK)
        rows = columns(place[at], before)
        before = place[at][-1], rows[-1]
        offset = np.zeros((len(rows), count))
        offset[:, number] = 1.0
        yield np.hstack([rows, offset])[record.used[at]], record.y[at][record.used[at]]


def _line(x: np.ndarray, before: _Before) -> np.ndarray:
    return x[:, None]


def _curve(x: np.ndarray, before: _Before) -> np.ndarray:
    # Constant beyond the fitted range, where a polynomial of high degree would diverge.
    return np.polynomial.legendre.legvander(np.clip(x, -1.0, 1.0), _DEGREE)[:, 1:]


def _plays(x: np.ndarray, before: _Before) -> np.ndarray:
    radii = np.linspace(0.0, 1.0, _PLAYS + 2)[1:-1]
    bend = np.polynomial.legendre.legvander(np.clip(x, -1.0, 1.0), 3)[:, 2:]
    if before is None:
        return np.hstack([x[:, None], bend, play_positions(x, radii)])
    positions = play_positions(np.append(before[0], x), radii, before[1][-_PLAYS:])
    return np.hstack([x[:, None], bend, positions[1:]])


def play_positions(u: np.ndarray, radii: np.ndarray, first: np.ndarray | None = None) -> np.ndarray:
    """Positions of plays, run by run of monotonic input, shape (T, K).

    Args:
        u: input, shape (T,).
        radii: half widths of the plays [u], shape (K,).
        first: positions at the first input, shape (K,); None where they rest on it.
    """
    p = np.empty((u.size, radii.size))
    p[0] = u[0] if first is None else first
    rising = np.diff(u) > 0
    ends = np.concatenate([[0], np.flatnonzero(rising[1:] != rising[:-1]) + 1, [u.size - 1]])
    for start, stop in itertools.pairwise(ends):
        way = u[start + 1 : stop + 1, None]
        p[start + 1 : stop + 1] = (
            np.maximum(way - radii, p[start]) if rising[start] else np.minimum(way + radii, p[start])
        )
    return p


def _noise(records: Sequence[Record]) -> float | None:
    """Pooled rms noise of the output; None where it is unknown on any record."""
    squares, count = 0.0, 0
    for record in records:
        y = record.y[record.used]
        rms, is_bound = noise_rms(y)
        if rms is None or is_bound:
            return None
        squares, count = squares + rms**2 * y.size, count + y.size
    return float(np.sqrt(squares / count))
