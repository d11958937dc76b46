"""Noise of predictive bands: its covariance, and its coverage where the noise has spikes and where it is Gaussian."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import hystfit as hf
from hystfit.data.batch import Batch
from hystfit.inference.noise import OrnsteinUhlenbeck, Setting, StudentT, White
from hystfit.inference.noise.base import drive, resample
from hystfit.outcome import Status
from hystfit.sampling.diagnostics import Convergence
from hystfit.sampling.posterior import Posterior
from hystfit.sampling.predictive import predictive_draws

T, REPLICATES = 400, 60


def spikes(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Unit variance; 3 % of the values are eight times as large as the others."""
    values = rng.normal(size=shape) * np.where(rng.random(shape) < 0.03, 8.0, 1.0)
    return values / np.sqrt(0.97 + 0.03 * 64)


@pytest.mark.parametrize("noise", [White(noise_white=0.7), OrnsteinUhlenbeck(0.7, 1.3, 4.0)], ids=["iid", "ou"])
def test_innovations_drive_the_cholesky_factor_of_the_covariance(noise):
    rng = np.random.default_rng(0)
    t, weight = np.cumsum(rng.exponential(0.1, 30)), np.where(rng.random(30) < 0.5, 1.0, 2.5)
    setting = Setting.of(Batch.of(hf.Record(u=np.sin(t), y=t, t=t, weight=weight)))
    on = np.asarray(setting.weight)[0] > 0
    setting = eqx.tree_at(lambda s: s.weight, setting, jnp.where(setting.weight > 0, setting.weight, 1.0))
    unit = jnp.eye(on.size)[:, None]
    columns = jax.vmap(lambda e: drive(noise.step, noise.init(), setting, e))(unit)[:, 0].T
    at = np.cumsum(np.asarray(jnp.broadcast_to(setting.gap, setting.weight.shape))[0][on])
    slow = getattr(noise, "noise_slow", 0.0) ** 2 * np.exp(
        -np.abs(at[:, None] - at) / getattr(noise, "noise_time", 1.0)
    )
    wanted = np.linalg.cholesky(slow + np.diag(0.7**2 / weight))
    np.testing.assert_allclose(np.asarray(columns)[np.ix_(on, on)], wanted, atol=1e-12)


def coverages(noise, seen_residual: np.ndarray, new_noise: np.ndarray) -> tuple[float, float]:
    """Coverage of bands of 90 % from predictive noise, and from Gaussian realizations; rows are replicates."""
    phase = np.arange(T) / 40
    setting = Setting.of(Batch.of(hf.Record(u=np.sin(2 * np.pi * phase), y=phase)))
    full = eqx.tree_at(lambda s: s.weight, setting, jnp.ones_like(setting.weight))
    pad = full.weight.shape[1] - T
    keys = jax.random.split(jax.random.key(0), 200)

    @eqx.filter_jit
    def draws(residual):
        residual = jnp.pad(residual, (0, pad))[None]
        ahead = jax.lax.map(lambda key: noise.predictive(full, key, setting, residual)[0, :T], keys)
        return ahead, jax.lax.map(lambda key: noise.draw(full, key)[0, :T], keys)

    inside = []
    for residual, true in zip(seen_residual, new_noise, strict=True):
        edges = [np.quantile(np.asarray(d), [0.05, 0.95], axis=0) for d in draws(jnp.asarray(residual))]
        inside.append([np.mean((true >= low) & (true <= high)) for low, high in edges])
    resampled, gaussian = np.mean(inside, axis=0)
    return float(resampled), float(gaussian)


