"""The evidence for a pair of columns as input and output: quantities, units, names, signals and loops, added up in one score.

Points are like logarithms of odds: what is measured or written for certain outweighs what is only usual.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from hystfit.params.units import quantity
from hystfit.reading.column_names import is_channel, secondary
from hystfit.reading.header import split_unit
from hystfit.reading.raw_table import Table

# Points of a quantity as the input and as the output of a device.
_DRIVE = {
    "input": 4.0, "state of charge": 3.0, "voltage": 2.5, "field": 2.5, "electric field": 2.5, "current": 2.0, "pressure": 1.8,
    "strain": 1.6, "displacement": 1.4, "induction": 1.0, "": 0.8, "temperature": -1.0,
}  # fmt: skip
_RESPONSE = {
    "output": 4.0, "moment": 2.5, "magnetization": 2.5, "induction": 2.5, "polarization": 2.5, "charge": 2.3, "force": 2.0,
    "stress": 2.0, "displacement": 1.8, "strain": 1.6, "voltage": 0.8, "": 0.8, "current": 0.6, "temperature": -1.0,
}  # fmt: skip
_SELDOM = -4.0  # of a rate, a frequency, a flag: never the input or output where there is another column
_MAGNETIC, _ELECTRIC = ("moment", "magnetization", "induction"), ("polarization", "charge")
# Points of pairs that belong together, besides those of each column.
_PAIRS: Mapping[tuple[str, str], float] = (
    dict.fromkeys(itertools.product(["field"], _MAGNETIC), 4.0)
    | dict.fromkeys([("electric field", "polarization"), ("voltage", "polarization"), ("voltage", "charge")], 4.0)
    | {("state of charge", "voltage"): 4.0, ("displacement", "force"): 4.0, ("strain", "stress"): 4.0}
    | dict.fromkeys(
        [
            ("voltage", "displacement"), ("electric field", "strain"), ("voltage", "strain"),
            ("current", "displacement"), ("current", "induction"), ("induction", "moment"),
            ("induction", "magnetization"), ("pressure", "displacement"), ("voltage", "force"), ("current", "force"),
            ("displacement", "moment"),
        ],
        3.0,
    )
    | dict.fromkeys(itertools.product(["temperature"], ["displacement", "strain", "force", "stress", "current", "", "output"]), 3.0)
)  # fmt: skip
_SECONDARY = -1.5  # for each word such as "raw" or "min" in a name
_RAW_VOLTS = -3.0  # of a sensor's signal in volts beside the same quantity in its own unit
_HEATED, _COLD = (
    10.0,
    -5.0,
)  # degrees over which a temperature must vary to be an input, and its points where it does not
# Distinct values up to which a column of many rows is one that is set, and its points.
_FEW, _MANY_ROWS, _IS_SET = 12, 50, -2.0
# Points of a clean wave (harmonics up to that part of its power; a triangle has 0.014) beside one with that many times more harmonics.
# Fewer samples show no harmonics.
_CLEAN, _PURE, _PLAINER, _WAVE = 1.0, 0.02, 2.0, 64
_LATER = -0.25  # of each further column of the same quantity, and of an input after its output
# Points of a commanded column beside a measured one, whose noise is that many times larger: a D/A converter beside a sensor.
_COMMANDED, _NOISIER = 1.0, 10.0
# Difference of points below which neither of two readings is better: that of one place among columns of the same quantity (0.25)
# decides, as people write the main channel first; nothing smaller is evidence.
TIE = 0.2


@dataclasses.dataclass(frozen=True)
class Reading:
    """A pair of columns, its points, and what carried them, in words."""

    input: int
    output: int
    points: float
    reasons: tuple[str, ...]


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
    ranks = dict.fromkeys(equal, 0) | _ranks(table, [k for k in free if k not in equal], kinds)
    found = [
        _scored(table, i, o, kinds, ranks, ordered=not {i, o} <= set(equal), alone=alone)
        for i, o in itertools.product(inputs, outputs)
        if i != o
    ]
    return sorted(found, key=lambda reading: (-reading.points, reading.input, reading.output))


def _ranks(table: Table, free: Sequence[int], kinds: Mapping[int, str]) -> dict[int, int]:
    """Place of each column among those of its quantity."""
    count: dict[str, int] = {}
    ranks = {}
    for k in sorted(free, key=lambda k: (secondary(table.names[k]), k)):
        ranks[k] = count.get(kinds[k], 0)
        count[kinds[k]] = ranks[k] + 1
    return ranks


def _scored(
    table: Table, i: int, o: int, kinds: Mapping[int, str], ranks: Mapping[int, int], *, ordered: bool, alone: bool
) -> Reading:
    """The points of column i as the input and column o as the output."""
    terms = [
        (_DRIVE.get(kinds[i], _SELDOM), kinds[i] or ""),
        (_RESPONSE.get(kinds[o], _SELDOM), kinds[o] or ""),
        (_PAIRS.get((kinds[i], kinds[o]), 0.0), f"{kinds[o]} over {kinds[i]}"),
        (_LATER * (ranks.get(i, 0) + ranks.get(o, 0) + (ordered and i > o)), "its place"),
    ]
    for k in (i, o):
        terms.append((_SECONDARY * secondary(table.names[k]), ""))
        if _is_raw_signal(table, k):
            terms.append((_RAW_VOLTS, ""))
        if table.rows >= _MANY_ROWS and np.unique(table.columns[k]).size <= _FEW:
            terms.append((_IS_SET, ""))
    if not alone and kinds[i] == "temperature" and _extent(table.columns[i]) < _HEATED:
        terms.append((_COLD, ""))
    if table.rows >= _WAVE and _either_drives(kinds[i], kinds[o]):
        plain, bent = _overtones(table.columns[i]), _overtones(table.columns[o])
        terms.append((_CLEAN * (plain <= _PURE and bent > _PLAINER * plain), "its clean wave"))
        noisier = _roughness(table.columns[o]) > _NOISIER * _roughness(table.columns[i])
        terms.append((_COMMANDED * noisier, "its small noise"))
    reasons = tuple(text for points, text in terms if points > 0 and text)
    return Reading(i, o, float(sum(points for points, _ in terms)), reasons)


def _either_drives(one: str, other: str) -> bool:
    """Whether quantities do not tell which of two columns drives the other."""
    return {one, other} in ({""}, {"voltage", "current"}, {"voltage"}, {"current"})


def _is_raw_signal(table: Table, position: int) -> bool:
    """Whether a column in volts has the name of another one in a unit of its own: Force (V) beside Force (N)."""
    name = split_unit(table.names[position])[0].strip().lower()
    if not name or quantity(table.units[position]) != "voltage":
        return False
    same = [k for k, other in enumerate(table.names) if split_unit(other)[0].strip().lower() == name and k != position]
    return any(quantity(table.units[k]) not in ("", "voltage") for k in same)


def _extent(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.ptp(finite)) if finite.size else 0.0


def _roughness(values: np.ndarray) -> float:
    """Median third difference over the range: the noise of a column that is sampled often."""
    values = values[np.isfinite(values)]
    return (
        float(np.median(np.abs(np.diff(values, 3))) / np.ptp(values)) if values.size > 3 and np.ptp(values) > 0 else 0.0
    )


def _overtones(values: np.ndarray) -> float:
    """Power of a column apart from its strongest frequency, as a part of the whole: small for a sine, 0.014 for a triangle."""
    values = values[np.isfinite(values)]
    power = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(values.size))[1:]) ** 2
    peak, total = int(np.argmax(power)), float(power.sum())
    return 1.0 - float(power[max(peak - 3, 0) : peak + 4].sum()) / total if total > 0 else 1.0
