"""Results that an instrument computed from a loop and wrote beside it: coercivity, remanence, loss."""

from __future__ import annotations

import dataclasses

# Labels of the line that was added to the output before the other results were computed: per unit of the input, and at zero input.
SLOPE, OFFSET = "Slope correction", "Offset correction"


@dataclasses.dataclass(frozen=True)
class Stated:
    """One result as the file states it, with the label and unit there; `quantity` names one of `QUANTITIES`, "" where it is none."""

    label: str
    value: float
    unit: str = ""
    quantity: str = ""
