"""Files with sections [Header] and [Data], such as those of Quantum Design: rows without a measurement are ordinary in them."""

from __future__ import annotations

import dataclasses

from hystfit.reading.files.text_file import TextFile
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.plain_text import plain_text


def read_sections(text: TextFile) -> Table | None:
    """Sections [Header] and [Data], as of Quantum Design: size and mass of the sample are kept, rows without a measurement left out."""
    if not any(line.strip(" ,;\t").lower() == "[data]" for line in text.head):
        return None
    return dataclasses.replace(plain_text(text), sectioned=True)
