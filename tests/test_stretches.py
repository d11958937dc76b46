"""Long records: residuals and derivatives by stretches of samples, and the memory that a fit needs."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

import hystfit as hf
from hystfit.data.dataset import Dataset
from hystfit.fitting.judgment import fit_warnings
from hystfit.inference import objective as whole
from hystfit.inference import stretches
from hystfit.inference.linearization import Linearization
from hystfit.inference.objective import misfit_of
from hystfit.inference.problem import Problem
from hystfit.quality import baselines


def loops(samples: int, name: str = "loops", seed: int = 0) -> hf.Record:
    """Noisy loops of growing amplitude, with an output that is missing in places and a window."""
    t, rng = np.arange(samples) * 1e-3, np.random.default_rng(seed)
    u = (1 + t) * np.sin(2 * np.pi * 3 * t)
    y = np.asarray(hf.simulate(hf.BoucWen(c=0.8, mu=0.3, tau=0.4, rho=0.2), u)[0]) + 0.01 * rng.normal(size=samples)
    y[samples // 3 : samples // 3 + 5] = np.nan
    return hf.Record(u=u, y=y, t=t, name=name).window(0.1, t[-20])


SEVERAL = Dataset((loops(700, "a"), loops(450, "b", 1), loops(901, "c", 2)))
CASES = {
    "one record": (hf.BoucWen(), loops(1000), "linear"),
    "first state": (hf.BoucWen(h0=0.3), loops(1000), "linear"),
    "robust": (hf.BoucWen(), loops(1000), "huber"),
    "composition with time": (hf.Series(hf.BoucWen(), hf.Lag(tau=0.01), hf.LogCreep()), loops(1000), "linear"),
    "offsets of records": (hf.BoucWen(), SEVERAL, "linear"),
}


@pytest.fixture(params=list(CASES))
def problem(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Problem:
    """Problems whose stretches have 64 or 128 samples."""
    model, data, loss = CASES[request.param]
    made = Problem(model, data, free=["h0"] if request.param == "first state" else (), loss=loss)  # type: ignore[arg-type]
    for name, value in (("NUMBERS", 500), ("_ENTRIES", 512), ("_FEWEST", 64)):
        monkeypatch.setattr(stretches, name, value)
    assert stretches.in_stretches(made.objective)
    return made


def test_derivatives_by_stretches_are_those_of_one_run(problem: Problem) -> None:
    x = problem.space.vector(problem.model)
    residual, jacobian = whole.linearized(problem.objective, x)
    found, derivatives = problem.linearize(x)
    np.testing.assert_allclose(found, residual, atol=1e-13)
    np.testing.assert_allclose(derivatives, jacobian, rtol=1e-9, atol=1e-12)


def test_the_factor_of_stretches_is_that_of_all_derivatives(problem: Problem) -> None:
    x = problem.space.vector(problem.model)
    misfit, jacobian = misfit_of(problem.objective, *whole.linearized(problem.objective, x))
    expected, found = Linearization.of(misfit, jacobian, problem.used.reshape(-1)), problem.linearization(x)
    assert found.joint is not None
    np.testing.assert_allclose(found.misfit, misfit, atol=1e-13)
    order, some = np.roll(np.arange(x.size), 2), np.arange(x.size) % 2 == 0
    for pair in (
        (found.factor(order), expected.factor(order)),
        (found.triangle(), expected.triangle()),
        (found.triangle(some), expected.triangle(some)),
    ):
        products = [factor.T @ factor for factor in pair]
        np.testing.assert_allclose(*products, rtol=1e-9, atol=1e-12 * np.abs(products[1]).max())
    np.testing.assert_allclose(found.columns(some), expected.columns(some), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.gradient(), expected.gradient(), rtol=1e-9, atol=1e-11)


def test_models_that_cannot_be_resumed_run_in_one_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stretches, "NUMBERS", 500)
    made = Problem(hf.BoucWenOscillator(m=1e-4, c=1e-3), loops(1000))
    assert not made.model.causal
    assert not stretches.in_stretches(made.objective)


def test_a_fit_of_a_long_record_needs_little_more_memory_than_its_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Arrays of NumPy: the derivatives of all samples, and copies of outputs and residuals, were 28 columns."""
    for module, name, value in (
        (stretches, "NUMBERS", 2**18),
        (baselines, "BLOCK", 2**12),
        (fit_warnings, "BLOCK", 2**12),
    ):
        monkeypatch.setattr(module, name, value)
    samples = 100_000
    t, rng = np.linspace(0, 20, samples), np.random.default_rng(0)
    u = (0.2 + 0.8 * np.sin(np.pi * t / 20) ** 2) * np.sin(2 * np.pi * t)
    y = np.asarray(hf.simulate(hf.BoucWen(c=1.0, mu=0.45, tau=1.5, rho=0.5), u)[0]) + rng.normal(0, 0.003, samples)

    compiling, record = hf.Record(u=u, y=y, t=t), hf.Record(u=u, y=y, t=t)
    hf.fit(hf.BoucWen(), compiling, starts=1)
    tracemalloc.start()
    hf.fit(hf.BoucWen(), record, starts=1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 12 * 8 * samples
