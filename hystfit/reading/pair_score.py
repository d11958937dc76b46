"""The evidence for a pair of columns as input and output: quantities, units, names, signals and loops, added up in one score.

Points are like logarithms of odds: what is measured or written for certain outweighs what is only usual.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hystfit.params.units import quantity
from hystfit.reading.column_names import SIDES, column_role, is_bare_role, is_channel, parts_of, secondary, without_role
from hystfit.reading.names_with_units import split_unit
from hystfit.reading.quantity_points import DRIVE, LOADS, PAIRS, RESPONSE, SELDOM
from hystfit.reading.raw_table import Table
from hystfit.reading.signal_evidence import (
    by_equal_steps,
    computed,
    explained,
    extent,
    is_even,
    is_held,
    overtones,
    proportional,
    repeats,
    roughness,
    sample,
    smoothness,
)

# Points of a column whose name states its role ("input", "response"), in that role and in the other one: less than those of a pair of
# quantities, as the output of a voltage source is the input of an actuator.
_STATED, _CONTRARY = 3.2, -1.0
# Further points in the other role where the name says nothing but the role: "Sensor output" is that of a sensor.
_BARE = -1.0
# Points of a commanded input beside the measured one, as that which an actuator reached drives the output, and of a commanded output
# there. The two are of one unit, or named alike, and differ by less than that part of the range: following errors are 0.001 to 0.05.
_OVERTAKEN, _FOLLOWS = -5.0, 0.1
# Points of a commanded load and its measurement, beside which the specimen moves.
_FOLLOWED = -3.0
# Points of a displacement or field whose range is less than that part of the largest one of its unit: a slip, an uplift or the strain of
# a part; the component of a field across its direction, or its size, which has no sign; the component of a signal out of phase. Points of
# components along one axis (Bx, mx).
_PARTIAL, _OF_LARGEST, _ALONG = -1.0, 0.3, 1.0
_TRANSVERSE = 0.6  # the same part of strains: one across the load is up to half of that along it
# Points of two columns of one part or axis by their names: more than those of two places.
_SAME_PART = 0.5
_OF_PARTS = ("displacement", "strain", "field", "induction")
_OF_VOLTAGES = ("current", "resistance")  # quantities that are computed from voltages
# Points of columns that are called input and output and alike but for that: input_angle, output_angle.
_PARTNERS = 2.0
_SECONDARY = -1.5  # for each word such as "raw" or "min" in a name
_RAW_VOLTS = -3.0  # of a sensor's signal in volts beside the same quantity in its own unit
HEATED = 10.0  # degrees over which a temperature must vary to be an input
_COLD = -5.0  # points of one that does not
# Distinct values up to which a column of many rows is one that is set, and its points.
_FEW, _MANY_ROWS, _IS_SET = 12, 50, -2.0
# Points of a clean wave (harmonics up to that part of its power; a triangle has 0.014) beside one with that many times more harmonics.
# Fewer samples show no harmonics.
_CLEAN, _PURE, _PLAINER, _WAVE = 1.0, 0.02, 2.0, 64
# Points of a pair of which the input, with its direction, explains nothing of the output; none are lost where it explains half of its
# variance. Loops with minor loops have 0.9 explained, a drifting temperature less than 0.1.
_UNRELATED, _RELATED = -4.5, 0.5
# Points of a pair of equal numbers, or of one quantity that is proportional: a second sensor of the input. Further ones of a pair of which
# one was computed from the other, whatever its quantity: the output of a source and the field of its coil.
_COPY, _COMPUTED = -3.0, -3.0
# Points of proportional columns of different quantities, but for those that belong together by that many points: the field of a coil and
# the voltage of its source are no loop, while the induction of a magnet may follow a straight line.
_STRAIGHT, _TOGETHER = -1.0, 4.0
# Points of a column that stays near one value far from zero, and further ones as the input: a condition held constant, such as 300.02 K.
_HELD, _HELD_INPUT = -2.5, -4.0
# Correlation of neighboring samples below which an input is noise about a value that is held, and its points: a sine of three samples a
# half cycle has 0.5, and four a whole one 0.
_WHITE, _NO_DRIVE = 0.3, -2.0
_LATER = -0.25  # of each further column of the same quantity, and of an input after its output
# Points of a commanded column beside a measured one, whose noise is that many times larger: a D/A converter beside a sensor.
_COMMANDED, _NOISIER = 1.0, 10.0
# Points of an input that was set: it goes up and down by equal steps or holds, and the output does not. They outweigh the quantities (a
# displacement that was set and the voltage of its sensor, a load and the displacement under it) but for a field and its induction.
_SET_BY_STEPS = 8.0
# Difference of points below which neither of two readings is better: that of one place among columns of the same quantity (0.25)
# decides, as people write the main channel first; nothing smaller is evidence.
TIE = 0.2


@dataclasses.dataclass(frozen=True)
class Reading:
    """A pair of columns and its points."""

    input: int
    output: int
    points: float


def readings(
    table: Table, free: Sequence[int], kinds: Mapping[int, str], given: Mapping[str, int], *, named: bool
) -> list[Reading]:
    """All readings, the best first.

    Args:
        free: columns that may be chosen.
        kinds: the physical quantity of every column.
        given: the input or output that is chosen already.
        named: whether the columns have names.
    """
    inputs, outputs = ([given[role]] if role in given else list(free) for role in ("input", "output"))
    alone = len({*inputs, *outputs}) == 2  # there is no other column to choose
    # Of more than two channels that have a number instead of a name, the order means nothing.
    equal = [k for k in free if kinds[k] == "" and (not named or is_channel(table.names[k]))]
    equal = equal if len(equal) > 2 else []
    components = _lock_in(table, kinds)
    roles = _roles(table, components)
    ranks = dict.fromkeys(equal, 0) | _ranks(table, [k for k in free if k not in equal], kinds, roles)
    evidence = _Evidence(table, kinds, components, roles, ranks, frozenset(equal), alone)
    found = [evidence.reading(i, o) for i, o in itertools.product(inputs, outputs) if i != o]
    if not alone:
        found = evidence.related(found)
    return sorted(found, key=lambda reading: (-reading.points, reading.input, reading.output))


def _lock_in(table: Table, kinds: Mapping[int, str]) -> tuple[int, ...]:
    """The columns X and Y that are components of one signal, as X is no displacement; none in other tables."""
    bases = {split_unit(name)[0].strip().lower(): k for k, name in enumerate(table.names)}
    components = bases.get("x", -1), bases.get("y", -1)
    return components if min(components) >= 0 and kinds.get(components[0]) != "displacement" else ()


def _roles(table: Table, components: Sequence[int]) -> dict[int, str]:
    """The role that the name of each column states; "" for the others: for a y that is a length, as a deflection is, or a component."""
    is_length = lambda k, name: (
        split_unit(name)[0].strip().lower() == "y" and quantity(table.units[k]) == "displacement"
    )
    told = lambda k, name: table.named and k not in components and not is_length(k, name)
    return {k: column_role(name) if told(k, name) else "" for k, name in enumerate(table.names)}


def _ranks(table: Table, free: Sequence[int], kinds: Mapping[int, str], roles: Mapping[int, str]) -> dict[int, int]:
    """Place of each column among those of its quantity."""
    count: dict[tuple[str, str], int] = {}
    ranks = {}
    for k in sorted(free, key=lambda k: (secondary(table.names[k]), k)):
        group = (kinds[k], roles[k])
        ranks[k] = count.get(group, 0)
        count[group] = ranks[k] + 1
    return ranks


@dataclasses.dataclass(frozen=True)
class _Evidence:
    """What speaks for columns of a table as input and output.

    Attributes:
        kinds: the physical quantity of every column.
        components: those of one signal that a lock-in amplifier writes.
        roles: that which the name of every column states.
        ranks: place of each among those of its quantity.
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

    def reading(self, i: int, o: int) -> Reading:
        """Column i as the input and column o as the output, by their names, units and signals, each for itself."""
        kinds, later = self.kinds, self.ranks.get(i, 0) + self.ranks.get(o, 0)
        overtaken = kinds[i] != kinds[o] and i in self._measured
        driven = self.roles[o] == "output" or (self.roles[i] == "input" and not overtaken)
        points = (
            self._of_quantity(i, DRIVE, told=driven)
            + self._of_quantity(o, RESPONSE, told=self.roles[o] == "output")
            + self._of_pair(i, o)
        )
        points += _LATER * (later + (i > o and not {i, o} <= self.equal))
        points += self._of_role(i, "input") + self._of_role(o, "output") + self._of_signal[i] + self._of_signal[o]
        across = kinds[o] == "strain" and self._is_partial[o]
        points += _PARTIAL * (self._is_partial[i] + across) + _HELD_INPUT * self._is_held[i]
        points += _NO_DRIVE * (not self.alone and self._smoothness[i] < _WHITE)
        points += _ALONG * (self._axis[i] == self._axis[o] != "") + _SAME_PART * self._of_one_part(i, o)
        points += _PARTNERS * self._are_partners(i, o)
        points += _OVERTAKEN * self._set_values(i, o)
        # Beside a set value that was measured too, the measurement drives.
        twin = any(kinds[k] == kinds[i] != "" for k in self.ranks if k != i)
        controlled = twin or (bool(self._measured) and self.roles[i] == "input")
        answers = kinds[o] in RESPONSE and not self._by_steps[o]
        points += _SET_BY_STEPS * (self._by_steps[i] and answers and not controlled)
        if not self.alone and kinds[i] == "temperature" and extent(self.table.columns[i]) < HEATED:
            points += _COLD
        told = {i, o} <= self.equal or self.roles[i] or self.roles[o]
        if self.table.rows >= _WAVE and _either_drives(kinds[i], kinds[o]) and not told:
            plain, bent = self._overtones[i], self._overtones[o]
            points += _CLEAN * (plain <= _PURE and bent > _PLAINER * plain)
            points += _COMMANDED * (self._roughness[o] > _NOISIER * self._roughness[i])
        return Reading(i, o, points)

    def related(self, found: Sequence[Reading]) -> list[Reading]:
        """The readings, those that could be the best with the points of how the two columns are related."""
        reach = max(reading.points for reading in found) + _UNRELATED - TIE
        columns = self.table.columns
        part = self.table.curve if self.table.part is None else self.table.part

        def lost(reading: Reading) -> float:
            u, y = columns[reading.input], columns[reading.output]
            share = explained(u, y, part)
            if {reading.input, reading.output} <= self.equal:  # how they are related does not tell which drives
                return _UNRELATED * max(0.0, 1.0 - max(share, explained(y, u, part)) / _RELATED)
            unrelated = _UNRELATED * max(0.0, 1.0 - share / _RELATED)
            if computed(u, y):
                return unrelated + _COMPUTED + _COPY
            if repeats(u, y) or self._are_sides(reading.input, reading.output):
                return unrelated + _COPY
            kinds = self.kinds[reading.input], self.kinds[reading.output]
            line = _COPY if kinds[0] == kinds[1] else _STRAIGHT if PAIRS.get(kinds, 0.0) < _TOGETHER else 0.0
            return unrelated + (line * proportional(u, y) if line else 0.0)

        return [
            dataclasses.replace(
                reading, points=reading.points + (lost(reading) if reading.points >= reach else _UNRELATED)
            )
            for reading in found
        ]

    def _are_sides(self, i: int, o: int) -> bool:
        """Whether two columns are one quantity at two sides of a specimen, by their names: "Left angle", "Right angle"."""
        sides = self._parts[i] & SIDES, self._parts[o] & SIDES
        return all(sides) and self._parts[i] - SIDES == self._parts[o] - SIDES and self.kinds[i] == self.kinds[o]

    def _are_partners(self, i: int, o: int) -> bool:
        """Whether the names of two columns differ by their roles alone."""
        names = [without_role(self.table.names[k]) for k in (i, o)]
        return (self.roles[i], self.roles[o]) == ("input", "output") and names[0] == names[1] != ""

    def _of_one_part(self, i: int, o: int) -> bool:
        """Whether names tell that two columns are of one part, and not a command and its own measurement."""
        return bool(self._parts[i] & self._parts[o]) and self._measured.get(i) != o

    @functools.cached_property
    def _parts(self) -> dict[int, frozenset[str]]:
        """Words in the name of each column that tell it from others: x of Disp_X beside Disp_Y, shear of ShearStrain."""
        words = {
            k: parts_of(without_role(name)) if self.table.named else frozenset()
            for k, name in enumerate(self.table.names)
        }
        common = frozenset.intersection(*(words[k] for k in self.ranks)) if self.ranks else frozenset()
        return {k: own - common for k, own in words.items()}

    def _of_quantity(self, position: int, usual: Mapping[str, float], *, told: bool) -> float:
        """Points of the quantity of a column in a role; one that the names tell to have it is not unusual."""
        points = usual.get(self.kinds[position], SELDOM)
        return max(points, usual[""]) if told and self.kinds[position] not in ("index", "error") else points

    def _of_role(self, position: int, role: str) -> float:
        """Points of a column in a role, by the one that its name states."""
        stated = self.roles[position]
        contrary = _CONTRARY + _BARE * (bool(stated) and is_bare_role(self.table.names[position]))
        return 0.0 if not stated else _STATED if stated == role else contrary

    @functools.cached_property
    def _of_signal(self) -> _ByColumn:
        """Points of each column in either role."""
        table = self.table

        signal = max((extent(table.columns[k]) for k in self.components), default=0.0)

        def points(k: int) -> float:
            values = table.columns[k]
            few = table.rows >= _MANY_ROWS and all(np.unique(some).size <= _FEW for some in (sample(values), values))
            few &= not self._by_steps[k]
            return (
                _SECONDARY * self._is_secondary(k)
                + _RAW_VOLTS * _is_raw_signal(table, k)
                + _IS_SET * few
                + _HELD * self._is_held[k]
                + _PARTIAL * (k in self.components and extent(values) < _OF_LARGEST * signal)
            )

        return _ByColumn(points)

    def _is_secondary(self, k: int) -> int:
        """By how many words of its name a column comes after another one of its quantity."""
        alike = [secondary(self.table.names[j]) for j in self.ranks if self.kinds[j] == self.kinds[k]]
        return secondary(self.table.names[k]) - min(alike, default=0)

    @functools.cached_property
    def _is_held(self) -> _ByColumn:
        """Whether a column is a condition that is held, by column; never of the only two."""
        return _ByColumn(lambda k: not self.alone and is_held(self.table.columns[k]))

    @functools.cached_property
    def _bases(self) -> list[str]:
        return [split_unit(name)[0].strip() for name in self.table.names]

    @functools.cached_property
    def _axis(self) -> dict[int, str]:
        """The axis of columns that are components of a vector, as the ends of their names tell; "" of others."""
        names = self._bases
        is_component = lambda name: (
            name[1:]
            and name[-1] in "xyz"
            and any(f"{name[:-1]}{other}" in names for other in "xyz" if other != name[-1])
        )
        return {k: name[-1] if is_component(name) else "" for k, name in enumerate(names)}

    @functools.cached_property
    def _is_partial(self) -> _ByColumn:
        """Whether a column is the displacement of a part of the device or a part of its field, by column."""
        extents: dict[tuple[str, str], float] = {}
        vectors = {self._bases[k][:-1] for k, axis in self._axis.items() if axis}
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

        return _ByColumn(partial)

    @functools.cached_property
    def _measured(self) -> dict[int, int]:
        """The measurement of each commanded column that has one."""
        commands = [k for k in self.ranks if self.roles[k] == "input"]
        others = [k for k in self.ranks if commands and self.roles[k] != "input" and not _is_raw_signal(self.table, k)]
        return {k: j for k, j in itertools.product(commands, others) if self._follows(j, k)}

    def _follows(self, j: int, k: int) -> bool:
        """Whether column j measures what column k commands."""
        names, units, columns = self.table.names, self.table.units, self.table.columns
        alike = units[j] == units[k] != "" or without_role(names[j]) == without_role(names[k]) != ""
        if self.kinds[j] != self.kinds[k] or not alike:
            return False
        return bool(np.sqrt(np.nanmean((columns[j] - columns[k]) ** 2)) < _FOLLOWS * extent(columns[k]))

    def _set_values(self, i: int, o: int) -> int:
        """How many of two columns are set values in place of measured ones: those of a controller whose command is followed.

        Beside a position that is followed, forces and currents are computed from its command.
        """
        ahead = self.kinds[i] in ("force", "current") and any(
            self.kinds[k] in ("displacement", "") for k in self._measured
        )
        instead = self.roles[i] == "input" and (ahead or (i in self._measured and self.kinds[i] != self.kinds[o]))
        return instead + (bool(self._measured) and self.roles[o] == "input")

    def _of_pair(self, i: int, o: int) -> float:
        """Points of quantities that belong together: a position that follows its command drives the current of the motor."""
        kinds = self.kinds[i], self.kinds[o]
        measured = self._measured.values()
        # A load that is controlled, and nothing else, drives.
        loads = [k for k, kind in zip((i, o), kinds, strict=True) if kind in LOADS and k in measured]
        if loads and {self.kinds[k] for k in self._measured} <= {*LOADS}:
            return _FOLLOWED if self._measured.get(i) == o else PAIRS.get(kinds[::-1], 0.0) * (kinds[0] in LOADS)
        beside = o if kinds[0] == "current" else i
        if "current" in kinds and self.kinds[beside] in ("displacement", "") and beside in measured:
            return PAIRS["current", "displacement"] * (beside == i)
        return PAIRS.get(kinds, 0.0)

    @functools.cached_property
    def _by_steps(self) -> _ByColumn:
        columns = self.table.columns
        times = (columns[k] for k, kind in self.kinds.items() if kind == "time" or k in self.table.stamps)
        clocks = (time for time in times if not (np.diff(time) < 0).any())
        logged = any(not is_even(clock) for clock in clocks)  # at each change of a value, by one digit of a sensor
        return _ByColumn(lambda k: not logged and by_equal_steps(columns[k]))

    @functools.cached_property
    def _overtones(self) -> _ByColumn:
        return _ByColumn(lambda k: overtones(self.table.columns[k]))

    @functools.cached_property
    def _smoothness(self) -> _ByColumn:
        return _ByColumn(lambda k: smoothness(self.table.columns[k]))

    @functools.cached_property
    def _roughness(self) -> _ByColumn:
        return _ByColumn(lambda k: roughness(self.table.columns[k]))


