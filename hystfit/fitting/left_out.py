"""What a model is worth on data that its fit did not see: blocks left out in turn, or the future left out; and BIC."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from hystfit.errors import ParameterError
from hystfit.fitting.again import problem_of
from hystfit.fitting.convex import Convex, LinearSystem, fit_ridge, left_out_blocks, linear_positions
from hystfit.fitting.covariance import near_bound
from hystfit.fitting.fit import ESTIMATORS
from hystfit.fitting.smooth_weights import left_out_score
from hystfit.inference.noise.serial import Contrasts, fit_slow_noise
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import Leftover
from hystfit.results.result import FitResult

Scheme = Literal["blocks", "future"]
SCHEMES: tuple[str, ...] = get_args(Scheme)
_PARTS = 5  # of each record; the future begins after the second


def left_out_error(result: FitResult, scheme: Scheme = "blocks") -> float:
    """Root mean square error on data left out of refits, output units; pointwise schemes would be fooled by correlated residuals.

    Args:
        result: the fit of all data; refits start there, which saves the search for the basin.
        scheme: "blocks" leaves out in turn whole records where there are three or more, else contiguous fifths of each; "future"
            predicts the third, fourth and fifth part of every record from a fit to what came before (Buerkner et al. 2020), which asks
            whether creep and drift are understood.

    Raises:
        ParameterError: an unknown scheme.
    """
    if scheme not in SCHEMES:
        raise ParameterError(f"left_out must be one of {', '.join(SCHEMES)}, got {scheme!r}")
    problem, x = problem_of(result, as_fitted=True)
    if scheme == "future":
        return _refitted(result.method, problem, x, _futures(problem))
    if result.method == "preisach":
        return left_out_score(problem, x)
    if result.method == "convex" and len(linear_positions(problem)):
        system = LinearSystem.of(problem, x)
        return fit_ridge(system, Convex().strengths).score
    blocks = left_out_blocks(problem)
    splits = [
        ([b != k for b in blocks], [b == k for b in blocks]) for k in range(max(int(b.max()) for b in blocks) + 1)
    ]
    return _refitted(result.method, problem, x, splits)


def _futures(problem: Problem) -> list[tuple[list[np.ndarray], list[np.ndarray]]]:
    """(samples to fit, samples to predict), one mask a record, for each part of the future."""
    parts = [record.blocks(_PARTS) for record in problem.data]
    before = lambda k: [np.any(own[:k], axis=0) for own in parts]
    return [(before(k), [own[k] for own in parts]) for k in range(2, _PARTS)]


def _refitted(
    method: str, problem: Problem, x: np.ndarray, splits: list[tuple[list[np.ndarray], list[np.ndarray]]]
) -> float:
    """Error of refits, from physical x on, to one side of each split on its other side."""
    c = problem.space.coordinates
    z = problem.space.unconstrained(np.clip(x, np.asarray(c.lower), np.asarray(c.upper)))
    name = "lm" if method == "convex" and not len(linear_positions(problem)) else method
    squares, count = 0.0, 0
    for seen, asked in splits:
        own = problem.reweighted([r.weight * mask for mask, r in zip(seen, problem.data, strict=True)])
        predicted = own.predict_at(ESTIMATORS[name].estimate(own, z[None]).x)
        for mask, record, y in zip(asked, problem.data, predicted, strict=True):
            held = mask & record.used
            squares += float(np.sum((y - record.y)[held] ** 2))
            count += int(held.sum())
    return float(np.sqrt(squares / count)) if count else float("nan")


def bic(result: FitResult) -> float:
    """Bayesian information criterion  -2 log L + p log n  under slow (Ornstein-Uhlenbeck) and independent noise (Schwarz 1978).

    L is taken at the least-squares estimate, with the noise that is most likely there: independent noise would count
    correlated samples as if each were news. p counts free parameters that are on no bound and three of the noise; smoothed weights
    count in full, so that it speaks against models of many. Only differences on the same data mean something.
    """
    problem, x = problem_of(result)
    residuals = [y - record.y for y, record in zip(problem.predict_at(x), problem.data, strict=True)]
    batch = problem.objective.batch
    weighted = np.zeros(batch.u.shape)
    for row, own in zip(weighted, residuals, strict=True):
        row[: own.size] = own
    weighted *= np.sqrt(np.asarray(batch.weight))
    left = Leftover.of(batch, weighted.reshape(-1))
    none = np.zeros((left.residual.size, 0))
    contrasts = Contrasts(left.samples, left.residual, none, none)
    noise, n = fit_slow_noise(contrasts).noise, left.residual.size
    deviance = contrasts.at((noise.white / noise.slow) ** 2, noise.time)[0] + n * (1 + np.log(2 * np.pi))
    deviance -= float(np.sum(np.log(left.samples.weight)))
    count = sum(side is None for side in near_bound(problem, x)) + 3
    return float(deviance + count * np.log(n))
