"""Tables as loggers and mail programs leave them: units in cells, remarks between rows, archives, few samples beside each other."""

from __future__ import annotations

import io
import re
import zipfile

import numpy as np
import openpyxl
import xlwt

from .documents import measured
from .drawing import Draw
from .physics import major_loop, saturating
from .registry import kind
from .truth import Layout, Records, loops
from .writing import Column, Dialect, loop, packed, rows, spelled, table, titles


@kind("units in every cell")
def unit_cells(draw: Draw) -> Layout:
    t, u, y = measured(draw, draw.whole(60, 400))
    columns = [c for c in ([t, u, y] if draw.chance(0.5) else [u, y]) if c.unit]
    dialect = Dialect(*draw.pick((",", "."), (";", ","), (";", "."), ("\t", "."), ("\t", ",")), style="none")
    blank = draw.pick(" ", "")
    names, *numbers = titles(columns, dialect) + rows(columns, dialect)
    mark = dialect.delimiter
    with_units = [
        mark.join(f"{cell}{blank}{c.unit}" for cell, c in zip(line.split(mark), columns, strict=True))
        for line in numbers
    ]
    above = draw.pick([], ["Logger 3", "Operator: abc"])
    lines = [*above, names, *with_units]
    return Layout("", {draw.pick("log.csv", "log.txt"): packed(draw, lines)}, loops(loop(u, y)))


@kind("remarks between rows")
def remarks(draw: Draw) -> Layout:
    t, u, y = measured(draw, draw.whole(100, 600))
    mark = draw.pick(",", ";", "\t")
    lines = table(draw, [t, u, y], Dialect(mark, style=draw.pick("parentheses", "brackets")))
    lead = draw.pick("# ", "% ", "// ", "")
    words = ["pause", "operator pause", "resumed at noon", "resumed at 12:30", "level changed by hand", "range x10"]
    for place in sorted(draw.rng.choice(np.arange(10, len(lines)), draw.whole(1, 4), replace=False))[::-1]:
        lines.insert(int(place), lead + draw.pick(*words))
    return Layout("", {"loop.csv": packed(draw, lines)}, loops(loop(u, y, t)))


@kind("archive of one file")
def archive(draw: Draw) -> Layout:
    t, u, y = measured(draw, draw.whole(100, 400))
    content = packed(
        draw,
        table(draw, [t, u, y], Dialect(draw.pick(",", ";", "\t"), style=draw.pick("parentheses", "brackets", "row"))),
    )
    stream = io.BytesIO()
    beside = draw.pick(
        [], [("__MACOSX/._loop.csv", b"\0\1\2")], [("readme.txt", b"a loop")], [("setup.png", b"\x89PNG")]
    )
    with zipfile.ZipFile(stream, "w", draw.pick(zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)) as file:
        for name, one in draw.shuffled([(draw.pick("loop.csv", "data/loop.txt"), content), *beside]):
            file.writestr(name, one)
    return Layout("", {draw.pick("loop.zip", "run 3.zip"): stream.getvalue()}, loops(loop(u, y, t)))


@kind("few samples beside each other")
def few(draw: Draw) -> Layout:
    n = 2 * draw.whole(6, 12)
    field = draw.size(100, 5000) * major_loop(n)
    h = Column(draw.pick("H", "Field", "Magnetic field"), field, draw.pick("A/m", "Oe"), ".5g")
    b = Column(draw.pick("B", "J"), 1.2 * saturating(draw, field / field.max(), begin=1), "T", ".4f")
    mark = draw.pick(",", ";", "\t")
    dialect = Dialect(mark, style=draw.pick("brackets", "parentheses"))
    columns = spelled(draw, draw.pick([h, b], [b, h]), dialect)
    names = titles(columns, dialect)[0].split(mark)
    lines = [mark.join([name, *column.cells]) for name, column in zip(names, columns, strict=True)]
    return Layout("", {draw.pick("loop.csv", "sheet.txt"): packed(draw, lines)}, loops(loop(h, b)))


def _of_sheet(draw: Draw) -> tuple[list[Column], list[list[str]], tuple[Records, ...]]:
    """Columns of a sheet, the rows of cells above them, and what they are."""
    t, u, y = measured(draw, draw.whole(100, 300))
    dialect = Dialect("\t", style=draw.pick("parentheses", "brackets", "row"))
    columns = spelled(draw, [t, u, y], dialect)
    return columns, [line.split("\t") for line in titles(columns, dialect)], loops(loop(u, y, t))


@kind("workbook with a summary")
def workbook(draw: Draw) -> Layout:
    columns, header, truth = _of_sheet(draw)
    book, stream = openpyxl.Workbook(), io.BytesIO()
    page = book.active
    page.title = "Results"
    for row in [["Quantity", "Value", "Error"], *([name, draw.between(0, 9), 0.1] for name in ("Hc", "Mr", "Ms", "k"))]:
        page.append(row)
    page = book.create_sheet("Data") if draw.chance(0.7) else book.create_sheet("Data", 0)
    if draw.chance(0.3):
        page.append(["Loop of the device"])
        page.merge_cells("A1:C1")
    for line in header:
        page.append(line)
    mark = draw.pick("", "", ".", ",")  # numbers as text
    for row in zip(*(column.cells for column in columns), strict=True):
        page.append([cell.replace(".", mark) if mark else float(cell) for cell in row])
    book.save(stream)
    return Layout("", {"loop.xlsx": stream.getvalue()}, truth)


@kind("rows in brackets")
def brackets(draw: Draw) -> Layout:
    _, u, y = measured(draw, draw.whole(60, 400))
    u, y = (Column("", column.values, "", ".6e") for column in (u, y))
    pairs = list(zip(u.cells, y.cells, strict=True))
    form = draw.pick("python", "numpy", "mathematica")
    if form == "python":
        text = "\n".join(f"({a}, {b})" for a, b in pairs)
    elif form == "numpy":
        text = "[[" + "]\n [".join(f"{a} {b}" for a, b in pairs) + "]]"
    else:
        inner = draw.pick(", ", ",\n ").join(f"{{{a}, {b}}}" for a, b in pairs)
        text = "{" + re.sub("e([+-])", r"*^\1", inner).replace("^+", "^") + "}"
    return Layout("", {"out.txt": text.encode()}, loops(loop(u, y)), either_order=True)


@kind("old Excel")
def old_workbook(draw: Draw) -> Layout:
    columns, header, truth = _of_sheet(draw)
    book, stream = xlwt.Workbook(), io.BytesIO()
    page = book.add_sheet("Data")
    lines = [["Loop of the device"], []] if draw.chance(0.5) else []
    lines += header
    lines += [[float(cell) for cell in row] for row in zip(*(column.cells for column in columns), strict=True)]
    for k, line in enumerate(lines):
        for j, cell in enumerate(line):
            page.write(k, j, cell)
    book.save(stream)
    return Layout("", {draw.pick("loop.xls", "export.XLS"): stream.getvalue()}, truth)
