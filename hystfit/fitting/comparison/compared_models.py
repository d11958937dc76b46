"""A ranking of models: their order, by errors on held-out samples, the winner, and the table that shows it."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, get_args

from hystfit.outcome import Code, Column, Status, Table, fragment
from hystfit.outcome.note import has
from hystfit.quality.held_out import AT_ONE_PACE, Scheme
from hystfit.quality.summary import paces
from hystfit.results.result import FitResult

# How many times the error of the best decides without further evidence: a first look at a model with elements that errs more ends it, and a
# model without an inverse, a flexible one that describes a lag or a drift of this loop by weights that no other loop would have, must err
# less by it.
MARGIN = 1.5
UNFIT = (Status.NOT_CONVERGED, Status.POOR)  # of fits that did not converge or do not describe the loop
STRONG = 10.0  # difference of BIC that is strong evidence against a model (Kass and Raftery 1995)
Purpose = Literal["prediction", "inverse", "export"]


class Obstacles(Mapping[str, str]):
    """Why a fitted model cannot be inverted or exported, by purpose: found when first looked at, because an inverse takes tables."""

    def __init__(self, result: FitResult):
        self._result = result

    @functools.cached_property
    def _texts(self) -> dict[str, str]:
        return {use: text for use in get_args(Purpose)[1:] if (text := self._result.obstacle(use))}

    def __getitem__(self, purpose: str) -> str:
        return self._texts[purpose]

    def __iter__(self) -> Iterator[str]:
        return iter(self._texts)

    def __len__(self) -> int:
        return len(self._texts)


def handicap(status: Status, inverts: bool, paced: bool = False) -> float:
    """Factor by which a model must err less than others: one whose fit failed, of a family without an inverse, or `Row.paced`."""
    return MARGIN ** ((status in UNFIT) + (not inverts)) / (AT_ONE_PACE if paced else 1.0)


@dataclasses.dataclass(frozen=True)
class Row:
    """One model in a comparison."""

    name: str  # expression that recreates the model, with the chosen size and terms
    asked: str  # the name as requested: the same, a name without settings, or a search
    # error on left-out data, in percent of the output's range; None where it is not known
    score_percent: float | None = None
    in_sample_percent: float | None = None  # error on the samples that were fitted, and the largest there
    max_error_percent: float | None = None
    parameters: int | None = None  # number of free ones
    seconds: float = 0.0  # what fit and validation took
    status: Status = Status.UNTESTED  # of the fit, or "failed"
    note: str = ""  # why it was left out or stopped early
    # Bayesian information criterion, see `hystfit.fitting.comparison.left_out.bic`; None where it is not known
    bic: float | None = None
    # why the model cannot be inverted or exported, by purpose; None where it is not known
    obstacles: Mapping[str, str] | None = None
    family_inverts: bool = True  # whether the models of its family have an inverse, unless their parameters exclude one
    # how many of them the data determine, where a penalty or bounds reduce them; None where it is not known
    effective: float | None = None
    # whether slow cycles leave the model's loop open; of one without, "no-loop" is what it says of the data
    hysteretic: bool = True
    # whether it leaves nothing but noise, see `hystfit.fitting.comparison.standings.leaves_noise`
    leaves_noise: bool = False
    # whether the model depends on time, and the records were taken at one pace, at which a lag and a loop look alike
    paced: bool = False

    @property
    def fitted(self) -> bool:
        """Whether there was at least a quick first fit."""
        return self.in_sample_percent is not None

    @property
    def score(self) -> float:
        """Error on left-out data [percent of range], infinite where it is not known."""
        return math.inf if self.score_percent is None else self.score_percent

    @property
    def ranked_percent(self) -> float | None:
        """The error by which it ranks, see `handicap`."""
        return None if self.score_percent is None else self.score_percent * self.handicap

    @property
    def handicap(self) -> float:
        """Factor by which its error counts for more."""
        return handicap(self.status, self.family_inverts, self.paced)

    def serves(self, purpose: Purpose) -> bool | None:
        """Whether the model can be used for a purpose; None where it was not fitted."""
        return None if self.obstacles is None else purpose not in self.obstacles


class Fits(Mapping[str, FitResult]):
    """The completed fits by name. The standard errors of each are computed when it is first looked at.

    Args:
        names: of the fits.
        judged: a fit by its name.
    """

    def __init__(self, names: Iterable[str], judged: Callable[[str], FitResult]):
        self._names, self._judged = tuple(names), functools.cache(judged)

    def __getitem__(self, name: str) -> FitResult:
        if name not in self._names:
            raise KeyError(name)
        return self._judged(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A ranking: rows from best to worst, and the fit of the best.

    Attributes:
        rows: one for each model.
        winner: the fitted result of the first row.
        fits: every completed fit, by the requested name.
        scheme: what was held out.
        purpose: models that cannot be used for it rank below the others.
    """

    rows: tuple[Row, ...]
    winner: FitResult
    fits: Mapping[str, FitResult]
    scheme: Scheme
    purpose: Purpose = "prediction"

    @property
    def reason(self) -> str:
        """Why the winner was chosen, and what the records do not test, in words."""
        best = self.rows[0]
        score = best.score_percent
        error = "" if score is None else f" (cross-validation error {score:.3g} % of the range)"
        pace = "; another pace is not tested" if paces(self.winner.problem.data) == 1 else ""
        tested = "" if has(self.winner.notes, Code.LEFT_OUT_ERROR) else f"; it {self.scheme.tested}{pace}"
        return f"{best.name} {self._why}{error}{tested}; hystfit compare shows the ranking"

    @property
    def _why(self) -> str:
        best, count = self.rows[0], sum(row.fitted for row in self.rows)
        first = min(self.rows, key=lambda row: row.score)
        if first.score != best.score and first.paced and not best.paced:
            return (
                f"is preferred to {first.name} ({first.score_percent:.3g} %), whose terms of time could imitate hysteresis because all "
                "branches take the same time; a record at another pace would distinguish them"
            )
        if first.score != best.score:
            return f"predicts held-out samples as well as the best of {count} models, and is simpler or converged"
        if count > 1:
            return f"is the best of {count} models by cross-validation"
        if len(self.rows) == 1:
            return "is the only candidate for these data"
        return "leaves only noise in the residuals" if best.leaves_noise else "is the only model that was fitted"

    def table(self) -> Table:
        """The ranking."""
        columns = (
            Column("model"),
            Column("cross-val. %", "score_percent", ".3g"),
            Column("in sample %", "in_sample_percent", ".3g"),
            Column("largest %", "max_error_percent", ".3g"),
            Column("params", "parameters"),
            Column("BIC above", "bic_above", ".1f"),
            Column("invert", left=True),
            Column("export", left=True),
            Column("seconds", form=".1f"),
            Column("status", left=True),
        )
        least = min((row.bic for row in self.rows if row.bic is not None), default=0.0)
        rows = [
            [
                row.name,
                row.score_percent,
                row.in_sample_percent,
                row.max_error_percent,
                row.parameters,
                None if row.bic is None else row.bic - least,
                row.serves("inverse"),
                row.serves("export"),
                row.seconds,
                str(row.status),
            ]
            for row in self.rows
        ]
        return Table(columns, rows)

    def explanations(self) -> list[str]:
        """What the columns of the ranking mean, and why these models were compared."""
        return [
            f"Error in percent of the output's range; 'cross-val.': on {self.scheme.held}, held out of the fit in turn."
            + ("" if has(self.winner.notes, Code.LEFT_OUT_ERROR) else f" The winner {self.scheme.tested}."),
            "'BIC above': difference to the smallest, under slow and independent noise; more than ten is strong evidence against a model "
            "and decides among equal errors.",
            "'invert', 'export': whether the model has an inverse and C code.",
        ]

    def remarks(self) -> list[str]:
        """Why models were left out, or not validated."""
        return [f"{row.name}: {row.note}" for row in self.rows if row.note]

    def text(self, width: int | None = None) -> str:
        """The ranking as text; a table of more than `width` columns is shown in parts."""
        purpose = "" if self.purpose == "prediction" else f" (for {self.purpose})"
        remarks = [f"  - {remark}" for remark in self.remarks()]
        winner = f"winner: {self.rows[0].name}{purpose}"
        return "\n".join([*self.explanations(), *self.table().lines(width=width), *remarks, winner])

    def __repr__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        return fragment(f"winner: {self.rows[0].name}", (*self.explanations(), self.table(), *self.remarks()))

    def to_dict(self) -> dict[str, Any]:
        """For `result.json`."""
        return {
            "schema": "hystfit.compare/1",
            "status": self.winner.status,
            "winner": self.rows[0].name,
            "left_out": self.scheme,
            "purpose": self.purpose,
            "rows": [
                {**vars(row), "obstacles": None if row.obstacles is None else dict(row.obstacles)} for row in self.rows
            ],
            "provenance": self.winner.provenance,
        }