def slow(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Rows of an Ornstein-Uhlenbeck process of unit variance, correlated over ten samples."""
    decay = np.exp(-0.1)
    rows = [rng.normal(size=shape[0])]
    for _ in range(shape[1] - 1):
        rows.append(decay * rows[-1] + np.sqrt(1 - decay**2) * rng.normal(size=shape[0]))
    return np.stack(rows, axis=1)


@pytest.mark.slow
def test_bands_hold_what_they_claim_under_spikes_and_under_gaussian_noise():
    rng, shape = np.random.default_rng(1), (2 * REPLICATES, T)
    noise = OrnsteinUhlenbeck(1.0, 0.5, 10.0)
    rough = spikes(rng, shape) + 0.5 * slow(rng, shape)
    resampled, gaussian = coverages(noise, rough[::2], rough[1::2])
    assert resampled == pytest.approx(0.9, abs=0.015)
    assert gaussian > 0.94
    smooth = rng.normal(size=shape) + 0.5 * slow(rng, shape)
    resampled, gaussian = coverages(noise, smooth[::2], smooth[1::2])
    assert resampled == pytest.approx(gaussian, abs=0.006)
    assert resampled == pytest.approx(0.9, abs=0.015)


def test_few_residuals_keep_the_tails_of_gaussian_noise():
    rng, inside = np.random.default_rng(2), []
    on = jnp.arange(40) < 30
    made = eqx.filter_jit(lambda e, key: resample(e, on, (4000,), key))
    for number in range(200):
        e = np.where(on, rng.normal(size=40), 1e6)
        low, high = np.quantile(np.asarray(made(jnp.asarray(e), jax.random.key(number))), [0.05, 0.95])
        inside.append(np.mean(np.abs(rng.normal(size=4000)) < (high - low) / 2))
    assert np.mean(inside) > 0.88  # 0.86 from the residuals themselves


def test_noise_that_is_not_gaussian_draws_from_its_own_distribution():
    noise, setting = (
        StudentT(noise_white=1.0, noise_dof=3.0),
        Setting.of(Batch.of(hf.Record(u=np.arange(30.0), y=np.zeros(30)))),
    )
    key, residual = jax.random.key(0), jnp.ones(setting.weight.shape)
    np.testing.assert_array_equal(noise.predictive(setting, key, setting, residual), noise.draw(setting, key))


def test_beside_records_of_a_fit_the_noise_is_students_t_of_the_groups_left_out():
    """The records err by 0.5 where each is left out, and by 0.01 where all are fitted."""
    rng, u = np.random.default_rng(4), np.sin(np.arange(120) / 6)
    model = hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)
    loop = lambda size, name: hf.Record(u=size * u, y=np.asarray(hf.simulate(model, size * u)[0]), name=name)
    seen = [loop(size, f"{size}") for size in (0.6, 0.8, 1.0)]
    seen = [record.replace(y=record.y + 0.01 * rng.normal(size=u.size)) for record in seen]
    fit = dataclasses.replace(hf.fit(model, seen, start="model", starts=1), left_out=0.5)
    row = np.append(fit.x, 0.01)
    nothing = Convergence(*(np.ones(row.size) for _ in range(3)))
    names, many = (*fit.free_names, "noise_white"), np.tile(row, (1, 2000, 1))
    posterior = Posterior(
        fit,
        "nuts",
        "iid",
        names,
        ("",) * row.size,
        many,
        np.zeros((1, 2000)),
        {},
        nothing,
        Status.OK,
        (),
        {},
        0.0,
        0,
        {},
    )
    groups = fit.problem.held_out.count
    assert groups < 10  # where Student's t is far from a normal distribution
    ahead = loop(0.9, "other")
    away = predictive_draws(posterior, ahead, 2000, 0) - np.mean([fit.predict(ahead)], axis=0)
    for level in (0.5, 0.9, 0.98):  # 2000 draws and 120 samples of each, whose noise is that of 360 residuals
        wanted = scipy.stats.t(groups, scale=0.5).ppf(0.5 + 0.5 * level)
        assert np.quantile(np.abs(away), level) == pytest.approx(wanted, rel=0.1)
    again = predictive_draws(posterior, seen[0], 2000, 0)
    assert np.std(again - again.mean(axis=0)) == pytest.approx(0.01, rel=0.05)


@pytest.mark.parametrize("noise", ["iid", "discrepancy"])
def test_bands_of_a_posterior_cover_spikes(noise):
    rng, n = np.random.default_rng(3), 1000
    model = hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)
    u = np.sin(2 * np.pi * np.arange(n) / 100)
    y = np.asarray(hf.simulate(model, u)[0])
    spiky = hf.Record(u=u, y=y + 0.02 * spikes(rng, (n,)))
    fit = hf.fit(model, spiky, start="model", starts=1, loss="huber")  # which keeps outliers
    sd = float(np.std(fit.data[0].y - fit.predict(fit.data[0])))
    size = {"noise_white": sd}
    if noise == "discrepancy":
        size |= {"noise_slow": 1e-4, "noise_time": 5.0, "noise_loop": 1e-3, "noise_length": 0.4}
    row = np.concatenate([fit.x, list(size.values())])
    nothing = Convergence(*(np.ones(row.size) for _ in range(3)))
    posterior = Posterior(
        fit, "nuts", noise, (*fit.free_names, *size), ("",) * row.size, np.tile(row, (1, 300, 1)), np.zeros((1, 300)), {}, nothing,
        Status.OK, (), {}, 0.0, 0, {},
    )  # fmt: skip
    measured = y + 0.02 * spikes(rng, (n,))
    low, _, high = posterior.bands(hf.Record(u=u, y=y), count=300)
    assert np.mean((measured >= low) & (measured <= high)) == pytest.approx(0.9, abs=0.025)
    assert np.mean(np.abs(measured - y) < 1.645 * sd) > 0.95  # Gaussian bands
