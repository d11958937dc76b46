"""`compare`: which model describes these loops best, judged on contiguous blocks that were left out of its fit."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hystfit.config import require_x64
from hystfit.data.loops import loop_area
from hystfit.data.record import Dataset, Record
from hystfit.data.reversal import recognize_family
from hystfit.errors import DataError, HystfitError, ModelError
from hystfit.fitting.convex import Convex, LinearSystem, fit_ridge, left_out_blocks, linear_positions
from hystfit.fitting.fit import ESTIMATORS, fit
from hystfit.fitting.preisach_system import PreisachSystem
from hystfit.fitting.smooth import SMOOTHNESS, fit_smooth
from hystfit.fitting.structure import search_structure
from hystfit.models.preisach import Preisach
from hystfit.models.registry import make_model
from hystfit.problem import Problem
from hystfit.results import FitResult

SCHEMA = "hystfit.compare/1"
SEARCH = "prandtl-ishlinskii-search"
_OTHER_PLAYS = (10, 40)  # tried beside the 20 of the search, and taken if they pay
_OTHER_LEVELS = (16, 24)  # tried beside a Preisach model's own, and taken if they pay


@dataclasses.dataclass(frozen=True)
class Row:
    """One model in a comparison.

    Attributes:
        name: what was asked for.
        score_percent: error on blocks left out, in percent of the output's range; None where it failed.
        in_sample_percent, max_error_percent: on the samples fitted.
        parameters: number of free ones.
        seconds: what fit and validation took.
        status: of the fit, or "failed".
        note: the structure found, or why it failed.
    """

    name: str
    score_percent: float | None
    in_sample_percent: float | None
    max_error_percent: float | None
    parameters: int | None
    seconds: float
    status: str
    note: str = ""


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A ranking: rows from best to worst, and the fit of the best.

    Attributes:
        rows: one for each model.
        winner: the fitted result of the first row.
        fits: every fit that succeeded, by name.
    """

    rows: tuple[Row, ...]
    winner: FitResult
    fits: dict[str, FitResult]

    def text(self) -> str:
        """The table as text."""
        head = f"{'model':<32} {'left out %':>10} {'fitted %':>9} {'max %':>7} {'params':>6} {'seconds':>8}  status"
        lines = [
            "Error in percent of the output's range; 'left out': on contiguous blocks that the fit did not see.",
            head,
        ]
        number = lambda value, width, form: f"{'-':>{width}}" if value is None else f"{value:>{width}{form}}"
        for row in self.rows:
            cells = (
                number(row.score_percent, 10, ".3f"),
                number(row.in_sample_percent, 9, ".3f"),
                number(row.max_error_percent, 7, ".2f"),
                number(row.parameters, 6, "d"),
                number(row.seconds, 8, ".1f"),
            )
            lines.append(f"{row.name:<32} {' '.join(cells)}  {row.status}{': ' + row.note if row.note else ''}")
        lines.append(f"winner: {self.rows[0].name}")
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.text()

    def to_dict(self) -> dict[str, Any]:
        """For `result.json`."""
        return {
            "schema": SCHEMA,
            "status": self.winner.status,
            "winner": self.rows[0].name,
            "rows": [dataclasses.asdict(row) for row in self.rows],
            "provenance": self.winner.provenance,
        }


def compare(
    data: Record | Dataset | Sequence[Record],
    models: Sequence[str] | None = None,
    *,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Comparison:
    """Fit several models and rank them by their error on data left out.

    Whole records are left out in turn where there are three or more, else five contiguous blocks of each: the input drives the
    model through a block, its output is not fitted. Test data never enter.

    Args:
        data: one record or several.
        models: names as `hystfit models` lists them (joined by "+"), or "prandtl-ishlinskii-search", which searches that
            family for its terms; None takes a choice that suits the data.
        seed: of the starting points.
        progress: told what is being done.

    Raises:
        HystfitError: data that cannot be used, an unknown model, or no model that could be fitted.
    """
    require_x64()
    data = Dataset.of(data)
    names = tuple(models) if models else candidates(data)
    for name in names:
        if name != SEARCH:
            make_model(name)
    rows, fits = [], {}
    for number, name in enumerate(names, start=1):
        if progress:
            progress(f"{name} ({number} of {len(names)})")
        row, result = _judge(name, data, seed)
        rows.append(row)
        if result is not None:
            fits[name] = result
    if not fits:
        raise ModelError("no model could be fitted: " + "; ".join(f"{row.name}: {row.note}" for row in rows))
    rows.sort(
        key=lambda row: (row.status in ("failed", "no-loop"), row.score_percent is None, row.score_percent or 0.0)
    )
    return Comparison(tuple(rows), fits[rows[0].name], fits)


def candidates(data: Dataset) -> tuple[str, ...]:
    """Models worth comparing: output that lags (counter-clockwise loops) and force that leads ask for different ones.

    Reversal curves come from saturation, which one model knows of.
    """
    if recognize_family(data) is not None:
        return ("preisach-forc",)
    lags = sum(loop_area(record.u[record.used], record.y[record.used]) for record in data) > 0
    if not lags:
        return ("bouc-wen-force", "duhem", SEARCH)
    timed = all(record.t is not None for record in data)
    # Records of piezo actuators have time, and creep; those of magnetic materials have neither.
    loops = ("bouc-wen-asymmetric", "bouc-wen+log-creep") if timed else ("preisach-magnetic",)
    return ("bouc-wen", *loops, "duhem", "preisach", SEARCH)


def _judge(name: str, data: Dataset, seed: int) -> tuple[Row, FitResult | None]:
    started = time.perf_counter()
    try:
        if name == SEARCH:
            result, score, note = best_structure(data, seed)
        elif isinstance(model := make_model(name), Preisach) and model.spacing != "reversal-curves":
            result, score, note = best_levels(model, data, seed)
        else:
            result = fit(model, data, seed=seed)
            score, note = left_out_error(result), ""
    except DataError:
        raise
    except HystfitError as error:
        return Row(name, None, None, None, None, time.perf_counter() - started, "failed", str(error)), None
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
    )
    return row, result


