"""Finished rows in a file to which each is appended as it is known, so that an interrupted batch resumes from them."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from hystfit.batch.row import Row
from hystfit.errors import DataError

Finished = tuple[str, Sequence[Row]]


class Journal:
    """One line for each file or record: its key and its rows. A line that an interruption cut short is ignored.

    Args:
        file: made when the first rows are added.

    Raises:
        DataError: the file cannot be read.
    """

    def __init__(self, file: Path):
        self.file = file
        self.rows: dict[str, tuple[Row, ...]] = {}
        try:
            text = file.read_bytes() if file.exists() else b""
        except OSError as error:
            raise DataError(f"cannot read {str(file)!r}: {error.strerror or error}") from error
        whole = [line for line in text.splitlines(keepends=True) if self._accept(line)]
        if (kept := b"".join(whole)) != text:
            scratch = file.with_name(f".{file.name}")
            scratch.write_bytes(kept)
            scratch.replace(file)

    def _accept(self, line: bytes) -> bool:
        """Take the rows of a line; whether it is whole."""
        if not line.endswith(b"\n"):
            return False
        try:
            content = json.loads(line)
            self.rows[content["key"]] = tuple(Row.of(row) for row in content["rows"])
        except (ValueError, KeyError, TypeError):
            return False
        return True

    def add(self, finished: Sequence[Finished]) -> None:
        """Append the rows of several loops."""
        lines = [json.dumps({"key": key, "rows": [row.to_dict() for row in rows]}) + "\n" for key, rows in finished]
        try:
            with self.file.open("a", encoding="utf-8") as handle:
                handle.write("".join(lines))
                handle.flush()
                os.fsync(handle.fileno())
        except OSError as error:
            raise DataError(f"cannot write {str(self.file)!r}: {error.strerror or error}") from error
        self.rows |= {key: tuple(rows) for key, rows in finished}
