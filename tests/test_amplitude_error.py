"""Error of weights over loops of amplitudes that were not fitted: its process, its estimate, bands with it."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import hystfit as hf
from hystfit.inference.weights import smoothness_penalty
from hystfit.models import Preisach
from hystfit.sampling import amplitude_error
from hystfit.sampling.amplitude_error import AmplitudeError, Strokes, _gap, posterior_mean
from hystfit.sampling.weight_equations import weight_priors

CYCLE = np.linspace(0, 2 * np.pi, 129)


def device(coercivity: float, width: float) -> Preisach:
    """A smooth density on a grid much finer than that of a fit."""
    n = 60
    span = hf.Record(u=np.cos(CYCLE), y=np.cos(CYCLE))
    model = Preisach.of(n, spacing="uniform", symmetric=False).start([span])
    centers = 0.5 * (model.levels[1:] + model.levels[:-1])
    i, j = np.tril_indices(n)
    half, middle = 0.5 * (centers[i] - centers[j]), 0.5 * (centers[i] + centers[j])
    w = np.exp(-0.5 * (np.log(np.maximum(half, 1e-3) / coercivity) / width) ** 2 - 0.5 * (middle / 0.15) ** 2)
    return eqx.tree_at(lambda m: m.w, model, jnp.asarray(w / w.sum()))


def loop(model: Preisach, amplitude: float, seed: int) -> hf.Record:
    """The second of two cycles, with noise of 0.1 % of the largest output."""
    u = amplitude * np.cos(np.concatenate([CYCLE[:-1], CYCLE]))
    y = np.asarray(model.free_run(u)) + 0.002 * np.random.default_rng(seed).normal(size=u.size)
    return hf.Record(u=u[128:], y=y[128:], name=f"loop {amplitude:g}")


@pytest.fixture(scope="module")
def sampled() -> tuple[hf.Posterior, hf.Record]:
    """Weights of the outer two of three loops, and the one between them."""
    model = device(0.3, 0.5)
    loops = [loop(model, amplitude, seed) for seed, amplitude in enumerate((0.15, 0.4, 1.0))]
    fit = hf.fit("preisach:n=16:spacing=steep", [loops[0], loops[2]])
    return hf.sample(fit, "weights", chains=2, draws=150, extend=1), loops[1]


def test_variance_is_that_of_fractional_brownian_motion_given_its_zeros(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the moving average of white noise that defines it (Mandelbrot and Van Ness 1968), and the bridge of a Wiener process."""
    fitted, power = np.array([-1.3, 0.2, 0.9, 2.0]), amplitude_error._SMOOTH - 0.5
    edges = np.concatenate([-np.geomspace(1e6, 5, 4000), np.linspace(-5, 3, 16_000)[1:]])
    middle = 0.5 * (edges[1:] + edges[:-1])
    average = lambda t: (np.maximum(t - middle, 0) ** power - np.maximum(-middle, 0) ** power) * np.sqrt(np.diff(edges))
    unit = average(1.0)
    for level in (-2.5, -0.7, 0.5, 1.2, 2.6):
        rows = np.array([average(t) - average(fitted[0]) for t in (*fitted[1:], level)])
        whole = rows @ rows.T / (unit @ unit)
        wanted = whole[3, 3] - whole[3, :3] @ np.linalg.solve(whole[:3, :3], whole[:3, 3])
        assert _gap(level, fitted) == pytest.approx(wanted, rel=0.01)
    assert _gap(0.21, fitted) == 0.0  # the same amplitude
    monkeypatch.setattr(amplitude_error, "_SMOOTH", 0.5)
    assert _gap(0.5, fitted) == pytest.approx(0.3 * 0.4 / 0.7)
    assert _gap(-2.0, fitted) == pytest.approx(0.7)


def test_strokes_cut_off_by_the_ends_have_the_swing_of_their_neighbor() -> None:
    u = np.concatenate([np.linspace(0, 1, 20), np.linspace(1, -1, 40), np.linspace(-1, 0.5, 30)[1:]])
    strokes = Strokes.of(u)
    np.testing.assert_allclose(strokes.swings, [2.0, 2.0, 2.0])
    assert [np.sum(strokes.number == k) for k in range(3)] == np.diff(strokes.edges).tolist()
    np.testing.assert_allclose(strokes.swing_of(3 * u, np.full(u.size, True)), 6.0)


