"""Results that the instrument wrote into the file, beside ours, and a sentence where its definition is another one."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Iterable, Iterator

from hystfit.data.record import OFFSET, SLOPE, Record, Stated
from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.outcome.table import number
from hystfit.params.units import conversion
from hystfit.reading.names.column_names import column_quantity
from hystfit.results.measured.loop_branches import Branch
from hystfit.results.measured.measured_value import LoopValue

Levels = Callable[[list[Branch]], Iterable[LoopValue]]

# Names of results that rows of a data sheet of magnets have, by these.
_SHEET = {
    "HcJ": re.compile(r"HcJ|Hci|[ij]Hc", re.IGNORECASE),
    "HcB": re.compile(r"HcB|BHc", re.IGNORECASE),
    "Br": re.compile(r"Br", re.IGNORECASE),
    "energy_product": re.compile(r"\(?BH\)?[_ ]?max", re.IGNORECASE),
}


def with_stated(record: Record, found: list[LoopValue], levels: Levels, branches: list[Branch]) -> Iterator[LoopValue]:
    """The quantities with those that the instrument states; those that its slope correction changes (`levels`) in rows of their own."""
    other = "HcJ" if column_quantity(record.y_name, record.y_unit) == "induction" else "HcB"  # where J = 0, or B
    own = [one for one in record.stated if one.quantity and not _SHEET[other].fullmatch(one.label)]
    stated = {_name_of(one): one for one in own}
    if any(row.name == "remanence_end" for row in found):
        u = record.u[record.used]
        side = "rising" if u.argmin() > u.argmax() else "falling"  # the direction in which the input ends
        if f"remanence_{side}" in stated:
            stated["remanence_end"] = stated.pop(f"remanence_{side}")
    beside = lambda row: dataclasses.replace(row, stated=_in_unit(stated.get(row.name), row.unit))
    slope = next((one.value for one in record.stated if one.label == SLOPE), None)
    if slope is None or not stated or record.y_name.lower().startswith("adjusted"):
        yield from map(beside, found)
        return
    yield from found
    offset = next((one.value for one in record.stated if one.label == OFFSET), 0.0)
    corrected = [Branch(b.u, b.y + slope * b.u + offset) for b in branches]
    for one in levels(corrected):
        if one.name in stated:
            label = f"{one.label}, after the slope correction of the file"
            yield dataclasses.replace(beside(one), name=f"{one.name}_corrected", label=label)


def with_stated_sheet(record: Record, sheet: Iterable[LoopValue]) -> Iterator[LoopValue]:
    """The rows of a data sheet of magnets with those that the instrument states."""
    for row in sheet:
        pattern = _SHEET.get(row.name)
        stated = next((one for one in record.stated if pattern is not None and pattern.fullmatch(one.label)), None)
        yield dataclasses.replace(row, stated=_in_unit(stated, row.unit))


def convention_notes(record: Record, rows: Iterable[LoopValue]) -> Iterator[Note]:
    """Where the instrument's definition of a result that it states is another than the usual one, or must be, as the values differ."""
    if any(one.label.startswith("S*") for one in record.stated):
        text = "S* of the file is not compared: it takes the slope at the coercivity over an interval that the file does not state"
        yield Note(Code.PREPARED, text)
    for row in rows:
        if row.stated is None:
            continue
        if row.name == "remanence_end":
            text = "the instrument reads the remanence of the branch on which the loop ends from the last sample, not where V = 0"
            yield Note(Code.PREPARED, text)
        elif row.name in ("saturation", "saturation_corrected"):
            text = "the instrument's saturation is an output near the largest field; Js is extrapolated by the law of approach"
            yield Note(Code.PREPARED, text)
        elif _differ(row, row.stated):
            text = (
                f"{row.label}: the file states {number(row.stated, '.5g')} {row.unit}, and its samples give {number(row.value, '.5g')}: by "
                "another definition, or after a correction that the samples are without"
            )
            yield Note(Code.PREPARED, text)


def _differ(row: LoopValue, stated: float) -> bool:
    """Whether a result differs from the stated one, whatever its sign, by more than 1 %, two standard errors and the spread of branches."""
    errors = [error for error in (row.stderr, row.scale) if error is not None]
    margin = max(0.01 * abs(stated), 2 * math.hypot(*errors), row.spread or 0.0)
    return abs(abs(row.value) - abs(stated)) > margin


# The branch on which a result of that sign is read: the output crosses zero at a positive input as it rises, and is left positive at
# zero input by the branch that falls.
_SIGNED = {
    ("coercive_input", "+"): "rising",
    ("coercive_input", "-"): "falling",
    ("remanence", "+"): "falling",
    ("remanence", "-"): "rising",
    ("polarization_tip", "+"): "rising",
    ("polarization_tip", "-"): "falling",
}


def _name_of(stated: Stated) -> str:
    """The name under which a stated result stands here: "Vc+" and "+Vc" are the coercivity of the rising branch."""
    sign = stated.label[:1] if stated.label[:1] in ("+", "-") else stated.label[-1:]
    side = _SIGNED.get((stated.quantity, sign))  # "Prrel-" is the one at the start, on whichever side
    return stated.quantity if side is None else f"{stated.quantity}_{side}"


def _in_unit(stated: Stated | None, unit: str) -> float | None:
    """A stated result in the unit of ours; as it is where one of the units is unknown."""
    if stated is None:
        return None
    try:
        factor = conversion(stated.unit, unit) if stated.unit and unit else None
    except DataError:
        return None
    return stated.value * (1.0 if factor is None else factor)
