"""What programs write: logs of names and numbers, arrays in source text, HTML and XML, structures of MATLAB, ARFF."""

from __future__ import annotations

import io
import json

import numpy as np
import scipy.io

from .drawing import Draw
from .physics import growing, lagging, rubbing, wave
from .registry import kind
from .truth import Layout, loops
from .writing import Column, loop, packed


def _columns(draw: Draw) -> tuple[Column, Column, Column]:
    """Time, input and output of an actuator or a specimen."""
    cycles = draw.whole(2, 5)
    n = cycles * draw.whole(40, 120)
    clock = Column(draw.pick("t", "time"), np.arange(n) * draw.pick(0.001, 0.01, 0.05), "s", ".3f")
    if draw.chance(0.5):
        u = (1 + wave(draw, n, cycles)) / 2
        names = draw.pick(("voltage", "position"), ("V_cmd", "disp"), ("Voltage", "Displacement"))
        pair = (150 * u, "V", ".4f", 12 * draw.noise(lagging(draw, u), 1e-3), "um", ".5f")
    else:
        x = growing(n, cycles)
        names = draw.pick(("disp", "force"), ("Displacement", "Load"))
        pair = (20 * x, "mm", ".4f", 80 * draw.noise(rubbing(draw, x), 2e-3), "kN", ".4f")
    return clock, Column(names[0], pair[0], pair[1], pair[2]), Column(names[1], pair[3], pair[4], pair[5])


def _bare(*columns: Column) -> list[Column]:
    """The columns without units."""
    return [Column(c.name, c.values, "", c.form) for c in columns]


@kind("log of names and numbers")
def key_values(draw: Draw) -> Layout:
    t, u, y = _columns(draw)
    units = draw.chance(0.5)
    t, u, y = (t, u, y) if units else _bare(t, u, y)
    mark, between = draw.pick(("=", " "), (": ", ", "), ("=", ", "), (":", "\t"), (" = ", "; "))
    columns = draw.pick([t, u, y], [t, y, u])
    cells = [[f"{c.name}{mark}{cell}{c.unit if units else ''}" for c, cell in zip(columns, row, strict=True)]
             for row in zip(*(c.cells for c in columns), strict=True)]  # fmt: skip
    if draw.chance(0.2):
        lines = [cell for row in cells for cell in row]
    else:
        lead = draw.pick("", "", "INFO loop: ", "[data] ")
        lines = [lead + between.join(row) for row in cells]
    return Layout("", {draw.pick("run.log", "serial.txt", "out"): packed(draw, lines)}, loops(loop(u, y, t)))


@kind("arrays in a program")
def arrays(draw: Draw) -> Layout:
    _, u, y = _bare(*_columns(draw))
    form = draw.pick("matlab", "matlab rows", "python", "c", "r", "yaml")
    if form == "yaml":
        text = "".join(f"{c.name}:\n" + "".join(f"  - {cell}\n" for cell in c.cells) for c in (u, y))
    elif form == "matlab rows":
        text = "".join(f"{c.name} = [\n" + "".join(f"{cell};\n" for cell in c.cells) + "];\n" for c in (u, y))
    else:
        begin, between, end = {
            "matlab": ("{} = [", " ", "];"),
            "python": ("{} = np.array([", ", ", "])"),
            "c": ("double {}[] = {{", ", ", "}};"),
            "r": ("{} <- c(", ", ", ")"),
        }[form]
        wrap = lambda cells: between.join(
            f"\n{cell}" if k % 10 == 0 and form != "matlab" else cell for k, cell in enumerate(cells)
        )
        text = "".join(begin.format(c.name) + wrap(c.cells) + end.replace("}}", "}") + "\n" for c in (u, y))
    return Layout("", {draw.pick("data.txt", "loop.m", "loop.py"): packed(draw, text.splitlines())}, loops(loop(u, y)))


