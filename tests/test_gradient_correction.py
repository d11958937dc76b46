from __future__ import annotations

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hystfit.data.record import Record
from hystfit.errors import ParameterError
from hystfit.identify import DuhemRegressor, GradientCorrection, Sample, identify, run_stream
from hystfit.identify.gradient_correction import check_weights
from hystfit.models.duhem import Duhem
from hystfit.models.shared.simulation import simulate
from hystfit.outcome import Code, Status
from hystfit.outcome.note import has


def surrogate(noise: float = 0.0) -> tuple[Duhem, Record]:
    """The paper's parameters on a decaying sine of 2001 samples, at rest on its anhysteretic curve."""
    t = np.linspace(0, 2, 2001)
    u = 25 + 25 * np.sin(5 * np.pi * t) * np.exp(-t)
    f = np.array([-0.015, 0.006, 5.57e-6, -8.6e-8]) / 0.0874
    model = Duhem.from_powers(0.0874, f, [0.053, -0.83e-4, 8.1e-6], 0.0, 50.0, w0=float(np.polyval(f[::-1], 25.0)))
    y = np.asarray(simulate(model, u)[0]) + noise * np.random.default_rng(0).normal(size=t.size)
    return model, Record(u=u, y=y)


MODEL, RECORD = surrogate()
REGRESSOR = DuhemRegressor.of(MODEL, [RECORD])
TRUTH = REGRESSOR.theta(MODEL)
ROWS = REGRESSOR.rows(RECORD)
vectors = st.lists(st.floats(-1, 1), min_size=8, max_size=8).map(np.array)
sizes = st.lists(st.floats(0.1, 10.0), min_size=8, max_size=8).map(np.array)


def one_row(identifier: GradientCorrection, at: int, count: int = 0):
    """theta before and after the row that ends at a sample, and the row."""
    state = identifier.init()._replace(
        last=jnp.asarray([RECORD.u[at - 1], RECORD.y[at - 1]]), count=jnp.asarray(count, dtype=int)
    )
    after, _ = run_stream(identifier, state, Sample.of(RECORD.u[at : at + 1], RECORD.y[at : at + 1], [0.0], [False]))
    return np.asarray(state.theta), np.asarray(after.theta), ROWS.phi[at - 1], ROWS.target[at - 1]


def test_the_papers_form_is_its_equation_8():
    """Raw columns, weights 1/q^i and the normalized step, against a plain loop."""
    weights = 30.0 ** -np.array([0, 1, 2, 3, 0, 0, 1, 2])
    u, w = RECORD.u[:200], RECORD.y[:200]
    theta = np.zeros(8)
    for v0, v1, w0, w1 in zip(u, u[1:], w, w[1:], strict=False):
        v, d = 0.5 * (v0 + v1), v1 - v0
        a = abs(d)
        phi = np.array([a, a * v, a * v**2, a * v**3, -a * 0.5 * (w0 + w1), d, d * v, d * v**2])
        theta = theta + 0.5 / (0.1 + phi @ (weights * phi)) * weights * phi * (w1 - w0 - phi @ theta)
    record = Record(u=u, y=w)
    made = GradientCorrection.of(Duhem(), record, start="zero", basis="powers", weights=weights, mu=0.5, floor=0.1)
    np.testing.assert_allclose(made.fit(record).theta, theta, rtol=1e-9, atol=1e-18)
    with pytest.raises(ParameterError, match="legendre, powers"):
        GradientCorrection.of(Duhem(), record, basis="cubes")


@given(start=vectors, weights=sizes, mu=st.floats(0.05, 1.95), floor=st.floats(0, 5), at=st.integers(1, 2000))
@settings(max_examples=60)
def test_weighted_error_decreases_by_the_proven_amount(start, weights, mu, floor, at):
    identifier = GradientCorrection(
        REGRESSOR, jnp.asarray(TRUTH + start), jnp.asarray(weights), jnp.asarray(mu), jnp.asarray(floor)
    )
    before, after, phi, target = one_row(identifier, at)
    power = phi @ (weights * phi)
    assume(power > 1e-10)
    c, e = mu / (floor + power), target - phi @ before
    V = lambda theta: np.sum((theta - TRUTH) ** 2 / weights)
    np.testing.assert_allclose(
        V(before) - V(after), c * e**2 * (2 - c * power), rtol=1e-6, atol=1e-9 * V(before) + 1e-20
    )


