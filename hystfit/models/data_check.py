"""`check`: the data-quality report, with a verdict for each model."""

from __future__ import annotations

from typing import Any

from hystfit.models.registry import judged
from hystfit.quality.check import QualityReport, examine
from hystfit.reading.in_memory import records_of


def check(data: Any, y: Any = None, t: Any = None, *, u: Any = None) -> QualityReport:
    """Data-quality report of records, of a data frame or of arrays, and which models the data determine.

    Args:
        data: a record, several, or a data frame; or the input, shape (T,).
        y: output, shape (T,); of a data frame the name or number of its column, guessed by default.
        t: time of each sample [s], shape (T,), or a column of a data frame.
        u: column of the input in a data frame; or the input, where it is given by name.

    Raises:
        DataError: `data` holds no records.
    """
    return examine(records_of(data, y, t, u=u), judged())
