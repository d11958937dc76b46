"""The unscented filter against filterpy, a plain Kalman filter and smoother, known truths, and bad input."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hystfit import (
    BoucWen,
    Duhem,
    Lag,
    LogCreep,
    Offset,
    PrandtlIshlinskii,
    Preisach,
    SecondOrder,
    Series,
    Sum,
    Viscous,
    datasets,
    simulate,
)
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError, ModelError, ParameterError
from hystfit.identify import (
    BlockVerdict,
    Phase,
    Run,
    Sample,
    Ukf,
    identify,
    identify_in_stages,
    identify_online,
    run_stream,
)
from hystfit.identify.filter_verdict import loop_count
from hystfit.identify.sigma_points import Unscented, triangular
from hystfit.outcome import Code, Severity, Status
from hystfit.outcome.note import has
from hystfit.stage import Actuator, Sensor

C, MU, TAU, DELTA = 0.1542, 0.45, 0.01086, 0.00956
TRUTH = BoucWen(c=C, mu=MU, tau=TAU, rho=DELTA / TAU, scheme="exact")


def bouc_wen(c=1.0, mu=1.0, tau=1.0, delta=1.0, scheme="exact"):
    """The truth with every parameter times a factor."""
    return BoucWen(c=C * c, mu=MU * mu, tau=TAU * tau, rho=DELTA * delta / (TAU * tau), scheme=scheme)


def modulated(duration=15.0, rate=400.0):
    """Input of several amplitudes, -20..100 V at 1 Hz, from 0 V."""
    t = np.arange(int(duration * rate)) / rate
    u = 40 + 60 * (0.55 + 0.45 * np.cos(2 * np.pi * t / 6.7)) * np.sin(2 * np.pi * t)
    return t, np.minimum(u, 160 * t)


def measured(model=TRUTH, seed=0, noise=0.005, signal=modulated):
    return Actuator(model=model, sensor=Sensor(noise, 0.0)).record(*signal(), seed=seed)


def nees(error, covariance):
    """Normalized estimation error squared  e^T P^-1 e; its mean should be the rank of P."""
    scale = np.sqrt(np.diag(covariance))
    return float((error / scale) @ np.linalg.inv(covariance / np.outer(scale, scale)) @ (error / scale))


def relative_errors(x):
    c, mu, tau, rho = x[:4]
    return np.array([c, mu, tau, tau * rho]) / [C, MU, TAU, DELTA] - 1


# -- against other filters ---------------------------------------------------------------------------------------------


def by_filterpy(ukf, record, move, read):
    """filterpy from our start, with the outputs read off the propagated points, as ours are."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    n, scheme = ukf.scheme.n, ukf.scheme
    moved = []

    def remember(point, dt, **drive):
        moved.append(move(point, dt, **drive))
        return moved[-1]

    first = jax.jit(lambda u: ukf.restart(ukf.init(), u))(record.u[0])
    points = MerweScaledSigmaPoints(n, scheme.alpha, scheme.beta, scheme.kappa)
    peer = UnscentedKalmanFilter(n, 1, 1.0, read, remember, points)
    peer.x, peer.P = np.asarray(first.mean), np.asarray(first.root @ first.root.T)
    peer.R, peer.Q = np.array([[float(ukf.noise) ** 2]]), np.diag(np.asarray(ukf.walk) ** 2)
    means, variances, before = [], [], record.u[0]
    for u, y, dt in zip(record.u, record.y, record.dt, strict=True):
        moved.clear()
        peer.predict(dt=dt, u0=before, u1=u)
        peer.sigmas_f = np.array(moved)
        peer.update(np.array([y]), u1=u)
        means.append(peer.x.copy())
        variances.append(peer.S[0, 0])
        before = u
    return np.array(means), np.array(variances), peer.P - peer.Q


