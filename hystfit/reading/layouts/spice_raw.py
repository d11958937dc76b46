"""Results of circuit simulators (ngspice, LTspice) as text: below "Values:" the number of a sample and its values, one in a line."""

from __future__ import annotations

import re

from hystfit.reading.files.text_file import TextFile
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.plain_text import plain_text

_VARIABLE = re.compile(r"^\s*\d+\s+(\S+)\s+\S+[^\S\n]*$", re.MULTILINE)


def read_spice(text: TextFile) -> Table | None:
    """Variables and values of ngspice or LTspice in their raw format as text; None for other text."""
    head, mark, body = text.content.partition("\nValues:\n")
    names = _VARIABLE.findall(head.partition("\nVariables:")[2]) if mark else []
    if len(names) < 2:
        return None
    numbers, width = body.split(), len(names) + 1
    rows = [numbers[k + 1 : k + width] for k in range(0, len(numbers) - width + 1, width)]
    return plain_text(text.of("\n".join("\t".join(row) for row in [names, *rows])))
