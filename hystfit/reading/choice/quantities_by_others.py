"""Quantities of columns whose names mean different things beside different columns: q beside a torque, v beside x."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence

import numpy as np

from hystfit.data.two_levels import has_two_levels
from hystfit.reading.choice.column_facts import HEATED
from hystfit.reading.choice.quantity_points import LOADS
from hystfit.reading.limits import MAJORITY, ODD
from hystfit.reading.names.column_names import RELATIVE_PRESSURE, column_quantity, column_role, has_terminals, parts_of
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Table
from hystfit.reading.table.signal_evidence import is_even, is_near_median, proportional

_FEW_UNKNOWN = 8  # columns of unknown quantity that are compared with each other
_SWEPT = ("field", "induction", "temperature", "electric field")  # beside which X and Y are components of a signal
_POLAR = frozenset({"deg", "phi", "theta", "r"})  # names of the same signal by its size and angle
# Angles of a wing, and coefficients of its loads.
_INCIDENCE = frozenset({"alpha", "alfa", "aoa", "incidence", "pitch"})
_COEFFICIENT = re.compile(r"c_?[ldmnt]p?", re.IGNORECASE)  # Cdp: the part of the pressure
_CHAMBERS = frozenset({"lv", "rv", "ventricle", "ventricular", "cylinder", "chamber"})  # that work against a pressure
# Suction of a soil and its water, as a part of its volume or mass.
_RETENTION = (("h", "theta"), ("psi", "theta"), ("s", "w"))
_B_FIELD = re.compile(r"b[ _-]?field", re.IGNORECASE)
_LAMMPS = re.compile(r"[cfv]_(\w{2,}).*")  # computes, fixes and variables in a log of LAMMPS
_COMPONENT = re.compile(r"(?:v_)?P[xyz]")  # of a polarization
_SAME_SHAPE, _FEWEST_OF_RATE = 0.99, 10  # correlation, and rows, from which a column is the rate of another
# The same of its sums, which are free of noise: the sums of a force that saturates with the velocity have 0.994.
_SAME_SUMS = 0.998


def tell_by_others(table: Table, free: Sequence[int], kinds: dict[int, str], *, many: bool) -> None:
    """Quantities of names that mean different things beside different columns.

    Args:
        table: of the columns.
        free: columns that may be input or output.
        kinds: quantities of the columns, which are changed.
        many: whether there are more columns than a pair.
    """
    among = lambda *names: any(kinds[k] in names for k in free)
    bases = {k: split_unit(table.names[k])[0].strip() for k in free}
    if among("stress", "pressure"):  # of the water in a soil, by its saturation or its content
        kinds.update({k: "loading" for k in free if table.names[k] == "Sr"})
    for names in _RETENTION:
        pair = [k for name in names for k in free if bases[k] == name]
        if len(pair) == 2 and 0 <= np.nanmin(table.columns[pair[1]]) < np.nanmax(table.columns[pair[1]]) <= 1:
            kinds.update(zip(pair, ("pressure", "loading"), strict=True))
    relative = [k for k in free if RELATIVE_PRESSURE.search(table.names[k])]
    if (
        among("loading", "mass") and relative
    ):  # the gas pressures that it was computed from, unless its digits are too few
        values = lambda k: np.unique(table.columns[k]).size
        finer = lambda k: values(relative[0]) > MAJORITY * values(k)
        kinds.update({k: "status" for k in free if kinds[k] == "pressure" and k not in relative and finer(k)})
    if among("loading") and not among("pressure"):
        kinds.update({k: "pressure" for k in free if kinds[k] == "stress"})
    if among("strain"):
        kinds.update({k: "velocity" for k in free if kinds[k] == "shear rate"})
    if not among(
        "field", "induction", "voltage", "electric field"
    ):  # q beside a torque or current is an angle of a joint
        kinds.update({k: "force" for k in free if kinds[k] == "moment" and not table.units[k]})
        if among("force", "current"):
            kinds.update({k: "displacement" for k in free if kinds[k] == "charge" and not table.units[k]})
    if (parts := _components(table, bases, swept=among(*_SWEPT))) and table.named:  # of a lock-in amplifier
        kinds.update(dict.fromkeys(parts, ""))
        kinds.update({k: "phase" for k in free if bases[k].lower() in _POLAR})
    locked = [k for k in free if {"lock", "lockin"} & parts_of(table.names[k])]
    kinds.update({k: "phase" for k in locked if _POLAR & parts_of(table.names[k]) and kinds[k] == "displacement"})
    if has_terminals(table.names):  # ID beside VG is no number of an object
        kinds.update({k: "current" for k in free if bases[k] in ("ID", "IS")})
    if among("capacitance"):  # D beside C is a loss, and Q its inverse
        kinds.update({k: "phase" for k in free if bases[k] in ("D", "Q")})
    angles = [k for k in free if kinds[k] == "displacement"]
    if any(({bases[k].lower()} | parts_of(table.names[k])) & _INCIDENCE for k in angles):  # of a wing
        kinds.update({k: "force" for k in free if _COEFFICIENT.fullmatch(bases[k])})
    if any(parts_of(table.names[k]) & _CHAMBERS for k in free if kinds[k] == "volume"):
        kinds.update({k: "stress" for k in free if kinds[k] == "pressure"})
    loads, warm = ([k for k in free if kinds[k] in names] for names in (LOADS, ("temperature",)))
    for k, of in itertools.product(loads, warm):  # a load that is held while the temperature goes up and down
        held = is_near_median(table.columns[k])
        if np.mean(held) > MAJORITY and np.ptp(table.columns[of][held]) > HEATED:
            kinds[k] = "status"
    if warm:  # a heater or a relay that is on or off
        kinds.update({k: "state" for k in free if kinds[k] == "power" and has_two_levels(table.columns[k], ODD)})
        kinds.update({k: "state" for k in free if kinds[k] == "" and {*np.unique(table.columns[k])} == {0.0, 1.0}})
    fields = [k for k in free if kinds[k] == "field"]
    induced = [k for k in fields if _B_FIELD.match(table.names[k])]
    if len(induced) < len(fields):  # the B field beside the H field
        kinds.update(dict.fromkeys(induced, "induction"))
    if "Step" in table.names:
        kinds.update({k: column_quantity(of[1]) for k in free if (of := _LAMMPS.fullmatch(table.names[k]))})
    if among("electric field"):
        kinds.update({k: "polarization" for k in free if kinds[k] == "" and _COMPONENT.fullmatch(table.names[k])})
    if any("thrust" in parts_of(table.names[k]) for k in free):  # of a propeller: its torque and current come after it
        commanded = [k for k in free if column_role(table.names[k]) == "input"]
        kinds.update({k: "" for k in free if {"torque", "trq"} & parts_of(table.names[k])})
        kinds.update({k: "" for k in free if commanded and (k in commanded or kinds[k] == "current")})
    _find_velocities(table, free, kinds)
    # n that is no whole number is no number of a row or, where it grows evenly, of cycles: a refractive index
    fractions = (k for k in free if kinds[k] == "index" and not _is_count(table.columns[k]))
    kinds.update(dict.fromkeys(fractions, ""))
    if table.named and many:
        unnamed = lambda k: kinds[k] == "" or table.names[k] == "X"  # of an oscilloscope, which numbers its samples so
        kinds.update({k: "index" for k in free if unnamed(k) and table.counts(k, groups=True)})


def _components(table: Table, bases: Mapping[int, str], *, swept: bool) -> list[int]:
    """The columns X and Y that are components of one signal: beside a swept quantity, or beside their size in a third column."""
    places = {name.lower(): k for k, name in bases.items()}
    if not {"x", "y"} <= places.keys():
        return []
    pair = [places["x"], places["y"]]
    size = np.hypot(*(table.columns[k] for k in pair))
    capital = swept and [bases[k] for k in pair] == ["X", "Y"]
    return pair if capital or any(proportional(size, table.columns[k]) for k in bases if k not in pair) else []


def _is_count(values: np.ndarray) -> bool:
    """Whether a column has whole numbers alone, or those of cycles, which grow as a clock does."""
    known = values[np.isfinite(values)]
    return bool((known == np.round(known)).all() or ((np.diff(known) >= 0).all() and is_even(known)))


def _find_velocities(table: Table, free: Sequence[int], kinds: dict[int, str]) -> None:
    """Mark columns of unknown quantity that are the rate of another such column: v in x, v, F, a flow beside its volume, V beside D."""
    unknown = [k for k in free if kinds[k] in ("", "flow", "volume") and not column_role(table.names[k])][:_FEW_UNKNOWN]
    if len(unknown) > 2 or len(free) > len(unknown) > 1:
        for k, of in itertools.permutations(unknown, 2):
            if kinds[of] != "velocity" and _is_rate(table.columns[k], table.columns[of]):
                kinds[k] = "velocity"
    moved = [k for k in free if kinds[k] == "displacement"]
    for k in unknown if len(free) > 2 else ():
        if kinds[k] == "" and any(_is_rate(table.columns[k], table.columns[of]) for of in moved):
            kinds[k] = "velocity"
    # A rate shows that mass.s beside mass.v is a displacement and no stress.
    rates = [k for k in free if kinds[k] == "velocity"]
    for k in [k for k in free if kinds[k] == "stress" and not table.units[k]]:
        if any(_is_rate(table.columns[rate], table.columns[k]) for rate in rates):
            kinds[k] = "displacement"
    bare = {table.names[k]: k for k in free if not table.units[k]}
    if {"D", "V"} <= bare.keys() and _is_rate(table.columns[bare["V"]], table.columns[bare["D"]]):
        kinds |= {bare["D"]: "displacement", bare["V"]: "velocity"}


def _is_rate(column: np.ndarray, of: np.ndarray) -> bool:
    """Whether a column has the shape of the rate of another one, or its sums have the shape of the other one, apart from a drift."""
    known = np.isfinite(of) & np.isfinite(column)
    if known.sum() < _FEWEST_OF_RATE:
        return False
    with np.errstate(all="ignore"):  # of numbers near the largest
        of, column = of[known], column[known]
        summed = np.append(0.0, np.cumsum(0.5 * (column[1:] + column[:-1])))
        return _are_alike(np.gradient(of), column, _SAME_SHAPE) or _are_alike(_level(of), _level(summed), _SAME_SUMS)


def _are_alike(one: np.ndarray, other: np.ndarray, least: float) -> bool:
    """Whether two columns have one shape, by this correlation."""
    return bool(np.ptp(one) > 0 and np.ptp(other) > 0 and np.corrcoef(one, other)[0, 1] > least)


def _level(values: np.ndarray) -> np.ndarray:
    """A column without the straight line through it."""
    rows = np.arange(values.size)
    return values - np.polyval(np.polyfit(rows, values, 1), rows)
