"""What a model needs of data so that its parameters can be determined; models declare it, the verdict on data uses it."""

from __future__ import annotations

import dataclasses
from typing import Literal


@dataclasses.dataclass(frozen=True)
class Needs:
    """Requirements of a model on the data.

    Attributes:
        loop: it describes an undamaged loop; False for a law of time beside the hysteresis.
        time: it depends on time.
        creep: holds of the input, or logarithmic drift of the mean of similar cycles.
        amplitudes: number of different strokes.
        dynamics: a response that changes with frequency.
        turning_pairs: (some, enough) different pairs of turning levels: below the first number only a major loop is described,
            below the second one part of the weights stays undetermined.
        symmetry: the loops that it describes: "symmetric", "asymmetric" (terms for asymmetry stay near zero otherwise), "any", or
            "generalized" (asymmetric loops need its generalized form).
        direction: of the loops that it describes with its default bounds.
        rate: its output depends on the speed of the input.
        speeds: number of speeds of the input, a factor of 3 apart.
        magnetic: it is a law of magnetization, which a comparison tries on a field and what it magnetizes alone.
        force: it is a law of a force, which a comparison tries on no output whose unit or name is that of another quantity.
        damage: it describes loops that lose strength or stiffness.
        too_few: what remains undetermined where amplitudes, frequencies or turning pairs are too few.
        regularized: a penalty decides between parameters that the data leave open, so that there may be more of them than samples.
        parameters: number of free ones with default settings; 0 where unknown.
    """

    loop: bool = True
    time: bool = False
    creep: bool = False
    amplitudes: int = 1
    dynamics: bool = False
    turning_pairs: tuple[int, int] = (0, 0)
    symmetry: Literal["any", "symmetric", "asymmetric", "generalized"] = "any"
    direction: Literal["any", "counter-clockwise", "clockwise"] = "any"
    rate: bool = False
    speeds: int = 1
    magnetic: bool = False
    force: bool = False
    damage: bool = False
    too_few: str = ""
    regularized: bool = False
    parameters: int = 0
