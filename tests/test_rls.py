from __future__ import annotations

import dataclasses
import itertools
import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystfit.data.record import Record
from hystfit.errors import DataError, ModelError, ParameterError
from hystfit.identify import DuhemRegressor, Rls, Sample, as_fit, identify, noise_bias, run_stream
from hystfit.identify.duhem_regression import rank_of
from hystfit.models.bouc_wen import BoucWen
from hystfit.models.duhem import Duhem
from hystfit.models.shared.simulation import simulate
from hystfit.outcome import Code, Status
from hystfit.outcome.note import has
from hystfit.results.provenance import Stopwatch

with warnings.catch_warnings():  # Python warns of escapes in its docstrings where it is not compiled yet
    warnings.simplefilter("ignore")
    import padasip

ALPHA, ALPHA_F, G = 0.0874, np.array([-0.015, 0.006, 5.57e-6, -8.6e-8]), np.array([0.053, -0.83e-4, 8.1e-6])
PAPER = np.array([*ALPHA_F, ALPHA, *G])


def sine(count: int = 2001) -> np.ndarray:
    return 25 - 25 * np.cos(2 * np.pi * np.linspace(0, 2, count))


def decaying(count: int = 2001) -> np.ndarray:
    t = np.linspace(0, 2, count)
    return 25 + 25 * np.sin(5 * np.pi * t) * np.exp(-t)


def truth(u: np.ndarray, scheme: str = "midpoint", w0: float = 0.0) -> np.ndarray:
    """The paper's law in powers of v by a plain loop."""
    w = [w0]
    for v0, v1 in itertools.pairwise(u):
        v, a, d = 0.5 * (v0 + v1), abs(v1 - v0), v1 - v0
        drive = a * np.polyval(ALPHA_F[::-1], v) + d * np.polyval(G[::-1], v)
        if scheme == "explicit":
            w.append(w[-1] + drive - a * ALPHA * w[-1])
        else:
            w.append(((1 - ALPHA * a / 2) * w[-1] + drive) / (1 + ALPHA * a / 2))
    return np.array(w)


def record(u: np.ndarray, scheme: str = "midpoint", noise: float = 0.0, seed: int = 0, w0: float = 0.0) -> Record:
    y = truth(u, scheme, w0) + noise * np.random.default_rng(seed).normal(size=u.size)
    return Record(u=u, y=y, u_unit="V", y_unit="um")


def test_final_estimate_is_the_batch_solution_with_its_prior():
    data = record(decaying(401), noise=0.01)
    start = 1e-3 * np.arange(8.0)
    for prior in (1e-2, 1.0, 1e4):
        rls = dataclasses.replace(Rls.of(Duhem(), data, prior=prior), theta0=jnp.asarray(start))
        rows = rls.regressor.rows(data)
        stacked = np.vstack([rows.phi, np.eye(8) / np.sqrt(prior)])
        expected = np.linalg.lstsq(stacked, np.concatenate([rows.target, start / np.sqrt(prior)]), rcond=None)[0]
        found = rls.fit(data)
        np.testing.assert_allclose(found.theta, expected, rtol=1e-8, atol=1e-9)
        P = np.linalg.inv(rows.phi.T @ rows.phi + np.eye(8) / prior)
        np.testing.assert_allclose(rls.covariance(found.state), P, rtol=1e-6, atol=1e-8 * np.abs(P).max())


def test_plain_batch_solution_is_reached_as_the_prior_widens():
    data = record(sine(401), noise=0.01)
    rows = DuhemRegressor.of(Duhem(), [data]).rows(data)
    plain = np.linalg.lstsq(rows.phi, rows.target, rcond=None)[0]
    gaps = [np.abs(Rls.of(Duhem(), data, prior=10.0**k).fit(data).theta - plain).max() for k in (4, 6, 8)]
    assert gaps[0] > 1e-4
    np.testing.assert_allclose(np.divide(gaps[1:], gaps[:-1]), 1e-2, rtol=0.05)  # the prior's pull is of order 1 / P0


