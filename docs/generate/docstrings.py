"""Docstrings of the package as reStructuredText: they are plain text, in which |h|, w_ij and 2 * x are not marks."""

from __future__ import annotations

import re
from typing import Any

_MARKS = re.compile(r"([|*\\])|(?<=\w)(_)(?=\W|$)")
_SECTION = re.compile(r"^(Args|Attributes|Class attributes|Returns|Raises|Yields):$")


def escape_marks(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Change a docstring in place, before napoleon reads its sections (event autodoc-process-docstring).

    Args:
        app, what, name, obj, options: of the event, not used.
        lines: of the docstring.
    """
    first = next((k for k, line in enumerate(lines) if _SECTION.match(line)), len(lines))
    lines[:] = [*_with_blocks(lines[:first]), *map(_escaped, lines[first:])]


def _escaped(line: str) -> str:
    """A line with its marks escaped; `code` becomes a literal, which needs a separator where a word continues it."""
    parts = re.split(r"`([^`]+)`", line)
    for k, part in enumerate(parts):
        parts[k] = f"``{part}``" if k % 2 else _MARKS.sub(r"\\\1\2", part)
        if k % 2 and re.match(r"[\w_]", parts[k + 1]):
            parts[k] += "\\ "
    return "".join(parts)


def _with_blocks(lines: list[str]) -> list[str]:
    """Lines in which indented equations are literal blocks."""
    out: list[str] = []
    inside = False
    for line in lines:
        indented = line.startswith("    ")
        if indented and not inside:
            out += [*([] if not out or not out[-1] else [""]), ".. code-block:: text", ""]
        elif inside and line and not indented and out[-1]:
            out.append("")
        inside = indented or (inside and not line)
        out.append(line if indented else _escaped(line))
    return out