@pytest.mark.parametrize("alpha", [1.0, 0.3])
def test_nonlinear_filter_equals_filterpy(alpha):
    record = measured(signal=lambda: modulated(1.5, 200.0))
    settings = {
        "start": "model",
        "noise": 0.005,
        "caution": 0.0,
        "walk": 1e-4,
        "prior": 0.2,
        "alpha": alpha,
        "kappa": 0.5,
    }
    start = bouc_wen(1.1, 0.9, 1.1, 0.9, scheme="semi-implicit")
    if alpha < 1:
        with pytest.warns(UserWarning, match="central point the covariance weight"):
            ukf = Ukf.of(start, record, **settings)
    else:
        ukf = Ukf.of(start, record, **settings)
    scale = np.asarray(ukf.coordinates.scale)

    def physical(z):
        grow = lambda k: scale[k] * math.exp(z[k])
        within = lambda z, low, high: low + (high - low) / (1 + math.exp(-z))
        return grow(0), within(z[1], 0, 1), grow(2), within(z[3], -1, 1), scale[4] * z[4]

    def move(point, dt, u0, u1):
        c, mu, tau, rho, _ = physical(point[1:])
        s, x = (-1.0 if u1 < u0 else 1.0), abs(u1 - u0)
        q = s * point[0]
        falls = min(-q / (mu * c), x) if q < 0 else 0.0
        half = 0.5 * tau * ((1 + rho) * (x - falls) + (1 - rho) * falls)
        return np.concatenate([[s * ((1 - half) * q + mu * c * x) / (1 + half)], point[1:]])

    def read(point, u1):
        c, _, _, _, offset = physical(point[1:])
        return np.array([offset + c * u1 - point[0]])

    means, variances, _ = by_filterpy(ukf, record, move, read)
    _, info = run_stream(ukf, ukf.init(), Sample.stream([record]))
    np.testing.assert_allclose(info.theta, means[:, 1:], atol=1e-8)
    np.testing.assert_allclose(info.variance, variances, rtol=1e-8)


class Linear:
    """A resonance and an offset: states (x, v), parameter z = offset / scale; everything linear."""

    omega, zeta, dt = 8.0, 0.2, 0.05

    def __init__(self, missing=()):
        rng = np.random.default_rng(0)
        u = np.repeat(rng.uniform(-1, 1, 30), 4)
        t = self.dt * np.arange(u.size)
        self.model = Sum(SecondOrder(omega=self.omega, zeta=self.zeta), Offset(value=0.3))
        y = np.asarray(simulate(self.model, jnp.asarray(u), jnp.full(u.size, self.dt))[0]) + 0.05 * rng.standard_normal(
            u.size
        )
        y[list(missing)] = np.nan
        self.record = Record(u=u, y=y, t=t)
        self.ukf = Ukf.of(
            self.model,
            self.record,
            only=("value",),
            start="model",
            noise=0.05,
            caution=0.0,
            walk=1e-2,
            prior=0.5,
            state_prior=np.array([0.2, 0.5]),
            state_walk=np.array([0.02, 0.1]),
            hold="none",
        )
        scale = float(self.ukf.coordinates.scale[0])
        self.H = np.array([1.0, 0.0, scale])
        self.Q = np.diag(np.asarray(self.ukf.walk) ** 2)

    def drive(self, u0, u1):
        """Transition matrix and drive over one sample by the matrix exponential of the input-augmented system."""
        from scipy.linalg import expm

        w, d = self.omega, self.zeta
        A = np.zeros((4, 4))
        A[:2, :2] = [[0, 1], [-w * w, -2 * d * w]]
        A[1, 2], A[2, 3] = w * w, 1.0
        M = expm(A * self.dt)
        F = np.eye(3)
        F[:2, :2] = M[:2, :2]
        shift = np.zeros(3)
        shift[:2] = M[:2, 2] * u0 + M[:2, 3] * (u1 - u0) / self.dt
        return F, shift

    def kalman(self):
        """Filter in plain numpy; noise enters before each step but the first."""
        u, y = self.record.u, self.record.y
        x = np.array([u[0], 0.0, float(self.ukf.z0[0])])
        P = np.asarray(self.ukf.prior) ** 2
        out, before, Q = [], u[0], np.zeros((3, 3))
        for uk, yk in zip(u, y, strict=True):
            F, shift = self.drive(before, uk)
            x_prior, P_prior = F @ x + shift, F @ (P + Q) @ F.T
            S = self.H @ P_prior @ self.H + 0.05**2
            K = P_prior @ self.H / S if np.isfinite(yk) else np.zeros(3)
            x = x_prior + K * ((yk if np.isfinite(yk) else 0.0) - self.H @ x_prior)
            P = P_prior - np.outer(K, K) * S
            out.append((x, P, S))
            before, Q = uk, self.Q
        return out


