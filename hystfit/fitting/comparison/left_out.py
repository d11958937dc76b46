"""Cross-validation error of a fit, with groups of samples or the future held out in turn; and BIC."""

from __future__ import annotations

import functools
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from hystfit.errors import ParameterError
from hystfit.fitting.solvers.convex import Convex
from hystfit.fitting.solvers.polish import STEPS, polish
from hystfit.fitting.solvers.registry import ESTIMATORS
from hystfit.fitting.solvers.ridge import LinearSystem, fit_ridge, linear_positions
from hystfit.fitting.solvers.smooth_weights import left_out_scores
from hystfit.inference.linearization import Linearization
from hystfit.inference.noise.slow_likelihood import Contrasts, fit_slow_noise
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import ResidualAnalysis
from hystfit.quality.held_out import FOLDS, Scheme, future
from hystfit.results.result import FitResult
from hystfit.runs.threads import Workers

# Part of the effect of a parameter on all samples, below which the others do not determine it, such as an initial state that they have
# forgotten: its standard error would be a hundred times as large.
_LOST = 0.01
# Distance from the minimum, in standard errors, at which a refit has converged. Models in error approach it slowly: five refits of
# `steel-02` to a coupon took 221 linearizations, 453 to 0.001, for an error on the held-out samples that differs by 4e-5 of it.
_WITHIN = 0.1
LeftOut = Literal["auto", "future"]
CHOICES: tuple[str, ...] = get_args(LeftOut)


def left_out_error(result: FitResult, left_out: LeftOut = "auto", most: float = np.inf) -> float:
    """Weighted root mean square error on samples held out of refits, output units.

    Args:
        result: the fit of all data; refits start there.
        left_out: "auto" holds out what suits the records (`hystfit.quality.held_out`); "future" predicts the third, fourth and fifth
            part of every record from a fit to what came before, which tests whether creep and drift are understood. The offset of a
            record that is held out as a whole is fitted to it; its other own parameters, such as an initial state, keep the values of
            the fit of all data.
        most: error that is of interest [y]; refits end, and the error is infinite, once it is larger.
    """
    if left_out not in CHOICES:
        raise ParameterError(f"left_out must be one of {', '.join(CHOICES)}, got {left_out!r}")
    problem, x = result.problem, result.x
    if left_out == "future":
        parts = future(list(problem.data)).folds
        splits = [([f < k for f in parts], [f == k for f in parts]) for k in range(2, FOLDS)]
        return _refitted(result.method, problem, x, splits, most)
    if result.left_out is not None and len(linear_positions(problem)):
        return result.left_out  # by which the fit chose its regularization
    return _held_out_error(result.method, problem, x, most)


def inner_error(result: FitResult, error: float, most: float = np.inf) -> float | None:
    """Error on `inner_loops` [y]; None where other groups than scattered samples are held out, or all loops are of one size.

    Models are ranked by the geometric mean of this and the `error` on scattered samples; it is infinite where their mean exceeds `most`.
    """
    problem = result.problem
    inner = problem.by_inner_loops() if problem.held_out.scheme is Scheme.SCATTERED else None
    return None if inner is None else _held_out_error(result.method, inner, result.x, most**2 / max(error, 1e-300))


def _held_out_error(method: str, problem: Problem, x: np.ndarray, most: float) -> float:
    """Error on the groups that are held out of a problem whose fit is x; see `left_out_error`."""
    if method == "preisach":
        return left_out_scores(problem, x).held
    if isinstance(estimator := ESTIMATORS.make(method), Convex) and len(linear_positions(problem)):
        return float(fit_ridge(LinearSystem.of(problem, x), estimator.strengths).score)
    return _refitted(method, problem, x, problem.held_out.splits(), most)


