"""`fit`: from a model and data to a result, with no guess from the user."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args

import jax.numpy as jnp
import numpy as np

from hystfit.config import require_seed, require_x64
from hystfit.data.record import Dataset, Record
from hystfit.errors import HystfitError, ModelError, ParameterError
from hystfit.fitting.assessment import notes_of, status_of
from hystfit.fitting.bounded import BoundedDescent
from hystfit.fitting.convex import Convex, LinearSystem, fit_ridge
from hystfit.fitting.covariance import Uncertainty, near_bound, uncertainty
from hystfit.fitting.estimate import AbstractEstimator, Estimate
from hystfit.fitting.least_squares import LeastSquares
from hystfit.fitting.multistart import spread_starts
from hystfit.fitting.released import refine_released
from hystfit.fitting.smooth_weights import SmoothWeights
from hystfit.fitting.timing import Stopwatch
from hystfit.fitting.trust_region import TrustRegion
from hystfit.inference.noise import NOISES
from hystfit.inference.problem import Loss, Problem, check_fittable
from hystfit.inference.residuals import diagnose
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import make_model
from hystfit.params.space import ParameterSpace
from hystfit.results.metrics import Metrics
from hystfit.results.result import FitResult, ParameterEstimate, provenance

Method = Literal["auto", "lm", "dogleg", "trf", "lbfgsb", "projected-gradient", "convex", "preisach"]
ESTIMATORS: dict[str, AbstractEstimator] = {
    "lm": LeastSquares(),
    "dogleg": LeastSquares(method="dogleg"),
    "trf": TrustRegion(),
    "lbfgsb": BoundedDescent(),
    "projected-gradient": BoundedDescent(method="projected-gradient"),
    "convex": Convex(),
    "preisach": SmoothWeights(),
}
_ROUNDING = 1e-8  # residuals below this part of the output's size are rounding
_MANY = 4  # weights on a bound from which the convex solve is the default


def fit(
    model: AbstractHysteresis | str,
    data: Record | Dataset | Sequence[Record],
    *,
    method: Method = "auto",
    fix: Sequence[str] | Mapping[str, Any] = (),
    free: Sequence[str] = (),
    start: Literal["data", "model"] = "data",
    starts: int = 8,
    seed: int = 0,
    loss: Loss = "linear",
    noise: Literal["auto", "iid", "ou", "ar1", "student-t", "discrepancy"] = "auto",
    test: Record | Dataset | Sequence[Record] | None = None,
) -> FitResult:
    """Fit a model to measured loops by least squares on its free run.

    Args:
        model: a model, or its name (see `hystfit models`).
        data: one record or several; windows are set by `Record.window`.
        method: "lm" and "dogleg" (optimistix), "trf" (scipy, bounded), "lbfgsb" and "projected-gradient" (jaxopt,
            bounded), "convex" (weights in closed form), "preisach" (the same on distinct relay states, smooth); "auto"
            takes "preisach" or "convex" for many linear weights, else "lm".
        fix: parameters to hold, at one value given ({"c": 0.15}), else at the value of the model given, or at the one read off
            the records where `start` is "data" and the model is given by name.
        free: parameters to fit that the model holds by default.
        start: "data" reads starting values off the records, "model" takes the model's own.
        starts: number of starting points: the data-driven one, and a Latin hypercube about it.
        seed: of the starting points.
        loss: robust losses bend at 1 % of the output's range.
        noise: "auto" keeps the least-squares estimate; where its residuals are correlated, its errors are those under slow
            (Ornstein-Uhlenbeck) and independent noise learned from them. "iid" takes residuals as independent. "ou" (slow and
            independent noise), "ar1", "student-t" and "discrepancy" (model error that repeats every loop) refine the fit by that noise
            model's likelihood: "ou" is the sharper estimate under slow noise, and errors under a repeating misfit need "discrepancy"
            (the notes say when).
        test: records to report the error on, never fitted.

    Returns:
        A result with a status; look at `usable` and `notes` before using its numbers.

    Raises:
        HystfitError: data, names or settings that cannot be used; the message says what to do.
    """
    require_x64()
    require_seed(seed)
    named = isinstance(model, str)
    model = make_model(model) if named else model
    data = Dataset.of(data)
    _check_settings(method, starts, loss, noise, start)
    watch = Stopwatch()
    chosen: list[str] = []
    if not isinstance(model, AbstractHysteresis):
        raise ModelError(f"expected a hystfit model or its name, got {type(model).__name__}")
    check_fittable(model, data)
    if start == "data":
        fix = fix if named else _held(model, fix)
        model = model.start(list(data))
    problem = Problem(model, data, fix=fix, free=free, loss=loss)
    name = _choose(problem, method)
    if name == "convex" and start == "data" and model.has_rest:
        problem, chosen = _choose_rest(problem, fix, free, loss)
    estimate = solve(problem, name, starts, seed)
    if noise in NOISES and noise != "iid":
        estimate, errors, described = _with_noise(problem, estimate, noise)
        chosen = [*chosen, described["words"]]
    else:
        errors, described = uncertainty(problem, estimate, honest=noise == "auto"), {"name": noise}
        if noise == "auto" and errors.left.correlated and errors.left.noise is not None:
            described["parameters"] = errors.left.noise.noise.parameters
    chosen = [*chosen, *_warnings(errors, noise, problem.scales.y)]
    result = conclude(problem, estimate, errors, name, seed, watch, extra=chosen, test=test)
    result.provenance["noise"] = described
    return result


def _held(model: AbstractHysteresis, fix: Sequence[str] | Mapping[str, Any]) -> Mapping[str, Any]:
    """`fix` with the model's own values where it gives none: starting values read off the data must not replace them."""
    values = dict(fix) if isinstance(fix, Mapping) else dict.fromkeys(fix)
    return {name: ParameterSpace.of(model).value(name) if value is None else value for name, value in values.items()}


