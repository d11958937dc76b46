"""The report on a fit as text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.outcome import Code, Note, Severity, Status
from hystfit.outcome.note import has, warn
from hystfit.outcome.table import number, with_error
from hystfit.outcome.wrapping import PROSE, shortened, within
from hystfit.results.measured.loop_values import MEASURED
from hystfit.results.measured.quantities import QUANTITIES, QuantityEstimate
from hystfit.results.measured.steady_loops import Excitation
from hystfit.results.quantity_estimates import measured_quantities
from hystfit.results.report.answer import Wording, answer
from hystfit.results.report.tables import fixed_words, metrics_table, parameter_table, quantity_table, unit_words
from hystfit.results.result import FitResult

ERRORS = "Simulation error (model driven by the input only; % of the output range)"
_STATUS = {Status.OK: "usable", Status.ROUGH: "ROUGH, usable only where such errors are acceptable"}
# Part of the difference of a steady loop from the measured one up to which the model may err in that one, and the difference be no error.
_ACCOUNTED = 0.2
_VERDICT = frozenset(
    {
        Code.ACCURACY,
        Code.CONDITIONS,
        Code.MEASUREMENT_NOISE,
        Code.CLIPPED,
        Code.POOR_FIT,
        Code.ROUGH_FIT,
        Code.TEST_ERROR,
        Code.LEFT_OUT_ERROR,
        Code.OTHER_FAMILY,
        Code.MODEL_MISMATCH,
        Code.INITIAL_STATE,
        Code.DRIFT,
        Code.LAST_HALF_CYCLE,
        Code.MINOR_LOOPS,
        Code.EXTRAPOLATION,
        Code.SINGLE_VALUED,
        Code.SPEED_DEPENDENT,
        Code.RECORDS_DIFFER,
        Code.NO_LOOP,
    }
)


def _section(heading: str, items: Iterable[object]) -> list[str]:
    return ["", heading, *(f"  - {item}" for item in items if str(item))]


def headline(result: FitResult) -> str:
    """Model, data and status in one line."""
    names = [record.name for record in result.data]
    what = names[0] if len(names) == 1 else f"{len(names)} records of {result.data.name}"
    status = _STATUS.get(result.status, f"NOT USABLE ({result.status})")
    return f"{result.name} fitted to {what}: {status}"


def quantities_of(result: FitResult) -> str:
    """Heading of the quantities: their loop and, for a model that depends on time, the duration of a cycle."""
    text = "Quantities of the steady loop over the fitted input range"
    first = result.data[0]
    if result.model.rate_independent or first.t is None:
        return text
    loop = Excitation.of(result.data)
    return f"{text}, one cycle in {f'{loop.points * loop.interval:.3g} {first.t_unit}'.rstrip()}"


def verdict(result: FitResult) -> list[Note]:
    """The notes that explain or qualify the status, and quantities in which model and measured loop differ."""
    notes = [note for note in result.notes if _explains(note)]
    if not any(one.differs for one in result.quantities):
        return notes
    modeled = measured_quantities(result.data.map(lambda record: record.replace(y=result.predict(record))))
    return notes + [_difference(one, result.data, modeled) for one in result.quantities if one.differs]


def _difference(one: QuantityEstimate, data: Dataset, modeled: Mapping[str, float]) -> Note:
    """A warning that the model has another value of a quantity than the measured loop.

    None is due where the model has about the measured one in these loops (`modeled`), as of a device whose loops change with each cycle.
    """
    assert one.value is not None
    assert one.measured is not None
    values = with_error(one.value, one.stderr, one.unit), f"{number(one.measured)} {one.unit}".rstrip()
    text = f"{QUANTITIES[one.name].label_on(data)}: {values[0]} by the model, {values[1]} in the measured loop"
    here = modeled.get(one.name, np.nan)
    if abs(here - one.measured) < _ACCOUNTED * abs(one.value - one.measured):
        shown = f"{number(here)} {one.unit}".rstrip()
        return Note(Code.QUANTITY_DIFFERS, f"{text}, where the model has {shown}: that loop is not steady")
    return warn(Code.QUANTITY_DIFFERS, f"{text}; use the measured value")


def remarks(result: FitResult) -> list[Note]:
    """All other notes."""
    return [note for note in result.notes if not _explains(note)]


def _explains(note: Note) -> bool:
    """Whether a note is a reason of the status, or belongs to those."""
    return note.code in _VERDICT or note.severity is Severity.ERROR


def facts(result: FitResult) -> dict[str, list[str]]:
    """Residuals, estimator, data and provenance, in sentences under headings."""
    unit = result.data.units["y"]
    starts = f"{result.in_best_basin} of {result.starts} starts reached the best cost"
    fit = [f"{result.method}; {starts}" if result.starts > 1 else f"{result.method}, one start"]
    if result.rank is not None:
        condition = f", condition {result.condition:.2g}" if result.condition is not None else ""
        fit.append(f"{len(result.free_names)} free parameters, rank {result.rank}{condition}")
    else:
        fit.append(f"{len(result.free_names)} free parameters")
    fit.append(f"{number(result.compile_s, '.2f')} s compilation, {number(result.run_s, '.2f')} s computation")
    spread = [f"standard deviation {number(result.sigma)} {unit}".rstrip()]
    if result.correlation_time > 1 or result.error_ratio != 1:
        spread.append(
            f"autocorrelated over {number(result.correlation_time, '.3g')} samples (integrated autocorrelation time)"
        )
    elif has(result.notes, Code.ERROR_RATIO):
        spread.append("autocorrelated (see the notes)")
    else:
        spread.append("white (no significant autocorrelation)")
    data = []
    for record in result.data:
        fitted = "all" if record.used.all() else str(int(record.used.sum()))
        data.append(f"{record.name}: {len(record)} samples, {fitted} fitted; {', '.join(_columns_of(record))}")
        data += [note.text for note in record.notes if note.text not in data]
    source = result.provenance
    versions = ", ".join(f"{name} {version}" for name, version in source.get("versions", {}).items())
    origin = [
        f"{source.get('date', '-')}, seed {source.get('seed', '-')}, Python {source.get('python', '-')}",
        versions,
    ]
    files: dict[str, list[str]] = {}
    for record in source.get("records", []):
        digest = record.get("file_sha256") or record.get("data_sha256")
        files.setdefault(digest, []).append(record.get("source") or record.get("name"))
    more = lambda names: f" and {len(names) - 1} more records" if len(names) > 1 else ""
    known = [f"{names[0]}{more(names)}, SHA-256 {digest}" for digest, names in files.items()]
    origin += shortened(known, 5, "and {} more files (result.json has their checksums)")
    return {
        "Residuals": spread,
        "Fit": fit,
        "Data": shortened(data, 16, "and {} more (result.json and records.npz)"),
        "Provenance": origin,
    }


def _extent(values: np.ndarray, unit: str) -> str:
    low, high = np.nanmin(values) + 0.0, np.nanmax(values) + 0.0  # + 0: no minus sign before 0
    return f"{low:.4g} to {high:.4g} {unit}".rstrip()


def _columns_of(record: Record) -> list[str]:
    """Names, ranges and units of input, output and time."""
    ranges = [
        f"input {record.u_name} {_extent(record.u, record.u_unit)}",
        f"output {record.y_name} {_extent(record.y, record.y_unit)}",
    ]
    if record.t is not None:
        ranges.append(f"{record.t[-1] - record.t[0]:.4g} {record.t_unit}".rstrip() + " long")
    return ranges


def text_report(result: FitResult, wording: Wording | None = None, width: int = PROSE) -> str:
    """The report as text in lines of `width` columns; only commands, and tables of many numbers, may be wider."""
    wording = wording or Wording()
    title = headline(result)
    lines = [title, "=" * min(len(title), width)]
    if not result.usable:
        lines.append(result.advice)
    *values, (following, commands) = answer(result, wording)
    lines += _section("Answer", (f"{name}: {value}" for name, value in values))
    lines += [f"  - {following}:", *(f"      {command}" for command in commands.splitlines())]  # whole, to be copied
    lines += _section("Verdict", verdict(result))
    lines += ["", ERRORS, *metrics_table(result).lines("  ")]
    if result.quantities:
        lines += ["", quantities_of(result), *quantity_table(result).lines("  ")]
    if any(result.measured.rows.values()):
        lines += ["", MEASURED, *shortened(result.measured.table().lines("  "), 60, "  and {} more (result.json)")]
    lines += ["", "Parameters", *parameter_table(result).lines("  ")]
    lines += [f"  {words}" for words in (fixed_words(result), unit_words(result)) if words]
    if notes := remarks(result):
        lines += _section("Notes", notes)
    for heading, items in facts(result).items():
        lines += _section(heading, items)
    return within(wording.translate("\n".join(lines)), width) + "\n"
