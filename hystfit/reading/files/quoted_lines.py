"""Lines that a spreadsheet or a program took for one cell each and quoted as a whole: "0.1,2.5,3.0"."""

from __future__ import annotations

import re

from hystfit.outcome import Code, Note

_CELL = r'"((?:[^"\n]|"")*)"[ \t;,]*'  # with the empty cells that a spreadsheet puts behind
_QUOTED = re.compile(rf"^{_CELL}$", re.MULTILINE)
_ROW = re.compile(r"[^;,\t\n]+(?:[;,\t][^;,\t\n]*)+")  # of several cells


def without_quotes(content: str) -> tuple[str, list[Note]]:
    """A text with such lines as they were before, and a note; other texts as they are. The last line tells which it is."""
    last = content.rstrip()
    last = last[last.rfind("\n") + 1 :]
    quoted = re.fullmatch(_CELL, last) if last.startswith('"') else None
    if quoted is None or not _ROW.fullmatch(quoted[1].replace('""', "")):
        return content, []
    text = "each line is quoted as one cell, and is read as the row of cells in it"
    plain = _QUOTED.sub(lambda match: match[1].replace('""', '"'), content)
    return plain, [Note(Code.FILE_FORMAT, text)]