def _with_noise(problem: Problem, estimate: Estimate, noise: str) -> tuple[Estimate, Uncertainty, dict[str, Any]]:
    """The estimate refined by a noise model, its errors, and the noise in numbers."""
    if problem.objective.loss != "linear":
        raise ParameterError(f"noise={noise!r} has a likelihood of its own: leave loss at 'linear'")
    refined = refine_released(problem, estimate, noise)
    squares = sum(
        np.sum((r.y - y)[r.used] ** 2) for r, y in zip(problem.data, problem.predict_at(refined.x), strict=True)
    )
    notes = () if refined.converged else (f"the {noise} noise model did not converge: its errors are rough",)
    changed = dataclasses.replace(
        estimate, x=refined.x, cost=0.5 * float(squares) / problem.scales.y**2, notes=(*estimate.notes, *notes)
    )
    values = {name: float(v) for name, v in zip(refined.space.names, refined.values, strict=True)}
    described = {"name": noise, "parameters": values, "words": refined.describe()}
    return changed, uncertainty(problem, changed, root=refined.root), described


def _warnings(errors: Uncertainty, noise: str, size: float) -> list[str]:
    """What the residuals say against errors of this kind; `size` of the output."""
    if errors.sigma < _ROUNDING * size:
        return ["the residuals are of the size of rounding: they are no measure of any error"]
    reasons = diagnose(errors.left).objections(noise)
    return reasons if noise == "auto" else [f"noise={noise!r} was asked for, but {reason}" for reason in reasons]


def _check_settings(method: str, starts: int, loss: str, noise: str, start: str) -> None:
    for what, value, known in (
        ("method", method, get_args(Method)),
        ("loss", loss, get_args(Loss)),
        ("noise", noise, ("auto", *NOISES)),
        ("start", start, ("data", "model")),
    ):
        if value not in known:
            raise ParameterError(f"{what} must be one of {', '.join(known)}, got {value!r}")
    if starts < 1:
        raise ParameterError(f"at least one start is needed, got {starts}")


def _choose(problem: Problem, method: str) -> str:
    weights = sum(info.linear and info.bounds[0] == 0.0 for info in problem.space.infos)
    if method != "auto":
        return method
    if problem.model.estimator is not None and problem.objective.loss == "linear":
        return problem.model.estimator
    return "convex" if weights >= _MANY and problem.objective.loss == "linear" else "lm"


def solve(problem: Problem, method: str, starts: int, seed: int) -> Estimate:
    """Run one estimator from the model's values and a hypercube about them.

    Raises:
        ParameterError: nothing is free.
    """
    if not len(problem.space):
        raise ParameterError("every parameter is fixed: there is nothing to fit (use predict)")
    x = problem.space.vector(problem.model)
    center = problem.space.unconstrained(_settled(problem, x))
    count = 1 if method in ("convex", "preisach") else starts
    return ESTIMATORS[method].estimate(problem, spread_starts(problem, center, count, seed))


