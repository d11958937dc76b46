"""Lines that are cut out of a text when they are asked for, beside `str.split`."""

from __future__ import annotations

import numpy as np
import pytest

from hystfit.errors import DataError
from hystfit.reading.files.lines import check_lengths, lines_of

TEXTS = [
    "",
    "\n",
    "\n\n",
    "a",
    "a\n",
    "a\n\n",
    "\na",
    "a\n\nbc\n",
    "a\nb",
    "µ\n1,2\n",
    "µ\n1,2",
    "t,u\n" + "1.5,2\n" * 40,
]


def _split(content: str) -> list[str]:
    lines = content.split("\n")
    return lines if lines[-1] else lines[:-1]


@pytest.mark.parametrize("content", TEXTS)
def test_lines_are_those_of_split(content: str) -> None:
    lines, expected = lines_of(content), _split(content)
    assert len(lines) == len(expected)
    assert list(lines) == expected
    for part in (slice(None), slice(3), slice(-2, None), slice(1, None, 2), slice(5, 2), slice(None, None, -1)):
        assert list(lines[part]) == expected[part]
    for k in range(-len(expected), len(expected)):
        assert lines[k] == lines[np.int64(k)] == expected[k]
    for k in (len(expected), -len(expected) - 1):
        with pytest.raises(IndexError):
            lines[k]


@pytest.mark.parametrize("end", ["", "\n", "\n1,2\n"])
def test_only_lines_of_more_than_the_limit_are_refused(end: str) -> None:
    head = "t,u\n" * 30_000  # longer than one line may be
    check_lengths(head + "1" * 100_000 + end, "file.csv")
    with pytest.raises(DataError, match=r"file\.csv, line 30001 has 100001 characters, and 100000 are the most"):
        check_lengths(head + "1" * 100_001 + end, "file.csv")
