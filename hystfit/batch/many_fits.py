"""What the fits of one model to many loops have in common, as a table (`fits`) or as maps (`loop_map`)."""

from __future__ import annotations

import abc
from collections import Counter
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from hystfit.outcome import Column, Status, Table, WithStatus
from hystfit.results.estimates import INTERVAL
from hystfit.results.provenance import provenance

ERRORS = ("rmse", "error_percent", "max_error_percent")


class ManyFits(WithStatus, abc.ABC):
    """Fits of one model to many loops: their counts, the summary of the usable ones, and what `result.json` has of both."""

    schema: ClassVar[str]
    model: Any
    units: Any
    work: Any
    verb: ClassVar[str] = "batch"

    @property
    def status(self) -> Status:
        """`Status.OK` where all fits are usable, `Status.PARTIAL` where some are, `Status.FAILED` where none is."""
        usable, every = self.counts.get(str(Status.OK), 0), sum(self.counts.values())
        return Status.OK if usable == every else Status.PARTIAL if usable else Status.FAILED

    @property
    def counts(self) -> dict[str, int]:
        """Number of loops by status, most frequent first."""
        return dict(Counter(self._statuses()).most_common())

    @abc.abstractmethod
    def _statuses(self) -> list[str]:
        """Status of each loop."""

    @abc.abstractmethod
    def summary(self) -> Table:
        """Distribution of each parameter and quantity over the usable fits, beside the median standard error of one fit."""

    @staticmethod
    def _distribution(rows: Sequence[tuple[str, str, np.ndarray, Sequence[Any]]], last: Sequence[str]) -> Table:
        """A table of names, units, values, and what the `last` columns say of them."""
        heads = ("loops", "median", "5 %", "95 %", *last)
        cells = []
        for name, unit, values, more in rows:
            low, middle, high = np.quantile(values, INTERVAL).tolist() if values.size else [None] * 3
            cells.append([name, unit, int(values.size), middle, low, high, *more])
        return Table([Column("parameter"), Column("unit", left=True), *map(Column, heads)], cells)

    def _lines(self, remarks: Sequence[str], usable: Sequence[str], bad: Sequence[str]) -> str:
        """Counts, `remarks` on all loops, the lines on `usable` fits, and the first loops that are `bad`."""
        counts, every = self.counts, sum(self.counts.values())
        counted = ", ".join(f"{count} {status}" for status, count in counts.items())
        lines = [f"{self.model} fitted to {every} loop{'s' if every != 1 else ''}: {counted}", *remarks]
        if counts.get(str(Status.OK), 0):
            lines += ["", "Usable fits", *usable]
        if bad:
            lines += ["", "Not usable", *bad]
            rest = every - counts.get(str(Status.OK), 0) - len(bad)
            lines += [f"  and {rest} more"] if rest else []
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """The contents of `result.json`; unknown values are null."""
        return {
            "schema": self.schema,
            "model": self.model,
            "status": str(self.status),
            "advice": self.advice,
            "counts": self.counts,
            "units": dict(self.units),
            "settings": self.work.settings,
            "summary": self.summary().to_list(),
            "provenance": provenance((), self.work.options.seed),
        }
