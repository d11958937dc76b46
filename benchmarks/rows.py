"""One comparison of a benchmark, and the table of all."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any


@dataclasses.dataclass(frozen=True)
class Row:
    """A time of hystfit beside a peer's in the same process.

    Attributes:
        name: what was computed, and beside whom: the key of its floor.
        ours_s: median seconds of hystfit; None where it was skipped.
        peer_s: median seconds of the peer; None where it was skipped.
        skipped: why there is no ratio.
    """

    name: str
    ours_s: float | None
    peer_s: float | None
    skipped: str = ""

    @property
    def ratio(self) -> float | None:
        """The peer's time over that of hystfit: above 1, hystfit is faster."""
        return None if self.peer_s is None or self.ours_s is None else self.peer_s / self.ours_s

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {**dataclasses.asdict(self), "ratio": self.ratio}


def beside(times: dict[str, float], name: str, ours: str = "hystfit") -> list[Row]:
    """A row for each peer of `ours` in the times of `alternate`.

    Args:
        times: median seconds, by name.
        name: what was computed.
        ours: which of the times is that of hystfit.
    """
    return [Row(f"{name} / {peer}", times[ours], seconds) for peer, seconds in times.items() if peer != ours]


def seconds(value: float | None) -> str:
    """A time with three digits and its unit."""
    if value is None:
        return "-"
    factor, unit = next((f, u) for f, u in ((1.0, "s"), (1e3, "ms"), (1e6, "us")) if value * f >= 1 or u == "us")
    return f"{value * factor:.3g} {unit}"


def markdown(rows: Sequence[Row], floors: dict[str, dict[str, float]]) -> str:
    """The table of all rows."""

    def cells(row: Row) -> Iterable[str]:
        floor = floors.get(row.name, {}).get("floor")
        ratio = row.skipped if row.ratio is None else f"{row.ratio:.2f}"
        return row.name, seconds(row.ours_s), seconds(row.peer_s), ratio, "-" if floor is None else f"{floor:.2f}"

    lines = ["| computation / peer | hystfit | peer | peer / hystfit | floor |", "|---|---|---|---|---|"]
    return "\n".join([*lines, *("| " + " | ".join(cells(row)) + " |" for row in rows)]) + "\n"
