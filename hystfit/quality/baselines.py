"""Errors of simple descriptions of the data, with which the error of a fit is compared."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.quality.faults import FEWEST_SAMPLES, noise_rms, rounding_rms
from hystfit.quality.host_operators import play_positions

DEGREE = 7  # of the single-valued curve
_PLAYS = 10
USABLE = 3.0  # percent of the range: largest rms error of a usable description
VISIBLE = 1.0  # percent of the range, below which an error, drift, damage or asymmetry does not matter
MOST_OF = 0.7  # of an rms error: half of its square
BLOCK = 2**16  # samples looked at together
_Part = tuple[np.ndarray, np.ndarray]
_SCATTERED = 2**14  # samples of a record that are compared with a curve of any shape: their scatter is known to 0.6 %
_SPARE = 4  # samples for each unknown of the plays, below which their error would be that of an overfit

# Rows that the descriptions share (see `_rows`), and which of them each one takes beside the offsets.
_ROWS = 1 + DEGREE + _PLAYS
_LINE, _CURVE = (0,), tuple(range(1, 1 + DEGREE))
_PLAYED = (0, 2, 3, *range(1 + DEGREE, _ROWS))


@dataclasses.dataclass(frozen=True)
class Baselines:
    """Root mean square errors of simple descriptions, on the samples that count, and the extent of these samples [y].

    Attributes:
        span: largest minus smallest measured output.
        noise: rms noise as the differences of neighboring samples show it; None where they still contain the signal, as those of cycles
            of a few samples do.
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
        """Fit the simple descriptions, with an offset for each record.

        Args:
            test: records to judge; those fitted by default. One that was not fitted has the offset of the first record.
        """
        judged = list(train if test is None else test)
        frame, own = _Frame.of(train), {record.name: k for k, record in enumerate(train)}
        fitted = frame.parts_of(train)

        samples = sum(int(record.used.sum()) for record in train)
        enough = samples >= _SPARE * (len(_PLAYED) + len(own))
        chosen = (_LINE, _CURVE, _PLAYED) if enough else (_LINE, _CURVE)
        theta = _least_squares([fitted(k) for k in range(len(train))], chosen)

        squares, outputs = np.zeros(len(chosen)), [record.y[record.used] for record in judged]
        for record in judged:
            k = own.get(record.name, 0)
            parts = fitted(k) if record is train[k] else frame.parts(record)
            misses = (measured - theta[:, :_ROWS] @ rows - theta[:, _ROWS + k, None] for rows, measured in parts)
            squares += _squares(misses, about_mean=refit_offset)
        line, curve, *plays = np.sqrt(squares / sum(y.size for y in outputs)).tolist()
        span = max(y.max(initial=-np.inf) for y in outputs) - min(y.min(initial=np.inf) for y in outputs)
        noise = _noise(outputs) if all(map(is_resolved, judged)) else None
        return cls(float(span), noise, line, curve, *(plays or [None]))


def plays_residuals(data: Dataset) -> list[np.ndarray]:
    """Prediction less measurement of ten plays and a cubic curve, which no slow change in time bends, at the samples that count."""
    parts, kept = _Frame.of(data).parts_of(data), range(len(data))
    (theta,) = _least_squares([parts(k) for k in kept], (_PLAYED,))
    missed = lambda k: [theta[:_ROWS] @ rows + theta[_ROWS + k] - measured for rows, measured in parts(k)]
    return [np.concatenate(missed(k)) for k in kept]


