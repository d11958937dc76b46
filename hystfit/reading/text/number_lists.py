"""Lists of numbers in one cell, "[0.1, 0.2]", as programs write arrays into a table."""

from __future__ import annotations

import re

import numpy as np
from jaxtyping import Float

_LIST = re.compile(r"\s*[\[(][\d\s,;.eE+-]*[\])]\s*")


def is_list(cell: str) -> bool:
    """Whether a cell has numbers in brackets, and nothing else."""
    return _LIST.fullmatch(cell) is not None


def numbers_of(cell: str) -> Float[np.ndarray, " n"]:
    """The numbers in brackets, which commas, semicolons or blanks separate.

    Raises:
        ValueError: one of them is no number, such as 2019-11-02.
    """
    return np.array([float(number) for number in re.sub(r"[\[\](),;]", " ", cell).split()])
