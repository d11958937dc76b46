"""What the data determine: covariance by SVD of the Jacobian, and the parameters that the data cannot separate."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy  # loads its subpackages when they are first used
from jaxtyping import Float
from scipy.linalg.lapack import dtrtri

from hystfit.fitting.judgment.near_bounds import (
    Information,
    NearBounds,
    centered,
    centered_lengths,
    distances_to_bounds,
    shared,
)
from hystfit.fitting.solvers.estimate import Estimate
from hystfit.inference.blocks import gram_root, parts, triangle
from hystfit.inference.linearization import Linearization
from hystfit.inference.noise.slow_likelihood import SlowNoiseFit, least_squares_root
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import FEW, ResidualAnalysis, analyze
from hystfit.models.shared.cholesky import cholesky
from hystfit.params.coordinates import BOTH
from hystfit.params.relative_size import OPEN, REACH, relative_size
from hystfit.params.space import ParameterSpace

RANK = 1e-7  # singular value, relative to the largest of columns of unit length, below which rounding errors dominate


def error_ratios(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Standard errors of a least-squares fit at x under the noise in its residuals, over those for independent noise, shape (p,)."""
    residuals = analyze(problem, x)
    ratios = np.full(x.size, np.sqrt(residuals.correlation_time))
    if residuals.of_errors is None or residuals.derivatives is None:
        return ratios
    live = ~problem.on_bound(x)
    J = residuals.derivatives() * problem.scales.y
    plain = float(np.sum(residuals.residual**2)) / max(len(J) - J.shape[1], 1)
    independent = triangle((J[part] for part in parts(*J.shape)), J.shape[1])
    root = least_squares_root(residuals.of_errors, J, overwrite=True)
    ratios[live] = np.exp(_log_ratios(root, independent, plain))
    return np.where(np.isfinite(ratios), ratios, np.sqrt(residuals.correlation_time))


def mean_error_ratio(root: np.ndarray, J: np.ndarray, variance: float) -> float:
    """Geometric mean of standard errors under a noise model over those for independent noise; 1 where neither is finite."""
    logs = _log_ratios(root, J, variance)
    logs = logs[np.isfinite(logs)]
    return float(np.exp(logs.mean())) if logs.size else 1.0


def _log_ratios(root: np.ndarray, J: np.ndarray, variance: float) -> np.ndarray:
    with np.errstate(all="ignore"):
        errors = [np.sum(np.linalg.pinv(A, rcond=RANK) ** 2, axis=1) for A in (root, J)]
        return 0.5 * np.log(errors[0] / (errors[1] * variance))


_TOUCHED = 0.05  # component in an undetermined direction above which a parameter has no error bar
_MOVED = 0.5  # the same for a direction limited by two bounds: standard error that it adds, over the parameter's size


@dataclasses.dataclass(frozen=True)
class Uncertainty:
    """Covariance and standard errors of a fit."""

    covariance: np.ndarray  # of the free parameters in physical units, shape (p, p); NaN where it is undefined
    # the same including undetermined parameters, whose variances are large; 0 for parameters fixed at a bound, NaN for inactive ones
    joint: np.ndarray
    determined: np.ndarray  # whether the data determine each parameter, shape (p,), bool
    inactive: np.ndarray  # parameters without any influence on these data, shape (p,), bool
    directions: tuple[str, ...]  # parameters that the data cannot separate, a text for each such direction
    reaching: tuple[str, ...]  # parameters whose 95 % interval reaches a bound
    rank: int  # number of directions determined
    condition: float | None  # largest over smallest singular value in relative coordinates; None where it is infinite
    correlation_time: float  # integrated autocorrelation time of the residuals, samples; 1 for white ones
    ratio: float  # standard errors over those for i.i.d. residuals (geometric mean over the parameters)
    sigma: float  # standard deviation of the residuals, output units
    residuals: ResidualAnalysis  # their analysis

    @classmethod
    def unknown(cls, problem: Problem, estimate: Estimate) -> Uncertainty:
        """Placeholder for a fit without standard errors, such as a candidate in a comparison."""
        p, known = estimate.x.size, estimate.linearized
        residual = problem.misfit(estimate.x) if known is None else known.misfit
        nothing, never = np.full((p, p), np.nan), np.zeros(p, dtype=bool)
        plain = float(np.sum(residual**2)) / estimate.freedom(np.count_nonzero(problem.used), p)
        analysis = ResidualAnalysis.of_misfit(problem, residual, None)
        sigma = float(np.sqrt(plain)) * problem.scales.y
        return cls(nothing, nothing, never, never, (), (), 0, None, analysis.correlation_time, 1.0, sigma, analysis)


