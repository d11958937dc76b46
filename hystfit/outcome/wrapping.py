"""Text within a number of columns: prose wraps below its own beginning, and commands stay whole."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence

NAMED = 5  # names of a list that prose gives one by one
PROSE = 100  # columns from which a line of prose is hard to read
_LAST_COLUMN = re.compile(r"^.*\S {2,}(?=\S)")
_REASON = 240  # characters of a reason in a list of several
_HANG = 0.7  # part of the width behind which the last column of a table is no prose that could wrap
_COMMAND = re.compile(r"\s*(?:\$ )?(?:hystfit|cc|printf) ")  # whole, to be copied


def listed(names: Sequence[str], separator: str = ", ") -> str:
    """The first names of a list, and how many more there are."""
    more = len(names) - NAMED
    return separator.join(names[:NAMED]) + (f" and {more} more" if more > 0 else "")


def shortened(lines: Sequence[str], most: int, rest: str = "and {} more") -> list[str]:
    """The first lines of a list, and one that counts those beyond the first `most`."""
    more = len(lines) - most
    return [*lines[:most], rest.format(more)] if more > 0 else list(lines)


def begun(text: str) -> str:
    """The beginning of a reason that stands in a list of several; a fit of that loop alone gives the whole."""
    return textwrap.shorten(text, _REASON, placeholder=" ...")


def within(text: str, width: int) -> str:
    """The text with lines of at most `width` columns.

    A longer line is continued below the beginning of its bullet or of its last column. Commands, and rows of numbers that are too wide,
    stay as they are.
    """
    return "\n".join(_wrapped(line, width) for line in text.split("\n"))


def _wrapped(line: str, width: int) -> str:
    if len(line) <= width or _COMMAND.match(line):
        return line
    column = _LAST_COLUMN.match(line)
    hang = column.end() if column else len(line) - len(line.lstrip()) + 2  # where the second line begins
    if hang > _HANG * width:
        return line
    return textwrap.fill(
        line,
        width,
        subsequent_indent=" " * hang,
        break_long_words=False,
        break_on_hyphens=False,
        replace_whitespace=False,
        drop_whitespace=True,
    )
