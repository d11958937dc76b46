"""The fit of one model to records, without starting values from the user; `hystfit.fit` in `entry` calls it."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import equinox as eqx
import numpy as np

from hystfit.config import require_seed, require_x64
from hystfit.data.record import Dataset, Record
from hystfit.errors import ParameterError
from hystfit.fitting.assessment import notes_of
from hystfit.fitting.convex import LinearSystem, fit_ridge
from hystfit.fitting.covariance import Uncertainty, uncertainty
from hystfit.fitting.estimate import AbstractEstimator, Estimate
from hystfit.fitting.multistart import spread_starts
from hystfit.fitting.noise_refinement import refine
from hystfit.fitting.registry import ESTIMATORS, is_sequential
from hystfit.fitting.structure import search_structure
from hystfit.fitting.verdict import Fitted, evaluate_on, verdict_of, with_left_out, worse
from hystfit.identify.identification import as_fit
from hystfit.identify.sequential import identify
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.objective import Loss
from hystfit.inference.problem import LOSSES, Problem, check_fittable
from hystfit.inference.residuals import diagnose
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import SEARCH, make_model
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.params.space import ParameterSpace
from hystfit.quality.baselines import Baselines
from hystfit.results.estimates import NoiseEstimate, ParameterEstimate
from hystfit.results.metrics import Metrics
from hystfit.results.provenance import provenance
from hystfit.results.result import FitResult
from hystfit.results.timing import Stopwatch

_ROUNDING = 1e-8  # residuals below this fraction of the output's size are rounding errors
Start = Literal["data", "model"] | Mapping[str, float]
_MANY = 4  # weights on a bound from which the convex solve is the default


def fit(
    model: AbstractHysteresis | type[AbstractHysteresis] | str,
    data: Record | Dataset | Sequence[Record],
    *,
    method: str | AbstractEstimator = "auto",
    fix: Sequence[str] | Mapping[str, Any] = (),
    free: Sequence[str] = (),
    start: Start = "data",
    starts: int = 8,
    seed: int = 0,
    loss: Loss = "linear",
    noise: str | type[AbstractNoise] = "auto",
    test: Record | Dataset | Sequence[Record] | None = None,
    **settings: Any,
) -> FitResult:
    """Fit one model to records; arguments, result and errors as for `hystfit.fit`.

    Args:
        model: a model, its class or its name.
        data: one record or several.
        method, fix, free, start, starts, seed, loss, noise, settings: see `hystfit.fit`.
        test: records to report the error on.
    """
    require_x64()
    require_seed(seed)
    named = not isinstance(model, AbstractHysteresis)
    data = Dataset.of(data)
    notes: list[Note] = []
    if isinstance(model, str) and model == SEARCH and not is_sequential(method):
        if isinstance(start, Mapping):
            raise ParameterError(f"{SEARCH} chooses its terms on the data: leave out starting values by name")
        found = search_structure(data)
        model, start, notes = found.model, "model", list(found.notes())
    model = make_model(model)
    watch = Stopwatch()
    if is_sequential(method):
        given = {"fix": fix, "free": free, "start": start, "starts": starts, "loss": loss, "noise": noise}
        if changed := changed_settings(given):
            raise ParameterError(f"{changed[0]}= has no effect with method={method!r}: leave it out")
        result = as_fit(identify(data, method, model, **settings), seed, watch)
        return result if test is None else with_test(result, test)
    if settings:
        raise ParameterError(f"fit has no setting {next(iter(settings))!r} for method={method!r}")
    check_settings(method, starts, loss, noise, start)
    fit_setup = set_up_fit(
        model, data, method=method, fix=fix, free=free, start=start, loss=loss, held=not named, notes=tuple(notes)
    )
    estimate = solve(fit_setup.problem, fit_setup.method, starts, seed, fit_setup.points)
    result = judge(fit_setup, estimate, noise=noise, seed=seed, watch=watch)
    return result if test is None else with_test(result, test)


@dataclasses.dataclass(frozen=True)
class FitSetup:
    """A fit that is ready to be solved.

    Attributes:
        problem: what is fitted.
        method: an estimator or its name.
        points: models to start from, the best first.
        notes: of choices made on the way.
    """

    problem: Problem
    method: str | AbstractEstimator
    points: tuple[AbstractHysteresis, ...]
    notes: tuple[Note, ...] = ()


def set_up_fit(
    model: AbstractHysteresis,
    data: Dataset,
    *,
    method: str | AbstractEstimator = "auto",
    fix: Sequence[str] | Mapping[str, Any] = (),
    free: Sequence[str] = (),
    start: Start = "data",
    loss: Loss = "linear",
    held: bool = False,
    notes: tuple[Note, ...] = (),
) -> FitSetup:
    """Set up a fit: the problem, its estimator and starting points.

    Args:
        model: what is fitted.
        data: the records.
        method, fix, free, start, loss: see `hystfit.fit`.
        held: whether parameters in `fix` without a value keep that of the model where starting values are read off the data.
        notes: of choices made before.
    """
    check_fittable(model, data)
    points: tuple[AbstractHysteresis, ...] = (model,)
    if start != "model":
        fix = _fixed_values(model, fix) if held else fix
        problem, points = started_problem(model, data, fix=fix, free=free, loss=loss)
        if isinstance(start, Mapping):
            points = (points[0].replace(**start),)
            problem = Problem(points[0], data, fix=fix, free=free, loss=loss)
        model = points[0]
    else:
        problem = Problem(model, data, fix=fix, free=free, loss=loss)
    name = choose_method(problem) if method == "auto" else method
    if name == "convex" and start != "model" and model.has_rest:
        problem, of_rest = _choose_rest(problem, fix, free, loss)
        notes = (*notes, *of_rest)
    return FitSetup(problem, name, points, notes)


def judge(
    fit_setup: FitSetup, estimate: Estimate, *, noise: str | type[AbstractNoise], seed: int, watch: Stopwatch
) -> FitResult:
    """The result of a solved fit: standard errors under the noise, and the verdict.

    Args:
        fit_setup: what was solved.
        estimate: where the fit ended.
        noise: see `hystfit.fit`.
        seed: of the starting points.
        watch: started with the fit.
    """
    problem, notes = fit_setup.problem, list(fit_setup.notes)
    if noise in ("auto", "iid"):
        errors = uncertainty(problem, estimate, correlated=noise == "auto")
        slow = errors.residuals.noise if noise == "auto" and errors.residuals.correlated else None
        noise_estimate = NoiseEstimate(str(noise), slow.noise.parameters if slow else {})
    else:
        estimate, errors, noise_estimate, description = _with_noise(problem, estimate, noise)
        notes.append(description)
    notes += _mismatches(errors, noise, problem.scales.y)
    label = ESTIMATORS.label(fit_setup.method)
    return make_result(problem, estimate, errors, label, seed, watch, noise=noise_estimate, notes=notes)


def started_problem(
    model: AbstractHysteresis, data: Dataset, **options: Any
) -> tuple[Problem, tuple[AbstractHysteresis, ...]]:
    """The problem of a model with starting values from the records, and all models to start from.

    Args:
        model: any model.
        data: records.
        **options: of `Problem`.
    """
    check_fittable(model, data)
    points = model.starting_points(list(data.map(model.prepared)))
    return Problem(points[0], data, **options), points


def changed_settings(given: Mapping[str, Any]) -> list[str]:
    """Names of the settings of `fit` that have another value than their default."""
    defaults = {name: p.default for name, p in inspect.signature(fit).parameters.items()}
    return [name for name, value in given.items() if (value or None) != (defaults[name] or None)]


def _fixed_values(model: AbstractHysteresis, fix: Sequence[str] | Mapping[str, Any]) -> Mapping[str, Any]:
    """`fix` with the model's own values where it gives none: starting values read off the data must not replace them."""
    values = dict(fix) if isinstance(fix, Mapping) else dict.fromkeys(fix)
    return {name: ParameterSpace.of(model).value(name) if value is None else value for name, value in values.items()}


