"""Identification in stages: hysteresis first, creep from a record at rest, then all parameters together."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from hystfit.config import verb
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import ParameterError
from hystfit.identify.identification import Identification
from hystfit.identify.ukf import Ukf
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Status


@dataclasses.dataclass(frozen=True)
class Phase:
    """One stage of an identification.

    Attributes:
        data: its records.
        only: parameters to identify from them; empty for all that are free by default.
        settings: of `Ukf.of` (prior, noise, hold, ...).
    """

    data: Record | Dataset | Sequence[Record]
    only: tuple[str, ...] = ()
    settings: dict[str, Any] = dataclasses.field(default_factory=dict)


@verb
def identify_in_stages(
    model: AbstractHysteresis, stages: Sequence[Phase]
) -> tuple[AbstractHysteresis, list[Identification]]:
    """Run the filter stage by stage, each from the result of the previous one.

    A cold start of hysteresis and creep together is badly conditioned (slow relaxation resembles an offset). Identify the
    hysteresis from a record of 1 to 10 Hz; then creep and the offset from a step or staircase of 100 s or more, with the
    hysteresis fixed; then all parameters from both records, with a small prior. The creep stages need the setting
    hold="none", because parameters of the hysteresis, the offset among them, are else fixed while the input rests.

    Args:
        model: start of the first stage, unless its settings have start="data".
        stages: the stages in turn.

    Returns:
        The model of the last stage and the identification of each stage.

    Raises:
        ParameterError: no stages, a stage that diverged, unknown names.
    """
    if not stages:
        raise ParameterError("staged identification needs at least one stage")
    results: list[Identification] = []
    for number, stage in enumerate(stages, start=1):
        settings = {"start": "model", **stage.settings}
        result = Ukf.of(model, stage.data, only=stage.only or None, **settings).fit(stage.data)
        results.append(result)
        if result.model is None or result.status is Status.DIVERGED:
            raise ParameterError(f"stage {number} diverged: {'; '.join(map(str, result.notes))}")
        model = result.model
    return model, results
