"""What plain descriptions of the data leave unexplained: the yardsticks beside which the error of a fit is judged."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence

import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.quality.faults import noise_rms

_DEGREE = 7  # of the single-valued curve
_PLAYS = 10
_SPARE = 4  # samples for each unknown of the plays, below which their error would be that of an overfit


@dataclasses.dataclass(frozen=True)
class Baselines:
    """Root mean square errors of plain descriptions, on the samples that count, and the extent of these samples [y].

    Attributes:
        span: largest less smallest measured output.
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
            train: records to fit.
            test: records to judge; those fitted by default. One that was not fitted has the offset of the first record.
            refit_offset: shift the prediction of each test record to its mean.
        """
        judged = list(train if test is None else test)
        frame = _Frame.of(train)
        own = {record.name: k for k, record in enumerate(train)}
        y = np.concatenate([record.y[record.used] for record in judged])

        def error(columns: Callable[[_Frame, Record], np.ndarray]) -> float:
            parts = {id(r): np.hstack([columns(frame, r), _offset(k, len(own), r)]) for k, r in enumerate(train)}
            theta = _least_squares(
                np.concatenate([parts[id(r)][r.used] for r in train]), np.concatenate([r.y[r.used] for r in train])
            )
            squares = 0.0
            for record in judged:
                here = parts.get(id(record))
                if here is None:
                    here = np.hstack([columns(frame, record), _offset(own.get(record.name, 0), len(own), record)])
                miss = (record.y - here @ theta)[record.used]
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


def _least_squares(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solution by normal equations: few scaled columns, of which only the misfit counts; a tenth of the time of an SVD of A."""
    size = np.linalg.norm(A, axis=0)
    size[size == 0] = 1.0
    gram = (A.T @ A) / np.outer(size, size)
    return np.linalg.lstsq(gram, (A.T @ b) / size, rcond=1e-13)[0] / size


def _line(frame: _Frame, record: Record) -> np.ndarray:
    return frame.place(record)[:, None]


def _curve(frame: _Frame, record: Record) -> np.ndarray:
    # Beyond the fitted range the curve goes on as its end: a polynomial of high degree would not.
    return np.polynomial.legendre.legvander(np.clip(frame.place(record), -1.0, 1.0), _DEGREE)[:, 1:]


def _plays(frame: _Frame, record: Record) -> np.ndarray:
    x = frame.place(record)
    radii = np.linspace(0.0, 1.0, _PLAYS + 2)[1:-1]
    bend = np.polynomial.legendre.legvander(np.clip(x, -1.0, 1.0), 3)[:, 2:]
    return np.hstack([x[:, None], bend, play_positions(x, radii)])


def _offset(number: int, count: int, record: Record) -> np.ndarray:
    columns = np.zeros((len(record), count))
    columns[:, number] = 1.0
    return columns


def play_positions(u: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Positions of plays at rest on the first input, run by run of monotonic input, shape (T, K).

    Args:
        u: input, shape (T,).
        radii: half widths of the plays [u], shape (K,).
    """
    p = np.empty((u.size, radii.size))
    p[0] = u[0]
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