@kind("table in HTML")
def html(draw: Draw) -> Layout:
    t, u, y = _columns(draw)
    cell = lambda tag, text: f"<{tag}>{text}</{tag}>"
    row = lambda tag, texts: cell("tr", "".join(cell(tag, text) for text in texts))
    columns = draw.pick([t, u, y], [u, y])
    lines = ["<html><body>", "<h1>Test 3</h1>", '<table border="1">']
    lines += [row(draw.pick("th", "td"), [f"{c.name} ({c.unit})" for c in columns])]
    lines += [row("td", cells) for cells in zip(*(c.cells for c in columns), strict=True)]
    lines += ["</table>", "</body></html>"]
    clock = t if t in columns else None
    return Layout("", {draw.pick("export.xls", "report.html"): packed(draw, lines)}, loops(loop(u, y, clock)))


@kind("table in XML")
def xml(draw: Draw) -> Layout:
    t, u, y = _columns(draw)
    form = draw.pick("attributes", "elements", "channels", "spreadsheet")
    if form in ("attributes", "spreadsheet"):
        t, u, y = (t, u, y) if form == "spreadsheet" else _bare(t, u, y)
    columns, rows = (t, u, y), [*zip(t.cells, u.cells, y.cells, strict=True)]
    lines = ['<?xml version="1.0"?>', draw.pick("<measurement>", '<measurement xmlns="urn:lab">')]
    if form == "attributes":
        lines += [
            "<point " + " ".join(f'{c.name}="{cell}"' for c, cell in zip(columns, row, strict=True)) + "/>"
            for row in rows
        ]
    elif form == "elements":
        lines += ["<row>" + "".join(f'<{c.name} unit="{c.unit}">{cell}</{c.name}>' for c, cell in zip(columns, row, strict=True)) + "</row>"
                  for row in rows]  # fmt: skip
    elif form == "channels":
        lines += [f'<channel name="{c.name}" unit="{c.unit}">' + " ".join(c.cells) + "</channel>" for c in columns]
    else:
        titles = tuple(f"{c.name} ({c.unit})" for c in columns)
        lines += [
            "<Row>" + "".join(f"<Cell><Data>{cell}</Data></Cell>" for cell in row) + "</Row>" for row in [titles, *rows]
        ]
    lines += ["</measurement>"]
    return Layout("", {draw.pick("test.xml", "export.xml"): packed(draw, lines, ("utf-8",))}, loops(loop(u, y, t)))


@kind("structures of MATLAB")
def matlab(draw: Draw) -> Layout:
    t, u, y = _columns(draw)
    form = draw.pick("nested", "records", "channels")
    if form == "nested":
        content = {"test": {"info": {"operator": "x", "rate": 20.0}, "data": {c.name: c.written for c in (t, u, y)}}}
        truth = [loop(*_bare(u, y), t)]
    elif form == "records":
        half = len(t.cells) // 2
        parts = [slice(0, half), slice(half, None)]
        content = {"tests": np.array([{c.name: c.written[part] for c in (t, u, y)} for part in parts], dtype=object)}
        truth = [loop(*_bare(u, y), t, rows=part) for part in parts]
    else:
        data = lambda c: {"Name": c.name, "Unit": c.unit, "Data": c.written}
        content = {"capture": {"X": data(t), "Y": np.array([data(u), data(y)], dtype=object)}}
        truth = [loop(u, y, t)]
    file = io.BytesIO()
    scipy.io.savemat(file, content)
    return Layout("", {draw.pick("test.mat", "capture.mat"): file.getvalue()}, loops(truth))


@kind("records in lines of JSON")
def lines_of_json(draw: Draw) -> Layout:
    t, u, y = _bare(*_columns(draw))
    columns = [t.renamed(draw.pick("ts", "time", "t")), u, y]
    lines = [
        json.dumps({c.name: float(cell) for c, cell in zip(columns, row, strict=True)})
        for row in zip(*(c.cells for c in columns), strict=True)
    ]
    return Layout("", {draw.pick("log.ndjson", "log.jsonl"): packed(draw, lines, ("utf-8",))}, loops(loop(u, y, t)))
