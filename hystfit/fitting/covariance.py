"""What the data determine: covariance by SVD of the Jacobian, and the parameters that the data cannot separate."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from hystfit.fitting.active_bounds import about_estimate
from hystfit.fitting.estimate import Estimate
from hystfit.inference.blocks import chosen
from hystfit.inference.noise.slow_likelihood import least_squares_root
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import FEW, ResidualAnalysis, analyze
from hystfit.inference.triangle import triangle
from hystfit.params.coordinates import BOTH
from hystfit.params.space import relative_size

_OPEN = 1.0  # a direction is undetermined when its standard error moves parameters by their own size
_REACH = 1.96  # standard errors within which a bound makes a symmetric error bar meaningless
_RANK = 1e-7  # or when its singular value, of columns of unit length, is below this fraction of the largest: rounding errors dominate
_REST = 1e-11  # part of a column that an offset does not explain, below which it is rounding errors
_TOUCHED = 0.05  # component in an undetermined direction above which a parameter has no error bar;
_MOVED = 0.5  # where two bounds limit the direction: standard error that it adds, over the parameter's size, above which it has none
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
    space, x = problem.space, estimate.x
    residual, jacobian = problem.linearize_misfit(x)
    used = problem.used.reshape(-1)
    relative = relative_size(problem.space, x)
    sides = np.array([{None: 0.0, "lower": 1.0, "upper": -1.0}[side] for side in problem.at_bound(x)])
    at_bound = sides != 0
    # The triangular factor is all that errors under independent noise need; of hundreds of weights few are live.
    rows = triangle(jacobian) if x.size <= FEW else jacobian[used]
    natural = np.minimum(relative, np.asarray(space.coordinates.scale))
    gain = np.linalg.norm(_centered(rows, space.offsets)[0] * natural, axis=0)
    inactive = (gain <= 1e-9 * max(gain.max(initial=0.0), 1e-300)) & ~at_bound
    live = ~at_bound & ~inactive
    y = problem.scales.y
    few = int(live.sum()) <= FEW
    columns = lambda: (chosen(jacobian, used) * relative)[:, live]
    analysis = ResidualAnalysis.of(problem.setting, residual * y, columns if few else None)
    time = analysis.correlation_time if correlated or root is not None else 1.0
    freedom = max(int(used.sum()) - int(live.sum()), 1)
    plain = float(np.sum(residual**2)) / freedom
    variance, ratio, unit = plain * time, float(np.sqrt(time)), 1.0
    pushed = at_bound & (gain > 1e-9 * gain.max(initial=0.0))
    on, square, sought = live | pushed, rows, root is not None
    slow = analysis.of_errors if correlated and not sought else None
    if slow is not None:
        part = least_squares_root(slow, jacobian[used][:, on] * y, overwrite=True)
        root = np.zeros((len(part), x.size))
        root[:, on] = part
    if root is not None:
        ratio = _ratio(root[:, live] * relative[live], columns(), plain)
        square, variance, unit = root, 1.0, 1 / plain
    ridge = np.zeros(x.size) if estimate.penalty is None else estimate.penalty
    below, above = _rooms(problem, x)
    room = np.where(pushed, 0.0, np.where([info.linear for info in space.infos], np.minimum(below, above), np.inf))
    inside = None
    if live.any() and plain > 0 and 0 < np.isfinite(room[on]).sum() <= FEW:
        # At the most probable point under a noise model the slope is not known.
        slope = np.where(pushed, 0.0 if sought else (residual @ jacobian + ridge * x) / plain, 0.0)
        information = (square[:, on], variance, unit * ridge[on])
        bounds = (room[on], np.where(below < above, 1.0, -1.0)[on])
        inside = np.zeros((x.size, x.size))
        inside[np.ix_(on, on)] = _inside(
            rows[:, on], ridge[on], plain, information, slope[on], bounds, space.offsets[on]
        )
    inner = _determined(problem, x, square, variance, live, None if estimate.penalty is None else unit * ridge, inside)
    inner["joint"][at_bound], inner["joint"][:, at_bound] = 0.0, 0.0
    return Uncertainty(
        **inner,
        inactive=inactive,
        correlation_time=time,
        ratio=ratio,
        sigma=float(np.sqrt(plain)) * y,
        residuals=analysis,
    )


def _determined(
    problem: Problem,
    x: np.ndarray,
    J: np.ndarray,
    variance: float,
    live: np.ndarray,
    ridge: np.ndarray | None,
    inside: np.ndarray | None,
) -> dict[str, Any]:
    """Covariance, and which parameters and directions the data determine, from an SVD.

    The rank is that of the Jacobian centered and scaled to columns of unit length: neither the unit of a parameter nor the place of
    zero in input and output may decide what the data determine.

    Args:
        problem: what was fitted.
        x: where it ended, physical, shape (p,).
        J: Jacobian, or the square root of the information, shape (n, p).
        variance: of its rows.
        live: parameters on no bound and with influence, shape (p,), bool.
        ridge: what regularization adds to the normal matrix of x, diagonal, shape (p,).
        inside: the covariance where bounds are near, shape (p, p); None where none is.
    """
    covariance, determined = np.full((x.size, x.size), np.nan), live.copy()
    if not live.any():
        return {
            "covariance": covariance, "joint": covariance.copy(), "determined": determined, "directions": (), "reaching": (), "rank": 0,
            "condition": None,
        }  # fmt: skip
    names = [name for name, on in zip(problem.space.names, live, strict=True) if on]
    relative = relative_size(problem.space, x)[live]
    rows = J[:, live] if ridge is None else np.vstack([J[:, live], np.diag(np.sqrt(ridge[live]))])
    rows, back = _centered(
        rows if rows.shape[0] <= rows.shape[1] else np.linalg.qr(rows, mode="r"), problem.space.offsets[live]
    )
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1.0
    values, vectors = _spectrum(rows / size)
    kept = values > _RANK * values[0]
    root = np.sqrt(variance) * vectors[:, kept] / values[kept] / size[:, None]
    spreads, axes = np.linalg.eigh(root @ root.T / relative[:, None] / relative)
    free = vectors[:, ~kept] / (size * relative)[:, None]
    wide = spreads > _OPEN**2
    open_axes = np.hstack([axes[:, wide], free / np.linalg.norm(free, axis=0)])
    full = back @ root
    full = full @ full.T if inside is None else inside[np.ix_(live, live)]
    joint, at = np.full_like(covariance, np.nan), np.flatnonzero(live)
    joint[np.ix_(at, at)] = full
    if not kept.all():  # with large variances in the directions that the data do not determine
        root = back @ (np.sqrt(variance) * vectors / np.maximum(values, _RANK * values[0]) / size[:, None])
        joint[np.ix_(at, at)] = root @ root.T
    two_sided = (np.asarray(problem.space.coordinates.kinds) == BOTH)[live]
    limited = np.array([two_sided[_main(axis)].all() for axis in open_axes.T], bool)
    moved = np.abs(open_axes[:, : wide.sum()]) * np.sqrt(spreads[wide])
    limited[wide.sum() :] = False
    touched = (np.abs(open_axes[:, ~limited]) > _TOUCHED).any(axis=1)
    touched |= (moved[:, limited[: wide.sum()]] > _MOVED).any(axis=1)
    near = ~touched & (_REACH * np.sqrt(np.diag(full)) > _room(problem, x)[live])
    touched |= near
    nonlinear = ~(np.array([info.linear for info in problem.space.infos], bool) | problem.space.offsets)
    known = np.zeros(x.size, bool)
    known[at] = ~touched
    if 2 * np.count_nonzero(nonlinear & known) < nonlinear.sum():
        touched |= nonlinear[
            live
        ]  # other values of the many that are not known may change these as well, far from the estimate
    full[touched], full[:, touched] = np.nan, np.nan
    covariance[np.ix_(at, at)] = full
    determined[at[touched]] = False
    return {
        "covariance": covariance,
        "joint": joint,
        "determined": determined,
        "directions": tuple(describe(axis, names) for axis in open_axes.T),
        "reaching": tuple(names[k] for k in np.flatnonzero(near)),
        "rank": len(names) - open_axes.shape[1],
        "condition": float(values[0] / values[-1]) if kept.all() else None,
    }


def _inside(
    rows: np.ndarray,
    ridge: np.ndarray,
    plain: float,
    information: tuple[np.ndarray, float, np.ndarray],
    slope: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    offsets: np.ndarray,
) -> np.ndarray:
    """Second moments about an estimate near bounds (`active_bounds`), shape (p, p).

    Args:
        rows: Jacobian of what was minimized, or its triangular factor, shape (n, p).
        ridge: of the same, shape (p,).
        plain: variance of its residuals.
        information: square root of the information (m, p), the variance of its rows, and its ridge (p,).
        slope: of the cost over `plain` at the estimate, shape (p,).
        bounds: distance to the bound, and its side, see `about_estimate`.
        offsets: see `_centered`.
    """
    centered, back = _centered(rows, offsets)
    size = np.linalg.norm(centered, axis=0)
    back = back / size
    normal = (centered / size).T @ (centered / size) / plain + np.diag(ridge / size**2) / plain
    root, variance, prior = information
    root = root @ back
    known = (root.T @ root + np.diag(prior / size**2)) / variance
    # The estimate is off the unconstrained one by normal^-1 slope, whatever the noise.
    away = np.linalg.pinv(normal, rcond=1e-14, hermitian=True) @ (slope / size)
    moments = back @ about_estimate(known, known @ away, bounds[0] * size, bounds[1]) @ back.T
    return 0.5 * (moments + moments.T)  # a saved fit keeps one half


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
    live = np.array([side is None for side in problem.at_bound(x)])
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


def _spectrum(J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Singular values (falling) and right singular vectors as columns."""
    _, values, rows = np.linalg.svd(J, full_matrices=True)
    return np.pad(values, (0, rows.shape[0] - values.size)), rows.T


def _room(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Distance of each parameter to its nearest bound; infinite without one, and for linear weights, which may well be zero."""
    return np.where([info.linear for info in problem.space.infos], np.inf, np.minimum(*_rooms(problem, x)))


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
