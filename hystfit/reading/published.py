"""The data sets of `published.toml`: their files, addresses and checksums, and the readers that make records of them."""

from __future__ import annotations

import dataclasses
import importlib.resources
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.reading.read import read_csv

Reader = Callable[[tuple[Path, ...]], Record | Dataset]
_RAW_ADDRESS = "https://raw.githubusercontent.com/{repository}/{revision}/{path}"


@dataclasses.dataclass(frozen=True)
class Source:
    """Publication of a measured set.

    Attributes:
        folder: name of the set here and in a local folder.
        repository: owner/name.
        revision: commit that the files are taken from.
        license: of the data.
        citation: of the data.
        about: what was measured.
    """

    folder: str
    repository: str
    revision: str
    license: str
    citation: str
    about: str


@dataclasses.dataclass(frozen=True)
class DataFile:
    """One published file.

    Attributes:
        name: in a local folder.
        paths: in the repository, tried in order for files that were moved; none where it holds another format.
        sha256: of the file.
    """

    name: str
    paths: tuple[str, ...]
    sha256: str

    def addresses(self, source: Source) -> list[str]:
        """Addresses of the file at the revision of its source."""
        place = {"repository": source.repository, "revision": source.revision}
        return [_RAW_ADDRESS.format(path=quote(path), **place) for path in self.paths]


@dataclasses.dataclass(frozen=True)
class Measured:
    """One measured record or data set: its files and their reader."""

    source: Source
    files: tuple[DataFile, ...]
    read: Reader
    about: str = ""


@dataclasses.dataclass(frozen=True)
class Bundled:
    """One simulated record that is installed with hystfit."""

    file: str
    about: str


def text_reader(input: Sequence[Any], output: Sequence[Any], *, rate: float | None = None, **options: object) -> Reader:
    """Reader of one text file.

    Args:
        **options: of `read_csv`.
    """

    def reader(paths: tuple[Path, ...]) -> Record:
        record = read_csv(paths[0], input=input[0], output=output[0], **{"time": False, **options})  # type: ignore[arg-type]
        if isinstance(record, Dataset):
            raise DataError(f"{paths[0]} should hold one record, and holds {len(record)}")
        record = record.replace(u_name=input[1], u_unit=input[2], y_name=output[1], y_unit=output[2])
        if rate is None:
            return record
        timed = record.replace(t=np.arange(len(record)) / rate, t_unit="s")
        return timed.noted(Code.PREPARED, f"time computed from the published rate of {rate:g} samples per s")

    return reader


def magnetic_loops(paths: tuple[Path, ...]) -> Dataset:
    """Loops in the columns of two matrices HmeasT [A/m] and BmeasT [T], smallest first."""
    from scipy.io import loadmat

    fields, flux = loadmat(paths[0])["HmeasT"], loadmat(paths[1])["BmeasT"]
    records = []
    for number in range(fields.shape[1]):
        u, y = fields[:, number], flux[:, number]
        records.append(Record(u, y, u_unit="A/m", y_unit="T", u_name="H", y_name="B", name=f"loop-{number + 1}"))
    return Dataset(tuple(records))


def shaking_table(paths: tuple[Path, ...]) -> Record:
    """Position x and force F from the matrix x_F = [x v F], 0.01 s."""
    from scipy.io import loadmat

    table = loadmat(paths[0])["x_F"]
    record = Record(table[:, 0], table[:, 2], t=0.01 * np.arange(len(table)), u_name="x", y_name="F")
    return record.noted(Code.LEFT_OUT, "left out: the measured velocity (second column of x_F)")


def pulse_train(paths: tuple[Path, ...]) -> Dataset:
    """Rows `DataValue, V, I, t, t` of an instrument's CSV: one record per pulse, with its own time."""
    rows = []
    for line in paths[0].read_text(encoding="utf-8-sig").splitlines():
        if line.startswith("DataValue"):
            rows.append([float(cell) for cell in line.split(",")[1:4]])
    if not rows:
        raise DataError(f"{paths[0]} has no DataValue rows")
    table = np.array(rows)
    pulses = np.split(table, np.flatnonzero(np.diff(table[:, 2]) < 0) + 1)
    units = {"u_unit": "V", "y_unit": "A", "u_name": "V", "y_name": "I"}
    note = Note(Code.PREPARED, "the output is a current: integrate it over time for the charge")
    return Dataset(
        tuple(
            Record(*pulse.T[:3], name=f"pulse-{number}", notes=(note,), **units)  # type: ignore[arg-type]
            for number, pulse in enumerate(pulses, start=1)
        )
    )


# By the name that `published.toml` gives them.
_READERS: dict[str, Reader] = {
    "csv": lambda paths: read_csv(paths[0]),
    "magnetic_loops": magnetic_loops,
    "shaking_table": shaking_table,
    "pulse_train": pulse_train,
}


def _entries() -> dict[str, Bundled | Measured]:
    """All data sets of `published.toml` by name, in its order."""
    content = tomllib.loads(
        (importlib.resources.files("hystfit.reading") / "published.toml").read_text(encoding="utf-8")
    )
    entries: dict[str, Bundled | Measured] = {name: Bundled(**one) for name, one in content.pop("bundled").items()}
    for prefix, described in content.items():
        records, shared = described.pop("records"), described.pop("read")
        source = Source(**{"folder": prefix} | described)
        for name, record in records.items():
            files = tuple(map(_data_file, record.get("files", [record])))
            options = shared | record.get("read", {})
            reader = _READERS[options["reader"]] if "reader" in options else text_reader(**options)
            entries[f"{prefix}/{name}"] = Measured(source, files, reader, record["about"])
    return entries


def _data_file(described: dict[str, Any]) -> DataFile:
    paths = tuple(described.get("paths", ()))
    return DataFile(described.get("name") or PurePosixPath(paths[0]).name, paths, described["sha256"])


ENTRIES: Mapping[str, Bundled | Measured] = _entries()
