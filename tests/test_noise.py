"""Noise likelihoods against dense Gaussian densities, and the fits that they refine against least squares with the dense covariance."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

import hystfit as hf
from hystfit.data.batch import Batch
from hystfit.data.dataset import Dataset
from hystfit.errors import ParameterError
from hystfit.fitting.fit_setup import solve
from hystfit.fitting.noise_refinement import refine
from hystfit.inference.noise import (
    NOISES,
    Ar1,
    LoopDiscrepancy,
    OrnsteinUhlenbeck,
    Setting,
    StudentT,
    White,
)
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import analyze, diagnose, excess_kurtosis
from hystfit.inference.whitened import restricted
from hystfit.outcome import Code
from hystfit.outcome.note import has
from hystfit.sampling.setup import prepare


def setting_of(T: int, seed: int, even: bool = False, missing: bool = True) -> tuple[Setting, np.ndarray, np.ndarray]:
    """A setting of one record, with its gaps (T,) and weights (T,)."""
    rng = np.random.default_rng(seed)
    t = np.arange(T) * 0.1 if even else np.cumsum(rng.exponential(0.1, T))
    u = np.sin(0.7 * t / t[-1] * 20)
    y = rng.normal(size=T)
    if missing:
        y[rng.integers(0, T, T // 6)] = np.nan
    weight = np.where(rng.random(T) < 0.5, 1.0, 2.5)
    batch = Batch.of(hf.Record(u=u, y=y, t=t, weight=weight))
    made = Setting.of(batch)
    gap = np.broadcast_to(np.asarray(made.gap), np.asarray(made.weight).shape)[0]
    return made, gap, np.asarray(made.weight)[0]


def dense(noise: object, gap: np.ndarray, weight: np.ndarray, setting: Setting) -> np.ndarray:
    """Covariance of the samples that count, entry by entry."""
    on = weight > 0
    time = np.cumsum(gap)[on]
    cover = np.zeros((on.sum(), on.sum()))
    if hasattr(noise, "noise_slow"):
        cover += float(noise.noise_slow) ** 2 * np.exp(-np.abs(time[:, None] - time) / float(noise.noise_time))
    if hasattr(noise, "noise_white"):
        cover += np.diag(float(noise.noise_white) ** 2 / weight[on])
    if hasattr(noise, "noise_loop"):
        place, up = np.asarray(setting.place)[0][on], np.asarray(setting.rising)[0][on]
        kernel = np.exp(-0.5 * ((place[:, None] - place) / float(noise.noise_length)) ** 2)
        cover += float(noise.noise_loop) ** 2 * kernel * (up[:, None] == up)
    return cover


CASES = [
    (White(noise_white=0.7), 1e-10),
    (OrnsteinUhlenbeck(noise_white=0.5, noise_slow=1.3, noise_time=4.0), 1e-10),
    (Ar1(noise_slow=1.3, noise_time=4.0), 1e-6),
    # Twelve inducing points against the exact kernel: the difference is theirs, not the likelihood's.
    (LoopDiscrepancy(noise_white=0.5, noise_slow=0.4, noise_time=4.0, noise_loop=0.8, noise_length=0.4), 1e-4),
]


@eqx.filter_jit
def log_density(noise, setting, r):
    """In one program: each operation of its own compiles for as long."""
    return noise.log_density(setting, r)


@pytest.mark.parametrize(("noise", "tolerance"), CASES, ids=lambda v: getattr(v, "name", ""))
@pytest.mark.parametrize("even", [False, True])
def test_log_density_is_the_dense_gaussian(noise, tolerance, even):
    setting, gap, weight = setting_of(60, 3, even)
    r = np.random.default_rng(1).normal(size=weight.size)
    on = weight > 0
    want = scipy.stats.multivariate_normal(cov=dense(noise, gap, weight, setting)).logpdf(r[on])
    assert float(log_density(noise, setting, jnp.asarray(r)[None])) == pytest.approx(want, rel=tolerance)


@pytest.mark.parametrize("noise", [CASES[1][0], CASES[2][0], OrnsteinUhlenbeck(2.0, 0.01, 3e4)], ids=str)
def test_density_of_full_records_is_the_dense_gaussian_and_has_its_derivatives(noise):
    """Records of different length, each with one weight: the variances have a closed form."""
    rng, sizes, weights = np.random.default_rng(2), (60, 45), (1.0, 2.5)
    rows = [(str(n), rng.normal(size=n), np.full(n, weight)) for n, weight in zip(sizes, weights, strict=True)]
    records = [hf.Record(u=y, y=y, t=np.arange(y.size) * 0.1, weight=w, name=name) for name, y, w in rows]
    full = Setting.of(Batch.of(Dataset.of(records)))
    np.testing.assert_array_equal(full.full, sizes)
    r = np.zeros(full.weight.shape)
    covers = []
    for k, (n, weight) in enumerate(zip(sizes, weights, strict=True)):
        r[k, :n] = rng.normal(size=n)
        covers.append(dense(noise, np.ones(n), np.full(n, weight), full))
    normal = lambda cover, row: scipy.stats.multivariate_normal(cov=cover, allow_singular=True).logpdf(row)
    want = sum(normal(cover, row[:n]) for cover, row, n in zip(covers, r, sizes, strict=True))
    tolerance = 1e-6 if isinstance(noise, Ar1) else 1e-9
    assert float(log_density(noise, full, jnp.asarray(r))) == pytest.approx(want, rel=tolerance)
    recursion = dataclasses.replace(full, full=None)
    slope = eqx.filter_jit(lambda s, n, r: jax.grad(lambda n, r: n.log_density(s, r), (0, 1))(n, r))
    slopes = [slope(s, noise, jnp.asarray(r)) for s in (full, recursion)]
    for one, other in zip(*map(jax.tree.leaves, slopes), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-8 * np.abs(other).max())


def test_only_records_whose_samples_count_alike_are_full():
    t = np.arange(8.0)
    rising = hf.Record(u=t, y=t, t=t)
    for weight in (np.r_[1, 1, 0, np.ones(5)], np.r_[0, np.ones(7)], np.r_[2, np.ones(7)]):
        assert Setting.of(Batch.of(rising.replace(weight=weight))).full is None
    assert Setting.of(Batch.of(hf.Record(u=t, y=t, t=t**1.5))).full is None
    assert Setting.of(Batch.of(rising.replace(weight=np.r_[np.ones(6), 0, 0]))).full == 6


whiten = eqx.filter_jit(lambda noise, setting, rows: noise.whiten(setting, rows))


@settings(max_examples=12)
@given(white=st.floats(0.05, 3), slow=st.floats(0.05, 3), time=st.floats(0.3, 200), seed=st.integers(0, 99))
def test_whitening_is_a_square_root_of_the_inverse_covariance(white, slow, time, seed):
    setting, gap, weight = setting_of(25, seed)
    noise = OrnsteinUhlenbeck(noise_white=white, noise_slow=slow, noise_time=time)
    on = weight > 0
    cover = dense(noise, gap, weight, setting)
    rows = jnp.eye(weight.size)[None]
    e, logs = whiten(noise, setting, rows)
    W = np.asarray(e)[0][np.ix_(on, on)]
    np.testing.assert_allclose(W @ cover @ W.T, np.eye(on.sum()), atol=1e-9)
    assert float(logs.sum()) == pytest.approx(np.linalg.slogdet(cover)[1], rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("noise", "_"), CASES[:3], ids=lambda v: getattr(v, "name", ""))
def test_the_filter_sample_by_sample_is_the_one_over_records(noise, _):
    setting, gap, weight = setting_of(30, 6)
    r = jnp.asarray(np.random.default_rng(1).normal(size=weight.size))
    state, total = noise.init(), 0.0
    for k in range(30):
        state, e, logs = noise.step(state, r[k], jnp.asarray(gap[k]), jnp.asarray(weight[k]))
        total += float(noise.density(e, logs)) if weight[k] > 0 else 0.0
    assert float(log_density(noise, setting, r[None])) == pytest.approx(total, rel=1e-10)


def test_student_t_is_scipys():
    setting, _, weight = setting_of(50, 2)
    r = np.random.default_rng(4).normal(size=weight.size)
    on = weight > 0
    noise = StudentT(noise_white=0.6, noise_dof=3.5)
    want = scipy.stats.t(3.5, scale=0.6 / np.sqrt(weight[on])).logpdf(r[on]).sum()
    assert float(log_density(noise, setting, jnp.asarray(r)[None])) == pytest.approx(want, rel=1e-12)


@pytest.mark.parametrize("dof", [2.5, 5.0, 40.0])
def test_student_t_has_the_information_of_its_gaussian_scale(dof):
    """Fisher information about the mean, the integral of (d log p / de)^2 p."""
    e = np.linspace(-400.0, 400.0, 800_001)
    log_p = scipy.stats.t.logpdf(e, dof, scale=0.6)
    information = np.sum(np.gradient(log_p, e) ** 2 * np.exp(log_p)) * (e[1] - e[0])
    assert float(StudentT(noise_white=0.6, noise_dof=dof).gaussian_scale()) == pytest.approx(
        information**-0.5, rel=1e-4
    )


def test_records_add_and_padding_counts_nothing():
    setting, _, weight = setting_of(40, 5, missing=False)
    two = eqx.tree_at(
        lambda s: (s.gap, s.weight, s.place, s.rising),
        setting,
        tuple(jnp.concatenate([v, v]) for v in (setting.gap, setting.weight, setting.place, setting.rising)),
    )
    r = jnp.asarray(np.random.default_rng(0).normal(size=weight.size))[None]
    noise = OrnsteinUhlenbeck(noise_white=0.5, noise_slow=1.0, noise_time=6.0)
    once = float(log_density(noise, setting, r))
    assert float(log_density(noise, two, jnp.concatenate([r, r]))) == pytest.approx(2 * once, rel=1e-12)
    changed = r + jnp.where(setting.weight > 0, 0.0, 100.0)
    assert float(log_density(noise, setting, changed)) == once


def test_restricted_likelihood_is_the_density_of_error_contrasts():
    setting, gap, weight = setting_of(40, 8, missing=False)
    on = weight > 0
    rng = np.random.default_rng(0)
    J = rng.normal(size=(weight.size, 2)) * on[:, None]
    r = rng.normal(size=weight.size) * on
    contrasts = scipy.linalg.null_space(J[on].T)
    values = []
    for noise in (
        OrnsteinUhlenbeck(noise_white=0.5, noise_slow=1.0, noise_time=6.0),
        OrnsteinUhlenbeck(noise_white=1.0, noise_slow=0.4, noise_time=2.0),
    ):
        cover = contrasts.T @ dense(noise, gap, weight, setting) @ contrasts
        want = scipy.stats.multivariate_normal(cov=cover).logpdf(contrasts.T @ r[on])
        got = eqx.filter_jit(restricted)(noise, setting, jnp.asarray(r)[None], jnp.asarray(J)[None], np.ones(2, bool))
        values.append((float(got), want))
    (a, wa), (b, wb) = values
    assert a - b == pytest.approx(wa - wb, rel=1e-6)  # the definitions differ by a constant


def noisy_loop(seed: int, kind: str, T: int = 1500, cycles: float = 10) -> tuple[hf.Record, hf.BoucWen]:
    """Bouc-Wen with white noise or heavy tails, and slow or repeating error beside white noise."""
    rng = np.random.default_rng(seed)
    phase = np.arange(T) / T
    u = np.sin(2 * np.pi * cycles * phase) * (0.4 + 0.6 * phase)
    model = hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)
    y = np.asarray(hf.simulate(model, u)[0]) + 0.01 * (rng.standard_t(3, T) if kind == "tails" else rng.normal(size=T))
    if kind == "slow":
        e, a = np.zeros(T), np.exp(-1 / 50)
        for k in range(1, T):
            e[k] = a * e[k - 1] + 0.02 * np.sqrt(1 - a * a) * rng.normal()
        y = y + e
    if kind == "repeating":
        y = y + np.where(np.gradient(u) > 0, 0.03 * np.sin(5 * u), -0.03 * np.cos(4 * u))
    return hf.Record(u=u, y=y), model


def test_refined_fit_is_least_squares_with_the_dense_covariance():
    record, model = noisy_loop(0, "slow")
    problem = Problem(model, record)
    found = refine(problem, solve(problem, "lm", 1, 0).x, "ou")
    setting = found.problem.setting
    weight = np.asarray(setting.weight)[0]
    inverse = np.linalg.inv(dense(found.noise, np.ones(weight.size), weight, setting))
    on = weight > 0
    r, J = (rows[0][on] for rows in problem.linearize(found.x))
    information = J.T @ inverse @ J
    np.testing.assert_allclose(found.root.T @ found.root, information, rtol=1e-6, atol=1e-9 * information.max())
    step = np.linalg.solve(information, J.T @ inverse @ r)
    assert np.all(np.abs(step) < 1e-3 * np.sqrt(np.diag(np.linalg.inv(information))))  # no step is left to take
    whitened = found.problem.whitened()
    cost = float(jax.jit(lambda x: whitened.normal_of(*whitened.objective.linearize(x))[0])(jnp.asarray(found.x)))
    assert cost == pytest.approx(0.5 * r @ inverse @ r, rel=1e-8)


# What was added to the loop, and how closely one record determines it.
ADDED = {
    "ou": ("slow", {"noise_white": (0.01, 0.1), "noise_slow": (0.02, 0.4), "noise_time": (50.0, 0.8)}),
    "student-t": ("tails", {"noise_white": (0.01, 0.1), "noise_dof": (3.0, 0.3)}),
    "discrepancy": ("repeating", {"noise_white": (0.01, 0.1)}),
}


@pytest.mark.parametrize("noise", ADDED)
def test_fit_takes_every_noise_model(noise):
    kind, added = ADDED[noise]
    record, model = noisy_loop(1, kind)
    result = hf.fit(model, record, noise=noise, starts=1)
    assert result.usable
    assert result.noise.name == noise
    for name, truth in (("c", 1.0), ("mu", 0.5), ("tau", 2.0)):
        error = result[name].stderr
        assert error is not None
        assert abs(result[name].value - truth) < 4 * error
    assert has(result.notes, Code.NOISE_MODEL)
    values = result.noise.parameters
    for name, (truth, part) in added.items():
        assert values[name] == pytest.approx(truth, rel=part)
    if noise == "discrepancy":  # curves of variance 0.03^2 / 2, part of which the model takes up
        assert 0.005 < values["noise_loop"] < 0.04


@pytest.mark.parametrize(("kind", "want"), [("white", "iid"), ("slow", "ou"), ("repeating", "discrepancy")])
def test_diagnosis_names_the_noise(kind, want):
    names = []
    for seed in range(3):
        record, model = noisy_loop(seed, kind)
        problem = Problem(model, record)
        names.append(diagnose(analyze(problem, solve(problem, "lm", 1, 0).x)).recommended)
    assert names.count(want) >= 2, names


def test_the_kurtosis_of_residuals_has_no_unit():
    rows = [np.random.default_rng(0).standard_t(5, size=400)]
    differences = np.diff(rows[0])
    for size in (1e-100, 1.0, 1e120):
        assert excess_kurtosis([size * rows[0]]) == pytest.approx(scipy.stats.kurtosis(differences), rel=1e-9)


@pytest.mark.slow
def test_the_noise_model_in_use_is_not_recommended():
    """A misfit that recurs every loop: discrepancy noise is advised beside another model, and not beside itself."""
    record, model = noisy_loop(0, "repeating", T=600)
    fit = hf.fit(model, record, starts=1)
    notes = {name: [note.text for note in prepare(fit, noise=name).notes] for name in ("iid", "auto")}
    advises = {name: any("noise='discrepancy'" in text for text in texts) for name, texts in notes.items()}
    assert any(text.startswith("noise model discrepancy") for text in notes["auto"])
    assert advises == {"iid": True, "auto": False}


def test_the_plain_fit_warns_of_error_that_repeats_and_iid_of_correlation():
    record, model = noisy_loop(0, "repeating")
    assert has(hf.fit(model, record, starts=1).notes, Code.REPEATING_RESIDUALS)
    assert not has(hf.fit(model, record, starts=1, noise="discrepancy").notes, Code.REPEATING_RESIDUALS)
    slow, _ = noisy_loop(0, "slow")
    assert has(hf.fit(model, slow, starts=1, noise="iid").notes, Code.CORRELATED_RESIDUALS)
    assert not has(hf.fit(model, slow, starts=1, noise="ou").notes, Code.REPEATING_RESIDUALS)


@pytest.mark.usefixtures("as_users_run")
def test_unknown_noise_and_a_robust_loss_beside_one_are_refused():
    record, model = noisy_loop(0, "white")
    with pytest.raises(ParameterError, match="noise must be one of"):
        hf.fit(model, record, noise="pink")
    with pytest.raises(ParameterError, match="iid, ou, ar1"):
        NOISES.make("pink")
    with pytest.raises(ParameterError, match="likelihood of its own"):
        hf.fit(model, record, noise="ou", loss="huber")
    assert set(NOISES) == {"iid", "ou", "ar1", "student-t", "discrepancy"}


@pytest.mark.slow
def test_a_noise_model_frees_what_a_repeating_error_pushed_to_a_bound():
    """Least squares puts rho on its bound; held there, the others were wrong by ten of their errors."""
    truth = hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)
    phase = np.arange(1600) / 1600
    u = np.sin(2 * np.pi * 8 * phase) * (0.7 - 0.3 * np.cos(2 * np.pi * phase))
    rng = np.random.default_rng([94, 3])  # of a hundred draws one of the eleven on which that happens
    y = np.asarray(hf.simulate(truth, u)[0]) + 0.01 * rng.normal(size=u.size)
    place, grid = (u - u.min()) / np.ptp(u), np.linspace(0, 1, 60)
    cover = np.exp(-0.5 * ((grid[:, None] - grid) / 0.25) ** 2) + 1e-9 * np.eye(60)
    up, down = (np.interp(place, grid, curve) for curve in (np.linalg.cholesky(cover) @ rng.normal(size=(60, 2))).T)
    y = y + 0.02 * np.where(np.gradient(u) >= 0, up, down)
    record = hf.Record(u=u, y=y)
    plain = hf.fit(truth, record, start="model", starts=1)
    assert plain["rho"].at_bound == "upper"
    found = hf.fit(truth, record, start="model", starts=1, noise="discrepancy")
    assert found["rho"].at_bound is None
    for name, value in (("c", 1.0), ("mu", 0.5), ("tau", 2.0), ("rho", 0.5)):
        assert abs(found[name].value - value) < 4 * found[name].stderr, name


def test_a_record_without_time_beside_one_with_it_is_evenly_sampled():
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.exponential(0.1, 40))
    timed = hf.Record(u=np.sin(t), y=rng.normal(size=40), t=t, name="timed")
    plain = hf.Record(u=np.sin(t[:30]), y=rng.normal(size=30), name="plain")
    both = np.asarray(Setting.of(Batch.of(hf.Dataset((timed, plain)))).gap)
    np.testing.assert_array_equal(both[1, :30], 1.0)
    np.testing.assert_allclose(both[0, 1:40] * np.median(timed.dt[timed.dt > 0]), np.diff(t), rtol=1e-9)