def _with_noise(
    problem: Problem, estimate: Estimate, noise: str | type[AbstractNoise]
) -> tuple[Estimate, Uncertainty, NoiseEstimate, Note]:
    """The estimate refined by a noise model, its errors, the noise, and a note that describes it."""
    if problem.objective.loss != "linear":
        raise ParameterError(f"noise={noise!r} has a likelihood of its own: leave loss at 'linear'")
    refined = refine(problem, estimate.x, noise)
    predicted = zip(problem.data, problem.predict(refined.x), strict=True)
    squares = sum(np.sum((r.weight * (r.y - y) ** 2)[r.used]) for r, y in predicted)
    label = refined.noise.name
    rough = (
        ()
        if refined.converged
        else (warn(Code.SOLVER, f"the {label} noise model did not converge: its errors are rough"),)
    )
    cost = 0.5 * float(squares) / problem.scales.y**2
    changed = dataclasses.replace(estimate, x=refined.x, cost=cost, notes=(*estimate.notes, *rough))
    shown = ", ".join(
        f"{name} = {value:.3g} {unit}".rstrip()
        for name, value, unit in zip(refined.space.names, refined.values, refined.space.units, strict=True)
    )
    described = Note(Code.NOISE_MODEL, f"noise model {label}: {shown}")
    estimated = NoiseEstimate(NOISES.label(noise), refined.parameters)
    return changed, uncertainty(problem, changed, root=refined.root), estimated, described


