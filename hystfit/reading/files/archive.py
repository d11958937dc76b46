"""Zip archives of measured files, as people send them."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from hystfit.errors import DataError
from hystfit.outcome.wrapping import listed

MAGIC = b"PK\x03\x04"
# Members by which an archive is a document of its own: Excel, NumPy, and those that are no measurement.
_WORKBOOK, _ARRAYS = "xl/workbook.xml", ".npy"
_DOCUMENTS = {
    "word/document.xml": "a Word document (export the numbers as CSV)",
    "ppt/presentation.xml": "a presentation (export the numbers as CSV)",
    "xl/workbook.bin": "a binary Excel file (save it as .xlsx)",
    "data.ndc": "a file of a Neware cycler (export it from BTSDA as CSV or Excel)",
    "content.xml": "an OpenDocument text or drawing (save the numbers as a spreadsheet)",
}
_BESIDE = frozenset({".md", ".pdf", ".png", ".jpg", ".jpeg", ".gif", ".tif", ".tiff", ".svg", ".docx", ".pptx"})
_NOTES = ("readme", "license", "licence")  # what names of texts about the data begin with


def member_of(raw: bytes, source: str, most: int, name: str = "") -> tuple[str, bytes] | None:
    """Name and content of the only file in an archive that may be a measurement; None for workbooks, NumPy and damaged archives.

    Args:
        most: bytes that it may have.
        name: of the member, where there are several.

    Raises:
        DataError: there are several of them, or none, or the archive is a document or has a password.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            members = {one.filename: one for one in archive.infolist() if not one.is_dir()}
            if not name and _is_document(archive, source):
                return None
            name = name or _only(measurements(list(members)), source)
            if members[name].file_size > most:
                raise DataError(
                    f"{source} unpacks to more than {most / 2**20:.0f} MiB, many times its size, and is not read; "
                    "unpack it yourself if it is a measurement"
                )
            if members[name].flag_bits & 1:
                raise DataError(f"{source} is a zip archive with a password; unpack it and read {name!r}")
            return name, archive.read(name)
    except DataError:
        raise
    except Exception:  # zipfile raises several kinds on damaged archives; the readers of these files say so
        return None


def members_of(path: Path) -> list[str]:
    """Names of the files in an archive that may be measurements; none for other files and for archives that are one document."""
    try:
        if not path.is_file():  # a pipe would wait for its writer
            return []
        with path.open("rb") as stream:
            if stream.read(2) != b"PK":  # sheets of old Excel may have an archive within
                return []
        with zipfile.ZipFile(path) as archive:
            return [] if _is_document(archive, str(path)) else measurements(archive.namelist())
    except Exception:  # as above, and documents
        return []


def split_member(path: Path) -> tuple[Path, str]:
    """The archive of any ending, and the name of the member in a path such as tests.zip/run/a.csv; "" for a path to a file of its own."""
    parent = next((parent for parent in path.parents if parent.is_file()), None)
    return (path, "") if parent is None else (parent, path.relative_to(parent).as_posix())


def measurements(names: Sequence[str]) -> list[str]:
    """The members that are no folder, picture, document or file of the system."""
    files = [name for name in names if not name.endswith("/")]
    visible = [name for name in files if not any(part.startswith((".", "__")) for part in PurePosixPath(name).parts)]
    data = [name for name in visible if PurePosixPath(name).suffix.lower() not in _BESIDE]
    return [name for name in data if not PurePosixPath(name).name.lower().startswith(_NOTES)] or data


def _is_document(archive: zipfile.ZipFile, source: str) -> bool:
    """Whether an archive is a workbook or NumPy arrays.

    Raises:
        DataError: it is a document of another kind.
    """
    names = archive.namelist()
    if any(name == _WORKBOOK or name.endswith(_ARRAYS) for name in names):
        return True
    if "content.xml" in names and b"spreadsheet" in archive.read("mimetype"):
        return True
    if kind := next((what for name, what in _DOCUMENTS.items() if name in names), ""):
        raise DataError(f"{source} is not text but {kind}")
    return False


def _only(data: Sequence[str], source: str) -> str:
    if len(data) == 1:
        return data[0]
    found = f"{len(data)} files ({listed([*map(repr, data)])})" if data else "no file that may hold a measurement"
    raise DataError(f"{source} is a zip archive with {found}; unpack it and name the files to read")
