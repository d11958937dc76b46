"""Vector hysteresis: a play in one dimension, rotation and dissipation, recovery of parameters, the written table."""

import csv

import numpy as np
import pytest

import hystfit as hf
from hystfit.identify import VectorHysteresis, VectorRecord

MU0 = 4e-7 * np.pi
TRUE = VectorHysteresis(1.4, 60.0, [25.0, 70.0], [0.6, 0.4])


def langevin(x):
    return np.where(np.abs(x) < 1e-4, x / 3, 1 / np.tanh(np.where(x == 0, 1.0, x)) - 1 / np.where(x == 0, 1.0, x))


def by_loop(h, js, a, kappa, w):
    """The same law by a plain loop over samples and cells."""
    b = MU0 * h.copy()
    for pinning, weight in zip(kappa, w, strict=True):
        dragged = np.zeros(h.shape[1])
        for k, field in enumerate(h):
            ahead = field - dragged
            if np.linalg.norm(ahead) > pinning:
                dragged = field - pinning * ahead / np.linalg.norm(ahead)
            size = np.linalg.norm(dragged)
            b[k] += weight * js * langevin(size / a) * dragged / size if size else 0.0
    return b


def alternating(direction, peak=250.0, count=300):
    h = np.interp(np.arange(count), np.linspace(0, count - 1, 5), [0, peak, -peak, 0.5 * peak, -peak])
    return h[:, None] * np.asarray(direction) / np.linalg.norm(direction)


def rotating(peak, count=300, turns=2.0):
    grow = np.minimum(np.linspace(0, 4, count), 1.0) * peak
    angle = 2 * np.pi * turns * np.linspace(0, 1, count)
    return grow[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def test_one_dimension_is_a_play_and_three_follow_a_plain_loop():
    h = alternating([1.0])
    play, expected = np.zeros(2), []
    for field in h[:, 0]:
        play = np.clip(play, field - TRUE.kappa, field + TRUE.kappa)
        expected.append(MU0 * field + TRUE.w @ (TRUE.Js * langevin(play / TRUE.a)))
    np.testing.assert_allclose(TRUE.simulate(h)[:, 0], expected, atol=1e-12)
    walk = np.cumsum(np.random.default_rng(0).normal(0, 15, (200, 3)), axis=0)
    np.testing.assert_allclose(TRUE.simulate(walk), by_loop(walk, TRUE.Js, TRUE.a, TRUE.kappa, TRUE.w), atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_no_step_gives_energy_back(seed):
    rng = np.random.default_rng(seed)
    model = VectorHysteresis(*rng.uniform(0.1, 100, 2), rng.uniform(0, 100, 4), np.full(4, 0.25))
    lost = model.dissipation(np.cumsum(rng.normal(0, 60, (2000, 3)), axis=0))
    assert (lost >= -1e-12).all()
    assert lost.sum() > 0


def test_the_energy_over_a_closed_cycle_is_the_loss():
    angle = 2 * np.pi * np.linspace(0, 2, 8001)
    h, cycle = (
        np.column_stack([200 * np.cos(angle), 80 * np.sin(angle)]),
        slice(4000, None),
    )  # the second of two ellipses
    b, lost = TRUE.simulate(h)[cycle], TRUE.dissipation(h)[cycle]
    fine = np.sum(0.5 * (h[cycle][1:] + h[cycle][:-1]) * np.diff(b, axis=0))
    assert lost[1:].sum() == pytest.approx(fine, rel=5e-3)


def test_a_fit_finds_the_parameters():
    rng, records = np.random.default_rng(1), []
    for h in (alternating([1.0, 0.0]), alternating([0.3, 1.0], 120.0), rotating(60.0), rotating(150.0)):
        records.append(VectorRecord(h, TRUE.simulate(h) + rng.normal(0, 2e-3, h.shape)))
    found = VectorHysteresis.fit(records, cells=2)
    values, true = (np.concatenate([[m.Js, m.a], m.kappa, m.w]) for m in (found, TRUE))
    np.testing.assert_allclose(values, true, rtol=0.02)
    assert (np.abs(values - true) < 4 * found.stderr).all()
    assert (found.stderr < 0.02 * true).all()


def test_the_written_table_gives_the_loop_again(tmp_path):
    lines = TRUE.save_csv(tmp_path / "cells.csv").read_text().splitlines()
    rows = list(csv.DictReader(lines[1:]))
    of = lambda name: [float(row["value"]) for row in rows if row["name"] == name]
    h = rotating(150.0)
    np.testing.assert_allclose(by_loop(h, of("Js")[0], of("a")[0], of("kappa"), of("w")), TRUE.simulate(h), atol=1e-12)


def test_bad_input_is_refused():
    h = rotating(100.0)
    for bad in ((h, h[:-1]), (h[:, :1], h[:, :1]), (h[:5], h[:5]), (h, h * np.nan)):
        with pytest.raises(hf.HystfitError):
            VectorRecord(*bad)
    for bad in (
        (0.0, 1.0, [1.0], [1.0]),
        (1.0, 1.0, [1.0, 2.0], [1.0]),
        (1.0, 1.0, [-1.0], [1.0]),
        (1.0, 1.0, [1.0], [0.5]),
    ):
        with pytest.raises(hf.HystfitError):
            VectorHysteresis(*bad)
    with pytest.raises(hf.HystfitError):
        VectorHysteresis.fit([VectorRecord(h, MU0 * h)])
    with pytest.raises(hf.HystfitError):
        VectorHysteresis.fit([], cells=1)