def _mismatches(errors: Uncertainty, noise: str | type[AbstractNoise], size: float) -> list[Note]:
    """Findings about the residuals that errors of this kind do not allow for; `size` is that of the output."""
    if errors.sigma < _ROUNDING * size:
        return [Note(Code.ROUNDING, "the residuals are rounding errors: the standard errors are meaningless")]
    diagnosis = diagnose(errors.residuals)
    if noise == "auto":
        return [note for note in diagnosis.findings if note.code is not Code.CORRELATED_RESIDUALS]
    return [
        dataclasses.replace(note, text=f"noise={noise!r} was chosen, but {note.text}")
        for note in diagnosis.objections(NOISES.find(noise))  # type: ignore[arg-type]
    ]


def check_settings(method: Any, starts: int, loss: str, noise: Any, start: Any) -> None:
    """Refuse settings that no data can be fitted with.

    Args:
        method, starts, loss, noise, start: see `hystfit.fit`; no sequential method.

    Raises:
        ParameterError: one of them is unknown.
    """
    if method != "auto" and not isinstance(method, AbstractEstimator):
        ESTIMATORS.find(method)
    if noise != "auto":
        NOISES.find(noise)
    if loss not in LOSSES:
        raise ParameterError(f"loss must be one of {', '.join(LOSSES)}, got {loss!r}")
    if start not in ("data", "model") and not isinstance(start, Mapping):
        raise ParameterError(f"start must be data, model, or values of parameters by name, got {start!r}")
    if starts < 1:
        raise ParameterError(f"at least one start is needed, got {starts}")


def choose_method(problem: Problem) -> str:
    """The estimator that suits a model: a closed form for its weights where there are many, else Levenberg-Marquardt."""
    if problem.objective.loss != "linear":
        return "lm"
    if problem.model.estimator is not None:
        return problem.model.estimator
    weights = sum(info.linear and info.bounds[0] == 0.0 for info in problem.space.infos)
    return "convex" if weights >= _MANY else "lm"


def solve(
    problem: Problem,
    method: str | AbstractEstimator,
    starts: int,
    seed: int,
    points: Sequence[AbstractHysteresis] = (),
) -> Estimate:
    """Run one estimator from several models, or from the values of one and a hypercube about them.

    Args:
        problem: what to fit.
        method: an estimator or its name.
        starts: number of starting points.
        seed: of the hypercube.
        points: models to start from, the best first; that of the problem by default.

    Raises:
        ParameterError: nothing is free.
    """
    estimator = ESTIMATORS.make(method)
    return estimator.estimate(problem, starting_vectors(problem, starts if estimator.needs_starts else 1, seed, points))


def starting_vectors(problem: Problem, count: int, seed: int, points: Sequence[AbstractHysteresis] = ()) -> np.ndarray:
    """Starting points of shape (S, p) in unconstrained coordinates; arguments and errors as for `solve`.

    Args:
        problem: what to fit.
        count: of the points at most.
        seed: of the hypercube.
        points: models to start from, the best first.
    """
    if not len(problem.space):
        raise ParameterError("every parameter is fixed: there is nothing to fit (use predict)")
    models = points[:count] or (problem.model,)
    at = [
        problem.space.unconstrained(_with_record_parameters(problem, problem.space.vector(model))) for model in models
    ]
    return np.stack(at) if len(at) > 1 else spread_starts(problem, at[0], count, seed)


