"""The lines of a text. A long table of plain numbers is parsed as a whole, so that most of its lines are never needed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import SupportsIndex, overload

import numpy as np

from hystfit.errors import DataError

_LONGEST = 100_000  # characters of a line


def lines_of(content: str) -> Sequence[str]:
    """The lines of a text without their ends; what follows the last line feed is a line where it is not empty."""
    if content.isascii():
        return _Lines(content)
    lines = content.split("\n")
    return lines if lines[-1] else lines[:-1]


def check_lengths(content: str, source: str) -> None:
    """Refuse lines that no table of numbers has.

    Raises:
        DataError: a line is too long.
    """
    start = 0
    while len(content) - start > _LONGEST:
        end = content.rfind("\n", start, start + _LONGEST + 1)
        if end < 0:
            line, end = 1 + content.count("\n", 0, start), content.find("\n", start)
            length = (len(content) if end < 0 else end) - start
            raise DataError(
                f"{source}, line {line} has {length} characters, and {_LONGEST} are the most: write one sample in a line"
            )
        start = end + 1


class _Lines(Sequence[str]):
    """Lines of a text in ASCII, which are cut out of it when they are asked for."""

    def __init__(self, content: str):
        self._content = content
        ends = np.flatnonzero(np.frombuffer(content.encode("ascii"), np.uint8) == ord("\n"))
        if content and not content.endswith("\n"):
            ends = np.append(ends, len(content))
        self._starts, self._ends = np.append(0, ends + 1)[: ends.size], ends

    def __len__(self) -> int:
        return self._ends.size

    def __iter__(self) -> Iterator[str]:
        lines = self._content.split("\n")
        return iter(lines if len(lines) == len(self) else lines[:-1])

    @overload
    def __getitem__(self, index: SupportsIndex) -> str: ...
    @overload
    def __getitem__(self, index: slice) -> list[str]: ...
    def __getitem__(self, index: SupportsIndex | slice) -> str | list[str]:
        if isinstance(index, slice):
            starts, ends = self._starts[index].tolist(), self._ends[index].tolist()
            return [self._content[start:end] for start, end in zip(starts, ends, strict=True)]
        return self._content[int(self._starts[index]) : int(self._ends[index])]
