"""What a generated file holds: its records, or the question that only its owner can answer."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np


@dataclasses.dataclass(frozen=True)
class Loop:
    """One record as it is written in a file.

    Attributes:
        u, y: input and output, shape (T,), as rounded in the file; y is NaN where it is missing.
        u_unit, y_unit: as hystfit spells them; "" where the file states none.
        t: time [s] from the first sample, shape (T,); None where any time, or none, is right.
        slack: error of an input that follows from several columns, as a part of its range; its zero is free. 0: as written.
    """

    u: np.ndarray
    y: np.ndarray
    u_unit: str = ""
    y_unit: str = ""
    t: np.ndarray | None = None
    slack: float = 0.0


Records = tuple[Loop, ...]


@dataclasses.dataclass(frozen=True)
class Layout:
    """A generated file, or several that belong together, and what is right.

    Attributes:
        kind: name in the registry.
        files: contents by file name; more than one is read as a list.
        truths: records that are right, each a defensible answer; the first is the usual one.
        ask: whether the right answer without options is a question, to which `answer` is the reply.
        may_ask: whether a question with the right reading among its remedies is as good as the reading.
        answer: options of `hystfit.read` with which the first truth is read.
        either_order: whether input and output may be exchanged where a warning says so, as in a file without names.
    """

    kind: str
    files: Mapping[str, bytes]
    truths: tuple[Records, ...]
    ask: bool = False
    may_ask: bool = False
    answer: Mapping[str, str | int] = dataclasses.field(default_factory=dict)
    either_order: bool = False


def loops(*pairs: Loop | Sequence[Loop]) -> tuple[Records, ...]:
    """Truths from a loop or a sequence of loops each."""
    return tuple((pair,) if isinstance(pair, Loop) else tuple(pair) for pair in pairs)