@pytest.fixture(scope="module")
def of_one_loop() -> hf.Posterior:
    fit = hf.fit("preisach-signed:n=6:spacing=uniform", loop(device(0.3, 0.5), 1.0, 3))
    return hf.sample(fit, "weights", chains=1, draws=60, extend=1, noise="ou")


def test_mean_of_unbounded_weights_is_the_solution_with_the_dense_covariance(of_one_loop: hf.Posterior) -> None:
    posterior, fit = of_one_loop, of_one_loop.result
    problem = fit.problem.with_loss("linear")
    residual, jacobian = (rows[problem.used] for rows in problem.linearize(fit.x))
    at = np.arange(residual.size)
    white, slow, time = (np.median(posterior[name]) for name in ("noise_white", "noise_slow", "noise_time"))
    covariance = slow**2 * np.exp(-np.abs(np.subtract.outer(at, at)) / time) + white**2 * np.eye(at.size)
    strength = np.median(posterior.stats["smoothness"]) * at.size / float(problem.scales.y) ** 2
    precision = strength * smoothness_penalty(problem.space, list(problem.data), fit.x)
    pull = np.zeros(fit.x.size)
    for name, prior in weight_priors(problem, fit.x, None).items():
        k = fit.free_names.index(name)
        precision[k, k] += float(prior.sd) ** -2
        pull[k] += float(getattr(prior, "mean", 0.0)) / float(prior.sd) ** 2
    solved = np.linalg.solve(covariance, np.column_stack([jacobian, jacobian @ fit.x - residual]))
    wanted = np.linalg.solve(jacobian.T @ solved[:, :-1] + precision, jacobian.T @ solved[:, -1] + pull)
    bounded = fit.problem.space.lower == 0
    if bounded.any():  # few, and far from zero
        assert (wanted[bounded] > 0).all()
    found = posterior_mean(posterior, problem)
    sd = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ solved[:, :-1] + precision)))
    assert np.abs(found - wanted).max() < 0.35 * sd.max()  # 270 moves
    np.testing.assert_allclose(jacobian @ found, jacobian @ wanted, atol=0.35 * np.sqrt(np.mean((jacobian @ sd) ** 2)))


@pytest.mark.slow
def test_a_band_between_fitted_amplitudes_covers_a_device_that_is_not_in_the_model(sampled: tuple) -> None:
    posterior, between = sampled
    low, middle, high = posterior.bands(between, count=400)
    inside = np.mean((between.y >= low) & (between.y <= high))
    assert inside > 0.8
    # Noise and draws alone, and with the error on scattered samples of the fitted loops, which says nothing of other amplitudes.
    scattered = dataclasses.replace(posterior)
    scattered.__dict__["beyond"] = None
    low, _, high = scattered.bands(between, count=400)
    assert np.mean((between.y >= low) & (between.y <= high)) < 0.7
    rms = float(np.sqrt(np.mean((between.y - middle) ** 2)))
    assert 0.5 * rms < posterior.beyond.sd(between.u, middle).mean() < 4 * rms


def test_the_error_is_zero_at_fitted_amplitudes_and_grows_with_the_output(sampled: tuple) -> None:
    posterior, between = sampled
    beyond = posterior.beyond
    np.testing.assert_allclose(np.exp(beyond.levels), [0.3, 2.0])
    assert (beyond.sd(between.u / 0.4, between.y) == 0).all()
    np.testing.assert_allclose(beyond.sd(between.u, 3 * between.y), 3 * beyond.sd(between.u, between.y))
    assert beyond.freedom == 1  # one amplitude was left out, whatever the samples of its loop
    assert (beyond.sd(np.ones(20), np.ones(20)) == 0).all()  # an input that does not move


def test_one_amplitude_gives_no_error_at_others(of_one_loop: hf.Posterior) -> None:
    assert AmplitudeError.of(of_one_loop) is None
    assert AmplitudeError.of(dataclasses.replace(of_one_loop, sampler="nuts")) is None