def uncertainty(
    problem: Problem, estimate: Estimate, *, correlated: bool = True, root: np.ndarray | None = None
) -> Uncertainty:
    """Covariance at an estimate, to first order.

    With `correlated`, the covariance is that of least squares under slow and independent noise estimated from the residuals
    (`inference.noise.slow_likelihood`). For hundreds of weights, or if this noise would be far larger than the residuals, the covariance is
    multiplied by their integrated autocorrelation time instead. Parameters at a bound and undetermined directions have no finite error. The
    errors of the others treat the bounds as prior information if at most 60 parameters are near theirs (`near_bounds`); otherwise
    parameters at a bound are fixed there. The root R of the information R'R about x under a noise model, shape (p, p), is used instead
    where it is given.
    """
    x, y = estimate.x, problem.scales.y
    penalty = np.zeros((x.size, x.size)) if estimate.penalty is None else estimate.penalty
    linear = problem.linearization(x) if estimate.linearized is None else estimate.linearized
    at_bound = problem.on_bound(x)
    residual, relative = linear.misfit, relative_size(problem.space, x)
    rows, acts = _factor(problem, x, linear, at_bound)
    live = acts & ~at_bound
    live_columns = lambda: linear.columns(live) * relative[live]
    analysis = ResidualAnalysis.of_misfit(problem, residual, live_columns if live.sum() <= FEW else None)
    plain = float(np.sum(residual**2)) / estimate.freedom(np.count_nonzero(linear.used), np.count_nonzero(live))
    refined = root is not None
    if correlated and not refined and analysis.of_errors is not None:
        root = _correlated_root(analysis.of_errors, linear, acts, y)
    time = analysis.correlation_time if correlated or refined else 1.0
    if root is None:
        ratio, information = float(np.sqrt(time)), Information(rows, plain * time, penalty)
    else:
        ratio = mean_error_ratio(root[:, live] * relative[live], rows[:, live] * relative[live], plain)
        information = Information(root, 1.0, penalty / plain)
    inside = None
    if live.any() and plain > 0:
        # At the most probable point under a noise model the slope is not known.
        on_bound = at_bound & (not refined)
        slope = lambda: np.where(on_bound, linear.gradient() + penalty @ x if on_bound.any() else 0.0, 0.0)
        space = problem.space
        near = NearBounds.of(
            space, x[None], at_bound[None], rows, information, lambda: slope()[None], penalty[None], acts
        )
        if near is not None:
            shrunk = estimate.toward_zero and not refined
            share = ridge_shares(near, space.names, acts) if shrunk else np.ones((1, x.size))
            (inside,) = near.moments(share, acts)
            information = information._replace(penalty=shared(information.penalty, share[0]))
    determined = determine(problem.space, x, relative, information, live, inside)
    if inside is not None and determined["condition"] is not None:
        # Weights at a bound and the others compensate each other in the output: keep their covariance.
        determined["joint"] = np.where(acts & acts[:, None], inside, np.nan)
    else:
        determined["joint"][at_bound], determined["joint"][:, at_bound] = 0.0, 0.0
    stepped = _add_step_errors(problem, x, determined)
    return Uncertainty(
        **determined,
        inactive=~acts & ~at_bound & ~stepped,
        correlation_time=time,
        ratio=ratio,
        sigma=float(np.sqrt(plain)) * y,
        residuals=analysis,
    )


def _add_step_errors(problem: Problem, x: np.ndarray, found: dict[str, Any]) -> np.ndarray:
    """Add what the model says of parameters in which the output is piecewise constant to `determine`; which are known, shape (p,), bool.

    They are independent of the others: between two samples they change no output.
    """
    space = problem.space
    if not any(info.stepwise for info in space.infos):
        return np.zeros(x.size, bool)
    errors = space.vector(space.assembled(x).step_errors(list(problem.data)))
    known = np.isfinite(errors)
    for matrix in (found["covariance"], found["joint"]):
        matrix[known], matrix[:, known] = 0.0, 0.0
        matrix[known, known] = errors[known] ** 2
    found["determined"] |= known
    found["rank"] += int(known.sum())
    return known


def _correlated_root(
    noise: SlowNoiseFit, linear: Linearization, acts: np.ndarray, y: float
) -> Float[np.ndarray, "m p"]:
    """Square root of the information of a least-squares estimate under correlated noise; zero in columns that do not act."""
    acting = linear.columns(acts)
    acting *= y
    root_of_acting = least_squares_root(noise, acting, overwrite=True)
    root = np.zeros((len(root_of_acting), acts.size))
    root[:, acts] = root_of_acting
    return root


