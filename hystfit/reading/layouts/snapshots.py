"""Logs of simulations, a block for each time: lines of settings (Time = 0.1, Data = ux;Rx), then a row for each node or element."""

from __future__ import annotations

import collections
import re
from collections.abc import Iterator

from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.limits import FEWEST
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.plain_text import plain_text

_SETTING = re.compile(r"\s*+(?:\*\s*+)?(Time|Data)\s*=\s*(\S.*?)\s*", re.IGNORECASE)
# The line above the rows of nodes or elements: "displacements (vx,vy,vz) for set TOP and time 0.1".
_CAPTION = re.compile(r"[ \t]*(?P<kind>[a-z][a-z ]*) \((?P<words>[\w ,.]+)\).*\btime +(?P<time>[\d.eE+-]+)[ \t]*")
_ITEMS = ("elem", "integ.pnt.")
_BEGIN = re.compile(rf"^[ \t]*+(?:\*[ \t]*+)?data[ \t]*=|^{_CAPTION.pattern}$", re.IGNORECASE | re.MULTILINE)
_ROW = re.compile(r"\s*\d+(?:[\s,;]+[+-]?[\d.][\d.eE+-]*)+\s*")
# What the letters of finite-element programs stand for beside each other: displacements and reactions along the axes.
_MEANINGS = {"u": "displacement", "R": "reaction force"}


def read_snapshots(text: TextFile) -> Table | None:
    """Logs of finite-element programs, a block for each time with a row for each node or element; None for other text."""
    if _BEGIN.search(text.content) is None:
        return None
    values: dict[str, dict[str, str]] = collections.defaultdict(dict)
    for time, name, value in _values(text):
        values[name][time] = value
    times = [*dict.fromkeys(time for column in values.values() for time in column)]
    whole = [name for name, column in values.items() if len(column) == len(times)]
    if len(times) < FEWEST or not whole:
        return None
    count = collections.Counter(map(_title_of, whole))
    titles = [name if count[_title_of(name)] > 1 else _title_of(name) for name in whole]
    rows = [["time", *titles]]
    rows += [[time, *(values[name][time] for name in whole)] for time in times]
    table = plain_text(text.of("\n".join("\t".join(row) for row in rows)))
    table = table.noted(
        Note(Code.FILE_FORMAT, f"{len(times)} blocks, one for each time, with {len(whole)} values each")
    )
    if max(count.values()) > 1:
        table = table.noted(
            warn(Code.FILE_FORMAT, "each node or element has a column: a force on several nodes is the sum of theirs")
        )
    if len(values) > len(whole):
        table = table.noted(
            warn(Code.LEFT_OUT, f"left out: {len(values) - len(whole)} values that not every block has")
        )
    return table


def _title_of(name: str) -> str:
    """The name of a value without that of its node or element."""
    return name.partition(" of ")[0]


def _values(text: TextFile) -> Iterator[tuple[str, str, str]]:
    """Time, name with its item ("x displacement of 5") and number of every value."""
    time, titles = "", []
    for line in text.lines:
        if caption := _CAPTION.fullmatch(line):
            time, kind = caption["time"], re.sub(r"(?<=ss)es$|s$", "", caption["kind"])
            titles = [f"{word.strip()} {kind}" for word in caption["words"].split(",") if word.strip() not in _ITEMS]
        elif setting := _SETTING.fullmatch(line):
            if setting[1].lower() == "time":
                time = setting[2]
            else:
                titles = [_title(word.strip()) for word in setting[2].split(";")]
        elif titles and _ROW.fullmatch(line):
            cells = re.split(r"[\s,;]+", line.strip())
            item = " ".join(cells[: -len(titles)])
            if item:
                yield from (
                    (time, f"{title} of {item}", cell)
                    for title, cell in zip(titles, cells[-len(titles) :], strict=True)
                )
        elif line.strip():
            titles = titles if "=" in line else []


def _title(word: str) -> str:
    """The name of a value: ux is a displacement along x, Rx a reaction force."""
    match = re.fullmatch(r"([uR])([xyz])", word)
    return f"{match[2]} {_MEANINGS[match[1]]}" if match else word
