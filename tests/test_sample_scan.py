"""Scans that end at the length of a record: programs then serve records of any length."""

import contextlib
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hystfit as hf
from hystfit.config import expect_few_runs
from hystfit.data.batch import Batch, room
from hystfit.data.batch import _roomy as kept_with_room
from hystfit.inference import objective
from hystfit.models.shared.sample_scan import first_samples, scan_samples
from hystfit.models.shared.simulation import AbstractDynamics, run

TIME = np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 150)) * 1e-3
LOOP = dict(c=1.1, mu=0.5, tau=1.7, rho=0.4)
PLAYS = dict(w=[[0.2, 0.1, 0.4]], r=(0.05, 0.17, 0.33), low=-1.1, high=1.2)
# Each with a scan of its own, or a composition of such models.
MODELS = {
    "bouc-wen": hf.BoucWen(**LOOP),
    "bouc-wen, exact": hf.BoucWen(**LOOP, scheme="exact"),
    "asymmetric": hf.AsymmetricBoucWen(**LOOP, skew=0.2, b=(0.1, -0.05), n=1.6),
    "hardening stops": hf.PrandtlIshlinskii(operator="stop", hardening=(0.1, -0.2, 0.3), s0=2.0, **PLAYS),
    "oscillator": hf.BoucWenOscillator(m=0.01, c=0.05, r_unl=0.7, n=1.5, between="linear"),
    "lag before plays and creep": hf.Series(
        hf.Lag(tau=0.002), hf.Sum(hf.PrandtlIshlinskii(**PLAYS), hf.LinearCreep(a=(0.1, 0.2), tau=(0.01, 0.1)))
    ),
    "creep before a resonance": hf.Series(
        hf.LogCreep(gamma=(0.02, 0.01), tau=(0.05, 0.5), weights=(0.9, 0.8)), hf.SecondOrder(omega=900.0, zeta=0.2)
    ),
}


def _loop(count: int) -> np.ndarray:
    return np.sin(np.linspace(0, 12, count)) * np.linspace(0.4, 1.0, count)