class _ByColumn(dict[int, float]):
    """A number of each column, computed once, where it is asked for."""

    def __init__(self, compute: Callable[[int], float]) -> None:
        self._compute = compute

    def __missing__(self, position: int) -> float:
        self[position] = self._compute(position)
        return self[position]


def _either_drives(one: str, other: str) -> bool:
    """Whether quantities do not tell which of two columns drives the other."""
    return {one, other} in ({""}, {"voltage", "current"}, {"voltage"}, {"current"})


def _is_raw_signal(table: Table, position: int) -> bool:
    """Whether a column in volts has the name of another one in a unit of its own, Force (V) beside Force (N), or is that across a shunt.

    The voltage across a shunt and that of a lock-in amplifier are proportional to the current or resistance computed from them.
    """
    name = split_unit(table.names[position])[0].strip().lower()
    if not name or quantity(table.units[position]) != "voltage":
        return False

    def measures(k: int) -> bool:
        kind = quantity(table.units[k])
        if kind in ("", "voltage"):
            return False
        computable = kind in _OF_VOLTAGES and k not in table.labels
        same = split_unit(table.names[k])[0].strip().lower() == name
        return same or (computable and proportional(table.columns[position], table.columns[k]))

    return any(measures(k) for k in range(len(table.names)) if k != position)
