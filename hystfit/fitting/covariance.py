"""What the data determine: covariance by SVD of the Jacobian, and the parameters that the data cannot separate."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from hystfit.fitting.active_bounds import about_estimate
from hystfit.fitting.estimate import Estimate
from hystfit.inference.linearization import Linearization
from hystfit.inference.noise.slow_likelihood import least_squares_root
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import FEW, ResidualAnalysis, analyze
from hystfit.params.coordinates import BOTH
from hystfit.params.space import relative_size

_OPEN = 1.0  # a direction is undetermined when its standard error moves parameters by their own size
_REACH = 1.96  # standard errors within which a bound makes a symmetric error bar meaningless
_RANK = 1e-7  # or when its singular value, of columns of unit length, is below this fraction of the largest: rounding errors dominate
_REST = 1e-11  # part of a column that an offset does not explain, below which it is rounding errors
_TOUCHED = 0.05  # component in an undetermined direction above which a parameter has no error bar;
_MOVED = 0.5  # where two bounds limit the direction: standard error that it adds, over the parameter's size, above which it has none
_ROUNDS, _SETTLED = 100, 1e-3  # of the share of a ridge that is known
_PART = 0.25  # components of a direction that its description includes


@dataclasses.dataclass(frozen=True)
class Uncertainty:
    """Covariance and standard errors of a fit.

    Attributes:
        covariance: of the free parameters in physical units, shape (p, p); NaN where it means nothing.
        joint: the same with the parameters that the data do not determine, whose variances are large; 0 on a bound, NaN where inactive.
        determined: whether the data determine each parameter, shape (p,), bool.
        inactive: parameters without any influence on these data, shape (p,), bool.
        directions: parameters that the data cannot separate, a text for each such direction.
        reaching: parameters whose 95 % interval reaches a bound.
        rank: number of directions determined.
        condition: largest over smallest singular value in relative coordinates; None where it is infinite.
        correlation_time: integrated autocorrelation time of the residuals, samples; 1 for white ones.
        ratio: standard errors over those for i.i.d. residuals (geometric mean over the parameters).
        sigma: standard deviation of the residuals, output units.
        residuals: their analysis.
    """

    covariance: np.ndarray
    joint: np.ndarray
    determined: np.ndarray
    inactive: np.ndarray
    directions: tuple[str, ...]
    reaching: tuple[str, ...]
    rank: int
    condition: float | None
    correlation_time: float
    ratio: float
    sigma: float
    residuals: ResidualAnalysis


def uncertainty(
    problem: Problem, estimate: Estimate, *, correlated: bool = True, root: np.ndarray | None = None
) -> Uncertainty:
    """Covariance at an estimate, to first order.

    Autocorrelated residuals carry less information than their number suggests: with `correlated` the covariance of a least-squares
    estimate is the one under slow and independent noise with their statistics (`inference.noise.slow_likelihood`). For hundreds of
    weights, or where such noise would have to be far larger than the residuals, it grows by their integrated autocorrelation time.
    Parameters on a bound and directions that the data do not determine have no finite error. Those of the others treat the
    bounds as prior information where up to 60 parameters are near theirs (`active_bounds`); for more, those at bounds are held there.

    Args:
        problem: what was fitted.
        estimate: where it ended.
        correlated: allow for autocorrelated residuals.
        root: square root R of the information R'R about x under a noise model, shape (p, p), which is then used instead.
    """
    x, y = estimate.x, problem.scales.y
    ridge = np.zeros(x.size) if estimate.penalty is None else estimate.penalty
    linear, at_bound = problem.linearization(x), problem.on_bound(x)
    residual, relative = linear.misfit, relative_size(problem.space, x)
    rows, acts = _factor(problem, x, linear, at_bound)
    live = acts & ~at_bound
    columns = lambda: linear.columns(live) * relative[live]
    analysis = ResidualAnalysis.of(problem.setting, residual * y, columns if live.sum() <= FEW else None)
    plain = float(np.sum(residual**2)) / max(int(linear.used.sum()) - int(live.sum()), 1)
    refined = root is not None
    if correlated and not refined and analysis.of_errors is not None:
        measured = linear.columns(acts)
        measured *= y
        part = least_squares_root(analysis.of_errors, measured, overwrite=True)
        root = np.zeros((len(part), x.size))
        root[:, acts] = part
    time = analysis.correlation_time if correlated or refined else 1.0
    if root is None:
        ratio, information = float(np.sqrt(time)), _Information(rows, plain * time, ridge)
    else:
        ratio = _ratio(root[:, live] * relative[live], rows[:, live] * relative[live], plain)
        information = _Information(root, 1.0, ridge / plain)
    inside = None
    if live.any() and plain > 0:
        # At the most probable point under a noise model the slope is not known.
        on_bound = at_bound & (not refined)
        slope = lambda: np.where(on_bound, linear.gradient() if on_bound.any() else 0.0, -ridge * x)
        near = _NearBounds.of(problem, x, rows, information, slope, ridge, acts)
        if near is not None:
            share = np.ones(x.size)
            if estimate.toward_zero and not refined:
                share[acts] = near.share(np.unique(_arrays(problem)[acts], return_inverse=True)[1])
            inside = near.moments(share, acts)
            information = information._replace(ridge=share * information.ridge)
    determined = _determined(problem, x, information, live, inside)
    determined["joint"][at_bound], determined["joint"][:, at_bound] = 0.0, 0.0
    return Uncertainty(
        **determined,
        inactive=~acts & ~at_bound,
        correlation_time=time,
        ratio=ratio,
        sigma=float(np.sqrt(plain)) * y,
        residuals=analysis,
    )


class _Information(NamedTuple):
    """Information about the parameters: R'R / variance, and that of a regularization.

    Attributes:
        root: R, shape (n, p).
        variance: of its rows.
        ridge: added to R'R, diagonal, shape (p,).
    """

    root: np.ndarray
    variance: float
    ridge: np.ndarray


def _arrays(problem: Problem) -> np.ndarray:
    """Name of the array that each parameter belongs to, shape (p,)."""
    return np.array([name.split("[")[0] for name in problem.space.names])


def _factor(
    problem: Problem, x: np.ndarray, linear: Linearization, at_bound: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The triangular factor of the derivatives, and which parameters have an influence on the data, shape (p,), bool.

    Of hundreds of weights few may be live: columns of the others, of which the errors make no use then, are zero in the factor.
    """
    offsets = problem.space.offsets
    if x.size <= FEW:
        factor = linear.triangle()
        return factor, _acting(problem, x, np.linalg.norm(_centered(factor, offsets)[0], axis=0))
    acts = _acting(problem, x, _centered_sizes(linear, offsets))
    needed = acts if np.count_nonzero(acts & at_bound) <= FEW else acts & ~at_bound
    part = linear.triangle(needed)
    factor = np.zeros((len(part), x.size))
    factor[:, needed] = part
    return factor, acts


