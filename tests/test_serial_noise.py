"""Errors under slow and independent noise against dense covariances and against the spread of estimates; the test for repeating error."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

import hystfit as hf
from hystfit.data.batch import Batch
from hystfit.inference.autocorrelation import autocorrelation_time, is_correlated
from hystfit.inference.newton import maximize
from hystfit.inference.noise import OrnsteinUhlenbeck, Setting
from hystfit.inference.noise.even_noise import EvenRows
from hystfit.inference.noise.slow_likelihood import (
    Contrasts,
    Samples,
    SlowNoise,
    fit_slow_noise,
    fit_slow_noises,
    least_squares_root,
    slow_solver,
)
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import CHANCE, ResidualAnalysis, analyze
from hystfit.inference.whitened import restricted
from hystfit.outcome import Status
from hystfit.sampling.diagnostics import Convergence
from hystfit.sampling.posterior import Posterior
from hystfit.sampling.predictive import predictive_draws

CYCLES, T = 8, 800


def two_records(seed: int = 0) -> tuple[Samples, Setting]:
    """Uneven times, missing samples, two weights."""
    rng = np.random.default_rng(seed)
    made = []
    for length in (30, 22):
        t = np.cumsum(rng.exponential(0.1, length))
        y = rng.normal(size=length)
        y[rng.integers(1, length - 1, 4)] = np.nan
        weight = np.where(rng.random(length) < 0.5, 1.0, 2.5)
        made.append(hf.Record(u=np.sin(7 * t), y=y, t=t, weight=weight, name=str(length)))
    setting = Setting.of(Batch.of(hf.Dataset(tuple(made))))
    return Samples.of(setting), setting


def dense(samples: Samples, setting: Setting, white: float, slow: float, time: float) -> np.ndarray:
    """Covariance of weighted residuals, entry by entry."""
    at = np.cumsum(np.broadcast_to(np.asarray(setting.gap), samples.on.shape), axis=1)[samples.on]
    record = np.repeat(np.arange(len(samples.on)), samples.on.sum(axis=1))
    cover = slow**2 * np.exp(-np.abs(at[:, None] - at) / time) * (record[:, None] == record)
    root = np.sqrt(samples.weight)
    return root[:, None] * cover * root + white**2 * np.eye(at.size)


def test_tridiagonal_algebra_is_that_of_the_dense_covariance():
    samples, setting = two_records()
    n = samples.gap.size
    shapes = np.random.default_rng(1).normal(size=(n, 3))
    noise = SlowNoise(samples, 0.4, 1.3, 2.5, shapes, 0.7)
    plain = dense(samples, setting, 0.4, 1.3, 2.5)
    rows = np.asfortranarray(np.random.default_rng(2).normal(size=(n, 4)))
    np.testing.assert_allclose(noise.solve(rows), np.linalg.solve(plain, rows), rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(noise.apply(rows), (plain + 0.49 * shapes @ shapes.T) @ rows, rtol=1e-10)


@pytest.mark.parametrize("ratio", [1e-6, 0.3, 1e6])
@pytest.mark.parametrize("time", [0.2, 5.0, 400.0])
def test_even_samples_have_the_dense_covariance_in_cosine_coordinates(ratio, time):
    n, step, weight = 41, 0.7, 2.5
    gap, rows = np.append(np.inf, np.full(n - 1, step)), np.random.default_rng(1).normal(size=(n, 3))
    apart = step * np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    dense = weight * np.exp(-apart / time) + ratio * np.eye(n)
    (even,) = EvenRows.of([rows], gap, np.full(n, weight))
    (gram,), (log_det,) = even.at(np.array([ratio]), np.array([time]))
    np.testing.assert_allclose(gram, rows.T @ np.linalg.solve(dense, rows), rtol=1e-9)
    assert log_det == pytest.approx(np.linalg.slogdet(dense)[1], rel=1e-10)


def test_only_even_records_of_one_weight_each_have_cosine_coordinates():
    gap, rows, weight = np.append(np.inf, np.ones(9)), np.ones((10, 1)), np.ones(10)
    assert EvenRows.of([rows], gap, weight) is not None
    uneven = gap.copy()
    uneven[4] = 1.001
    assert EvenRows.of([rows], uneven, weight) is None
    assert EvenRows.of([rows], gap, np.append(weight[1:], 2.0)) is None


@pytest.mark.parametrize("ratio", [1e-6, 0.3, 1e6])
@pytest.mark.parametrize("time", [0.2, 30.0, 1e4])
def test_even_records_have_the_likelihood_of_the_tridiagonal_algebra(ratio, time):
    """Three long ones of two lengths, and one of another step and weight."""
    lengths, steps, weights = (3000, 1700, 3000, 3000), (1.0, 1.0, 1.0, 0.4), (1.0, 1.0, 1.0, 2.0)
    gap = np.concatenate([np.append(np.inf, np.full(n - 1, step)) for n, step in zip(lengths, steps, strict=True)])
    weight, n = np.repeat(weights, lengths), sum(lengths)
    samples = Samples(np.ones((1, n), bool), gap, weight, np.zeros(n), np.zeros(n, bool))
    rng = np.random.default_rng(11)
    rows = np.column_stack([rng.normal(size=n), np.cumsum(rng.normal(size=n)) / 50, np.sin(np.arange(n) / 40)])
    solve, log_det = slow_solver(samples, ratio, time)
    groups = EvenRows.of([rows], gap, weight)
    assert len(groups) == 3
    grams, log_dets = zip(*(group.at(np.array([ratio]), np.array([time])) for group in groups), strict=True)
    ideal = rows.T @ solve(np.asfortranarray(rows))
    size = np.sqrt(np.diag(ideal))
    np.testing.assert_allclose(sum(grams)[0] / size / size[:, None], ideal / size / size[:, None], atol=1e-9)
    assert sum(log_dets)[0] == pytest.approx(log_det, rel=1e-10)


def test_the_restricted_likelihood_is_that_of_the_filter():
    samples, setting = two_records(3)
    rng = np.random.default_rng(4)
    n = samples.gap.size
    J, r = rng.normal(size=(n, 2)), rng.normal(size=n)
    contrasts = Contrasts(samples, r, np.linalg.qr(J)[0], np.zeros((n, 0)))
    full = np.zeros((*samples.on.shape, 3))
    full[samples.on] = np.column_stack([J, r]) / np.sqrt(samples.weight)[:, None]
    both = []
    for ratio, time in ((0.3, 2.0), (4.0, 15.0)):
        (value,), (slow,), _ = contrasts.at(np.array([ratio]), np.array([time]))
        noise = OrnsteinUhlenbeck(noise_white=np.sqrt(ratio * slow), noise_slow=np.sqrt(slow), noise_time=time)
        other = restricted(noise, setting, jnp.asarray(full[..., 2]), jnp.asarray(full[..., :2]), jnp.ones(2, bool))
        both.append((-0.5 * value, float(other)))
    (a, wa), (b, wb) = both
    assert a - b == pytest.approx(wa - wb, rel=1e-6)


def test_the_likelihood_with_shapes_is_the_dense_one_at_its_best_strength():
    samples, setting = two_records(5)
    rng = np.random.default_rng(6)
    n, ratio, time = samples.gap.size, 0.5, 3.0
    shapes, basis = rng.normal(size=(n, 4)), np.linalg.qr(rng.normal(size=(n, 2)))[0]
    r = rng.normal(size=n) + 2 * shapes @ rng.normal(size=4)
    made = Contrasts(samples, r, basis, shapes, power=float(np.mean(r**2)))
    null = scipy.linalg.null_space(basis.T)

    def value(strength: float) -> float:
        cover = null.T @ (dense(samples, setting, np.sqrt(ratio), 1.0, time) + strength * shapes @ shapes.T) @ null
        square = (null.T @ r) @ np.linalg.solve(cover, null.T @ r) / (n - 2)
        prior = np.log(strength * square / made.expected) ** 2
        return (n - 2) * np.log(square) + np.linalg.slogdet(cover)[1] + prior

    best = min(value(s) for s in np.geomspace(1e-2, 1e3, 400))
    assert made.at(np.array([ratio]), np.array([time]))[0][0] == pytest.approx(best, abs=0.05)


@pytest.mark.parametrize("even", [True, False])
def test_noises_side_by_side_are_those_of_each_alone(even):
    """Residuals that take different numbers of steps, of which those that have ended leave; evenly sampled or not."""
    rng, samples = np.random.default_rng(9), two_records(9)[0]
    if even:
        t = np.arange(200) * 0.1
        samples = Samples.of(Setting.of(Batch.of(hf.Record(u=np.sin(t), y=t, t=t))))
    n, scales = samples.gap.size, np.array([0.0, 0.3, 1.0, 3.0, 10.0])
    slow = scipy.signal.lfilter([1.0], [1.0, -0.9], rng.normal(size=(5, n)), axis=1)
    residual, basis = rng.normal(size=(5, n)) + scales[:, None] * slow, np.linalg.qr(rng.normal(size=(5, n, 3)))[0]
    together = fit_slow_noises(Contrasts(samples, residual, basis, np.zeros((n, 0))))
    for k, found in enumerate(together):
        alone = fit_slow_noise(Contrasts(samples, residual[k], basis[k], np.zeros((n, 0))))
        assert found.noise.parameters == pytest.approx(alone.noise.parameters, rel=1e-6)
        np.testing.assert_allclose(found.shares, alone.shares, rtol=1e-6)


def test_least_squares_errors_are_those_of_the_dense_covariance():
    samples, setting = two_records(7)
    rng = np.random.default_rng(8)
    n = samples.gap.size
    J, r = rng.normal(size=(n, 3)) * [1.0, 1e3, 1e-3], rng.normal(size=n)
    made = fit_slow_noise(Contrasts(samples, r, np.linalg.qr(J)[0], np.zeros((n, 0))))
    alone = dataclasses.replace(made, others=(made.noise,), shares=np.ones(1))
    root = least_squares_root(alone, J)
    own = made.noise
    inverse = np.linalg.pinv(J)
    want = inverse @ dense(samples, setting, own.white, own.slow, own.time) @ inverse.T
    np.testing.assert_allclose(np.linalg.inv(root.T @ root), want, rtol=1e-6)


def loop() -> tuple[np.ndarray, np.ndarray, Setting]:
    """Input of eight modulated cycles, four regressors of a loop's kind, and the setting."""
    phase = np.arange(T) / T
    u = np.sin(2 * np.pi * CYCLES * phase) * (0.7 - 0.3 * np.cos(2 * np.pi * phase))
    lag = np.sin(2 * np.pi * CYCLES * phase - 0.5) * (0.7 - 0.3 * np.cos(2 * np.pi * phase))
    J = np.column_stack([np.ones(T), u, lag, u**3])
    return u, J, Setting.of(Batch.of(hf.Record(u=u, y=u)))


