"""What the data determine: covariance by SVD of the Jacobian, and the parameters that the data cannot separate."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from hystfit.fitting.estimate import Estimate
from hystfit.inference.noise.slow_likelihood import least_squares_root
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import FEW, ResidualAnalysis, analyze
from hystfit.params.space import relative_size

_OPEN = 1.0  # a direction is undetermined when its standard error moves parameters by their own size
_REACH = 1.96  # standard errors within which a bound makes a symmetric error bar meaningless
_RANK = 1e-7  # or when its singular value is below this fraction of the largest, where rounding dominates
_TOUCHED = 0.05  # component in an undetermined direction above which a parameter has no error bar
_PART = 0.25  # components of a direction that its description includes


@dataclasses.dataclass(frozen=True)
class Uncertainty:
    """Errors of a fit.

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
    Parameters on a bound and directions that the data do not determine have no finite error.

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
    at_bound = np.array([side is not None for side in problem.at_bound(x)])
    J = jacobian[used] * relative
    gain = np.linalg.norm(J, axis=0)
    inactive = (gain <= 1e-9 * max(gain.max(initial=0.0), 1e-300)) & ~at_bound
    live = ~at_bound & ~inactive
    y = problem.scales.y
    few = int(live.sum()) <= FEW
    analysis = ResidualAnalysis.of(problem.setting, residual * y, (jacobian * relative)[:, live] if few else None)
    time = analysis.correlation_time if correlated or root is not None else 1.0
    freedom = max(int(used.sum()) - int(live.sum()), 1)
    plain = float(np.sum(residual**2)) / freedom
    variance, ratio, unit = plain * time, float(np.sqrt(time)), 1.0
    slow = analysis.of_errors if correlated and root is None else None
    if slow is not None:
        root = np.zeros((int(live.sum()), x.size))
        # The noise may have pushed a parameter to its bound: the errors of the others allow for that.
        pushed = at_bound & (gain > 1e-9 * gain.max()) & ~np.array([info.linear for info in space.infos])
        order = np.concatenate([np.flatnonzero(pushed), np.flatnonzero(live)])
        triangle = np.linalg.qr(least_squares_root(slow, J[:, order] * y), mode="r")
        root[:, live] = triangle[pushed.sum() :, pushed.sum() :] / relative[live]
    if root is not None:
        ratio = _ratio(root[:, live] * relative[live], J[:, live], plain)
        J, variance, unit = root * relative, 1.0, 1 / plain
    ridge = None if estimate.penalty is None else unit * estimate.penalty
    inner = _determined(problem, x, J, variance, live, ridge)
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
    problem: Problem, x: np.ndarray, J: np.ndarray, variance: float, live: np.ndarray, ridge: np.ndarray | None
) -> dict[str, Any]:
    """What an SVD shows: covariance, and which parameters and directions the data determine.

    Args:
        problem: what was fitted.
        x: where it ended, physical, shape (p,).
        J: Jacobian in relative coordinates, or the square root of the information, shape (n, p).
        variance: of its rows.
        live: parameters on no bound and with influence, shape (p,), bool.
        ridge: what regularization adds to the normal matrix of x, diagonal, shape (p,).
    """
    relative = relative_size(problem.space, x)
    covariance, determined = np.full((x.size, x.size), np.nan), live.copy()
    if not live.any():
        return {
            "covariance": covariance, "joint": covariance.copy(), "determined": determined, "directions": (), "reaching": (), "rank": 0,
            "condition": None,
        }  # fmt: skip
    names = [name for name, on in zip(problem.space.names, live, strict=True) if on]
    values, vectors = _spectrum(J[:, live], None if ridge is None else (ridge * relative**2)[live])
    floor = _RANK * values[0]
    undetermined, kept = (values < floor) | (np.sqrt(variance) > _OPEN * values), values > floor
    scale = relative[live]
    root = vectors / np.maximum(values, floor) * np.sqrt(variance) * scale[:, None]
    full = root[:, kept] @ root[:, kept].T
    joint, at = np.full_like(covariance, np.nan), np.flatnonzero(live)
    joint[np.ix_(at, at)] = full if kept.all() else root @ root.T
    touched = (np.abs(vectors[:, undetermined]) > _TOUCHED).any(axis=1)
    near = ~touched & (_REACH * np.sqrt(np.diag(full)) > _room(problem, x)[live])
    touched |= near
    full[touched], full[:, touched] = np.nan, np.nan
    covariance[np.ix_(at, at)] = full
    determined[at[touched]] = False
    return {
        "covariance": covariance,
        "joint": joint,
        "determined": determined,
        "directions": tuple(describe(vectors[:, k], names) for k in np.flatnonzero(undetermined)),
        "reaching": tuple(names[k] for k in np.flatnonzero(near)),
        "rank": int(np.sum(~undetermined)),
        "condition": float(values[0] / values[-1]) if values[-1] > floor else None,
    }


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
        errors = [np.sum(np.linalg.pinv(np.linalg.qr(A, mode="r")) ** 2, axis=1) for A in (root, J)]
        return 0.5 * np.log(errors[0] / (errors[1] * variance))


def _spectrum(J: np.ndarray, ridge: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Singular values (falling) and right singular vectors as columns; a ridge counts as further rows."""
    if ridge is not None:
        J = np.vstack([J, np.diag(np.sqrt(ridge))])
    if J.shape[0] > J.shape[1]:
        J = np.asarray(np.linalg.qr(J, mode="r"))
    _, values, rows = np.linalg.svd(J, full_matrices=True)
    return np.pad(values, (0, rows.shape[0] - values.size)), rows.T


def _room(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Distance of each parameter to its nearest bound; infinite without one, and for linear weights, which may well be zero."""
    c = problem.space.coordinates
    room = np.minimum(x - np.asarray(c.lower), np.asarray(c.upper) - x)
    return np.where([info.linear for info in problem.space.infos], np.inf, room)


def describe(direction: np.ndarray, names: list[str]) -> str:
    """The parameters that trade against each other along a direction, with their relative components."""
    order = np.argsort(-np.abs(direction))
    main = [k for k in order if abs(direction[k]) > _PART * abs(direction[order[0]])][:6]
    if len(main) == 1:
        return names[main[0]]
    lead = np.sign(direction[main[0]])
    return ", ".join(f"{names[k]} ({lead * direction[k]:+.2f})" for k in main)
