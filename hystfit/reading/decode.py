"""Bytes of a file and their text: what can be read, and in which encoding."""

from __future__ import annotations

import re
from pathlib import Path

from hystfit.errors import DataError

_MAGIC = {
    b"PK\x03\x04": "a zip archive or Excel file (name it .xlsx)",
    b"\x89HDF": "an HDF5 file (name it .h5, or .mat if MATLAB wrote it)",
    b"\xd0\xcf\x11\xe0": "an old Excel file (save it as .xlsx)",
    b"MATLAB": "a MATLAB file (name it .mat)",
    b"\x93NUMPY": "a numpy file (name it .npy)",
    b"\x1f\x8b": "a gzip archive (unpack it)",
    b"TDSm": "a TDMS file (export it as CSV)",
    b"%PDF": "a PDF document",
    b"\x89PNG": "a picture",
    b"PAR1": "a parquet file (export it as CSV)",
}


def load(path: str | Path) -> bytes:
    """The bytes of a file.

    Raises:
        DataError: it is missing, a folder, empty or may not be read.
    """
    path = Path(path)
    if path.is_dir():
        raise DataError(f"{path} is a folder; name one file in it")
    try:
        raw = path.read_bytes()
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file; check the name and the folder that you are in") from error
    except (OSError, ValueError) as error:
        raise DataError(f"{path} cannot be read: {error}") from error
    if not raw:
        raise DataError(f"{path} is empty (0 bytes); nothing was written to it: record or copy it again")
    return raw


def decode(raw: bytes, source: str, encoding: str | None) -> tuple[str, list[str]]:
    """Text of a file and what was assumed: byte-order mark, UTF-8, UTF-16 without a mark, then cp1252 and latin-1.

    Raises:
        DataError: the bytes are not text, or not in the encoding that was given.
    """
    for magic, what in _MAGIC.items():
        if raw.startswith(magic):
            raise DataError(f"{source} is not text but {what}")
    notes: list[str] = []
    if encoding is None:
        encoding = _encoding(raw)
        if encoding not in ("utf-8", "utf-8-sig"):
            notes.append(f"read as {encoding}")
    try:
        text = raw.decode(encoding).removeprefix("\ufeff")
    except LookupError as error:
        raise DataError(f"{source}: there is no encoding {encoding!r}; use utf-8, utf-16 or cp1252") from error
    except UnicodeError as error:
        raise DataError(
            f"{source} is not text in {encoding}: {error}; leave the encoding out or give another"
        ) from error
    if padded := len(text) - len(text.rstrip("\x00")):
        text = text.rstrip("\x00")
        notes.append(f"{padded} NUL bytes at the end left out")
    odd = len(re.findall(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]", text))
    if "\x00" in text or odd > max(2, 0.01 * len(text)):
        place = re.search(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]", text)
        line = 1 + text.count("\n", 0, place.start() if place else 0)
        raise DataError(
            f"{source}, line {line}: {odd} NUL or control bytes; this is a binary or damaged file: export it as text, "
            "or name it by its format (.mat, .npz, .xlsx, .h5)"
        )
    return text.replace("\r\r\n", "\n").replace("\r\n", "\n").replace("\r", "\n"), notes


def _encoding(raw: bytes) -> str:
    for mark, name in ((b"\xff\xfe\x00\x00", "utf-32"), (b"\x00\x00\xfe\xff", "utf-32")):
        if raw.startswith(mark):
            return name
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    head = raw[:2000]
    for name, start in (("utf-16-le", 1), ("utf-16-be", 0)):  # ASCII in UTF-16: every other byte is NUL
        if len(head) > 3 and head[start::2].count(0) > 0.7 * len(head[start::2]) and head[1 - start :: 2].count(0) == 0:
            return name
    for name in ("utf-8-sig", "cp1252"):
        try:
            raw.decode(name)
        except UnicodeDecodeError:
            continue
        return "utf-8" if name == "utf-8-sig" and not raw.startswith(b"\xef\xbb\xbf") else name
    return "latin-1"
