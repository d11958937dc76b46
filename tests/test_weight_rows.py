"""Loops over one input whose weights are found together, beside `hystfit.fit` of each."""

from __future__ import annotations

import functools

import equinox as eqx
import numpy as np
import pytest
from scipy.signal import lfilter

import hystfit as hf
from hystfit.batch import work
from hystfit.batch.row import Row, row_of
from hystfit.outcome import Status

SAMPLES = 400
T = np.arange(SAMPLES) / 100
INPUTS = {
    "from zero": 3 * np.sin(2 * np.pi * T) * (0.4 + 0.6 * T / T[-1]),
    "from its range": 3 * np.cos(2 * np.pi * T) * (0.4 + 0.6 * T / T[-1]),
}
MODELS = {
    "plays": hf.PrandtlIshlinskii.of(12),
    "stops": hf.PrandtlIshlinskii.of(8, 3, operator="stop"),
    "cells with one weight held": hf.Preisach.of(n=6),
}


def record(u: np.ndarray, y: np.ndarray, name: str) -> hf.Record:
    return hf.Record(u=u, y=y, t=T, u_unit="V", y_unit="um", name=name)


@functools.cache
def devices(model: str, place: str, count: int = 12) -> tuple[hf.Record, ...]:
    """Loops of devices with random weights of which a third are zero, of all sizes and levels.

    The last but two is far from zero, the last but one has slow noise, the last an outlier. Half of the plays over a full range rested at
    the first input.
    """
    rng, u, records = np.random.default_rng(1), INPUTS[place], list[hf.Record]()
    start = MODELS[model].start([record(u, u, "")])
    for k in range(count):
        weights = np.abs(rng.normal(size=start.w.shape)) * (rng.random(start.w.shape) > 0.3)
        one = eqx.tree_at(lambda m: m.w, start, weights)
        one = one.with_rest("first") if place == "from its range" and k % 2 else one
        clean = 10 ** rng.uniform(-1, 1) * (one.free_run(u) + rng.normal())
        noise = rng.normal(size=SAMPLES)
        if k == count - 2:
            noise += 0.3 * lfilter([1], [1, -0.95], rng.normal(size=SAMPLES))
        y = clean + 0.004 * np.ptp(clean) * noise + (k == count - 3) * 1e3 * np.ptp(clean)
        y[50] += (k == count - 1) * np.ptp(clean)
        records.append(record(u, y, f"{place} {k}"))
    return tuple(records)


def same(row: Row, wanted: Row, span: float) -> None:
    """Estimates to 1e-6 of their errors, errors to 1e-3, everything else."""
    assert (row.status, row.codes, row.reason) == (wanted.status, wanted.codes, wanted.reason)
    assert (row.units, row.samples, row.model) == (wanted.units, wanted.samples, wanted.model)
    for name, value in wanted.values.items():
        error, mine = wanted.stderr[name], row.stderr[name]
        assert (error is None) is (mine is None), name
        assert abs(row.values[name] - value) <= 1e-6 * (span if error is None else error)
        assert error is None or mine == pytest.approx(error, rel=1e-3)
    for name, value in wanted.quantities.items():
        assert row.quantities[name] == pytest.approx(value, rel=1e-6)
    for name in ("rmse", "error_percent", "max_error_percent"):
        assert getattr(row, name) == pytest.approx(getattr(wanted, name), rel=1e-6)


@pytest.mark.parametrize("model", MODELS)
def test_rows_are_those_of_fit(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Most are judged together, one with slow noise too; one with an outlier is fitted alone."""
    records, judged, solved = devices(model, "from zero"), list[str](), list[int]()
    judge, solve = work._judge, work.solve
    monkeypatch.setattr(work, "_judge", lambda task, loop: judged.append(loop.name) or judge(task, loop))
    monkeypatch.setattr(work, "solve", lambda *arguments: solved.append(1) or solve(*arguments))
    fix = {"w[3]": 0.01} if "held" in model else {}
    rows = hf.fit_many(MODELS[model], records, fix=fix)
    assert "from zero 11" in judged
    assert len(judged) <= 5
    assert len(solved) == 1
    slow = rows["from zero 10"]
    assert "error-ratio" in slow.codes
    assert (slow.name in judged) is (model == "stops")
    for k in (1, 9, 10):
        one = records[k]
        same(rows[one.name], row_of("", "", one, hf.fit(MODELS[model], one, fix=fix)), float(np.ptp(one.y)))


def test_devices_at_rest_in_another_state_are_fitted_alone() -> None:
    """Where the input does not begin at zero, each loop decides where it rested; loops over another input have columns of their own."""
    records = [*devices("plays", "from its range", 10), *devices("plays", "from zero")[:9]]
    rows = hf.fit_many("prandtl-ishlinskii", records)
    assert all(row.status is Status.OK for row in rows)
    for k in (2, 3, 12):
        one = records[k]
        same(rows[one.name], row_of("", "", one, hf.fit("prandtl-ishlinskii", one)), float(np.ptp(one.y)))


def test_a_map_of_plays_is_that_of_fit() -> None:
    records = devices("plays", "from zero")
    found = hf.fit_map(
        MODELS["plays"], INPUTS["from zero"], np.stack([r.y for r in records]), T, u_unit="V", y_unit="um"
    )
    assert (~found.alone).sum() >= 7
    assert found.alone[-1]
    alone = hf.fit(MODELS["plays"], records[4])
    for p in alone.parameters:
        if not p.fixed:
            assert found[p.name][4] == pytest.approx(p.value, abs=1e-6 * (p.stderr or np.ptp(records[4].y)))


def test_a_map_without_hysteresis_has_the_verdict_of_fit() -> None:
    rng, u = np.random.default_rng(2), INPUTS["from zero"]
    y = u**3 + 0.01 * np.ptp(u**3) * rng.normal(size=(8, SAMPLES))
    found = hf.fit_map(MODELS["plays"], u, y, T)
    wanted = [hf.fit(MODELS["plays"], record(u, row, "")).status for row in y[:2]]
    assert found.statuses[:2].tolist() == [str(status) for status in wanted]
