"""Several records that are fitted, compared or predicted together."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from hystfit.data.record import Record, median_interval
from hystfit.errors import DataError


@dataclasses.dataclass(frozen=True, eq=False)
class Dataset:
    """Several records with distinct names, for one model.

    They are converted to the units of the first record that has one, and their weights refer to one standard deviation.

    Raises:
        DataError: no records, two of the same name, units of different quantities, or standard deviations for some only.
    """

    records: tuple[Record, ...]
    name: str = "data"

    def __post_init__(self) -> None:
        object.__setattr__(self, "records", tuple(self.records))
        if not self.records:
            raise DataError(f"data set {self.name!r} has no records")
        names = [record.name for record in self.records]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise DataError(f"data set {self.name!r}: record names must differ, found {twice} more than once")
        units = self.units
        alike = [record.in_units(**units) for record in self.records]
        sigma = _common_sigma(alike)
        object.__setattr__(self, "records", tuple(_referred(record, sigma) for record in alike))

    @classmethod
    def of(cls, data: Record | Dataset | Iterable[Record]) -> Dataset:
        """A data set from a record, a data set or a list of records.

        Raises:
            DataError: anything else.
        """
        if isinstance(data, Dataset):
            return data
        if isinstance(data, Record):
            return cls((data,), name=data.name)
        try:
            records = tuple(data)
        except TypeError as error:
            raise DataError(f"expected a Record, a Dataset or a list of records, got {type(data).__name__}") from error
        for record in records:
            if not isinstance(record, Record):
                raise DataError(
                    f"expected records, got {type(record).__name__}: make them with hystfit.Record(u=..., y=..., t=...)"
                )
        return cls(records)

    def __iter__(self) -> Iterator[Record]:
        return iter(self.records)

    def __len__(self) -> int:
        return len(self.records)

    def __repr__(self) -> str:
        return "\n".join(
            [f"<Dataset {self.name!r}: {len(self)} records>", *(f"  {record!r}" for record in self.records)]
        )

    def __getitem__(self, key: int | str) -> Record:
        if isinstance(key, int):
            return self.records[key]
        for record in self.records:
            if record.name == key:
                return record
        raise DataError(f"no record {key!r}; there are {[r.name for r in self.records]}")

    def map(self, change: Callable[[Record], Record]) -> Dataset:
        """Apply a function to every record."""
        return Dataset(tuple(change(record) for record in self.records), name=self.name)

    @property
    def units(self) -> dict[str, str]:
        """Units of u, y and t, each from the first record that has one."""
        first = lambda field: next((unit for record in self.records if (unit := getattr(record, field))), "")
        return {symbol: first(f"{symbol}_unit") for symbol in ("u", "y", "t")}

    @property
    def sampling_interval(self) -> float | None:
        """Median of the positive time steps of all records [t_unit]; None where no record has time."""
        return median_interval(np.concatenate([record.dt[1:] for record in self.records]))


def _common_sigma(records: Sequence[Record]) -> float | None:
    """Standard deviation of the first record at weight 1; None where no record has one."""
    known = [record for record in records if record.sigma is not None]
    if known and len(known) < len(records):
        without = next(record.name for record in records if record.sigma is None)
        raise DataError(f"record {without!r} has no standard deviations, and others have: give them for all or none")
    return known[0].sigma if known else None


def _referred(record: Record, sigma: float | None) -> Record:
    """The record with its weights relative to another standard deviation [y_unit]."""
    if sigma is None or record.sigma is None or record.sigma == sigma:
        return record
    return record.replace(weight=record.weight * (sigma / record.sigma) ** 2, sigma=sigma)
