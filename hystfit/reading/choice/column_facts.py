"""Facts about each column among the others: which one is set, measured, held, raw, a part of another, and how its signal runs."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hystfit.params.units import parse_unit, quantity
from hystfit.reading.choice.quantity_points import PAIRS
from hystfit.reading.names.column_names import (
    MEANS,
    SIDES,
    column_quantity,
    column_role,
    is_channel,
    parts_of,
    secondary,
    without_role,
)
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Table
from hystfit.reading.table.signal_evidence import (
    by_equal_steps,
    extent,
    is_even,
    is_held,
    overtones,
    proportional,
    repeats,
    roughness,
    rounded,
    sample,
    smoothness,
)

# A commanded column and its measurement are of one unit, or named alike, and differ by less than that part of the range: following errors
# are 0.001 to 0.05.
_FOLLOWS = 0.1
# Part of the largest range of a unit below which a displacement or field is that of a part: a slip, an uplift or the strain of a part; the
# component of a field across its direction; the component of a signal out of phase.
_OF_LARGEST = 0.3
_TRANSVERSE = 0.6  # the same part of strains: one across the load is up to half of that along it
_OF_PARTS = ("displacement", "strain", "field", "induction", "current")
_OF_SENSORS = 1e-3  # unit of voltages [V] in which those of sensors are written, and those that drive actuators are not
_OF_VOLTAGES = ("current", "resistance")  # quantities that are computed from voltages
_FIELDS = ("field", "induction")
# Quantities that a source sets: a set value of one and its measurement, which repeat each other, are one drive and no device.
SOURCES = (*_FIELDS, "voltage", "current", "temperature")
_PAIR = 2  # columns of a loop
_HEATERS = frozenset({"heater", "heaters", "heating", "furnace", "heizung", "heizer"})
HEATED = 10.0  # degrees over which a temperature must vary to be an input
_RELATIVE = ("%", "ppm")  # units of changes beside the quantity itself
_ELEMENT = re.compile(r"\[\d+\]$")  # of an array
_REFERENCE = re.compile(r"ref(?:erence)?(?![a-z])", re.IGNORECASE)
_WINDING = re.compile("primary|secondary", re.IGNORECASE)


@dataclasses.dataclass(frozen=True)
class ColumnFacts:
    """Facts about the columns of a table, found when they are asked for.

    Attributes:
        kinds: the physical quantity of every column.
        components: those of one signal that a lock-in amplifier writes.
        roles: that which the name of every column states.
        ranks: place of each that may be chosen among those of its quantity.
        equal: columns whose order means nothing.
        alone: whether there is no other pair to choose.
    """

    table: Table
    kinds: Mapping[int, str]
    components: tuple[int, ...]
    roles: Mapping[int, str]
    ranks: Mapping[int, int]
    equal: frozenset[int]
    alone: bool

    @classmethod
    def of(
        cls, table: Table, free: Sequence[int], kinds: Mapping[int, str], *, alone: bool, named: bool
    ) -> ColumnFacts:
        """Those of a table of which the columns `free` may be chosen; `named`: whether its columns have names."""
        # Of more than two channels that have a number instead of a name, the order means nothing.
        equal = [k for k in free if kinds[k] == "" and (not named or is_channel(table.names[k]))]
        equal = equal if len(equal) > 2 else []
        components = _lock_in(table, kinds)
        roles = _roles(table, components, kinds)
        ranks = dict.fromkeys(equal, 0) | _ranks(table, [k for k in free if k not in equal], kinds, roles)
        facts = cls(table, kinds, components, roles, ranks, frozenset(equal), alone)
        inputs = [k for k in facts.ranks if roles[k] == "input"]
        references = [k for k in inputs if _REFERENCE.search(table.names[k])]
        others = {kinds[k] for k in inputs if k not in references}
        efforts = [k for k in facts.ranks if table.names[k] == "u" and roles[k] and {*facts.measured} - {k}]
        roles |= dict.fromkeys(efforts, "")  # u of a controller, whose reference is followed
        idle = [k for k in references if kinds[k] in others and k not in facts.measured]
        roles |= dict.fromkeys(idle, "")  # a reference that nothing follows, beside the input of an open loop
        return dataclasses.replace(
            facts, roles=roles, kinds={**kinds, **{k: kinds[j] for k, j in facts.measured.items()}}
        )

    def is_open(self, k: int) -> bool:
        """Whether a column is one of three or more of which names tell no quantity, and has no role: it may drive as well as another."""
        told = self.kinds[k] or self.roles[k] or any(map(str.isdigit, self._parts[k]))  # joint 1 is before joint 2
        return not told and sum(self.kinds[j] == "" for j in self.ranks) > _PAIR

    def are_sides(self, i: int, o: int) -> bool:
        """Whether two columns are one quantity at two sides of a specimen, by their names: "Left angle", "Right angle"."""
        sides = self._parts[i] & SIDES, self._parts[o] & SIDES
        return all(sides) and self._parts[i] - SIDES == self._parts[o] - SIDES and self.kinds[i] == self.kinds[o]

    def are_partners(self, i: int, o: int) -> bool:
        """Whether the names of two columns differ by their roles alone."""
        names = [without_role(self.table.names[k]) for k in (i, o)]
        return (self.roles[i], self.roles[o]) == ("input", "output") and names[0] == names[1] != ""

    def of_one_part(self, i: int, o: int) -> bool:
        """Whether names tell that two columns are of one part, and not a command and its own measurement."""
        return bool(self._parts[i] & self._parts[o]) and self.measured.get(i) != o

    @functools.cached_property
    def _parts(self) -> dict[int, frozenset[str]]:
        """Words in the name of each column that tell it from others: x of Disp_X beside Disp_Y, shear of ShearStrain."""
        words = {
            k: parts_of(without_role(name)) if self.table.named else frozenset()
            for k, name in enumerate(self.table.names)
        }
        common = frozenset.intersection(*(words[k] for k in self.ranks)) if self.ranks else frozenset()
        return {k: own - common for k, own in words.items()}

    def is_secondary(self, k: int) -> int:
        """By how many words of its name a column comes after another one of its quantity, as two sides come after their mean.

        A strain is one quantity with a displacement, as a crosshead comes after the strain of the specimen.
        """
        group = lambda j: "strain" if self.kinds[j] == "displacement" else self.kinds[j]
        alike = {j: self._parts[j] for j in self.ranks if group(j) == group(k)}
        mean = next((j for j, own in alike.items() if own & MEANS and self._sides_of(own - MEANS, alike) > 1), None)
        if mean is not None and (k == mean or self._parts[k] & SIDES):
            return int(k != mean)
        return secondary(self.table.names[k]) - min((secondary(self.table.names[j]) for j in alike), default=0)

    @staticmethod
    def _sides_of(words: frozenset[str], columns: Mapping[int, frozenset[str]]) -> int:
        """How many columns are a side of what these words name."""
        return sum(bool(own & SIDES) and own - SIDES == words for own in columns.values())

    @functools.cached_property
    def is_held(self) -> ByColumn:
        """Whether a column is a condition that is held, by column; never of the only two."""
        return ByColumn(lambda k: not self.alone and is_held(self.table.columns[k]))

    @functools.cached_property
    def has_two_states(self) -> ByColumn:
        """Whether a column is on or off, as the relay of a thermostat, which follows a quantity that goes up and down, by column."""
        two = lambda k: np.unique(sample(self.table.columns[k])).size == 2
        return ByColumn(lambda k: self.kinds[k] == "state" or (self.kinds[k] == "" and two(k)))

    @functools.cached_property
    def is_share(self) -> ByColumn:
        """Whether a column is one of several of one quantity and unit that add up to another, as loads of two cells, by column.

        Voltages add up along a circuit, where each is that of an element.
        """
        group = lambda k: (self.kinds[k], self.table.units[k])

        def whole(j: int, others: list[int]) -> bool:
            columns = self.table.columns
            alone = any(repeats(columns[one], columns[j]) for one in others)  # a commanded load and its measurement
            return not alone and repeats(np.sum([columns[one] for one in others], axis=0), columns[j])

        def share(k: int) -> bool:
            alike = [j for j in self.ranks if group(j) == group(k)]
            return (
                len(alike) > 2
                and self.kinds[k] != "voltage"
                and any(whole(j, [one for one in alike if one != j]) for j in alike if j != k)
            )

        return ByColumn(share)

    @functools.cached_property
    def _bases(self) -> list[str]:
        return [split_unit(name)[0].strip() for name in self.table.names]

    @functools.cached_property
    def axis(self) -> dict[int, str]:
        """The axis of columns that are components of a vector, as the ends of their names tell; "" of others."""
        return _axes(self._bases)

    @functools.cached_property
    def is_partial(self) -> ByColumn:
        """Whether a column is the displacement of a part of the device or a part of its field, by column."""
        extents: dict[tuple[str, str], float] = {}
        vectors = {self._bases[k][:-1] for k, axis in self.axis.items() if axis}
        group = lambda k: (self.kinds[k], self.table.units[k])
        summed = lambda k: bool((np.diff(self.table.columns[k]) >= 0).all())  # over the test: of no part or the whole
        for k in (k for k in self.ranks if not summed(k)):
            extents[group(k)] = max(extents.get(group(k), 0.0), extent(self.table.columns[k]))

        def partial(k: int) -> bool:
            whole = extents.get(group(k), 0.0) if self.kinds[k] in _OF_PARTS else 0.0
            strain = self.kinds[k] == "strain"
            least = (_TRANSVERSE if strain else _OF_LARGEST) * whole
            of_part = bool(self.table.units[k] or strain) and extent(self.table.columns[k]) < least
            return of_part or self._bases[k] in vectors

        return ByColumn(partial)

    @functools.cached_property
    def measured(self) -> dict[int, int]:
        """The measurement of each commanded column that has one."""
        commands = [k for k in self.ranks if self.roles[k] == "input"]
        others = [k for k in self.ranks if commands and self.roles[k] != "input" and not is_raw_signal(self.table, k)]
        return {k: j for k, j in itertools.product(commands, others) if self._follows(j, k)}

    def _follows(self, j: int, k: int) -> bool:
        """Whether column j measures what column k commands."""
        names, units, columns = self.table.names, self.table.units, self.table.columns
        told = units[k] or column_quantity(names[k])
        if self.kinds[j] in _FIELDS and not (self.alone or told):
            return proportional(columns[k], columns[j])  # the field of a coil and the output of its source
        one_unit = units[j] == units[k] and bool(units[k] or self.kinds[k])
        alike = one_unit or without_role(names[j]) == without_role(names[k]) != ""
        # "ref" has the quantity of what follows it, as a set value without quantity and unit has.
        bare = without_role(names[k]) == "" or not told
        belongs = self.kinds[k] in (self.kinds[j], "" if bare else self.kinds[j]) and (alike or bare)
        return belongs and bool(np.sqrt(np.nanmean((columns[j] - columns[k]) ** 2)) < _FOLLOWS * extent(columns[k]))

    def is_followed(self, i: int, o: int) -> bool:
        """Whether the input is a reference without a name of its own, as "ref" is, and the output what follows it."""
        return self.measured.get(i) == o and without_role(self.table.names[i]) == ""

    def heats(self, i: int) -> bool:
        """Whether a column is that of a heater beside the temperature that it changes, which drives whatever else changes."""
        warmed = any(self.kinds[k] == "temperature" and extent(self.table.columns[k]) > HEATED for k in self.ranks)
        return warmed and bool(_HEATERS & parts_of(self.table.names[i]))

    def set_values(self, i: int, o: int) -> int:
        """How many of two columns are set values in place of measured ones: those of a controller whose command is followed.

        Beside a position that is followed, forces and currents are computed from its command.
        """
        ahead = self.kinds[i] in ("force", "current") and any(
            self.kinds[k] in ("displacement", "") for k in self.measured
        )
        instead = self.roles[i] == "input" and (ahead or (i in self.measured and self.kinds[i] != self.kinds[o]))
        # A field or voltage that follows its command is no response; the current of a motor and the temperature of a heater are.
        source = self.kinds[o] in (*_FIELDS, "voltage") and o in self.measured.values()
        return instead + source + (bool(self.measured) and self.roles[o] == "input")

    @functools.cached_property
    def by_steps(self) -> ByColumn:
        """Whether a column goes by equal steps or is held equally long, as one that was set; not where changes are logged."""
        columns = self.table.columns
        times = (columns[k] for k, kind in self.kinds.items() if kind == "time" or k in self.table.stamps)
        clocks = (time for time in times if not (np.diff(time) < 0).any())
        logged = any(not is_even(clock) for clock in clocks)  # at each change of a value, by one digit of a sensor
        # Not rows that are printed twice
        moved = np.any([np.diff(columns[k], prepend=np.nan) != 0 for k in self.kinds], axis=0)
        return ByColumn(lambda k: not logged and by_equal_steps(columns[k][moved]))

    @functools.cached_property
    def overtones(self) -> ByColumn:
        """See `signal_evidence.overtones`."""
        return ByColumn(lambda k: overtones(self.table.columns[k]))

    @functools.cached_property
    def smoothness(self) -> ByColumn:
        """See `signal_evidence.smoothness`."""
        return ByColumn(lambda k: smoothness(self.table.columns[k]))

    @functools.cached_property
    def roughness(self) -> ByColumn:
        """See `signal_evidence.roughness`."""
        return ByColumn(lambda k: roughness(self.table.columns[k]))

    @functools.cached_property
    def _largest_component(self) -> float:
        return max((extent(self.table.columns[k]) for k in self.components), default=0.0)

    def is_out_of_phase(self, k: int) -> bool:
        """Whether a column is the small component of a signal of a lock-in amplifier."""
        return k in self.components and extent(self.table.columns[k]) < _OF_LARGEST * self._largest_component

    def is_relative(self, k: int) -> bool:
        """Whether a column is a number without a quantity that was computed from a column that has one: a magnetoresistance in percent."""
        columns, unit, kinds = self.table.columns, self.table.units, self.kinds
        of = lambda j: kinds[j] and quantity(unit[j]) and rounded(columns[k], columns[j])
        return not kinds[k] and unit[k] in _RELATIVE and any(map(of, self.ranks))

    def is_raw_beside(self, i: int, o: int) -> bool:
        """Whether an output is a sensor's signal in volts, beside a quantity in a unit of its own that belongs to the input as well."""
        in_volts = lambda k: quantity(self.table.units[k]) in ("", "voltage")
        usual = lambda k: PAIRS.get((self.kinds[i], self.kinds[k]), 0.0)
        signal = quantity(self.table.units[o]) == "voltage" != self.kinds[o]
        return signal and any(usual(k) >= usual(o) > 0 for k in self.ranks if k not in (i, o) and not in_volts(k))

    def is_sensed(self, k: int) -> bool:
        """Whether a voltage is that of a sensor: one in mV of which no word says that it is a voltage or drives."""
        unit, named = parse_unit(self.table.units[k]), column_quantity(self._bases[k]) == "voltage"
        return unit is not None and 0.0 < unit.factor <= _OF_SENSORS and self.roles[k] != "input" and not named

    def is_controlled(self, k: int) -> bool:
        """Whether beside a column that was set, what it sets was measured too: a second sensor, or the field of a magnet's current."""
        kinds, columns = self.kinds, self.table.columns
        of_magnet = lambda j: kinds[k] == "current" and kinds[j] in _FIELDS and proportional(columns[k], columns[j])
        twin = any(kinds[j] == kinds[k] != "" or (of_magnet(j) and not self.alone) for j in self.ranks if j != k)
        return twin or (bool(self.measured) and self.roles[k] == "input")


