"""What the data determine: covariance from the singular values of the Jacobian, and the directions that they leave open."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.fitting.estimate import Estimate
from hystfit.fitting.smooth_weights import responses
from hystfit.inference.noise.serial import least_squares_root
from hystfit.inference.problem import Objective, Problem
from hystfit.inference.residuals import Leftover
from hystfit.params.coordinates import BOTH, REAL

_OPEN = 1.0  # a direction is undetermined when its standard error moves parameters by their own size
_REACH = 1.96  # standard errors within which a bound makes an error bar, which is symmetric, meaningless
_RANK = 1e-7  # or when its singular value is below this part of the largest: rounding decides then, not data
_TOUCHED = 0.05  # component in an undetermined direction from which a parameter has no error bar
_PART = 0.25  # components of a direction that its description names
_FEW = (
    60  # parameters up to which errors take the noise's covariance; those of more weights grow by its correlation time
)


@dataclasses.dataclass(frozen=True)
class Uncertainty:
    """Errors of a fit.

    Attributes:
        covariance: of the free parameters in physical units, shape (p, p); NaN where it means nothing.
        determined: whether the data determine each parameter, shape (p,), bool.
        inactive: parameters without any influence on these data, shape (p,), bool.
        directions: each combination that the data leave open, in words.
        rank: number of directions determined.
        condition: largest over smallest singular value in relative coordinates; None where it is infinite.
        correlation_time: integrated autocorrelation time of the residuals, samples; 1 for white ones.
        ratio: errors over those for independent residuals (geometric mean over the parameters).
        sigma: standard deviation of the residuals, output units.
        left: what the fit leaves.
    """

    covariance: np.ndarray
    determined: np.ndarray
    inactive: np.ndarray
    directions: tuple[str, ...]
    rank: int
    condition: float | None
    correlation_time: float
    ratio: float
    sigma: float
    left: Leftover


@eqx.filter_jit
def _linearize(objective: Objective, x: Array) -> tuple[Array, Array]:
    return objective.misfit(x), jax.jacfwd(objective.misfit)(x)


@eqx.filter_jit
def _misfit(objective: Objective, x: Array) -> Array:
    return objective.misfit(x)


def _residual_and_jacobian(problem: Problem, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (R T,) and their derivatives (R T, p); hundreds of relays have theirs from distinct states, not a scan for each."""
    if problem.model.estimator == "preisach" and problem.objective.loss == "linear":
        weight = np.sqrt(np.asarray(problem.objective.batch.weight)).reshape(-1, 1) / problem.scales.y
        return np.asarray(_misfit(problem.objective, jnp.asarray(x))), weight * responses(problem, x)
    residual, jacobian = _linearize(problem.objective, jnp.asarray(x))
    return np.asarray(residual), np.asarray(jacobian)


def uncertainty(
    problem: Problem, estimate: Estimate, *, honest: bool = True, root: np.ndarray | None = None
) -> Uncertainty:
    """Covariance at an estimate, to first order.

    Residuals that are correlated in time carry less information than their number: with `honest` the covariance of a least-squares
    estimate is taken under slow and independent noise with their statistics (`inference.noise.serial`). That of hundreds of weights, or
    where such noise would have to be far larger than the residuals, grows by their integrated autocorrelation time. Parameters on a
    bound and directions that the data leave open get no finite error.

    Args:
        problem: what was fitted.
        estimate: where it ended.
        honest: allow for correlated residuals.
        root: square root R of the information R'R about x that a noise model leaves, shape (p, p); it then decides.
    """
    space, x = problem.space, estimate.x
    residual, jacobian = _residual_and_jacobian(problem, x)
    used = np.asarray(problem.objective.batch.weight).reshape(-1) > 0
    relative = _relative_size(problem, x)
    at_bound = np.array([side is not None for side in near_bound(problem, x)])
    J = jacobian[used] * relative
    gain = np.linalg.norm(J, axis=0)
    inactive = (gain <= 1e-9 * max(gain.max(initial=0.0), 1e-300)) & ~at_bound
    live = ~at_bound & ~inactive
    y = problem.scales.y
    few = int(live.sum()) <= _FEW
    left = Leftover.of(problem.objective.batch, residual * y, (jacobian * relative)[:, live] if few else None)
    time = left.correlation_time if honest or root is not None else 1.0
    freedom = max(int(used.sum()) - int(live.sum()), 1)
    plain = float(np.sum(residual**2)) / freedom
    variance, ratio, unit = plain * time, float(np.sqrt(time)), 1.0
    if root is None and honest and left.correlated and few and live.any() and left.noise is not None:
        root = np.zeros((int(live.sum()), x.size))
        # Noise that pushed a parameter to its bound might as well have left it inside: the errors of the others allow for that.
        pushed = at_bound & (gain > 1e-9 * gain.max()) & ~np.array([info.linear for info in space.infos])
        order = np.concatenate([np.flatnonzero(pushed), np.flatnonzero(live)])
        triangle = np.linalg.qr(least_squares_root(left.noise, J[:, order] * y), mode="r")
        root[:, live] = triangle[pushed.sum() :, pushed.sum() :] / relative[live]
    if root is not None:
        ratio = _ratio(root[:, live] * relative[live], J[:, live], plain)
        J, variance, unit = root * relative, 1.0, 1 / plain
    covariance = np.full((x.size, x.size), np.nan)
    determined = live.copy()
    directions: list[str] = []
    rank, condition = 0, None
    if live.any():
        ridge = None if estimate.penalty is None else (unit * estimate.penalty * relative**2)[live]
        values, vectors = _spectrum(J[:, live], ridge)
        names = [name for name, on in zip(space.names, live, strict=True) if on]
        floor = _RANK * values[0]
        open_ = (values < floor) | (np.sqrt(variance) > _OPEN * values)
        rank = int(np.sum(~open_))
        condition = float(values[0] / values[-1]) if values[-1] > floor else None
        directions = [describe(vectors[:, k], names) for k in np.flatnonzero(open_)]
        kept = values > floor
        inner = (vectors[:, kept] / values[kept] ** 2) @ vectors[:, kept].T * variance
        touched = (np.abs(vectors[:, open_]) > _TOUCHED).any(axis=1)
        scale = relative[live]
        full = inner * scale[:, None] * scale[None, :]
        reaching = ~touched & (_REACH * np.sqrt(np.diag(full)) > _room(problem, x)[live])
        directions += [f"{names[k]} alone, whose 95 % interval reaches its bound" for k in np.flatnonzero(reaching)]
        touched |= reaching
        full[touched] = np.nan
        full[:, touched] = np.nan
        at = np.flatnonzero(live)
        covariance[np.ix_(at, at)] = full
        determined[at[touched]] = False
    return Uncertainty(
        covariance,
        determined,
        inactive,
        tuple(directions),
        rank,
        condition,
        time,
        ratio,
        float(np.sqrt(plain)) * y,
        left,
    )


