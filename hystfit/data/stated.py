"""Results that an instrument computed from a loop and wrote beside it: coercivity, remanence, loss."""

from __future__ import annotations

import dataclasses

# Labels of the line that was added to the output before the other results were computed: per unit of the input, and at zero input.
SLOPE, OFFSET = "Slope correction", "Offset correction"


@dataclasses.dataclass(frozen=True)
class Stated:
    """One result as the file states it.

    Attributes:
        label: its name in the file ("Coercivity", "Vc+").
        value: its number.
        unit: as written in the file; "" if unknown.
        quantity: the quantity of `hystfit.results.measured.quantities` that it corresponds to; "" where it is none of them.
    """

    label: str
    value: float
    unit: str = ""
    quantity: str = ""
