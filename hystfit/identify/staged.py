"""Identification in stages: hysteresis first, creep from a record that rests, then all together."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from hystfit.data.record import Dataset, Record
from hystfit.errors import ParameterError
from hystfit.identify.identification import Identification
from hystfit.identify.ukf import Ukf
from hystfit.models.base import AbstractHysteresis


@dataclasses.dataclass(frozen=True)
class Phase:
    """One stage of an identification: which parameters a record is to determine; empty frees all that are free by default.

    `settings` go to `Ukf.of` (prior, noise, hold, ...).
    """

    data: Record | Dataset | Sequence[Record]
    only: tuple[str, ...] = ()
    settings: dict[str, Any] = dataclasses.field(default_factory=dict)


def identify_in_stages(
    model: AbstractHysteresis, stages: Sequence[Phase], *, passes: int = 1
) -> tuple[AbstractHysteresis, list[Identification]]:
    """Run the filter stage by stage, each from where the one before ended.

    A cold start of hysteresis and creep together is badly conditioned (slow relaxations look like an offset), so: hysteresis from a
    record of 1 to 10 Hz; creep and the offset from a step or staircase of 100 s and more, the hysteresis held; then all
    from both records, with a small prior. While the input rests parameters of the hysteresis wait, its offset among
    them: the creep stages need the setting hold="none".

    The first stage starts at the model's own values unless its settings say start="data".

    Returns:
        The model of the last stage and what each stage found.

    Raises:
        ParameterError: no stages, a stage that diverged, unknown names.
    """
    if not stages:
        raise ParameterError("staged identification needs at least one stage")
    found: list[Identification] = []
    for number, stage in enumerate(stages, start=1):
        settings = {"start": "model", **stage.settings}
        result = Ukf.of(model, stage.data, only=stage.only or None, **settings).fit(stage.data, passes=passes)
        found.append(result)
        if result.model is None or result.status == "diverged":
            raise ParameterError(f"stage {number} diverged: {'; '.join(result.notes)}")
        model = result.model
    return model, found
