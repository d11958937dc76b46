"""One quantity of a measured loop."""

from __future__ import annotations

import dataclasses

from hystfit.outcome.table import or_none


@dataclasses.dataclass(frozen=True)
class LoopValue:
    """One quantity of a measured loop; a `stderr`, `spread` or `scale` of NaN becomes None."""

    # name, label: what it is; `name` is that of `hystfit.results.measured.quantities` where it is one of them
    name: str
    label: str
    value: float  # median over the loops of the record
    # standard error, from the noise about the place where it is read, or from the repeats of the loop where these scatter more; None where
    # the noise is unknown
    stderr: float | None
    unit: str  # "" where unknown
    count: int = 1  # number of branches or loops from which it was read
    stated: float | None = None  # what the instrument wrote into the file; None where it states nothing
    # half the difference of both branches, or half the range over the laws from which it can be computed; None where there is one
    spread: float | None = None
    # standard error by the size of the sample, common to all values of the sample; None where it is unknown
    scale: float | None = None

    def __post_init__(self) -> None:
        for name in ("stderr", "spread", "scale"):
            object.__setattr__(self, name, or_none(getattr(self, name)))
