"""Smooth weights from their normal equations: convex, bounded, the smoothness chosen by the error on held-out data."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy  # loads its subpackages when they are first used
from jaxtyping import Float

from hystfit.models.preisach.smooth_system import SmoothSystem
from hystfit.models.shared.design import effective_number, with_own_offsets
from hystfit.models.shared.nonnegative import solve_nonnegative, submatrix
from hystfit.params.host_arrays import NUMBERS
from hystfit.runs.threads import Workers

SMOOTHNESS = tuple(10.0**k for k in range(-9, 0))
_EQUAL = 1.01  # ratio of errors on held-out groups, or of residuals, below which two strengths are equally good


@dataclasses.dataclass(frozen=True)
class SmoothFit:
    """Solution of a `SmoothSystem`."""

    weights: np.ndarray  # all p weights, in output units; fixed ones as given
    smoothness: float  # strength of the penalty, relative to the number of samples
    # root mean square error on held-out groups, in parts of the output's range, for each strength; infinite for those that were not tried
    left_out: np.ndarray
    error: float | None  # the same for the strength chosen; None where there was no choice
    rss: float  # sum of squared residuals, output units
    cost: float  # the same with the penalty added
    # number of weights that the data determine, see `effective_number`; None where there was no choice
    effective: float | None
    # what the penalty adds to the normal matrix, in units of outputs / weights, shape (p, p)
    penalty: np.ndarray
    size: float  # of the output, as in the system
    moving: np.ndarray  # positions of the weights that are neither fixed nor held at zero

    def following(self, system: SmoothSystem, products: Float[np.ndarray, "p q"]) -> Float[np.ndarray, "p q"]:
        """How the weights follow changes of the residuals, given as products with the columns, while the same ones are at zero."""
        at = self.moving
        A = submatrix(system.grams.sum(axis=0)[:-1, :-1] + self.penalty, at)
        A[np.diag_indices_from(A)] += 1e-12 * np.trace(A) / max(at.size, 1)
        changes = np.zeros(products.shape)
        changes[at] = -scipy.linalg.solve(A, products[at], assume_a="pos")
        return changes


def fit_smooth(
    system: SmoothSystem, strengths: Sequence[float] = SMOOTHNESS, *, fixed: np.ndarray | None = None
) -> SmoothFit:
    """Solve for the weights, with the smoothness whose error on held-out groups in turn is smallest.

    Scattered samples do not test loops of other sizes, which depend on it: of smoothnesses with practically equal errors on such samples
    the strongest is taken. Of 24 simulated devices this changed the error on a loop of another size by -16 to 5 %, -2 % on average, and
    on a measured one (M130-27s between two other loops) from 1.57 to 1.12 % of the range.

    The offset of a record that is left out as a whole is fitted to it.

    Args:
        strengths: of the penalty to choose among; a single one is used without a choice.
        fixed: values of weights that are not fitted, NaN for the others, output units, shape (p,).
    """
    fixed = np.full(system.roughness.shape[0], np.nan) if fixed is None else fixed
    trials = _Trials.of(system, fixed)
    left_out = trials.left_out(strengths, refitted=True) if len(strengths) > 1 else []
    choose = trials.smoothest if left_out and system.scattered else trials.chosen
    best = choose(strengths, left_out)
    found = _fit(system, trials, fixed, strengths[best])
    if not left_out:
        return found
    effective = trials.effective(strengths[best])
    return dataclasses.replace(found, left_out=np.array(left_out), error=left_out[best], effective=effective)


def _fit(system: SmoothSystem, trials: _Trials, fixed: np.ndarray, smoothness: float) -> SmoothFit:
    """The solution with a penalty of some strength, without errors on held-out groups."""
    v, positive, rss = trials.solved(smoothness)
    strength, size = smoothness * trials.n, system.size
    cost = (rss + strength * float(v @ trials.rough @ v)) * size**2
    weights = fixed.copy()
    weights[trials.free] = (v + system.origin[trials.free]) * size
    penalty = strength * system.roughness
    moving = trials.free[positive]
    return SmoothFit(weights, smoothness, np.array([]), None, rss * size**2, cost, None, penalty, size, moving)


class LeftOutErrors(NamedTuple):
    """Root mean square errors on held-out groups, and on all samples: those in every fit count with the error of the fit.

    A choice by the first alone takes elements that describe these samples badly, such as the largest of several loops.
    `beaten` says that both are lower bounds, which hold for weights of either sign too; `smoothness` is the strength of the penalty, None
    for bounds.
    """

    held: float
    overall: float
    beaten: bool = False
    smoothness: float | None = None

    @property
    def known(self) -> bool:
        """Whether they are the errors, not bounds of them."""
        return self.smoothness is not None


def left_out_errors(
    system: SmoothSystem,
    strengths: Sequence[float],
    fixed: np.ndarray,
    most: float = np.inf,
    likely: float | None = None,
) -> LeftOutErrors:
    """Errors of the strength that `fit_smooth` chooses in less time, for choices between systems; arguments as there.

    `likely` is the strength that a similar system chose.

    Weights that the fit of all samples holds at zero stay there without a group too, except in the error of the strength chosen: this
    takes a third of the time, and prefers weaker penalties. Errors above `most` may be lower bounds: from the samples fitted, because a
    group held out adds at least as much to the sum of squares, or from the first groups.
    """
    if np.isfinite(most):
        free = dataclasses.replace(system, bounded=np.zeros_like(system.bounded))
        least = _Trials.of(free if system.bounded.any() else system, fixed).fitted(strengths[0])
        if least > most:
            return LeftOutErrors(least, least, beaten=True)
    trials = _Trials.of(system, fixed, likely)
    left_out = trials.left_out(strengths, refitted=False, most=most)
    if np.isinf(min(left_out)):
        return LeftOutErrors(trials.least, trials.least)
    best = trials.chosen(strengths, left_out)
    if np.isinf(trials.error(strengths[best], refitted=True, most=trials.bar(strengths[best], most))):
        least = min(trials.least, float(np.nextafter(most, np.inf)))
        return LeftOutErrors(least, least)
    held, overall = trials.error(strengths[best], refitted=True), trials.overall(strengths[best])
    if trials.least < min(held, overall):
        return LeftOutErrors(trials.least, trials.least)
    return LeftOutErrors(held, overall, smoothness=strengths[best])


def errs_more(system: SmoothSystem, strengths: Sequence[float], fixed: np.ndarray, most: float) -> SmoothFit | None:
    """The fit with the weakest penalty where those of all samples err more than `most` on samples that are held out in turn, else None.

    From the strongest penalty to the weakest, which leaves the smallest error: each solution starts the next; see `fit_smooth`.
    """
    trials, count = _Trials.of(system, fixed), system.counts[:-1].sum()
    squares = (trials.fitted_squares(strength, slice(0, -1)) for strength in strengths[::-2])
    return _fit(system, trials, fixed, strengths[0]) if all(rss > most**2 * count for rss in squares) else None


class _Solved(NamedTuple):
    """Weights, which of them are not held at zero, and the sum of squared residuals."""

    weights: np.ndarray
    positive: np.ndarray
    rss: float


class _Trials:
    """Solutions of a system with penalties of different strengths, each started from the one before; see `left_out_errors`."""

    def __init__(self, system: SmoothSystem, fixed: np.ndarray, likely: float | None = None):
        self._grams, self.free = _reduced(system, fixed - system.origin * system.size)
        self._total, self.n = self._grams.sum(axis=0), float(system.counts.sum())
        self.rough, self._bounded = submatrix(system.roughness, self.free), system.bounded[self.free]
        self._penalty = scipy.sparse.csr_array(self.rough)
        self._own, self._counts = system.offsets[self.free], system.counts
        self._solved: dict[float, _Solved] = {}
        self._squares: dict[float, np.ndarray] = {}  # squared errors of those on each group
        self._errors: dict[tuple[float, bool], float] = {}
        self._above: dict[tuple[float, bool], float] = {}  # what errors that were not finished exceed
        self._positive: np.ndarray | None = None
        self._likely = likely
        self.least = np.inf  # lower bound of the errors with the strengths that the last choice left out

    @classmethod
    def of(cls, system: SmoothSystem, fixed: np.ndarray, likely: float | None = None) -> _Trials:
        """Those of a system, which keeps the last ones in `solved`: the choice of a size and the fit solve the same equations.

        Bounded weights that the data hardly determine depend on the solution that a solve starts from: a fit of them begins anew, so that
        it does not depend on what was solved before.
        """
        key = fixed.tobytes()
        known = system.solved.get(key)
        if known is None or system.bounded.any():
            system.solved.clear()
            system.solved[key] = cls(system, fixed, likely if known is None else known.likely)
        return system.solved[key]

    @property
    def likely(self) -> float | None:
        """The strength with the smallest error on held-out groups so far."""
        return min(self._errors, key=self._errors.__getitem__)[0] if self._errors else self._likely

    def left_out(self, strengths: Sequence[float], *, refitted: bool, most: float = np.inf) -> list[float]:
        """The error on held-out groups with each rising strength; infinite for those that are not tried, or above `most` by `fitted`.

        Every second one from the strongest until the error grows, and the neighbors of the best: among weak ones, with which other
        samples hardly determine the weights, the error has several minima. One whose fit errs more on all samples than another, such as the
        likely one, on those held out is not tried, and one whose first groups tell that it is not as good is not finished: each of its
        solves is for one group. Bounded weights are compared with stronger penalties alone, since those held at zero prefer weak ones.
        """
        errors, self.least, best = [np.inf] * len(strengths), np.inf, np.inf
        held = bool(self._bounded.any())
        every = range(len(strengths) - 1, -1, -2)

        def error(k: int) -> float:
            nonlocal best
            if min(most, best) < (least := self.fitted(strengths[k])):
                self.least = min(self.least, least) if most < least else self.least
                return np.inf
            found = self.error(strengths[k], refitted=refitted, most=_EQUAL * (min(errors) if held else best))
            best = min(best, found)
            return found

        likely = self.likely if self.likely in strengths else None
        if likely is not None:
            for k in every:  # each solution starts the next
                if strengths[k] > likely:
                    self.solved(strengths[k])
            error(strengths.index(likely))
        for k in every:
            errors[k] = error(k)
            if errors[k] > _EQUAL * min(errors):
                break
        at = int(np.argmin(errors))
        for k in range(max(at - 1, 0), min(at + 2, len(strengths))):
            errors[k] = error(k)
        return errors

    def error(self, strength: float, *, refitted: bool, most: float = np.inf) -> float:
        """Root mean square error on the held-out groups; `refitted` says whether each fit decides which weights are zero.

        Infinite where it is above `most`, unless it is known.
        """
        key = strength, refitted and bool(self._bounded.any())
        if key not in self._errors and self._above.get(key, -np.inf) < most:
            found = self._error(strength, refitted=key[1], most=most)
            if found <= most:
                self._errors[key] = found
            else:
                self._above[key] = most
        return self._errors.get(key, np.inf)

    def bar(self, strength: float, most: float) -> float:
        """The error on the held-out groups from which both errors of `LeftOutErrors` are above `most`."""
        fixed, held = self.fitted_squares(strength, slice(-1, None)), self._counts[:-1].sum()
        return float(np.sqrt(max(most**2, (most**2 * self._counts.sum() - fixed) / held)))

    def overall(self, strength: float) -> float:
        """Root mean square error of all samples: see `LeftOutErrors`."""
        squares = self.error(strength, refitted=True) ** 2 * self._counts[:-1].sum()
        squares += self.fitted_squares(strength, slice(-1, None))
        return float(np.sqrt(squares / self._counts.sum()))

    def fitted(self, strength: float) -> float:
        """Lower bound of both errors of `LeftOutErrors` by the fit of all samples."""
        held, count = self.fitted_squares(strength, slice(0, -1)), self._counts.sum()
        return float(np.sqrt(min(held / self._counts[:-1].sum(), self.solved(strength).rss / count)))

    def fitted_squares(self, strength: float, groups: slice) -> float:
        """Sum of squared errors of the fit of all samples on some of the groups."""
        if strength not in self._squares:
            r = np.append(-self.solved(strength).weights, 1.0)
            self._squares[strength] = np.maximum(self._grams @ r @ r, 0.0)
        return float(sum(self._squares[strength][groups]))

    def _error(self, strength: float, *, refitted: bool, most: float) -> float:
        positive = self.solved(strength).positive
        bounded = self._bounded if refitted else np.zeros_like(self._bounded)
        at = np.arange(self.free.size) if refitted else np.flatnonzero(positive)
        rows = np.append(at, self.free.size)
        total, whole = submatrix(self._total, rows), at.size == self.free.size
        rough = self._penalty if whole else self._penalty[at][:, at]
        squares, held = np.zeros(self._counts.size - 1), self._counts[:-1].sum()

        def solve(groups: Sequence[int]) -> None:
            others = np.empty_like(total)  # memory that all groups use
            for group in groups:
                if squares.sum() > most**2 * held:
                    return
                own, count = submatrix(self._grams[group], rows), self._counts[group]
                np.subtract(total, own, out=others)
                absent = self._own[at] & (np.diag(others)[:-1] == 0)
                v, _ = _solve(others, rough, strength * (self.n - count), bounded[at], positive[at])
                r = np.append(-with_own_offsets(own[:-1, :-1], own[None, :-1, -1], v[None], absent)[0], 1.0)
                squares[group] = max(float(r @ own @ r), 0.0)

        workers = Workers(None if total.size > NUMBERS else 1)
        parts = (range(k, squares.size, workers.count) for k in range(workers.count))
        workers.run([functools.partial(solve, part) for part in parts])
        return float(np.sqrt(sum(squares.tolist()) / held))

    def effective(self, strength: float) -> float:
        """Number of weights that the data determine."""
        return effective_number(self._total[:-1, :-1], strength * self.n * self.rough, self.solved(strength).positive)

    def chosen(self, strengths: Sequence[float], left_out: Sequence[float]) -> int:
        """The strength with the smallest left-out error (the first one without errors).

        Where the errors of several strengths are practically equal, those that fit the data clearly worse are out of the choice:
        a block that alone determines a weight is then predicted by the penalty, which has no say where that block is measured.
        """
        if not left_out:
            return 0
        order = np.argsort(left_out, kind="stable")
        rss = {int(k): self.solved(strengths[k]).rss for k in order if left_out[k] <= _EQUAL * left_out[order[0]]}
        return next(k for k in rss if rss[k] <= _EQUAL**2 * min(rss.values()))

    def smoothest(self, strengths: Sequence[float], left_out: list[float]) -> int:
        """The strongest penalty with practically the smallest left-out error; errors that were not known are put into the list."""
        most = _EQUAL * min(left_out)
        best = max(k for k, error in enumerate(left_out) if error <= most)
        for k in range(best + 1, len(strengths)):
            left_out[k] = self.error(strengths[k], refitted=True, most=most)
            if left_out[k] > most:
                break
            best = k
        return best

    def solved(self, strength: float) -> _Solved:
        """The weights that all samples give."""
        if strength not in self._solved:
            total = self._total.copy()
            v, self._positive = _solve(total, self._penalty, strength * self.n, self._bounded, self._positive)
            r = np.append(-v, 1.0)
            self._solved[strength] = _Solved(v, self._positive, max(float(r @ self._total @ r), 0.0))
        return self._solved[strength]


def _reduced(system: SmoothSystem, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrices without the fixed weights, whose part moves to the side of the output, and the free ones' positions.

    `values` are those of the fixed weights, NaN for the free ones, output units, shape (p,).
    """
    free, fixed = np.flatnonzero(np.isnan(values)), np.flatnonzero(~np.isnan(values))
    if not fixed.size:
        return system.grams, free
    T = np.zeros((values.size + 1, free.size + 1))
    T[free, np.arange(free.size)] = 1.0
    T[fixed, -1] = -values[fixed] / system.size
    T[-1, -1] = 1.0
    return np.stack([T.T @ gram @ T for gram in system.grams]), free


def _solve(
    gram: np.ndarray, rough: scipy.sparse.csr_array, strength: float, bounded: np.ndarray, start: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Weights of normal equations, whose memory takes the penalty too, and which of them are not held at zero."""
    A = gram[:-1, :-1]
    A[rough.nonzero()] += strength * rough.data
    A[np.diag_indices(len(A))] += 1e-12 * np.trace(A) / len(A)
    return solve_nonnegative(A, gram[:-1, -1], bounded, start)