class ByColumn(dict[int, float]):
    """A number of each column, computed once, where it is asked for."""

    def __init__(self, compute: Callable[[int], float]) -> None:
        self._compute = compute

    def __missing__(self, position: int) -> float:
        self[position] = self._compute(position)
        return self[position]


def _lock_in(table: Table, kinds: Mapping[int, str]) -> tuple[int, ...]:
    """The columns X and Y that are components of one signal, as X is no displacement; none in other tables."""
    bases = {split_unit(name)[0].strip().lower(): k for k, name in enumerate(table.names)}
    components = bases.get("x", -1), bases.get("y", -1)
    return components if min(components) >= 0 and kinds.get(components[0]) != "displacement" else ()


def _roles(table: Table, components: Sequence[int], kinds: Mapping[int, str]) -> dict[int, str]:
    """The role that the name of each column states; "" for the others: for a y that is a length, as a deflection is, or a component.

    A reference is no set value beside another input of its quantity, as that of Sawyer and Tower's capacitor is none beside the drive, nor
    are windings input and output beside the field that they make.
    """
    is_length = lambda k, base: base.strip().lower() == "y" and quantity(table.units[k]) == "displacement"
    of_coil = lambda name: "field" in kinds.values() and _WINDING.search(name) is not None
    no_role = lambda k, name: is_length(k, split_unit(name)[0]) or of_coil(name)
    role = lambda k, name: "output" if k in components else "" if no_role(k, name) else column_role(name)
    roles = {k: role(k, name) if table.named else "" for k, name in enumerate(table.names)}
    references = {k for k in roles if roles[k] == "input" and _REFERENCE.search(table.names[k])}
    driven = {kinds[k] for k in roles if roles[k] == "input" and k not in references}
    return roles | dict.fromkeys((k for k in references if kinds[k] in driven and kinds[k]), "")


