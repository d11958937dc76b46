"""Bounded, regularized least squares for linear weights, with the strength of the ridge chosen on data left out."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hystfit.errors import ModelError
from hystfit.fitting.solvers.variable_projection import Eliminated, counted, output_slopes
from hystfit.inference.blocks import NUMBERS, parts, spread
from hystfit.inference.problem import Problem
from hystfit.inference.weights import weighted_columns
from hystfit.models.shared.design import FAR, effective_number, with_own_offsets
from hystfit.models.shared.nonnegative import solve_nonnegative, solve_several, submatrix

# Half decades where ridges of plays and dampers lie: at a whole decade the best error can be 3 % larger, and the residuals 4 % above the
# noise; of a damper whose best ridge lies at 10^-1.5, 10 and 21 %.
STRENGTHS = tuple(10.0**k for k in (-10, -8, -6, -5, -4.5, -4, -3.5, -3, -2.5, -2, -1.5, -1, -0.5, 0))
_SMALL = 45  # unknowns up to which 25 systems take less time side by side than one after another


@dataclasses.dataclass(frozen=True)
class LinearSystem:
    """The linear least-squares problem for the linear parameters at given values of the others, on the samples that count."""

    columns: np.ndarray  # shape (n, p), weighted
    target: np.ndarray  # measured output less the response with all weights zero, weighted, shape (n,)
    free: np.ndarray  # parameters without a lower bound, shape (p,), bool; the others are >= 0
    ridged: np.ndarray  # parameters that the ridge penalizes (all but the offsets of records), shape (p,), bool
    # of each sample, the group with which it is held out, shape (n,); -1 for samples that stay in every fit
    fold: np.ndarray
    weight: np.ndarray  # of each sample, shape (n,)

    @classmethod
    def of(cls, problem: Problem, x: np.ndarray, which: np.ndarray | None = None) -> LinearSystem:
        """The system at physical x, shape (p,), for the linear parameters `which`, shape (p,), bool; None for all of them."""
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

    def origins(self, targets: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N p"]:
        """For each target, one level for the offsets of all records, zeros for all others.

        Normal equations would square the size of an output far from zero. Where zero is near, the level is zero.
        """
        constant = np.flatnonzero(self.free & ~self.ridged)
        alike = [
            k for k in constant if np.ptp(column := self.columns[:, k][self.columns[:, k] != 0]) < 1e-12 * column.max()
        ]
        together, origins = self.columns[:, alike].sum(axis=1), np.zeros((len(targets), self.free.size))
        level = targets @ together / max(float(together @ together), 1e-300)
        far = np.abs(level) * np.abs(together).max(initial=0.0) > FAR * np.ptp(targets, axis=1)
        origins[:, alike] = np.where(far, level, 0.0)[:, None]
        return origins

    def normal(self, targets: Float[np.ndarray, "N n"] | None = None) -> Normal:
        """Normal equations of the target, or of others on the same columns, less the response to `origins`."""
        targets = self.target[None] if targets is None else targets
        scale = spread(self.columns)
        scale = np.where(scale > 1e-9 * max(scale.max(initial=0.0), 1e-300), scale, np.inf)
        scale[~self.ridged] = 1.0  # an offset has no spread, and needs no common scale
        p, count, origins = self.columns.shape[1], int(self.fold.max()) + 2, self.origins(targets)
        A, b, squares = np.zeros((count, p, p)), np.zeros((len(targets), count, p)), np.zeros((len(targets), count))
        for group, number in enumerate((*range(count - 1), -1)):
            rows = np.flatnonzero(self.fold == number)
            for part in parts(rows.size, p + len(targets)):
                some = self.columns[rows[part]]
                rest = targets[:, rows[part]] - origins @ some.T
                A[group] += some.T @ some
                b[:, group] += rest @ some
                squares[:, group] += np.einsum("nk,nk->n", rest, rest)
        counts = np.bincount(np.where(self.fold < 0, count - 1, self.fold), minlength=count)
        return Normal(A / scale / scale[:, None], b / scale, squares, origins, scale, counts)


class Normal(NamedTuple):
    """Normal equations of N targets on the same columns, for G held-out groups of samples and a last one that stays in every fit."""

    A: np.ndarray  # shape (G + 1, p, p), of columns divided by `scale`
    b: np.ndarray  # shape (N, G + 1, p)
    squares: np.ndarray  # of the targets, shape (N, G + 1)
    origins: np.ndarray  # about which the targets are solved for, shape (N, p)
    scale: np.ndarray  # of each column, infinite for columns that vanish, shape (p,)
    counts: np.ndarray  # number of samples of each group, shape (G + 1,)

    @property
    def dead(self) -> np.ndarray:
        """Which columns vanish, shape (p,), bool."""
        return ~np.isfinite(self.scale)


def linear_positions(problem: Problem) -> np.ndarray:
    """Positions in x of the parameters in which the output is linear."""
    return np.flatnonzero(problem.space.linear)


def solve_normal(
    A: np.ndarray, b: np.ndarray, free: np.ndarray, ridges: np.ndarray, start: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Minimize w'Aw - 2 w'b + ridge w'w with w >= 0 where not free, for K problems.

    A has shape (K, p, p), or (p, p) where all share it, b and the ridges of the diagonals (K, p). With the solutions it returns which
    unknowns are not held at zero, shapes (K, p); `start` is this of neighboring solutions.
    """
    found, positive = np.empty_like(b), np.empty(b.shape, bool)
    A = np.broadcast_to(A, (len(b), *A.shape[-2:]))
    if free.size <= _SMALL:
        for part in parts(len(b), free.size**2):
            own = None if start is None else start[part]
            found[part], positive[part] = solve_several(_ridged(A[part], ridges[part]), b[part], ~free, own)
        return found, positive
    for k, right in enumerate(b):
        own = None if start is None else start[k]
        found[k], positive[k] = solve_nonnegative(_ridged(A[k], ridges[k]), right, ~free, own)
    return found, positive


