"""Signals one after the other, each as many numbers to a line as fit on it: the columns of a line mean nothing.

A table has the same look. What tells them apart is the number of samples that the lines above state, as "NPTS= 404" does: it is that of
all numbers of the block and not of its lines.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

from hystfit.outcome import Code, Note
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.limits import FEW
from hystfit.reading.names.column_names import column_quantity
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.plain_text import plain_text
from hystfit.reading.text.stated_interval import stated_interval

_NUMBERS = re.compile(r"(?:\s*[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eEdD][+-]?\d+)?(?=\s|$))++\s*")
_WHOLE = re.compile(r"(?<![\d.])(?<!\d[/:-])\d+(?![\d.]|[/:-]\d)")  # no part of a date or a time
_LONGEST = 9  # digits of a number of samples


@dataclasses.dataclass(frozen=True)
class _Block:
    """A signal: the lines above its numbers, and these."""

    above: list[str]
    cells: list[str]

    @property
    def title(self) -> str:
        """The line above that names a quantity, else the last one with words that does not state the number of samples."""
        lines = [line.strip(" \t#%*") for line in self.above if re.search(r"[^\W\d]", line)]
        lines = [line for line in lines if str(len(self.cells)) not in _WHOLE.findall(line)]
        kinds = {line: column_quantity(line, split_unit(line)[1]) for line in lines[::-1]}
        lines = sorted(
            (line for line, kind in kinds.items() if kind not in ("index", "time")), key=lambda line: kinds[line] == ""
        )
        return next(iter(lines), "")


def read_wrapped_blocks(text: TextFile) -> Table | None:
    """Signals one after the other, each of as many numbers as the lines above it state, with several in a line; None for other text."""
    if not _ends_as_stated(text) or (blocks := _blocks(text.lines)) is None:
        return None
    if len({len(block.cells) for block in blocks}) > 1:
        return None
    titles = [block.title or f"signal {k}" for k, block in enumerate(blocks, start=1)]
    rows = ["\t".join(cells) for cells in zip(*(block.cells for block in blocks), strict=True)]
    table = plain_text(text.of("\n".join(["\t".join(titles), *rows])))
    words = f"{len(blocks)} signals of {len(rows)} samples, each in lines of several"
    interval = stated_interval([part for block in blocks for line in block.above for part in line.split(",")])
    return dataclasses.replace(table, interval=interval).noted(Note(Code.FILE_FORMAT, words))


def _ends_as_stated(text: TextFile) -> bool:
    """Whether the first block of numbers ends where the number of samples in the lines above it says; nothing else is looked at."""
    first = next((k for k, line in enumerate(text.head) if _NUMBERS.fullmatch(line)), len(text.head))
    begins = [
        k for k in (first, first + 1) if 0 < k < len(text.lines)
    ]  # the number of samples may be in a line of numbers
    stated = {k: {int(n) for line in text.head[:k] for n in _WHOLE.findall(line) if len(n) < _LONGEST} for k in begins}
    for k in begins:
        width = len(text.lines[k].split())
        for end in {k - (-n // width) for n in stated[k] if n > FEW * width} if width >= FEW else ():
            block = text.lines[end - 1 : end + 1]
            if block and _NUMBERS.fullmatch(block[0]) and not any(map(_NUMBERS.fullmatch, block[1:])):
                return True
    return False


def may_state_samples(row: str) -> bool:
    """Whether a row of numbers may be a line that states how many samples follow it."""
    return any(int(n) > FEW * len(row.split()) for n in _WHOLE.findall(row) if len(n) < _LONGEST)


def _blocks(lines: Sequence[str]) -> list[_Block] | None:
    """The signals of a text; None where a block of numbers is none."""
    blocks: list[_Block] = []
    above: list[str] = []
    rows: list[list[str]] = []
    for line in [*lines, "end"]:
        if _NUMBERS.fullmatch(line):
            rows.append(line.split())
            continue
        if rows and (line.strip() or len(rows) >= FEW):
            if (
                above and len(rows) > 1 and len(rows[0]) < min(FEW, len(rows[1]))
            ):  # the number of samples and their interval
                above, rows = [*above, " ".join(rows[0])], rows[1:]
            cells = [cell for row in rows for cell in row]
            widths = [len(row) for row in rows]
            even = len({*widths[:-1]}) == 1 and widths[-1] <= widths[0] and widths[0] >= FEW
            stated = str(len(cells)) in _WHOLE.findall(" ".join(above))
            if len(rows) < FEW or not even or not stated:
                return None
            blocks.append(_Block(above, cells))
            above, rows = [], []
        above.append(line)
    return blocks or None
