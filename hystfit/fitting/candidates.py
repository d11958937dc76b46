"""Which models are worth trying on records, by what `check` finds about them."""

from __future__ import annotations

import dataclasses

from hystfit.data.dataset import Dataset
from hystfit.models.data_check import data_kinds
from hystfit.models.registry import SEARCH, DataKind, compared, make_model
from hystfit.quality.determination import delayed, falling
from hystfit.quality.reversal_curves import recognize_family
from hystfit.quality.summary import summarize

_WORDS: dict[DataKind, str] = {
    "leading": "clockwise loops (a force that leads)",
    "leading-with-rate": "an output that depends on the rate of the input",
    "lagging-timed": "counter-clockwise loops (an output that lags) with time",
    "lagging-late": "a lag of many samples",
    "lagging-untimed": "counter-clockwise loops (an output that lags) without time",
    "point-symmetric": "loops symmetric about their center",
    "dynamic": "a resonance",
}


@dataclasses.dataclass(frozen=True)
class Candidates:
    """Models that a comparison tries.

    Attributes:
        names: expressions; those whose weights follow from a linear solve come first, because they take seconds.
        reason: what was found about the data.
        without_resonance: of records with a resonance, models that do not have one, which are tried only where it is in doubt.
    """

    names: tuple[str, ...]
    reason: str
    without_resonance: tuple[str, ...] = ()


def candidates(data: Dataset) -> Candidates:
    """Models worth comparing on records, and why."""
    if recognize_family(data) is not None:
        return Candidates(compared("reversal-curves"), "the records are first-order reversal curves")
    records = [summarize(record) for record in data]
    kinds, falls, late = data_kinds(records), falling(records), delayed(records)
    before = "delay+" * late + "negate+" * falls
    found = (
        [_WORDS[kind] for kind in kinds] + ["a pure delay"] * late + ["an output that falls as the input rises"] * falls
    )
    resonant = [before + name for name in compared(*(kind for kind in kinds if kind == "dynamic"))]
    others = [before + name for name in compared(*(kind for kind in kinds if kind != "dynamic"))]
    names, without = (resonant, others) if resonant else (others, [])
    reason = "the data have " + ", ".join(found)
    return Candidates((SEARCH, *_linear_first(names)), reason, tuple(_linear_first(without)))


def _linear_first(names: list[str]) -> list[str]:
    return sorted(names, key=lambda name: make_model(name).estimator is not None, reverse=True)
