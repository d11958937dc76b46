"""`compare`: which model describes these loops best, judged on data that were left out of its fit."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Any, Literal, get_args

from hystfit.config import verb
from hystfit.errors import DataError, HystfitError, ModelError, ParameterError
from hystfit.fitting.comparison.candidates import Candidates, candidates
from hystfit.fitting.comparison.compared_models import Comparison, Fits, Purpose, Row, ranked
from hystfit.fitting.comparison.comparison_run import ComparisonRun
from hystfit.fitting.comparison.left_out import CHOICES, LeftOut
from hystfit.fitting.comparison.model_search import search
from hystfit.fitting.comparison.screening import search_screened, some_records
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import without_faults
from hystfit.fitting.solvers.thinning import coarse
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import SEARCH, make_model, model_name
from hystfit.outcome.progress import ShownProgress
from hystfit.outcome.progress import progress as shown_progress
from hystfit.params.relative_size import ROUNDED
from hystfit.quality.baselines import rounding_error
from hystfit.quality.loops import turns_back
from hystfit.reading.in_memory import records_of
from hystfit.runs.threads import Workers


@verb
def compare(
    data: Any,
    models: Sequence[str | type[AbstractHysteresis] | AbstractHysteresis] | Literal["auto"] | None = None,
    *,
    left_out: LeftOut = "auto",
    purpose: Purpose = "prediction",
    seed: int = 0,
    starts: int = 8,
    progress: Callable[..., object] | None = None,
    workers: int | None = None,
) -> Comparison:
    """Fit several models and rank them by their cross-validation error.

    What is held out follows the records (`hystfit.quality.held_out`): whole records, amplitude levels, cycles, or scattered samples of a
    single loop; beside scattered samples of loops of several sizes smaller loops, and the geometric mean of both errors ranks. The input
    drives the model through what is held out, but its output is not fitted; the offset of a whole record is. Test data are not used.
    Among models within one standard error of the smallest error, those rank first whose fit converged, that have no hysteresis, of which
    the data determine fewer parameters, and that have an inverse; one that has not converged or describes the loops only roughly, or whose
    family has no inverse, must err clearly less. A model that cannot be fitted is listed with the reason. Long records that are sampled
    far finer than their signals count by the means of several samples, on which the winner is fitted too
    (`hystfit.fitting.solvers.thinning.coarse`).

    Args:
        data: one record or several, or a data frame.
        models: names as `hystfit models` lists them (joined by "+"), classes, models, or "prandtl-ishlinskii-search", which searches
            that family for its terms. A name without settings, or a class, stands for the number of elements that suits the data.
            None (or "auto") tries every family that the records can drive, those with a resonance where the response shows one, and
            stops those that cannot win: their fit errs more than the best model does in cross-validation, or their first fit errs one
            and a half times as much, or 5 % more where all its samples are held out in turn. A first fit starts from two points and is
            judged on the fitted samples; that of a model with elements has its default size, is judged by cross-validation on at most
            2048 samples or so, and stops once the choices that lowered the error of another such model would not suffice. Records that
            differ at equal inputs by more than a usable fit errs get one model, because none changes the verdict; where the residuals are
            noise and show no loop, models that iterate are left out; they are tried from those with the fewest parameters on, until
            one leaves white residuals as small as the noise of the output.
            Many records of many samples are compared on some of them, of strokes of all sizes; the best model there, and the plainest
            that these do not tell from it, are fitted to all (`hystfit.fitting.comparison.screening`).
        left_out: "auto" as above; "future" predicts the later parts of every record from fits to what came before, which tests the
            description of creep and drift. Numbers of plays and levels, and the terms of the search, are chosen as by "auto".
        purpose: "prediction"; "inverse" or "export" rank models without an inverse, or without C code, below the others.
        seed: of the starting points.
        starts: number of starting points of each fit, see `fit`.
        progress: called with a line of text and the fraction done for each model; None shows them on a terminal or in a notebook.
        workers: number of models that are fitted side by side, in threads; default: one for each core, at most four. The result
            does not depend on it.

    Raises:
        HystfitError: data or settings that cannot be used, an unknown model, or no model that could be fitted.
    """
    options = FitOptions(seed=seed, starts=starts)
    options.check()
    for what, value, known in (("left_out", left_out, CHOICES), ("purpose", purpose, get_args(Purpose))):
        if value not in known:
            raise ParameterError(f"{what} must be one of {', '.join(known)}, got {value!r}")
    data = records_of(data)
    if left_out == "future" and not turns_back(data):
        raise ModelError("reversal curves have no order in time: use left_out='auto'")
    named = _named(models) if models and models != "auto" else {}
    chosen = Candidates(tuple(named)) if named else candidates(data)
    data = coarse(without_faults(data))
    update = shown_progress("comparing models") if progress is None else contextlib.nullcontext(progress)
    with update as shown:
        run = ComparisonRun(
            data, left_out, purpose, options, named, ShownProgress(shown, chosen.names), Workers(workers)
        )
        if named:
            run.run(chosen.names)
        elif (few := some_records(data)) is not None:
            search_screened(run, few, chosen)
        else:
            search(run, chosen)
    found = run.standings
    floor = max(rounding_error(data) / found.span, ROUNDED)
    rows = ranked(found.rows, purpose, 100 * floor, equal=found.equal)
    if not found.fits:
        raise _refusal(run.errors, rows)
    best = rows[0]
    if purpose != "prediction" and not best.serves(purpose):
        reasons = "; ".join(
            f"{row.name}: {row.obstacles[purpose]}" for row in rows if row.obstacles and purpose in row.obstacles
        )
        raise ModelError(f"no model that was fitted can be used for {purpose}: {reasons}")
    fits = Fits(found.fits, run.judged)
    return Comparison(tuple(rows), fits[best.asked], fits, run.scheme, purpose)


def _refusal(errors: Sequence[Exception], rows: Sequence[Row]) -> HystfitError:
    """The error where no candidate could be fitted: what is wrong with the data, where all found the same."""
    if isinstance(errors[0], DataError) and len(set(map(str, errors))) == 1:
        return errors[0]
    return ModelError("no model could be fitted: " + "; ".join(f"{row.name}: {row.note}" for row in rows))


def _named(models: Sequence[str | type[AbstractHysteresis] | AbstractHysteresis]) -> dict[str, Any]:
    """Models by the name of their row: as it was given, or that of a class or a model, numbered where several have it."""
    chosen: dict[str, Any] = {}
    for choice in [models] if isinstance(models, str) else models:
        if isinstance(choice, str):
            if choice != SEARCH:
                make_model(choice)
            chosen[choice] = choice
            continue
        base = model_name(make_model(choice))
        count = sum(name == base or name.startswith(f"{base} (") for name in chosen)
        chosen[f"{base} ({count + 1})" if count else base] = choice
    return chosen
