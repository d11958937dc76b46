"""The fit of one loop of many, as a row of numbers that is small enough to keep."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from hystfit.batch.many_fits import ERRORS
from hystfit.data.record import Record
from hystfit.outcome import Code, Severity, Status, WithStatus
from hystfit.outcome.table import or_none
from hystfit.results.measured.quantities import QUANTITIES
from hystfit.results.quantity_estimates import quantity_values
from hystfit.results.result import FitResult

Number = float | None


@dataclasses.dataclass(frozen=True)
class Row(WithStatus):
    """The fit of one loop; what is unknown is None."""

    name: str  # of the loop: its file (with the name of the curve where the file has several), or the record's name
    file: str  # that it was read from; "" for a record
    sha256: str | None  # checksum of the file, or of the numbers of a record
    status: Status  # of the fit; `Status.FAILED` where there is none
    reason: str = ""  # why there is no fit, or the notes that are warnings or errors; "" where there are none
    codes: tuple[str, ...] = ()  # of all notes
    model: str | None = None  # readable name
    samples: int | None = None  # that were fitted
    # values, stderr: of the free parameters; the standard error is None where it is undefined
    values: Mapping[str, float] = dataclasses.field(default_factory=dict)
    stderr: Mapping[str, Number] = dataclasses.field(default_factory=dict)
    rmse: Number = None  # root mean square error [y]
    # error_percent, max_error_percent: rms and largest error, percent of the output's range
    error_percent: Number = None
    max_error_percent: Number = None
    # of the steady loop of the fitted model over the fitted input range (loss per cycle, coercivity, remanence, ...), and those that the
    # model derives from its parameters
    quantities: Mapping[str, Number] = dataclasses.field(default_factory=dict)
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)  # of parameters and quantities

    def to_dict(self) -> dict[str, Any]:
        content = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        content |= {name: dict(content[name]) for name in ("values", "stderr", "quantities", "units")}
        return content | {"status": str(self.status), "codes": list(self.codes)}

    def numbers(self) -> dict[str, Number]:
        """Its numbers by the names of columns: "value tau", "stderr tau", "rmse", "quantity loop_area", ..."""
        both = {"value": self.values, "stderr": self.stderr}
        of_parameters = {f"{what} {name}": rows[name] for name in self.values for what, rows in both.items()}
        errors = {name: getattr(self, name) for name in ERRORS}
        return of_parameters | errors | {f"quantity {name}": value for name, value in self.quantities.items()}

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Row:
        """From what `to_dict` gave; a KeyError, ValueError or TypeError where it is no such description."""
        known = {field.name: content[field.name] for field in dataclasses.fields(cls)}
        return cls(**known | {"status": Status(content["status"]), "codes": tuple(content["codes"])})


def row_of(name: str, file: str, record: Record, result: FitResult) -> Row:
    """The row of a fitted loop."""
    free = [p for p in result.parameters if not p.fixed]
    converted = [note for note in record.notes if note.code is Code.UNITS]
    notes = [*result.notes, *converted]
    quantities, of_quantities = _quantities(result)
    return Row(
        name=name,
        file=file,
        sha256=record.sha256 or record.digest(),
        status=result.status,
        reason="; ".join(note.text for note in notes if note.severity is not Severity.INFO),
        codes=tuple(dict.fromkeys(str(note.code) for note in notes)),
        model=result.name,
        samples=result.train.n,
        values={p.name: float(p.value) for p in free},
        stderr={p.name: or_none(p.stderr) for p in free},
        rmse=or_none(result.train.rmse),
        error_percent=or_none(result.train.nrmse_percent),
        max_error_percent=or_none(result.train.max_error_percent),
        quantities=quantities,
        units={p.name: p.unit for p in free} | of_quantities,
    )


def _quantities(result: FitResult) -> tuple[dict[str, Number], dict[str, str]]:
    """Quantities of the fitted model, and their units."""
    values, derived = quantity_values(result), result.derived
    label = {name: QUANTITIES[name].units(result.data) for name in values}
    return values | {p.name: or_none(p.value) for p in derived}, label | {p.name: p.unit for p in derived}
