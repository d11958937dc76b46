"""Sampling of linear weights by hundreds: against integrals, rejection, dense covariances; files, predictions and bad input."""

from __future__ import annotations

import dataclasses
import itertools
import warnings
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import gamma, norm, rankdata
from scipy.stats import t as student

import hystfit as hf
from hystfit import priors
from hystfit.errors import ParameterError
from hystfit.inference.noise.slow_likelihood import Samples
from hystfit.inference.problem import Problem
from hystfit.models import PrandtlIshlinskii, Preisach
from hystfit.outcome import Status
from hystfit.sampling.noise_grid import NoiseGrid
from hystfit.sampling.sample import suited_sampler
from hystfit.sampling.truncated_normal import draw_opposite, draw_truncated, inverse
from hystfit.sampling.weight_equations import weight_equations, weight_priors
from hystfit.sampling.weight_sampler import Weights, overrelaxed


def turning(seed: int, count: int, steps: int = 12) -> np.ndarray:
    rng = np.random.default_rng(seed)
    turns = np.concatenate([[0.0, 1.0, -1.0], rng.uniform(-1, 1, count)])
    return np.concatenate([np.linspace(a, b, steps, endpoint=False) for a, b in itertools.pairwise(turns)])


@pytest.mark.parametrize("opposite", [False, True])
def test_exact_motion_has_the_moments_of_a_truncated_normal(opposite: bool) -> None:
    # Three coordinates, two of them bounded, one with its mean outside: moments by sums over a grid.
    precision = np.array([[2.0, 0.9, -0.4], [0.9, 1.5, 0.6], [-0.4, 0.6, 1.0]])
    slope, bounded = np.array([-1.5, 1.0, 0.3]), np.array([True, True, False])
    axes = np.linspace(0, 6, 121), np.linspace(0, 6, 121), np.linspace(-8, 8, 161)
    x = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    mass = np.exp(-0.5 * np.einsum("ni,ij,nj->n", x, precision, x) + x @ slope)
    edges = np.prod([np.where(x[:, k] == 0, 0.5, 1.0) for k in (0, 1)], axis=0)  # the trapezoidal rule
    mass *= edges / (mass @ edges)
    mean = mass @ x
    covariance = (x * mass[:, None]).T @ x - np.outer(mean, mean)

    density = jnp.asarray(slope), jnp.asarray(precision), jnp.asarray(bounded)

    def move(x: jax.Array, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        new = draw_opposite(key, x, *density, order, 8) if opposite else draw_truncated(key, x, *density)[-1]
        return new, new

    order = lambda x: x @ x
    found = np.asarray(
        jax.jit(lambda: jax.lax.scan(move, jnp.ones(3), jax.random.split(jax.random.key(0), 8_000))[1])()
    )
    assert (found[:, bounded] >= 0).all()
    error = np.sqrt(np.diag(covariance) / 2000)  # at least a quarter as many effective draws
    np.testing.assert_array_less(np.abs(found.mean(axis=0) - mean), 4 * error)
    np.testing.assert_allclose(np.cov(found.T), covariance, atol=0.05)
    sizes = rankdata(np.sum(found**2, axis=1))
    along = np.corrcoef(sizes[1:], sizes[:-1])[0, 1]
    assert along < -0.5 if opposite else along > -0.2


def test_the_inverse_by_blocks_is_that_of_the_whole() -> None:
    roots = np.random.default_rng(0).normal(size=(150, 150))
    matrix = roots @ roots.T / 150 + 0.01 * np.eye(150)
    found = np.asarray(jax.jit(inverse)(jnp.asarray(matrix)))
    np.testing.assert_allclose(found, np.linalg.inv(matrix), rtol=0, atol=1e-11 * np.abs(found).max())


def test_overrelaxation_leaves_a_density_as_it_is_and_takes_the_other_side() -> None:
    def move(value: jax.Array, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        new = overrelaxed(value, jax.random.gamma(key, 3.0, (15,)))
        return new, new

    keys = jax.random.split(jax.random.key(0), 20_000)
    draws = np.asarray(jax.jit(lambda: jax.lax.scan(move, jnp.asarray(3.0), keys)[1])())
    assert np.corrcoef(draws[1:], draws[:-1])[0, 1] < -0.7
    levels = np.array([0.05, 0.25, 0.5, 0.75, 0.95])
    np.testing.assert_allclose([np.mean(draws <= gamma(3.0).ppf(level)) for level in levels], levels, atol=0.01)


@pytest.fixture(scope="module")
def plays() -> hf.FitResult:
    u = turning(1, 12)
    model = PrandtlIshlinskii(w=[[0.6, 0.01, 0.3]], r=[0.0, 0.2, 0.4], low=-1.0, high=1.0)
    y = np.asarray(hf.simulate(model, u)[0]) + 0.05 * np.random.default_rng(2).normal(size=u.size)
    return hf.fit(model, hf.Record(u=u, y=y))


def test_draws_agree_with_rejection_from_the_unbounded_posterior(plays: hf.FitResult) -> None:
    # With vague priors the posterior without bounds is normal and inverse gamma in closed form; rejection puts in the bounds.
    residual, jacobian = plays.problem.linearize(plays.x)
    on = plays.problem.used
    X, r = jacobian[on], residual[on]
    A = X.T @ X
    best = plays.x - np.linalg.solve(A, X.T @ r)
    rss, n, p = float(np.sum((r + X @ (best - plays.x)) ** 2)), len(r), len(best)
    rng = np.random.default_rng(3)
    variance = rss / rng.chisquare(n - p, size=50_000)
    z = rng.normal(size=(variance.size, p))
    w = best + np.sqrt(variance)[:, None] * np.linalg.solve(np.linalg.cholesky(A).T, z.T).T
    inside = (w >= plays.problem.space.lower).all(axis=1)
    assert 0.05 < inside.mean() < 0.95  # the bound matters
    expected = np.column_stack([w, np.sqrt(variance)])[inside]
    vague = {"offset": priors.Normal(0, 100), **{f"w[0,{k}]": priors.HalfNormal(100) for k in range(3)}}
    posterior = hf.sample(plays, "weights", noise="iid", draws=300, seed=4, priors=vague)
    found = posterior.draws.reshape(-1, p + 1)
    assert posterior.names[-1] == "noise_white"
    sd = expected.std(axis=0)
    np.testing.assert_array_less(np.abs(found.mean(axis=0) - expected.mean(axis=0)), 0.15 * sd)
    np.testing.assert_allclose(found.std(axis=0), sd, rtol=0.12)
    np.testing.assert_allclose(
        np.quantile(found, 0.95, axis=0), np.quantile(expected, 0.95, axis=0), atol=0.2 * sd.max()
    )


def test_equations_are_those_of_the_dense_covariance(plays: hf.FitResult) -> None:
    weights = np.random.default_rng(0).uniform(0.5, 2.0, len(plays.data[0]))
    problem = plays.problem.reweighted([weights])
    grid = NoiseGrid(np.array([0.3, 5.0]), np.array([4.0, 20.0]), np.zeros(2))
    chosen = {**weight_priors(problem, plays.x, None), "offset": priors.Normal(0.2, 0.5)}
    found = weight_equations(problem, plays.x, grid, chosen, size=2.0)
    residual, jacobian = (rows[problem.used] for rows in problem.linearize(plays.x))
    lags = np.abs(np.subtract.outer(np.arange(residual.size), np.arange(residual.size)))
    for k, (ratio, time) in enumerate(zip(grid.ratios, grid.times, strict=True)):
        covariance = np.exp(-lags / time) + np.diag(ratio / weights)
        inverse = np.linalg.inv(covariance)
        np.testing.assert_allclose(found.squares[k], residual @ inverse @ residual / 4, rtol=1e-8)
        np.testing.assert_allclose(found.slopes[k], jacobian.T @ inverse @ residual / 2, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(found.grams[k], jacobian.T @ inverse @ jacobian, rtol=1e-7, atol=1e-9)
        # The log determinant is that of weighted residuals, the same constant away for every noise.
        log_det = np.linalg.slogdet(covariance)[1] + np.sum(np.log(weights))
        np.testing.assert_allclose(found.log_dets[k], log_det, rtol=1e-8)
    k = plays.free_names.index("offset")
    np.testing.assert_allclose([found.precision[k], found.pull[k]], [4 / 0.25, 2 * 0.2 / 0.25])


@pytest.fixture(scope="module")
def cells() -> hf.FitResult:
    rng = np.random.default_rng(5)
    records = []
    for number in range(2):
        u = turning(6 + number, 12)
        model = dataclasses.replace(Preisach.of(6, spacing="uniform"), offset=0.1 * number)
        model = eqx.tree_at(lambda m: m.w, model, jnp.asarray(np.random.default_rng(8).exponential(0.05, 21)))
        y = np.asarray(model.free_run(u)) + 0.01 * rng.normal(size=u.size)
        records.append(hf.Record(u=u, y=y, name=f"loop {number}"))
    return hf.fit(Preisach.of(6, spacing="uniform"), hf.Dataset(tuple(records)))


@pytest.fixture(scope="module")
def drawn(cells: hf.FitResult, tmp_path_factory: pytest.TempPathFactory) -> tuple[hf.Posterior, object]:
    folder = tmp_path_factory.mktemp("run")
    return hf.sample(cells, draws=100, extend=1, folder=folder), folder


def test_smooth_weights_are_sampled_by_default_and_resume(cells: hf.FitResult, drawn: tuple) -> None:
    posterior, folder = drawn
    assert posterior.sampler == "weights"
    assert posterior.names[: len(cells.free_names)] == cells.free_names
    assert (posterior.draws[:, :, : len(cells.free_names)][:, :, cells.problem.space.lower == 0] >= 0).all()
    for file in list(folder.glob("weights-1-0000[3-9].npz")):
        file.unlink()
    np.testing.assert_array_equal(hf.sample(cells, draws=100, extend=1, folder=folder).draws, posterior.draws)
    assert "w[21]" in "\n".join(posterior.summary().lines())


def test_weights_are_one_array_of_the_file(drawn: tuple, tmp_path: Path) -> None:
    import xarray

    posterior = drawn[0]
    posterior.save(tmp_path / "p")
    with xarray.open_dataset(tmp_path / "p" / "posterior.nc", group="posterior", engine="h5netcdf") as table:
        assert not [name for name in table if "[" in name]
        assert {"w", "offset@loop 0", "offset@loop 1", "noise_white"} <= set(table)
        assert table["w"].shape == (*posterior.draws.shape[:2], 21)
        assert table["w"].attrs["units"] == posterior.units[posterior.names.index("w[0]")]
        np.testing.assert_array_equal(table["w"].sel(w_entry="13"), posterior["w[13]"])
        np.testing.assert_array_equal(table["offset@loop 1"], posterior["offset@loop 1"])
    np.testing.assert_array_equal(hf.load_posterior(tmp_path / "p").draws, posterior.draws)
    with warnings.catch_warnings():  # ArviZ announces its next version
        warnings.simplefilter("ignore")
        np.testing.assert_array_equal(posterior.to_arviz()["posterior"]["w"][..., 13], posterior["w[13]"])


def test_predictions_are_those_of_each_draws_model(cells: hf.FitResult, drawn: tuple) -> None:
    posterior = drawn[0]
    record = cells.data[1]
    # Each draw's model simulated by itself, with the offset of its record.
    rows = posterior.thinned(3, 1)
    expected = [cells.problem.space.assembled(row, 1).free_run(record.u, record.dt) for row in rows]
    np.testing.assert_allclose(posterior.predict(record, 3, 1), expected, atol=1e-12)
    new = hf.Record(u=turning(9, 5), y=np.zeros(turning(9, 5).size), name="another")
    offsets = [k for k, name in enumerate(cells.free_names) if name.startswith("offset")]
    plain = cells.problem.space.assembled(rows[0], 0).free_run(new.u)
    shifts = posterior.predict(new, 3, 1)[0] - plain
    assert np.ptp(shifts) < 1e-12
    assert np.min(np.abs(shifts[0] - (rows[0][offsets] - rows[0][offsets[0]]))) < 1e-12
    low, _, high = posterior.bands(record)
    assert 0.8 < np.mean((record.y >= low) & (record.y <= high)) < 0.98


def test_a_band_beyond_the_fitted_records_has_the_error_on_held_out_groups(drawn: tuple) -> None:
    """That error far above noise and weights: Student's t of as many degrees of freedom as groups. Below them: nothing changes."""
    posterior = drawn[0]
    with_error = lambda size: dataclasses.replace(
        posterior, result=dataclasses.replace(posterior.result, left_out=size)
    )
    fitted, u = posterior.result.data[0], turning(9, 5)
    new = hf.Record(u=u, y=0 * u, name="another")
    plain = with_error(None).bands(new, count=400)
    np.testing.assert_array_equal(with_error(1e-4).bands(new, count=400), plain)
    np.testing.assert_array_equal(with_error(2.0).bands(fitted), with_error(None).bands(fitted))
    low, _, high = with_error(2.0).bands(new, count=400)
    groups = posterior.result.problem.held_out.count
    assert np.mean(high - low) / 2 == pytest.approx(2.0 * student.ppf(0.95, groups), rel=0.1)


def test_every_weight_that_acts_has_an_error_by_its_posterior(cells: hf.FitResult, drawn: tuple, monkeypatch) -> None:
    from hystfit.uncertainty import robust_errors

    monkeypatch.setattr(robust_errors, "sample", lambda result, sampler, seed, progress: drawn[0])
    found = robust_errors.standard_errors(cells)
    acts = np.linalg.norm(cells.problem.linearize(cells.x)[1], axis=(0, 1)) > 0
    np.testing.assert_array_equal(np.isfinite(found.errors["posterior"]), acts)
    assert found.to_dict()["parameters"]["w[0]"]["stderr"]["posterior"] > 0


def test_what_the_sampler_cannot_do_is_named(plays: hf.FitResult, cells: hf.FitResult) -> None:
    assert suited_sampler(plays, "iid") == suited_sampler(plays, "iid", {"w[0,0]": priors.HalfNormal(2.0)}) == "weights"
    assert (
        suited_sampler(plays, "student-t")
        == suited_sampler(plays, "iid", {"w[0,0]": priors.LogNormal(0.5, 0.3)})
        == "independence"
    )
    with pytest.raises(ParameterError, match="iid and ou"):
        hf.sample(plays, "weights", noise="student-t")
    with pytest.raises(ParameterError, match="normal priors"):
        hf.sample(plays, "weights", priors={"w[0,0]": priors.LogNormal(0.5, 0.3)})
    u = turning(1, 12)
    y = np.asarray(hf.simulate(hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5), u)[0])
    problem = Problem(hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5), hf.Record(u=u, y=y))
    with pytest.raises(ParameterError, match="needs weights"):
        hf.sample(hf.fit(problem.model, problem.data, fix={"mu": 0.5}, free=["tau", "rho"]), "weights")


@pytest.fixture(scope="module")
def lagging() -> hf.FitResult:
    """Two plays behind a lag, with much noise."""
    u, noise = turning(21, 8), 0.12
    model = hf.Series(hf.Lag(tau=2.0), PrandtlIshlinskii(w=[[1.0, 0.8]], r=[0.0, 0.4], low=-1.0, high=1.0))
    y = np.asarray(hf.simulate(model, u, np.ones(u.size))[0]) + noise * np.random.default_rng(22).normal(size=u.size)
    return hf.fit(model, hf.Record(u=u, y=y, t=np.arange(float(u.size))))


@pytest.mark.slow
def test_a_time_constant_is_sampled_with_the_weights_behind_it(lagging: hf.FitResult) -> None:
    # Given the time constant, the weights are a truncated normal whose normal has a closed form: the posterior by sums over a grid.
    fit = lagging
    prior = priors.LogNormal(2.0, 0.5)
    vague = {
        name: priors.HalfNormal(30) if name.startswith("w") else priors.Normal(0, 30) for name in fit.free_names[1:]
    }
    posterior = hf.sample(fit, "weights", noise="iid", priors={"tau": prior} | vague, draws=1000, seed=1)
    assert fit.free_names[0] == "tau"
    y, taus, rng = fit.data[0].y, np.linspace(0.3, 3.8, 100), np.random.default_rng(0)
    normals, squares = rng.normal(size=(3, 20_000)), rng.chisquare(y.size - 3, 20_000)

    def log_marginal(tau: float) -> float:
        X = np.column_stack([fit.problem.predict(np.array([tau, *unit]))[0] for unit in np.eye(3)])
        best, free = np.linalg.lstsq(X, y, rcond=None)[0], y.size - X.shape[1]
        rss = np.sum((y - X @ best) ** 2)
        spread = np.linalg.slogdet(X.T @ X)[1] + free * np.log(rss)
        away = np.linalg.solve(np.linalg.cholesky(X.T @ X).T, normals) * np.sqrt(rss / squares)
        inside = np.mean(np.all(best[:2, None] + away[:2] >= 0, axis=0))  # both weights
        return norm.logpdf(np.log(tau / 2.0), scale=0.5) - np.log(tau) - 0.5 * spread + np.log(inside)

    logs = np.array([log_marginal(tau) for tau in taus])
    p = np.exp(logs - np.max(logs))
    p /= p.sum()
    assert max(p[0], p[-1]) < 1e-3
    mean = p @ taus
    sd = np.sqrt(p @ (taus - mean) ** 2)
    assert sd / mean > 0.05  # the output is far from linear in the time constant over its posterior
    assert np.mean(posterior.stats["acceptance"]) < 0.95
    found = posterior["tau"].reshape(-1)
    assert found.mean() == pytest.approx(mean, abs=0.1 * sd)
    assert found.std() == pytest.approx(sd, rel=0.1)
    np.testing.assert_allclose(
        np.quantile(found, [0.05, 0.95]), np.interp([0.05, 0.95], np.cumsum(p), taus), atol=0.2 * sd
    )


@pytest.mark.slow
def test_a_lag_before_many_cells_converges() -> None:
    """Weights at their bound have means inside it: derivatives about the estimate are not those that the draws need."""
    rng, t = np.random.default_rng(0), 0.01 * np.arange(960.0)
    u = np.linspace(1, 0.15, t.size) * np.cos(2 * np.pi * np.cumsum(np.where(t < 4.8, 1.0, 2.0)) / 120)
    relays = Preisach.of(40, spacing="uniform", reversible=False).start([hf.Record(u=u, y=u, t=t)])
    center = 0.5 * (relays.levels[1:] + relays.levels[:-1])
    i, j = np.tril_indices(center.size)
    half, middle = 0.5 * (center[i] - center[j]), 0.5 * (center[i] + center[j])
    w = np.exp(-0.5 * (np.log(np.maximum(half, 1e-3) / 0.2) / 0.6) ** 2 - 0.5 * (middle / 0.2) ** 2)[: relays.w.size]
    truth = hf.Series(hf.Lag(tau=0.05), eqx.tree_at(lambda m: m.w, relays, jnp.asarray(w / w.sum())))
    y = np.asarray(hf.simulate(truth, u, np.full(u.size, 0.01))[0])
    y = y + 0.01 * np.ptp(y) * rng.normal(size=u.size)
    posterior = hf.sample(hf.fit("lag+preisach:n=10", hf.Record(u=u, y=y, t=t)), seed=1)
    assert posterior.sampler == "weights"
    assert posterior.status is not Status.NOT_CONVERGED  # 10 effective draws about the estimate
    assert abs(np.median(posterior["tau"]) - 0.05) < 4 * np.std(posterior["tau"])


@pytest.mark.parametrize("noise", ["iid", pytest.param("ou", marks=pytest.mark.slow)])
def test_the_exact_density_is_that_of_the_equations_where_only_weights_differ(
    lagging: hf.FitResult, noise: str
) -> None:
    fit = lagging
    equations = Weights().prepare(fit, noise, None).equations
    rng, k, m = np.random.default_rng(0), fit.free_names.index("tau"), equations.squares.size
    found = []
    for number in rng.integers(m, size=8):
        w = np.asarray(equations.estimate) * rng.uniform(0.5, 1.5, equations.estimate.size)
        w[k], variance = equations.estimate[k], rng.uniform(0.5, 2.0) * equations.squares[number] / equations.count
        found.append(
            equations.excess(w, number, variance, equations.fit(equations.square(w, number), number, variance))
        )
    np.testing.assert_allclose(found, found[0], atol=1e-6)
    w[k] += 0.5
    fit_there = equations.fit(equations.square(w, number), number, variance)
    assert abs(equations.excess(w, number, variance, fit_there) - found[0]) > 0.1


def test_noises_have_the_shares_that_residuals_tell() -> None:
    from hystfit.inference.noise.slow_likelihood import Contrasts, fit_slow_noise

    rng, n = np.random.default_rng(0), 400
    lags = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    residual = np.linalg.cholesky(np.exp(-lags / 15)) @ rng.normal(size=n) + 0.5 * rng.normal(size=n)
    u = np.sin(0.05 * np.arange(n))
    samples, nothing = Samples.of(Problem(hf.BoucWen(), hf.Record(u=u, y=u)).host_setting), np.zeros((n, 0))
    contrasts = Contrasts(samples, residual, nothing, nothing)
    grid = NoiseGrid.about(fit_slow_noise(contrasts), contrasts, priors.LogNormal(10.0, 0.5))
    expected = norm.logpdf(np.log(grid.times), np.log(10.0), 0.5)  # the grid is even in the logarithm
    for k, (ratio, time) in enumerate(zip(grid.ratios, grid.times, strict=True)):
        covariance = np.exp(-lags / time) + ratio * np.eye(n)
        square = residual @ np.linalg.solve(
            covariance, residual
        )  # the variance has a density proportional to its inverse
        expected[k] -= 0.5 * (np.linalg.slogdet(covariance)[1] + n * np.log(square))
    np.testing.assert_allclose(grid.log_shares, expected - expected.max(), atol=1e-6)
    share = np.exp(grid.log_shares)
    assert share.reshape(5, 5)[[0, 0, -1, -1], [0, -1, 0, -1]].max() < 0.1
    assert grid.times.min() < 15 < grid.times.max()
    assert grid.ratios.min() < 0.25 < grid.ratios.max()


def test_draws_of_noises_have_their_shares(cells: hf.FitResult) -> None:
    prepared = Weights(draws=300, extend=1).prepare(cells, "ou", None)
    posterior = hf.sample(cells, "weights", noise="ou", draws=300, extend=1)
    share = np.exp(prepared.grid.log_shares)
    share /= share.sum()
    logs = np.log(prepared.grid.times)
    mean = share @ logs
    sd = np.sqrt(share @ (logs - mean) ** 2)
    found = np.log(posterior["noise_time"]).reshape(-1)
    assert abs(found.mean() - mean) < 4 * sd / np.sqrt(found.size)
    assert found.std() == pytest.approx(sd, rel=0.1)


def test_status_tells_of_chains_that_are_too_short(cells: hf.FitResult) -> None:
    assert hf.sample(cells, draws=100, warmup=1, chains=2, extend=1, noise="iid").status is Status.NOT_CONVERGED
