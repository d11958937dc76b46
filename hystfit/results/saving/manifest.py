"""The manifest of a folder that hystfit opens again: the SHA-256 of every file that opening reads, so that these belong together."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from hystfit.errors import DataError

MANIFEST = "manifest.json"
# Folder of a whole result whose files are being moved in place (see `hystfit.results.saving.folders.writing`).
PENDING = ".hystfit-commit"
_SCHEMA = "hystfit.manifest/1"
_ATTEMPTS, _PAUSE = 4, 0.05  # to read a folder while another process writes it, and seconds between two of them


class Files(NamedTuple):
    """Files of one result as bytes by name, and names of those that differ from what hystfit saved, where edits were allowed."""

    contents: dict[str, bytes]
    edited: tuple[str, ...]


def digest(content: bytes) -> str:
    """SHA-256 in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def seal(folder: Path, names: Sequence[str]) -> None:
    """Write the manifest of a folder whose files that opening reads are complete; the manifest of a folder within stands for its files."""
    files = {name: digest((folder / name).read_bytes()) for name in names}
    (folder / MANIFEST).write_text(json.dumps({"schema": _SCHEMA, "files": files}, indent=1) + "\n", encoding="utf-8")


def read_files(folder: Path, names: Sequence[str], *, allow_edits: bool = False) -> Files:
    """The files of a sealed folder that must be there, each compared with the manifest, as bytes."""
    for attempt in range(_ATTEMPTS):
        places = _places(folder)
        try:
            return _read(places, folder, names, allow_edits)
        except DataError:
            if attempt == _ATTEMPTS - 1 or len(places) == len(_places(folder)) == 1:
                raise
            time.sleep(_PAUSE)  # another process moves the files of a new result in place
    raise AssertionError("the last attempt returns or raises")


def is_sealed(folder: Path) -> bool:
    """Whether a folder has a manifest, in place or about to be."""
    return (folder / MANIFEST).is_file() or len(_places(folder)) > 1


def _places(folder: Path) -> list[Path]:
    """Where the files of a folder are, first choice first: a result that is being moved in place counts as a whole from its start."""
    pending = (folder / PENDING, folder.parent / PENDING / folder.name)
    return [*(place for place in pending if (place / MANIFEST).is_file()), folder]


def _bytes(places: Sequence[Path], name: str) -> bytes:
    for place in places[:-1]:
        try:
            return (place / name).read_bytes()
        except FileNotFoundError:
            continue
    return (places[-1] / name).read_bytes()


def _read(places: Sequence[Path], folder: Path, names: Sequence[str], allow_edits: bool) -> Files:
    try:
        listed = _listed(places, folder)
    except DataError:
        if not allow_edits:
            raise
        listed = {}
    contents, edited = {}, []
    for name in names:
        try:
            contents[name] = _bytes(places, name)
        except OSError as error:
            raise DataError(
                f"{str(folder / name)!r} cannot be read ({error.strerror}): restore it, or fit again"
            ) from error
        if listed.get(name) != digest(contents[name]):
            edited.append(name)
    if edited and not allow_edits:
        raise DataError(
            f"{str(folder / edited[0])!r} is not the file that hystfit saved (its SHA-256 is "
            f"{digest(contents[edited[0]])[:16]}..., the manifest has {str(listed.get(edited[0]))[:16]}...): restore it or fit "
            "again; if you made this change on purpose, open it with trust=True"
        )
    return Files(contents, tuple(edited))


def _listed(places: Sequence[Path], folder: Path) -> dict[str, str]:
    try:
        stored = json.loads(_bytes(places, MANIFEST))
        if stored["schema"] != _SCHEMA:
            raise ValueError(f"schema {stored['schema']!r}")
        return dict(stored["files"])
    except OSError as error:
        raise DataError(
            f"{str(folder / MANIFEST)!r} cannot be read ({error.strerror}): the folder is incomplete; restore it, or fit again"
        ) from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise DataError(f"{str(folder / MANIFEST)!r} is damaged ({error}): restore it, or fit again") from error