@pytest.mark.parametrize("missing", [pytest.param((), marks=pytest.mark.slow), (5, 6, 7, 40)])
def test_linear_filter_equals_kalman(missing):
    case = Linear(missing)
    out, state, means, variances = case.kalman(), case.ukf.init(), [], []
    update = jax.jit(lambda state, sample: case.ukf.update(state, sample))
    stream = Sample.stream([case.record])
    for k in range(len(case.record)):
        state, info = update(state, jax.tree.map(lambda leaf, k=k: leaf[k], stream))
        means.append(state.mean)
        variances.append(info.variance)
    np.testing.assert_allclose(means, [row[0] for row in out], atol=1e-10)
    np.testing.assert_allclose(variances, [row[2] for row in out], rtol=1e-10)
    root = np.asarray(state.root)
    np.testing.assert_allclose(root @ root.T, out[-1][1] + case.Q, atol=1e-10)
    assert int(state.tally[2]) == len(missing)


# -- what it identifies ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seeds", [range(4), pytest.param(range(4, 20), marks=pytest.mark.slow)])
def test_twenty_seeds_far_from_the_truth(seeds):
    """5 nm of noise, starts off by +20, -30, +50 and -40 %."""
    start = bouc_wen(1.2, 0.7, 1.5, 0.6)
    levels = []
    for seed in seeds:
        record = measured(seed=seed)
        result = Ukf.of(start, record, start="model").fit(record)
        assert result.status is Status.OK
        assert np.max(np.abs(relative_errors(result.history[-1]))) < 0.03
        free = np.asarray(simulate(result.model, jnp.asarray(record.u))[0])
        clean = np.asarray(simulate(TRUTH, jnp.asarray(record.u))[0])
        assert np.max(np.abs(free - clean)) < 0.002 * np.ptp(clean)
        levels.append(float(result.state.tally[5]))
    assert 0.8 < min(levels)
    assert max(levels) < 1.2


def test_random_starts_stay_finite():
    record = measured(signal=lambda: modulated(4.0, 200.0))
    ukf = Ukf.of(bouc_wen(), record, start="model", noise=0.005)
    rng = np.random.default_rng(7)
    starts = np.asarray(ukf.z0) + rng.uniform(-2.0, 2.0, (60, 5)) * [1, 1, 1, 1, 0.2]
    stream = Sample.stream([record])
    started = lambda z0: dataclasses.replace(ukf, z0=z0)
    run = jax.jit(jax.vmap(lambda z0: run_stream(started(z0), started(z0).init(), stream)))
    states, info = run(jnp.asarray(starts))
    assert np.isfinite(np.asarray(states.mean)).all()
    assert np.isfinite(np.asarray(states.root)).all()
    assert np.isfinite(np.asarray(info.theta)).all()
    assert np.asarray(states.tally)[:, 3].max() == 0
    roots = np.asarray(states.root)
    assert np.linalg.eigvalsh(roots @ roots.transpose(0, 2, 1)).min() > -1e-15


def test_near_the_truth_its_covariance_is_fair():
    """Normalized estimation error squared of the parameters over 30 runs started within the prior: chi-square of 5 * 30 degrees."""
    values = []
    for seed in range(30):
        record = measured(seed=seed, signal=lambda: modulated(2.0, 200.0))
        base = Ukf.of(
            bouc_wen(), record, start="model", noise=0.005, prior=0.003, walk=0.0, caution=0.0, state_prior=0.0
        )
        shifted = dataclasses.replace(base, z0=base.z0 + 0.003 * np.random.default_rng(seed).standard_normal(5))
        state, _ = run_stream(shifted, shifted.init(), Sample.stream([record]))
        covariance = np.asarray(shifted.covariance(state))[1:, 1:]
        values.append(nees(np.asarray(state.mean[1:] - base.z0), covariance))
    # 99.9 % band of the mean of 30 chi-square(5) variables
    assert 3.3 < np.mean(values) < 7.1