def _settled(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Starting values with each record's own linear parameters (offsets, first outputs) solved for, and all inside their bounds."""
    c = problem.space.coordinates
    own = np.array([info.per_record and info.linear for info in problem.space.infos])
    if len(problem.data) > 1 and own.any():
        system = LinearSystem.of(problem, x, own)
        x = x.copy()
        x[own] = np.linalg.lstsq(system.columns, system.target, rcond=None)[0]
    return np.clip(x, np.asarray(c.lower), np.asarray(c.upper))


def _choose_rest(
    problem: Problem, fix: Sequence[str] | Mapping[str, Any], free: Sequence[str], loss: Loss
) -> tuple[Problem, list[str]]:
    """Whether the device rested at zero input or on the record's first one before it: whichever predicts left-out blocks better."""
    span = 2 * problem.scales.u
    if all(abs(record.u[0]) < 1e-3 * span for record in problem.data):
        return problem, []
    other = Problem(problem.model.with_rest("first"), problem.data, fix=fix, free=free, loss=loss)
    scores = []
    for candidate in (problem, other):
        x = _settled(candidate, candidate.space.vector(candidate.model))
        scores.append(fit_ridge(LinearSystem.of(candidate, x)).score)
    best, where = (problem, "on zero input") if scores[0] <= scores[1] else (other, "on its first input")
    gain = min(scores) / max(scores)
    words = f"before the record the device is taken to have rested {where} (error on left-out blocks {gain:.0%} of the other)"
    return best, [words]


def conclude(
    problem: Problem,
    estimate: Estimate,
    errors: Uncertainty,
    method: str,
    seed: int,
    watch: Stopwatch,
    *,
    extra: Sequence[str] = (),
    test: Record | Dataset | Sequence[Record] | None = None,
) -> FitResult:
    """Put an estimate into the result that users see."""
    space, data = problem.space, problem.data
    models = tuple(space.coordinates.assemble(jnp.asarray(estimate.x), k) for k in range(len(data)))
    bounds = near_bound(problem, estimate.x)
    predicted = problem.predict_at(estimate.x)
    measured, made = [r.y[r.used] for r in data], [y[r.used] for r, y in zip(data, predicted, strict=True)]
    train = Metrics.of(measured, made)
    left = [y - m for y, m in zip(made, measured, strict=True)]
    status, why = status_of(data, models[0], estimate, train, left)
    linear = [info.linear for info in space.infos]
    notes = why + list(extra) + notes_of(data, models[0], space.names, linear, estimate, errors, bounds)
    compile_s, run_s = watch.read()
    result = FitResult(
        model=models[0],
        models=models,
        data=data,
        status=status,
        notes=tuple(notes),
        parameters=_parameters(problem, estimate.x, errors, bounds, models[0]),
        free_names=space.names,
        covariance=errors.covariance,
        train=train,
        test=None,
        sigma=errors.sigma,
        correlation_time=errors.correlation_time,
        honest_ratio=errors.ratio,
        rank=errors.rank,
        condition=errors.condition,
        method=method,
        starts=int(estimate.costs.size),
        in_best_basin=estimate.in_best_basin,
        compile_s=compile_s,
        run_s=run_s,
        provenance=provenance(data, seed, loss=problem.objective.loss, evaluations=estimate.evaluations),
    )
    return result if test is None else with_test(result, test)


def with_test(result: FitResult, test: Record | Dataset | Sequence[Record], *, refit_offset: bool = False) -> FitResult:
    """The result with its error on records that were not fitted, and a warning where they leave the fitted range."""
    records = list(Dataset.of(test))
    try:
        metrics = result.metrics(records, refit_offset=refit_offset)
    except HystfitError as error:
        raise type(error)(f"test data: {error}") from error
    warnings = [words for record in records if (words := result.extrapolates(record))]
    if refit_offset:
        warnings.append("the offset of each test record was refitted to it")
    return dataclasses.replace(result, test=metrics, notes=result.notes + tuple(warnings))


def _parameters(
    problem: Problem, x: np.ndarray, errors: Uncertainty, bounds: Sequence[str | None], model: AbstractHysteresis
) -> tuple[ParameterEstimate, ...]:
    space, c = problem.space, problem.space.coordinates
    finite = lambda value: float(value) if np.isfinite(value) else None
    variance = np.diag(errors.covariance)
    rows = []
    for k, name in enumerate(space.names):
        error = float(np.sqrt(variance[k])) if np.isfinite(variance[k]) else None
        known = bool(errors.determined[k]) and not bounds[k]
        info, unit = space.infos[k], space.units[k]
        lower, upper = finite(c.lower[k]), finite(c.upper[k])
        rows.append(ParameterEstimate(name, float(x[k]), error, unit, lower, upper, False, bounds[k], known, info.doc))
    for name, value, info in space.fixed():
        lower, upper = (finite(b) for b in info.bounds)
        unit = problem.scales.label(info.unit)
        rows.append(ParameterEstimate(name, value, None, unit, lower, upper, True, None, None, info.doc))
    return tuple(rows)
