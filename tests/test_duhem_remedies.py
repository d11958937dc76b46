from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystfit.data.record import Record
from hystfit.errors import DataError, ParameterError
from hystfit.fitting.fit import fit
from hystfit.identify import bias_compensated, decimate, identify, integrated_regression
from hystfit.models.duhem import Duhem
from hystfit.models.shared.simulation import simulate
from hystfit.results.result import FitResult

ALPHA = 0.0874
TRUTH = Duhem.from_powers(
    ALPHA, np.array([-0.015, 0.006, 5.57e-6, -8.6e-8]) / ALPHA, [0.053, -0.83e-4, 8.1e-6], 0.0, 50.0, w0=1.5
)


def noisy(noise: float, seed: int, scheme: str = "midpoint") -> tuple[np.ndarray, Record]:
    """Noise-free and noisy output on a decaying sine of 2001 samples."""
    t = np.linspace(0, 2, 2001)
    u = 25 + 25 * np.sin(5 * np.pi * t) * np.exp(-t)
    model = Duhem(TRUTH.alpha, TRUTH.f, TRUTH.g, TRUTH.w0, TRUTH.center, TRUTH.half, scheme=scheme)
    y = np.asarray(simulate(model, u)[0])
    return y, Record(u=u, y=y + noise * np.random.default_rng(seed).normal(size=t.size))


def output_error(model: Duhem, record: Record) -> FitResult:
    """Least squares on the simulated output, started from integrated regression."""
    start = integrated_regression(model, record).model
    return fit(start, record, method="lm", start="model", starts=1, noise="iid")


def free_run_error(model: Duhem, record: Record, y: np.ndarray) -> float:
    return float(np.abs(np.asarray(simulate(model, record.u)[0]) - y).max())


@given(seed=st.integers(0, 2**32 - 1), increment=st.floats(0.01, 3.0), repeat=st.booleans())
@settings(max_examples=60)
def test_decimation_keeps_the_travel_and_every_increment(seed, increment, repeat):
    rng = np.random.default_rng(seed)
    u = np.cumsum(np.repeat(rng.normal(size=80), rng.integers(1, 5, 80)) * 0.3)
    u = np.repeat(u, 2) if repeat else u
    if np.ptp(u) <= 2 * increment:
        return
    record = Record(u=u, y=np.arange(u.size, dtype=float), t=0.1 * np.arange(u.size))
    thin = decimate(record, increment)
    at = thin.y.astype(int)
    np.testing.assert_array_equal(thin.u, u[at])
    np.testing.assert_array_equal(thin.t, record.t[at])
    assert (np.diff(at) > 0).all()
    travel = lambda v: np.abs(np.diff(v)).sum()
    assert travel(thin.u) == pytest.approx(travel(u[: at[-1] + 1]), rel=1e-9)  # no step hides a turning point
    short = np.flatnonzero(np.abs(np.diff(thin.u)) < increment - 1e-12)
    signs = np.sign(np.diff(thin.u))
    turns = {0, signs.size, *(np.flatnonzero(signs[1:] != signs[:-1]) + 1)}
    assert all(k + 1 in turns for k in short)  # only a turning point may end a shorter step


def test_decimation_adds_a_note_and_refuses_increments_that_are_too_large():
    _, record = noisy(0.0, 0)
    assert len(decimate(record, 2.0).notes) == len(record.notes) + 1
    with pytest.raises(ParameterError, match="must be positive"):
        decimate(record, 0.0)
    with pytest.raises(DataError, match="choose a smaller"):
        decimate(Record(u=np.linspace(0, 1, 9), y=np.zeros(9)), 5.0)


def test_decimation_removes_most_of_the_bias_of_explicit_regressors():
    pulls = {}
    for thin in (False, True):
        values = []
        for seed in range(5):
            _, record = noisy(0.005, seed, "explicit")
            record = decimate(record, 2.0) if thin else record
            values.append(identify(record, "rls", Duhem(scheme="explicit")).history[-1, 0] / ALPHA)
        pulls[thin] = abs(np.mean(values) - 1)
    assert pulls[False] > 1
    assert pulls[True] < 0.2 * pulls[False]


@pytest.mark.parametrize("scheme", ["midpoint", pytest.param("explicit", marks=pytest.mark.slow)])
def test_integrated_regression_and_output_error_have_little_bias(scheme):
    worst = {"rls": [], "integrated": [], "output error": []}
    for seed in range(4):
        y, record = noisy(0.02, seed, scheme)
        rls = identify(record, "rls", Duhem(scheme=scheme)).model
        integrated = integrated_regression(Duhem(scheme=scheme).start([record]), record)
        fitted = output_error(Duhem(scheme=scheme).start([record]), record)
        for name, model in (("rls", rls), ("integrated", integrated.model), ("output error", fitted.model)):
            worst[name].append((abs(float(model.alpha) / ALPHA - 1), free_run_error(model, record, y)))
        assert integrated.converged
        assert fitted.usable
        assert fitted.model.scheme == scheme
    alpha, error = (
        dict(zip(worst, column, strict=True)) for column in np.moveaxis([np.mean(v, 0) for v in worst.values()], 1, 0)
    )
    assert max(alpha["integrated"], alpha["output error"]) < 0.08 < alpha["rls"]
    assert max(error["integrated"], error["output error"]) < 0.9 * error["rls"]


def test_remedies_recover_the_truth_from_a_noise_free_record():
    y, record = noisy(0.0, 0)
    integrated = integrated_regression(Duhem().start([record]), record)
    assert free_run_error(integrated.model, record, y) < 1e-3 * np.ptp(y)
    fitted = output_error(Duhem().start([record]), record)
    np.testing.assert_allclose(fitted.model.powers()[0], TRUTH.powers()[0], rtol=1e-6, atol=1e-10)
    assert float(fitted.model.alpha) == pytest.approx(ALPHA, rel=1e-8)
    compensated = bias_compensated(Duhem(), record)
    assert float(compensated.model.alpha) == pytest.approx(ALPHA, rel=1e-5)


def test_bias_compensation_removes_the_mean_bias():
    plain, compensated = [], []
    for seed in range(10):
        _, record = noisy(0.02, seed)
        plain.append(identify(record).history[-1, 0] / ALPHA)
        compensated.append(float(bias_compensated(Duhem(), record).model.alpha) / ALPHA)
    assert abs(np.mean(plain) - 1) > 0.1
    assert abs(np.mean(compensated) - 1) < 0.25 * abs(np.mean(plain) - 1)


def test_bias_compensation_refuses_noise_that_is_too_large():
    y, record = noisy(0.0, 0)
    drowned = record.replace(y=record.y + 2.0 * np.random.default_rng(1).normal(size=y.size))
    with pytest.raises(DataError, match=r"too large to identify the rate.*method='lm'"):
        bias_compensated(Duhem(), drowned)