@dataclasses.dataclass(frozen=True)
class _Frame:
    """Range of the fitted inputs, on which columns are scaled."""

    middle: float
    half: float

    @classmethod
    def of(cls, data: Dataset) -> _Frame:
        low, high = min(float(r.u[r.used].min()) for r in data), max(float(r.u[r.used].max()) for r in data)
        return cls(0.5 * (low + high), 0.5 * (high - low) or 1.0)

    def parts_of(self, data: Dataset) -> Callable[[int], Iterable[_Part]]:
        """`parts` of a record by its number, as often as they are asked for; of long records none are kept."""
        short = sum(map(len, data)) <= BLOCK
        kept = [list(self.parts(record)) for record in data] if short else None
        return lambda k: kept[k] if kept else self.parts(data[k])

    def parts(self, record: Record) -> Iterator[_Part]:
        """Rows of the descriptions and outputs at the samples of a record that count, block by block."""
        used, before = record.used, None
        for start in range(0, used.size, BLOCK):
            at = slice(start, start + BLOCK)
            place = (record.u[at] - self.middle) / self.half  # -1 to 1 over the fitted range
            rows = _rows(place, before)
            before = place[-1], rows[-_PLAYS:, -1]
            yield (rows, record.y[at]) if used[at].all() else (rows[:, used[at]], record.y[at][used[at]])


def _squares(misses: Iterable[np.ndarray], *, about_mean: bool) -> np.ndarray:
    """Sum of squares of each row of the blocks (K, m), about zero or the row's mean."""
    count, mean, squares = 0, np.zeros(1), np.zeros(1)  # one for each row, from the first block on
    for miss in misses:
        m = miss.shape[1]
        if m == 0:
            continue
        shift = miss.mean(axis=1) - mean
        squares = squares + np.sum((miss - (mean + shift)[:, None]) ** 2, axis=1) + shift**2 * count * m / (count + m)
        count, mean = count + m, mean + shift * m / (count + m)
    return squares if about_mean else squares + count * mean**2


def _least_squares(records: Sequence[Iterable[_Part]], chosen: Sequence[Sequence[int]]) -> np.ndarray:
    """Coefficients of each description, shape (K, rows and offsets), 0 where it has none.

    By normal equations: few scaled columns, of which only the misfit counts, take a tenth of the time of an SVD.

    Args:
        records: parts of each of R records, which has an offset of its own.
        chosen: rows of each of K descriptions.
    """
    count = _ROWS + len(records)
    gram, right = np.zeros((count, count)), np.zeros(count)
    for k, parts in enumerate(records, start=_ROWS):
        for rows, measured in parts:
            gram[:_ROWS, :_ROWS] += rows @ rows.T
            gram[k, :_ROWS] += rows.sum(axis=1)
            gram[k, k] += measured.size
            right[:_ROWS] += rows @ measured
            right[k] += measured.sum()
    gram[:_ROWS, _ROWS:] = gram[_ROWS:, :_ROWS].T
    size = np.sqrt(np.diag(gram))
    size[size == 0] = 1.0
    theta = np.zeros((len(chosen), count))
    for one, own in zip(theta, chosen, strict=True):
        at = [*own, *range(_ROWS, count)]
        scaled = gram[np.ix_(at, at)] / np.outer(size[at], size[at])
        one[at] = np.linalg.lstsq(scaled, right[at] / size[at], rcond=1e-13)[0] / size[at]
    return theta


def _rows(x: np.ndarray, before: tuple[float, np.ndarray] | None) -> np.ndarray:
    """Input, Legendre polynomials of it, and positions of plays, shape (_ROWS, T).

    Args:
        x: input, -1 to 1 over the fitted range, shape (T,).
        before: the input before these, and the positions there; None at the start of a record.
    """
    rows, inside = np.empty((_ROWS, x.size)), np.clip(x, -1.0, 1.0)
    # Constant beyond the fitted range, where a polynomial of high degree would diverge.
    rows[0], rows[1], one = x, inside, np.ones(x.size)
    for n in range(1, DEGREE):
        rows[n + 1] = ((2 * n + 1) * inside * rows[n] - n * (rows[n - 1] if n > 1 else one)) / (n + 1)
    radii, positions = np.linspace(0.0, 1.0, _PLAYS + 2)[1:-1], rows[-_PLAYS:].T
    if before is None:
        play_positions(x, radii, out=positions)
    else:
        positions[:] = play_positions(np.append(before[0], x), radii, before[1])[1:]
    return rows