def ranked(rows: Sequence[Row], purpose: Purpose, floor: float = 0.0, *, equal: float = 1.0) -> list[Row]:
    """Models from best to worst, by their errors on held-out samples.

    A few large errors decide such an error. Where errors do not differ by more than it is known, what else speaks for a model decides, see
    `_plainest_first`: up to `equal` times the smallest error, and up to `floor`, that of rounding, which recurs where the cycles repeat
    [percent of range]. A fit that has not converged is not first beside one that can be used, nor one that describes the loops only roughly
    beside one that describes them and errs no more.
    """
    by_error = sorted(rows, key=lambda row: _rank(row, purpose))
    if not by_error or by_error[0].score_percent is None:
        return by_error
    ended = [row for row in by_error if row.status not in UNFIT]
    if by_error[0].status is Status.NOT_CONVERGED and ended and ended[0].status is Status.OK:
        first = ranked(ended, purpose, floor, equal=equal)[0]
        return [first, *(row for row in by_error if row is not first)]
    kind, most = _rank(by_error[0], purpose)[:-1], equal * _error(by_error[0])
    alike = [row for row in by_error if _rank(row, purpose)[:-1] == kind and _error(row) <= max(most, floor)]
    # Rounding errors are no evidence.
    order = _plainest_first(alike, evidence=most > floor) + by_error[len(alike) :]
    sound = [row for row in order if row.status is Status.OK and _rank(row, purpose)[:-1] == kind]
    best = min(sound, key=lambda row: row.score, default=order[0])
    if order[0].status is Status.ROUGH and best.score <= order[0].score:
        return [best, *(row for row in order if row is not best)]
    return order


