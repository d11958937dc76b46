"""Tables of numbers as text, HTML and JSON: the one place where a verb's table is formatted."""

from __future__ import annotations

import csv
import dataclasses
import html
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

_WRITTEN_OUT = 1e6  # numbers from here on have an exponent


def number(value: float | None, form: str = ".4g") -> str:
    """A number as text, without exponent from 1 to 1e6, with a space before "%"; "-" where it is unknown."""
    if value is None or not math.isfinite(value):
        return "-"
    text = format(value, form)
    if "e+" in text and abs(value) < _WRITTEN_OUT and form.endswith("g"):
        text = f"{float(text):.0f}"
    return text.replace("%", " %")


ROUNDING = 1e-9  # relative difference below which the digits of a value are those of rounding errors


def rounded(value: float, stderr: float | None) -> tuple[str, str]:
    """A value and its standard error as text: two digits of the error, the value to the same decimal; "-" where unknown.

    A number below the smallest that floats hold to full precision is 0, which a bound without an exact zero comes to.
    """
    value = 0.0 if abs(value) < sys.float_info.min else value
    if stderr is None or not math.isfinite(stderr) or stderr <= 0:
        return f"{value:.5g}", "-"
    if stderr < ROUNDING * abs(value):
        return f"{value:.9g}", f"{stderr:.2g}"
    exponent = math.floor(math.log10(max(abs(value), stderr)))
    scale = 0 if -4 <= exponent < 6 else exponent
    decimals = min(15, 1 - math.floor(math.log10(stderr)) + scale)
    tail = f"e{scale:+03d}" if scale else ""
    if decimals < 0:
        return f"{round(value, decimals):z.0f}", f"{round(stderr, decimals):.0f}"
    return f"{value / 10**scale:z.{decimals}f}{tail}", f"{stderr / 10**scale:.{decimals}f}{tail}"


def with_error(value: float, stderr: float | None, unit: str = "") -> str:
    """A value with its standard error, where it is known, and unit: "1.23 +- 0.04 mm"."""
    return f"{' +- '.join(text for text in rounded(value, stderr) if text != '-')} {unit}".rstrip()


_LONG = 28  # characters of a text from which it may take several lines
_CLASS = {True: ' class="long"', False: ' class="number"'}


@dataclasses.dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        head: heading, with the unit.
        key: name in JSON; the heading by default.
        form: format of numbers, such as ".3g".
        left: whether cells are flush left; numbers are flush right.
    """

    head: str
    key: str = ""
    form: str = ".4g"
    left: bool = False

    @property
    def name(self) -> str:
        """Name in JSON."""
        return self.key or self.head


class Table:
    """Rows of cells below headings; a cell is text, a number, or None where a value is unknown.

    Args:
        columns: headings, or `Column`s. The first column is flush left.
        rows: each as long as `columns`.
    """

    def __init__(self, columns: Sequence[Column | str], rows: Sequence[Sequence[Any]]):
        made = [column if isinstance(column, Column) else Column(column) for column in columns]
        self.columns = [dataclasses.replace(column, left=column.left or k == 0) for k, column in enumerate(made)]
        self.rows = [list(row) for row in rows]
        if any(len(row) != len(made) for row in self.rows):
            raise ValueError("every row needs one cell for each column")

    def cells(self) -> list[list[str]]:
        """All cells as text, without the headings."""
        return [[_cell(value, column) for value, column in zip(row, self.columns, strict=True)] for row in self.rows]

    def text(self, indent: str = "") -> str:
        """Aligned columns of plain text."""
        return "\n".join(self.lines(indent))

    def lines(self, indent: str = "", width: int | None = None) -> list[str]:
        """`text`, line by line.

        Args:
            width: columns of a line: what does not fit follows below, beside the first column again; None: without limit.
        """
        heads = [column.head for column in self.columns]
        rows = [heads, *self.cells()] if any(heads) else self.cells()
        widths = [max((len(row[k]) for row in rows), default=0) for k in range(len(self.columns))]
        pad = [str.ljust if column.left else str.rjust for column in self.columns]
        lines = []
        for part in _parts(widths, None if width is None else width - len(indent)):
            lines += [""] if lines else []
            lines += [(indent + "  ".join(pad[k](row[k], widths[k]) for k in part)).rstrip() for row in rows]
        return lines

    def html(self, links: Mapping[str, str] | None = None) -> str:
        """An HTML table; numbers are flush right by the class "number", and "long" cells may take several lines.

        Each cell names its column, for narrow screens on which a row becomes a list. Cells of the first column whose text is in `links`
        lead to that address.
        """
        shown = lambda k, text: (
            f'<a href="{links[text]}">{html.escape(text)}</a>'
            if links and k == 0 and text in links
            else html.escape(text)
        )
        mark = lambda column, text="": "" if column.left and len(text) < _LONG else _CLASS[column.left]
        head = "".join(f"<th{mark(column)}>{html.escape(column.head)}</th>" for column in self.columns)
        body = "".join(
            "<tr>"
            + "".join(
                f'<td{mark(c, text)} data-head="{html.escape(c.head)}">{shown(k, text)}</td>'
                for k, (c, text) in enumerate(zip(self.columns, row, strict=True))
            )
            + "</tr>\n"
            for row in self.cells()
        )
        return f"<table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}</tbody>\n</table>"

    def to_list(self) -> list[dict[str, Any]]:
        """Rows for JSON: numbers in full, unknown values null."""
        plain = lambda value: value if isinstance(value, (str, bool, int)) else or_none(value)
        return [{c.name: plain(value) for c, value in zip(self.columns, row, strict=True)} for row in self.rows]


def _parts(widths: Sequence[int], width: int | None) -> list[list[int]]:
    """Columns that stand beside each other within a width: the first one, and as many others as fit, at least one."""
    parts, last = [[0]], widths[0]
    for k in range(1, len(widths)):
        if width is not None and len(parts[-1]) > 1 and last + 2 + widths[k] > width:
            parts.append([0])
            last = widths[0]
        parts[-1].append(k)
        last += 2 + widths[k]
    return parts


def _cell(value: Any, column: Column) -> str:
    if value is None or isinstance(value, str):
        return "-" if value is None else value
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, (int, float)) and not hasattr(value, "__float__"):
        return str(value)
    return str(value) if isinstance(value, int) else number(float(value), column.form)


def or_none(value: Any) -> float | None:
    """A number for JSON, which has no NaN and no infinity: None where it is not finite, or None itself."""
    return None if value is None or not math.isfinite(value) else float(value)


def write_csv(path: Path, columns: Mapping[str, Iterable[Any]], form: str = "") -> None:
    """Columns of text and numbers, in a form such as ".10g", by heading as a CSV file; a missing value is an empty cell."""
    write_rows(path, columns, zip(*columns.values(), strict=True), form)


def write_rows(path: Path, heads: Iterable[str], rows: Iterable[Iterable[Any]], form: str = "") -> None:
    """Rows below their headings as a CSV file, see `write_csv`."""

    def cell(value: Any) -> str:
        if value is None or isinstance(value, str):
            return value or ""
        if isinstance(value, int):
            return str(value)
        return "" if math.isnan(value) else format(value, form) if form else repr(float(value))

    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(heads)
        writer.writerows([cell(value) for value in row] for row in rows)
