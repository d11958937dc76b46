"""Data sets by name: records installed with hystfit, and public measurements by address, revision and checksum."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.reading.published import ENTRIES, Bundled, DataFile, Measured, Source
from hystfit.reading.read import read_csv
from hystfit.registry import near

FOLDER_VARIABLE = "HYSTFIT_DATA"


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def names() -> tuple[str, ...]:
    """Names of all data sets: installed ones first, then measured ones as "set/record"."""
    return tuple(ENTRIES)


def describe(name: str) -> str:
    """Content, origin, license and checksum of a data set, as text.

    Raises:
        DataError: no such data set.
    """
    entry = _entry(name)
    if isinstance(entry, Bundled):
        return f"{name}: {entry.about} (simulated, installed with hystfit as {entry.file})"
    source = entry.source
    lines = [f"{name}: {entry.about or source.about}"]
    if entry.about:
        lines.append(f"  measured  {source.about}")
    lines += [f"  from      {source.repository} at {source.revision}", f"  license   {source.license}"]
    lines.append(f"  cite      {source.citation}")
    for file in entry.files:
        address = next(iter(file.addresses(source)), f"{file.name} (converted from the repository)")
        lines.append(f"  file      {address}")
        lines.append(f"  sha256    {file.sha256}")
    return "\n".join(lines)


def load(name: str, *, folder: str | os.PathLike[str] | None = None, download: bool = True) -> Record | Dataset:
    """A data set by name.

    A measured set is searched in `folder`, then in the folder named by the environment variable HYSTFIT_DATA (both laid out
    as set/file), then in the user's cache, to which it is downloaded.

    Args:
        name: one of `names()`.
        folder: searched first, and for installed records alone.
        download: whether missing files may be downloaded.

    Raises:
        DataError: unknown name, a file that is missing or cannot be downloaded, or a wrong checksum.
    """
    entry = _entry(name)
    if isinstance(entry, Bundled):
        return _load_bundled(name, entry, None if folder is None else Path(folder))
    paths = tuple(_find(name, entry.source, file, folder, download) for file in entry.files)
    data = entry.read(paths)
    digest = entry.files[0].sha256 if len(entry.files) == 1 else None
    return _label(data, name, entry, digest)


def _entry(name: str) -> Bundled | Measured:
    if name not in ENTRIES:
        raise DataError(f"no data set {name!r}{near(name, names())}; there are {', '.join(names())}")
    return ENTRIES[name]


def _label(data: Record | Dataset, name: str, entry: Measured, digest: str | None) -> Record | Dataset:
    origin = {"source": f"{entry.source.repository}@{entry.source.revision}", "sha256": digest}
    if isinstance(data, Record):
        return data.replace(name=name, **origin)
    return Dataset(tuple(record.replace(**origin) for record in data), name=name)


def _load_bundled(name: str, entry: Bundled, folder: Path | None) -> Record:
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
        "reinstall hystfit, or run data/make.py in a checkout"
    )


def _check_bundled(place: Path, file: str) -> None:
    """Refuse a bundled file that differs from the checksum beside it."""
    table = place / "checksums.json"
    expected = json.loads(table.read_text()).get(file) if table.is_file() else None
    if expected is not None and sha256_of(place / file) != expected:
        raise DataError(f"{place / file} differs from its SHA-256 {expected} in {table.name}: reinstall hystfit")


def _find(name: str, source: Source, file: DataFile, folder: str | os.PathLike[str] | None, download: bool) -> Path:
    """The file on this machine, its checksum verified."""
    given = [Path(folder)] if folder is not None else []
    if os.environ.get(FOLDER_VARIABLE):
        given.append(Path(os.environ[FOLDER_VARIABLE]))
    for place in given:
        path = place / source.folder / file.name
        if path.is_file():
            actual = sha256_of(path)
            if actual != file.sha256:
                raise DataError(
                    f"{path} is not the published file of {name!r}: its SHA-256 is {actual}, expected {file.sha256}; "
                    "delete it to download it again"
                )
            return path
    addresses = file.addresses(source)
    where = f"no {source.folder}/{file.name} in {[str(place) for place in given]}" if given else "no local folder given"
    if not addresses:
        raise DataError(
            f"{name!r} cannot be downloaded file by file: get it from the repository {source.repository} at "
            f"{source.revision}, convert it to {source.folder}/{file.name} and name the folder in {FOLDER_VARIABLE} ({where})"
        )
    if not download:
        raise DataError(f"{name!r} is not on this machine ({where}); it is at {addresses[0]}")
    return _download(name, source, file, addresses)


def _download(name: str, source: Source, file: DataFile, addresses: list[str]) -> Path:
    import pooch

    target = Path(pooch.os_cache("hystfit")) / source.folder
    kept = target / file.name
    if kept.is_file() and sha256_of(kept) != file.sha256:
        raise DataError(f"{kept} has a wrong SHA-256 (expected {file.sha256}): delete it to download it again")
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