def leftover(problem: Problem, x: np.ndarray) -> Leftover:
    """What is left of the data at physical x."""
    residual, jacobian = _residual_and_jacobian(problem, x)
    live = np.array([side is None for side in near_bound(problem, x)])
    few = live.any() and int(live.sum()) <= _FEW
    columns = jacobian[:, live] * _relative_size(problem, x)[live] if few else None
    return Leftover.of(problem.objective.batch, residual * problem.scales.y, columns)


def error_ratios(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Standard errors of a least-squares fit under the noise that it leaves, over those for independent noise, shape (p,)."""
    left = leftover(problem, x)
    ratios = np.full(x.size, np.sqrt(left.correlation_time))
    if not left.correlated or not left.basis.shape[1] or left.noise is None:
        return ratios
    live = np.array([side is None for side in near_bound(problem, x)])
    used = left.samples.on.reshape(-1)
    J = _residual_and_jacobian(problem, x)[1][used][:, live] * _relative_size(problem, x)[live]
    root = least_squares_root(left.noise, J * problem.scales.y)
    plain = float(np.sum(left.residual**2)) / max(int(used.sum()) - int(live.sum()), 1) / problem.scales.y**2
    ratios[live] = np.exp(_log_ratios(root, J, plain))
    return np.where(np.isfinite(ratios), ratios, np.sqrt(left.correlation_time))


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


def _relative_size(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Size in which each parameter's error is judged: its distance to the bounds, or its natural scale where it has none."""
    c = problem.space.coordinates
    lower, upper, scale, kind = (np.asarray(v) for v in (c.lower, c.upper, c.scale, c.kinds))
    with np.errstate(invalid="ignore"):
        both = (x - lower) * (upper - x) / (upper - lower)
        one = np.where(np.isfinite(lower), x - lower, upper - x)
    natural = np.maximum(scale, np.abs(x))
    weight = np.array([info.linear for info in problem.space.infos])
    # A weight that is nearly zero is determined when its error is small beside its scale, not beside itself.
    one = np.where(weight, np.maximum(one, scale), one)
    return np.where(kind == REAL, natural, np.where(kind == BOTH, both, one))


def _room(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Distance of each parameter to its nearest bound; infinite without one, and for linear weights, which may well be zero."""
    c = problem.space.coordinates
    room = np.minimum(x - np.asarray(c.lower), np.asarray(c.upper) - x)
    return np.where([info.linear for info in problem.space.infos], np.inf, room)


def near_bound(problem: Problem, x: np.ndarray, tolerance: float = 1e-4) -> list[str | None]:
    """ "lower" or "upper" for each parameter that ran into a bound, None for the others.

    With one bound the distance is measured in the parameter's scale, with two in the width between them.
    """
    c = problem.space.coordinates
    lower, upper, scale = (np.asarray(v) for v in (c.lower, c.upper, c.scale))
    width = np.where(np.asarray(c.kinds) == BOTH, upper - lower, scale)
    low, high = x - lower < tolerance * width, upper - x < tolerance * width
    return ["lower" if a else "upper" if b else None for a, b in zip(low, high, strict=True)]


def describe(direction: np.ndarray, names: list[str]) -> str:
    """A direction in words: which parameters trade against which."""
    order = np.argsort(-np.abs(direction))
    main = [k for k in order if abs(direction[k]) > _PART * abs(direction[order[0]])][:6]
    if len(main) == 1:
        return f"{names[main[0]]} alone"
    lead = np.sign(direction[main[0]])
    terms = [f"{names[k]} ({lead * direction[k]:+.2f})" for k in main]
    return "the combination " + ", ".join(terms) + " in relative units"
