"""`fit_model`: the fit of one model to records."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hystfit.config import one_blas_thread, require_seed, verb
from hystfit.data.covariates import dependences
from hystfit.data.dataset import Dataset
from hystfit.errors import ParameterError
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import FitSetup, choose_method, set_up_fit, solve, without_faults
from hystfit.fitting.judgment.assessment import notes_of
from hystfit.fitting.judgment.covariance import Uncertainty, uncertainty
from hystfit.fitting.judgment.fit_warnings import ROBUST_LOSS, may_be_robust
from hystfit.fitting.judgment.fitted import Fitted
from hystfit.fitting.judgment.verdict import verdict_of
from hystfit.fitting.noise_refinement import refine
from hystfit.fitting.solvers.estimate import Estimate
from hystfit.fitting.solvers.registry import ESTIMATORS, is_sequential
from hystfit.fitting.structure.structure_search import search_structure
from hystfit.fitting.trial import with_left_out
from hystfit.identify.identification import as_fit, identify
from hystfit.inference.blocks import chosen
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import diagnose
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import SEARCH, make_model
from hystfit.models.varying import Varying
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.params.relative_size import ROUNDED
from hystfit.quality.baselines import Baselines
from hystfit.results.accuracy import Metrics
from hystfit.results.estimates import NoiseEstimate, ParameterEstimate, parameter_estimates
from hystfit.results.provenance import Stopwatch, provenance
from hystfit.results.result import FitResult


@verb
def fit_model(
    model: AbstractHysteresis | type[AbstractHysteresis] | str,
    data: Dataset,
    options: FitOptions,
    **settings: Any,
) -> FitResult:
    """Fit one model, its class or its name to records; result and errors as for `hystfit.fit`. The settings are those of an identifier."""
    require_seed(options.seed)
    if is_sequential(options.method):
        watch = Stopwatch()
        if changed := dataclasses.replace(options, method="auto").changed():
            raise ParameterError(f"{changed[0]}= has no effect with method={options.method!r}: leave it out")
        return as_fit(identify(data, options.method, make_model(model), **settings), options.seed, watch)
    if settings:
        raise ParameterError(f"fit has no setting {next(iter(settings))!r} for method={options.method!r}")
    return solve_model(model, data, options).judged()


def solve_model(
    model: AbstractHysteresis | type[AbstractHysteresis] | str,
    data: Dataset,
    options: FitOptions,
    worth: float = np.inf,
    ready: FitSetup | None = None,
) -> Solved:
    """Fit one model to records without its standard errors; arguments and errors as for `fit_model`, apart from identifiers.

    The fit may stop early if its rms error on held-out samples exceeds `worth` [y]. `ready` is the result of `set_up_fit`, if it is known.
    """
    named, notes = not isinstance(model, AbstractHysteresis), list[Note]()
    watch = Stopwatch()
    if isinstance(model, str) and model == SEARCH:
        if isinstance(options.start, Mapping):
            raise ParameterError(f"{SEARCH} chooses its terms on the data: leave out starting values by name")
        found = search_structure(without_faults(data), spacing=options.spacing)
        model, notes = found.model, list(found.notes())
        options = dataclasses.replace(options, start="model")
    options.check()
    made = make_model(model)
    if options.covariates:
        made = Varying.of(made, dependences(options.covariates), list(data))
        notes += made.notes(list(data))
    setup = ready or set_up_fit(made, data, options, held=not named, notes=tuple(notes))
    estimate = solve(setup.problem, setup.method, options.starts, options.seed, setup.points, worth)
    return Solved(setup, estimate, options, watch)


@dataclasses.dataclass(frozen=True)
class Solved:
    """A solved fit. Standard errors, which often take longer than the solve, are computed on demand: few fits of a comparison need them."""

    setup: FitSetup
    estimate: Estimate
    options: FitOptions
    watch: Stopwatch

    def judged(self) -> FitResult:
        """The result with standard errors."""
        with one_blas_thread():  # may be called after the comparison has ended
            return judge(self.setup, self.estimate, self.options, self.watch)

    @functools.cached_property
    def unjudged(self) -> FitResult:
        """The result with its verdict, without standard errors."""
        noise = NoiseEstimate(str(self.options.noise), {})
        errors = Uncertainty.unknown(self.setup.problem, self.estimate)
        return _make_result(
            self.setup,
            self.estimate,
            errors,
            self.options.seed,
            self.watch,
            noise=noise,
            notes=self.setup.notes,
            thorough=False,
        )


def judge(fit_setup: FitSetup, estimate: Estimate, options: FitOptions, watch: Stopwatch) -> FitResult:
    """The result of a solved fit: standard errors under the noise, and the verdict."""
    problem, noise, notes = fit_setup.problem, options.noise, list(fit_setup.notes)
    if options.plain_noise:
        errors = uncertainty(problem, estimate, correlated=noise == "auto")
        slow = errors.residuals.noise if noise == "auto" and errors.residuals.correlated else None
        noise_estimate = NoiseEstimate(str(noise), slow.noise.parameters if slow else {})
    else:
        estimate, errors, noise_estimate, description = _with_noise(problem, estimate, noise)
        notes.append(description)
    notes += _mismatches(errors, noise, problem)
    return _make_result(fit_setup, estimate, errors, options.seed, watch, noise=noise_estimate, notes=notes)


def _with_noise(
    problem: Problem, estimate: Estimate, noise: str | type[AbstractNoise]
) -> tuple[Estimate, Uncertainty, NoiseEstimate, Note]:
    """The estimate refined by a noise model, its errors, the noise, and a note that describes it."""
    if problem.objective.loss != "linear":
        raise ParameterError(f"noise={noise!r} has a likelihood of its own: leave loss at 'linear'")
    refined = refine(problem, estimate.x, noise)
    label, notes = refined.noise.name, estimate.notes
    if not refined.converged:
        notes = (
            *notes,
            warn(Code.SOLVER, f"the {label} noise model did not converge: its standard errors are approximate"),
        )
    predicted = zip(problem.data, problem.predict(refined.x), strict=True)
    squares = sum(np.sum((r.weight * (r.y - y) ** 2)[r.used]) for r, y in predicted)
    cost = 0.5 * float(squares) / problem.scales.y**2
    changed = dataclasses.replace(estimate, x=refined.x, cost=cost, notes=notes, linearized=None)
    rows = zip(refined.space.names, refined.values, refined.space.units, strict=True)
    values = ", ".join(f"{name} = {value:.3g} {unit}".rstrip() for name, value, unit in rows)
    description = Note(Code.NOISE_MODEL, f"noise model {label}: {values}")
    noise_estimate = NoiseEstimate(NOISES.label(noise), refined.parameters)
    return changed, uncertainty(problem, changed, root=refined.root), noise_estimate, description


def _mismatches(errors: Uncertainty, noise: str | type[AbstractNoise], problem: Problem) -> list[Note]:
    """Notes on properties of the residuals that these standard errors do not account for."""
    if errors.sigma < ROUNDED * problem.scales.y:
        which = "those of thresholds alone have a meaning" if problem.model.jumps else "they are meaningless"
        return [Note(Code.ROUNDING, f"the residuals are rounding errors, and with them the standard errors: {which}")]
    diagnosis = diagnose(errors.residuals)
    if noise == "auto":
        found = [note for note in diagnosis.findings if note.code is not Code.CORRELATED_RESIDUALS]
        return [_outweighed(note) if may_be_robust(problem) else note for note in found]
    return [
        dataclasses.replace(note, text=f"noise={noise!r} was chosen, but {note.text}")
        for note in diagnosis.objections(NOISES.find(noise))  # type: ignore[arg-type]
    ]


def _outweighed(note: Note) -> Note:
    """The note, with a robust loss as remedy if it reports heavy tails."""
    if note.code is not Code.HEAVY_TAILS:
        return note
    return dataclasses.replace(
        note, text=f"{note.text}; with a robust loss (loss='huber') they count less", option=ROBUST_LOSS
    )


def _make_result(
    setup: FitSetup,
    estimate: Estimate,
    errors: Uncertainty,
    seed: int,
    watch: Stopwatch,
    *,
    noise: NoiseEstimate,
    notes: Sequence[Note] = (),
    thorough: bool = True,
) -> FitResult:
    problem, method = setup.problem, ESTIMATORS.label(setup.method)
    data, x = problem.data, estimate.x
    train, rows = _errors(problem, x)
    model = problem.space.assembled(x)
    baselines = Baselines.of(data)
    fitted = Fitted(problem, model, estimate, train, rows, baselines, method, choose_method(problem), thorough)
    status, reasons = verdict_of(fitted)
    compile_s, run_s = watch.read()
    result = FitResult(
        problem=problem,
        x=np.asarray(x),
        status=status,
        notes=(*reasons, *notes, *(notes_of(problem, model, estimate, errors) if thorough else estimate.notes)),
        parameters=_parameters_of(problem, x, errors),
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


def _errors(problem: Problem, x: np.ndarray) -> tuple[Metrics, list[np.ndarray]]:
    """Metrics of the prediction, and its residuals at the samples of each record that count."""
    used = [record.used for record in problem.data]
    measured = [chosen(record.y, on) for record, on in zip(problem.data, used, strict=True)]
    predicted = [chosen(y, on) for y, on in zip(problem.predict(x), used, strict=True)]
    return Metrics.of(measured, predicted), [y - m for y, m in zip(predicted, measured, strict=True)]


def _parameters_of(problem: Problem, x: np.ndarray, errors: Uncertainty) -> tuple[ParameterEstimate, ...]:
    """Every parameter for the report: free ones, those tied to them, fixed ones."""
    rows, variance, sides = parameter_estimates(problem.space, x), np.diag(errors.covariance), problem.at_bound(x)
    free = [
        dataclasses.replace(
            row,
            stderr=float(np.sqrt(square)) if np.isfinite(square) else None,
            at_bound=side,
            identifiable=bool(known) and not side,
        )
        for row, square, side, known in zip(rows, variance, sides, errors.determined, strict=False)
    ]
    tied = []
    for row, (tie, *_, k) in zip(rows[len(free) :], problem.space.tied(x), strict=False):
        of = None if k is None else free[k]
        error = None if of is None or of.stderr is None else abs(tie.factor) * of.stderr
        tied.append(dataclasses.replace(row, stderr=error, identifiable=None if of is None else of.identifiable))
    return (*free, *tied, *rows[len(free) + len(tied) :])
