"""Tables in HTML, also under the name .xls as instruments and web pages write them, and in XML: rows of cells, attributes or elements."""

from __future__ import annotations

import collections
import html.parser
import re
from collections.abc import Sequence
from xml.etree import ElementTree

from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.limits import FEW, FEWEST
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.plain_text import plain_text

_HTML = re.compile(r"<!doctype html|<html|<t(?:able|r|body)\b", re.IGNORECASE)
# Answers of a node in a recorder of OpenSees: D1 is its displacement along the first axis.
_ANSWERS = re.compile(r"([DVAR])([1-6])")
_OF_NODES = {"D": "displacement", "V": "velocity", "A": "acceleration", "R": "reaction force"}
# Elements named by the one around them.
_OF_VALUES = frozenset({"value", "val", "v", "data", "number", "double", "float"})


def read_markup(text: TextFile) -> Table | None:
    """Tables in HTML (also named .xls) and in XML: cells, or the attributes and elements of a row; an element of numbers is a column."""
    if not text.content.lstrip("\ufeff \t\r\n").startswith("<"):
        return None
    page = _HTML.search(text.content[:20_000]) is not None
    lines = _html_lines(text.content) if page else _xml_lines(text)
    if page and not lines:
        raise DataError(
            f"{text.source} is a web page without a table: download the file itself instead of the page that shows it"
        )
    if not lines:
        return None
    kind = "HTML" if page else "XML"
    return plain_text(text.of("\n".join(lines))).noted(Note(Code.FILE_FORMAT, f"a table in {kind}"))


class _Rows(html.parser.HTMLParser):
    """The rows of the tables of a page; an empty one between tables."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self._cell: list[str] | None = None

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "tr" or (tag == "table" and self.rows):
            self.rows.append([])
        elif tag in ("td", "th") and self.rows:
            self.handle_endtag(tag)
            self._cell = []

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th", "tr", "table") and self._cell is not None:
            self.rows[-1].append(_plain(" ".join(self._cell)))
            self._cell = None

    def handle_data(self, data: str) -> None:
        if self._cell is not None:
            self._cell.append(data)


def _plain(words: str) -> str:
    return " ".join(words.split())


def _html_lines(content: str) -> list[str]:
    """The rows of all tables, with tabs between cells; none of a page without a table."""
    parser = _Rows()
    parser.feed(content)
    return ["\t".join(row) for row in parser.rows] if sum(map(bool, parser.rows)) > 1 else []


def _xml_lines(text: TextFile) -> list[str]:
    """The rows of an XML text, with tabs between cells; none where no elements repeat."""
    if "<!DOCTYPE" in text.content or "<!ENTITY" in text.content:
        raise DataError(f"{text.source} is XML with definitions of its own, which are not read: write the table as CSV")
    try:
        root = ElementTree.fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text.content.lstrip("\ufeff")).strip())
    except ElementTree.ParseError as error:
        raise DataError(f"{text.source} begins as XML and is not: {error}; write it again") from error
    if rows := _matrix(root):
        return rows
    if columns := _columns(root):
        return ["\t".join(columns), *("\t".join(row) for row in zip(*columns.values(), strict=True))]
    counts = collections.Counter((id(parent), child.tag) for parent in root.iter() for child in parent)
    (_, tag), count = counts.most_common(1)[0] if counts else ((0, ""), 0)
    if count < FEWEST:
        return []
    groups = [[child for child in parent if child.tag == tag] for parent in root.iter()]
    tables = [_rows(rows) for rows in groups if len(rows) >= FEWEST]
    if len(kinds := {rows[0] for rows in tables}) > FEW:
        raise DataError(
            f"{text.source} is XML with tables of {len(kinds)} kinds: export what was measured as CSV, from the program that wrote it"
        )
    return "\n\n".join("\n".join(rows) for rows in tables).split("\n") if tables else []


def _local(tag: str) -> str:
    return tag.rpartition("}")[2]


def _columns(root: ElementTree.Element) -> dict[str, list[str]]:
    """Elements whose text is as many numbers each, by name; none where there are no two of them."""
    found: dict[str, list[str]] = {}
    for element in root.iter():
        parts = re.split(r"[\s,;]+", (element.text or "").strip())
        if len(parts) >= FEWEST and re.fullmatch(r"[\d.eE+\s,;-]+", element.text or ""):
            name = next(
                (element.attrib[key] for key in ("name", "id", "label") if key in element.attrib), _local(element.tag)
            )
            found[_with_unit(name, element)] = parts
    return found if len(found) > 1 and len({*map(len, found.values())}) == 1 else {}


def _matrix(root: ElementTree.Element) -> list[str]:
    """The rows of an element of many numbers in every line, under the names that elements before it give; none without them.

    A recorder of OpenSees has the answer of a node (D1, R1) or element in an element, and its number in the attributes of those around.
    """
    around = {child: parent for parent in root.iter() for child in parent}
    named: dict[str, list[str]] = collections.defaultdict(list)
    for element in root.iter():
        rows = [line.split() for line in (element.text or "").splitlines() if line.strip()]
        width = len(rows[0]) if len(rows) >= FEWEST and re.fullmatch(r"[\d.eE+\s-]+", element.text or "") else 0
        names = next((names for names in named.values() if len(names) == width), [])
        if width > 1 and names and all(len(row) == width for row in rows):
            twice = collections.Counter(name.partition(" of ")[0] for name in names)
            short = [name if twice[base := name.partition(" of ")[0]] > 1 else base for name in names]
            return ["\t".join(short), *map("\t".join, rows)]
        if not len(element) and rows and len(rows[0]) == 1:
            tags = (
                value
                for key, value in (around[element].attrib if element in around else {}).items()
                if "tag" in key.lower()
            )
            named[element.tag].append(f"{_ANSWERS.sub(_answer, rows[0][0])} of {next(tags, '')}")
    return []


def _answer(match: re.Match[str]) -> str:
    """The quantity that a recorder names by a letter."""
    return f"{_OF_NODES[match[1]]} {match[2]}"


def _with_unit(name: str, element: ElementTree.Element) -> str:
    unit = next((element.attrib[key] for key in ("unit", "units", "uom") if key in element.attrib), "")
    return f"{name} [{unit}]" if unit else name


def _rows(elements: Sequence[ElementTree.Element]) -> list[str]:
    """The lines of elements that are rows: a header where their cells have names, and the cells."""
    rows = [_cells(element) for element in elements]
    names = collections.Counter(tuple(name for name, _ in row) for row in rows)
    usual = names.most_common(1)[0][0]
    if len({*usual}) == len(usual):
        return ["\t".join(usual), *("\t".join(dict(row).get(name, "") for name in usual) for row in rows)]
    inner = [
        [cell for cell in element if len(cell) or (cell.text or "").strip()] for element in elements
    ]  # cells of one name
    return ["\t".join(_plain("".join(cell.itertext())) for cell in row) for row in inner]


def _cells(element: ElementTree.Element) -> list[tuple[str, str]]:
    """Names and values of an element that is a row: its attributes and the elements in it."""
    cells = [(name, value) for name, value in element.attrib.items()]
    around = {child: parent for parent in element.iter() for child in parent}
    for leaf in element.iter():
        if len(leaf) or not (leaf.text or "").strip():
            continue
        named = (
            around[leaf]
            if leaf in around and _local(leaf.tag).lower() in _OF_VALUES and around[leaf] is not element
            else leaf
        )
        cells.append(
            (_with_unit(_local(named.tag), named if "unit" in named.attrib else leaf), _plain(leaf.text or ""))
        )
    return cells