def _ridged(A: np.ndarray, ridge: np.ndarray) -> np.ndarray:
    """Normal matrices (..., p, p) with a ridge (..., p) on the diagonal, and what rounding needs."""
    A, at = A.copy(), np.arange(A.shape[-1])
    A[..., at, at] += ridge
    A[..., at, at] += 1e-12 * np.mean(A[..., at, at], axis=-1, keepdims=True)
    return A


def _squares(A: np.ndarray, b: np.ndarray, squares: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Sums of squared residuals of N targets at weights (N, p), from their normal equations."""
    return np.maximum(squares - 2 * np.einsum("np,np->n", b, w) + np.einsum("np,np->n", w @ A, w), 0.0)


class RidgeFit(NamedTuple):
    """Solution of a `LinearSystem` for one target; or solutions for N targets, along a first axis of each array."""

    weights: np.ndarray  # shape (p,)
    strength: np.ndarray  # of the ridge, relative to the samples' number, on columns of unit spread
    ridge: np.ndarray  # what it adds to the normal matrix of the weights, diagonal, shape (p,)
    # weighted root mean square error on held-out groups, output units, for each strength tried, shape (S,)
    left_out: np.ndarray
    rss: np.ndarray  # sum of squared residuals
    effective: np.ndarray  # number of weights that the data determine, see `effective_number`

    @property
    def score(self) -> np.ndarray:
        """The smallest error on held-out groups."""
        return self.left_out.min(axis=-1)

    def of(self, k: int) -> RidgeFit:
        """The solution for one of several targets."""
        return RidgeFit(*(values[k] for values in self))


def fit_ridge(system: LinearSystem, strengths: tuple[float, ...] = STRENGTHS) -> RidgeFit:
    """Solve, with the strength whose error on the groups held out in turn is smallest.

    The offset of a record that is left out as a whole is fitted to it.
    """
    return fit_ridges(system, system.target[None], strengths).of(0)


def fit_ridges(
    system: LinearSystem, targets: Float[np.ndarray, "N n"], strengths: tuple[float, ...] = STRENGTHS
) -> RidgeFit:
    """`fit_ridge` for each of several targets on the columns of a system."""
    normal = system.normal(targets)
    dead, n = normal.dead, normal.counts.sum()
    held, total, tried = system.ridged | dead, normal.A.sum(axis=0), np.array(strengths)
    left_out = np.sqrt(_left_out(system, normal, held, tried) / system.weight[system.fold >= 0].sum())
    best = np.argmin(left_out, axis=1)
    ridge = held * tried[best, None] * n + dead
    b, squares = normal.b.sum(axis=1), normal.squares.sum(axis=1)
    w, positive = solve_normal(total, b, system.free, ridge)
    effective = [effective_number(total, np.diag(own), on & ~dead) for own, on in zip(ridge, positive, strict=True)]
    finite = np.where(dead, 1.0, normal.scale)
    weights = np.where(dead, 0.0, w / finite) + normal.origins
    rss = _squares(total, b, squares, w)
    return RidgeFit(weights, tried[best], ridge * finite**2, left_out, rss, np.array(effective))


def _left_out(system: LinearSystem, normal: Normal, held: np.ndarray, strengths: np.ndarray) -> np.ndarray:
    """Sums of squared residuals of the held-out groups with each strength, shape (N, S); `held` are the weights with a ridge."""
    N, groups, p = len(normal.b), len(normal.A) - 1, held.size
    A, b = normal.A.sum(axis=0) - normal.A[:-1], normal.b.sum(axis=1, keepdims=True) - normal.b[:, :-1]
    fewer = normal.counts.sum() - normal.counts[:-1]
    absent = ~held & (np.diagonal(A, axis1=1, axis2=2) == 0)
    together = strengths.size if N * A.size * strengths.size <= NUMBERS and p <= _SMALL else 1
    out, positive = np.zeros((N, strengths.size)), None
    for begin in range(0, strengths.size, together):
        some = strengths[begin : begin + together]
        shape = (some.size, N, groups)
        ridges = np.broadcast_to((fewer * some[:, None])[:, None, :, None] * held + normal.dead, (*shape, p))
        every, right = np.broadcast_to(A, (*shape, p, p)), np.broadcast_to(b, (*shape, p))
        found, positive = solve_normal(
            every.reshape(-1, p, p), right.reshape(-1, p), system.free, ridges.reshape(-1, p), positive
        )
        found = found.reshape(*shape, p)
        for group in range(groups):
            own = normal.A[group], normal.b[:, group]
            for k, w in enumerate(found[:, :, group], begin):
                out[:, k] += _squares(*own, normal.squares[:, group], with_own_offsets(*own, w, absent[group]))
    return out


def eliminated(problem: Problem, x: np.ndarray, others: np.ndarray, strength: float) -> Eliminated:
    """What the weights leave at physical x with a ridge of given strength, beside the nonlinear parameters at the positions `others`."""
    system = LinearSystem.of(problem, x)
    normal = system.normal()
    total, b = normal.A.sum(axis=0), normal.b.sum(axis=1)
    ridge = (system.ridged | normal.dead) * strength * normal.counts.sum() + normal.dead
    (w,), (positive,) = solve_normal(total, b, system.free, ridge[None])
    full = x.copy()
    full[linear_positions(problem)] = weights = np.where(normal.dead, 0.0, w / normal.scale) + normal.origins[0]
    left = system.columns @ weights - system.target

    def slopes() -> np.ndarray:
        measured = counted(problem, [record.y for record in problem.data])
        direct = output_slopes(problem, full, others, left + measured)
        on = np.flatnonzero(positive & ~normal.dead)
        columns = system.columns[:, on] / normal.scale[on]
        follow = np.zeros((w.size, others.size))
        follow[on] = -np.linalg.solve(_ridged(submatrix(total, on), ridge[on]), columns.T @ direct)
        return np.concatenate([direct + columns @ follow[on], np.sqrt(ridge)[:, None] * follow])

    return Eliminated(np.concatenate([left, np.sqrt(ridge) * w]), slopes)
