"""Parquet tables: columns of numbers, or one loop a row, as a data base of loops has them."""

from __future__ import annotations

import dataclasses
import io
from typing import Any

import numpy as np

from hystfit.errors import DataError, optional
from hystfit.outcome import Code, Note
from hystfit.reading.files.file_bytes import FileBytes
from hystfit.reading.files.text_file import Opening
from hystfit.reading.layouts.array_files import DOUBLE, check_size
from hystfit.reading.layouts.array_table import read_arrays
from hystfit.reading.table.raw_table import Part, Table


def read_parquet(file: FileBytes, opening: Opening) -> Table:
    """The columns of a Parquet file; needs the extra "frames".

    Columns of lists, of which each row is a loop, are joined, and each row is a record. It has the name in the first column of texts or
    whole numbers of which no two are alike, else its number.
    """
    rows: list[_Rows] = []

    def arrays_of(raw: bytes) -> dict[str, np.ndarray]:
        parquet = optional("pyarrow.parquet", "frames", "reading Parquet files")
        opened = parquet.ParquetFile(io.BytesIO(raw))
        groups = [opened.metadata.row_group(k) for k in range(opened.num_row_groups)]
        numbers = sum(group.column(k).num_values for group in groups for k in range(group.num_columns))
        check_size(DOUBLE * numbers, raw)
        table = opened.read()
        lists = [field.name for field in table.schema if str(field.type).startswith(("list", "large_list"))]
        if not lists:
            return {name: _values(table[name]) for name in table.column_names}
        rows.append(_Rows.of(table, lists))
        return rows[0].columns(table, lists)

    table = read_arrays(arrays_of, file, opening)
    if not rows:
        return table
    part, parts = np.repeat(np.arange(len(rows[0].names)), rows[0].counts), tuple(map(Part, rows[0].names))
    note = Note(Code.FILE_FORMAT, f"one loop a row: {len(parts)} rows with lists")
    return dataclasses.replace(table, part=part, parts=parts, notes=(*table.notes, note))


@dataclasses.dataclass(frozen=True)
class _Rows:
    """Names of the rows of a table, and the numbers of entries of their lists."""

    names: tuple[str, ...]
    counts: np.ndarray

    @classmethod
    def of(cls, table: Any, lists: list[str]) -> _Rows:
        counts = [_lengths(table[name]) for name in lists]
        other = next((name for name, count in zip(lists, counts, strict=True) if (count != counts[0]).any()), None)
        if other is not None:
            raise DataError(f"within a row, the lists of {lists[0]!r} and {other!r} differ in length")
        names = [f"row {k}" for k in range(table.num_rows)]
        for name in table.column_names:
            values = [] if name in lists else table[name].to_pylist()
            if values and all(isinstance(value, str | int) for value in values) and len(set(values)) == len(values):
                names = [str(value) for value in values]
                break
        return cls(tuple(names), counts[0])

    def columns(self, table: Any, lists: list[str]) -> dict[str, np.ndarray]:
        """The lists joined, and the numbers beside them once for each entry."""
        joined: dict[str, np.ndarray] = {}
        for name in table.column_names:
            column = table[name].combine_chunks()
            if name in lists:
                joined[name] = np.asarray(column.flatten().to_numpy(zero_copy_only=False))
            elif (values := column.to_numpy(zero_copy_only=False)).dtype.kind in "fiub":
                joined[name] = np.repeat(values, self.counts)
        return joined


def _values(column: Any) -> np.ndarray:
    """Numbers, dates or texts of a column; a missing text is empty."""
    if not str(column.type).startswith(("string", "large_string", "dictionary")):
        return np.asarray(column.to_numpy())
    coded = column if str(column.type).startswith("dictionary") else column.dictionary_encode()
    coded = coded.combine_chunks()
    texts = np.array([*map(str, coded.dictionary.to_pylist()), ""])
    codes = coded.indices.to_numpy(zero_copy_only=False)
    return texts[np.where(np.isnan(codes.astype(float)), len(texts) - 1, codes).astype(int)]


def _lengths(column: Any) -> np.ndarray:
    """Entries of each list, 0 where there is none."""
    lengths = np.asarray(column.combine_chunks().value_lengths().to_numpy(zero_copy_only=False), float)
    return np.nan_to_num(lengths).astype(int)
