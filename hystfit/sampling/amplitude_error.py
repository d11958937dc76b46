"""Error of smooth weights over loops of an amplitude that was not fitted, from fits without single amplitudes and without several.

The prior of weights and the noise say how sure they are if the model is true; that its error is absorbed at the fitted loops shows where
some are left out. The error over the swing of the output grows with the ratio of the amplitude to those fitted. It is described by a Wiener
process in the logarithm of the amplitude that is zero at the fitted ones: no length has to be known, and units do not matter. Its one
parameter is the variance of relative error over an e-fold of amplitude.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from jaxtyping import Float

from hystfit.inference.problem import Problem
from hystfit.inference.weights import Split
from hystfit.models.preisach.smooth import fit_smooth
from hystfit.quality.held_out import FOLDS, HeldOut, Scheme, correlation_length
from hystfit.quality.loops import APART, clear_reversals, distinct

_STROKES = 2  # of each amplitude, on average, where amplitudes were chosen: a loop has so many


@dataclasses.dataclass(frozen=True)
class AmplitudeError:
    """Errors beyond fitted amplitudes.

    Attributes:
        levels: logarithms of the fitted amplitudes, rising.
        variance: of the error over the output's swing, for an e-fold of amplitude.
        freedom: degrees of freedom with which it is known.
        length: samples over which the error is correlated.
    """

    levels: np.ndarray
    variance: float
    freedom: float
    length: int

    @classmethod
    def of(cls, problem: Problem, x: np.ndarray) -> AmplitudeError | None:
        """From fits without some of the amplitudes, the largest of them always fitted; None where records have one, or none in common.

        Args:
            problem: with smooth weights.
            x: the fit of all samples, physical, shape (p,).
        """
        strokes = [Strokes.of(record.u) for record in problem.data]
        levels = np.array(distinct(np.log(np.concatenate([one.swings for one in strokes])), APART)[::-1])
        if levels.size < 2 or _STROKES * levels.size > sum(one.swings.size for one in strokes):
            return None
        level = [np.abs(np.log(one.of_samples)[:, None] - levels).argmin(axis=1) for one in strokes]
        parts = np.array_split(np.arange(levels.size - 1), min(levels.size - 1, FOLDS))
        group = np.append(np.repeat(np.arange(len(parts)), [part.size for part in parts]), -1)
        used = [record.used for record in problem.data]
        folds = tuple(np.where(on, group[of], -1) for on, of in zip(used, level, strict=True))
        split = Split.of(problem.space, list(problem.data), x, held=HeldOut(Scheme.LEVELS, folds))
        smoothness = fit_smooth(split.system, fixed=split.fixed).smoothness
        relative, freedom, lengths = [], 0.0, []
        for first, last in itertools.combinations(range(len(parts) + 1), 2):
            kept = np.delete(np.arange(len(parts) + 1), np.s_[first:last])
            system = dataclasses.replace(
                split.system, grams=split.system.grams[kept], counts=split.system.counts[kept]
            )
            fitted = x.copy()
            at = split.place >= 0
            fitted[at] = fit_smooth(system, (smoothness,), fixed=split.fixed).weights[split.place[at]]
            fitted_levels = levels[~np.isin(group, np.arange(first, last))]
            for record, y, of, fold, one in zip(
                problem.data, problem.predict(fitted), level, folds, strokes, strict=True
            ):
                inside = (fold >= first) & (fold < last)
                if not inside.any():
                    continue
                error = y - record.y
                if inside[record.used].all():
                    error = error - error[inside].mean()  # the record's own offset is unknown
                for number in np.unique(of[inside]):
                    on = inside & (of == number)
                    swing = one.swing_of(record.y, record.used)[on]
                    gap = _gap(levels[number], fitted_levels)
                    relative.append(np.mean((error[on] / swing) ** 2) / gap)
                    if last == first + 1:
                        lengths.append(correlation_length(error[on]))
                        freedom += on.sum() / lengths[-1]
        return cls(levels, float(np.mean(relative)), freedom, int(np.median(lengths)))

    def sd(self, u: np.ndarray, y: np.ndarray) -> Float[np.ndarray, " T"]:
        """Standard deviation of the error over an input u with output y, shapes (T,) [y]."""
        strokes = Strokes.of(u)
        gap = np.array([_gap(value, self.levels) for value in np.log(strokes.swings)])
        return np.sqrt(self.variance * gap[strokes.number]) * strokes.swing_of(y, np.ones(y.size, dtype=bool))


def _gap(level: float, fitted: np.ndarray) -> float:
    """Variance of a Wiener process at a level, known at fitted ones (rising) and of unit variance over a unit."""
    k = int(np.searchsorted(fitted, level))
    if np.abs(fitted - level).min() <= APART:
        return 0.0
    if k in (0, fitted.size):
        return float(np.abs(fitted - level).min())
    below, above = fitted[k - 1], fitted[k]
    return float((level - below) * (above - level) / (above - below))


@dataclasses.dataclass(frozen=True)
class Strokes:
    """Branches of an input between clear reversals.

    Attributes:
        edges: first sample of each, and the end, shape (K + 1,).
        number: of the stroke of every sample, shape (T,).
        swings: change of the input over each, shape (K,); those that a record cuts off have the swing of their neighbor.
    """

    edges: np.ndarray
    number: np.ndarray
    swings: np.ndarray

    @classmethod
    def of(cls, u: np.ndarray) -> Strokes:
        """Strokes of an input, shape (T,)."""
        edges = np.concatenate([[0], clear_reversals(u), [u.size]])
        return cls(edges, np.repeat(np.arange(edges.size - 1), np.diff(edges)), _swings(u, edges))

    @property
    def of_samples(self) -> np.ndarray:
        """Swing of the stroke of every sample, shape (T,)."""
        return self.swings[self.number]

    def swing_of(self, y: np.ndarray, used: np.ndarray) -> np.ndarray:
        """Change of an output over the stroke of every sample, shape (T,)."""
        return _swings(np.where(used, y, np.nan), self.edges)[self.number]


def _swings(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    swings = np.array([np.nanmax(part) - np.nanmin(part) for part in (values[a : b + 1] for a, b in itertools.pairwise(edges))])
    if swings.size > 1:
        swings[0], swings[-1] = max(swings[0], swings[1]), max(swings[-1], swings[-2])
    return swings