def slow(rng: np.random.Generator, rho: float) -> np.ndarray:
    e = rng.normal(size=T)
    e[1:] *= np.sqrt(1 - rho**2)
    for k in range(1, T):
        e[k] += rho * e[k - 1]
    return e


def left_of(u: np.ndarray, J: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ResidualAnalysis]:
    x = np.linalg.lstsq(J, y, rcond=None)[0]
    batch = Batch.of(hf.Record(u=u, y=y))
    full = np.zeros((batch.u.shape[1], J.shape[1] + 1))
    full[:T] = np.column_stack([y - J @ x, J])
    return x, ResidualAnalysis.of(Setting.of(batch), full[:, 0], lambda: J)


@pytest.mark.parametrize("white", [pytest.param(0.0, marks=pytest.mark.slow), 0.5])
def test_errors_are_as_large_as_estimates_spread_and_slow_noise_alarms_no_one(white):
    u, J, _ = loop()
    rng = np.random.default_rng(int(10 * white))
    squares, alarms = [], 0
    for _ in range(40):
        x, left = left_of(u, J, slow(rng, 0.97) + white * rng.normal(size=T))
        root = least_squares_root(left.slow, J)
        squares.append(x**2 / np.diag(np.linalg.inv(root.T @ root)))
        alarms += left.repeating is not None and left.repeating.shown
    inside = np.mean(np.array(squares) < 1.96**2)
    assert 0.9 < inside < 0.99  # 160 looks at 95 %
    assert alarms <= 3  # of 40 at 2 %


