"""Quantities read off a measured loop, with standard errors and without a model: coercivity, remanence, loss, (BH)max, stiffness."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from hystfit.data.circulation import FEWEST
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.outcome import Code, Column, Note, Table
from hystfit.outcome.merged_notes import merged
from hystfit.outcome.note import warn
from hystfit.outcome.notebook import fragment
from hystfit.outcome.table import rounded
from hystfit.params.units import loop_energy, quantity
from hystfit.quality.coverage import is_switched
from hystfit.quality.faults import noise_rms, printed_step, saturated_samples
from hystfit.quality.loops import LARGEST, SAME_LEVEL
from hystfit.quality.other_curves import is_remanence, is_remanence_curve
from hystfit.quality.reversal_curves import recognize_family
from hystfit.quality.summary import without_outliers
from hystfit.reading.names.column_names import column_quantity
from hystfit.results.measured.butterfly_values import butterfly_values
from hystfit.results.measured.instrument_values import convention_notes, with_stated, with_stated_sheet
from hystfit.results.measured.loop_branches import (
    Branch,
    Pair,
    closes,
    combined,
    crosses,
    crossing,
    from_ends,
    is_open,
    large_branches,
    large_cycles,
    loss,
    mean_ends,
    range_error,
    turns_of,
)
from hystfit.results.measured.loop_kinds import REMANENT, STRUCTURAL, LoopKind, turns_light
from hystfit.results.measured.loop_origin import Origin, centered, is_unipolar
from hystfit.results.measured.magnetic_loop import Correction, MagneticLoop
from hystfit.results.measured.magnetic_sample import Sample
from hystfit.results.measured.magnetic_values import REMANENT_PART, magnetic_values
from hystfit.results.measured.measured_value import LoopValue
from hystfit.results.measured.polarization_values import offset_of, polarization_values
from hystfit.results.measured.quantities import area_label
from hystfit.results.measured.saturation_law import saturation
from hystfit.results.measured.steady_branches import at_one_pace, labeled, without_first_loading
from hystfit.results.measured.stiffness_values import stiffness_values

MEASURED = "Quantities read off the measured loops, without the model"


@dataclasses.dataclass(frozen=True)
class LoopValues:
    """The quantities of measured loops, record by record."""

    # for the name of each record its quantities; empty for records without a loop
    rows: dict[str, tuple[LoopValue, ...]]
    # of magnetic loops, in their order
    corrections: dict[str, tuple[Correction, ...]] = dataclasses.field(default_factory=dict)
    # why a quantity is not given, and where the instrument's definition is another one
    notes: dict[str, tuple[Note, ...]] = dataclasses.field(default_factory=dict)

    def table(self) -> Table:
        """All quantities; standard errors by the size of the sample, half differences and results of the instrument where there are any."""
        every = [one for values in self.rows.values() for one in values]
        beside = {
            "+- size": (lambda one: one.scale),
            "+- branches, laws": (lambda one: one.spread),
            "instrument": (lambda one: one.stated),
        }
        shown = {head: of for head, of in beside.items() if any(of(one) is not None for one in every)}
        left = lambda head: Column(head, left=True)
        columns = [left("quantity"), Column("value"), Column("+- stderr"), left("unit"), *map(Column, shown)]
        rows = []
        for name, values in self.rows.items():
            for one in values:
                label = one.label if len(self.rows) == 1 else f"{name}: {one.label}"
                extra = [
                    "" if of(one) is None else f"{of(one):.{5 if head == 'instrument' else 2}g}"
                    for head, of in shown.items()
                ]
                rows.append([label, *rounded(one.value, one.stderr), one.unit, *extra, str(one.count)])
        return Table([*columns, Column("read from")], rows)

    def lines(self) -> list[str]:
        """Corrections in their order, the table, and notes."""
        one = len(self.rows) == 1
        named = lambda record, text: str(text) if one else f"{record}: {text}"
        corrected = [named(record, c) for record, all_of in self.corrections.items() for c in all_of]
        lines = ["corrections, in this order", *(f"  {text}" for text in corrected), ""] if corrected else []
        lines += self.table().lines() if any(self.rows.values()) else ["no loop to read quantities from"]
        noted = merged(self.notes, len(self.rows))
        return [*lines, *(["", *(f"note: {note}" for note in noted)] if noted else [])]

    def __repr__(self) -> str:
        return "\n".join(self.lines())

    def _repr_html_(self) -> str:
        return fragment("Quantities of the measured loops", (self.table(),))

    def to_dict(self) -> dict[str, Any]:
        """For `result.json`: by record and name."""
        plain = lambda one: {k: v for k, v in dataclasses.asdict(one).items() if k != "name"}
        return {record: {one.name: plain(one) for one in values} for record, values in self.rows.items()}

    def remarks(self) -> dict[str, Any]:
        """Corrections and notes for `result.json`, by record."""
        return {
            record: {
                "corrections": [dataclasses.asdict(one) for one in self.corrections.get(record, ())],
                "notes": [note.to_dict() for note in self.notes.get(record, ())],
            }
            for record in self.rows
            if self.corrections.get(record) or self.notes.get(record)
        }


def quantities(data: Record | Dataset, sample: Sample | None = None, correct: Collection[str] = ()) -> LoopValues:
    """Quantities of the measured loops of every record, without a model.

    Args:
        data: records.
        sample: of magnetic loops: size, volume or mass and demagnetizing factor, beside what the header of the file states.
        correct: corrections of magnetic loops to apply besides volume, image and demagnetization: "drift", "offset", "slope". The
            others are estimated and listed.

    Raises:
        DataError: a correction of another name.
    """
    records = Dataset.of(data)
    family = recognize_family(records)
    # Their reversals lie inside the loop.
    inner = {record.name for record in family.curves[:-1]} if family else set[str]()
    read = {
        record.name: ((), (), ()) if record.name in inner else _of_record(record, sample or Sample(), correct)
        for record in records
    }
    rows, corrections, own = ({name: one[k] for name, one in read.items()} for k in range(3))
    # Several measurements in one record: its values are of none of them.
    notes = {
        record.name: (*(n for n in record.notes if n.code is Code.CONDITIONS), *own[record.name]) for record in records
    }
    some = lambda by_record: {name: value for name, value in by_record.items() if value}
    return LoopValues(rows, some(corrections), some(notes))


_NO_CYCLE = warn(
    Code.NOT_CLOSED, "no closed loop: the input does not cover the same range in both directions; measure a whole cycle"
)
_NO_AREA = warn(Code.NOT_CLOSED, "no loop: the branches of the largest cycles differ by no more than the noise")
_LOBED = Note(
    Code.CROSSING,
    "the branches cross, and the lobes run in opposite directions (a butterfly): the loop has no loss, width or height",
)
_LIMITED = warn(
    Code.CLIPPED, "the sensor is saturated at the ends of the loop: its ranges, stiffness and areas are lower bounds"
)
_CUT_OFF = ("stroke", "saturation", "Js", "secant_stiffness", "loop_area", "W")
_Read = tuple[tuple[LoopValue, ...], tuple[Correction, ...], tuple[Note, ...]]


def _of_record(record: Record, sample: Sample, correct: Collection[str]) -> _Read:
    """Quantities, corrections and notes of a record."""
    record, limited = _with_limited(without_outliers(record))
    kept = record.used
    u, y = record.u[kept], record.y[kept]
    if u.size < FEWEST or not (np.ptp(u) > 0 and np.ptp(y) > 0) or is_switched([u]):
        return (), (), ()
    kind, (noise, is_bound), of_zero = LoopKind.of(Dataset((record,))), noise_rms(y), tuple[Note, ...]()
    # Of sparse samples the most that it can be: errors without it would be those of the straight lines alone.
    sigma = np.nan if noise is None else max(noise, printed_step(y) / np.sqrt(12))
    if kind in REMANENT:
        record, of_zero = centered(record, kind)
        y = record.y[kept]
    has_sheet = kind is LoopKind.MAGNETIC and not turns_light(record)
    magnetic = MagneticLoop.of(record, sample, sigma, correct) if has_sheet else None
    turns = turns_of(u)
    if not turns.size or is_remanence_curve(record):
        last = slice(
            turns[-1] + 1 if turns.size else 0, None
        )  # remanences after back fields, behind those of the acquisition
        rows = _of_quadrant(record, u[last], y[last], sigma)
        return _with_data_sheet(rows, record, sample, correct, sigma, magnetic, closed=False)
    branches, pairs, cycles, duration = _loops_of(record, turns, kind, sigma)
    if not (pairs or cycles):
        rows, corrections, notes = _with_data_sheet((), record, sample, correct, sigma, magnetic, closed=False)
        return rows, corrections, (_NO_CYCLE, *notes)
    known = np.nan if is_bound else sigma
    if pairs and kind not in REMANENT and crosses(pairs, known):
        return tuple(butterfly_values(branches, sigma, record)), (), (_LOBED,)
    if not is_open(pairs or cycles, known):
        return (), (), (_NO_AREA,)
    levels = [*_levels(branches, cycles, sigma, kind, record)]
    if magnetic is not None and (law := saturation(branches)) is not None and law.on_substrate:
        film = [Branch(b.u, b.y - law.slope * b.u) for b in branches]
        levels = _of_film(levels, _levels(film, cycles, sigma, kind, record))
    found = [*levels, *(_loss(cycles, sigma, kind, record) if cycles else ())]
    found = [*labeled(found, record, pairs, duration, sigma)]
    if kind is LoopKind.FERROELECTRIC:
        found.extend(polarization_values(record, found, sigma, branches))
    if kind is LoopKind.MAGNETIC:
        found.extend(offset_of(found, "offset (half sum of both coercivities)"))
    rows = tuple(with_stated(record, found, lambda added: _levels(added, cycles, sigma, kind, record), branches))
    closed = any(closes(*pair, y) for pair in pairs or cycles)
    rows, corrections, notes = _with_data_sheet(rows, record, sample, correct, sigma, magnetic, closed=closed)
    if limited:
        rows, notes = tuple(_at_least(rows)), (*notes, _LIMITED)
    return rows, corrections, (*of_zero, *notes)


def _loops_of(
    record: Record, turns: np.ndarray, kind: LoopKind, sigma: float
) -> tuple[list[Branch], list[Pair], list[Pair], float | None]:
    """The branches of the largest amplitude at one pace, the pairs of them that follow each other, and the cycles whose areas are losses.

    And the duration of these cycles, where others are left out.
    """
    kept = record.used
    u, y, t = record.u[kept], record.y[kept], None if record.t is None else record.t[kept]
    branches, duration = at_one_pace(_largest(large_branches(u, y, turns, t)))
    branches = without_first_loading(branches, int(turns[0]) + 1, sigma)
    pairs = [pair for pair in itertools.pairwise(branches) if pair[0].rises != pair[1].rises]
    cycles = [c for c in large_cycles(u, y, pairs, t) if pairs or kind in STRUCTURAL or closes(*c, y)]
    if not pairs and kind not in STRUCTURAL:  # loops that grow from the middle, each of which begins and ends there
        branches = [*itertools.chain(*(from_ends(*cycle) for cycle in cycles))]
    return branches, pairs, cycles, duration


def _largest(branches: list[Branch]) -> list[Branch]:
    """The branches of the largest amplitude, where there are some in both directions; smaller loops are narrower."""
    longest = max((float(np.ptp(b.u)) for b in branches), default=0.0)
    largest = [b for b in branches if np.ptp(b.u) >= (1 - SAME_LEVEL) * longest]
    return largest if len({b.rises for b in largest}) == 2 else branches


def _with_limited(record: Record) -> tuple[Record, bool]:
    """The record with the samples of a saturated sensor, which a fit leaves out, and whether it has any."""
    limited = (
        saturated_samples(record.u, record.y) & (np.cumsum(record.used) > 0) & (np.cumsum(record.used[::-1])[::-1] > 0)
    )
    return record.replace(weight=np.where(limited, 1.0, record.weight)), bool(limited.any())


def _at_least(rows: Sequence[LoopValue]) -> Iterator[LoopValue]:
    """The values of a loop whose ends are cut off: ranges and areas are the least that they can be, a ratio of both is left out."""
    for row in rows:
        if row.name in _CUT_OFF:
            yield dataclasses.replace(row, label=f"{row.label}, at least", stderr=None)
        elif row.name != "equivalent_damping_percent":
            yield row


def _with_data_sheet(
    rows: tuple[LoopValue, ...],
    record: Record,
    sample: Sample,
    correct: Collection[str],
    sigma: float,
    magnetic: MagneticLoop | None,
    *,
    closed: bool,
) -> _Read:
    """The rows with those of magnetic data sheets, their errors by the size of the sample, and what is not given and why."""
    notes = list(convention_notes(record, rows))
    if rows and not closed and any(row.name.startswith("coercive_input_") for row in rows):
        text = "no loss per cycle: the loop does not end where it began"
        notes.append(warn(Code.NOT_CLOSED, text))
    if magnetic is None:
        return rows, (), tuple(notes)
    sheet = magnetic_values(magnetic)
    full = sample.with_header(record.metadata)
    longer = [one for axis in range(3) if (one := full.longer(axis)) is not None]
    moved = [{r.name: r.value for r in magnetic_values(MagneticLoop.of(record, one, sigma, correct))} for one in longer]
    error = lambda row: (
        float(np.sqrt(sum((m.get(row.name, np.nan) - row.value) ** 2 for m in moved))) if moved else None
    )
    sheet = tuple(with_stated_sheet(record, (dataclasses.replace(row, scale=error(row)) for row in sheet)))
    if sheet and not magnetic.absolute:
        text = (
            "Br, HcB and (BH)max need the volume of the sample, or its mass and density, and units of field and output"
        )
        notes.append(Note(Code.UNITS, text))
    if magnetic.branches and not any(row.name == "Js" for row in sheet):
        text = "no saturation Js: the field does not reach the approach to saturation, or has too few samples there"
        notes.append(warn(Code.EXTRAPOLATION, text))
    if (law := magnetic.saturation) is not None and law.on_substrate and "slope" not in correct:
        text = "the output falls at large fields, as on a diamagnetic substrate: hystfit quantities --correct slope removes this slope"
        notes.append(warn(Code.MODEL_ADVICE, text))
    return (*rows, *sheet), magnetic.corrections if rows or sheet else (), tuple(notes)


def _levels(
    branches: list[Branch], cycles: Sequence[Pair], sigma: float, kind: LoopKind, record: Record
) -> Iterator[LoopValue]:
    """Where the branches cross zero (coercivity, remanence), of other loops the middle of their ranges; stiffness of those of forces."""
    named, units = kind in REMANENT, (record.u_unit, record.y_unit)
    top, bottom = max(b.y.max() for b in branches), min(b.y.min() for b in branches)
    if kind not in STRUCTURAL:
        ends = [(b.u.max(), b.u.min()) for b in branches]
        center = 0.0 if named else 0.5 * (max(high for high, _ in ends) + min(low for _, low in ends))
        level = Origin.of(Dataset((record,))).y
        middle = 0.0 if named else 0.5 * (top + bottom) if level is None else level
        # A branch that begins inside the loop crosses the middle elsewhere; one that ends inside it does not, nor do those that begin there
        # in every cycle, of an output that lags.
        least = (1 - LARGEST) * (top - bottom)
        repeats = lambda b: sum(b.rises == other.rises and abs(b.y[0] - other.y[0]) <= least for other in branches) > 1
        from_end = lambda b: np.ptp(b.y) >= top - bottom - least or min(top - b.y[0], b.y[0] - bottom) <= least
        whole = lambda b: named or from_end(b) or repeats(b)
        of = lambda rises: [b for b in branches if b.rises == rises and whole(b)]
        width = {r: combined([crossing(b.y - middle, b.u, sigma) for b in of(r)]) for r in (True, False)}
        height = {r: combined([crossing(b.u - center, b.y, of_values=sigma) for b in of(r)]) for r in (True, False)}
        words = ("coercivity (half width)", "remanence") if named else ("half width", "half height")
        # Thresholds and temperatures of a transition have no name that all loops share.
        switches = kind is LoopKind.OTHER or column_quantity(record.u_name, record.u_unit) == "temperature"
        at_middle = "input at the middle of the output" if switches else ""
        yield from _both(width, "coercive_input", words[0], units[0], "coercivity" if named else at_middle)
        yield from _both(height, "remanence", words[1], units[1], "remanence" if named else "")
    # A structure has its largest force before its largest displacement, and an actuator its largest output where it creeps.
    y = record.y[record.used] if kind in STRUCTURAL else np.concatenate([b.y for b in branches])
    yield LoopValue("stroke", "range of the output", float(np.ptp(y)), range_error(y, sigma), units[1])
    if named and not is_unipolar(record.u):
        (high, low), error = mean_ends(
            branches, min(b.u.min() for b in branches), max(b.u.max() for b in branches), sigma
        )
        label = "output near the ends (outer 5 % of the input)"  # as instruments read the saturation
        yield LoopValue("saturation", label, 0.5 * (high - low), error, units[1])
    if kind is LoopKind.DISPLACEMENT_DRIVEN:
        yield from stiffness_values(branches, cycles, sigma, record)


def _of_film(levels: Sequence[LoopValue], film: Iterable[LoopValue]) -> list[LoopValue]:
    """The values with the coercivity of the film alone: with its substrate, the output passes zero at other fields."""
    alone = {one.name: dataclasses.replace(one, label=f"{one.label}, without the slope") for one in film}
    return [alone.get(one.name, one) if one.name.startswith("coercive_input") else one for one in levels]


def _both(
    found: dict[bool, tuple[float, float, int]], name: str, label: str, unit: str, of_side: str
) -> Iterator[LoopValue]:
    """Half the distance of what was read on the rising and the falling branch, and each of them where it has a label, `of_side`."""
    (rising, *_), (falling, *_) = both = found[True], found[False]
    if np.isfinite(rising - falling):
        error = 0.5 * float(np.hypot(*(one[1] for one in both)))
        yield LoopValue(name, label, 0.5 * abs(rising - falling), error, unit, min(one[2] for one in both))
    for which, one in zip(("rising", "falling"), both, strict=True):
        if of_side and np.isfinite(one[0]):
            yield LoopValue(f"{name}_{which}", f"{of_side}, {which} branch", one[0], one[1], unit, one[2])


def _loss(closed: Sequence[Pair], sigma: float, kind: LoopKind, record: Record) -> Iterator[LoopValue]:
    """Loss per cycle, in energy where the units tell it."""
    value, error, count = loss(closed, sigma)
    unit, factor = loop_energy(record.u_unit, record.y_unit)
    yield LoopValue("loop_area", area_label(kind, unit), factor * value, factor * error, unit, count)


def _of_quadrant(record: Record, u: np.ndarray, y: np.ndarray, sigma: float) -> tuple[LoopValue, ...]:
    """Coercivity and remanence of a magnetic curve in one direction that is remanent at zero field; nothing of other curves.

    It is a demagnetization curve, half a loop, or a curve of remanences after back fields, whose zero is the coercivity of remanence.
    """
    kinds = quantity(record.u_unit), quantity(record.y_unit)
    named = {record.u_name[:1].upper(), record.y_name[:1].upper()} in ({"H", "B"}, {"H", "J"}, {"H", "M"})
    magnetic = kinds[0] in ("field", "induction") and kinds[1] in ("induction", "magnetization", "moment")
    slack, largest = SAME_LEVEL * float(np.abs(u).max()), float(np.abs(y).max())
    rest = int(np.argmin(np.abs(u)))
    if not (magnetic or named) or abs(y[rest]) < REMANENT_PART * largest:
        return ()
    field, flux = -np.sign(y[rest]) * u, np.sign(y[rest]) * y  # the demagnetizing field counts positive
    if field[0] > field[-1]:  # in the order of the samples: on a steep part the field of digitized ones goes to and fro
        field, flux = field[::-1], flux[::-1]
    found = []
    if field[-1] > slack and flux[-1] <= SAME_LEVEL * largest:
        at, error = crossing(flux, field, sigma)
        label = "coercivity of remanence" if is_remanence(record) else "coercivity"
        at = at if np.isfinite(at) else float(field[-1])
        found.append(LoopValue("coercive_input", label, at, error, record.u_unit))
    if abs(u[rest]) <= slack:
        order = np.argsort(field, kind="stable")
        at_rest = float(np.interp(0.0, field[order], flux[order]))
        found.append(LoopValue("remanence", "remanence", at_rest, sigma, record.y_unit))
    return tuple(with_stated(record, found, lambda _: (), []))