def _with_record_parameters(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Starting values with each record's own linear parameters (offsets, first outputs) solved for, and all inside their bounds."""
    per_record = np.array([info.per_record and info.linear for info in problem.space.infos])
    if len(problem.data) > 1 and per_record.any():
        system = LinearSystem.of(problem, x, per_record)
        x = x.copy()
        x[per_record] = np.linalg.lstsq(system.columns, system.target, rcond=None)[0]
    c = problem.space.coordinates
    return np.clip(x, np.asarray(c.lower), np.asarray(c.upper))


def _choose_rest(
    problem: Problem, fix: Sequence[str] | Mapping[str, Any], free: Sequence[str], loss: Loss
) -> tuple[Problem, list[Note]]:
    """Whether the device rested at zero input or on the record's first one before it: whichever predicts left-out blocks better."""
    span = 2 * problem.scales.u
    if all(abs(record.u[0]) < 1e-3 * span for record in problem.data):
        return problem, []
    first = problem.model.with_rest("first")
    if eqx.tree_equal(first, problem.model):  # chosen by the user
        return problem, []
    other = Problem(first, problem.data, fix=fix, free=free, loss=loss)
    scores = []
    for candidate in (problem, other):
        x = _with_record_parameters(candidate, candidate.space.vector(candidate.model))
        scores.append(fit_ridge(LinearSystem.of(candidate, x)).score)
    best, where = (problem, "on zero input") if scores[0] <= scores[1] else (other, "on its first input")
    gain = 1 - min(scores) / max(scores)
    text = f"the device is assumed to have rested {where} before the record (cross-validation error {100 * gain:.0f} % lower)"
    return best, [Note(Code.CHOICE, text)]


def make_result(
    problem: Problem,
    estimate: Estimate,
    errors: Uncertainty,
    method: str,
    seed: int,
    watch: Stopwatch,
    *,
    noise: NoiseEstimate,
    notes: Sequence[Note] = (),
) -> FitResult:
    """Make the `FitResult` of an estimate.

    Args:
        problem: what was fitted.
        estimate: where the fit ended.
        errors: its standard errors.
        method: name of the estimator.
        seed: of the starting points.
        watch: started with the fit.
        noise: behind the standard errors.
        notes: of choices made on the way.
    """
    data, x = problem.data, estimate.x
    measured = [r.y[r.used] for r in data]
    predicted = [y[r.used] for r, y in zip(data, problem.predict(x), strict=True)]
    train = Metrics.of(measured, predicted)
    rows = [y - m for y, m in zip(predicted, measured, strict=True)]
    model = problem.space.assembled(x)
    baselines = Baselines.of(data)
    fitted = Fitted(problem, model, estimate, train, rows, baselines, method, choose_method(problem))
    status, reasons = verdict_of(fitted)
    compile_s, run_s = watch.read()
    result = FitResult(
        problem=problem,
        x=np.asarray(x),
        status=status,
        notes=(*reasons, *notes, *notes_of(problem, model, estimate, errors)),
        parameters=parameters_of(problem, x, errors),
        covariance=errors.covariance,
        joint=errors.joint,
        train=train,
        test=None,
        sigma=errors.sigma,
        correlation_time=errors.correlation_time,
        error_ratio=errors.ratio,
        rank=errors.rank,
        condition=errors.condition,
        method=method,
        starts=int(estimate.costs.size),
        in_best_basin=estimate.in_best_basin,
        compile_s=compile_s,
        run_s=run_s,
        noise=noise,
        baselines=baselines,
        provenance=provenance(data, seed, evaluations=estimate.evaluations),
    )
    return result if estimate.left_out is None else with_left_out(result, estimate.left_out)


def with_test(result: FitResult, test: Record | Dataset | Sequence[Record], *, refit_offset: bool = False) -> FitResult:
    """The result judged on records that were not fitted: their error, and a status that includes it.

    Args:
        result: the fit.
        test: the records.
        refit_offset: shift each prediction to the mean of the record.

    Raises:
        HystfitError: the model cannot predict the records.
    """
    trial = evaluate_on(result, list(Dataset.of(test)), refit_offset=refit_offset)
    notes = [Note(Code.OFFSET_REFITTED, "the offset of each test record was refitted")] if refit_offset else []
    status = worse(result.status, trial.status)
    changed = dataclasses.replace(result, test=trial.metrics, test_baselines=trial.baselines, status=status)
    return changed.with_notes(*trial.notes, *notes)


def parameters_of(problem: Problem, x: np.ndarray, errors: Uncertainty) -> tuple[ParameterEstimate, ...]:
    """Every parameter, free ones first, for the report.

    Args:
        problem: what was fitted.
        x: free parameters, physical, shape (p,).
        errors: their standard errors.
    """
    space, c = problem.space, problem.space.coordinates
    finite = lambda value: float(value) if np.isfinite(value) else None
    variance, sides = np.diag(errors.covariance), problem.at_bound(x)
    lowest, highest = np.asarray(c.lower), np.asarray(c.upper)
    rows = []
    for k, name in enumerate(space.names):
        error = float(np.sqrt(variance[k])) if np.isfinite(variance[k]) else None
        known = bool(errors.determined[k]) and not sides[k]
        info, unit = space.infos[k], space.units[k]
        lower, upper = finite(lowest[k]), finite(highest[k])
        rows.append(ParameterEstimate(name, float(x[k]), error, unit, lower, upper, False, sides[k], known, info.doc))
    for name, value, info in space.fixed():
        lower, upper = (finite(b) for b in info.bounds)
        unit = problem.scales.label(info.unit)
        rows.append(ParameterEstimate(name, value, None, unit, lower, upper, True, None, None, info.doc))
    return tuple(rows)