def test_error_that_repeats_is_found_under_slow_noise():
    u, J, _ = loop()
    rng, found = np.random.default_rng(1), 0
    for k in range(10):
        bump = 2 * np.where(np.gradient(u) >= 0, np.sin(3 * u + k), np.cos(3 * u - k))
        _, left = left_of(u, J, bump + 0.5 * slow(rng, 0.97) + 0.5 * rng.normal(size=T))
        assert left.repeating is not None
        found += left.repeating.shown
    assert found >= 9
    assert left.repeating.chance < CHANCE
    assert left.noise.noise.loop > 0


def test_the_size_of_a_repeating_error_is_read_off_what_the_model_leaves_of_it():
    """Curves drawn from the exact Gaussian process; four regressors swallow most of each."""
    u, J, _ = loop()
    rng, sizes, seen = np.random.default_rng(5), [], []
    place = (u - u.min()) / np.ptp(u)
    up = np.gradient(u) >= 0
    cover = np.exp(-0.5 * ((place[:, None] - place) / 0.3) ** 2) * (up[:, None] == up)
    values, vectors = np.linalg.eigh(cover)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    for _ in range(30):
        _, left = left_of(u, J, 2.0 * root @ rng.normal(size=T) + 0.5 * rng.normal(size=T))
        sizes.append(left.curve_size)
        seen.append(np.std(left.residual))
    # Shrunk, and shared with slow noise: a third too small on average, within the prior that `sample` makes of it.
    away = np.log(np.array(sizes) / 2.0)
    assert abs(away.mean()) < 0.5
    assert np.sqrt(np.mean(away**2)) < 0.7
    assert np.mean(seen) < 1.3
    assert left_of(u, J, rng.normal(size=T))[1].curve_size is None  # white: nothing is seen