def _refitted(
    method: str,
    problem: Problem,
    x: np.ndarray,
    splits: list[tuple[list[np.ndarray], list[np.ndarray]]],
    most: float,
) -> float:
    """Error on the held-out side of each split, of refits to its other side that start from physical x.

    Parameters that the other side does not determine keep their value in x. Infinite where it is larger than `most`.
    """
    z, workers = problem.space.unconstrained(problem.space.clip(x)), Workers()
    descends = method == "lm" or (method == "convex" and not len(linear_positions(problem)))
    effects = _effects(problem.linearization(x)) if descends else np.zeros(0)
    held = [
        (mask & record.used, record) for _, asked in splits for mask, record in zip(asked, problem.data, strict=True)
    ]
    squares, total = 0.0, sum(float(record.weight[mask].sum()) for mask, record in held)

    def refitted(seen: list[np.ndarray], asked: list[np.ndarray]) -> float:
        """Squares of the errors on the asked side."""
        training = problem.reweighted([r.weight * mask for mask, r in zip(seen, problem.data, strict=True)])
        if descends:
            known = training.linearization(x)
            lost = _effects(known) < _LOST * effects
            fitted = training.space.physical(
                polish(training, z, STEPS, _WITHIN, held=lost, step_on=True, known=known).z
            )
        else:
            fitted = ESTIMATORS.make(method).estimate(training, z[None]).x
        predicted, missed = training.predict(_with_absent_records(problem, x, fitted, training.idle)), 0.0
        for mask, record, y in zip(asked, problem.data, predicted, strict=True):
            at = mask & record.used
            with np.errstate(over="ignore"):  # of a refit that diverges
                missed += float(np.sum(record.weight[at] * (y - record.y)[at] ** 2))
        return missed

    for begin in range(0, len(splits), workers.count):
        squares += sum(workers.run([functools.partial(refitted, *split) for split in splits[begin:][: workers.count]]))
        if squares > most**2 * total:
            return np.inf
    return float(np.sqrt(squares / total)) if total else float("nan")


def _effects(linear: Linearization) -> Float[np.ndarray, " p"]:
    """Root of the sum of squared changes of the samples that count by each parameter."""
    return np.linalg.norm(linear.triangle(), axis=0)


def _with_absent_records(
    problem: Problem, x: np.ndarray, fitted: np.ndarray, idle: np.ndarray
) -> Float[np.ndarray, " p"]:
    """Fitted parameters, (p,), but those of records absent from the fit (`idle`): offsets that fit them best, else their values in x."""
    changed, shifts = np.where(idle, x, fitted), idle & problem.space.offsets
    if not shifts.any():
        return changed
    residual, jacobian = problem.linearize(changed)
    root = np.sqrt(np.asarray(problem.objective.batch.weight))
    owner = np.array([-1 if record is None else record for *_, record in problem.space.sources])
    for record in np.unique(owner[shifts]):
        at = np.flatnonzero(shifts & (owner == record))
        weighted = root[record][:, None] * np.column_stack([jacobian[record][:, at], residual[record]])
        changed[at] -= np.linalg.lstsq(weighted[:, :-1], weighted[:, -1])[0]
    return changed


def bic(result: FitResult) -> float:
    """Bayesian information criterion  -2 log L + p log n  under slow (Ornstein-Uhlenbeck) and independent noise (Schwarz 1978).

    L is taken at the least-squares estimate, with the most likely noise there: independent noise would count autocorrelated samples as
    independent information. p counts the free parameters that are on no bound, and three of the noise; smoothed weights count in full,
    to the disadvantage of models with many. Only differences on the same data are meaningful.
    """
    problem, x = result.problem, result.x
    weighted = problem.residuals(x) * np.sqrt(np.asarray(problem.objective.batch.weight))
    residuals = ResidualAnalysis.of(problem.setting, weighted.reshape(-1))
    none = np.zeros((residuals.residual.size, 0))
    contrasts = Contrasts(residuals.samples, residuals.residual, none, none)
    noise, n = fit_slow_noise(contrasts).noise, residuals.residual.size
    point = np.array([(noise.white / noise.slow) ** 2]), np.array([noise.time])
    deviance = float(contrasts.at(*point)[0][0]) + n * (1 + np.log(2 * np.pi))
    deviance -= float(np.sum(np.log(residuals.samples.weight)))
    count = np.count_nonzero(~problem.on_bound(x)) + 3
    return float(deviance + count * np.log(n))
