"""A text file before its layout is known: its content, lines, and the options for reading it."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Sequence

from hystfit.outcome import Note
from hystfit.reading.files.encodings import decode
from hystfit.reading.files.file_bytes import FileBytes
from hystfit.reading.files.lines import lines_of
from hystfit.reading.files.quoted_lines import without_quotes
from hystfit.reading.files.typed_numbers import without_types

HEAD = 200  # lines by which layouts are recognized


@dataclasses.dataclass(frozen=True)
class Opening:
    """Options for opening a file.

    Attributes:
        sheet: of a workbook, by name or number from 0; the first with rows of numbers where None.
        delimiter, decimal, encoding: of a text, detected where None.
    """

    sheet: str | int | None = None
    delimiter: str | None = None
    decimal: str | None = None
    encoding: str | None = None


@dataclasses.dataclass(frozen=True)
class TextFile:
    """The text of a file.

    Attributes:
        content: decoded, with line feeds between lines.
        source: path; sha256: checksum of the file's bytes.
        notes: what was assumed of encoding and packing.
        opening: options of the user.
    """

    content: str
    source: str
    sha256: str | None
    notes: tuple[Note, ...] = ()
    opening: Opening = Opening()

    @functools.cached_property
    def lines(self) -> Sequence[str]:
        """The lines without their ends."""
        return lines_of(self.content)

    @functools.cached_property
    def head(self) -> Sequence[str]:
        """The first lines, by which layouts are recognized."""
        return self.lines[:HEAD]

    @functools.cached_property
    def first(self) -> int:
        """Number of the first line that is not blank; 0 where there is none."""
        return next((k for k, line in enumerate(self.head) if line.strip()), 0)

    def without(self, blanked: Iterable[int]) -> TextFile:
        """The file with some lines blank, so that the others keep their numbers."""
        lines = list(self.lines)
        for k in blanked:
            lines[k] = ""
        return self.of("\n".join(lines))

    def of(self, content: str) -> TextFile:
        """The file with its content arranged in another way."""
        return dataclasses.replace(self, content=content + "\n")


def text_of(file: FileBytes, opening: Opening) -> TextFile:
    """The text in the bytes of a file.

    Raises:
        DataError: the bytes are not text.
    """
    content, notes = decode(file.raw, file.source, opening.encoding)
    content, typed = without_types(content)
    content, quoted = without_quotes(content)
    return TextFile(content, file.source, file.sha256, (*file.notes, *notes, *typed, *quoted), opening)
