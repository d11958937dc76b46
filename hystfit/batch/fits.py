"""The fits of many loops: a table with one row per loop, the distribution of each parameter, and the loops that need attention."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from hystfit.batch.many_fits import ERRORS, ManyFits
from hystfit.batch.row import Row
from hystfit.batch.sources import Source
from hystfit.batch.work import Work, fit_alone, record_of
from hystfit.data.record import Record
from hystfit.errors import ParameterError, optional
from hystfit.outcome import Status, Table
from hystfit.outcome.table import write_csv
from hystfit.outcome.wrapping import begun
from hystfit.params.units import with_unit
from hystfit.registry import near
from hystfit.results.estimates import grouped
from hystfit.results.exchange import write_table
from hystfit.results.result import FitResult
from hystfit.results.saving.folders import writing_file


@dataclasses.dataclass(frozen=True, repr=False)
class Fits(ManyFits):
    """Fits of one model to many loops.

    Attributes:
        rows: one for each loop, in the order given.
        model: its name.
        units: of input u, output y and time t, to which all loops were converted.
        work: what was done with every loop.
        sources: the file or record of each row.
    """

    rows: tuple[Row, ...]
    model: str
    units: Mapping[str, str]
    work: Work
    sources: tuple[Source, ...]
    schema: ClassVar[str] = "hystfit.batch/1"

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def __getitem__(self, name: str) -> Row:
        return self.rows[self._number(name)]

    def _number(self, name: str) -> int:
        names = [row.name for row in self.rows]
        if name not in names:
            raise KeyError(f"no loop {name!r}{near(name, names)}")
        return names.index(name)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all free parameters."""
        return tuple(dict.fromkeys(name for row in self.rows for name in row.values))

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the quantities that follow from the parameters."""
        return tuple(dict.fromkeys(name for row in self.rows for name in row.quantities))

    def _statuses(self) -> list[str]:
        return [str(row.status) for row in self.rows]

    def unit(self, name: str) -> str:
        """Unit of a parameter or quantity; "" where rows differ."""
        units = {row.units[name] for row in self.rows if name in row.units}
        return units.pop() if len(units) == 1 else ""

    def values(self, name: str, *, usable: bool = True) -> np.ndarray:
        """Values of a parameter or quantity, of usable fits only by default, shape (n,).

        Raises:
            ParameterError: no row has it.
        """
        known = (*self.names, *self.quantities)
        if name not in known:
            raise ParameterError(f"no parameter or quantity {name!r}{near(name, known)}; there are {', '.join(known)}")
        return self._values([row for row in self.rows if row.usable or not usable], name)

    def _values(self, rows: Sequence[Row], name: str) -> np.ndarray:
        found = [row.values.get(name, row.quantities.get(name)) for row in rows]
        return np.array([value for value in found if value is not None], dtype=float)

    def _by_unit(self, name: str) -> dict[str, list[Row]]:
        """Usable fits that have a parameter or quantity, by its unit: numbers in different units have no common median."""
        groups: dict[str, list[Row]] = {}
        self.values(name)  # refuses an unknown name
        for row in self.rows:
            if row.usable and (name in row.values or name in row.quantities):
                groups.setdefault(row.units.get(name, ""), []).append(row)
        return groups or {self.unit(name): []}

    def result(self, name: str) -> FitResult:
        """The fit of one loop with everything that `hystfit.fit` gives; it is fitted again.

        Raises:
            KeyError: no loop of this name.
            HystfitError: the loop cannot be read or fitted.
        """
        number = self._number(name)
        return fit_alone(self.work, self.sources[number], self.rows[number])

    def record(self, name: str) -> Record:
        """The record of one loop, in the units of the table.

        Raises:
            KeyError: no loop of this name.
            HystfitError: the loop cannot be read.
        """
        number = self._number(name)
        return record_of(self.work, self.sources[number], self.rows[number])

    def columns(self) -> dict[str, list[Any]]:
        """All rows as columns of text and numbers; NaN and "" where unknown."""
        nan = lambda value: math.nan if value is None else float(value)
        text = lambda value: "" if value is None else str(value)
        columns: dict[str, list[Any]] = {"loop": [row.name for row in self.rows]}
        columns |= {name: [text(getattr(row, name)) for row in self.rows] for name in ("sha256", "status", "model")}
        columns["samples"] = [nan(row.samples) for row in self.rows]
        for name in self.names:
            columns[name] = [nan(row.values.get(name)) for row in self.rows]
            columns[f"{name}_stderr"] = [nan(row.stderr.get(name)) for row in self.rows]
        columns |= {name: [nan(getattr(row, name)) for row in self.rows] for name in ERRORS}
        columns |= {name: [nan(row.quantities.get(name)) for row in self.rows] for name in self.quantities}
        columns["notes"] = [" ".join(row.codes) for row in self.rows]
        columns["reason"] = [row.reason for row in self.rows]
        return columns

    def column_units(self) -> dict[str, str]:
        """Unit of each column of numbers that has one."""
        units = {name: self.unit(name) for name in (*self.names, *self.quantities)}
        units |= {f"{name}_stderr": units[name] for name in self.names}
        units |= {"rmse": self.units.get("y", ""), "error_percent": "%", "max_error_percent": "%"}
        return {name: unit for name, unit in units.items() if unit}

    def to_dataframe(self) -> Any:
        """`columns` as a pandas data frame; its attribute `attrs` has the units.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        pandas = optional("pandas", "frames", "to_dataframe")
        frame = pandas.DataFrame(self.columns())
        frame.attrs = {"schema": self.schema, "model": self.model, "units": self.column_units()}
        return frame

    def to_xarray(self) -> Any:
        """`columns` as an xarray dataset over the dimension `loop`, with units as attributes.

        Raises:
            MissingExtraError: xarray is not installed.
        """
        xarray = optional("xarray", "frames", "to_xarray")
        columns, units = self.columns(), self.column_units()
        loops = columns.pop("loop")
        data = {
            name: ("loop", np.asarray(values), {"units": units[name]} if name in units else {})
            for name, values in columns.items()
        }
        return xarray.Dataset(data, {"loop": loops}, {"schema": self.schema, "model": self.model})

    def save(self, path: str | Path) -> Path:
        """Write the table: .csv (units in the headings), .parquet, .nc (netCDF) or .zarr (a Zarr store).

        Raises:
            DataError: another ending.
            HystfitError: the file cannot be written; an older one stays.
            MissingExtraError: a package for this kind of file is not installed.
        """
        if (path := Path(path)).suffix != ".csv":
            return write_table(path, lambda: [self.to_dataframe()], self.to_xarray)
        units = self.column_units()
        columns = {with_unit(name, units.get(name, "")): values for name, values in self.columns().items()}
        with writing_file(path) as scratch:
            write_csv(scratch, columns, ".15g")
        return path

    def worst(self, count: int = 20) -> tuple[Row, ...]:
        """Loops to inspect: first those without a fit, then unusable ones, then those with the largest errors."""
        rank = lambda row: (row.status is not Status.FAILED, row.usable, -(row.error_percent or 0.0))
        return tuple(sorted(self.rows, key=rank)[:count])

    def summary(self, names: Sequence[str] | None = None) -> Table:
        """Distribution of each parameter and quantity over the usable fits, beside the median standard error of one fit.

        Args:
            names: of parameters and quantities; all of them by default.
        """
        rows = []
        for name in names or (*self.names, *self.quantities):
            for unit, loops in self._by_unit(name).items():
                values = self._values(loops, name)
                errors = [error for row in loops if (error := row.stderr.get(name)) is not None]
                spread = float(np.std(values, ddof=1)) if values.size > 1 else None
                rows.append((name, unit, values, (spread, float(np.median(errors)) if errors else None)))
        return self._distribution(rows, ("standard deviation", "median stderr"))

    def __str__(self) -> str:
        return self.text()

    __repr__ = __str__

    def text(self, width: int | None = None) -> str:
        """Counts, the summary of the usable fits, and the reasons of those that are not usable.

        Args:
            width: columns of the table; a wider one is shown in parts.
        """
        rows = grouped(self.names, str)
        few = [name for name, family in rows if len(family) == 1]
        many = [f"{name}[{len(family)}]" for name, family in rows if len(family) > 1]
        usable = [*self.summary((*self.quantities, *few)).lines("  ", width)]
        usable += [f"  {', '.join(many)}: in fits.csv"] if many else []
        worst = [row for row in self.worst(5) if not row.usable]
        return self._lines([], usable, [f"  {row.name}: {row.status}: {begun(row.reason)}" for row in worst])

    def to_dict(self) -> dict[str, Any]:
        """The contents of `result.json`; unknown values are null."""
        return super().to_dict() | {"loops": len(self.rows), "rows": [row.to_dict() for row in self.rows]}
