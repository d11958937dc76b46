"""Models that are linear in their weights: bounded, regularized least squares with the strength chosen on data left out."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import numpy as np
import scipy  # loads its subpackages when they are first used, which optimize is not in most fits

from hystfit.errors import ModelError, ParameterError
from hystfit.fitting.estimate import AbstractEstimator, Estimate
from hystfit.inference.blocks import parts, spread
from hystfit.inference.problem import Problem
from hystfit.inference.weights import weighted_columns
from hystfit.models.design import FAR, effective_number, left_out_squares
from hystfit.models.nonnegative import solve_nonnegative, solve_several
from hystfit.outcome import Code, Note

# Half decades where ridges of plays lie: at a whole decade the best error can be 3 % larger, and the residuals 4 % above the noise.
STRENGTHS = tuple(10.0**k for k in (-10, -8, -6, -5, -4.5, -4, -3.5, -3, -2.5, -2, -1, 0))
_SMALL = 45  # unknowns up to which 25 systems take less time side by side than one after another
_WEAK = 1e-6  # strength at which a ridge moves no lag
_BRACKET = 0.2  # of a nonlinear parameter's natural scale: first step of its search
_QUICK = 15  # evaluations of the outer search of a first look


@dataclasses.dataclass(frozen=True)
class LinearSystem:
    """The linear least-squares problem for the linear parameters at given values of the others, on the samples that count.

    Attributes:
        columns: shape (n, p), weighted.
        target: measured output less the response with all weights zero, weighted, shape (n,).
        free: parameters without a lower bound, shape (p,), bool; the others are >= 0.
        ridged: parameters that the ridge penalizes (all but the offsets of records), shape (p,), bool.
        fold: of each sample, the group with which it is held out, shape (n,); -1 for samples that stay in every fit.
        weight: of each sample, shape (n,).
    """

    columns: np.ndarray
    target: np.ndarray
    free: np.ndarray
    ridged: np.ndarray
    fold: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, problem: Problem, x: np.ndarray, which: np.ndarray | None = None) -> LinearSystem:
        """The system at given values of the other parameters; for all linear parameters, or some.

        Args:
            problem: what is fitted.
            x: physical parameters, shape (p,).
            which: parameters to solve for, shape (p,), bool; None for all linear ones.

        Raises:
            ModelError: a linear parameter with bounds other than none or (0, infinity).
        """
        at = linear_positions(problem) if which is None else np.flatnonzero(which)
        lower, upper = (np.asarray(b)[at] for b in (problem.space.coordinates.lower, problem.space.coordinates.upper))
        if np.isfinite(upper).any() or (np.isfinite(lower) & (lower != 0)).any():
            names = [problem.space.names[k] for k in at]
            raise ModelError(f"linear parameters must be free or >= 0 for a convex fit: {names}; use method='trf'")
        columns, target = weighted_columns(problem.space, list(problem.data), x, at)
        ridged = np.array([not problem.space.infos[k].per_record for k in at])
        pairs = list(zip(problem.held_out.folds, problem.data, strict=True))
        fold, weight = (
            np.concatenate(parts) for parts in zip(*((f[r.used], r.weight[r.used]) for f, r in pairs), strict=True)
        )
        return cls(columns, target, ~np.isfinite(lower), ridged, fold, weight)

    @functools.cached_property
    def origin(self) -> np.ndarray:
        """One level for the offsets of all records, zeros for all others, shape (p,).

        Normal equations would square the size of an output far from zero. Where zero is near, the level is zero.
        """
        constant = np.flatnonzero(self.free & ~self.ridged)
        alike = [
            k for k in constant if np.ptp(column := self.columns[:, k][self.columns[:, k] != 0]) < 1e-12 * column.max()
        ]
        together, origin = self.columns[:, alike].sum(axis=1), np.zeros(self.free.size)
        level = float(together @ self.target) / max(float(together @ together), 1e-300)
        origin[alike] = level if abs(level) * np.abs(together).max(initial=0.0) > FAR * np.ptp(self.target) else 0.0
        return origin

    def normal(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Normal matrices of the held-out groups, and a last one of the samples that stay in every fit, on columns divided by `scale`.

        The target, less the response to `origin`, comes last.

        Returns:
            The matrices, shape (groups + 1, p + 1, p + 1), the scale of each column, and the number of samples of each group.
        """
        scale = spread(self.columns)
        scale = np.where(scale > 1e-9 * max(scale.max(initial=0.0), 1e-300), scale, np.inf)
        constant = ~self.ridged  # an offset has no spread, and needs no common scale
        scale[constant] = 1.0
        p, count = self.columns.shape[1], int(self.fold.max()) + 2
        grams = np.zeros((count, p + 1, p + 1))
        for gram, number in zip(grams, (*range(count - 1), -1), strict=True):
            rows = np.flatnonzero(self.fold == number)
            for part in parts(rows.size, p + 1):
                some, target = self.columns[rows[part]], self.target[rows[part]]
                target = target - some @ self.origin
                gram[:p, :p] += some.T @ some
                gram[:p, p] += some.T @ target
                gram[p, p] += target @ target
        grams[:, p, :p] = grams[:, :p, p]
        by = np.append(1 / scale, 1.0)
        grams *= by * by[:, None]
        return grams, scale, np.bincount(np.where(self.fold < 0, count - 1, self.fold), minlength=count)