@pytest.mark.parametrize("forgetting", [1.0, 0.995])
def test_every_step_is_that_of_an_independent_implementation(forgetting):
    data = record(decaying(401), noise=0.01)
    rls = Rls.of(Duhem(), data, forgetting=forgetting, prior=1e4)
    rows = rls.regressor.rows(data)
    other = padasip.filters.FilterRLS(8, mu=forgetting, eps=1e-4, w="zeros")
    expected = []
    for phi, target in zip(rows.phi, rows.target, strict=True):
        other.adapt(target, phi)
        expected.append(other.w.copy())
    history = rls.fit(data).theta_history[1:]
    np.testing.assert_allclose(history, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("scheme", ["midpoint", "explicit"])
@pytest.mark.parametrize("u", [sine(), decaying(), sine(401)], ids=["sine", "decaying", "sine-401"])
def test_noise_free_records_give_back_all_eight_parameters(scheme, u):
    data = record(u, scheme, w0=0.5)
    rls = Rls.of(Duhem(scheme=scheme), data)
    found = rls.fit(data)
    np.testing.assert_allclose(rls.regressor.powers(found.theta), PAPER, rtol=1e-3)
    assert np.abs(found.predict()[0] - data.y).max() < 1e-4 * np.ptp(data.y)
    assert (found.status, found.notes) == (Status.OK, ())
    assert found.equation_error < 1e-9
    assert found.counts == {"total": u.size, "used": u.size - 1, "still": 0, "missing": 0, "first": 1}


def test_paper_parameters_and_scaled_ones_are_two_names_of_one_model():
    data = record(sine(401))
    regressor = DuhemRegressor.of(Duhem(), [data])
    model = Duhem.from_powers(ALPHA, ALPHA_F / ALPHA, G, 0.0, 50.0)
    theta = regressor.theta(model)
    np.testing.assert_allclose(regressor.powers(theta), PAPER, rtol=1e-10, atol=1e-16)
    np.testing.assert_allclose(regressor.from_powers(PAPER), theta, rtol=1e-10, atol=1e-14)
    elsewhere = Duhem.from_powers(ALPHA, ALPHA_F / ALPHA, G, -10.0, 200.0)
    np.testing.assert_allclose(regressor.theta(elsewhere), theta, rtol=1e-9, atol=1e-12)
    y, _ = simulate(regressor.model(theta, 0.0), data.u)
    np.testing.assert_allclose(y, data.y, atol=1e-12)


def test_powers_are_the_papers_columns_and_theta_its_parameters():
    data = record(decaying(401), w0=0.5)
    rls = Rls.of(Duhem(), data, basis="powers", prior=1e14)
    u, w = data.u, data.y
    d, v, middle = np.diff(u), 0.5 * (u[1:] + u[:-1]), 0.5 * (w[1:] + w[:-1])
    a = np.abs(d)
    columns = [a, a * v, a * v**2, a * v**3, -a * middle, d, d * v, d * v**2]
    rows = rls.regressor.rows(data)
    np.testing.assert_allclose(rows.phi, np.stack(columns, axis=1), rtol=1e-12)
    np.testing.assert_allclose(rows.target, np.diff(w), rtol=1e-12)
    found = rls.fit(data)
    np.testing.assert_allclose(found.theta, PAPER, rtol=1e-4)
    np.testing.assert_allclose(rls.regressor.theta(found.model), found.theta, rtol=1e-8)
    np.testing.assert_allclose(found.history[-1][0], ALPHA, rtol=1e-4)
    assert found.status is Status.OK


def test_the_bias_by_noise_does_not_depend_on_the_basis():
    data = record(sine(401), "explicit", noise=0.01)
    found = []
    for basis in ("legendre", "powers"):
        regressor = DuhemRegressor.of(Duhem(scheme="explicit"), [data], basis=basis)
        rows = regressor.rows(data)
        scale = np.linalg.norm(rows.phi, axis=0)
        theta = np.linalg.lstsq(rows.phi / scale, rows.target, rcond=None)[0] / scale
        bias = noise_bias(regressor, rows, theta)
        found.append((bias.noise, bias.alpha, bias.relative or 0.0))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-6)


@given(
    values=st.lists(st.floats(-1, 1), min_size=7, max_size=7),
    alpha=st.floats(0.01, 0.2),
    seed=st.integers(0, 2**32 - 1),
    explicit=st.booleans(),
)
@settings(max_examples=30)
def test_simulated_steps_satisfy_the_linear_equation(values, alpha, seed, explicit):
    scheme = "explicit" if explicit else "midpoint"
    u = np.cumsum(np.random.default_rng(seed).normal(size=60))
    model = Duhem(alpha=alpha, f=values[:4], g=values[4:], center=u.mean(), half=np.ptp(u), scheme=scheme)
    data = Record(u=u, y=np.asarray(simulate(model, u)[0]) + np.linspace(0, 1e-9, 60))
    regressor = DuhemRegressor.of(model, [data])
    rows = regressor.rows(data)
    size = np.abs(rows.phi) @ np.abs(regressor.theta(model)) + 1.0
    assert np.max(np.abs(rows.target - rows.phi @ regressor.theta(model)) / size) < 1e-5 / float(regressor.size)


def test_high_orders_stay_well_conditioned():
    data = record(decaying())
    model = Duhem.of_order(f=9, g=8)
    phi = DuhemRegressor.of(model, [data]).rows(data).phi
    scaled = phi / np.linalg.norm(phi, axis=0)
    raw = np.vander(data.u[1:], 10) * np.abs(np.diff(data.u))[:, None]
    assert np.linalg.cond(scaled) < 1e-3 * np.linalg.cond(raw)
    found = identify(data, "rls", model)
    assert np.abs(found.predict()[0] - data.y).max() < 1e-4 * np.ptp(data.y)


