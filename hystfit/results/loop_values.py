"""Quantities read off a measured loop, with standard errors and without a model: coercivity, remanence, loss, (BH)max, stiffness."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.data.stated import OFFSET, SLOPE, Stated
from hystfit.errors import DataError
from hystfit.outcome import Column, Table
from hystfit.outcome.notebook import fragment
from hystfit.outcome.table import rounded
from hystfit.params.units import conversion, parse_unit, quantity
from hystfit.quality.faults import noise_rms
from hystfit.quality.loops import reversals
from hystfit.results.loop_kinds import REMANENT, STRUCTURAL, LoopKind

_TURN = 0.05  # of the input's range: smallest reversal that ends a branch
_LARGE = 0.9  # of the input's range that a branch of the largest loops covers
_GAP = 0.1  # of the output's range: between the two ends of a loop that counts as closed
_OPEN = 4.0  # standard errors by which an area differs from zero where there is a loop
_FEWEST = 8  # samples of a loop
_ABOUT = 4.0  # standard deviations of the noise, within which samples are averaged about a crossing
_SIDE = 0.02  # of the range that a demagnetization curve may pass beyond its quadrant


@dataclasses.dataclass(frozen=True)
class LoopValue:
    """One quantity of a measured loop.

    Attributes:
        name, label: what it is; `name` is that of `hystfit.results.quantities` where it is one of them.
        value: median over the loops of the record.
        stderr: standard error, from the noise about the place where it is read, or from the repeats of the loop where these
            scatter more; None where the noise is unknown.
        unit: "" where unknown.
        count: number of branches or loops from which it was read.
        stated: what the instrument wrote into the file; None where it states nothing.
    """

    name: str
    label: str
    value: float
    stderr: float | None
    unit: str
    count: int = 1
    stated: float | None = None


@dataclasses.dataclass(frozen=True)
class LoopValues:
    """The quantities of measured loops, record by record.

    Attributes:
        rows: for the name of each record its quantities; empty for records without a loop.
    """

    rows: dict[str, tuple[LoopValue, ...]]

    def table(self) -> Table:
        """All quantities."""
        left = lambda head: Column(head, left=True)
        columns = [
            left("quantity"),
            Column("value"),
            Column("+- stderr"),
            left("unit"),
            Column("instrument"),
            Column("read from"),
        ]
        rows = []
        for name, values in self.rows.items():
            for one in values:
                label = one.label if len(self.rows) == 1 else f"{name}: {one.label}"
                stated = "" if one.stated is None else f"{one.stated:.5g}"
                rows.append([label, *rounded(one.value, one.stderr), one.unit, stated, str(one.count)])
        return Table(columns, rows)

    def __repr__(self) -> str:
        return "\n".join(self.table().lines()) if any(self.rows.values()) else "no loop to read quantities from"

    def _repr_html_(self) -> str:
        return fragment("Quantities of the measured loops", (self.table(),))

    def to_dict(self) -> dict[str, Any]:
        """For `result.json`: by record and name."""
        plain = lambda one: {k: v for k, v in dataclasses.asdict(one).items() if k != "name"}
        return {record: {one.name: plain(one) for one in values} for record, values in self.rows.items()}


def quantities(data: Record | Dataset) -> LoopValues:
    """Quantities of the measured loops of every record, without a model.

    Args:
        data: records.
    """
    return LoopValues({record.name: _of_record(record) for record in Dataset.of(data)})


@dataclasses.dataclass(frozen=True, eq=False)
class _Branch:
    """Samples between two turning points of the input, in the order of time."""

    u: np.ndarray
    y: np.ndarray

    @property
    def rises(self) -> bool:
        return bool(self.u[-1] > self.u[0])


def _of_record(record: Record) -> tuple[LoopValue, ...]:
    kept = record.used
    u, y = record.u[kept], record.y[kept]
    if u.size < _FEWEST or not (np.ptp(u) > 0 and np.ptp(y) > 0):
        return ()
    kind, (noise, is_bound) = LoopKind.of(Dataset((record,))), noise_rms(y)
    sigma = None if is_bound or noise is None else noise
    turns = reversals(u, _TURN * float(np.ptp(u)))
    if not turns.size:
        return _of_quadrant(record, u, y, sigma)
    branches = _large_branches(u, y, turns)
    pairs = [pair for pair in itertools.pairwise(branches) if pair[0].rises != pair[1].rises]
    if not pairs or not _is_open(np.array([_area(*pair) for pair in pairs]), sigma, u):
        return ()
    closed = np.array([_area(*pair) for pair in pairs if _closes(*pair, y)])
    found = [*_levels(branches, sigma, kind, record), *(_loss(closed, sigma, u, record) if closed.size else ())]
    return tuple(_with_stated(record, found, branches, sigma, kind))


def _large_branches(u: np.ndarray, y: np.ndarray, turns: np.ndarray) -> list[_Branch]:
    """Branches over nearly the whole range; the last and the first piece of a loop that ends where it began are one branch."""
    edges = [0, *turns.tolist(), u.size - 1]
    parts = [_Branch(u[a : b + 1], y[a : b + 1]) for a, b in itertools.pairwise(edges)]
    span = float(np.ptp(u))
    large = [part for part in parts if np.ptp(part.u) >= _LARGE * span]
    first, last = parts[0], parts[-1]
    if (
        len(parts) > 2
        and first.rises == last.rises
        and abs(u[-1] - u[0]) <= _GAP * span
        and first not in large
        and last not in large
    ):
        joined = _Branch(np.append(last.u, first.u), np.append(last.y, first.y))
        if np.ptp(joined.u) >= _LARGE * span:
            large.append(joined)
    return large


def _closes(one: _Branch, other: _Branch, y: np.ndarray) -> bool:
    """Whether two branches end where they began."""
    return bool(abs(other.y[-1] - one.y[0]) <= _GAP * float(np.ptp(y)))


def _area(one: _Branch, other: _Branch) -> float:
    """Signed area between two branches, positive counter-clockwise."""
    u, y = np.append(one.u, other.u), np.append(one.y, other.y)
    u, y = u - u.mean(), y - y.mean()
    return 0.5 * float(np.sum(u * np.roll(y, -1) - np.roll(u, -1) * y))


def _area_error(sigma: float | None, u: np.ndarray) -> float | None:
    """Standard error of the area of a loop over inputs u by white noise."""
    return None if sigma is None else sigma * float(np.sqrt(np.sum(np.gradient(u) ** 2)))


def _is_open(areas: np.ndarray, sigma: float | None, u: np.ndarray) -> bool:
    error = _area_error(sigma, u) or 0.0
    return bool(abs(np.median(areas)) > _OPEN * error / np.sqrt(areas.size))


def _levels(branches: list[_Branch], sigma: float | None, kind: LoopKind, record: Record) -> Iterator[LoopValue]:
    """Where the branches cross zero (coercivity, remanence), of other loops the middle of their ranges; stiffness of those of forces."""
    named, units = kind in REMANENT, (record.u_unit, record.y_unit)
    top, bottom = max(b.y.max() for b in branches), min(b.y.min() for b in branches)
    if kind not in STRUCTURAL:
        ends = [(b.u.max(), b.u.min()) for b in branches]
        center = 0.0 if named else 0.5 * (max(high for high, _ in ends) + min(low for _, low in ends))
        middle = 0.0 if named else 0.5 * (top + bottom)
        of = lambda rises: [b for b in branches if b.rises == rises]
        width = {r: _combined([_crossing(b.y - middle, b.u, sigma) for b in of(r)]) for r in (True, False)}
        height = {r: _combined([_crossing(b.u - center, b.y, None, sigma) for b in of(r)]) for r in (True, False)}
        words = ("coercivity", "remanence") if named else ("half width", "half height")
        yield from _both(width, "coercive_input", words[0], units[0], sides=named)
        yield from _both(height, "remanence", words[1], units[1], sides=named)
    error = None if sigma is None else sigma * float(np.sqrt(2))
    yield LoopValue("stroke", "range of the output", float(top - bottom), error, units[1])
    if named:
        yield LoopValue("saturation", "largest output", float(0.5 * (top - bottom)), sigma, units[1])
    if kind is LoopKind.DISPLACEMENT_DRIVEN:
        yield from _stiffness(branches, sigma, units)


def _stiffness(branches: list[_Branch], sigma: float | None, units: tuple[str, str]) -> Iterator[LoopValue]:
    """Secant stiffness between the ends of the loop, and the equivalent viscous damping ratio."""
    width = max(b.u.max() for b in branches) - min(b.u.min() for b in branches)
    found = _combined([(abs(b.y[-1] - b.y[0]) / float(np.ptp(b.u)), None) for b in branches])
    if found is None:
        return
    error = None if sigma is None else sigma * float(np.sqrt(2)) / width
    yield LoopValue(
        "secant_stiffness",
        "secant stiffness",
        found[0],
        error or found[1],
        f"{units[1]}/{units[0]}".strip("/"),
        found[2],
    )
    losses = [abs(_area(*pair)) for pair in itertools.pairwise(branches) if pair[0].rises != pair[1].rises]
    if losses and found[0] > 0:
        ratio = 100 * 2 * float(np.median(losses)) / (np.pi * found[0] * width**2)
        yield LoopValue("equivalent_damping_percent", "equivalent damping", ratio, None, "%", len(losses))


def _both(
    found: dict[bool, tuple[float, float | None, int] | None], name: str, label: str, unit: str, *, sides: bool
) -> Iterator[LoopValue]:
    """Half the distance of what was read on the rising and the falling branch, and each of them where `sides`."""
    rising, falling = found[True], found[False]
    if rising is not None and falling is not None:
        known = rising[1] is not None and falling[1] is not None
        error = 0.5 * float(np.hypot(rising[1] or 0.0, falling[1] or 0.0)) if known else None
        text = f"{label} (half width)" if name == "coercive_input" and sides else label
        yield LoopValue(name, text, 0.5 * abs(rising[0] - falling[0]), error, unit, min(rising[2], falling[2]))
    for which, one in (("rising", rising), ("falling", falling)):
        if sides and one is not None:
            yield LoopValue(f"{name}_{which}", f"{label}, {which} branch", one[0], one[1], unit, one[2])


def _crossing(
    level: np.ndarray, values: np.ndarray, sigma: float | None, of_values: float | None = None
) -> tuple[float, float | None] | None:
    """Value where a level passes zero, and its standard error; None where it does not, or more than once beyond the noise.

    Args:
        level: along a branch, shape (n,).
        values: at the same samples, shape (n,).
        sigma: noise of the level; of_values: noise of the values; None where unknown.
    """
    passed = np.flatnonzero((level[:-1] < 0) != (level[1:] < 0))
    if not passed.size:
        return None
    k = int(passed[len(passed) // 2])
    step, run = level[k + 1] - level[k], values[k + 1] - values[k]
    near = np.flatnonzero(np.abs(level) <= _ABOUT * (sigma or 0.0))
    if near.size < 5 or abs(step) > _ABOUT * (sigma or 0.0):
        error = of_values if sigma is None else sigma * abs(run / step)
        return float(values[k] - level[k] * run / step), None if error is None else float(error)
    # Noise crosses zero several times: a straight line through the samples about it.
    slope, offset = np.polyfit(values[near], level[near], 1)
    at = -offset / slope
    spread = 1.0 / near.size + (at - values[near].mean()) ** 2 / max(
        float(np.sum((values[near] - values[near].mean()) ** 2)), 1e-300
    )
    return float(at), float((sigma or 0.0) / abs(slope) * np.sqrt(spread))


def _combined(found: list[tuple[float, float | None] | None]) -> tuple[float, float | None, int] | None:
    """Median over branches and its standard error: by the noise of each, or their scatter where that is larger."""
    known = [one for one in found if one is not None and np.isfinite(one[0])]
    if not known:
        return None
    values = np.array([value for value, _ in known])
    errors = [error for _, error in known if error is not None]
    stated = float(np.sqrt(np.mean(np.square(errors)) / values.size)) if len(errors) == values.size else None
    scatter = float(np.std(values, ddof=1) / np.sqrt(values.size)) if values.size > 2 else None
    both = [error for error in (stated, scatter) if error is not None]
    return float(np.median(values)), max(both, default=None), values.size


def _loss(areas: np.ndarray, sigma: float | None, u: np.ndarray, record: Record) -> Iterator[LoopValue]:
    """Loss per cycle, in energy where the units tell it."""
    size, each = np.abs(areas), _area_error(sigma, u)
    found = _combined([(float(value), each) for value in size])
    if found is None:
        return
    unit, factor = _energy(record)
    error = None if found[1] is None else factor * found[1]
    yield LoopValue("loop_area", "loss per cycle", factor * found[0], error, unit, found[2])


def _energy(record: Record) -> tuple[str, float]:
    """Unit of the loop's area as an energy (density), and the factor to it; the product of the units elsewhere."""
    one, other = parse_unit(record.u_unit), parse_unit(record.y_unit)
    plain = f"{record.y_unit} {record.u_unit}".strip()
    if one is None or other is None:
        return plain, 1.0
    kinds = quantity(record.u_unit), quantity(record.y_unit)
    named = {
        ("field", "induction"): "J/m3",
        ("voltage", "polarization"): "J/m2",
        ("electric field", "polarization"): "J/m3",
        ("displacement", "force"): "J",
        ("force", "displacement"): "J",
        ("strain", "stress"): "J/m3",
        ("stress", "strain"): "J/m3",
        ("voltage", "charge"): "J",
        ("induction", "moment"): "J",
    }
    return (named[kinds], one.factor * other.factor) if kinds in named else (plain, 1.0)