def _acting(problem: Problem, x: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Parameters with an influence on the data, by the length of their centered derivatives, shape (p,), bool."""
    gain = size * np.minimum(relative_size(problem.space, x), np.asarray(problem.space.coordinates.scale))
    return gain > 1e-9 * max(gain.max(initial=0.0), 1e-300)


def _determined(
    problem: Problem, x: np.ndarray, information: _Information, live: np.ndarray, inside: np.ndarray | None
) -> dict[str, Any]:
    """Covariance, and which parameters and directions the data determine.

    Args:
        problem: what was fitted.
        x: where it ended, physical, shape (p,).
        information: about the parameters.
        live: parameters on no bound and with influence, shape (p,), bool.
        inside: the covariance where bounds are near, shape (p, p); None where none is.
    """
    space, at = problem.space, np.flatnonzero(live)
    covariance, determined = np.full((x.size, x.size), np.nan), np.zeros(x.size, bool)
    joint = covariance.copy()
    if not at.size:
        nothing = {"directions": (), "reaching": (), "rank": 0, "condition": None}
        return {"covariance": covariance, "joint": joint, "determined": determined, **nothing}
    values, root, back = _spectrum(information, live, space.offsets[live])
    kept, relative = values > _RANK * values[0], relative_size(space, x)[live]
    spreads, axes = np.linalg.eigh(root[:, kept] @ root[:, kept].T / relative[:, None] / relative)
    wide, free = spreads > _OPEN**2, root[:, ~kept] / relative[:, None]
    open_axes = np.hstack([axes[:, wide], free / np.linalg.norm(free, axis=0)])
    full, every = back @ root[:, kept], back @ root
    full = full @ full.T if inside is None else inside[np.ix_(at, at)]
    joint[np.ix_(at, at)] = full if kept.all() else every @ every.T
    touched = _touched(open_axes, spreads[wide], (np.asarray(space.coordinates.kinds) == BOTH)[live])
    reaching = ~touched & (_REACH * np.sqrt(np.diag(full)) > _room(problem, x)[live])
    touched |= reaching
    nonlinear = ~space.linear[live]
    if 2 * np.count_nonzero(nonlinear & ~touched) < np.count_nonzero(~space.linear):
        touched |= (
            nonlinear  # other values of the many that are not known may change these as well, far from the estimate
        )
    covariance[np.ix_(at, at)] = np.where(touched | touched[:, None], np.nan, full)
    determined[at] = ~touched
    names = [space.names[k] for k in at]
    return {
        "covariance": covariance,
        "joint": joint,
        "determined": determined,
        "directions": tuple(describe(axis, names) for axis in open_axes.T),
        "reaching": tuple(names[k] for k in np.flatnonzero(reaching)),
        "rank": len(names) - open_axes.shape[1],
        "condition": float(values[0] / values[-1]) if kept.all() else None,
    }


def _spectrum(
    information: _Information, live: np.ndarray, offsets: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """SVD of the root of the information about live parameters, centered and with columns of unit length.

    Neither the unit of a parameter nor the place of zero in input and output may decide what the data determine.

    Returns:
        Singular values, falling, (k,); directions with their standard deviations as lengths, (k, k), where those of tiny values are
        large but finite; and the matrix that takes them to parameters, (k, k).
    """
    rows = information.root[:, live]
    if information.ridge.any():
        rows = np.vstack([rows, np.diag(np.sqrt(information.ridge[live]))])
    if rows.shape[0] > rows.shape[1]:
        rows = np.linalg.qr(rows, mode="r")
    rows, back = _centered(rows, offsets)
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1.0
    _, values, vectors = np.linalg.svd(rows / size, full_matrices=True)
    values = np.pad(values, (0, len(vectors) - values.size))
    root = np.sqrt(information.variance) * vectors.T / np.maximum(values, _RANK * values[0]) / size[:, None]
    return values, root, back


def _touched(open_axes: np.ndarray, spreads: np.ndarray, two_sided: np.ndarray) -> np.ndarray:
    """Parameters with a large component in an undetermined direction, shape (k,), bool.

    A direction among parameters with two bounds is limited by these: there the standard error that it adds decides.

    Args:
        open_axes: the directions in relative coordinates, as columns, (k, m).
        spreads: variances along the first of them, shape (n,); those along the others are not known.
        two_sided: parameters with two bounds, shape (k,), bool.
    """
    limited = np.array([two_sided[_main(axis)].all() for axis in open_axes.T], bool)
    limited[spreads.size :] = False
    moved = np.abs(open_axes[:, limited]) * np.sqrt(spreads[limited[: spreads.size]])
    largest = lambda components: components.max(axis=1, initial=0.0)
    return (largest(np.abs(open_axes[:, ~limited])) > _TOUCHED) | (largest(moved) > _MOVED)


class _NearBounds(NamedTuple):
    """A linear model with bounds and a ridge about an estimate, on centered columns of unit length.

    A ridge that was chosen for its predictions can be far stronger than what is known about the weights: as prior information it
    would then say that they are smaller than the estimate of their own size. The share of it that counts is the one of largest
    evidence, one for each array of weights: number of determined weights over their power (MacKay 1992, Bayesian
    interpolation, eq. 21), at most 1. The rest of the ridge is a known error of the estimate.

    Attributes:
        x: estimate, shape (k,).
        normal: information of independent noise, which decides where the unconstrained optimum is, shape (k, k).
        ridge: added to it, diagonal, shape (k,).
        slope: of the cost without the ridge, shape (k,).
        known: information about the parameters, shape (k, k).
        prior: what the ridge adds to it, diagonal, shape (k,).
        room: distances to the bounds, infinite without one, shape (k,).
        sides: 1 for a lower bound, -1 for an upper bound, shape (k,).
        back: takes these parameters to physical ones, shape (k, k).
    """

    x: np.ndarray
    normal: np.ndarray
    ridge: np.ndarray
    slope: np.ndarray
    known: np.ndarray
    prior: np.ndarray
    room: np.ndarray
    sides: np.ndarray
    back: np.ndarray

    @classmethod
    def of(
        cls,
        problem: Problem,
        x: np.ndarray,
        rows: np.ndarray,
        information: _Information,
        slope: Callable[[], np.ndarray],
        ridge: np.ndarray,
        acts: np.ndarray,
    ) -> _NearBounds | None:
        """None where there is neither a bound nearby nor a ridge, or too many bounds are near.

        Args:
            problem: what was fitted.
            x: where it ended, physical, shape (p,).
            rows: Jacobian of what was minimized, or its triangular factor, shape (n, p).
            information: about the parameters.
            slope: of the cost without the ridge at the estimate, shape (p,), computed when it is needed.
            ridge: added to the normal matrix of the cost, shape (p,).
            acts: parameters with influence, shape (p,), bool.
        """
        space = problem.space
        below, above = _rooms(problem, x)
        room = np.where(space.linear, np.minimum(below, above), np.inf)
        room = np.where(problem.on_bound(x), 0.0, room)[acts]
        near = np.isfinite(room).sum()
        if near > FEW or not (near or ridge.any()):
            return None
        centered, back = _centered(rows[:, acts], space.offsets[acts])
        size = np.linalg.norm(centered, axis=0)
        back, unit = back / size, centered / size
        root = information.root[:, acts] @ back
        return cls(
            x[acts] * size,
            unit.T @ unit,
            ridge[acts] / size**2,
            slope()[acts] / size,
            root.T @ root / information.variance,
            information.ridge[acts] / size**2 / information.variance,
            room * size,
            np.where(below < above, 1.0, -1.0)[acts],
            back,
        )

    def deviation(self, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and second moments of the deviation from the estimate (`active_bounds`), with some share of the ridge known."""
        # The estimate is off the unconstrained one by normal^-1 slope, whatever the noise.
        normal, slope = self.normal + np.diag(share * self.ridge), self.slope + share * self.ridge * self.x
        known = self.known + np.diag(share * self.prior)
        away = np.linalg.pinv(normal, rcond=1e-14, hermitian=True) @ slope
        return about_estimate(known, known @ away, self.room, self.sides)

    def share(self, array: np.ndarray) -> np.ndarray:
        """Share of the ridge of largest evidence, shape (k,); `array` has the number of the array of each parameter."""
        share, held = np.ones(self.x.size), self.prior > 0
        for _ in range(_ROUNDS if held.any() else 0):
            mean, moments = self.deviation(share)
            power = self.prior * (self.x + mean) ** 2
            determined = held - share * self.prior * (np.diag(moments) - mean**2)
            number, size = (np.bincount(array, part) for part in (determined, power))
            before, share = share, np.clip(number / np.maximum(size, 1e-300), 0.0, 1.0)[array]
            if np.all(np.abs(share - before) <= _SETTLED * share):
                break
        return share

    def moments(self, share: np.ndarray, acts: np.ndarray) -> np.ndarray:
        """Second moments about the estimate in physical units, shape (p, p); zero for parameters without influence."""
        moments = self.back @ self.deviation(share[acts])[1] @ self.back.T
        inside = np.zeros((acts.size, acts.size))
        inside[np.ix_(acts, acts)] = 0.5 * (moments + moments.T)  # a saved fit keeps one half
        return inside


def _centered(J: np.ndarray, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns less what the offsets of records explain of them, and the matrix that takes errors of the new parameters to the old ones.

    Args:
        J: derivatives, shape (n, p).
        offsets: which columns belong to offsets, shape (p,), bool; they stay, as do columns that they explain altogether.
    """
    back = np.eye(J.shape[1])
    if not offsets.any():
        return J, back
    explained = np.linalg.lstsq(J[:, offsets], J[:, ~offsets], rcond=None)[0]
    rest = J[:, ~offsets] - J[:, offsets] @ explained
    explained[:, np.linalg.norm(rest, axis=0) <= _REST * np.linalg.norm(J[:, ~offsets], axis=0)] = 0.0
    centered = J.copy()
    centered[:, ~offsets] -= J[:, offsets] @ explained
    back[np.ix_(offsets, ~offsets)] = -explained
    return centered, back


def _centered_sizes(linear: Linearization, offsets: np.ndarray) -> np.ndarray:
    """Length of every column of `_centered` derivatives, shape (p,), in two passes over their blocks."""
    at = np.flatnonzero(offsets)
    cross, squares = np.zeros((at.size, linear.size)), np.zeros(linear.size)
    for rows in linear.blocks():
        mine = rows[:, at].any(axis=0)
        cross[mine] += rows[:, at[mine]].T @ rows
        squares += np.einsum("np,np->p", rows, rows)
    whole = np.sqrt(squares)
    if not at.size:
        return whole
    explained = np.linalg.lstsq(cross[:, at], cross, rcond=None)[0]
    explained[:, at], squares[:] = 0.0, 0.0
    for rows in linear.blocks():
        mine = rows[:, at].any(axis=0)
        rest = rows - rows[:, at[mine]] @ explained[mine]
        squares += np.einsum("np,np->p", rest, rest)
    size = np.sqrt(squares)
    return np.where(size <= _REST * whole, whole, size)


def error_ratios(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Standard errors of a least-squares fit under the noise in its residuals, over those for independent noise.

    Args:
        problem: what was fitted.
        x: where the fit ended, physical, shape (p,).

    Returns:
        Shape (p,).
    """
    residuals = analyze(problem, x)
    ratios = np.full(x.size, np.sqrt(residuals.correlation_time))
    if residuals.of_errors is None:
        return ratios
    live = ~problem.on_bound(x)
    used = problem.used.reshape(-1)
    jacobian = problem.with_loss("linear").linearize_misfit(x)[1]
    J = jacobian[used][:, live] * relative_size(problem.space, x)[live]
    root = least_squares_root(residuals.of_errors, J * problem.scales.y)
    plain = float(np.sum(residuals.residual**2)) / max(int(used.sum()) - int(live.sum()), 1) / problem.scales.y**2
    ratios[live] = np.exp(_log_ratios(root, J, plain))
    return np.where(np.isfinite(ratios), ratios, np.sqrt(residuals.correlation_time))


def _ratio(root: np.ndarray, J: np.ndarray, variance: float) -> float:
    """Geometric mean of standard errors under a noise model over those for independent noise; 1 where neither is finite."""
    logs = _log_ratios(root, J, variance)
    logs = logs[np.isfinite(logs)]
    return float(np.exp(logs.mean())) if logs.size else 1.0


def _log_ratios(root: np.ndarray, J: np.ndarray, variance: float) -> np.ndarray:
    with np.errstate(all="ignore"):
        errors = [np.sum(np.linalg.pinv(np.linalg.qr(A, mode="r"), rcond=_RANK) ** 2, axis=1) for A in (root, J)]
        return 0.5 * np.log(errors[0] / (errors[1] * variance))


def _room(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Distance of each parameter to its nearest bound; infinite without one, and for linear weights, which may well be zero."""
    return np.where(problem.space.linear, np.inf, np.minimum(*_rooms(problem, x)))


def _rooms(problem: Problem, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances of each parameter to its lower and its upper bound."""
    c = problem.space.coordinates
    return x - np.asarray(c.lower), np.asarray(c.upper) - x


def describe(direction: np.ndarray, names: list[str]) -> str:
    """The parameters that trade against each other along a direction, with their relative components."""
    main = _main(direction)[:6]
    if len(main) == 1:
        return names[main[0]]
    lead = np.sign(direction[main[0]])
    return ", ".join(f"{names[k]} ({lead * direction[k]:+.2f})" for k in main)


def _main(direction: np.ndarray) -> list[int]:
    """The parameters with large components, largest first."""
    order = np.argsort(-np.abs(direction))
    return [int(k) for k in order if abs(direction[k]) > _PART * abs(direction[order[0]])]
