"""Files that hold several tables: zip archives, spreadsheets of LibreOffice, groups of arrays in HDF5, NumPy and MATLAB."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from xml.sax.saxutils import escape

import numpy as np
import scipy.io

from .documents import measured
from .drawing import Draw
from .registry import kind
from .truth import Layout, loops
from .writing import Column, Dialect, loop, packed, table


def _specimens(draw: Draw, count: int) -> list[list[Column]]:
    """Time, input and output of several specimens of one kind, of different lengths."""
    state = draw.rng.bit_generator.state
    found = []
    for k in range(count):
        draw.rng.bit_generator.state = state  # the same pair of quantities
        columns = measured(draw, 200)
        end = 200 - 7 * k
        found.append([Column(c.name, (1 + 0.1 * k) * c.values[:end], c.unit, c.form) for c in columns])
    return found


def _zipped(members: Mapping[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


@kind("archive of several tables")
def archive(draw: Draw) -> Layout:
    specimens = _specimens(draw, draw.whole(2, 4))
    folder, dialect = draw.pick("", "data/", "tests/cyclic/"), Dialect(draw.pick(",", "\t", ";"), style="brackets")
    members = {f"{folder}S{k}.csv": packed(draw, table(draw, c, dialect)) for k, c in enumerate(specimens, start=1)}
    beside = {
        "README.txt": b"Tests of March",
        "meta.json": json.dumps({"lab": "A"}).encode(),
        "__MACOSX/._S1.csv": b"\0\5",
    }
    members |= {name: content for name, content in beside.items() if draw.chance(0.5)}
    return Layout("", {"tests.zip": _zipped(members)}, loops([loop(u, y, t) for t, u, y in specimens]))


_SPACES = " ".join(
    f'xmlns:{name}="urn:oasis:names:tc:opendocument:xmlns:{name}:1.0"' for name in ("office", "table", "text")
)


def _sheet(title: str, lines: Sequence[Sequence[str]]) -> str:
    """A sheet with a cell for each text; numbers as such, and the empty rest of the sheet as LibreOffice writes it."""

    def cell(text: str) -> str:
        try:
            return f'<table:table-cell office:value-type="float" office:value="{float(text)!r}"><text:p>{text}</text:p></table:table-cell>'
        except ValueError:
            content = f'office:value-type="string"><text:p>{escape(text)}</text:p></table:table-cell>'
            return f"<table:table-cell {content}" if text else "<table:table-cell/>"

    body = "".join(f"<table:table-row>{''.join(map(cell, line))}</table:table-row>" for line in lines)
    rest = '<table:table-cell table:number-columns-repeated="1024"/>'
    rest = f'<table:table-row table:number-rows-repeated="1048000">{rest}</table:table-row>'
    return f'<table:table table:name="{title}">{body}{rest}</table:table>'


@kind("OpenDocument spreadsheet")
def open_document(draw: Draw) -> Layout:
    specimens = _specimens(draw, draw.whole(1, 3))
    sheets = []
    for k, columns in enumerate(specimens, start=1):
        names = [f"{c.name} ({c.unit})" for c in columns]
        sheets.append(_sheet(f"S{k}", [names, *zip(*(c.cells for c in columns), strict=True)]))
    content = f"<office:document-content {_SPACES}><office:body><office:spreadsheet>{''.join(sheets)}</office:spreadsheet></office:body>"
    members = {
        "mimetype": b"application/vnd.oasis.opendocument.spreadsheet",
        "META-INF/manifest.xml": b'<m:manifest xmlns:m="urn:oasis:names:tc:opendocument:xmlns:manifest:1.0"/>',
        "content.xml": f'<?xml version="1.0" encoding="UTF-8"?>{content}</office:document-content>'.encode(),
    }
    return Layout(
        "", {draw.pick("loops.ods", "tests.ods"): _zipped(members)}, loops([loop(u, y, t) for t, u, y in specimens])
    )


@kind("groups of arrays")
def groups(draw: Draw) -> Layout:
    specimens = _specimens(draw, draw.whole(2, 4))
    key = lambda c: f"{c.name}_{c.unit.replace('/', '_').replace('%', 'percent')}"
    form, stream = draw.pick("npz", "mat", "h5"), io.BytesIO()
    bare = [[Column(key(c), c.values, "", c.form) for c in columns] for columns in specimens]
    if form == "npz":
        np.savez(stream, **{f"S{k}/{c.name}": c.written for k, columns in enumerate(bare) for c in columns})
    elif form == "mat":
        tests = {f"S{k}": {c.name: c.written for c in columns} for k, columns in enumerate(bare)}
        scipy.io.savemat(stream, {"tests": tests})
    else:
        import h5py

        with h5py.File(stream, "w") as file:
            for k, columns in enumerate(specimens):
                for c in columns:
                    data = file.create_dataset(f"S{k}/raw/{c.name}", data=c.written)
                    data.attrs["units"] = c.unit
    truth = [loop(u, y, t) for t, u, y in (specimens if form == "h5" else bare)]
    return Layout("", {f"tests.{form}": stream.getvalue()}, loops(truth))
