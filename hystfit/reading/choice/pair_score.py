"""The evidence for a pair of columns as input and output: quantities, units, names, signals and loops, added up in one score.

Points are like logarithms of odds: what is measured or written for certain outweighs what is only usual.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from hystfit.data.circulation import OF_RATE, of_rate
from hystfit.reading.choice.column_facts import HEATED, SOURCES, ByColumn, ColumnFacts, is_raw_signal
from hystfit.reading.choice.quantity_points import DRIVE, LOADS, PAIRS, RESPONSE, SELDOM
from hystfit.reading.names.column_names import has_terminals, is_bare_role
from hystfit.reading.table.held_levels import levels_in_turn
from hystfit.reading.table.raw_table import Table
from hystfit.reading.table.signal_evidence import (
    computed,
    explained,
    extent,
    has_loop,
    moves_at_rest,
    proportional,
    repeats,
    resolution,
    rises_evenly,
    sample,
    set_again,
)

# Points of a column whose name states its role ("input", "response"), in that role and in the other one: less than those of a pair of
# quantities, as the output of a voltage source is the input of an actuator.
_STATED, _CONTRARY = 3.2, -1.0
# Further points in the other role where the name says nothing but the role: "Sensor output" is that of a sensor.
_BARE = -1.0
# Points of a commanded input beside the measured one, as that which an actuator reached drives the output, and of a commanded output there.
_OVERTAKEN = -5.0
# Points of a commanded load and its measurement, beside which the specimen moves, and of the reference of a controller and what follows it.
_FOLLOWED = -3.0
# Points of a displacement or field of a part, of the size of a vector, which has no sign, and of the component of a signal out of phase.
# Points of components along one axis (Bx, mx).
_PARTIAL, _ALONG = -1.0, 1.0
# Points of two columns of one part or axis by their names: more than those of two places.
_SAME_PART = 0.5
# Points of columns that are called input and output and alike but for that: input_angle, output_angle.
_PARTNERS = 2.0
_SECONDARY = -1.5  # for each word such as "raw" or "min" in a name
_RAW_VOLTS = -3.0  # of a sensor's signal in volts beside the same quantity in its own unit
_COLD = -5.0  # points of one that does not
# Distinct values up to which a column of many rows is one that is set, and its points.
_FEW, _MANY_ROWS, _IS_SET = 12, 50, -2.0
# Points of a clean wave (harmonics up to that part of its power; a triangle has 0.014) beside one with that many times more harmonics.
# Fewer samples show no harmonics.
_CLEAN, _PURE, _PLAINER, _WAVE = 1.0, 0.02, 2.0, 64
# Points of an input of which the output is the rate, and by more than the other way around, or equally and with its sign, which is worth
# that much more.
_INDUCED, _OF_ITS_SIGN = 2.0, 0.1
# Points of a pair of which the input, with its direction, explains nothing of the output; none are lost where it explains half of its
# variance. Loops with minor loops have 0.9 explained, a drifting temperature less than 0.1.
_UNRELATED, _RELATED = -4.5, 0.5
# Points of a pair of equal numbers, of two temperatures, or of one quantity that is proportional: a second sensor of the input. Further
# ones of a pair of which one was computed from the other, whatever its quantity: the output of a source and the field of its coil.
_COPY, _COMPUTED = -3.0, -3.0
# Points of the current of a heater, beside a temperature that explains more than that part of what moves while the current rests.
_HEATING, _WELL = -4.5, 0.95
_ELECTRIC, _MOVES = ("voltage", "current"), ("displacement", "strain", "force", "stress")
# Points of proportional columns of different quantities, but for those that belong together by that many points: the field of a coil and
# the voltage of its source are no loop, while the induction of a magnet may follow a straight line.
_STRAIGHT, _TOGETHER = -1.0, 4.0
# Points of a column that stays near one value far from zero, and further ones as the input: a condition held constant, such as 300.02 K.
_HELD, _HELD_INPUT = -2.5, -4.0
# Points of quantities that belong together, of which an output that the input explains is none: the resistance of a film changes by 0.5 %
# over a loop of the field.
_BELONG = 3.0
# Correlation of neighboring samples below which an input is noise about a value that is held, and its points: a sine of three samples a
# half cycle has 0.5, and four a whole one 0.
_WHITE, _NO_DRIVE = 0.3, -2.0
_LOOP = 0.5  # of an output that has a loop, where another one without it would be better by its place alone
_LATER = -0.25  # of each further column of the same quantity, and of an input after its output
# Points of a commanded column beside a measured one, whose noise is that many times larger: a D/A converter beside a sensor.
_COMMANDED, _NOISIER = 1.0, 10.0
# Points of an input that has most of its very values in both directions, of which the output has few: those of a table, or that were set
# by hand. They outweigh both of a wave, as the steps of a table are no noise.
_AGAIN, _MOSTLY, _SELDOM_AGAIN = 2.5, 0.9, 0.5
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
    evidence = _Evidence(ColumnFacts.of(table, free, kinds, alone=alone, named=named))
    found = [evidence.reading(i, o) for i, o in itertools.product(inputs, outputs) if i != o]
    if alone:
        found = [dataclasses.replace(one, points=one.points + evidence.of_clock(one)) for one in found]
    else:
        found = evidence.related(found)
    return sorted(found, key=lambda reading: (-reading.points, reading.input, reading.output))


@dataclasses.dataclass(frozen=True)
class _Evidence:
    """What speaks for columns of a table as input and output."""

    facts: ColumnFacts

    def reading(self, i: int, o: int) -> Reading:
        """Column i as the input and column o as the output, by their names, units and signals, each for itself."""
        kinds, later = self.facts.kinds, self.facts.ranks.get(i, 0) + self.facts.ranks.get(o, 0)
        heats = kinds[o] != "temperature" and self.facts.heats(i)
        overtaken = heats or (kinds[i] != kinds[o] and i in self.facts.measured)
        driven = self.facts.roles[o] == "output" or (self.facts.roles[i] == "input" and not overtaken)
        points = (
            self._of_quantity(i, DRIVE, told=driven)
            + self._of_quantity(o, RESPONSE, told=self.facts.roles[o] == "output")
            + self._of_pair(i, o)
        )
        points += _LATER * (later + (i > o and not {i, o} <= self.facts.equal)) * (not self.facts.is_open(i))
        stated = self._of_role(i, "input") * (not heats) + self._of_role(o, "output")
        points += stated + self._of_signal[i] + self._of_signal[o]
        across = kinds[o] == "strain" and self.facts.is_partial[o]
        points += _PARTIAL * (self.facts.is_partial[i] + across + self.facts.is_share[o])
        points += _HELD_INPUT * (self.facts.is_held[i] or self.facts.has_two_states[i])
        points += _NO_DRIVE * (not self.facts.alone and self.facts.smoothness[i] < _WHITE)
        points += _ALONG * (self.facts.axis[i] == self.facts.axis[o] != "") + _SAME_PART * self.facts.of_one_part(i, o)
        points += _PARTNERS * self.facts.are_partners(i, o)
        points += _OVERTAKEN * (self.facts.set_values(i, o) + heats) + _FOLLOWED * self.facts.is_followed(i, o)
        answers = kinds[o] in RESPONSE and not self._is_set(o)
        points += _SET_BY_STEPS * (self._is_set(i) and answers and not self.facts.is_controlled(i))
        cold = kinds[i] == "temperature" and extent(self.facts.table.columns[i]) < HEATED
        points += _COLD * (cold and not (self.facts.alone or self.facts.has_two_states[o]))
        points += _RAW_VOLTS * self.facts.is_raw_beside(i, o)
        names = self.facts.table.names
        told = {i, o} <= self.facts.equal or self.facts.roles[i] or self.facts.roles[o] or has_terminals(names)
        if kinds[i] == kinds[o] == "" and not told:
            points += _AGAIN * (self._again[i] > _MOSTLY and self._again[o] < _SELDOM_AGAIN)
        if self.facts.table.rows >= _WAVE and _either_drives(kinds[i], kinds[o]) and not told:
            wave = self.facts.overtones
            plainer = lambda one, other: wave[one] <= _PURE and wave[other] > _PLAINER * wave[one]
            points += _CLEAN * plainer(i, o)
            hidden = resolution(self.facts.table.columns[i])  # noise of the input that its digits may hide
            points += _COMMANDED * (self.facts.roughness[o] > max(_NOISIER * self.facts.roughness[i], hidden))
            points += _INDUCED * (kinds[i] != kinds[o] and self._is_induced(i, o))
        return Reading(i, o, points)

    def _is_set(self, k: int) -> bool:
        """Whether a column was set by equal steps; a load beside a velocity answers to the motion, by equal steps too."""
        answers = self.facts.kinds[k] in LOADS and "velocity" in self.facts.kinds.values()
        return bool(self.facts.by_steps[k]) and not answers

    def related(self, found: Sequence[Reading]) -> list[Reading]:
        """The readings, those that could be the best with the points of how the two columns are related."""
        reach = max(reading.points for reading in found) + _UNRELATED - TIE
        columns = self.facts.table.columns

        def held(reading: Reading) -> float:
            """Points that an output lost because it stays near one value, of which it is no condition where the input explains it."""
            kinds = self.facts.kinds[reading.input], self.facts.kinds[reading.output]
            return _HELD * (PAIRS.get(kinds, 0.0) >= _BELONG and self.facts.is_held[reading.output])

        def lost(reading: Reading) -> float:
            u, y = columns[reading.input], columns[reading.output]
            if clocked := self.of_clock(reading):
                return clocked
            part = self._parts(reading)
            share = explained(u, y, part)
            if {reading.input, reading.output} <= self.facts.equal:  # how they are related does not tell which drives
                return _UNRELATED * max(0.0, 1.0 - max(share, explained(y, u, part)) / _RELATED)
            unrelated = _UNRELATED * max(0.0, 1.0 - share / _RELATED) + _HEATING * self._heats(reading, part)
            unrelated += _HEATING * self._is_thermostat(reading, part)
            if computed(u, y):
                return unrelated + _COMPUTED + _COPY
            kinds = self.facts.kinds[reading.input], self.facts.kinds[reading.output]
            unrelated -= held(reading) * (share > _RELATED)
            thermometers = kinds == ("temperature", "temperature")
            if kinds[0] == kinds[1] and kinds[0] in SOURCES and repeats(u, y):
                return unrelated + 2 * _COPY
            if thermometers or repeats(u, y) or self.facts.are_sides(reading.input, reading.output):
                return unrelated + _COPY
            line = _COPY if kinds[0] == kinds[1] else _STRAIGHT if PAIRS.get(kinds, 0.0) < _TOGETHER else 0.0
            return unrelated + (line * proportional(u, y) if line else 0.0)

        points = [
            reading.points + (lost(reading) if reading.points - held(reading) >= reach else _UNRELATED)
            for reading in found
        ]
        return self._looped([dataclasses.replace(one, points=p) for one, p in zip(found, points, strict=True)])

    def _looped(self, found: Sequence[Reading]) -> list[Reading]:
        """The readings; where the best one has no loop, those of its input that have one and are as good but for their place come first."""
        best, columns = max(found, key=lambda one: one.points), self.facts.table.columns
        looped = lambda one: has_loop(columns[one.input], columns[one.output], self._parts(one))
        kinds = self.facts.kinds[best.input], self.facts.kinds[best.output]
        # Where names do not tell what drives, the user is asked; the induction of a magnet may follow a straight line.
        if not kinds[0] or PAIRS.get(kinds, 0.0) >= _TOGETHER or looped(best):
            return [*found]
        rival = lambda one: one.input == best.input and one.points > best.points - _LOOP and looped(one)
        return [dataclasses.replace(one, points=one.points + _LOOP * rival(one)) for one in found]

    def _heats(self, reading: Reading, part: np.ndarray) -> bool:
        """Whether the input is the voltage or current of a heater: what it heats moves while it rests, and follows the temperature."""
        kinds, columns = self.facts.kinds, self.facts.table.columns
        warm = [k for k in self.facts.ranks if kinds[k] == "temperature" and extent(columns[k]) >= HEATED]
        if not warm or kinds[reading.input] not in _ELECTRIC:
            return False
        alone = [reading.output] if kinds[reading.output] not in _ELECTRIC else self.facts.ranks
        moved = [k for k in alone if kinds[k] in _MOVES and moves_at_rest(columns[reading.input], columns[k])]
        return any(explained(columns[one], columns[k], part) > _WELL for one in warm for k in moved)

    def _is_thermostat(self, reading: Reading, part: np.ndarray) -> bool:
        """Whether the pair is a heater and the temperature that it controls, which explains another column better than the heater does."""
        kinds, columns = self.facts.kinds, self.facts.table.columns
        if kinds[reading.output] != "temperature" or not self.facts.heats(reading.input):
            return False
        measured = [k for k in self.facts.ranks if PAIRS.get(("temperature", kinds[k]), 0.0) > 0 and kinds[k] != ""]
        shares = (
            [explained(columns[u], columns[k], part) for u in (reading.output, reading.input)]
            for k in measured
            if k != reading.input
        )
        return any(warm >= max(heater, _RELATED) for warm, heater in shares)

    def of_clock(self, reading: Reading) -> float:
        """Points of an output that rises as a clock does, such as the angle of a crank, while its input does not."""
        u, y = (self.facts.table.columns[k] for k in (reading.input, reading.output))
        return _UNRELATED * (rises_evenly(y) and not rises_evenly(u) and bool((np.diff(u) < 0).any()))

    def _parts(self, reading: Reading) -> np.ndarray:
        """Number of the record of each row, and of the level to which another column is set there, such as the voltage of a gate."""
        table = self.facts.table
        part = table.curve if table.part is None else table.part
        for k, values in enumerate(table.columns):
            if k in self.facts.kinds and k not in (reading.input, reading.output) and self._in_turn[k]:
                part = np.unique(np.column_stack([part, values]), axis=0, return_inverse=True)[1].ravel()
        return part

    @functools.cached_property
    def _in_turn(self) -> ByColumn:
        """Whether a column is set to levels in turn while others are measured."""
        return ByColumn(lambda k: bool(levels_in_turn(self.facts.table.columns[k])))

    @functools.cached_property
    def _again(self) -> ByColumn:
        """See `signal_evidence.set_again`."""
        return ByColumn(lambda k: set_again(self.facts.table.columns[k]))

    def _is_induced(self, i: int, o: int) -> bool:
        """Whether an output is the rate of its input, as the current of a capacitor and the voltage of a coil are."""
        u, y = self.facts.table.columns[i], self.facts.table.columns[o]
        ways = of_rate(u, y), of_rate(y, u)
        sizes = [abs(way) + _OF_ITS_SIGN * (way > 0) for way in ways]
        return abs(ways[0]) > OF_RATE and sizes[0] > sizes[1]

    def _of_quantity(self, position: int, usual: Mapping[str, float], *, told: bool) -> float:
        """Points of the quantity of a column in a role; one that the names tell to have it is not unusual."""
        points = usual.get(self.facts.kinds[position], SELDOM)
        return max(points, usual[""]) if told and self.facts.kinds[position] not in ("index", "error") else points

    def _of_role(self, position: int, role: str) -> float:
        """Points of a column in a role, by the one that its name states."""
        stated = self.facts.roles[position]
        contrary = _CONTRARY + _BARE * (bool(stated) and is_bare_role(self.facts.table.names[position]))
        return 0.0 if not stated else _STATED if stated == role else contrary

    @functools.cached_property
    def _of_signal(self) -> ByColumn:
        """Points of each column in either role."""
        table = self.facts.table

        def points(k: int) -> float:
            values = table.columns[k]
            few = table.rows >= _MANY_ROWS and all(np.unique(some).size <= _FEW for some in (sample(values), values))
            few &= not self.facts.by_steps[k] and self.facts.kinds[k] != "state"
            return (
                _SECONDARY * (self.facts.is_secondary(k) + self.facts.is_relative(k))
                + _RAW_VOLTS * is_raw_signal(table, k)
                + _IS_SET * few
                + _HELD * self.facts.is_held[k]
                + _PARTIAL * self.facts.is_out_of_phase(k)
            )

        return ByColumn(points)

    def _of_pair(self, i: int, o: int) -> float:
        """Points of quantities that belong together: the position of a motor, of which a controller follows it, drives its current."""
        kinds = self.facts.kinds[i], self.facts.kinds[o]
        measured = self.facts.measured.values()
        # A load that is controlled, and nothing else, drives.
        loads = [k for k, kind in zip((i, o), kinds, strict=True) if kind in LOADS and k in measured]
        if loads and {self.facts.kinds[k] for k in self.facts.measured} <= {*LOADS}:
            return _FOLLOWED if self.facts.measured.get(i) == o else PAIRS.get(kinds[::-1], 0.0) * (kinds[0] in LOADS)
        if set(kinds) == {"voltage", "displacement"} and self.facts.is_sensed(i if kinds[0] == "voltage" else o):
            kinds = kinds[::-1]
        beside = o if kinds[0] == "current" else i
        moved = beside in measured or "velocity" in self.facts.kinds.values()  # that of a motor, beside its speed
        if "current" in kinds and self.facts.kinds[beside] in ("displacement", "") and moved:
            return PAIRS["current", "displacement"] * (beside == i)
        return PAIRS.get(kinds, 0.0)


def _either_drives(one: str, other: str) -> bool:
    """Whether quantities do not tell which of two columns drives the other."""
    return {one, other} in ({""}, {"voltage", "current"}, {"voltage"}, {"current"})