@given(start=vectors, weights=sizes, leader=st.integers(0, 7), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_error_never_grows_under_weights_that_meet_the_condition(start, weights, leader, seed):
    rng = np.random.default_rng(seed)
    ratio = np.exp(0.01 * rng.normal(size=(199, 8)))
    ratio[:, leader] = ratio.min(axis=1)  # the leader has the largest relative decrease at every row
    schedule = weights * np.vstack([np.ones(8), np.cumprod(ratio, axis=0)])
    identifier = GradientCorrection(REGRESSOR, jnp.asarray(TRUTH + start), jnp.asarray(check_weights(schedule, 8)))
    data = RECORD.segment(0, 201)
    _, info = run_stream(identifier, identifier.init(), Sample.stream([data]))
    theta = np.asarray(info.theta)[1:]
    V = np.sum(schedule[:, leader : leader + 1] / schedule * (theta - TRUTH) ** 2, axis=1)
    assert (np.diff(V) <= 1e-9 * V[:-1] + 1e-20).all()


@given(ratio=st.lists(sizes, min_size=1, max_size=4), leader=st.integers(-1, 7))
@settings(max_examples=200)
def test_both_forms_of_the_papers_condition_are_what_is_checked(ratio, leader):
    ratio = np.array(ratio)
    if leader >= 0:
        ratio[:, leader] = ratio.min(axis=1) * 0.99
    weights = np.vstack([np.ones(8), np.cumprod(ratio, axis=0)])
    now, later = weights[:-1], weights[1:]
    forms = []
    for below in (now, later):
        decrease = (now - later) / below
        forms.append(any((decrease[:, [m]] >= decrease - 1e-13).all() for m in range(8)))
    assert forms[0] == forms[1]
    if forms[0]:
        check_weights(weights, 8)
    else:
        with pytest.raises(ParameterError, match="largest relative decrease"):
            check_weights(weights, 8)


def test_whole_step_without_floor_satisfies_the_row_exactly():
    identifier = GradientCorrection(REGRESSOR, jnp.zeros(8), jnp.arange(1.0, 9.0), jnp.asarray(1.0), jnp.asarray(0.0))
    before, after, phi, target = one_row(identifier, 700)
    assert abs(target - phi @ before) > 1e-3
    assert abs(target - phi @ after) < 1e-13
    correction = (after - before) / (np.arange(1.0, 9.0) * phi)
    np.testing.assert_allclose(correction, correction[0], rtol=1e-9)  # along Lambda phi


def test_schedule_of_weights_is_followed_row_by_row_and_its_end_stays():
    schedule = np.outer([1.0, 0.5, 0.25], np.ones(8))
    for count, weight in ((0, 1.0), (1, 0.5), (2, 0.25), (9, 0.25)):
        moved = [
            one_row(GradientCorrection(REGRESSOR, jnp.zeros(8), jnp.asarray(w)), 700, count)[1]
            for w in (schedule, np.full(8, weight))
        ]
        np.testing.assert_array_equal(*moved)


def test_constant_step_is_bounded():
    good = GradientCorrection.of(Duhem(), RECORD, start="zero", step=1e-3)
    weights = np.asarray(good.weights)
    bound = 2 / np.max(ROWS.phi**2 @ weights)
    with pytest.raises(ParameterError, match=r"step must lie in \(0, 0\.\d+\)"):
        GradientCorrection.of(Duhem(), RECORD, step=1.01 * bound)
    at = 700
    before, after, phi, target = one_row(good, at)
    np.testing.assert_allclose(after - before, 1e-3 * weights * phi * (target - phi @ before), rtol=1e-9)
    wild = dataclasses.replace(good, step=jnp.asarray(100.0))  # beyond the bound on-line: the normalized step instead
    before, after, phi, target = one_row(wild, at)
    assert abs(target - phi @ after) < 1e-12


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"mu": 2.0}, "mu must lie in"),
        ({"mu": 0.0}, "mu must lie in"),
        ({"floor": -1.0}, "floor must not be negative"),
        ({"weights": np.ones(7)}, r"shape \(8,\)"),
        ({"weights": np.zeros(8)}, "positive and finite"),
        ({"start": "best"}, "start must be one of zero, model, data"),
        ({"step": -1.0}, "step must lie in"),
    ],
)
def test_settings_out_of_range_are_refused(setting, words):
    with pytest.raises(ParameterError, match=words):
        identify(RECORD, "gradient-correction", **setting)


def test_one_noise_free_pass_from_forty_starts_within_a_tenth():
    """The known limit of the method: half the starts within 10 % of the paper's parameters reach 2.5 % of range."""
    base = GradientCorrection.of(MODEL, RECORD, start="model", floor=1.0)
    powers, stream = REGRESSOR.powers(TRUTH), Sample.stream([RECORD])
    errors, starts = [], []
    for seed in range(40):
        off = powers * (1 + np.random.default_rng(seed).uniform(-0.1, 0.1, 8))
        identifier = eqx.tree_at(lambda g: g.theta0, base, jnp.asarray(REGRESSOR.from_powers(off)))
        state, _ = run_stream(identifier, identifier.init(), stream)
        for theta, kept in ((np.asarray(identifier.theta0), starts), (np.asarray(state.theta), errors)):
            run = np.asarray(simulate(REGRESSOR.model(theta, float(MODEL.w0)), RECORD.u)[0])
            kept.append(100 * np.abs(run - RECORD.y).max() / np.ptp(RECORD.y))
    assert np.median(errors) <= 2.5
    assert np.median(errors) < 0.5 * np.median(starts)


def test_many_passes_converge_to_the_truth_without_noise():
    near = eqx.tree_at(lambda m: m.f, MODEL, 1.05 * MODEL.f)
    one, many = (identify(RECORD, "gradient-correction", near, start="model", passes=k) for k in (1, 100))
    assert many.free_run.max_error_percent < 0.1 * one.free_run.max_error_percent
    assert many.free_run.max_error_percent < 0.2
    assert many.status is Status.OK
    assert many.counts["used"] == 100 * 2000


def test_without_floor_it_diverges_on_noisy_data():
    _, noisy = surrogate(noise=0.005)
    with_floor = identify(noisy, "gradient-correction", MODEL, start="model", floor=10.0)
    without = identify(noisy, "gradient-correction", MODEL, start="model", floor=0.0)
    far = lambda found: np.linalg.norm(found.theta - TRUTH) / np.linalg.norm(TRUTH)
    assert far(with_floor) < 0.2
    assert far(without) > 20
    assert without.status is Status.DIVERGED
    assert has(without.notes, Code.STEP_SIZE)
    assert has(without.notes, Code.ONE_STEP_ERROR, Code.DIVERGED)
    assert not has(with_floor.notes, Code.STEP_SIZE)


def test_from_zero_one_pass_does_not_converge():
    found = identify(RECORD, "gradient-correction", start="zero")
    assert found.status is Status.NOT_CONVERGED
    assert has(found.notes, Code.ONE_STEP_ERROR)
