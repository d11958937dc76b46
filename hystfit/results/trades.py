"""Trades: which kind of loop a record is, by the units of its input and output."""

from __future__ import annotations

import enum

from hystfit.data.dataset import Dataset
from hystfit.params.units import quantity


class Trade(enum.StrEnum):
    """What kind of loop a record is, by the units of its input and output."""

    MAGNETIC = "magnetic"
    FERROELECTRIC = "ferroelectric"
    ACTUATOR = "actuator"
    DISPLACEMENT_DRIVEN = "displacement-driven"
    FORCE_DRIVEN = "force-driven"
    OTHER = "other"

    @classmethod
    def of(cls, data: Dataset) -> Trade:
        """The kind of the records; `OTHER` where their units are not known, or not those of a trade."""
        u, y = quantity(data.units["u"]), quantity(data.units["y"])
        for trade, inputs, outputs in _TRADES:
            if u in inputs and y in outputs:
                return trade
        return cls.OTHER


_FORCES, _PATHS = {"force", "stress"}, {"displacement", "strain"}
_TRADES = (
    (Trade.MAGNETIC, {"field", "induction", "current"}, {"moment", "magnetization", "induction", "field", "flux"}),
    (Trade.FERROELECTRIC, {"voltage", "electric field"}, {"charge", "polarization"}),
    (Trade.ACTUATOR, {"voltage", "electric field", "current", "field", "charge", "temperature", "pressure"}, _PATHS),
    (Trade.DISPLACEMENT_DRIVEN, _PATHS, _FORCES),
    (Trade.FORCE_DRIVEN, _FORCES, _PATHS),
)
STRUCTURAL = frozenset({Trade.DISPLACEMENT_DRIVEN, Trade.FORCE_DRIVEN})
REMANENT = frozenset({Trade.MAGNETIC, Trade.FERROELECTRIC})