def test_one_amplitude_does_not_determine_the_parameters():
    def sine():
        t = np.arange(4000) / 400.0
        return t, 40 + 60 * np.sin(2 * np.pi * t + np.arcsin(-2 / 3))

    record = measured(signal=sine)
    start = bouc_wen(1.2, 0.7, 1.5, 0.6)
    result = Ukf.of(start, record, start="model").fit(record)
    assert result.status is Status.UNDETERMINED
    assert not result.usable
    assert has(result.notes, Code.NOT_DETERMINED)
    assert result.free_run.nrmse_percent < 0.2
    assert loop_count(result.data) == 1
    poor = dataclasses.replace(result.free_run, rmse=1.0)
    ukf = Ukf.of(start, record, start="model")
    judgment = ukf.judge(Run(result.data, result.state, np.tile(ukf.z0, (20, 1)), poor))
    assert judgment.status is Status.UNDETERMINED
    assert loop_count(Dataset.of(measured())) > 5


def test_innovations_outside_their_band_are_not_usable():
    """A noise of three times the true one makes them a ninth of their prediction, however well the simulation follows."""
    record = measured()
    start = bouc_wen(1.1, 0.9)
    noise = float(Ukf.of(start, record, start="model").noise)
    found = Ukf.of(start, record, start="model", noise=3 * noise).fit(record)
    assert found.status is Status.INCONSISTENT
    assert [note.severity for note in found.notes if note.code is Code.INNOVATIONS] == [Severity.WARNING]


def test_status_of_a_run_that_ends_far_from_the_record_or_without_a_finite_mean():
    record = measured()
    result = Ukf.of(bouc_wen(1.1, 0.9), record, start="model").fit(record)
    ukf = Ukf.of(bouc_wen(1.1, 0.9), record, start="model")
    run = Run(result.data, result.state, result.theta_history, result.free_run)
    assert ukf.judge(run).status is Status.OK
    assert (
        ukf.judge(run._replace(free_run=dataclasses.replace(result.free_run, rmse=1.0))).status is Status.NOT_CONVERGED
    )
    assert ukf.judge(run._replace(free_run=None)).status is Status.DIVERGED
    broken = run._replace(history=np.full_like(result.theta_history, np.nan))
    judgment = ukf.judge(broken)
    assert judgment.status is Status.DIVERGED
    assert has(judgment.notes, Code.DIVERGED)
    assert judgment.equation_error is None


def test_the_filter_stops_on_line_where_it_has_converged():
    """What it returns is the filter of the samples until then; later samples, here damaged, are not used."""
    record = measured()
    ukf = Ukf.of(bouc_wen(1.1, 0.9), record, start="model", noise=0.005)
    later = np.arange(len(record)) >= 5600
    damaged = record.replace(y=np.where(later, 0.0, record.y))
    result = identify_online(ukf, damaged, block=400)
    used = result.counts["total"]
    assert result.status is Status.OK
    assert 400 < used <= 5600
    np.testing.assert_allclose(result.theta, ukf.fit(record.segment(0, used)).theta, rtol=0, atol=1e-9)
    assert result.free_run.nrmse_percent < 0.1


def test_the_filter_runs_to_the_end_where_it_does_not_converge():
    """With too large a noise the innovations never have their predicted size; a wrong model does not predict the next block."""
    record = measured()
    noisy = Ukf.of(bouc_wen(1.1, 0.9), record, start="model", noise=0.05)
    result = identify_online(noisy, record, block=1000)
    assert result.counts["total"] == len(record)
    assert not result.usable
    assert has(result.notes, Code.NOT_SETTLED)
    assert BlockVerdict(0.001, 1.0, 0.001).converged
    assert not any(v.converged for v in (BlockVerdict(0.1, 1, 0), BlockVerdict(0, 2, 0), BlockVerdict(0, 1, 0.1)))
    with pytest.raises(ParameterError, match="block"):
        identify_online(noisy, record, block=len(record) + 1)