def _axes(names: Sequence[str]) -> dict[int, str]:
    """The axis of names that are those of components of a vector, such as Fx beside Fy, as their ends tell; "" of others."""
    alike = lambda name, axes: any(f"{name[:-1]}{other}" in names for other in axes if other != name[-1])
    axis = lambda name: next((name[-1] for axes in ("xyz", "XYZ") if name[-1] in axes and alike(name, axes)), "")
    return {k: axis(name).lower() if name[1:] else "" for k, name in enumerate(names)}


def _ranks(table: Table, free: Sequence[int], kinds: Mapping[int, str], roles: Mapping[int, str]) -> dict[int, int]:
    """Place of each column among those of its quantity, of components of a force that which moves most first.

    The elements of one of several arrays (q[0], q[1], tau[0], tau[1]) have one place: which joint of a robot moves is told by the signals.
    """
    count: dict[tuple[str, str], int] = {}
    of_array: dict[tuple[tuple[str, str], str], int] = {}
    ranks = {}
    bases = [split_unit(name)[0].strip() for name in table.names]
    arrays = {k: base[: match.start()] for k, base in enumerate(bases) if (match := _ELEMENT.search(base))}
    several = len({*arrays.values()}) > 1
    forces = {k: bases[k][:-1] for k, axis in _axes(bases).items() if axis and kinds[k] == "force"}
    first = {stem: k for k, stem in reversed(forces.items())}
    place = lambda k: (first[forces[k]], -extent(table.columns[k])) if k in forces else (k, 0.0)
    for k in sorted(free, key=lambda k: (secondary(table.names[k]), *place(k))):
        group = (kinds[k], roles[k])
        array = arrays.get(k, "") if several else ""
        ranks[k] = of_array.get((group, array), count.get(group, 0))
        if array:
            of_array[group, array] = ranks[k]
        count[group] = max(count.get(group, 0), ranks[k] + 1)
    return ranks


def is_raw_signal(table: Table, position: int) -> bool:
    """Whether a column in volts has the name of another one in a unit of its own, Force (V) beside Force (N), or is that across a shunt.

    The voltage across a shunt and that of a lock-in amplifier are proportional to the current or resistance computed from them.
    """
    name = split_unit(table.names[position])[0].strip().lower()
    unit = table.units[position]
    if not name or "voltage" not in (quantity(unit), table.quantity(position)):
        return False

    def measures(k: int) -> bool:
        kind = quantity(table.units[k])
        if kind in ("", "voltage"):
            return False
        computable = kind in _OF_VOLTAGES and k not in table.labels
        same = split_unit(table.names[k])[0].strip().lower() == name
        return same or (computable and proportional(table.columns[position], table.columns[k]))

    return any(measures(k) for k in table.positions if k != position)