def _of_quadrant(record: Record, u: np.ndarray, y: np.ndarray, sigma: float | None) -> tuple[LoopValue, ...]:
    """HcB, Br and (BH)max of a demagnetization curve: one way, in the second or the fourth quadrant; nothing of other curves."""
    kinds = quantity(record.u_unit), quantity(record.y_unit)
    named = {record.u_name[:1].upper(), record.y_name[:1].upper()}
    magnetic = kinds in (
        ("field", "induction"),
        ("field", "magnetization"),
        ("induction", "magnetization"),
    ) or named in ({"H", "B"}, {"H", "J"}, {"H", "M"})
    slack = _SIDE * float(np.abs(u).max()), _SIDE * float(np.abs(y).max())
    sign = 1.0 if u.min() < -slack[0] else -1.0
    field, flux = -sign * u, sign * y  # the demagnetizing field counts positive
    if not magnetic or field.min() < -slack[0] or flux.min() < -slack[1]:
        return ()
    order = np.argsort(field, kind="stable")
    field, flux = field[order], flux[order]
    found = []
    if flux[-1] <= slack[1]:
        crossing = _crossing(flux, field, sigma) or (float(field[-1]), None)
        found.append(LoopValue("coercive_input", "coercivity", *crossing, record.u_unit))
    if field[0] <= slack[0]:
        found.append(LoopValue("remanence", "remanence", float(flux[0]), sigma, record.y_unit))
    return (*found, *_energy_product(record, field, flux, sigma))


