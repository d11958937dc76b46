"""Rows of numbers in brackets, as Python, NumPy and Mathematica print them: (1, 2), [[1 2] and {{1., 2.}."""

from __future__ import annotations

import json
import re

from hystfit.reading.files.text_file import TextFile
from hystfit.reading.limits import FEWEST
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.plain_text import plain_text

_ROWS = re.compile(r"\s*[\[({]\s*[\[({]?[\[\](){}\d\s,;.eE+*^-]*")
_BETWEEN = re.compile(r"[\])}]\s*[,;]?\s*[\[({]")
_ALONE = re.compile(r"\(\s*\d*\.?\d*(?:e[+-]?\d+)?\s*\)", re.IGNORECASE)  # a negative number, as accounts write it
_POWER = re.compile(r"\*\^\s*")  # 1.5*^-9 of Mathematica


def read_bracketed(text: TextFile) -> Table | None:
    """Rows of numbers in brackets, (1, 2) or [1 2] or {1, 2}, as programs print them; None for other text and for lists of JSON."""
    if text.content.lstrip()[:1] not in "[({" or _ROWS.fullmatch(text.content) is None or _ALONE.search(text.content):
        return None
    try:
        json.loads(text.content)
    except (ValueError, RecursionError):
        rows = _BETWEEN.sub("\n", _POWER.sub("e", text.content).strip())
        lines = [re.sub(r"\s+", " ", line).strip() for line in re.sub(r"[\[\](){}]", " ", rows).split("\n")]
        lines = [line for line in lines if line]
        return plain_text(text.of("\n".join(lines))) if len(lines) >= FEWEST else None
    return None