@pytest.mark.parametrize(("rows_per_sample", "samples_per_row", "unroll"), [(1, 1, 1), (3, 1, 2), (1, 4, 1)])
def test_the_first_samples_are_those_of_a_plain_loop(rows_per_sample, samples_per_row, unroll):
    rows = np.random.default_rng(0).normal(size=(24, 2))
    body = lambda carry, row: (carry * row[0] + row[1], carry)

    @jax.jit
    def counted(count, carry):
        with first_samples(count):
            return scan_samples(
                body,
                carry,
                jnp.asarray(rows),
                rows_per_sample=rows_per_sample,
                samples_per_row=samples_per_row,
                unroll=unroll,
            )

    for count in (1, 5, 8):
        steps = -(-count // samples_per_row) * rows_per_sample
        carry, slope, expected, slopes = 0.3, 1.0, [], []
        for gain, push in rows[:steps]:
            expected.append(carry)
            slopes.append(slope)
            carry, slope = carry * gain + push, slope * gain
        (_, outputs), (_, along) = jax.jvp(lambda c, n=count: counted(n, c), (0.3,), (1.0,))
        np.testing.assert_allclose(outputs[:steps], expected, rtol=1e-12)
        np.testing.assert_allclose(along[:steps], slopes, rtol=1e-12)


@pytest.mark.parametrize("name", MODELS)
def test_outputs_in_longer_arrays_are_those_in_arrays_of_its_own(name):
    u, dt = _loop(150), np.diff(TIME, prepend=TIME[0])
    y = np.asarray(hf.simulate(MODELS[name], u, dt)[0])
    problem = hf.Problem(MODELS[name], hf.Record(u=u, y=y + 0.1, t=TIME))
    with expect_few_runs(long=True):
        assert room(150) > problem.objective.batch.u.shape[1]
        output = problem.predict(problem.space.vector(MODELS[name]))[0]
    np.testing.assert_allclose(output, y, rtol=1e-9, atol=1e-9 * np.abs(y).max())


@pytest.mark.parametrize(
    "name",
    [
        name
        if name in ("bouc-wen", "hardening stops", "lag before plays and creep")
        else pytest.param(name, marks=pytest.mark.slow)
        for name in MODELS
    ],
)
def test_derivatives_in_longer_arrays_are_those_in_arrays_of_its_own(name):
    u = _loop(150)
    model = MODELS[name]
    y = np.asarray(hf.simulate(model, u, np.diff(TIME, prepend=TIME[0]))[0])
    problem = hf.Problem(model, hf.Record(u=u, y=y + 0.1, t=TIME))
    x = problem.space.vector(model)
    alone = objective.linearized(problem.objective, x)
    with expect_few_runs(long=True):
        assert room(150) > problem.objective.batch.u.shape[1]
        shared = objective.linearized(problem.objective, x)
    for one, other in zip(shared, alone, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())


def test_records_of_any_length_share_a_program(monkeypatch):
    """A comparison compiled eight programs for each new length, which took longer than its fits."""
    traced = []
    monkeypatch.setattr(objective, "run", lambda *of, **count: traced.append(of) or run(*of, **count))
    slow = hf.BoucWen(c=1.1, mu=0.5, tau=1.7, rho=0.4)

    class Own(hf.BoucWen):
        """A class of its own, whose programs no other test has made."""

    model, counts = Own(c=slow.c, mu=slow.mu, tau=slow.tau, rho=slow.rho), []
    with expect_few_runs():
        for count in (150, 400, 2500):
            u = _loop(count)
            problem = hf.Problem(model, hf.Record(u=u, y=u))
            residual, _ = problem.linearize(problem.space.vector(model))
            np.testing.assert_allclose(residual[0, :count], np.asarray(hf.simulate(slow, u)[0]) - u, atol=1e-12)
            counts.append(len(traced))
    assert counts[0] == counts[-1] > 0


def test_longer_arrays_are_made_once_and_forgotten_with_their_batch():
    batch = Batch.of(hf.Record(u=_loop(150), y=_loop(150)))
    with expect_few_runs():
        first = batch.with_room()
        assert batch.with_room() is first
        other = batch.with_room(np.array([60]))
        np.testing.assert_array_equal(other.counts, [60])  # type: ignore[arg-type]
        np.testing.assert_array_equal(batch.with_room().counts, [150])  # type: ignore[arg-type]
        changed = dataclasses.replace(batch, y=2 * batch.y).with_room()
        np.testing.assert_array_equal(changed.y[0, :150], 2 * _loop(150))
    assert batch.with_room().u.shape[1] < first.u.shape[1]  # where programs are not shared
    key = id(batch)
    assert key in kept_with_room
    del batch
    assert key not in kept_with_room


def test_the_output_of_a_record_that_is_not_fitted_to_its_end_is_whole():
    u = _loop(150)
    record = hf.Record(u=u, y=u, weight=(np.arange(150) < 60).astype(float))
    model = MODELS["bouc-wen"]
    with expect_few_runs():
        problem = hf.Problem(model, record)
        np.testing.assert_array_equal(Batch.of(record).with_room().counts, [60])  # type: ignore[arg-type]
        output = problem.predict(problem.space.vector(model))[0]
        free = AbstractDynamics.free_run(model, u)
    expected = np.asarray(hf.simulate(model, u)[0])
    np.testing.assert_allclose(output, expected, rtol=1e-12)
    np.testing.assert_allclose(free, expected, rtol=1e-12)


@pytest.mark.parametrize("shared", [False, True])
def test_a_problem_that_is_cut_to_its_window_keeps_its_residuals(shared):
    """Its arrays are shorter than its record: a scan over all samples of the record wrote the others over the last output."""
    u = _loop(150)
    record = hf.Record(u=u, y=0.9 * u, weight=(np.arange(150) < 64).astype(float))
    model = MODELS["bouc-wen"]
    problem = hf.Problem(model, record)
    x = problem.space.vector(model)
    expected = (np.asarray(hf.simulate(model, u)[0]) - record.y)[:64]
    with expect_few_runs() if shared else contextlib.nullcontext():
        residual = problem.trimmed().residuals(x)
    np.testing.assert_allclose(residual[0], np.pad(expected, (0, residual.shape[1] - 64)), atol=1e-12)
