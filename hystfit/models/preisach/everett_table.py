"""Everett tables as they are read off measured curves (Song et al. 2005), and the nearest monotone ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy  # loads its subpackages when they are first used

from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.models.preisach.everett import cells
from hystfit.quality.loops import APART


@dataclasses.dataclass(frozen=True)
class Moved:
    """How far a measured table is from the nearest monotone one [% of its largest value], and how many nodes moved by over 1e-9 of it."""

    rms: float
    largest: float
    nodes: int


@dataclasses.dataclass(frozen=True)
class EverettTable:
    """X(alpha, beta) = f_alpha - f_alpha_beta on a grid: the output lost by falling from alpha to beta.

    Attributes:
        levels: grid of both arguments, rising, shape (n + 1,).
        X: shape (n + 1, n + 1), row alpha, column beta <= alpha; zero on the diagonal and above.
        base: output at levels[0], where the memory is empty.

    Raises:
        DataError: levels that do not rise, or a table of another shape.
    """

    levels: np.ndarray
    X: np.ndarray
    base: float = 0.0

    def __post_init__(self) -> None:
        levels = np.asarray(self.levels, dtype=float)
        X = np.tril(np.asarray(self.X, dtype=float), -1)
        if levels.ndim != 1 or levels.size < 2 or not (np.diff(levels) > 0).all():
            raise DataError("levels of an Everett table must rise strictly, and be at least two")
        if X.shape != (levels.size, levels.size):
            raise DataError(f"a table on {levels.size} levels has shape {(levels.size, levels.size)}, got {X.shape}")
        if not np.isfinite(X).all():
            raise DataError(f"the table must be finite; {np.count_nonzero(~np.isfinite(X))} of its values are not")
        object.__setattr__(self, "levels", levels)
        object.__setattr__(self, "X", X)

    @classmethod
    def from_descending(cls, curves: Sequence[Record], levels: np.ndarray) -> EverettTable:
        """From curves that rise from levels[0] to a peak and fall back: X = output at the peak minus that on the way down.

        A record may hold several such curves, one after another. Between peaks, X is interpolated linearly in the peak. The memory is
        empty at both ends of a curve: X(peak, levels[0]) is its rise, and what it has not lost at its end is left out.

        Raises:
            DataError: no peaks, curves that reverse in between, or levels outside those measured.
        """
        peaks, rows = [], []
        for r in (piece for record in curves for piece in _single_peaks(record, levels)):
            top = int(np.argmax(r.u))
            down_u, down_y = r.u[top:], r.y[top:]
            order = np.argsort(down_u, kind="stable")
            peaks.append(float(r.u[top]))
            row = r.y[top] - np.interp(levels, down_u[order], down_y[order])
            if r.u[0] <= levels[0] + APART * np.ptp(levels):
                row[0] = r.y[top] - r.y[0]
            rows.append(row)
        order = np.argsort(peaks)
        peaks, table = np.array(peaks)[order], np.array(rows)[order]
        if levels[-1] > peaks[-1] + 1e-6 * np.ptp(levels):
            raise DataError(f"the largest level {levels[-1]:g} was never reached: the highest peak is {peaks[-1]:g}")
        with_zero = np.append(levels[0], peaks), np.vstack([np.zeros(levels.size), table])
        X = np.stack([np.interp(levels, with_zero[0], with_zero[1][:, j]) for j in range(levels.size)], axis=1)
        base = float(np.mean([r.y[r.used][0] for r in curves]))
        return cls(levels, X, base)

    @classmethod
    def from_masses(cls, levels: np.ndarray, masses: np.ndarray, base: float = 0.0) -> EverettTable:
        """From cell masses of +-1 relays: X is twice the mass of the triangle.

        Args:
            levels: edges of the cells, shape (n + 1,).
            masses: row by row, shape (n (n + 1) / 2,).
            base: output at levels[0].
        """
        n = len(levels) - 1
        square = np.zeros((n, n))
        square[cells(n)] = masses
        X = np.zeros((n + 1, n + 1))
        X[1:, :-1] = 2 * np.cumsum(np.cumsum(square, axis=0)[:, ::-1], axis=1)[:, ::-1]
        return cls(levels, X, base)

    def masses(self) -> np.ndarray:
        """Cell masses, row by row: second differences of the table, halved."""
        n = self.levels.size - 1
        second = self.X[1:, :-1] - self.X[:-1, :-1] - self.X[1:, 1:] + self.X[:-1, 1:]
        return 0.5 * second[cells(n)]

    def turned(self) -> np.ndarray:
        """By how much each step of the table goes the wrong way, as a fraction of its largest value; negative where it goes the right way.

        Down a column X rises with alpha, along a row it falls with beta, from 0 on the diagonal.
        """
        i, j = cells(self.levels.size - 1)
        size = float(np.abs(self.X).max()) or 1.0
        return np.concatenate([self.X[i, j] - self.X[i + 1, j], self.X[i + 1, j + 1] - self.X[i + 1, j]]) / size

    def monotone(self) -> tuple[EverettTable, Moved]:
        """The nearest table that rises with alpha and falls with beta, as an inverse needs, and how far it had to move.

        Nearest by least squares over the nodes.
        """
        X = _monotone(self.X)
        size = float(np.abs(self.X).max()) or 1.0
        i, j = np.tril_indices(self.levels.size, -1)
        change = 100 * (X - self.X)[i, j] / size
        moved = Moved(
            float(np.sqrt(np.mean(change**2))), float(np.abs(change).max()), int((np.abs(change) > 1e-7).sum())
        )
        return EverettTable(self.levels, X, self.base), moved


def _single_peaks(record: Record, levels: np.ndarray) -> list[Record]:
    """The curves of a record, cut where its input is back at the lowest level."""
    r, span = record.take(record.used), float(np.ptp(levels))
    near = r.u <= levels[0] + APART * span
    edges = np.flatnonzero(np.diff(np.concatenate([[False], near, [False]]).astype(int)))
    lowest = [a + int(np.argmin(r.u[a:b])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    cuts = sorted({0, *lowest})
    pieces = [r.take(np.arange(a, b + 1)) for a, b in zip(cuts, [*cuts[1:], len(r) - 1], strict=True) if b > a]
    pieces = [piece for piece in pieces if piece.u.max() > levels[0] + APART * span]
    for piece in pieces:
        top = int(np.argmax(piece.u))
        if piece.u[-1] > levels[0] + APART * span:
            raise DataError(f"curve {record.name!r} does not fall back to {levels[0]:g} after its peak")
        back = max((np.maximum.accumulate(side) - side).max() for side in (piece.u[: top + 1], -piece.u[top:]))
        if back > 0.2 * APART * span:
            raise DataError(
                f"curve {record.name!r} reverses between {levels[0]:g} and its peak {piece.u[top]:g}: a table needs curves that rise "
                "to one peak and fall back (--model preisach fits any input)"
            )
    return pieces


def _monotone(X: np.ndarray) -> np.ndarray:
    """Dykstra's alternating projections on "falls with beta" and "rises with alpha", from 0 on the diagonal."""
    n = X.shape[0]
    Y, kept = X.copy(), [np.zeros_like(X), np.zeros_like(X)]
    for _ in range(5000):
        before = Y
        for k in (0, 1):
            trial = Y + kept[k]
            Y = np.zeros_like(X)
            for line in range(1, n):
                if k == 0:
                    Y[line, :line] = scipy.optimize.isotonic_regression(trial[line, :line], increasing=False).x
                else:
                    Y[line:, line - 1] = scipy.optimize.isotonic_regression(trial[line:, line - 1]).x
            Y = np.maximum(Y, 0.0)
            kept[k] = trial - Y
        if np.abs(Y - before).max() <= 1e-12 * np.abs(X).max(initial=1e-300):
            break
    return np.tril(Y, -1)