def curve_scatter(records: Iterable[Record]) -> float:
    """Pooled rms distance of samples from a curve of any shape over the input [y]; infinite where none has another beside it.

    Samples of a rising input are compared with the curve through those of a falling one, and the reverse; samples that share an input and
    a direction, as a hold has them, with their mean.
    """
    squares, count = 0.0, 0
    for record in records:
        every = max(1, -(-np.count_nonzero(record.used) // _SCATTERED))
        u, y = record.u[record.used][::every], record.y[record.used][::every]
        step = np.sign(np.diff(u, prepend=u[0]))
        moved = np.maximum.accumulate(np.where(step != 0, np.arange(u.size), 0))
        rises = step[moved] > 0
        curves = [_Curve.of(u[side], y[side]) for side in (rises, ~rises)]
        for own, other in (curves, curves[::-1]):
            errors = np.concatenate([own.errors(own.u, own.y), other.errors_between(own.u, own.y)])
            squares, count = squares + float(errors @ errors), count + errors.size
    return float(np.sqrt(squares / count)) if count else np.inf


@dataclasses.dataclass(frozen=True)
class _Curve:
    """Means of an output over the inputs that occur.

    Attributes:
        u, y: samples, shape (n,).
        inputs, means, many: the inputs, rising, the mean output of each and the number of its samples, shape (m,).
    """

    u: np.ndarray
    y: np.ndarray
    inputs: np.ndarray
    means: np.ndarray
    many: np.ndarray

    @classmethod
    def of(cls, u: np.ndarray, y: np.ndarray) -> _Curve:
        """That of samples."""
        inputs, which, many = np.unique(u, return_inverse=True, return_counts=True)
        return cls(u, y, inputs, np.bincount(which, y, minlength=inputs.size) / many, many)

    def errors(self, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Of own samples that share their input with others, in units of one of them."""
        at = np.searchsorted(self.inputs, u)
        shared = self.many[at] > 1
        return (y - self.means[at])[shared] / np.sqrt(1 - 1 / self.many[at][shared])

    def errors_between(self, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Of other samples within the range of the inputs, about straight lines between the means, in units of one sample."""
        if self.inputs.size < 2:
            return np.empty(0)
        inside = (u >= self.inputs[0]) & (u <= self.inputs[-1])
        k = np.clip(np.searchsorted(self.inputs, u[inside]) - 1, 0, self.inputs.size - 2)
        part = (u[inside] - self.inputs[k]) / (self.inputs[k + 1] - self.inputs[k])
        line = (1 - part) * self.means[k] + part * self.means[k + 1]
        return (y[inside] - line) / np.sqrt(1 + (1 - part) ** 2 / self.many[k] + part**2 / self.many[k + 1])


def is_resolved(record: Record) -> bool:
    """Whether there are samples enough for each time that the input goes there and back over its range to tell noise from the output."""
    cycles = float(np.abs(np.diff(record.u)).sum()) / (2 * float(np.ptp(record.u)) or np.inf)
    return bool(np.count_nonzero(record.used) >= FEWEST_SAMPLES * cycles)


def _noise(outputs: Sequence[np.ndarray]) -> float | None:
    """Pooled rms noise of the outputs of records; None where it is unknown on any of them."""
    squares, count = 0.0, 0
    for y in outputs:
        rms, is_bound = noise_rms(y)
        if rms is None or is_bound:
            return None
        squares, count = squares + rms**2 * y.size, count + y.size
    return float(np.sqrt(squares / count))


def rounding_error(records: Iterable[Record]) -> float:
    """Pooled rms error by the rounding of outputs whose noise is that alone [y]; the least error that a model can have there."""
    outputs = [record.y[record.used] for record in records]
    squares = sum(rounding_rms(y) ** 2 * y.size for y in outputs)
    return float(np.sqrt(squares / sum(y.size for y in outputs)))
