"""Whether a device looks like a Preisach model: its three properties measured on records, and put in words."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.models.preisach.design_matrix import features
from hystfit.models.preisach.model import Preisach, rest_before
from hystfit.models.preisach.properties import (
    Closures,
    Congruency,
    congruency,
    error_by_order,
    orders,
    wiping_out,
)
from hystfit.models.preisach.smooth import fit_smooth
from hystfit.models.preisach.smooth_system import SmoothSystem
from hystfit.outcome.status import Status
from hystfit.outcome.wrapping import NAMED, listed
from hystfit.quality.loops import SAME_LEVEL
from hystfit.quality.reversal_curves import ReversalFamily, recognize_family

Outcome = Literal["holds", "fails", "untested"]
_LIMIT = 2.0  # percent of the output's range up to which a property holds
_MAJOR = 0.95  # fraction of the input's range from which a loop is the major one
_KNOWN = 0.9  # fraction of the higher orders' states from which the first-order ones determine them
_CELLS = 20  # along an axis, of the model whose errors are split by order
_SMOOTHNESS = 1e-6  # strength of the penalty on the weights of this model
_FIRST = 1  # reversals that the memory holds on a first-order curve


@dataclasses.dataclass(frozen=True)
class HigherOrder:
    """Errors of a Preisach model on states that remember more and more reversals."""

    held_out: bool  # it was identified on the initial and first-order curves alone; else on all samples
    known: float  # fraction of the higher orders' states that those curves determine
    # for each order (samples, root mean square error, largest error), in percent of the output's range
    errors: dict[int, tuple[int, float, float]]

    @property
    def worst(self) -> float | None:
        """Largest root mean square error over the orders above the first; None where there are none."""
        return max((rms for order, (_, rms, _) in self.errors.items() if order > _FIRST), default=None)


def higher_order(record: Record) -> HigherOrder | None:
    """How well a Preisach model describes reversals of higher order (paper's Figs. 14 and 15 ask the same).

    It is identified on samples that remember at most one reversal where those determine the others (reversal curves do), and
    predicts the others; where they do not, it is fitted to all samples.

    Args:
        record: measured.

    Returns:
        Errors by order; None where no sample remembers more than one reversal, or nothing moves.
    """
    if not (np.ptp(record.u) > 0 and np.ptp(record.y[record.used]) > 0):
        return None
    model = Preisach.of(_CELLS, initial=rest_before(record)).start([record])
    order = orders(model, record, SAME_LEVEL)
    if not (record.used & (order > _FIRST)).any():
        return None
    first = record.used & (order <= _FIRST)
    known = _determined(model, record.u, first, record.used & (order > _FIRST)) if first.any() else 0.0
    part = record.replace(weight=np.where(first, record.weight, 0.0)) if known >= _KNOWN else record
    return HigherOrder(part is not record, known, error_by_order(_fitted(model, part), record, SAME_LEVEL))


def _fitted(model: Preisach, record: Record) -> Preisach:
    """The model with the weights that fit the record."""
    weights = fit_smooth(SmoothSystem.of([model.design_matrix(record.u)], [record]), (_SMOOTHNESS,)).weights
    cells, slopes = np.split(weights[:-1], [model.w.size])
    return dataclasses.replace(model, w=cells, slopes=slopes, offset=weights[-1])


def _determined(model: Preisach, u: np.ndarray, first: np.ndarray, others: np.ndarray) -> float:
    """Part of the others' states (rms of what sets them apart from each other) that follows from those of the first samples."""
    A, index = features(model, u)
    A = np.column_stack([A, np.ones(len(A))])
    known, wanted = A[np.unique(index[first])], A[np.unique(index[others])]
    _, size, rows = np.linalg.svd(known, full_matrices=False)
    rows = rows[size > 1e-6 * size[0]]
    beyond = wanted - (wanted @ rows.T) @ rows
    return 1.0 - float(np.linalg.norm(beyond) / (np.linalg.norm(wanted - wanted.mean(axis=0)) or 1.0))


@dataclasses.dataclass(frozen=True)
class PreisachCheck:
    """Result of the Preisach tests on one record."""

    record: str  # its name
    closures: Closures  # of its loops
    loops: tuple[Congruency, ...]  # congruency of its minor loops
    higher: HigherOrder | None  # errors by order of reversal; None where there are none above the first
    outcomes: dict[str, Outcome]  # of "wiping-out", "congruency" and "higher-order"
    notes: tuple[str, ...]  # what they mean, one sentence each, in the same order

    @property
    def tested(self) -> bool:
        """Whether wiping-out or congruency could be tested."""
        return any(self.outcomes[name] != "untested" for name in ("wiping-out", "congruency"))

    def text(self) -> str:
        """The check as lines of text, without the record's name."""
        lines = [f"    - {note}" for note in self.notes]
        if self.higher is not None:
            lines += [f"      {'reversals remembered':<22}{'samples':>8}{'rms %':>9}{'largest %':>11}"]
            for order, (count, rms, largest) in self.higher.errors.items():
                lines.append(f"      {order:<22}{count:>8}{rms:>9.2g}{largest:>11.2g}")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers for result.json."""
        c, h = self.closures, self.higher
        keys = ("samples", "rms_percent", "max_percent")
        return {
            "outcomes": dict(self.outcomes),
            "notes": list(self.notes),
            "wiping_out": {
                "at": c.at.tolist(),
                "width": c.width.tolist(),
                "gap": c.gap.tolist(),
                "rms_percent": None if c.percent is None else c.percent[0],
                "max_percent": None if c.percent is None else c.percent[1],
            },
            "congruency": [dataclasses.asdict(loop) for loop in self.loops],
            "higher_order": h
            and {
                "held_out": h.held_out,
                "known": h.known,
                "errors": {str(k): dict(zip(keys, row, strict=True)) for k, row in h.errors.items()},
            },
        }


def check_preisach(record: Record) -> PreisachCheck:
    """Test the two properties that characterize a Preisach model (Mayergoyz), wiping-out and congruency, and a model of the record.

    Args:
        record: measured; the errors of a Preisach model identified on it should not grow with the order of reversal.
    """
    closures, loops = wiping_out(record), tuple(congruency(record))
    minor = closures.width < _MAJOR * float(np.ptp(record.u))
    inner = tuple(loop for loop in loops if loop.high - loop.low < _MAJOR * float(np.ptp(record.u)))
    higher = higher_order(record)
    found = [_wiping_words(closures, minor), _congruency_words(inner), _order_words(higher)]
    names = ("wiping-out", "congruency", "higher-order")
    outcomes = dict(zip(names, (outcome for outcome, _ in found), strict=True))
    return PreisachCheck(record.name, closures, loops, higher, outcomes, tuple(note for _, note in found))


@dataclasses.dataclass(frozen=True)
class PreisachChecks:
    """Results of the Preisach tests on all records of a data set; `family` are first-order reversal curves, None where these are none."""

    checks: tuple[PreisachCheck, ...]
    family: ReversalFamily | None

    @property
    def outcome(self) -> Outcome:
        """Over all records that test anything, and the family's curves, which should close and not cross."""
        if self.family is not None and self.family.notes:
            return "fails"
        outcomes = [outcome for one in self.checks if one.tested for outcome in one.outcomes.values()]
        if "fails" in outcomes:
            return "fails"
        return "holds" if outcomes or self.family is not None else "untested"

    def text(self) -> str:
        """As lines of text; records with the same text share it."""
        tested, family = [one for one in self.checks if one.tested], self.family
        lines = [f"Preisach properties (limit: {_LIMIT:g} % of the output's range)"]
        if family is not None:
            closes = ["the curves close and do not cross: weights >= 0 can reproduce them"]
            lines += [f"  {family.words()}", *(f"    - {note}" for note in family.notes or closes)]
        groups: dict[str, list[str]] = {}
        for one in tested or self.checks:
            groups.setdefault(one.text(), []).append(one.record)
        for text, names in list(groups.items())[:NAMED]:
            lines += [f"  {listed(names)}", text]
        if self.outcome == "untested":
            lines.append(f"  not tested: {Status.UNTESTED.advice('check')}")
        if len(groups) > NAMED:
            lines.append(f"  ({len(groups) - NAMED} more groups of records are in result.json)")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """For result.json."""
        return {"status": self.outcome, "records": {one.record: one.to_dict() for one in self.checks}}


def check_family(data: Record | Dataset) -> PreisachChecks:
    """Test the properties of a Preisach model on every record, and on the family of reversal curves that they may be.

    Raises:
        DataError: `data` holds no records.
    """
    dataset = Dataset.of(data)
    return PreisachChecks(tuple(check_preisach(record) for record in dataset), recognize_family(dataset))


def _outcome(value: float) -> Outcome:
    return "holds" if value <= _LIMIT else "fails"


def _verb(outcome: Outcome) -> str:
    return "holds" if outcome == "holds" else "does not hold"


def _wiping_words(closures: Closures, minor: np.ndarray) -> tuple[Outcome, str]:
    if not minor.any():
        which = "no loop closes in this record"
        if closures.percent is not None:
            which = (
                f"only the major loop closes ({closures.at.size} times, within {closures.percent[1]:.2g} % of the range), which "
                "shows that the loop is repeatable"
            )
        return "untested", (
            f"{which}: wiping-out cannot be tested; drive minor loops inside larger ones, such as 0, 150, 100, 180, 120 V"
        )
    worst = float(np.abs(closures.gap[minor]).max() / closures.span * 100)
    rms = float(np.sqrt(np.mean(closures.gap[minor] ** 2)) / closures.span * 100)
    outcome = _outcome(worst)
    return outcome, (
        f"wiping-out {_verb(outcome)}: over {int(minor.sum())} closed minor loops the output returns within {rms:.2g} % rms and "
        f"{worst:.2g} % at most of the range"
    )


def _congruency_words(loops: tuple[Congruency, ...]) -> tuple[Outcome, str]:
    if not loops:
        return "untested", (
            "no two minor branches run between the same inputs: congruency cannot be tested; drive the same minor loop after "
            "different histories, such as 120, 80, 120, 180, 80, 120 V"
        )
    worst = max(loops, key=lambda c: c.percent_of_range)
    outcome = _outcome(worst.percent_of_range)
    return outcome, (
        f"congruency {_verb(outcome)}: branches between {worst.low:.4g} and {worst.high:.4g} differ by "
        f"{worst.percent_of_range:.2g} % of the range ({worst.percent_of_loop:.2g} % of their travel)"
    )


def _order_words(higher: HigherOrder | None) -> tuple[Outcome, str]:
    worst = None if higher is None else higher.worst
    if higher is None or worst is None:
        return "untested", "no sample remembers more than one reversal: higher orders cannot be tested"
    outcome = _outcome(worst)
    how = (
        "a model identified on the first-order curves alone predicts"
        if higher.held_out
        else "a model fitted to the whole record (its first-order curves do not determine it) describes"
    )
    return outcome, (
        f"higher orders {'hold' if outcome == 'holds' else 'do not hold'}: {how} reversals above the first with an error of at most "
        f"{worst:.2g} % rms of the range in any order"
    )
