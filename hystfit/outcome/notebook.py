"""What a notebook shows for a result: its heading, tables and notes as a fragment of HTML."""

from __future__ import annotations

import html
from collections.abc import Iterable

from hystfit.outcome.note import Note
from hystfit.outcome.table import Table

_STYLE = "<style>.hystfit th, .hystfit td {text-align: left} .hystfit .number {text-align: right}</style>"


def fragment(heading: str, parts: Iterable[str | Table | tuple[Note, ...]]) -> str:
    """HTML of a heading and of paragraphs, tables and lists of notes below it; all text is escaped.

    Args:
        heading: one line.
        parts: text for a paragraph, a table, or notes; empty ones are skipped.
    """
    shown = "\n".join(_part(part) for part in parts if not isinstance(part, str | tuple) or part)
    return f'<div class="hystfit">{_STYLE}\n<p><b>{html.escape(heading)}</b></p>\n{shown}\n</div>'


def _part(part: str | Table | tuple[Note, ...]) -> str:
    if isinstance(part, Table):
        return part.html()
    if isinstance(part, str):
        return f"<p>{html.escape(part)}</p>"
    return "<ul>\n" + "".join(f"<li>{html.escape(str(note))}</li>\n" for note in part) + "</ul>"
