"""The bytes of a file: regular files of a sensible size only, unpacked where they are compressed."""

from __future__ import annotations

import bz2
import dataclasses
import hashlib
import lzma
import os
import stat
import zlib
from pathlib import Path
from typing import Any

from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.reading.files import archive

_LARGEST = 4 * 2**30  # bytes of a file
_PACKED = {b"\x1f\x8b": "gzip", b"\xfd7zXZ\x00": "xz", b"BZh": "bzip2"}
_PACKED_SUFFIXES = frozenset({".gz", ".xz", ".bz2", ".lzma", ".zip"})
_LZMA_ALONE = b"\x5d\x00\x00"
_ZARR = ("zarr.json", ".zgroup", ".zarray")  # metadata of formats 3 and 2


@dataclasses.dataclass(frozen=True)
class FileBytes:
    """Content of a file, unpacked; SHA-256 of the file as it is stored; its path; and what was done with it."""

    raw: bytes
    sha256: str
    source: str
    notes: tuple[Note, ...] = ()

    @property
    def suffix(self) -> str:
        """Ending of the name in lower case, without that of a packed file: a hint where the content has no mark."""
        return inner_name(self.source).suffix.lower()


def allowed(size: int) -> int:
    """Number of bytes that the numbers in a file of `size` bytes may take: more is a damaged file, or made to fill the memory."""
    return 64 * 2**20 + 4 * size


def exists(path: str | Path) -> bool:
    """Whether there is a file or folder of this name; False for a name that the system does not accept."""
    try:
        return Path(path).exists()
    except (OSError, ValueError):
        return False


def is_zarr(path: str | Path) -> bool:
    """Whether a folder is a Zarr store."""
    return any((Path(path) / name).is_file() for name in _ZARR)


def no_file(folder: str | Path, remedy: str) -> DataError:
    """The error of a folder where a file is needed.

    Args:
        remedy: for a folder of files.
    """
    if is_zarr(folder):
        remedy = "a Zarr store; fit the array of loops in it by hystfit map, in Python by fit_map"
        return DataError(f"{str(folder)!r} is {remedy}")
    return DataError(f"{str(folder)!r} is a folder; {remedy}")


def inner_name(path: str | Path) -> Path:
    """The name without the suffix of a compressed file: loop.csv.xz holds loop.csv."""
    path = Path(path)
    return path.with_suffix("") if path.suffix.lower() in _PACKED_SUFFIXES else path


def load(path: str | Path) -> FileBytes:
    """The content of a regular file, unpacked where it is gzip, bzip2, xz, or a zip archive of one file.

    A file in an archive of several is named as in a folder: tests.zip/run/a.csv.
    """
    path, inside = archive.split_member(Path(path))
    try:
        status = os.stat(path)
        if stat.S_ISDIR(status.st_mode):
            raise no_file(path, "name one file in it")
        if not stat.S_ISREG(status.st_mode):
            raise DataError(f"{path} is a pipe or a device, and only files are read; save its content in a file first")
        if status.st_size > _LARGEST:
            raise DataError(
                f"{path} has {status.st_size / 2**30:.3g} GiB, and {_LARGEST / 2**30:g} GiB is the most; split it"
            )
        raw = path.read_bytes()
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file; check the name and the folder that you are in") from error
    except DataError:
        raise
    except (OSError, ValueError) as error:
        shown = str(path) if len(str(path)) < 200 else f"{str(path)[:60]}..."
        reason = getattr(error, "strerror", None) or error
        raise DataError(f"{shown} cannot be read: {reason}; check the name") from error
    if not raw:
        raise DataError(f"{path} is empty (0 bytes); nothing was written to it: record or copy it again")
    digest = hashlib.sha256(raw).hexdigest()
    kind = next((kind for magic, kind in _PACKED.items() if raw.startswith(magic)), "")
    if not kind and path.suffix.lower() == ".lzma" and raw.startswith(_LZMA_ALONE):
        kind = "lzma"
    member = archive.member_of(raw, str(path), allowed(len(raw)), inside) if raw.startswith(archive.MAGIC) else None
    path = path / inside
    if not kind and member is None:
        return FileBytes(raw, digest, str(path))
    name, content = member or ("", _unpacked(raw, kind, str(path)))
    note = Note(Code.FILE_FORMAT, f"unpacked from {kind or f'zip, {name!r}'}: {len(content)} bytes")
    return FileBytes(content, digest, str(path), (note,))


def _unpacked(raw: bytes, kind: str, source: str) -> bytes:
    """Content of a compressed file, of one or several streams, at most `allowed` bytes."""
    most, parts, total = allowed(len(raw)), [], 0
    try:
        while raw:
            stream = _stream(kind)
            parts.append(stream.decompress(raw, most - total + 1))
            total += len(parts[-1])
            if total > most:
                raise DataError(
                    f"{source} unpacks to more than {most / 2**20:.0f} MiB, many times its size, and is not read; "
                    "unpack it yourself if it is a measurement"
                )
            if not stream.eof:
                raise DataError(f"{source} ends within its {kind} data: copy it again")
            raw = stream.unused_data.lstrip(b"\x00")
            if raw and kind != "lzma" and not any(raw.startswith(magic) for magic in _PACKED):
                raise DataError(f"{source} has {len(raw)} bytes after its {kind} data: it is damaged, copy it again")
    except (OSError, EOFError, zlib.error, lzma.LZMAError, ValueError, MemoryError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"{source} cannot be unpacked as {kind}: {error}; it is damaged, copy it again") from error
    return b"".join(parts)


def _stream(kind: str) -> Any:
    if kind == "gzip":
        return zlib.decompressobj(wbits=31)
    return bz2.BZ2Decompressor() if kind == "bzip2" else lzma.LZMADecompressor(memlimit=256 * 2**20)
