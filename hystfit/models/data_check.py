"""`check`: the data-quality report, with a verdict for each model."""

from __future__ import annotations

from hystfit.data.record import Dataset, Record
from hystfit.models.registry import judged
from hystfit.quality.check import QualityReport, examine


def check(data: Record | Dataset) -> QualityReport:
    """Data-quality report of a record or a data set, and which models the data determine.

    Raises:
        DataError: `data` holds no records.
    """
    return examine(data, judged())
