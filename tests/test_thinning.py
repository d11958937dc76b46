"""Starts on a short form of the records, and the polish on all samples."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

import hystfit as hf
from hystfit.data.batch import bucket
from hystfit.fitting.solvers.polish import polish
from hystfit.fitting.solvers.thinning import coarse, thin
from hystfit.inference import blocks
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.starting import best_column

TRUTH = {"c": 0.15, "mu": 0.4, "tau": 0.02, "rho": 0.3, "offset": 0.5}


def loops(samples: int, seed: int = 1, noise: float = 0.01) -> hf.Record:
    """A decaying sine through a Bouc-Wen model, with white noise."""
    t = np.linspace(0, 20, samples)
    u = 50 + (0.2 + 0.8 * np.sin(np.pi * t / 20) ** 2) * 50 * np.sin(2 * np.pi * 0.5 * t)
    y = np.asarray(hf.simulate(hf.BoucWen(**TRUTH), u)[0])
    return hf.Record(u=u, y=y + np.random.default_rng(seed).normal(0, noise, samples), t=t)


def problem(*records: hf.Record, model: AbstractHysteresis | None = None) -> Problem:
    data = list(records)
    return Problem((model or hf.BoucWen()).start(data), data)


def test_the_short_form_keeps_reversals_time_and_the_simulated_output():
    record = loops(20_000)
    made = problem(record)
    short = thin(made)
    assert short is not None
    u, dt, weight = (np.asarray(values)[0] for values in (short.batch.u, short.batch.dt, short.batch.weight))
    assert u.size == 1024
    # Every extreme of the input, found by hand: a sample larger (or smaller) than both neighbors.
    inner = record.u[1:-1]
    extremes = inner[(inner - record.u[:-2]) * (inner - record.u[2:]) > 0]
    assert extremes.size == 20
    assert np.isin(extremes, u[weight > 0]).all()
    assert np.sum(dt) == pytest.approx(np.sum(record.dt), rel=1e-12)
    # The model's output on it is its output on all samples there, up to the error of the longer steps.
    x = made.space.vector(hf.BoucWen(**TRUTH))
    rough = np.asarray(short.predict(jnp.asarray(x)))[0][weight > 0]
    at = np.flatnonzero(np.isin(record.u, u[weight > 0]))
    whole = dict(zip(record.u[at], made.predict(x)[0][at], strict=True))
    exact = np.array([whole[value] for value in u[weight > 0]])
    assert np.max(np.abs(rough - exact)) < 2e-3 * np.ptp(exact)


def test_missing_samples_and_windows_stay_without_weight():
    record = loops(20_000)
    y = record.y.copy()
    y[::3] = np.nan
    made = problem(hf.Record(u=record.u, y=y, t=record.t).window(start=2.0))
    short = thin(made)
    assert short is not None
    t = np.cumsum(np.asarray(short.batch.dt)[0])
    weight = np.asarray(short.batch.weight)[0]
    assert not weight[t < 1.99].any()
    assert np.mean(weight[(t > 2.1) & (np.arange(t.size) < 1000)] == 0) == pytest.approx(1 / 3, abs=0.05)


@pytest.mark.parametrize(
    ("samples", "model"),
    [(1500, hf.BoucWen()), (20_000, hf.Series(hf.Delay(), hf.BoucWen())), (20_000, hf.Series(hf.Lag(), hf.BoucWen()))],
    ids=["short record", "delay in samples", "lag of a few samples"],
)
def test_short_records_and_models_with_short_delays_are_not_thinned(samples, model):
    assert thin(problem(loops(samples), model=model)) is None


def test_many_reversals_keep_samples_between_them():
    t = np.linspace(0, 20, 4000)
    record = loops(4000).replace(u=np.sin(2 * np.pi * 20 * t), t=t)  # 800 reversals, five samples between two of them
    assert thin(problem(record)) is None


def test_the_fit_of_a_long_record_is_that_of_a_bounded_solver_on_all_samples():
    record = loops(20_000, noise=0.002)
    found = hf.fit("bouc-wen", record, noise="iid")
    oracle = hf.fit("bouc-wen", record, noise="iid", method="trf", starts=1)
    errors = np.sqrt(np.diag(found.covariance))
    assert np.isfinite(errors).all()
    assert np.all(np.abs(found.x - oracle.x) < 1e-4 * errors)
    # A fit on the short form alone would be off by its own, larger standard errors.
    assert found.train.rmse == pytest.approx(oracle.train.rmse, rel=1e-10)


def test_polish_reaches_the_minimum_that_minpack_finds():
    made = problem(loops(3000))
    start = made.space.unconstrained(np.array([0.14, 0.5, 0.03, 0.0, 0.0]))
    found = polish(made, start)
    oracle = scipy.optimize.leastsq(lambda z: made.misfit(made.space.physical(z)), start, ftol=1e-14, xtol=1e-14)[0]
    assert found.converged
    scatter = np.sqrt(np.diag(np.linalg.inv(_normal(made, oracle))) * 2 * found.cost / 2995)
    assert np.all(np.abs(found.z - oracle) < 1e-3 * scatter)
    assert found.evaluations < 15
    assert found.linearized is not None
    misfit, jacobian = made.linearize_misfit(made.space.physical(found.z))
    np.testing.assert_array_equal(found.linearized.misfit, misfit)
    np.testing.assert_array_equal(found.linearized.columns(np.ones(start.size, bool)), jacobian[made.used[0]])


def test_the_factor_in_blocks_is_that_of_all_rows(monkeypatch):
    rows, last = np.random.default_rng(0).normal(size=(50, 3)), np.arange(50.0)
    order = np.array([2, 0, 1])
    joint = np.column_stack([rows[:, order], last])
    monkeypatch.setattr(blocks, "ENTRIES", 28)  # 7 rows of four columns
    monkeypatch.setattr(blocks, "TALL", 1)
    parts = list(blocks.beside(rows, last, order))
    assert {len(part) for part in parts} == {7, 1}
    np.testing.assert_array_equal(np.vstack(parts), joint)
    factor = blocks.triangle(parts, 4)
    np.testing.assert_allclose(factor.T @ factor, joint.T @ joint, rtol=1e-12)


def test_polish_that_stops_at_its_limit_has_not_converged():
    made = problem(loops(3000))
    found = polish(made, made.space.unconstrained(np.array([0.14, 0.5, 0.03, 0.0, 0.0])), steps=2)
    assert not found.converged


@pytest.mark.parametrize("offset", [1e160, -1e300])
def test_polish_from_an_offset_that_has_run_away_has_not_converged(offset):
    made = problem(loops(1500))
    found = polish(made, made.space.unconstrained(np.array([0.14, 0.5, 0.03, 0.0, offset])))
    assert not found.converged


def test_padding_of_long_records_is_at_most_a_tenth():
    lengths = np.unique(np.geomspace(64, 1e7, 4000).astype(int))
    sizes = np.array([bucket(int(length)) for length in lengths])
    assert (sizes >= lengths).all()
    long = lengths >= 4096
    assert np.max(sizes[long] / lengths[long]) < 1.1
    assert len(set(sizes[lengths <= 4096])) <= 13  # few shapes, hence few compilations, for short records


def test_the_best_companion_is_that_of_separate_least_squares():
    rng = np.random.default_rng(0)
    fixed, candidates = rng.normal(size=(60, 3)) * [1.0, 1e3, 1e-3], rng.normal(size=(60, 12))
    y = fixed @ [1.0, 2e-3, 5e2] + 0.3 * candidates[:, 7] + 0.05 * rng.normal(size=60)
    costs = [np.linalg.lstsq(np.column_stack([fixed, column]), y, rcond=None)[1][0] for column in candidates.T]
    assert best_column(fixed, candidates, y) == int(np.argmin(costs)) == 7
    spanned = np.column_stack([fixed @ [1.0, 1.0, 1.0], candidates])
    assert best_column(fixed, spanned, y) == 8


def _normal(made: Problem, z: np.ndarray) -> np.ndarray:
    jacobian = made.linearize_misfit(made.space.physical(z))[1] * made.space.slope(z)
    return jacobian.T @ jacobian


def test_a_model_without_an_offset_is_polished() -> None:
    """Rounding errors are judged by the output alone where no parameter is an offset."""
    t = np.linspace(0.0, 3.0, 300)
    u = np.sin(2 * np.pi * t)
    y = np.asarray(hf.simulate(hf.Lag(tau=0.05, rest="first"), u, float(t[1]))[0])
    found = hf.fit(hf.Lag(tau=0.02, rest="first"), hf.Record(u=u, y=y, t=t), start="model", starts=1, noise="iid")
    assert found.values["tau"] == pytest.approx(0.05, rel=1e-6)


class TestMeans:
    """Means of several samples stand for them where models are compared on long records."""

    def test_they_are_the_means_and_carry_the_weight_of_the_samples_that_count(self):
        record = loops(200_000)
        y, weight = record.y.copy(), np.ones(len(record))
        y[1000:1010], weight[:7] = np.nan, 0.0
        (short,) = coarse(hf.Dataset.of(record.replace(y=y, weight=weight)))
        step = len(record) // len(short)
        assert step == 6
        for k in (0, 1, 166, 167, 168, 5000):
            part = slice(step * k, step * (k + 1))
            counted = np.isfinite(y[part]) & (weight[part] > 0)
            assert short.u[k] == pytest.approx(record.u[part].mean())
            assert short.t[k] == pytest.approx(record.t[part].mean())
            assert short.weight[k] == pytest.approx(counted.mean())
            if counted.any():
                assert short.y[k] == pytest.approx(y[part][counted].mean())
        noise = np.std(np.diff(short.y[1000:], 3)) / np.sqrt(20)  # third differences of white noise
        assert noise == pytest.approx(0.01 / np.sqrt(step), rel=0.05)

    def test_few_samples_and_fast_signals_stay(self):
        assert len(coarse(hf.Dataset.of(loops(50_000)))[0]) == 50_000
        record = loops(200_000, noise=0.0)
        ringing = 0.2 * np.sin(2 * np.pi * np.arange(len(record)) / 25)
        assert len(coarse(hf.Dataset.of(record.replace(y=record.y + ringing)))[0]) == len(record)

    def test_a_comparison_finds_the_model_on_them(self):
        record = loops(400_000)
        found = hf.compare(record, ["bouc-wen", "prandtl-ishlinskii"])
        assert found.rows[0].name == "bouc-wen"
        winner = found.winner
        assert len(winner.data[0]) < 40_000
        assert any("means of 13 samples" in str(note) for note in winner.data[0].notes)
        for name, value in TRUTH.items():
            # the step of the model's integration differs by as much as the means are apart
            assert winner[name].value == pytest.approx(value, abs=4 * winner[name].stderr + 2e-3 * abs(value))
