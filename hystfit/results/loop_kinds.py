"""Which kind of loop a record is, by the units of its input and output."""

from __future__ import annotations

import enum

from hystfit.data.dataset import Dataset
from hystfit.params.units import quantity


class LoopKind(enum.StrEnum):
    """What kind of loop a record is, by the units of its input and output."""

    MAGNETIC = "magnetic"
    FERROELECTRIC = "ferroelectric"
    ACTUATOR = "actuator"
    DISPLACEMENT_DRIVEN = "displacement-driven"
    FORCE_DRIVEN = "force-driven"
    OTHER = "other"

    @classmethod
    def of(cls, data: Dataset) -> LoopKind:
        """The kind of the records; `OTHER` where their units are not known or belong to no other kind."""
        u, y = quantity(data.units["u"]), quantity(data.units["y"])
        for kind, inputs, outputs in _LOOP_KINDS:
            if u in inputs and y in outputs:
                return kind
        return cls.OTHER


_FORCES, _PATHS = {"force", "stress"}, {"displacement", "strain"}
_LOOP_KINDS = (
    (LoopKind.MAGNETIC, {"field", "induction", "current"}, {"moment", "magnetization", "induction", "field", "flux"}),
    (LoopKind.FERROELECTRIC, {"voltage", "electric field"}, {"charge", "polarization"}),
    (LoopKind.ACTUATOR, {"voltage", "electric field", "current", "field", "charge", "temperature", "pressure"}, _PATHS),
    (LoopKind.DISPLACEMENT_DRIVEN, _PATHS, _FORCES),
    (LoopKind.FORCE_DRIVEN, _FORCES, _PATHS),
)
STRUCTURAL = frozenset({LoopKind.DISPLACEMENT_DRIVEN, LoopKind.FORCE_DRIVEN})
REMANENT = frozenset({LoopKind.MAGNETIC, LoopKind.FERROELECTRIC})
