"""Battery cyclers: the charge that passed, with its sign, as the input that drives the voltage of a cell.

Cyclers (Arbin, Neware, Maccor, BioLogic and others) write capacities that only grow: one of charge and one of discharge, or one for each
step beside the current. Their difference, or the integral with the sign of the current, goes back and forth as the cell is cycled.
"""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Sequence

import numpy as np

from hystfit.data.record import Record
from hystfit.outcome import Code, Note, Severity
from hystfit.params.units import conversion, quantity, symbol_of
from hystfit.reading.arrangements.branch_files import joined
from hystfit.reading.limits import MAJORITY, MOST, RARE
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Table

NAME = "Charge throughput"
_CAPACITY = r"(?:cap(?:acity)?|q|ah|amp hr)"
_OF_CHARGE = re.compile(rf"(?:ch(?:ar)?g(?:e|ing)?|cha)\.? ?{_CAPACITY}|{_CAPACITY} ?(?:charge|chg|cha)|充电容量")
_OF_DISCHARGE = re.compile(
    rf"(?:dis ?ch(?:ar)?g(?:e|ing)?|d ?chg|dis)\.? ?{_CAPACITY}|{_CAPACITY} ?(?:discharge|dis ?chg|dchg|dis)|放电容量"
)
_OF_STEP = re.compile(rf"{_CAPACITY}|容量")
_SIGNED = re.compile(r"\(?q ?q[o0]\)?|net capacity")  # a charge that goes back and forth as it is
_OF_ROW = re.compile(rf"(?:d|delta ?|Δ){_CAPACITY}")  # the charge since the row before
_OF_STATE = re.compile(r"charge")  # beside a column that tells which steps charge and which discharge
_UNITS = frozenset(
    {"Ah", "mAh", "A.h", "mA.h", "C", "As", "mAs", "Ahr", "mAhr", "coulomb", "coulombs", "Coulomb", "Coulombs"}
)
_AMPERE_HOURS = re.compile(r"amp[ ._-]?h(?:ou)?rs?|ah", re.IGNORECASE)  # a name that is the unit
_OF_VOLTAGE = re.compile(r"(?:voltage|spannung|volts|potential|ecell|ewe|e|u|v|cell voltage|terminal voltage)\b|电压")
_DISCHARGING = re.compile(r"dis|dchg|^d$|dch", re.IGNORECASE)
_CHARGING = re.compile(r"chg|charge|^c$|cha", re.IGNORECASE)
_LEVELS = 6  # currents that charge and discharge a cell; rests, ramps and voltages that are held have others
# The usual current of a cell, in hundredths of the range of its currents; that of a film between the pulses that switch it is less.
_LEAST = 3
_ROWS = 5  # over which the rate of a voltage is taken, beyond the noise of its single steps
_SAME = 0.1  # of a rate, up to which two are the same: noise of 0.1 mV over five rows of 1 mV changes it by 0.03 rms
_BACK = 0.02  # part of the charge that passed, up to which a half-cycle may run back


@np.errstate(all="ignore")  # of infinities, which a damaged file has
def with_throughput(table: Table) -> Table | None:
    """Battery cyclers: the charge that passed, with its sign, is one more column and the input of the voltage; None for other tables."""
    if not table.named or table.part is not None or NAME in table.names:
        return None
    names = [_words_of(name) for name in table.names]
    in_volts = lambda k: _is_number(table, k) and (not table.units[k] or quantity(table.units[k]) == "voltage")
    voltage = next((k for k, name in enumerate(names) if _OF_VOLTAGE.match(name) and in_volts(k)), None)
    if voltage is None or _is_voltammogram(table, table.columns[voltage]):
        return None
    found = _passed(table, names) or _integral(table, table.columns[voltage])
    if found is None or not np.ptp(found[0][np.isfinite(found[0])]) > 0:
        return None
    passed, unit, how = found
    noted = table.beside(NAME, passed, unit or "Ah").noted(
        Note(Code.PREPARED, f"the input is the charge that passed: {how}")
    )
    return dataclasses.replace(noted, pair=(len(table.names), voltage))


@functools.lru_cache(maxsize=4096)
def _words_of(name: str) -> str:
    """A name without its unit, in lower case, with a blank between its words."""
    return re.sub(r"[\s_./-]+", " ", split_unit(name)[0]).strip(" .").lower()


