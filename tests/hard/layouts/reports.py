"""Tables as people put them into notes and spreadsheets: drawn with rules, or a row for each quantity."""

from __future__ import annotations

from .documents import measured
from .drawing import Draw
from .registry import kind
from .truth import Layout, loops
from .writing import Dialect, loop, packed, rows, titles


@kind("table drawn with rules")
def drawn(draw: Draw) -> Layout:
    t, u, y = measured(draw, draw.whole(100, 400))
    columns = [*([t] if draw.chance(0.5) else []), u, y]
    dialect = Dialect("\t", style=draw.pick("brackets", "parentheses"))
    header, *table = [line.split("\t") for line in [*titles(columns, dialect), *rows(columns, dialect)]]
    style = draw.pick("Markdown", "framed", "simple")
    if style == "simple":
        wide = [max(len(row[k]) for row in [header, *table]) + 2 for k in range(len(header))]
        put = ["".join(cell.ljust(width) for cell, width in zip(row, wide, strict=True)).rstrip() for row in table]
        names = "".join(cell.ljust(width) for cell, width in zip(header, wide, strict=True)).rstrip()
        lines = [names, "  ".join("-" * (width - 2) for width in wide), *put]
    else:
        end = "+" + "+".join("-" * 12 for _ in header) + "+"
        rule = end if style == "framed" else "|" + "|".join(draw.pick(" --- ", " ---: ") for _ in header) + "|"
        put = ["| " + " | ".join(row) + " |" for row in [header, *table]]
        lines = [put[0], rule, *put[1:]]
        lines = [end, *lines, end] if style == "framed" else lines
    above = draw.pick([], ["# Loop of sample 7", ""], ["Measured on the second rig", ""])
    clock = t if t in columns else None
    return Layout(
        "", {draw.pick("note.md", "loop.rst", "table.txt"): packed(draw, [*above, *lines])}, loops(loop(u, y, clock))
    )


@kind("row for each quantity")
def turned(draw: Draw) -> Layout:
    t, u, y = measured(draw, draw.whole(100, 400))
    columns = [*([t] if draw.chance(0.5) else []), u, y]
    mark = draw.pick(",", ";", "\t")
    dialect = Dialect(mark, style=draw.pick("brackets", "parentheses", "underscore"))
    names, *table = [line.split(mark) for line in [*titles(columns, dialect), *rows(columns, dialect)]]
    lines = [mark.join([name, *cells]) for name, cells in zip(names, zip(*table, strict=True), strict=True)]
    clock = t if t in columns else None
    return Layout("", {draw.pick("turned.csv", "export.txt"): packed(draw, lines)}, loops(loop(u, y, clock)))