def test_a_swinging_residual_is_correlated_though_its_correlations_cancel():
    y = np.sin(2 * np.pi * np.arange(600) / 12)
    assert autocorrelation_time(y) < 1.5
    assert is_correlated(y)
    assert not is_correlated(np.random.default_rng(0).normal(size=600))


def test_white_residuals_keep_plain_errors_and_slow_ones_widen_profiles_alike():
    model = hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)
    u = loop()[0]
    y, rng = np.asarray(hf.simulate(model, u)[0]), np.random.default_rng(2)
    white = hf.Record(u=u, y=y + 0.003 * rng.normal(size=T))
    fits = [hf.fit(model, white, start="model", starts=1, noise=noise) for noise in ("auto", "iid")]
    assert [p.stderr for p in fits[0].parameters] == [p.stderr for p in fits[1].parameters]
    wide = hf.fit(
        model, white.replace(y=y + 0.002 * slow(rng, 0.97) + 0.001 * rng.normal(size=T)), start="model", starts=1
    )
    assert wide.error_ratio > 2
    assert set(wide.noise.parameters) == {"noise_white", "noise_slow", "noise_time"}
    found = hf.profile(wide, ["c", "tau"])
    for name in ("c", "tau"):
        assert found[name].upper - found[name].lower == pytest.approx(2 * 1.96 * wide[name].stderr, rel=0.1)