def ridge_shares(near: NearBounds, names: Sequence[str], acts: np.ndarray) -> Float[np.ndarray, "N p"]:
    """Fraction of the ridge of each parameter that counts as prior information, equal for all weights of an array."""
    share = np.ones((len(near.x), acts.size))
    arrays = np.array([name.split("[")[0] for name in names])
    share[:, acts] = near.share(np.unique(arrays[acts], return_inverse=True)[1])
    return share


def _factor(
    problem: Problem, x: np.ndarray, linear: Linearization, at_bound: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A square root of the normal matrix, triangular for few parameters, and which parameters affect the data, shape (p,), bool.

    If few of hundreds of weights are off their bounds, the columns of the others, which are not needed, are zero.
    """
    offsets = problem.space.offsets
    if x.size <= FEW or not at_bound.any() or linear.root is not None:
        # For hundreds of weights any square root will do, because only its square is used.
        factor = linear.triangle() if x.size <= FEW or linear.root is None else linear.root[:, :-1]
        return factor, _acting(problem, x, np.linalg.norm(centered(factor, offsets)[0], axis=0))
    acts = _acting(problem, x, centered_lengths(linear, offsets))
    needed = acts if np.count_nonzero(acts & at_bound) <= FEW else acts & ~at_bound
    factor = np.zeros((int(np.count_nonzero(needed)), x.size))
    factor[:, needed] = linear.triangle(needed)
    return factor, acts


def _acting(problem: Problem, x: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Parameters with an influence on the data, by the length of their centered derivatives, shape (p,), bool."""
    gain = length * np.minimum(relative_size(problem.space, x), problem.space.scale)
    return gain > 1e-9 * max(gain.max(initial=0.0), 1e-300)


def determine(
    space: ParameterSpace,
    x: np.ndarray,
    relative: np.ndarray,
    information: Information,
    live: np.ndarray,
    inside: np.ndarray | None,
) -> dict[str, Any]:
    """Covariance, and which parameters and directions the data determine; `live` ones act and are off their bounds, shape (p,), bool.

    `relative` are the sizes of the parameters, see `relative_size`; `inside` is the covariance where bounds are near, shape (p, p).
    """
    at = np.flatnonzero(live)
    covariance, determined = np.full((x.size, x.size), np.nan), np.zeros(x.size, bool)
    joint = covariance.copy()
    if not at.size:
        nothing = {"directions": (), "reaching": (), "rank": 0, "condition": None}
        return {"covariance": covariance, "joint": joint, "determined": determined, **nothing}
    values, root, back = _spectrum(information, live, space.offsets[live])
    lost, relative = np.flatnonzero(values <= RANK * values[0]), relative[live]
    scaled = root / relative[:, None]
    determining = np.delete(np.arange(at.size), lost) if lost.size else slice(None)
    spreads, wide = _wide_axes(scaled[:, determining])
    open_axes = np.hstack([wide, scaled[:, lost] / np.linalg.norm(scaled[:, lost], axis=0)])
    shifts = space.offsets[live]
    root[shifts] = back[shifts] @ root  # the other rows of this matrix are those of the identity
    known = root[:, determining]
    full = known @ known.T if inside is None else inside[np.ix_(at, at)]
    joint[np.ix_(at, at)] = root @ root.T if lost.size else full
    touched = _touched(open_axes, spreads, (space.kinds == BOTH)[live])
    # Linear weights may well be zero.
    room = np.where(space.linear, np.inf, np.minimum(*distances_to_bounds(space, x)))
    reaching = ~touched & (REACH * np.sqrt(np.diag(full)) > room[live])
    touched |= reaching
    nonlinear = ~space.linear[live]
    # If most nonlinear parameters are undetermined, the linearization does not hold for the others either.
    if 2 * np.count_nonzero(nonlinear & ~touched) < np.count_nonzero(~space.linear):
        touched |= nonlinear
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
        "condition": None if lost.size else float(values[0] / values[-1]),
    }