@pytest.mark.slow
def test_creep_in_stages_on_the_bundled_records():
    fast, slow = datasets.load("stage-sweep"), datasets.load("stage-step")
    start = Series(bouc_wen(1.1, 0.9, 1.2, 0.85), LogCreep(gamma=(0.01,)))
    stages = [
        Phase(fast, ("c", "mu", "bouc_wen.tau", "rho", "offset")),
        Phase(slow, ("gamma", "offset"), {"hold": "none"}),
        Phase([fast, slow], settings={"prior": 0.05, "hold": "none"}),
    ]
    model, found = identify_in_stages(start, stages)
    assert found[1].names == ("offset", "gamma[0]")
    assert [result.status for result in found] == [Status.OK] * 3
    hysteresis, creep = model.parts
    assert float(creep.gamma[0]) == pytest.approx(0.0175, rel=0.02)
    assert float(hysteresis.c) == pytest.approx(C, rel=0.01)
    assert float(hysteresis.mu) == pytest.approx(MU, rel=0.01)
    assert float(hysteresis.tau) == pytest.approx(TAU, rel=0.01)
    assert found[2].free_run.nrmse_percent < 0.1


@pytest.mark.parametrize(
    "model",
    [
        pytest.param(Duhem(), marks=pytest.mark.slow),
        PrandtlIshlinskii.of(6),
        pytest.param(
            Preisach.of(4, degree=1, reversible=False, elements="relays", spacing="uniform"), marks=pytest.mark.slow
        ),
        pytest.param(Sum(bouc_wen(), Viscous()), marks=pytest.mark.slow),
        pytest.param(Series(bouc_wen(), SecondOrder(omega=300.0, zeta=0.1)), marks=pytest.mark.slow),
    ],
    ids=["duhem", "prandtl-ishlinskii", "preisach", "viscous", "resonance"],
)
def test_any_model_with_a_step(model):
    record = measured(signal=lambda: modulated(10.0, 100.0))
    result = Ukf.of(model, record).fit(record)
    assert np.isfinite(result.history).all()
    assert result.counts["used"] == len(record)
    if isinstance(model, Preisach):  # relays jump: a filter of their states can be run, not relied on
        return
    start = Ukf.of(model, record)
    before = np.asarray(
        simulate(start.model(np.asarray(start.z0), record), jnp.asarray(record.u), jnp.asarray(record.dt))[0]
    )
    assert result.free_run.rmse < 0.8 * np.sqrt(np.mean((before - record.y) ** 2))


# -- freezing, gaps, on-line use ---------------------------------------------------------------------------------------


def test_parameters_of_rate_independent_parts_are_fixed_while_the_input_rests():
    slow = datasets.load("stage-step")
    start = Series(bouc_wen(1.1, 0.9), LogCreep(gamma=(0.01,), tau=(0.3, 3.0), weights=(0.9, 0.8)))
    ukf = Ukf.of(start, slow, start="model")
    resting = dict(zip(ukf.names, np.asarray(ukf.resting)[ukf.states :], strict=True))
    gamma = next(name for name in ukf.names if name.startswith("gamma"))
    assert {name for name, rests in resting.items() if not rests} == {gamma}
    state, info = run_stream(ukf, ukf.init(), Sample.stream([slow]))
    jump = np.flatnonzero(np.diff(slow.u))[0] + 1
    theta = np.asarray(info.theta)
    column = ukf.names.index(gamma)
    others = [k for k in range(len(ukf.names)) if k != column]
    assert np.max(np.abs(theta[jump + 1 :, others] - theta[jump, others])) < 1e-9  # rounding of the sigma points' mean
    assert np.ptp(theta[jump + 1 :, column]) > 1e-3
    free = Ukf.of(start, slow, start="model", hold="none")
    assert not np.asarray(free.resting).any()
    assert np.asarray(Ukf.of(start, slow, start="model", hold="all").resting)[free.states :].all()
    assert np.isfinite(np.asarray(state.root)).all()


def test_missing_measurements_are_skipped_and_counted():
    whole = measured()
    y = whole.y.copy()
    y[700:760] = np.nan
    y[-1] = np.nan
    result = Ukf.of(bouc_wen(1.1, 0.9), whole, start="model", noise=0.005).fit(whole.replace(y=y))
    assert result.counts["missing"] == 61
    assert result.counts["used"] == len(whole) - 61
    assert int(result.state.tally[2]) == 61
    assert has(result.notes, Code.SKIPPED_SAMPLES)
    assert np.isnan(result.errors[700:760]).all()
    assert np.max(np.abs(relative_errors(result.history[-1]))) < 0.03