def test_curvature_in_a_bent_valley_is_that_at_its_bottom():
    bent = lambda z: -0.5 * ((z[0] - 0.3) ** 2 / 0.09 + ((z[1] - 2 * z[0] ** 2) / 0.01) ** 2)
    found = jax.jit(lambda z: maximize(bent, z))(jnp.array([0.29, 0.17]))
    exact = jax.hessian(bent)(found.z)
    assert bent(found.z) > -1e-4
    np.testing.assert_allclose(np.linalg.inv(found.hessian), np.linalg.inv(exact), rtol=0.05)


def test_a_repeating_error_is_predicted_as_a_dense_gaussian_process_does():
    model = hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)
    phase = np.arange(240) / 240
    u = np.sin(2 * np.pi * 4 * phase)
    rng = np.random.default_rng(0)
    y = np.asarray(hf.simulate(model, u)[0]) + 0.05 * np.sin(4 * u) + 0.02 * rng.normal(size=240)
    fit = hf.fit(model, hf.Record(u=u, y=y), start="model", starts=1)
    noise = {"noise_white": 0.02, "noise_slow": 0.03, "noise_time": 5.0, "noise_loop": 0.06, "noise_length": 0.4}
    row = np.concatenate([[fit[n].value for n in fit.free_names], list(noise.values())])
    names = (*fit.free_names, *noise)
    nothing = Convergence(*(np.ones(row.size) for _ in range(3)))
    draws = np.tile(row, (1, 4000, 1))
    posterior = Posterior(
        fit, "nuts", "discrepancy", names, ("",) * row.size, draws, np.zeros((1, 4000)), {}, nothing, Status.OK, (), {}, 0.0, 0, {}
    )  # fmt: skip
    ahead = hf.Record(u=0.8 * np.sin(2 * np.pi * np.arange(60) / 60), y=np.zeros(60))
    got = predictive_draws(posterior, ahead, 4000, 0)
    setting = Setting.of(Batch.of(fit.data))
    on = np.asarray(setting.weight)[0] > 0
    place, up = np.asarray(setting.place)[0][on], np.asarray(setting.rising)[0][on]
    new, rise = (ahead.u - u.min()) / np.ptp(u), np.gradient(ahead.u) > 0
    rise = np.concatenate([[True], np.diff(ahead.u) > 0])
    cover = lambda a, ra, b, rb: 0.06**2 * np.exp(-0.5 * ((a[:, None] - b) / 0.4) ** 2) * (ra[:, None] == rb)
    at = np.arange(on.sum())
    K = cover(place, up, place, up) + 0.03**2 * np.exp(-np.abs(at[:, None] - at) / 5) + 0.02**2 * np.eye(at.size)
    across = cover(new, rise, place, up)
    residual = (y - fit.predict(fit.data[0]))[: at.size]
    mean = fit.predict(ahead) + across @ np.linalg.solve(K, residual)
    variance = 0.06**2 + 0.03**2 + 0.02**2 - np.einsum("ij,ji->i", across, np.linalg.solve(K, across.T))
    np.testing.assert_allclose(got.mean(axis=0), mean, atol=0.003)
    np.testing.assert_allclose(got.std(axis=0), np.sqrt(variance), rtol=0.06)


def test_what_is_left_of_a_fit_is_its_residuals():
    model = hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)
    u = loop()[0]
    record = hf.Record(u=u, y=np.asarray(hf.simulate(model, u)[0]) + 0.01 * slow(np.random.default_rng(0), 0.9))
    fit = hf.fit(model, record, start="model", starts=1)
    problem = Problem(fit.model, record)
    left = analyze(problem, problem.space.vector(fit.model))
    np.testing.assert_allclose(left.residual, fit.predict(record) - record.y, atol=1e-10)
    assert np.abs(left.basis.T @ left.residual).max() < 1e-4 * np.linalg.norm(left.residual)