def _plainest_first(alike: Sequence[Row], *, evidence: bool) -> list[Row]:
    """Models whose errors do not differ: fits that converged and describe the loop first, at one pace those without time, those without
    strong evidence against them by BIC, without hysteresis, with fewer determined parameters, and with an inverse.

    Args:
        evidence: whether their BIC tells of the models, not of rounding.
    """
    least = min((row.bic for row in alike if row.bic is not None and evidence), default=math.inf)

    def plain(row: Row) -> tuple[Any, ...]:
        unlikely = row.bic is not None and row.bic > least + STRONG
        parameters = row.effective or row.parameters or 0
        return row.status in UNFIT, row.paced, unlikely, row.hysteretic, parameters, not row.family_inverts, row.score

    return sorted(alike, key=plain)


def _error(row: Row) -> float:
    """Error by which a model ranks [percent of range]: one that describes the loops only roughly must err clearly less."""
    return (row.ranked_percent or 0.0) * (MARGIN if row.status is Status.ROUGH else 1.0)


def _rank(row: Row, purpose: Purpose) -> tuple[Any, ...]:
    """Validated models first, then those that serve the purpose, then the smallest error on left-out data."""
    return (
        row.in_sample_percent is None,
        row.status is Status.UNTESTED,
        row.status is Status.NO_LOOP and row.hysteretic,
        purpose != "prediction" and not row.serves(purpose),
        row.score_percent is None,
        _error(row) or (row.in_sample_percent or 0.0) * row.handicap,
    )