def linear_positions(problem: Problem) -> np.ndarray:
    """Positions in x of the parameters in which the output is linear."""
    return np.flatnonzero(problem.space.linear)


def solve_normal(
    matrix: np.ndarray, free: np.ndarray, ridge: np.ndarray, start: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Minimize w'Aw - 2 w'b + ridge w'w with w >= 0 where not free; matrix = [[A, b], [b', .]].

    Args:
        matrix: shape (p + 1, p + 1).
        free: unknowns without a lower bound, shape (p,), bool.
        ridge: added to the diagonal, shape (p,).
        start: which unknowns are not zero at a neighboring solution, shape (p,), bool.

    Returns:
        w, shape (p,), and which unknowns are not held at zero, to start a similar problem from.
    """
    return solve_nonnegative(_ridged(matrix[:-1, :-1], ridge), matrix[:-1, -1], ~free, start)


def _ridged(A: np.ndarray, ridge: np.ndarray) -> np.ndarray:
    """Normal matrices (..., p, p) with a ridge (..., p) on the diagonal, and what rounding needs."""
    A, at = A.copy(), np.arange(A.shape[-1])
    A[..., at, at] += ridge
    A[..., at, at] += 1e-12 * np.mean(A[..., at, at], axis=-1, keepdims=True)
    return A


def _solve_ridges(matrices: np.ndarray, free: np.ndarray, ridges: np.ndarray) -> np.ndarray:
    """Solutions for G matrices, shape (G, p + 1, p + 1), each with S ridges, shape (G, S, p); shape (G, S, p)."""
    if free.size <= _SMALL:
        A, b = (np.repeat(part, ridges.shape[1], axis=0) for part in (matrices[:, :-1, :-1], matrices[:, :-1, -1]))
        return solve_several(_ridged(A, ridges.reshape(len(A), -1)), b, ~free).reshape(ridges.shape)
    found = np.zeros(ridges.shape)
    for of_matrix, matrix, own in zip(found, matrices, ridges, strict=True):
        positive = None
        for k, ridge in enumerate(own):
            of_matrix[k], positive = solve_normal(matrix, free, ridge, positive)
    return found


@dataclasses.dataclass(frozen=True)
class RidgeFit:
    """Solution of a `LinearSystem`.

    Attributes:
        weights: shape (p,).
        strength: of the ridge, relative to the samples' number, on columns of unit spread.
        ridge: what it adds to the normal matrix of the weights, diagonal, shape (p,).
        left_out: weighted root mean square error on held-out groups, output units, for each strength tried.
        rss: sum of squared residuals.
        effective: number of weights that the data determine, see `effective_number`.
    """

    weights: np.ndarray
    strength: float
    ridge: np.ndarray
    left_out: np.ndarray
    rss: float
    effective: float

    @property
    def score(self) -> float:
        """The smallest error on held-out groups."""
        return float(np.min(self.left_out))


def fit_ridge(system: LinearSystem, strengths: tuple[float, ...] = STRENGTHS) -> RidgeFit:
    """Solve, with the strength whose error on the groups held out in turn is smallest.

    The offset of a record that is left out as a whole is fitted to it.
    """
    grams, scale, counts = system.normal()
    total, n = grams.sum(axis=0), counts.sum()
    dead = ~np.isfinite(scale)
    held = system.ridged | dead
    error = np.zeros(len(strengths))
    others, fewer = total - grams[:-1], n - counts[:-1]
    absent = ~held & (np.diagonal(others, axis1=1, axis2=2)[:, :-1] == 0)
    ridges = fewer[:, None, None] * np.array(strengths)[:, None] * held + dead
    solved = _solve_ridges(others, system.free, ridges)
    for gram, own, weights in zip(grams[:-1], absent, solved, strict=True):
        error += [left_out_squares(gram, w, own) for w in weights]
    left_out = np.sqrt(error / system.weight[system.fold >= 0].sum())
    best = int(np.argmin(left_out))
    ridge = held * strengths[best] * n + dead
    w, positive = solve_normal(total, system.free, ridge)
    effective = effective_number(total[:-1, :-1], np.diag(ridge), positive & ~dead)
    r = np.append(-w, 1.0)
    finite = np.where(dead, 1.0, scale)
    weights = np.where(dead, 0.0, w / finite) + system.origin
    return RidgeFit(weights, strengths[best], ridge * finite**2, left_out, max(float(r @ total @ r), 0.0), effective)


def penalized(system: LinearSystem, strength: float) -> float:
    """Least sum of squares and ridge that the weights reach at a given strength: what nonlinear parameters minimize.

    Args:
        system: at some values of the nonlinear parameters.
        strength: of the ridge.
    """
    grams, scale, counts = system.normal()
    total, dead = grams.sum(axis=0), ~np.isfinite(scale)
    ridge = (system.ridged | dead) * strength * counts.sum() + dead
    w, _ = solve_normal(total, system.free, ridge)
    r = np.append(-w, 1.0)
    return max(float(r @ total @ r), 0.0) + float(ridge @ w**2)


class Convex(AbstractEstimator):
    """The weights of a model that is linear in them, given its other parameters; the nonlinear ones by a simplex outside.

    For plays, relays and creep weights: dozens of unknowns, of which many end on zero. With nonlinear parameters free (a lag, a
    bend) those move to lower the cost at the strength found at the start, and the strength is found again at the end. At a wrong lag
    cross-validation chooses a strong ridge, with which the cost has its minimum at another wrong lag. If the ridge is strong, the
    search is therefore repeated with a weak one.

    Attributes:
        strengths: of the ridge, among which held-out groups choose.
        max_evaluations: of an outer search.
    """

    needs_starts: ClassVar[bool] = False
    strengths: tuple[float, ...] = eqx.field(static=True, default=STRENGTHS)
    max_evaluations: int = eqx.field(static=True, default=80)

    def quick(self) -> Convex:
        """See the base class."""
        return dataclasses.replace(self, max_evaluations=_QUICK)

    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        """See `AbstractEstimator.estimate`; the first start alone matters, because the weights need none.

        Raises:
            ModelError: no free parameter enters linearly, or one has bounds that this method does not serve.
            ParameterError: tied parameters.
        """
        if problem.space.ties:
            raise ParameterError("tied parameters need another method than 'convex': choose method='lm'")
        at = linear_positions(problem)
        if not at.size:
            raise ModelError(f"{type(problem.model).__name__} has no linear weights: use method='lm' or 'trf'")
        others = np.setdiff1d(np.arange(len(problem.space)), at)
        x = np.array(problem.space.physical(starts[0]))
        evaluations, converged, message = 1, True, "solved"
        if others.size:
            x, evaluations, converged, message = self._search(problem, starts[0], others)
        system = LinearSystem.of(problem, x)
        fit = fit_ridge(system, self.strengths)
        x[at] = fit.weights
        size = problem.scales.y
        penalty = np.zeros(x.size)
        penalty[at] = fit.ridge / size**2
        note = (
            f"ridge {fit.strength:.0e} chosen by cross-validation on {system.fold.max() + 1} groups "
            f"(error {100 * fit.score / (2 * size):.2f} % of the range)"
        )
        if fit.strength == max(self.strengths):
            note += "; it is the largest tried"
        cost = 0.5 * fit.rss / size**2
        chosen = (Note(Code.CHOICE, note),)
        costs, effective = np.array([cost]), fit.effective + others.size
        return Estimate(
            x,
            cost,
            converged,
            message,
            evaluations,
            costs,
            penalty,
            chosen,
            fit.score,
            toward_zero=True,
            effective=effective,
        )

    def _search(self, problem: Problem, z: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, int, bool, str]:
        """Where the nonlinear parameters end: with the ridge of the start or, if that is strong, with a weak one, by left-out error."""

        def search(strength: float) -> tuple[np.ndarray, int, bool, str]:
            cost = lambda x: float(np.log(penalized(LinearSystem.of(problem, x), strength) + 1e-300))
            limits = {"maxfev": self.max_evaluations, "xatol": 1e-2, "fatol": 1e-4}
            return search_nonlinear(problem, cost, z, others, **limits)

        first = fit_ridge(LinearSystem.of(problem, problem.space.physical(z)), self.strengths).strength
        weak = min(self.strengths, key=lambda strength: abs(np.log(strength / _WEAK)))
        ended = [search(strength) for strength in dict.fromkeys((first, min(first, weak)))]
        scores = [fit_ridge(LinearSystem.of(problem, x), self.strengths).score for x, *_ in ended] if ended[1:] else [0]
        x, _, converged, message = ended[int(np.argmin(scores))]
        return x, sum(evaluations for _, evaluations, _, _ in ended), converged, message


def search_nonlinear(
    problem: Problem, cost: Callable[[np.ndarray], float], z: np.ndarray, others: np.ndarray, **options: Any
) -> tuple[np.ndarray, int, bool, str]:
    """Search over the nonlinear parameters of a model whose weights are solved for inside (variable projection).

    Args:
        problem: what is fitted.
        cost: of physical parameters, shape (p,).
        z: unconstrained start, shape (p,).
        others: positions of the nonlinear parameters.
        **options: of the simplex search.

    Returns:
        Physical parameters at the lowest cost, the number of evaluations, whether it converged, and a message.
    """

    def at(inner: np.ndarray) -> np.ndarray:
        trial = z.copy()
        trial[others] = inner
        return np.array(problem.space.physical(trial))

    if others.size == 1:  # by parabolas: a sixth of the evaluations of a simplex
        bracket, limits = (
            (z[others[0]], z[others[0]] + _BRACKET),
            {"maxiter": options["maxfev"], "xtol": options["xatol"]},
        )
        of_number = lambda v: cost(at(np.atleast_1d(v)))
        solution = scipy.optimize.minimize_scalar(of_number, bracket, method="brent", options=limits)
    else:
        solution = scipy.optimize.minimize(lambda v: cost(at(v)), z[others], method="Nelder-Mead", options=options)
    stopped = f"the search over nonlinear parameters stopped after {solution.nfev} evaluations"
    message = "converged" if solution.success else stopped
    return at(np.atleast_1d(solution.x)), int(solution.nfev), bool(solution.success), message