def test_an_input_that_is_not_finite_keeps_the_previous_one():
    record = measured(signal=lambda: modulated(2.0, 200.0))
    ukf = Ukf.of(bouc_wen(1.1, 0.9), record, start="model", noise=0.005)
    stream = Sample.stream([record])
    broken = stream._replace(u=stream.u.at[100].set(jnp.nan))
    state, info = run_stream(ukf, ukf.init(), broken)
    assert np.isfinite(np.asarray(info.theta)).all()
    assert np.flatnonzero(~np.asarray(info.used)).tolist() == [100]
    assert np.asarray(state.tally)[1:4:2].tolist() == [len(record) - 1, 0]
    held = stream._replace(u=stream.u.at[100].set(stream.u[99]), y=stream.y.at[100].set(jnp.nan))
    np.testing.assert_allclose(info.theta, run_stream(ukf, ukf.init(), held)[1].theta, rtol=1e-12)


def test_irregular_time_is_integrated_as_it_is():
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.002, 0.02, 1500))
    u = 50 * (1 - np.cos(2 * np.pi * 0.7 * t)) * (0.6 + 0.4 * np.cos(t / 2))
    truth = Series(TRUTH, Lag(tau=0.02))
    record = Actuator(model=truth, sensor=Sensor(0.005, 0.0)).record(t, u, seed=0)
    ukf = Ukf.of(truth, record, start="model", noise=0.005, caution=0.0, prior=0.01)
    _, info = run_stream(ukf, ukf.init(), Sample.stream([record]))
    # innovations of the right model at the right times are white and of the predicted size; 1500 samples scatter by 3.7 %
    nis = np.asarray(info.error) ** 2 / np.asarray(info.variance)
    assert np.mean(nis[200:]) == pytest.approx(1.0, abs=0.15)


def test_single_updates_equal_the_scan_and_passes_continue():
    record = measured(signal=lambda: modulated(0.5, 200.0))
    ukf = Ukf.of(bouc_wen(1.1, 0.9), record, start="model")
    update = jax.jit(lambda state, sample: ukf.update(state, sample))
    state = ukf.init()
    for k, (u, y, dt) in enumerate(zip(record.u, record.y, record.dt, strict=True)):
        state, _ = update(state, Sample.of(u, y, dt, k == 0))
    together, _ = run_stream(ukf, ukf.init(), Sample.stream([record]))
    np.testing.assert_allclose(state.mean, together.mean, rtol=1e-9, atol=1e-12)
    again = ukf.fit(record, passes=2)
    assert again.counts["used"] == 2 * len(record)
    assert int(again.state.tally[0]) == 1


def test_several_records_share_all_but_their_offsets():
    model = TRUTH
    records = [measured(model, seed=k).replace(name=f"run{k}") for k in range(2)]
    records[1] = records[1].replace(y=records[1].y + 0.8)
    result = Ukf.of(bouc_wen(1.1, 0.9), records, start="model").fit(records)
    values = dict(zip(result.names, result.history[-1], strict=True))
    assert values["offset@run0"] == pytest.approx(0.0, abs=0.03)
    assert values["offset@run1"] == pytest.approx(0.8, abs=0.03)
    assert float(result.models[1].offset) == pytest.approx(values["offset@run1"])


def test_a_second_record_of_the_same_length_costs_no_trace():
    seen = []

    class Counted(BoucWen):
        def step(self, state, u0, u1, dt):
            seen.append(1)
            return BoucWen.step(self, state, u0, u1, dt)

    start = Counted(c=C, mu=MU, tau=TAU, rho=0.8)
    for seed in range(2):
        record = measured(seed=seed, signal=lambda: modulated(1.0, 200.0))
        Ukf.of(start, record, start="model").fit(record)
        if seed == 0:
            first = len(seen)
    assert first > 0
    assert len(seen) == first