def _wide_axes(deviations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues above `OPEN` squared, rising, (m,), and eigenvectors, (k, m), of a covariance D D' in relative coordinates."""
    covariance = deviations @ deviations.T
    below = -covariance
    below[np.diag_indices_from(below)] += OPEN**2
    with contextlib.suppress(np.linalg.LinAlgError):  # positive definite where no variance is larger
        cholesky(below, overwrite=True)
        return np.zeros(0), np.zeros((len(covariance), 0))
    return scipy.linalg.eigh(covariance, subset_by_value=(OPEN**2, np.inf))  # type: ignore[return-value]


def _spectrum(
    information: Information, live: np.ndarray, offsets: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Singular values and inverse of the root of the information about live parameters, centered and with columns of unit length.

    Scaling and centering make the rank independent of units and of the zero of input and output.

    Returns:
        Singular values, falling, (k,), of which for hundreds of parameters the ends suffice where none is tiny, (2,); a square root of the
        covariance, (k, k); and the matrix that transforms it to parameters, (k, k).
        If some values are tiny, the columns of the square root are the singular directions, with large but finite standard deviations as
        lengths.
    """
    rows, penalty = information.root[:, live], information.penalty[np.ix_(live, live)]
    if penalty.any() and (len(penalty) <= FEW or penalty[offsets].any()):
        rows, penalty = np.vstack([rows, gram_root(penalty)]), np.zeros(penalty.shape)
    ridge = np.diag(penalty)
    if rows.shape[1] <= FEW and rows.shape[0] > rows.shape[1]:
        rows = np.linalg.qr(rows, mode="r")
    rows, back = centered(rows, offsets, ridge)
    size = np.hypot(np.linalg.norm(rows, axis=0), np.sqrt(ridge))
    size[size == 0] = 1.0
    if size.size > FEW:
        values, inverse = _inverse_root(rows / size, penalty / np.outer(size, size))
    else:
        _, values, vectors = np.linalg.svd(rows / size, full_matrices=True)
        values = np.pad(values, (0, len(vectors) - values.size))
        inverse = vectors.T / np.maximum(values, RANK * values[0])
    return values, np.sqrt(information.variance) * inverse / size[:, None], back


def _inverse_root(rows: np.ndarray, penalty: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Singular values of rows R and a penalty, falling, and a square root of the inverse of the normal matrix R'R + `penalty`.

    If some values are tiny, its columns are the singular directions, in a third of the time of a decomposition of R; else the values are
    the largest and the smallest one, and it is triangular. Values down to `RANK` of the largest are distinguished from zero.
    """
    gram = rows.T @ rows + penalty
    with contextlib.suppress(np.linalg.LinAlgError, scipy.sparse.linalg.ArpackError):  # rounding errors
        inverse = np.triu(dtrtri(cholesky(gram), lower=True)[0].T)
        ends = _largest(len(gram), lambda v: gram @ v), 1 / _largest(len(gram), lambda v: inverse @ (inverse.T @ v))
        if ends[1] > RANK**2 * ends[0]:
            return np.sqrt(ends), inverse
    squares, columns = np.linalg.eigh(gram)
    values = np.sqrt(np.maximum(squares[::-1], 0.0))
    return values, columns[:, ::-1] / np.maximum(values, RANK * values[0])


def _largest(size: int, multiply: Callable[[np.ndarray], np.ndarray]) -> float:
    """Largest eigenvalue of a symmetric matrix, which products with vectors define: by Lanczos, in a fifth of the time of all of them."""
    operator = scipy.sparse.linalg.LinearOperator((size, size), matvec=multiply, dtype=float)
    first = np.random.default_rng(0).normal(size=size)
    return float(scipy.sparse.linalg.eigsh(operator, 1, which="LM", v0=first, return_eigenvectors=False)[0])


def _touched(open_axes: np.ndarray, spreads: np.ndarray, two_sided: np.ndarray) -> np.ndarray:
    """Parameters with a large component in an undetermined direction, shape (k,), bool.

    A direction among parameters with two bounds is limited by these, so it counts only if it adds a large standard error.

    The directions are columns, in relative coordinates, (k, m); `spreads` are the variances along the first of them. The variances along
    the others are unknown.
    """
    limited = np.array([two_sided[_main(axis)].all() for axis in open_axes.T], bool)
    limited[spreads.size :] = False
    moved = np.abs(open_axes[:, limited]) * np.sqrt(spreads[limited[: spreads.size]])
    largest = lambda components: components.max(axis=1, initial=0.0)
    return (largest(np.abs(open_axes[:, ~limited])) > _TOUCHED) | (largest(moved) > _MOVED)


def describe(direction: np.ndarray, names: list[str]) -> str:
    """The parameters that trade against each other along a direction, with their relative components."""
    main = _main(direction)[:6]
    if len(main) == 1:
        return names[main[0]]
    lead = np.sign(direction[main[0]])
    return ", ".join(f"{names[k]} ({lead * direction[k]:+.2f})" for k in main)


def _main(direction: np.ndarray) -> list[int]:
    """The parameters with components of a quarter of the largest and more, largest first."""
    order = np.argsort(-np.abs(direction))
    return [int(k) for k in order if 4 * abs(direction[k]) > abs(direction[order[0]])]
