"""`hystfit.fit`: convert the data to records, choose the model, and fit it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from inspect import signature
from typing import Any

from hystfit.config import verb
from hystfit.data.dataset import Dataset
from hystfit.errors import ParameterError
from hystfit.fitting.comparison.compare import compare
from hystfit.fitting.comparison.compared_models import Purpose
from hystfit.fitting.fit_model import fit_model
from hystfit.fitting.fit_options import DEFAULT_OPTIONS, FitOptions, Start
from hystfit.fitting.solvers.estimate import AbstractEstimator
from hystfit.fitting.solvers.registry import is_sequential
from hystfit.fitting.trial import carried_over, with_left_out, with_test
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.objective import Loss
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Code, Note, Status
from hystfit.outcome.note import warn
from hystfit.reading.frames import is_frame
from hystfit.reading.in_memory import records_of
from hystfit.reading.read import read
from hystfit.results.result import FitResult

_SEQUENTIAL_MODEL = "duhem"  # the model for "auto" with a sequential identifier
_READ_OPTIONS = signature(read).parameters


@verb
def fit(
    model: AbstractHysteresis | type[AbstractHysteresis] | str,
    data: Any = None,
    y: Any = None,
    t: Any = None,
    *,
    u: Any = None,
    method: str | AbstractEstimator = "auto",
    fix: Sequence[str] | Mapping[str, Any] = (),
    free: Sequence[str] = (),
    start: Start = "data",
    starts: int = 8,
    seed: int = 0,
    loss: Loss = "linear",
    noise: str | type[AbstractNoise] = "auto",
    covariates: Mapping[str, str | Sequence[str]] | Sequence[str] = (),
    tie: Mapping[str, str] | None = None,
    test: Any = None,
    **settings: Any,
) -> FitResult:
    """Fit a model to measured loops by least squares on its simulated output, or by a sequential identifier.

    `fit(model, record)`, `fit(model, frame)` and `fit(model, u, y, t)` are the same for records, data frames and arrays.

    Args:
        model: a model, its class, its name (see `hystfit models`), or "auto": the winner of `compare`, refitted under `noise` unless that
            is "auto"; the other options that apply are `starts`, `seed` and `test`. "prandtl-ishlinskii-search" chooses the terms of that
            family by cross-validation.
        data: a record, several, or a data frame (pandas, polars, a dictionary of columns); or the input, shape (T,). Windows are set
            by `Record.window`.
        y: output, shape (T,); or its column in a data frame, by name or number, recognized by default.
        t: time of each sample [s], shape (T,), or a column of a data frame; models that depend on time need it.
        u: column of the input in a data frame; or the input itself, shape (T,), as a keyword.
        method: "lm", "dogleg" (optimistix), "trf" (scipy, bounded), "lbfgsb" (jaxopt, bounded), "convex"
            (weights in closed form), "preisach" (the same for smooth Preisach weights), my_method.py:MyEstimator, or an
            estimator; "auto" takes "preisach" or "convex" for many linear weights, else "lm". The sequential methods "rls",
            "gradient-correction" and "ukf" (or your own) take only `seed`, `test` and their own settings.
        fix: parameters that are not fitted: names with values ({"c": 0.15}), or names alone, which keep the value of the model, or the one
            estimated from the records if `start` is "data" and the model is given by name.
        free: parameters to fit that the model fixes by default.
        start: "data" estimates starting values from the records, "model" takes the model's own; values by name ({"tau": 0.01}) replace
            those estimated from the records.
        starts: number of starting points: the data-driven one, and a Latin hypercube about it; for a model that estimates several
            starting points from the records, the largest number of these.
        seed: random seed of the starting points.
        loss: "linear", or a robust loss ("huber", "soft-l1", "cauchy") that reduces the influence of errors above 1 % of the range.
        noise: "auto" keeps the least-squares estimate; where its residuals are autocorrelated, its standard errors are those under
            slow (Ornstein-Uhlenbeck) and independent noise estimated from them. "iid" treats residuals as independent. "ou" (slow and
            independent noise), "ar1", "student-t", "discrepancy" (model error that recurs every loop), my_noise.py:MyNoise or a
            class refit by maximum likelihood under that noise model: "ou" is more precise under slow noise, and "discrepancy" is needed if
            errors recur every loop (a note says so).
        covariates: parameters that depend linearly on a constant of each record, {"T_degC": ["kappa_x", "c"]} or "T_degC:kappa_x,c". Its
            value comes from the metadata of the record, which include constant columns of its file, or from its name; see
            `hystfit.models.Varying`. The result has the parameters at the mean of the covariate, and their slopes ("kappa_x/T_degC").
        tie: parameters that follow from others: a number times a parameter plus a number ({"k2": "2*k1", "gamma[1]": "gamma[0]"}).
        test: records, or a data frame with the same columns, on which the error is reported; they are not fitted.
        **settings: settings of a sequential identifier, see `hystfit.identify`.

    Returns:
        A result with a status; check `usable` and `notes` before using its numbers.

    Raises:
        HystfitError: data, names or settings that cannot be used; the message names the remedy.
    """
    if isinstance(data, str | AbstractHysteresis) and not isinstance(model, str | type | AbstractHysteresis):
        name = repr(data) if isinstance(data, str) else type(data).__name__ + "()"
        raise ParameterError(f"the model comes first, then the data: hystfit.fit({name}, data)")
    if of_read := [name for name in settings if name in _READ_OPTIONS and not is_sequential(method)]:
        raise ParameterError(
            f"{of_read[0]}= is an option of hystfit.read, which takes files and data frames: "
            f"hystfit.fit(model, hystfit.read(data, {of_read[0]}=...))"
        )
    records = records_of(data, y, t, u=u)
    tested = None if test is None else records_of(test, y, t, u=u) if is_frame(test) else records_of(test)
    options = FitOptions(method, fix, free, start, starts, seed, loss, noise, covariates, tie)
    if isinstance(model, str) and model == "auto" and is_sequential(method):
        model = _SEQUENTIAL_MODEL
    if isinstance(model, str) and model == "auto":
        options.check_search(settings)
        result = best_model(records, options)
    else:
        result = fit_model(model, records, options, **settings)
    return result if tested is None else with_test(result, tested)


def best_model(data: Dataset, options: FitOptions = DEFAULT_OPTIONS, purpose: Purpose = "prediction") -> FitResult:
    """The fit of the model that wins the comparison, with notes on the choice; of the options, starts, seed and noise have an effect."""
    comparison = compare(data, purpose=purpose, seed=options.seed, starts=options.starts)
    failed = [row for row in comparison.rows if row.status is Status.FAILED]
    left_out = [warn(Code.LEFT_OUT, f"{row.name}: {row.note}") for row in failed]
    winner = comparison.winner
    if options.noise != "auto":
        winner = _under_noise(winner, data, options)
    return winner.with_notes(Note(Code.CHOICE, comparison.reason), *left_out, first=True)


def _under_noise(winner: FitResult, data: Dataset, options: FitOptions) -> FitResult:
    """The winner refitted from its own values under the noise of the options; it keeps its structure and cross-validation error."""
    result = fit_model(winner.model, data, dataclasses.replace(options, start="model"))
    result = result if winner.left_out is None else with_left_out(result, winner.left_out)
    return carried_over(result, winner)
