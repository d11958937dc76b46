r"""Curves in the source of a LaTeX picture: `\addplot table {...}` and `\addplot coordinates {...}` of PGFPlots."""

from __future__ import annotations

import re

from hystfit.outcome import Code, Note
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.table.raw_table import Part, Table, below_each_other
from hystfit.reading.text.plain_text import plain_text

_PLOT = re.compile(
    r"\\addplot3?\+?\s*(?:\[[^\]]*\])?\s*(?P<kind>table|coordinates)\s*(?:\[[^\]]*\])?\s*\{(?P<body>[^{}]*)\}"
    r"\s*;?\s*(?:\\addlegendentry\{(?P<title>[^{}]*)\})?"
)
_LABEL = re.compile(r"\b(?P<axis>[xy])label\s*=\s*(?:\{(?P<braced>(?:[^{}]|\{[^{}]*\})*)\}|(?P<bare>[^,\]\n]+))")
_POINT = re.compile(r"\(\s*([^,()\s]+)\s*,\s*([^,()\s]+)\s*\)")


def read_pgfplots(text: TextFile) -> Table | None:
    r"""The curves behind `\addplot`, a record each, with the labels of the axes as names; None for text without them."""
    plots = [*_PLOT.finditer(text.content)]
    if not plots:
        return None
    labels = {one["axis"]: _plain(one["braced"] or one["bare"]) for one in _LABEL.finditer(text.content)}
    tables = [plain_text(text.of(_rows(plot, labels))) for plot in plots]
    note = Note(Code.FILE_FORMAT, f"{len(plots)} curve{'s' * (len(plots) > 1)} of a LaTeX picture")
    titles = [_plain(plot["title"] or "") or f"curve {k}" for k, plot in enumerate(plots)]
    alike = len({table.names for table in tables}) == 1
    whole = below_each_other(tables, [*map(Part, titles)]) if alike and len(tables) > 1 else tables[0]
    return whole.noted(note)


def _rows(plot: re.Match[str], labels: dict[str, str]) -> str:
    """The lines of a table of a curve, under the labels of both axes where it has no names of its own."""
    body = plot["body"].replace("\\\\", "\n")
    if plot["kind"] == "coordinates":
        body = "\n".join(f"{x}\t{y}" for x, y in _POINT.findall(body))
    first = next((line for line in body.splitlines() if line.strip()), "")
    named = re.match(r"\s*[A-Za-z]", first) or len(labels) < 2 or len(first.split()) != len(labels)
    return body if named else "\n".join(["\t".join(labels[axis] for axis in "xy"), *_tabbed(body)])


def _tabbed(body: str) -> list[str]:
    return ["\t".join(line.split()) for line in body.splitlines()]


def _plain(label: str) -> str:
    """A label without the marks of mathematics: H [A/m] of $H$ [A/m]."""
    return re.sub(r"\\(?:mathrm|text|si|unit)\b|[${}]|\\,", "", label).strip()
