"""Priors as densities; correlated ones against a multivariate normal distribution in transformed parameters."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import hystfit as hf
from hystfit.errors import ParameterError
from hystfit.inference.correlated_priors import CorrelatedPriors, Dependence
from hystfit.inference.noise.white import White
from hystfit.inference.priors import AbstractPrior, HalfNormal, LogitNormal, LogNormal, Normal, Uniform
from hystfit.inference.problem import Problem

EACH = {"c": LogNormal(1.2, 0.3), "rho": LogitNormal(-1.0, 1.0, 0.2, 0.5), "offset": Normal(0.1, 0.4)}
CORRELATION = np.array([[1.0, 0.7, -0.2], [0.7, 1.0, 0.1], [-0.2, 0.1, 1.0]])


@pytest.fixture(scope="module")
def problem() -> Problem:
    u = np.sin(np.linspace(0, 12, 60))
    return Problem(hf.BoucWen(), hf.Record(u=u, y=u + 0.1 * np.cos(np.linspace(0, 12, 60))))


@pytest.mark.parametrize(
    "prior",
    [
        Normal(0.1, 0.4),
        LogNormal(1.2, 0.3),
        LogNormal(0.5, 0.6, edge=2.0, side=-1.0),
        HalfNormal(0.7),
        HalfNormal(0.7, edge=-1.0, side=-1.0),
        Uniform(-1.0, 3.0),
        LogitNormal(-1.0, 1.0, 0.2, 0.5),
    ],
    ids=str,
)
def test_a_prior_is_the_density_of_its_draws(prior: AbstractPrior) -> None:
    x = np.linspace(-9.0, 9.0, 36_001)[1::2]  # middles of intervals between multiples of 0.001, where densities may end
    density = np.exp(np.asarray(jax.vmap(prior.log_density)(jnp.asarray(x))))
    assert density.sum() * (x[1] - x[0]) == pytest.approx(1.0, abs=1e-6)
    draws = np.asarray(prior.sample(jax.random.key(0), (4000,)))
    below = np.interp(draws, x + 0.5 * (x[1] - x[0]), np.cumsum(density) * (x[1] - x[0]))
    assert scipy.stats.kstest(below, "uniform").pvalue > 0.01


def test_the_log_prior_is_a_multivariate_normal_of_the_transformed_parameters(problem: Problem) -> None:
    x = problem.space.vector(problem.model)
    independent = problem.with_noise(White(), EACH, np.append(x, 0.1))
    correlated = problem.with_noise(White(), CorrelatedPriors(EACH, CORRELATION), np.append(x, 0.1))
    rng = np.random.default_rng(0)
    for _ in range(3):
        z = 0.3 * rng.normal(size=len(problem.space) + 1)
        at = dict(zip(correlated.names, np.asarray(correlated.density.physical(jnp.asarray(z))), strict=True))
        # Logarithm, logit and the number itself are jointly normal; their slopes are the same with and without correlation.
        rho = 0.5 * (at["rho"] + 1)
        t = np.array([np.log(at["c"]), np.log(rho / (1 - rho)), at["offset"]])
        mean, sd = np.array([np.log(1.2), np.log(0.6 / 0.4), 0.1]), np.array([0.3, 0.5, 0.4])
        joint = scipy.stats.multivariate_normal(mean, CORRELATION * sd * sd[:, None]).logpdf(t)
        apart = scipy.stats.norm(mean, sd).logpdf(t).sum()
        assert correlated.log_prior(z) - independent.log_prior(z) == pytest.approx(joint - apart, rel=1e-9)


def test_replacing_and_choosing_priors_keeps_the_other_correlations() -> None:
    priors = CorrelatedPriors(EACH, CORRELATION)
    replaced = priors | {"rho": Uniform(-1.0, 1.0)}
    assert isinstance(replaced, CorrelatedPriors)
    assert replaced.names == ("c", "offset")
    assert replaced.correlation[0, 1] == -0.2
    assert isinstance(replaced["rho"], Uniform)
    assert (priors | {"rho": Uniform(-1.0, 1.0), "c": Normal(1.0, 0.1)}).keys() == EACH.keys()
    defaults = {"c": Normal(0.0, 1.0), "noise_white": LogNormal(0.1, 1.0)} | priors
    assert defaults["c"] is EACH["c"]
    assert set(defaults) == {*EACH, "noise_white"}
    assert not isinstance(priors.of(["c"]), CorrelatedPriors)
    moved = Dependence.of(priors, ("tau", "offset", "c", "rho"))
    assert moved is not None
    assert moved.at == (2, 3, 1)


@pytest.mark.parametrize(
    ("each", "matrix", "words"),
    [
        (EACH, np.eye(2), "shape"),
        (EACH, np.array([[1, 0.9, -0.9], [0.9, 1, 0.9], [-0.9, 0.9, 1]]), "positive definite"),
        ({"c": HalfNormal(1.0), "tau": Normal(1.0, 1.0)}, np.eye(2), "that of c is not"),
    ],
)
def test_bad_correlations_are_refused(each: dict, matrix: np.ndarray, words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        CorrelatedPriors(each, matrix)


def test_a_correlated_prior_of_a_parameter_that_is_not_free_is_refused(problem: Problem) -> None:
    priors = CorrelatedPriors({"c": LogNormal(1.0, 0.1), "gamma": Normal(0.0, 1.0)}, np.eye(2))
    with pytest.raises(ParameterError, match="gamma"):
        problem.with_noise(White(), priors)


def test_scores_of_draws_are_standard_normal() -> None:
    for prior in EACH.values():
        scores = jax.vmap(prior.score)(prior.sample(jax.random.key(0), (4000,)))
        assert scipy.stats.kstest(np.asarray(scores), "norm").pvalue > 0.01
