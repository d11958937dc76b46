"""`compare`: which model describes these loops best, judged on data that were left out of its fit."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, get_args

from hystfit.config import verb
from hystfit.errors import ModelError, ParameterError
from hystfit.fitting.candidates import Candidates, candidates
from hystfit.fitting.comparison import STRONG, Comparison, Fits, Purpose, Row, handicap
from hystfit.fitting.comparison_progress import ShownProgress
from hystfit.fitting.comparison_run import ComparisonRun
from hystfit.fitting.comparison_search import search
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import without_faults
from hystfit.fitting.left_out import CHOICES, LeftOut
from hystfit.fitting.verdict import turns_back
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import SEARCH, make_model, model_name
from hystfit.models.starting import output_range
from hystfit.outcome import Status
from hystfit.outcome.progress import progress as shown_progress
from hystfit.quality.baselines import rounding_error
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
    single loop. The input drives the model through what is held out, but its output is not fitted; the offset of a whole record is.
    Test data are not used. Among models within one standard error of the smallest error, those rank first whose fit converged, of which
    the data determine fewer parameters, and that have an inverse; one that has not converged, or whose family has no inverse, must err
    clearly less. A model that cannot be fitted is listed with the reason.

    Args:
        data: one record or several, or a data frame.
        models: names as `hystfit models` lists them (joined by "+"), classes, models, or "prandtl-ishlinskii-search", which searches
            that family for its terms. A name without settings, or a class, stands for the number of elements that suits the data.
            None (or "auto") tries every family that the records can drive, those with a resonance where the response shows one, and
            stops those that cannot win: their fit errs more than the best model does in cross-validation, or their first fit errs one
            and a half times as much, or 5 % more where all its samples are held out in turn. A first fit starts from two points and is
            judged on the fitted samples; that of a model with elements has its default size, is judged by cross-validation on at most
            2048 samples or so, and stops once the choices that lowered the error of another such model would not suffice.
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
    data = without_faults(data)
    update = shown_progress("comparing models") if progress is None else contextlib.nullcontext(progress)
    with update as shown:
        run = ComparisonRun(
            data, left_out, purpose, options, named, ShownProgress(shown, chosen.names), Workers(workers)
        )
        if named:
            run.run(chosen.names)
        else:
            search(run, chosen)
    rows = _ranked(run.rows, purpose, 100 * rounding_error(data) / output_range(data).width, equal=run.equal)
    if not run.fits:
        raise run.refusal(rows)
    best = rows[0]
    if purpose != "prediction" and not best.serves(purpose):
        reasons = "; ".join(
            f"{row.name}: {row.obstacles[purpose]}" for row in rows if row.obstacles and purpose in row.obstacles
        )
        raise ModelError(f"no model that was fitted can be used for {purpose}: {reasons}")
    fits = Fits(run.fits, run.judged)
    return Comparison(tuple(rows), fits[best.asked], fits, run.scheme, purpose)


def _named(models: Sequence[str | type[AbstractHysteresis] | AbstractHysteresis]) -> dict[str, Any]:
    """Models by the name of their row: as it was given, or that of a class or a model, numbered where several have it.

    Raises:
        ModelError: one of them is not a model.
    """
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


def _ranked(rows: Sequence[Row], purpose: Purpose, floor: float = 0.0, *, equal: float = 1.0) -> list[Row]:
    """From best to worst; among errors that do not differ, converged fits, those without strong evidence against them by BIC, fewer
    determined parameters and an inverse come first.

    A few large errors decide held-out errors, which then do not differ, though one model describes all other samples better.

    Args:
        rows: of the models.
        purpose: of the choice.
        floor: error up to which they do not differ [percent of range], that of rounding, which recurs where the cycles repeat.
        equal: ratio to the smallest error up to which they do not differ.
    """
    ranked = sorted(rows, key=lambda row: _rank(row, purpose))
    if not ranked or ranked[0].score_percent is None:
        return ranked
    least = ranked[0].ranked_percent or 0.0
    kind = _rank(ranked[0], purpose)[:-1]
    most = max(equal * least, floor)
    alike = [row for row in ranked if _rank(row, purpose)[:-1] == kind and (row.ranked_percent or 0.0) <= most]
    plain = lambda row: (row.effective or row.parameters or 0, not row.family_inverts, row.score_percent)
    # Rounding errors are no evidence.
    bics = [row.bic for row in alike if row.bic is not None] if equal * least > floor else []
    limit = min(bics, default=math.inf) + STRONG
    unlikely = lambda row: row.bic is not None and row.bic > limit
    simple = sorted(alike, key=lambda row: (row.status is Status.NOT_CONVERGED, unlikely(row), *plain(row)))
    return simple + ranked[len(alike) :]


def _rank(row: Row, purpose: Purpose) -> tuple[Any, ...]:
    """Validated models first, then those that serve the purpose, then the smallest error on left-out data."""
    return (
        row.in_sample_percent is None,
        row.status is Status.UNTESTED,
        row.status is Status.NO_LOOP,
        purpose != "prediction" and not row.serves(purpose),
        row.score_percent is None,
        row.ranked_percent or (row.in_sample_percent or 0.0) * handicap(row.status, row.family_inverts),
    )