def _passed(table: Table, names: Sequence[str]) -> tuple[np.ndarray, str, str] | None:
    """The charge that passed, shape (rows,), its unit, and how it was found; None without capacities."""
    capacities = {k: name for k, name in enumerate(names) if _is_capacity(table, k)}
    of = lambda pattern: next((k for k, name in capacities.items() if pattern.fullmatch(name)), None)
    charge, discharge, step = of(_OF_CHARGE), of(_OF_DISCHARGE), of(_OF_STEP)
    if charge is not None and discharge is not None:
        passed = _grown(table.columns[charge]) - _grown(table.columns[discharge])
        return passed, table.units[charge], f"{table.names[charge]!r} less {table.names[discharge]!r}"
    signed = [k for k, name in enumerate(names) if _is_signed(table, k, name)]
    sums = [k for k in signed if not _OF_ROW.fullmatch(names[k])]
    if sums:
        return table.columns[sums[0]], table.units[sums[0]], repr(table.names[sums[0]])
    if signed:
        summed = np.cumsum(np.nan_to_num(table.columns[signed[0]]))
        return summed, table.units[signed[0]], f"the sum of {table.names[signed[0]]!r}"
    if step is None and _has_states(table):
        step = of(_OF_STATE)
    signs = None if step is None else _signs(table)
    if step is None or signs is None:
        return None
    passed = np.cumsum(signs * np.diff(_grown(table.columns[step]), prepend=0.0))
    return passed, table.units[step], f"{table.names[step]!r} with the sign of the current"


def _integral(table: Table, voltage: np.ndarray) -> tuple[np.ndarray, str, str] | None:
    """The same from a current that keeps few values, of both signs, while the voltage changes: a cell at constant currents."""
    time, source = _clock_and_current(table)
    if time is None or source is None or quantity(table.units[time] or "s") != "time":
        return None
    current, intervals = np.nan_to_num(table.columns[source]), np.diff(table.columns[time])
    if not current.min() < 0 < current.max() or not np.all(intervals >= 0) or not np.isfinite(np.diff(voltage)).any():
        return None
    levels, kept = _levels(current)
    switched, steps = np.diff(levels) != 0, np.abs(np.diff(voltage))
    moves = np.add.reduceat(np.where(switched, 0.0, np.diff(voltage)), np.append(0, np.flatnonzero(switched)))
    changes = np.nansum(np.abs(moves)) > MAJORITY * np.nansum(steps[switched])
    most, median = np.nanquantile(steps, [MOST, 0.5])
    swept = np.nanmax(steps[switched], initial=most) <= (1 + RARE) * median  # as in cyclic voltammetry
    if not kept or not changes or swept:
        return None
    passed = np.append(0.0, np.cumsum(current[1:] * intervals)) * (conversion(table.units[time] or "s", "h") or 1.0)
    return passed, f"{symbol_of(table.units[source]) or 'A'}h", f"{table.names[source]!r} over {table.names[time]!r}"


def _clock_and_current(table: Table) -> tuple[int | None, int | None]:
    """Positions of the time and of the current."""
    kinds = [*map(table.quantity, table.positions)]
    time, source = (kinds.index(kind) if kind in kinds else None for kind in ("time", "current"))
    return time, source


def _levels(current: np.ndarray) -> tuple[np.ndarray, bool]:
    """The current in hundredths of its range, and whether it keeps few values, as that with which a cell is cycled does."""
    levels = np.round(current / (RARE * np.ptp(current)))
    values, counts = np.unique_counts(levels[levels != 0])
    most_kept = np.argsort(counts)[-_LEVELS:]
    usual = np.median(np.repeat(np.abs(values[most_kept]), counts[most_kept])) if values.size else 0.0
    return levels, bool(counts[most_kept].sum() > MOST * counts.sum() and usual >= _LEAST)


def _is_voltammogram(table: Table, voltage: np.ndarray) -> bool:
    """Whether the voltage goes up and down at one rate while the current keeps no values: it drives, and the charge follows."""
    time, source = _clock_and_current(table)
    if time is None or source is None or not np.ptp(current := np.nan_to_num(table.columns[source])) > 0:
        return False
    changes, intervals = (values[_ROWS:] - values[:-_ROWS] for values in (voltage, table.columns[time]))
    rates = changes / intervals
    usual = np.nanmedian(np.abs(rates)) if np.isfinite(rates).any() else 0.0
    at_one = np.abs(np.abs(rates) - usual) < _SAME * usual
    both = (rates[at_one] > 0).any() and (rates[at_one] < 0).any()
    return bool(both and at_one.mean() > MAJORITY) and not _levels(current)[1]


