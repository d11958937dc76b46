"""The loops of a batch before they are fitted: files or records, with keys that identify their data."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError, HystfitError
from hystfit.reading import datasets
from hystfit.reading.files.file_bytes import no_file
from hystfit.reading.read import read
from hystfit.reading.several import files_of, pair_of


class Source(NamedTuple):
    """A file (its path in `name`, read where it is fitted) or a record; `key`, a checksum with the name, identifies the data."""

    name: str
    key: str
    record: Record | None = None

    @property
    def file(self) -> str:
        """Path of the file; "" for a record."""
        return self.name if self.record is None else ""

    def loops(self, reading: Mapping[str, Any], unread: dict[str, str] | None = None) -> list[tuple[str, Record]]:
        """Name and record of each loop of a file or record; `unread` takes the reasons of curves that cannot be read, by loop."""
        if self.record is not None:
            return [(self.name, self.record)]
        failed: dict[str, str] = {}
        data = Dataset.of(read(self.name, **reading, unread=failed))
        name = lambda curve: self.name if len(data) + len(failed) == 1 else f"{self.name}: {curve}"
        if unread is not None:
            unread |= {name(curve): reason for curve, reason in failed.items()}
        return [(name(record.name), record) for record in data]


def sources_of(loops: Iterable[str | Path | Record] | str | Path) -> list[Source]:
    """Files, those that patterns match, and records."""
    if isinstance(loops, Record):
        raise DataError("fit_many fits a list of loops; use fit for a single record")
    listed = [loops] if isinstance(loops, (str, Path)) else list(loops)
    found = [source for loop in listed for source in _sources(loop)]
    if not found:
        raise DataError("there are no loops to fit")
    name, count = Counter(source.name for source in found).most_common(1)[0]
    if count > 1:
        raise DataError(f"{name!r} is given {count} times: loops must have different names")
    return found


def _sources(loop: Any) -> list[Source]:
    if isinstance(loop, Record):
        digest = hashlib.sha256(f"{loop.name}\n{loop.u_unit}\n{loop.y_unit}\n{loop.digest()}".encode())
        return [Source(loop.name, digest.hexdigest(), loop)]
    if not isinstance(loop, (str, Path)):
        raise DataError(f"a loop is a file or a Record, got {type(loop).__name__}")
    if str(loop) in datasets.names() and not Path(loop).exists():
        return [source for record in Dataset.of(datasets.load(str(loop))) for source in _sources(record)]
    return [Source(str(file), _key(str(file))) for file in files_of(loop)]


def _key(path: str) -> str:
    """SHA-256 of the path and the bytes of a file, or of a pair of files; of the path alone where they cannot be read."""
    digest = hashlib.sha256(path.encode())
    for part in pair_of(path) or (path,):
        if Path(part).is_dir():
            raise no_file(part, f"give a pattern ('{part}/*.csv')")
        if not Path(part).exists():
            raise DataError(f"no file {part!r}")
        try:
            digest.update(Path(part).read_bytes())
        except OSError:
            digest.update(b"unreadable")
    return digest.hexdigest()


def units_of(sources: Sequence[Source], reading: Mapping[str, Any]) -> dict[str, str]:
    """Units of the first loop that can be read, to which the others are converted."""
    reasons = []
    for source in sources:
        try:
            _, record = source.loops(reading)[0]
        except (HystfitError, OSError) as error:
            reasons.append(error)
            continue
        return {"u": record.u_unit, "y": record.y_unit, "t": record.t_unit}
    if len(sources) == 1:
        raise DataError(str(reasons[0]))
    raise DataError(f"none of {len(sources)} loops can be read; the first: {reasons[0]}")
