"""Quantities of measured loops, without a model."""

from __future__ import annotations

import itertools

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.data.steady_cycle import from_turning_point
from hystfit.quality.loops import reversals
from hystfit.results.quantities import QUANTITIES
from hystfit.results.steady_loops import Excitation, SteadyLoops

_WHOLE = 0.01  # gap to the fitted range, in parts of it, within which a measured cycle covers it
_GRID = 2001  # inputs of the branches of a measured cycle
_GAP = 0.05  # of the output's range, between the two ends of a measured loop
_TURN = 0.05  # of the input's range: smallest reversal that ends a measured branch


def measured_quantities(data: Dataset) -> dict[str, float]:
    """Quantities of the loops as measured, by name, without a model: medians over the closed loops that cover the range of all records.

    Samples are joined by straight lines. Empty where no two successive branches cover the range and meet at both ends: a first rise from
    rest and the branch after it are no loop.
    """
    excitation = Excitation.of(data)
    inputs = np.linspace(excitation.low, excitation.high, _GRID)
    branches: dict[bool, list[np.ndarray]] = {True: [], False: []}
    for record in data.map(from_turning_point):
        turns = np.unique([0, *reversals(record.u, _TURN * float(np.ptp(record.u))), len(record) - 1]).tolist()
        found = [(bool(record.u[b] > record.u[a]), _branch(record, a, b, inputs)) for a, b in itertools.pairwise(turns)]
        for pair in itertools.pairwise(found):
            if _closed(*pair):
                for rises, branch in pair:
                    branches[rises].append(branch)
    if not branches[True]:
        return {}
    loops = SteadyLoops(inputs, *map(np.array, branches.values()), excitation.force_driven)
    values = {name: float(np.median(q.of_loops(loops))) for name, q in QUANTITIES.items() if q.of_loops is not None}
    return {name: value for name, value in values.items() if np.isfinite(value)}


def _closed(one: tuple[bool, np.ndarray | None], other: tuple[bool, np.ndarray | None]) -> bool:
    """Whether two successive branches cover the range, and the second ends where the first began."""
    (rises, first), (_, second) = one, other
    if first is None or second is None:
        return False
    end = 0 if rises else -1
    return bool(abs(first[end] - second[end]) <= _GAP * np.ptp(first))


def _branch(record: Record, first: int, last: int, inputs: np.ndarray) -> np.ndarray | None:
    """The measured output at inputs between two turning points; None where the branch does not cover them."""
    kept = first + np.flatnonzero(record.used[first : last + 1])
    kept = kept[np.argsort(record.u[kept], kind="stable")]
    u, slack = record.u[kept], _WHOLE * float(inputs[-1] - inputs[0])
    if not kept.size or u[0] > inputs[0] + slack or u[-1] < inputs[-1] - slack:
        return None
    return np.interp(inputs, u, record.y[kept])