def _energy_product(record: Record, field: np.ndarray, flux: np.ndarray, sigma: float | None) -> Iterator[LoopValue]:
    """(BH)max: the top of a parabola through the largest product and its neighbors."""
    product = field * flux
    k = int(np.clip(np.argmax(product), 1, product.size - 2))
    three = slice(k - 1, k + 2)
    best = float(product[k])
    if np.unique(field[three]).size == 3:
        a, b, c = np.polyfit(field[three] - field[k], product[three], 2)
        best = float(c - b**2 / (4 * a)) if a < 0 and abs(b / (2 * a)) <= np.ptp(field[three]) else best
    one, other = parse_unit(record.u_unit), parse_unit(record.y_unit)
    known = one is not None and other is not None and quantity(record.y_unit) == "induction"
    factor = 1e-3 * one.factor * other.factor if known and one and other else 1.0
    unit = "kJ/m3" if known else f"{record.u_unit} {record.y_unit}".strip()
    error = None if sigma is None else factor * sigma * float(field[k])
    yield LoopValue("energy_product", "(BH)max", factor * best, error, unit)


def _with_stated(
    record: Record, found: list[LoopValue], branches: list[_Branch], sigma: float | None, kind: LoopKind
) -> Iterator[LoopValue]:
    """The quantities with those that the instrument states; after its slope correction, where it made one, in rows of their own."""
    stated = {_name_of(one): one for one in record.stated if one.quantity}
    beside = lambda row: dataclasses.replace(row, stated=_in_unit(stated.get(row.name), row.unit))
    slope = next((one.value for one in record.stated if one.label == SLOPE), None)
    if slope is None or not stated or record.y_name.lower().startswith("adjusted"):
        yield from map(beside, found)
        return
    yield from found
    offset = next((one.value for one in record.stated if one.label == OFFSET), 0.0)
    corrected = [_Branch(b.u, b.y + slope * b.u + offset) for b in branches]
    for one in _levels(corrected, sigma, kind, record):
        if one.name in stated:
            label = f"{one.label}, after the slope correction of the file"
            yield dataclasses.replace(beside(one), name=f"{one.name}_corrected", label=label)


# The branch on which a result of that sign is read: the output crosses zero at a positive input as it rises, and is left positive at
# zero input by the branch that falls.
_SIGNED = {
    ("coercive_input", "+"): "rising",
    ("coercive_input", "-"): "falling",
    ("remanence", "+"): "falling",
    ("remanence", "-"): "rising",
}


def _name_of(stated: Stated) -> str:
    """The name under which a stated result stands here: "Vc+" is the coercivity of the rising branch."""
    side = _SIGNED.get((stated.quantity, stated.label[-1:]))
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
