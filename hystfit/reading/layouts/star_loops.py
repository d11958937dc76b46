"""Loops of STAR files, as CIF and the adsorption files AIF are: "loop_", a name in each line, then the rows of a table."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

from hystfit.outcome import Code, Note
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.names.branch_words import FALLING, RISING, words_of
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.plain_text import plain_text

_ITEM = re.compile(r"_(?P<name>\S+)\s+(?P<quote>['\"]?)(?P<value>.*?)(?P=quote)\s*")
_UNIT_OF = {"amount": "loading"}  # names of AIF whose unit stands under another one


@dataclasses.dataclass(frozen=True)
class _Loop:
    """A table: the names of its columns, and its rows."""

    names: list[str] = dataclasses.field(default_factory=list)
    rows: list[str] = dataclasses.field(default_factory=list)

    @property
    def columns(self) -> list[str]:
        """The last word of each name: a branch has its own name in front, as in "_desorp_pressure"."""
        return [name.rpartition("_")[2] for name in self.names]


def read_star(text: TextFile) -> Table | None:
    """Tables of STAR files (CIF, AIF) behind "loop_", those of the same columns below each other; None for other text."""
    if not any(line.strip().lower() == "loop_" for line in text.head):
        return None
    loops, items = _content(text.lines)
    loops = [loop for loop in loops if len(loop.names) > 1 and loop.rows]
    if not loops:
        return None
    longest = max(loops, key=lambda loop: len(loop.rows))
    alike = [loop for loop in loops if loop.columns == longest.columns]
    names = longest.names if len(alike) == 1 else longest.columns
    units = {name.rpartition("units_")[2]: value for name, value in items if "units_" in name}
    found = [units.get(_UNIT_OF.get(column, column), "") for column in longest.columns]
    titles = [f"{name} [{unit}]" if unit else name for name, unit in zip(names, found, strict=True)]
    settings = [f"{name}: {value}" for name, value in items if value]
    blocks = ["\n".join("\t".join(row.split()) for row in loop.rows) for loop in alike]
    between = "\n" if _are_branches(alike) else "\n\n"
    table = plain_text(text.of("\n".join([*settings, "", "\t".join(titles), between.join(blocks)])))
    more = f"; {len(loops) - len(alike)} of other columns are left out" if len(loops) > len(alike) else ""
    return table.noted(Note(Code.FILE_FORMAT, f"{len(alike)} tables of a STAR file (CIF, AIF){more}"))


def _are_branches(loops: Sequence[_Loop]) -> bool:
    """Whether two tables are named as the branches of one loop, wherever they end: a desorption starts below the last point."""
    words = [words_of(" ".join(loop.names)) for loop in loops]
    return len(words) == 2 and any(a & RISING and b & FALLING for a, b in (words, words[::-1]))


def _content(lines: Sequence[str]) -> tuple[list[_Loop], list[tuple[str, str]]]:
    """The tables, and names and values of the items that stand alone."""
    loops: list[_Loop] = []
    items: list[tuple[str, str]] = []
    within = False
    for line in map(str.strip, lines):
        if line.lower() == "loop_":
            within = True
            loops.append(_Loop())
        elif within and line.startswith("_") and not loops[-1].rows:
            loops[-1].names.append(line[1:])
        elif match := _ITEM.fullmatch(line):
            within = False
            items.append((match["name"], match["value"]))
        elif within and line and not line.startswith("#"):
            loops[-1].rows.append(line)
        elif not line and within and loops[-1].rows:
            within = False
    return loops, items
