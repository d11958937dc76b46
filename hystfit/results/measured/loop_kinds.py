"""Which kind of loop a record is, by the units of its input and output."""

from __future__ import annotations

import enum
import re

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.reading.names.column_names import column_quantity

_LIGHT = re.compile(r"kerr|moke|mcd", re.IGNORECASE)  # effects of Kerr and of X-ray magnetic circular dichroism


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
        """The kind of the records, by the units and names of their columns; `OTHER` where these tell of no other kind."""
        first = data[0]
        u, y = column_quantity(first.u_name, first.u_unit), column_quantity(first.y_name, first.y_unit)
        if turns_light(first):
            return cls.MAGNETIC
        for kind, inputs, outputs in _LOOP_KINDS:
            if u in inputs and y in outputs:
                return kind
        return cls.OTHER


_FORCES, _PATHS = {"force", "stress"}, {"displacement", "strain"}
_LOOP_KINDS = (
    (LoopKind.MAGNETIC, {"field", "induction", "current"}, {"moment", "magnetization", "induction", "field", "flux"}),
    (LoopKind.FERROELECTRIC, {"voltage", "electric field"}, {"charge", "polarization"}),
    (LoopKind.ACTUATOR, {"voltage", "electric field", "current", "field", "charge", "temperature", "pressure"}, _PATHS),
    # A force per length is that of a seam, of soil along a pile, or of a fabric.
    (LoopKind.DISPLACEMENT_DRIVEN, _PATHS, _FORCES | {"stiffness"}),
    (LoopKind.FORCE_DRIVEN, _FORCES, _PATHS),
)


def turns_light(record: Record) -> bool:
    """Whether the output is light that a magnetization turns or absorbs: it tells coercivity and remanence, and no energy."""
    driven = column_quantity(record.u_name, record.u_unit) in ("field", "induction")
    return driven and (record.y_unit.endswith(("deg", "rad", "°")) or _LIGHT.search(record.y_name) is not None)


def may_be_force(data: Dataset) -> bool:
    """Whether the outputs of records are forces, by their unit and name, or of an unknown quantity."""
    return column_quantity(data[0].y_name, data[0].y_unit) in (*_FORCES, "")


STRUCTURAL = frozenset({LoopKind.DISPLACEMENT_DRIVEN, LoopKind.FORCE_DRIVEN})
REMANENT = frozenset({LoopKind.MAGNETIC, LoopKind.FERROELECTRIC})
