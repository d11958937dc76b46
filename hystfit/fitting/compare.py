"""`compare`: which model describes these loops best, judged on data that were left out of its fit."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np

from hystfit.config import require_seed, require_x64
from hystfit.data.record import Dataset
from hystfit.errors import DataError, HystfitError, ModelError, ParameterError
from hystfit.fitting.fit import fit
from hystfit.fitting.left_out import SCHEMES, Scheme, bic, left_out_error
from hystfit.fitting.structure import search_structure
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import compared, make_model, model_name
from hystfit.outcome import Code, Column, Note, Status, Table, fragment
from hystfit.quality.loops import loop_area
from hystfit.quality.reversal_curves import recognize_family
from hystfit.reading.in_memory import records_of
from hystfit.results.result import FitResult

SCHEMA = "hystfit.compare/1"
SEARCH = "prandtl-ishlinskii-search"
_OTHER_PLAYS = (10, 40)  # tried beside the 20 of the search, and taken if they pay
_WORDS = {
    "blocks": "on contiguous blocks (or records) that the fit did not see",
    "future": "on the last three fifths of each record, each fifth predicted from a fit to what came before it",
}


@dataclasses.dataclass(frozen=True)
class Row:
    """One model in a comparison.

    Attributes:
        name: what was asked for.
        score_percent: error on data left out, in percent of the output's range; None where it failed.
        in_sample_percent, max_error_percent: on the samples fitted.
        parameters: number of free ones.
        seconds: what fit and validation took.
        status: of the fit, or "failed".
        note: the structure found, or why it failed.
        bic: Bayesian information criterion, see `hystfit.fitting.left_out.bic`; None where it failed.
    """

    name: str
    score_percent: float | None
    in_sample_percent: float | None
    max_error_percent: float | None
    parameters: int | None
    seconds: float
    status: Status
    note: str = ""
    bic: float | None = None


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A ranking: rows from best to worst, and the fit of the best.

    Attributes:
        rows: one for each model.
        winner: the fitted result of the first row.
        fits: every fit that succeeded, by name.
        left_out: what was left out, "blocks" or "future".
    """

    rows: tuple[Row, ...]
    winner: FitResult
    fits: dict[str, FitResult]
    left_out: Scheme = "blocks"

    def text(self) -> str:
        """The table as text."""
        wide = max(32, *(len(row.name) for row in self.rows))
        head = f"{'model':<{wide}} {'left out %':>10} {'fitted %':>9} {'max %':>7} {'params':>6} {'BIC above':>9} {'seconds':>8}  status"
        lines = [
            f"Error in percent of the output's range; 'left out': {_WORDS[self.left_out]}.",
            "'BIC above': difference to the smallest, under slow and independent noise; more than ten is strong evidence against a model.",
            head,
        ]
        least = min((row.bic for row in self.rows if row.bic is not None), default=0.0)
        number = lambda value, width, form: f"{'-':>{width}}" if value is None else f"{value:>{width}{form}}"
        for row in self.rows:
            cells = (
                number(row.score_percent, 10, ".3f"),
                number(row.in_sample_percent, 9, ".3f"),
                number(row.max_error_percent, 7, ".2f"),
                number(row.parameters, 6, "d"),
                number(None if row.bic is None else row.bic - least, 9, ".1f"),
                number(row.seconds, 8, ".1f"),
            )
            lines.append(f"{row.name:<{wide}} {' '.join(cells)}  {row.status}{': ' + row.note if row.note else ''}")
        lines.append(f"winner: {self.rows[0].name}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        percent = [Column("left out %", form=".3f"), Column("fitted %", form=".3f"), Column("max %", form=".2f")]
        columns = ["model", *percent, Column("parameters"), Column("status", left=True), Column("note", left=True)]
        keys = ("name", "score_percent", "in_sample_percent", "max_error_percent", "parameters", "status", "note")
        table = Table(columns, [[getattr(row, key) for key in keys] for row in self.rows])
        explained = f"Error in percent of the output's range; 'left out': {_WORDS[self.left_out]}."
        return fragment(f"winner: {self.rows[0].name}", (explained, table))

    def to_dict(self) -> dict[str, Any]:
        """For `result.json`."""
        return {
            "schema": SCHEMA,
            "status": self.winner.status,
            "winner": self.rows[0].name,
            "left_out": self.left_out,
            "rows": [dataclasses.asdict(row) for row in self.rows],
            "provenance": self.winner.provenance,
        }


def compare(
    data: Any,
    models: Sequence[str | type[AbstractHysteresis] | AbstractHysteresis] | Literal["auto"] | None = None,
    *,
    left_out: Scheme = "blocks",
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Comparison:
    """Fit several models and rank them by their error on data left out.

    Whole records are left out in turn where there are three or more, else five contiguous blocks of each: the input drives the
    model through a block, its output is not fitted. Samples are never left out one by one, because their neighbors give them away.
    Test data never enter.

    Args:
        data: one record or several, or a data frame.
        models: names as `hystfit models` lists them (joined by "+"), classes, models, or "prandtl-ishlinskii-search", which searches
            that family for its terms; None (or "auto") takes a choice that suits the data.
        left_out: "blocks" as above; "future" predicts the later parts of every record from fits to what came before, which
            tests the description of creep and drift. Numbers of plays and levels, and the terms of the search, are chosen on blocks.
        seed: of the starting points.
        progress: called with a line of text for each model.

    Raises:
        HystfitError: data or settings that cannot be used, an unknown model, or no model that could be fitted.
    """
    require_x64()
    require_seed(seed)
    if left_out not in SCHEMES:
        raise ParameterError(f"left_out must be one of {', '.join(SCHEMES)}, got {left_out!r}")
    data = records_of(data)
    if left_out == "future" and recognize_family(data) is not None:
        raise ModelError("reversal curves have no order in time: use left_out='blocks'")
    chosen = _named(models) if models and models != "auto" else {name: name for name in candidates(data)}
    rows, fits = [], {}
    for number, (name, choice) in enumerate(chosen.items(), start=1):
        if progress:
            progress(f"{name} ({number} of {len(chosen)})")
        row, result = _judge(name, choice, data, seed, left_out)
        rows.append(row)
        if result is not None:
            fits[name] = result
    if not fits:
        raise ModelError("no model could be fitted: " + "; ".join(f"{row.name}: {row.note}" for row in rows))
    rows.sort(
        key=lambda row: (
            row.status in (Status.FAILED, Status.NO_LOOP),
            row.score_percent is None,
            row.score_percent or 0.0,
        )
    )
    return Comparison(tuple(rows), fits[rows[0].name], fits, left_out)


def _named(models: Sequence[str | type[AbstractHysteresis] | AbstractHysteresis]) -> dict[str, Any]:
    """Models by the name of their row: as it was given, or that of a class or a model, numbered where several have it.

    Raises:
        ModelError: one of them is no model.
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


def candidates(data: Dataset) -> tuple[str, ...]:
    """Models worth comparing: output that lags (counter-clockwise loops) and force that leads call for different ones."""
    if recognize_family(data) is not None:
        return compared("reversal-curves")
    lags = sum(loop_area(record.u[record.used], record.y[record.used]) for record in data) > 0
    timed = all(record.t is not None for record in data)
    return (*compared(("lagging-timed" if timed else "lagging-untimed") if lags else "leading"), SEARCH)


def _judge(name: str, choice: Any, data: Dataset, seed: int, left_out: Scheme) -> tuple[Row, FitResult | None]:
    started = time.perf_counter()
    try:
        if name == SEARCH:
            result, score, note = best_structure(data, seed)
        else:
            model = make_model(choice)
            # A model that is given, and settings in a name, give the size; the colon of my_model.py:MyModel is none.
            sized = isinstance(choice, AbstractHysteresis) or ":" in name.replace(".py:", "")
            sizes = {} if sized else model.sizes()
            result, score, note = best_size(sizes, data, seed) if sizes else (fit(model, data, seed=seed), None, "")
        if score is None or left_out != "blocks":
            score = left_out_error(result, left_out)
        criterion = bic(result)
    except DataError:
        raise
    except HystfitError as error:
        return Row(name, None, None, None, None, time.perf_counter() - started, Status.FAILED, str(error)), None
    span = _span(data)
    row = Row(
        name,
        100 * score / span if np.isfinite(score) else None,
        result.train.nrmse_percent,
        result.train.max_error_percent,
        len(result.free_names),
        time.perf_counter() - started,
        result.status,
        note,
        criterion if np.isfinite(criterion) else None,
    )
    return row, result


def _span(data: Dataset) -> float:
    y = np.concatenate([record.y[record.used] for record in data])
    return float(np.ptp(y)) or 1.0


def best_structure(data: Dataset, seed: int) -> tuple[FitResult, float, str]:
    """The Prandtl-Ishlinskii model whose terms and number of plays blocks left out choose: (fit, left-out error, terms in words)."""
    search = search_structure(data)
    best = min((search.resized(data, plays) for plays in _OTHER_PLAYS), key=lambda f: f.score)
    best = best if best.score < 0.98 * search.score else search
    result = fit(best.model, data, start="model", seed=seed)
    texts = (
        f"structure: {best.structure.words()}, {best.plays} plays",
        *(f"structure search: {step}" for step in best.trail),
    )
    return result.with_notes(*(Note(Code.CHOICE, text) for text in texts)), best.score, best.structure.words()


def best_size(sizes: dict[str, AbstractHysteresis], data: Dataset, seed: int) -> tuple[FitResult, float, str]:
    """The fit of the size that blocks left out choose, its left-out error, and the size in words.

    Args:
        sizes: models by their size in words; the first one is kept unless another is clearly better.
        data: records.
        seed: of the starting points.
    """
    fits = [fit(model, data, seed=seed) for model in sizes.values()]
    scores = [left_out_error(result) for result in fits]
    best = int(np.argmin(scores)) if min(scores) < 0.98 * scores[0] else 0
    note = list(sizes)[best]
    return fits[best].with_notes(Note(Code.CHOICE, f"structure: {note}")), scores[best], note