def _span(data: Dataset) -> float:
    y = np.concatenate([record.y[record.used] for record in data])
    return float(np.ptp(y)) or 1.0


def best_structure(data: Dataset, seed: int) -> tuple[FitResult, float, str]:
    """The Prandtl-Ishlinskii model whose terms and number of plays blocks left out choose: (fit, left-out error, terms in words)."""
    found = search_structure(data)
    best = min((found.resized(data, plays) for plays in _OTHER_PLAYS), key=lambda f: f.score)
    best = best if best.score < 0.98 * found.score else found
    result = fit(best.model, data, start="model", seed=seed)
    steps = tuple(f"structure search: {step}" for step in best.trail)
    result = dataclasses.replace(
        result, notes=(*result.notes, f"structure: {best.structure.words()}, {best.plays} plays", *steps)
    )
    return result, best.score, best.structure.words()


def best_levels(model: Preisach, data: Dataset, seed: int) -> tuple[FitResult, float, str]:
    """The Preisach model with as many levels as blocks left out choose: (fit, left-out error, levels in words)."""
    sizes = [Preisach.of(n, symmetric=model.symmetric, elements=model.elements) for n in _OTHER_LEVELS]
    fits = [fit(each, data, seed=seed) for each in (model, *sizes)]
    scores = [left_out_error(each) for each in fits]
    best = int(np.argmin(scores)) if min(scores) < 0.98 * scores[0] else 0
    note = f"{fits[best].model.levels.size} levels"
    return dataclasses.replace(fits[best], notes=(*fits[best].notes, f"structure: {note}")), scores[best], note


def left_out_error(result: FitResult) -> float:
    """Root mean square error on blocks left out in turn, each predicted by a fit to the others, output units.

    Refits start at the fit of all data, which saves the search for the basin.
    """
    problem = result_problem(result)
    x = np.array([result[name].value for name in result.free_names])
    blocks = left_out_blocks(problem)
    if isinstance(problem.model, Preisach) and result.method == "preisach":
        system = PreisachSystem.of(problem.model, list(problem.data))
        return float(fit_smooth(system, SMOOTHNESS).left_out.min()) * system.size
    if result.method == "convex" and len(linear_positions(problem)):
        return fit_ridge(LinearSystem.of(problem, x), Convex().strengths).score
    space = problem.space
    z = space.unconstrained(np.clip(x, np.asarray(space.coordinates.lower), np.asarray(space.coordinates.upper)))
    squares, count = 0.0, 0
    for block in range(max(int(np.max(b)) for b in blocks) + 1):
        inside = [b == block for b in blocks]
        weights = [record.weight * ~mask for mask, record in zip(inside, problem.data, strict=True)]
        own = problem.reweighted(weights)
        estimate = ESTIMATORS["lm" if result.method == "convex" else result.method].estimate(own, z[None])
        predicted = own.predict_at(estimate.x)
        for mask, record, y in zip(inside, problem.data, predicted, strict=True):
            held = mask & record.used
            squares += float(np.sum((y - record.y)[held] ** 2))
            count += int(held.sum())
    return float(np.sqrt(squares / count)) if count else float("nan")


def result_problem(result: FitResult) -> Problem:
    """The problem that a result solved, at its fitted model."""
    held = [p.name for p in result.parameters if p.fixed]
    return Problem(
        result.model, result.data, fix=held, free=_freed(result), loss=result.provenance.get("loss", "linear")
    )


def _freed(result: FitResult) -> list[str]:
    return [name.partition("@")[0] for name in dict.fromkeys(n.partition("@")[0] for n in result.free_names)]
