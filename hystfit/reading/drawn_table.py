"""Tables drawn with rules, as in Markdown and in reports: a line of dashes between the names and the numbers."""

import re

from hystfit.reading.raw_table import Table
from hystfit.reading.text import plain_text
from hystfit.reading.text_file import TextFile

_RULE = re.compile(r"[\s|+:_=-]*[-=]{3}[\s|+:_=-]*")
_NUMBERS = re.compile(r"[\s|]*[-+]?\.?\d")


def read_drawn_table(text: TextFile) -> Table | None:
    """A table of which a rule separates names and numbers; None for text without one."""
    pairs = zip(text.head, text.head[1:], strict=False)
    rules = [k for k, (line, below) in enumerate(pairs) if _RULE.fullmatch(line) and _NUMBERS.match(below)]
    if not rules:
        return None
    lines = list(text.lines)
    for rule in rules:  # the names move down to the numbers, whose lines keep their places
        above = rule
        while above and lines[above - 1].strip():
            above -= 1
        lines[above : rule + 1] = ["", *lines[above:rule]]
    return plain_text(text.of("\n".join(lines)))