# -- bad input ---------------------------------------------------------------------------------------------------------


def test_bad_settings_are_refused():
    record = measured(signal=lambda: modulated(1.0, 200.0))
    make = lambda **settings: Ukf.of(bouc_wen(), record, start="model", **settings)
    five = np.diag([1.0, 1.0, 1.0, 1.0, -1.0])
    cases = {
        "not positive definite": {"prior": five},
        r"shape \(5, 5\)": {"prior": np.eye(4)},
        "symmetric": {"prior": np.eye(5) + np.eye(5, k=1)},
        "prior must be positive": {"prior": -1.0},
        "no parameter 'alpha'": {"prior": {"alpha": 1.0}},
        "which is fixed": {"prior": {"c": 1.0}, "fix": ("c",)},
        "noise must be a positive": {"noise": 0.0},
        "walk must be finite": {"walk": -1.0},
        "still must be finite": {"still": np.nan},
        "caution must be finite": {"caution": -1.0},
        "state_prior must be one number or 1": {"state_prior": np.ones(3)},
        r"alpha\^2": {"kappa": -6.0},
        "beta must be finite": {"beta": np.nan},
        r"array of shape \(5,\)": {"prior": np.ones(5)},
        "outside its bounds": {"fix": {"mu": 3.0}},
        "leave fix and free out": {"only": ("c",), "fix": {"mu": 0.4}},
        "every parameter is fixed": {"fix": ("c", "mu", "tau", "rho", "offset")},
    }
    for message, settings in cases.items():
        with pytest.raises(ParameterError, match=message):
            make(**settings)
    with pytest.raises(ParameterError, match="the parameters are"):
        make(only=("gamma",))
    with pytest.raises(DataError, match="constant"):
        Ukf.of(bouc_wen(), record.replace(u=np.zeros(len(record))))
    with pytest.raises(ModelError, match="no time column"):
        Ukf.of(Series(bouc_wen(), LogCreep()), record.replace(t=None))
    with pytest.raises(ParameterError, match="no setting 'gain'"):
        identify(record, "ukf", bouc_wen(), gain=1.0)
    with pytest.raises(ParameterError, match="at least one stage"):
        identify_in_stages(bouc_wen(), [])


def test_a_covariance_may_be_given():
    record = measured(signal=lambda: modulated(1.0, 200.0))
    covariance = 0.04 * (np.eye(5) + 0.3 * np.ones((5, 5)))
    ukf = Ukf.of(bouc_wen(), record, start="model", prior=covariance)
    np.testing.assert_allclose(np.asarray(ukf.covariance(ukf.init()))[1:, 1:], covariance, rtol=1e-12)


def test_weights_reproduce_mean_and_covariance_exactly():
    rng = np.random.default_rng(0)
    for n, alpha, kappa in ((3, 1.0, 0.0), (5, 1.0, 2.0), (5, 0.5, 1.0)):
        scheme = Unscented(n, alpha, 2.0, kappa)
        root = np.tril(rng.standard_normal((n, n)))
        mean = rng.standard_normal(n)
        points = jax.jit(scheme.points)(mean, root)
        np.testing.assert_allclose(jax.jit(scheme.mean)(points), mean, atol=1e-12)
        found = np.asarray(jax.jit(scheme.root)(np.asarray(points) - mean, np.zeros((n, n))))
        np.testing.assert_allclose(found @ found.T, root @ root.T, atol=1e-11)
    assert Unscented(8).safe
    assert not Unscented(8, alpha=0.1).safe


@pytest.mark.parametrize("n", [1, 5, 30])
def test_triangular_factor_equals_lapack(n):
    rng = np.random.default_rng(n)
    rows = rng.standard_normal((3 * n + 2, n)) * np.geomspace(1e-6, 1e3, n)
    expected = np.linalg.qr(rows, mode="r").T
    factor = jax.jit(triangular)
    found = np.asarray(factor(rows))
    np.testing.assert_allclose(
        found * np.sign(np.diag(found)), expected * np.sign(np.diag(expected)), rtol=1e-11, atol=1e-13
    )
    rows[:, -1] = 0.0  # a state without variance
    assert np.isfinite(factor(rows)).all()
