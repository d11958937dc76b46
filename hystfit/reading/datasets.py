"""Data sets by name: records bundled with hystfit, and public measurements by address, revision and checksum."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from urllib.parse import quote

import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.errors import DataError

FOLDER_VARIABLE = "HYSTFIT_DATA"
RAW_ADDRESS = "https://raw.githubusercontent.com/{repository}/{revision}/{path}"


@dataclasses.dataclass(frozen=True)
class Source:
    """Where a measured set was published.

    Attributes:
        folder: what the set is called here and in a local folder.
        repository: owner/name.
        revision: commit that the files are taken from.
        licence: of the data.
        citation: whom to thank.
        about: what was measured.
    """

    folder: str
    repository: str
    revision: str
    licence: str
    citation: str
    about: str


@dataclasses.dataclass(frozen=True)
class File:
    """One published file: its name in a local folder, where it is in the repository, and its SHA-256.

    `paths` are tried in order, for files that the repository moved; there are none where it holds another format.
    """

    name: str
    paths: tuple[str, ...]
    sha256: str


@dataclasses.dataclass(frozen=True)
class Measured:
    """One measured record or data set: its files, and how they are read."""

    source: Source
    files: tuple[File, ...]
    read: Callable[[tuple[Path, ...]], Record | Dataset]
    about: str = ""


@dataclasses.dataclass(frozen=True)
class Bundled:
    """One simulated record that travels with hystfit."""

    file: str
    about: str


def raw_addresses(source: Source, file: File) -> list[str]:
    """Addresses at which a file may be had, at its revision; none where the repository holds another format."""
    place = {"repository": source.repository, "revision": source.revision}
    return [RAW_ADDRESS.format(path=quote(path), **place) for path in file.paths]


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


BUNDLED = {
    "stage-sine": Bundled("stage_sine.csv", "-20..100 V sine on the simulated piezo actuator"),
    "stage-sweep": Bundled("stage_sweep.csv", "sines of falling amplitude: nested minor loops"),
    "stage-step": Bundled("stage_step.csv", "a 100 V step: creep"),
    "stage-staircase": Bundled("stage_staircase.csv", "steps up and down with holds"),
}


def names() -> tuple[str, ...]:
    """Names of all data sets: bundled ones first, then measured ones as "set/record"."""
    from hystfit.reading.published import MEASURED

    return (*BUNDLED, *MEASURED)


def describe(name: str) -> str:
    """What a data set is, where it comes from, its licence and checksum, as text.

    Raises:
        DataError: no such data set.
    """
    entry = _entry(name)
    if isinstance(entry, Bundled):
        return f"{name}: {entry.about} (simulated, bundled with hystfit as {entry.file})"
    source = entry.source
    lines = [f"{name}: {entry.about or source.about}"]
    if entry.about:
        lines.append(f"  measured  {source.about}")
    lines += [f"  from      {source.repository} at {source.revision}", f"  licence   {source.licence}"]
    lines.append(f"  cite      {source.citation}")
    for file in entry.files:
        lines.append(
            f"  file      {next(iter(raw_addresses(source, file)), file.name + ' (made from the repository)')}"
        )
        lines.append(f"  sha256    {file.sha256}")
    return "\n".join(lines)


def load(name: str, *, folder: str | os.PathLike[str] | None = None, download: bool = True) -> Record | Dataset:
    """A data set by name.

    A measured set is looked for in `folder`, then in the folder that the environment variable HYSTFIT_DATA names
    (both laid out as set/file), then in the user's cache, where it is downloaded to.

    Args:
        name: one of `names()`.
        folder: where to look first; only there is looked for bundled records too where it is given.
        download: False never reaches for the network.

    Raises:
        DataError: unknown name, a file that is not found or cannot be had, or a wrong checksum.
    """
    entry = _entry(name)
    if isinstance(entry, Bundled):
        return _load_bundled(name, entry, None if folder is None else Path(folder))
    paths = tuple(_find(name, entry.source, file, folder, download) for file in entry.files)
    data = entry.read(paths)
    digest = entry.files[0].sha256 if len(entry.files) == 1 else None
    return _label(data, name, entry, digest)


def _entry(name: str) -> Bundled | Measured:
    from hystfit.reading.published import MEASURED

    found = BUNDLED.get(name) or MEASURED.get(name)
    if found is None:
        raise DataError(f"no data set {name!r}; there are {', '.join(names())}")
    return found


def _label(data: Record | Dataset, name: str, entry: Measured, digest: str | None) -> Record | Dataset:
    if isinstance(data, Record):
        return data.replace(name=name, source=f"{entry.source.repository}@{entry.source.revision}", sha256=digest)
    records = [
        record.replace(source=f"{entry.source.repository}@{entry.source.revision}", sha256=digest) for record in data
    ]
    return Dataset(tuple(records), name=name)


def _load_bundled(name: str, entry: Bundled, folder: Path | None) -> Record:
    from hystfit.reading.read import read_csv

    here = Path(__file__).resolve().parents[1]
    places = [folder] if folder is not None else [here / "_bundled", here.parent / "data"]
    for place in places:
        if (place / entry.file).is_file():
            _check_bundled(place, entry.file)
            record = read_csv(place / entry.file)
            if isinstance(record, Record):
                return record.replace(name=name)
            raise DataError(f"{place / entry.file} should hold one record, and holds {len(record)}")
    raise DataError(
        f"the bundled record {name!r} is missing: {entry.file} is in none of {[str(place) for place in places]}; "
        "install hystfit anew, or run data/make.py in a checkout"
    )


def _check_bundled(place: Path, file: str) -> None:
    """Refuse a bundled file that differs from the checksum beside it."""
    table = place / "checksums.json"
    expected = json.loads(table.read_text()).get(file) if table.is_file() else None
    if expected is not None and sha256_of(place / file) != expected:
        raise DataError(f"{place / file} differs from its SHA-256 {expected} in {table.name}: install hystfit anew")


def _find(name: str, source: Source, file: File, folder: str | os.PathLike[str] | None, download: bool) -> Path:
    """The file on this machine, its checksum verified."""
    given = [Path(folder)] if folder is not None else []
    if os.environ.get(FOLDER_VARIABLE):
        given.append(Path(os.environ[FOLDER_VARIABLE]))
    for place in given:
        path = place / source.folder / file.name
        if path.is_file():
            found = sha256_of(path)
            if found != file.sha256:
                raise DataError(
                    f"{path} is not the published file of {name!r}: its SHA-256 is {found}, expected {file.sha256}; "
                    "remove it, and it is downloaded again"
                )
            return path
    addresses = raw_addresses(source, file)
    where = f"no {source.folder}/{file.name} in {[str(place) for place in given]}" if given else "no local folder given"
    if not addresses:
        raise DataError(
            f"{name!r} cannot be downloaded file by file: get it from the repository {source.repository} at "
            f"{source.revision}, convert it to {source.folder}/{file.name} and name the folder in {FOLDER_VARIABLE} ({where})"
        )
    if not download:
        raise DataError(f"{name!r} is not on this machine ({where}); it is at {addresses[0]}")
    return _download(name, source, file, addresses)


def _download(name: str, source: Source, file: File, addresses: list[str]) -> Path:
    import pooch

    target = Path(pooch.os_cache("hystfit")) / source.folder
    kept = target / file.name
    if kept.is_file() and sha256_of(kept) != file.sha256:
        raise DataError(f"{kept} has a wrong SHA-256 (expected {file.sha256}): remove it, and it is downloaded again")
    failure: Exception | None = None
    for address in addresses:
        try:
            pooch.get_logger().setLevel("WARNING")
            return Path(pooch.retrieve(address, known_hash=f"sha256:{file.sha256}", fname=file.name, path=target))
        except OSError as error:  # no network, no such address, no room in the cache
            failure = failure or error
        except ValueError as error:
            raise DataError(f"{address} is not the published file of {name!r}, wrong SHA-256: {error}") from error
    raise DataError(
        f"{name!r} could not be downloaded from {addresses[0]}: {failure}; with a copy on this machine, name its folder "
        f"in the environment variable {FOLDER_VARIABLE} (as {source.folder}/{file.name})"
    ) from failure


def uniform_time(data: Record | Dataset, rate: float, unit: str = "s") -> Record | Dataset:
    """The same records with the time of evenly spaced samples [rate in samples per unit]."""
    if isinstance(data, Dataset):
        return Dataset(tuple(_timed(record, rate, unit) for record in data), name=data.name)
    return _timed(data, rate, unit)


def _timed(record: Record, rate: float, unit: str) -> Record:
    note = f"time made from the published rate of {rate:g} samples per {unit}"
    return record.replace(t=np.arange(len(record)) / rate, t_unit=unit, notes=(*record.notes, note))