def _is_number(table: Table, position: int) -> bool:
    return (
        position not in table.labels
        and position not in table.stamps
        and bool(np.isfinite(table.columns[position]).any())
    )


def _is_charge(table: Table, position: int) -> bool:
    unit = table.units[position].replace(" ", "").replace("·", ".")
    named = not unit and _AMPERE_HOURS.fullmatch(table.names[position]) is not None
    return _is_number(table, position) and (unit in _UNITS or named)


def _is_capacity(table: Table, position: int) -> bool:
    """Whether a column holds a charge that only grows, apart from where it starts again."""
    steps = np.diff(table.columns[position])
    return _is_charge(table, position) and bool((steps < 0).sum() < _BACK * np.isfinite(steps).sum())


def _is_signed(table: Table, position: int, name: str) -> bool:
    """Whether a column is the charge that passed, by its name or because it falls as well as grows, in the log of a cycler."""
    in_hours = "h" in table.units[position] or _OF_STEP.fullmatch(name)
    falls = len(table.names) > 2 and in_hours and _is_charge(table, position) and not _is_capacity(table, position)
    return falls or (bool(_SIGNED.fullmatch(name)) and _is_number(table, position))


def _grown(capacity: np.ndarray) -> np.ndarray:
    """A capacity that goes on where it starts again from zero, at the next cycle or step."""
    steps = np.diff(np.nan_to_num(capacity), prepend=np.nan_to_num(capacity[:1]))
    return np.cumsum(np.where(steps < 0, np.nan_to_num(capacity), steps))


def _signs(table: Table) -> np.ndarray | None:
    """Whether each row charges (1), discharges (-1) or neither (0), by the current or a column of steps; None where neither tells."""
    for position in table.positions:
        if _is_number(table, position) and table.quantity(position) == "current":
            current = np.nan_to_num(table.columns[position])
            if (current < 0).any():
                return np.sign(current)
    for labels in table.labels.values():
        signs = {
            label: -1 if _DISCHARGING.search(label) else int(bool(_CHARGING.search(label)))
            for label in set(labels.tolist())
        }
        if min(signs.values()) < 0 or max(signs.values()) > 0:
            return np.array([signs[label] for label in labels.tolist()])
    return None


def _has_states(table: Table) -> bool:
    """Whether a column of text says charge in some rows and discharge in others."""
    states = (set(labels.tolist()) for labels in table.labels.values())
    off = lambda label: _DISCHARGING.search(label) is not None
    return any(
        any(map(off, labels)) and any(_CHARGING.search(label) and not off(label) for label in labels)
        for labels in states
    )


def _one_way(passed: np.ndarray) -> str:
    """ "charge" or "discharge" where the charge only grows or falls; "" where it does both."""
    steps = np.diff(passed[np.isfinite(passed)])
    up, down = float(steps[steps > 0].sum()), float(-steps[steps < 0].sum())
    return "" if min(up, down) > _BACK * max(up, down) else "charge" if up > down else "discharge"


def cycled(records: Sequence[Record]) -> list[Record]:
    """The records; a charge and a discharge in files of their own are one loop, and a half-cycle that is left alone is said to be none.

    Files of the steps between them, which rest the cell or pass little charge both ways, are parts of that loop.
    """
    if not records or any(record.u_name != NAME for record in records):
        return [*records]
    ways, ranges = [_one_way(record.u) for record in records], [float(np.ptp(record.u)) for record in records]
    between = [size for size, way in zip(ranges, ways, strict=True) if not way]
    if {"charge", "discharge"} <= set(ways) and all(size < MAJORITY * max(ranges) for size in between):
        whole = joined(records, counted=True)
        halved = Code.CURVES, Severity.WARNING  # what was noted where a file was read by itself
        return [whole.replace(notes=tuple(note for note in whole.notes if (note.code, note.severity) != halved))]
    text = "half a cycle, which is no loop; name the file of the other half too (A.csv B.csv)"
    noted = lambda record, way: record.noted(Code.CURVES, f"the cell is only {way}d: {text}", Severity.WARNING)
    return [noted(record, way) if way else record for record, way in zip(records, ways, strict=True)]
