"""Errors of fits whose parameters reach their bounds."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

import hystfit as hf
from hystfit.fitting.judgment.near_bounds import about_estimate, truncated_moments

T = np.arange(300) / 100
U = (20 + 12 * T) * np.sin(2 * np.pi * T)
START = hf.PrandtlIshlinskii.of(6).start([hf.Record(u=U, y=U)])


def pulls_of(seed: int, scale: float, noise: str, method: str = "lm") -> list[float]:
    """Errors of plays with random weights, over their standard errors; about half of the weights end on zero."""
    rng = np.random.default_rng(seed)
    weights = (rng.exponential(scale, START.w.shape), rng.exponential(2.0, START.rise.shape), rng.normal())
    truth = eqx.tree_at(lambda m: (m.w, m.rise, m.offset), START, tuple(jnp.asarray(value) for value in weights))
    white = rng.normal(size=U.size)
    slow = scipy.signal.lfilter([np.sqrt(1 - 0.95**2)], [1, -0.95], white) + 0.3 * rng.normal(size=U.size)
    y = np.asarray(hf.simulate(truth, jnp.asarray(U))[0]) + 0.3 * (white if noise == "iid" else slow)
    fit = hf.fit(START, hf.Record(u=U, y=y, t=T), start="model", starts=1, method=method, noise=noise)
    true = fit.problem.space.vector(truth)
    return [(p.value - t) / p.stderr for p, t in zip(fit.parameters, true, strict=False) if p.stderr is not None]


@pytest.mark.parametrize(
    ("scale", "noise", "count", "slack"),
    [
        (1.0, "iid", 6, 0.35),
        pytest.param(0.5, "iid", 80, 0.1, marks=pytest.mark.slow),
        pytest.param(1.0, "iid", 80, 0.1, marks=pytest.mark.slow),
        pytest.param(2.0, "iid", 80, 0.1, marks=pytest.mark.slow),
        pytest.param(1.0, "auto", 80, 0.1, marks=pytest.mark.slow),
    ],
)
def test_errors_beside_weights_on_zero_are_calibrated(scale: float, noise: str, count: int, slack: float) -> None:
    pulls = np.concatenate([pulls_of(seed, scale, noise) for seed in range(count)])
    assert np.sqrt(np.mean(pulls**2)) == pytest.approx(1.0, abs=slack)
    assert np.abs(pulls).max() < 4.0  # errors that held the weights on zero gave 9


def test_a_ridge_counts_as_knowledge_only_as_far_as_the_weights_bear_it_out() -> None:
    pulls = np.concatenate([pulls_of(seed, 1.0, "iid", "convex") for seed in range(12)])
    assert pulls.size > 30
    assert np.sqrt(np.mean(pulls**2)) == pytest.approx(1.0, abs=0.2)  # 1.47 where the whole ridge was prior information


def test_moments_are_those_of_a_plain_sample() -> None:
    rng = np.random.default_rng(0)
    for count in (1, 2, 3):
        A = rng.normal(size=(count + 2, count))
        P, s, low = A.T @ A, rng.normal(size=count), -np.abs(rng.normal(size=count))
        sample = rng.multivariate_normal(-np.linalg.solve(P, s), np.linalg.inv(P), size=400_000)
        sample = sample[(sample >= low).all(axis=1)]
        ((mean, other), (covariance, _)) = truncated_moments(*(np.stack([v, 2 * v]) for v in (P, s, low)))
        alone = truncated_moments(2 * P[None], 2 * s[None], 2 * low[None])[0][0]
        np.testing.assert_allclose(other, alone, rtol=1e-12)  # each of several ends by itself
        np.testing.assert_allclose(mean, sample.mean(axis=0), atol=0.01)
        np.testing.assert_allclose(np.sqrt(np.diag(covariance)), sample.std(axis=0), rtol=0.02)


def test_a_steep_slope_leaves_an_exponential_density() -> None:
    mean, covariance = truncated_moments(np.array([[[1e-12]]]), np.array([[50.0]]), np.zeros((1, 1)))
    assert (mean[0, 0], covariance[0, 0, 0]) == pytest.approx((1 / 50, 1 / 2500), rel=1e-3)
    # So does a slope beyond all measure, where the residuals are rounding errors.
    mean, covariance = truncated_moments(np.array([[[1.0]]]), np.array([[1e90]]), np.zeros((1, 1)))
    assert np.isfinite([mean[0, 0], covariance[0, 0, 0]]).all()
    assert abs(mean[0, 0]) < 1e-80


def test_without_a_bound_the_moments_are_the_covariance() -> None:
    A = np.random.default_rng(1).normal(size=(5, 3))
    P = A.T @ A
    mean, far = about_estimate(P[None], np.zeros((1, 3)), np.array([[np.inf, 1e3, np.inf]]), np.ones(3))
    np.testing.assert_allclose(far[0], np.linalg.inv(P), rtol=1e-6)
    np.testing.assert_allclose(mean, 0, atol=1e-5)


@pytest.mark.parametrize(("side", "slope"), [(1.0, 0.7), (-1.0, 0.0)])
def test_beside_one_bound_the_moments_are_integrals_of_the_density(side: float, slope: float) -> None:
    """One parameter at 0.4 from its bound, and two others that follow it; `slope` pushes it against the bound."""
    A = np.random.default_rng(2).normal(size=(6, 3))
    P, s, room = A.T @ A, np.array([side * slope, 0.2, -0.3]), 0.4
    mean, moments = about_estimate(P[None], s[None], np.array([[room, np.inf, np.inf]]), np.array([side, 1.0, 1.0]))
    d = side * np.linspace(-room, 12.0, 200_001)
    inner = np.linalg.inv(P[1:, 1:])
    others = -(d[:, None] * P[0, 1:] + s[1:]) @ inner  # mean of the others, given the first
    exponent = -0.5 * P[0, 0] * d**2 - s[0] * d + 0.5 * np.einsum("np,pq,nq->n", others, P[1:, 1:], others)
    share = np.exp(exponent - exponent.max())
    share /= share.sum()
    every = np.column_stack([d, others])
    expected = every.T @ (share[:, None] * every)
    expected[1:, 1:] += inner
    np.testing.assert_allclose(mean[0], share @ every, rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(moments[0], expected, rtol=1e-3, atol=1e-4)


def test_the_error_of_a_quantity_is_the_spread_of_repeated_fits_where_weights_replace_each_other() -> None:
    """Of 20 plays about half end on zero, in the place of others; the stroke hardly depends on which."""
    plays = hf.PrandtlIshlinskii.of(20).start([hf.Record(u=U, y=U)])
    rng = np.random.default_rng(0)
    truth = eqx.tree_at(lambda m: m.w, plays, jnp.asarray(rng.exponential(1.0, plays.w.shape)))
    clean = np.asarray(hf.simulate(truth, jnp.asarray(U))[0])
    strokes, errors = [], []
    for _ in range(24):
        record = hf.Record(u=U, y=clean + 0.3 * rng.normal(size=U.size), t=T)
        fit = hf.fit(plays, record, start="model", method="convex", noise="iid")
        stroke = next(one for one in fit.quantities if one.name == "stroke")
        strokes.append(stroke.value)
        errors.append(stroke.stderr)
    assert np.median(errors) == pytest.approx(np.std(strokes), rel=0.5)
