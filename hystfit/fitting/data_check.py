"""`check`: the data-quality report, and the model to try first by a competition of those with a closed form."""

from __future__ import annotations

import contextlib
import dataclasses
from typing import Any

from hystfit.config import verb
from hystfit.data.dataset import Dataset
from hystfit.errors import HystfitError
from hystfit.fitting.compare import compare
from hystfit.models.registry import judged, judged_as
from hystfit.outcome import Code, Status
from hystfit.quality.check import Advice, QualityReport, examine
from hystfit.quality.determination import Verdict
from hystfit.reading.in_memory import records_of

_INTEGRATED = ("integrate", "true")  # option that reads a current as the charge, of which the loop is made
_RANK = {Verdict.YES: 0, Verdict.PARTLY: 1, Verdict.NO: 2}


@verb
def check(data: Any, y: Any = None, t: Any = None, *, u: Any = None) -> QualityReport:
    """Data-quality report of records, of a data frame or of arrays, which models the data determine, and which to try first.

    Args:
        data: a record, several, or a data frame; or the input, shape (T,).
        y: output, shape (T,); of a data frame the name or number of its column, guessed by default.
        t: time of each sample [s], shape (T,), or a column of a data frame.
        u: column of the input in a data frame; or the input, where it is given by name.

    Raises:
        DataError: `data` holds no records.
    """
    records = records_of(data, y, t, u=u)
    report = examine(records, judged())
    other = any(note.code is Code.DEGRADING or note.option == _INTEGRATED for note in report.findings)
    advice = None if other else _advice(records)
    first = set() if advice is None else {judged_as(part.partition(":")[0]) for part in advice.model.split("+")}
    rank = lambda item: (item.model not in first, _RANK[item.verdict])
    return dataclasses.replace(report, advice=advice, determines=tuple(sorted(report.determines, key=rank)))


def _advice(records: Dataset) -> Advice | None:
    """The best of the models with a closed form; None where none of them describes a loop."""
    with contextlib.suppress(HystfitError):
        found = compare(records, "quick", progress=lambda *_: None)
        best = found.rows[0]
        if found.winner.status not in (Status.NO_LOOP, Status.POOR) and best.score_percent is not None:
            reason = f"cross-validation error {best.score_percent:.2g} % of the range; it {found.scheme.tested}"
            return Advice(best.name, reason)
    return None
