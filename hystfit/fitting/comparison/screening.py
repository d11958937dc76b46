"""Comparison on many records: every model is tried on some of them, and those that may win are fitted to all."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.fitting.comparison.candidates import Candidates
from hystfit.fitting.comparison.compared_models import Row, ranked
from hystfit.fitting.comparison.comparison_run import ComparisonRun
from hystfit.fitting.comparison.model_search import search
from hystfit.quality.loops import turns_back

# Samples and records on which every model is tried, at least: 9 of 53 transients, and the best on all, took 85 s, all on 53 over 200 s.
_SAMPLES, _RECORDS = 8192, 8


def some_records(data: Dataset) -> Dataset | None:
    """Records with strokes of all sizes on which models are screened; None where half of them are needed, and for reversal curves.

    Curves of one family lie side by side, and some of them would be a coarser family.
    """
    lengths = [int(record.used.sum()) for record in data]
    count = max(_RECORDS, int(np.ceil(_SAMPLES / np.mean(lengths))))
    if 2 * count > len(data) or not turns_back(data):
        return None
    by_stroke = np.argsort([np.ptp(record.u) for record in data], kind="stable")
    chosen = np.sort(by_stroke[np.linspace(0, len(data) - 1, count).round().astype(int)])
    return Dataset(tuple(data[int(k)] for k in chosen), data.name)


def search_screened(run: ComparisonRun, few: Dataset, chosen: Candidates) -> None:
    """Search on few of the records, and fit the best models found there to all of them, from the values found."""
    screen = run.on(few)
    search(screen, chosen)
    rows = ranked(screen.standings.rows, run.standings.purpose, equal=screen.standings.equal)
    fits = screen.standings.fits
    # The first of those that few records do not tell apart is the plainest.
    best = min(rows, key=lambda row: row.score)
    plainest = rows[:1]
    ahead = [row for row in (plainest if best in plainest else [*plainest, best]) if row.asked in fits]
    run.errors += screen.errors
    for row in ahead:
        run.refit(row.asked, fits[row.asked])
    for row in rows:
        if row not in ahead:
            run.standings.add(_left(row, len(few), len(run.data)))


def _left(row: Row, few: int, records: int) -> Row:
    """The row of a model that was tried on few of the records only."""
    if row.score_percent is None:
        return dataclasses.replace(row, note=row.note and f"on {few} of {records} records: {row.note}")
    text = f"not fitted to all records: its cross-validation error on {few} of {records} is {row.score_percent:.2g} %"
    return dataclasses.replace(row, score_percent=None, bic=None, obstacles=None, leaves_noise=False, note=text)
