"""Notes on plain loops, as a fit that is judged alone has them: most loops share their codes, and a text is made when it is asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from hystfit.batch.alike import Common, Group, Loops
from hystfit.batch.plain_judge import Judged
from hystfit.data.dataset import Dataset
from hystfit.fitting.assessment import notes_of_model, notes_on_time
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Code, Note, Severity
from hystfit.quality.coverage import coverage_notes


@dataclasses.dataclass(frozen=True)
class RowNotes:
    """Notes on N loops besides their accuracy.

    Attributes:
        sets: the different sets of codes, each with that of the accuracy.
        of: which of them each loop has, shape (N,); -1 for loops that are not plain.
        make: the notes on a plain loop, by its number.
    """

    sets: tuple[tuple[str, ...], ...]
    of: np.ndarray
    make: Callable[[int], Sequence[Note]]

    def codes(self, k: int) -> tuple[str, ...]:
        """The codes of the notes on a plain loop."""
        return self.sets[self.of[k]]

    def reason(self, k: int) -> str:
        """The warnings and errors among them."""
        return "; ".join(note.text for note in self.make(k) if note.severity is not Severity.INFO)

    def examples(self) -> list[int]:
        """The first loop of each set."""
        plain = np.flatnonzero(self.of >= 0)
        return np.sort(plain[np.unique(self.of[plain], return_index=True)[1]]).tolist()

    def among(self, at: np.ndarray, count: int) -> RowNotes:
        """Those of the loops `at`, whose numbers rise, among `count`."""
        of = np.full(count, -1)
        of[at] = self.of
        return RowNotes(self.sets, of, lambda k: self.make(int(np.searchsorted(at, k))))


def row_notes(common: Common, loops: Loops, judged: Judged, on_errors: Sequence[Sequence[Note]]) -> RowNotes:
    """Notes on each plain loop, in the order of a fit that is judged alone.

    Args:
        common: what the loops have in common.
        loops: that were judged.
        judged: their numbers.
        on_errors: notes on the errors of each.
    """
    model, space = common.setup.problem.model, common.setup.problem.space
    chosen = [Note(Code.CHOICE, "")] if common.of_weights else []  # as every estimate of weights has one
    datasets = [Dataset.of(group.record) for group in loops.groups]
    of_range = [() if model.from_saturation else coverage_notes(data) for data in datasets]
    first = [
        (*notes, *common.setup.notes, *chosen, *notes_on_time(data))
        for data, notes in zip(datasets, of_range, strict=True)
    ]
    last = [[note for note in group.record.notes if note.code is Code.UNITS] for group in loops.groups]
    group_of = np.repeat(np.arange(len(loops.groups)), [len(group.y) for group in loops.groups])
    advised = _advised(common, loops, judged)

    def make(k: int) -> tuple[Note, ...]:
        group = group_of[k]
        fitted = space.coordinates.assemble_rows(judged.x[k : k + 1]) if advised[k] else ()
        advice = [note for one in fitted for note in notes_of_model(datasets[group], one)]
        slow = [Note(Code.ERROR_RATIO, "residuals are autocorrelated")] if judged.slow[k] else []
        return (*first[group], *advice, *on_errors[k], *slow, *last[group])

    kinds: dict[tuple[Code, ...], int] = {}
    kind = np.array([kinds.setdefault(tuple(note.code for note in lines), len(kinds)) for lines in on_errors])
    plain, of, sets = np.flatnonzero(judged.plain), np.full(len(loops), -1), dict[tuple[str, ...], int]()
    traits = np.stack([group_of, advised, judged.slow, kind], axis=1)[plain]
    _, examples, which = np.unique(traits, axis=0, return_index=True, return_inverse=True)
    own = [sets.setdefault(_codes(make(k)), len(sets)) for k in plain[examples].tolist()]
    of[plain] = np.array(own, int)[which.reshape(-1)]
    return RowNotes(tuple(sets), of, make)


def _codes(notes: Sequence[Note]) -> tuple[str, ...]:
    return tuple(dict.fromkeys([str(Code.ACCURACY), *(str(note.code) for note in notes)]))


def _advised(common: Common, loops: Loops, judged: Judged) -> np.ndarray:
    """On which plain loops the fitted model has advice, shape (N,), bool."""
    model, coordinates = common.setup.problem.model, common.setup.problem.space.coordinates
    if type(model).advice is AbstractHysteresis.advice:
        return np.zeros(len(loops), bool)

    def of_group(group: Group, x: np.ndarray, plain: np.ndarray) -> np.ndarray:
        advised, data = np.zeros(len(x), bool), Dataset.of(group.record)
        ratio = coordinates.assemble_stacked(x[plain]).step_ratio(group.record.u)
        if ratio is None:
            advised[plain] = [bool(notes_of_model(data, one)) for one in coordinates.assemble_rows(x[plain])]
        else:
            advised[plain] = ratio > 1
        return advised

    return loops.each(of_group, judged.x, judged.plain)
