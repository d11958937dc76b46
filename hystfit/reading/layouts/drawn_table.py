r"""Tables drawn with rules, as in Markdown and in reports: a line of dashes between the names and the numbers; and those for LaTeX."""

import re

from hystfit.reading.files.text_file import TextFile
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.plain_text import plain_text

_RULE = re.compile(r"(?=[\s|+:_=-]*?[-=_]{3})[\s|+:_=-]++")
_NUMBERS = re.compile(r"[\s|]*[-+]?\.?\d")


def read_latex_table(text: TextFile) -> Table | None:
    r"""The rows of `\begin{tabular}`, whose cells `&` separates and which `\\` ends; None for text without them."""
    if not any(r"\begin{tabular" in line for line in text.head):
        return None
    rows = (line.partition(r"\\")[0].replace("&", "\t") if "&" in line else "" for line in text.lines)
    return plain_text(text.of("\n".join(re.sub(r"\\(?:hline|toprule|midrule|bottomrule)\s*", "", row) for row in rows)))


def read_drawn_table(text: TextFile) -> Table | None:
    """A table of which a rule separates names and numbers; None for text without one."""
    after = [*text.head[1:], "", ""]
    below = lambda k: after[k] or after[k + 1]  # a blank line may follow the rule
    rules = [k for k, line in enumerate(text.head) if _RULE.fullmatch(line) and _NUMBERS.match(below(k))]
    if not rules:
        return None
    lines = list(text.lines)
    for rule in rules:  # the names move down to the numbers, whose lines keep their places
        above = rule
        while above and lines[above - 1].strip():
            above -= 1
        lines[above : rule + 1] = ["", *lines[above:rule]]
    return plain_text(text.of("\n".join(lines)))
