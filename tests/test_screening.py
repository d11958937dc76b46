"""Comparison on many records: which of them screen the models, and that the winner is that of a comparison on all."""

import numpy as np
import pytest

import hystfit as hf
from hystfit.fitting.comparison import compare as comparing
from hystfit.fitting.comparison.screening import some_records


def play_records(count: int, samples: int, noise: float = 2e-3) -> hf.Dataset:
    """Decaying loops of several sizes through three play operators, by a plain loop."""
    rng, records = np.random.default_rng(3), []
    for number in range(count):
        phase = np.linspace(0.0, 6 * np.pi, samples)
        u = (0.3 + 0.7 * (number * 7 % count) / (count - 1)) * np.sin(phase) * (1 - 0.5 * phase / phase[-1])
        widths, weights = np.array([0.0, 0.1, 0.3]), np.array([1.0, 0.5, 0.4])
        states, y = np.zeros(3), np.empty(samples)
        for k, value in enumerate(u):
            states = np.clip(states, value - widths, value + widths)
            y[k] = weights @ states
        records.append(hf.Record(u=u, y=y + noise * rng.standard_normal(samples), name=f"run {number}"))
    return hf.Dataset(tuple(records), "runs")


def test_some_records_have_the_smallest_and_the_largest_stroke_and_their_order():
    data = play_records(40, 500)
    few = some_records(data)
    assert few is not None
    strokes = [np.ptp(record.u) for record in few]
    every = [np.ptp(record.u) for record in data]
    assert (min(strokes), max(strokes)) == (min(every), max(every))
    numbers = [int(record.name.split()[1]) for record in few]
    assert numbers == sorted(numbers)
    assert 8192 <= 500 * len(few) < 8192 + 500


@pytest.mark.parametrize(("count", "samples"), [(15, 4000), (30, 500)], ids=["few records", "few samples"])
def test_records_that_are_soon_compared_are_compared_whole(count, samples):
    assert some_records(play_records(count, samples)) is None


def test_reversal_curves_are_compared_whole():
    ends = np.linspace(-0.9, 0.9, 60)
    curves = [
        hf.Record(u=np.linspace(end, 1.0, 400), y=np.tanh(np.linspace(end, 1.0, 400)), name=f"{end:.3f}")
        for end in ends
    ]
    assert some_records(hf.Dataset(tuple(curves))) is None


@pytest.mark.usefixtures("few_families")
def test_the_winner_on_some_records_is_fitted_to_all_and_predicts_as_that_of_all(monkeypatch):
    data = play_records(36, 500)
    screened = hf.compare(data, progress=lambda *_: None)
    monkeypatch.setattr(comparing, "some_records", lambda _: None)
    whole = hf.compare(data, progress=lambda *_: None)
    assert len(screened.winner.problem.data) == 36
    assert screened.rows[0].score < 1.02 * whole.rows[0].score
    assert any("compared on 17 of 36 records" in note.text for note in screened.winner.notes)
    others = [row for row in screened.rows if row.score_percent is None]
    assert others
    assert all("17 of 36" in row.note for row in others)