def test_sample_by_sample_is_the_scan():
    data = record(sine(60), noise=0.01)
    rls = Rls.of(
        Duhem(), data, prior=1e4
    )  # a wide prior would amplify the rounding in which the two compilations differ
    update, state, thetas = eqx.filter_jit(rls.update), rls.init(), []
    for k in range(len(data)):
        state, info = update(state, Sample.of(data.u[k], data.y[k], first=k == 0))
        thetas.append(np.asarray(info.theta))
    found = rls.fit(data)
    np.testing.assert_allclose(thetas, found.theta_history, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(state.root, found.state.root, rtol=1e-9, atol=1e-9)


def in_single_precision(identifier):
    down = lambda leaf: leaf.astype(jnp.float32) if eqx.is_inexact_array(leaf) else leaf
    return jax.tree.map(down, identifier)


def test_single_precision_serves():
    data = record(decaying(), noise=0.002)
    rls = Rls.of(Duhem(), data, forgetting=0.9995, prior=1e6)
    stream = Sample.stream([data])
    single = Sample(*(leaf.astype(jnp.float32) for leaf in stream[:3]), stream.first)
    small = in_single_precision(rls)
    state, _ = run_stream(small, small.init(), single)
    assert state.theta.dtype == state.root.dtype == jnp.float32
    _, double = run_stream(rls, rls.init(), stream)
    np.testing.assert_allclose(state.theta, double.theta[-1], rtol=0.02, atol=0.02 * np.abs(double.theta[-1]).max())
    spectrum = np.linalg.eigvalsh(np.asarray(small.covariance(state), dtype=float))
    assert spectrum.min() > 0


def test_still_and_missing_samples_are_skipped_and_counted():
    data = record(decaying(401))
    plain = identify(data)
    twice = np.repeat(np.arange(401), 2)
    held = identify(Record(u=data.u[twice], y=data.y[twice]))
    np.testing.assert_allclose(held.theta, plain.theta, rtol=1e-6, atol=1e-8)
    assert held.counts == {"total": 802, "used": 400, "still": 401, "missing": 0, "first": 1}

    gap = data.y.copy()
    gap[[50, 51, 200]] = np.nan
    found = identify(data.replace(y=gap))
    assert found.counts == {"total": 401, "used": 400 - 5, "still": 0, "missing": 3, "first": 1}
    np.testing.assert_allclose(found.theta, plain.theta, rtol=1e-4, atol=1e-6)
    assert np.isnan(found.errors[[0, 50, 51, 52, 200, 201]]).all()
    assert np.isfinite(np.delete(found.errors, [0, 50, 51, 52, 200, 201])).all()


def test_no_step_leads_from_one_record_or_pass_to_the_next():
    data = record(decaying(401))
    records = [data.segment(0, 200).replace(name="a"), data.segment(200, 401).replace(name="b")]
    found = identify(records, passes=2)
    assert found.counts["used"] == 2 * (199 + 200)
    assert found.counts["first"] == 4
    assert found.equation_error < 1e-9
    assert len(found.predict()) == len(found.models) == 2


def test_forgetting_follows_a_change_that_plain_rls_averages():
    u = np.concatenate([decaying(1001), decaying(1001)])
    first = record(u).y
    y = np.concatenate([first[:1001], first[1001:] * 1.3])
    data = Record(u=u, y=y)
    late = lambda found: np.abs(found.errors[-200:]).max()
    assert late(identify(data, forgetting=0.99)) < 0.05 * late(identify(data))


def test_covariance_does_not_wind_up_where_the_input_does_not_excite():
    u = np.concatenate([decaying(401), 25 + 1e-3 * np.sin(np.arange(20000))])
    rls = Rls.of(Duhem(), record(u, noise=1e-4), forgetting=0.98, prior=1e4)
    found = rls.fit(record(u, noise=1e-4))
    assert np.trace(np.asarray(rls.covariance(found.state))) < 8 * 1e4 * 1.1e3
    assert np.isfinite(found.theta_history).all()


# -- noise ---------------------------------------------------------------------------------------------------------------


def alpha_over_truth(scheme: str, u: np.ndarray, seeds: int, w0: float = 0.0) -> np.ndarray:
    found = [identify(record(u, scheme, 0.005, seed, w0), "rls", Duhem(scheme=scheme)) for seed in range(seeds)]
    return np.array([one.history[-1, 0] / ALPHA for one in found])


def test_the_regressor_decides_how_far_noise_pulls_the_rate():
    assert (alpha_over_truth("explicit", sine(), 5) > 5).all()
    assert (np.abs(alpha_over_truth("midpoint", sine(), 8) - 1) < 0.35).all()
    assert (np.abs(alpha_over_truth("midpoint", decaying(), 8, w0=1.5) - 1) < 0.10).all()


@pytest.mark.parametrize(
    ("scheme", "u", "serious"),
    [("midpoint", sine(), True), ("midpoint", decaying(), False), ("explicit", decaying(), True)],
    ids=["midpoint-sine", "midpoint-decaying", "explicit-decaying"],
)
def test_bias_is_estimated_from_the_residuals(scheme, u, serious):
    pulls, corrected = [], []
    for seed in range(6):
        data = record(u, scheme, 0.005, seed, w0=1.5 if u[0] > 1 else 0.0)
        found = identify(data, "rls", Duhem(scheme=scheme))
        rls = Rls.of(Duhem(scheme=scheme), data)
        bias = noise_bias(rls.regressor, rls.regressor.rows(found.data), found.theta)
        assert bias.noise == pytest.approx(0.005, rel=0.1)
        assert found.status is (Status.BIASED if serious else Status.OK)
        assert has(found.notes, Code.NOISE_BIAS) is serious
        assert bias.explicit is (scheme == "explicit")
        pulls.append(found.history[-1, 0] / ALPHA)
        corrected.append(bias.corrected / ALPHA)
    assert abs(np.mean(corrected) - 1) < max(0.02, 0.4 * abs(np.mean(pulls) - 1))


@pytest.mark.parametrize("scheme", ["midpoint", "explicit"])
def test_model_error_is_not_reported_as_noise(scheme):
    data = record(decaying(), scheme)
    odd = data.replace(y=data.y + 0.02 * np.sin(data.u / 3))
    found = identify(odd, "rls", Duhem(scheme=scheme))
    assert found.equation_error > 1e-5
    assert found.status is not Status.BIASED
    assert not has(found.notes, Code.NOISE_BIAS)


# -- what cannot be identified -----------------------------------------------------------------------------------------


def test_input_that_never_turns_back_does_not_determine_all():
    u = np.linspace(0, 50, 400)
    found = identify(record(u, noise=1e-3))
    assert found.status is Status.UNDETERMINED
    assert has(found.notes, Code.NOT_DETERMINED)
    assert rank_of(DuhemRegressor.of(Duhem(), [found.data[0]]).rows(found.data).phi) == 5
    assert not found.usable


def test_a_rate_that_is_not_positive_is_no_model():
    u, w = decaying(401), [1.5]
    for v0, v1 in itertools.pairwise(u):
        w.append(w[-1] + 0.05 * (v1 - v0) + 0.02 * abs(v1 - v0) * w[-1])  # runs away: alpha = -0.02
    found = identify(Record(u=u, y=np.array(w)), "rls", Duhem(scheme="explicit"))
    assert found.status is Status.FAILED
    assert has(found.notes, Code.INVALID_MODEL)
    assert found.model is None
    assert found.predict() == []
    assert found.free_run is None
    alpha = next(parameter for parameter in found.parameters if parameter.name == "alpha")
    assert alpha.value == pytest.approx(-0.02, rel=1e-3)
    with pytest.raises(ModelError, match="no usable model"):
        as_fit(found, 0, Stopwatch())


def test_unusable_requests_are_refused():
    data = record(sine(101))
    with pytest.raises(DataError, match="4 usable steps cannot determine 8 parameters"):
        identify(record(sine(5)))
    with pytest.raises(DataError, match="never moves"):
        identify(Record(u=np.ones(50), y=np.arange(50.0)))
    with pytest.raises(ModelError, match="not linear in the parameters"):
        identify(data, "rls", Duhem(scheme="exact"))
    with pytest.raises(ModelError, match="got BoucWen"):
        identify(data, "rls", BoucWen())
    with pytest.raises(ParameterError, match="forgetting must lie in"):
        identify(data, forgetting=1.5)
    with pytest.raises(ParameterError, match="no setting 'lam'; it has start, basis, forgetting, prior"):
        identify(data, lam=0.99)
    with pytest.raises(ParameterError, match="method must be one of rls"):
        identify(data, "lms")
    with pytest.raises(ParameterError, match="at least one pass"):
        identify(data, passes=0)


def test_every_parameter_has_its_unit_and_no_error():
    found = identify(record(decaying(401)))
    parameters = {parameter.name: parameter for parameter in found.parameters}
    assert list(parameters) == [*found.space.names, "center", "half"]
    assert [parameters[name].unit for name in ("alpha", "f[3]", "g[0]", "w0")] == ["1/V", "um", "um/V", "um"]
    assert all(parameter.stderr is None for parameter in found.parameters)
    np.testing.assert_allclose(found.x[:-1], found.history[-1])
