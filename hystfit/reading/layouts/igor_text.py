"""Text files of Igor Pro (.itx): waves in blocks of BEGIN and END, with their names before and their units behind these."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hystfit.outcome import Code, Note
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.plain_text import plain_text

_WAVES = re.compile(r"\s*WAVES\s*(?:/\S+\s+)*(?P<names>\S.*)", re.IGNORECASE)
_NAME = re.compile(r"'([^']+)'|([^\s,]+)")
_UNIT = re.compile(
    r"\s*X\s+SetScale\s*(?:/\w+\s+)?[dy]\s+[^\"]*\"(?P<unit>[^\"]*)\"\s*,\s*(?P<names>\S.*)", re.IGNORECASE
)


def read_igor(text: TextFile) -> Table | None:
    """Waves of Igor Pro (.itx) with the same number of points as columns, with their units; None for other text."""
    if not text.head or text.head[text.first].strip() != "IGOR":
        return None
    blocks, units = _blocks(text.lines)
    if not blocks:
        return None
    size = max((len(rows) for _, rows in blocks), key=lambda size: size)
    alike = [(names, rows) for names, rows in blocks if len(rows) == size]
    names = [name for of_block, _ in alike for name in of_block]
    titles = [f"{name} [{units[name]}]" if units.get(name) else name for name in names]
    rows = [
        "\t".join("\t".join(row.split()) for row in cells) for cells in zip(*(rows for _, rows in alike), strict=True)
    ]
    table = plain_text(text.of("\n".join(["\t".join(titles), *rows])))
    left = sum(len(of_block) for of_block, _ in blocks) - len(names)
    more = f"; {left} waves of another length are left out" if left else ""
    return table.noted(Note(Code.FILE_FORMAT, f"{len(names)} waves of Igor Pro of {size} points{more}"))


def _blocks(lines: Sequence[str]) -> tuple[list[tuple[list[str], list[str]]], dict[str, str]]:
    """Names and rows of every block, and units by the name of the wave."""
    blocks: list[tuple[list[str], list[str]]] = []
    units: dict[str, str] = {}
    names: list[str] = []
    within = False
    for line in lines:
        word = line.strip().upper()
        if word == "BEGIN" and names:
            within = True
            blocks.append((names, []))
        elif word == "END":
            within, names = False, []
        elif within:
            blocks[-1][1].append(line)
        elif match := _WAVES.match(line):
            names = [quoted or plain for quoted, plain in _NAME.findall(match["names"])]
        elif match := _UNIT.match(line):
            units |= dict.fromkeys((quoted or plain for quoted, plain in _NAME.findall(match["names"])), match["unit"])
    return blocks, units
