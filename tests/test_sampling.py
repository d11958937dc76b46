"""Samplers against grids, closed forms and each other; diagnostics against ArviZ; runs killed and resumed; bad input."""

import dataclasses
import itertools
import json
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import scipy.signal
import scipy.special
import scipy.stats

import hystfit as hf
import hystfit.models
from hystfit import priors
from hystfit.errors import DataError, MissingExtraError, ModelError, ParameterError, optional
from hystfit.inference.noise import OrnsteinUhlenbeck, White
from hystfit.inference.problem import Problem
from hystfit.models import LogCreep, Series, Sum
from hystfit.outcome import Code, Status
from hystfit.outcome.note import has
from hystfit.sampling import independence, proposals
from hystfit.sampling.base import AbstractSampler, Raw
from hystfit.sampling.bend import Bend, Shear, straight
from hystfit.sampling.diagnostics import Convergence, bulk_ess, effective_size, rhat, tail_ess
from hystfit.sampling.ensemble import Ensemble, longest_time
from hystfit.sampling.files import load_posterior
from hystfit.sampling.nuts import Nuts, adapted
from hystfit.sampling.posterior import Posterior
from hystfit.sampling.predictive import simulate_draws
from hystfit.sampling.sample import drift_notes, prior_dominated_notes, sample
from hystfit.sampling.setup import Prepared, checked, prepare
from hystfit.sampling.slope_coordinates import SlopeCoordinates
from hystfit.sampling.target import Target


def loop(T: int = 500, seed: int = 0, sigma: float = 0.01) -> tuple[hf.Record, hf.BoucWen]:
    rng = np.random.default_rng(seed)
    phase = np.arange(T) / T
    u = np.sin(2 * np.pi * 8 * phase) * (0.4 + 0.6 * phase)
    model = hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)
    return hf.Record(u=u, y=np.asarray(hf.simulate(model, u)[0]) + sigma * rng.normal(size=T)), model


@pytest.fixture(scope="module")
def fitted() -> hf.FitResult:
    record, model = loop()
    return hf.fit(model, record, starts=1, fix={"rho": 0.5})


@pytest.fixture(scope="module")
def posterior(fitted):
    return sample(fitted, "nuts", noise="iid", chains=2, draws=900, warmup=200, seed=3)


def test_density_is_likelihood_prior_and_jacobian(fitted):
    setup = prepare(fitted, noise="iid", priors={"tau": priors.LogNormal(2.0, 0.3)})  # of the kind of the default
    target, record = setup.target, fitted.data[0]
    density = eqx.filter_jit(lambda z: target.density.log_density(z))
    map_out = eqx.filter_jit(lambda z: target.density.physical(z))
    physical = lambda z: np.asarray(map_out(jnp.asarray(z)))
    for shift in (0.0, 0.3):
        z = target.unwhitened(jnp.zeros(target.center.size).at[0].set(shift))
        x = dict(zip(setup.names, physical(z), strict=True))
        model = hf.BoucWen(c=x["c"], mu=x["mu"], tau=x["tau"], rho=0.5, offset=x["offset"])
        want = scipy.stats.norm.logpdf(record.y, np.asarray(hf.simulate(model, record.u)[0]), x["noise_white"]).sum()
        want += scipy.stats.lognorm.logpdf(x["tau"], 0.3, scale=2.0)
        scale = 0.01 * setup.problem.scales.y
        want += scipy.stats.lognorm.logpdf(x["noise_white"], 3.0, scale=scale)
        c_scale = setup.problem.scales.size("y/u")
        want += scipy.stats.lognorm.logpdf(x["c"], 3.0, scale=c_scale)
        want += scipy.stats.norm.logpdf(x["offset"], 0.0, 10 * setup.problem.scales.y)  # mu is uniform: 0
        steps = 1e-6 * np.eye(z.size)
        slopes = [(physical(z + e) - physical(z - e))[k] / 2e-6 for k, e in enumerate(steps)]
        want += np.sum(np.log(np.abs(slopes)))
        assert float(density(z)) == pytest.approx(want, rel=1e-6)


@pytest.mark.slow
def test_noise_slower_than_the_record_is_left_to_the_offset(fitted):
    setup = prepare(fitted, noise="ou")
    prior = setup.problem.priors[setup.names.index("noise_time")]
    draws = np.asarray(prior.sample(jax.random.key(0), (20_000,)))
    assert np.quantile(draws, 0.977) == pytest.approx(500 / 3, rel=0.1)
    own = priors.LogNormal(40.0, 0.2)
    setup = prepare(fitted, noise="ou", priors={"noise_time": own})
    assert "40" in str(setup.problem.priors[setup.names.index("noise_time")])


def each(function):
    """A function of one row for all rows, in one program."""
    return jax.jit(jax.vmap(function))


def test_coordinates_for_sampling_are_linear_inside_two_bounds_and_logistic_in_the_tails():
    bend = Bend(jnp.asarray([True, False]), jnp.zeros(2))
    v = np.linspace(-4.5, 4.5, 181)
    rows = np.stack([v, v], 1)
    z = np.asarray(each(bend.unbent)(rows))
    np.testing.assert_array_equal(z[:, 1], v)
    np.testing.assert_allclose(each(bend.bent)(z), rows, atol=1e-9)
    part = scipy.special.expit(z[:, 0])  # of the interval
    inside = np.abs(v) < 1.0
    np.testing.assert_allclose(part[inside], v[inside] / 4 + 0.5, atol=1e-3)
    tail = v < -3.5
    np.testing.assert_allclose(
        np.diff(z[tail, 0]) / np.diff(v[tail]), 5.0, rtol=0.01
    )  # exponential in v, as far as z goes
    slopes = each(bend.log_slope)(rows)[1:-1]
    np.testing.assert_allclose(np.exp(slopes), (z[2:, 0] - z[:-2, 0]) / (v[2:] - v[:-2]), rtol=0.01)


def test_coordinates_of_weights_are_linear_above_their_bound_and_exponential_next_to_it():
    bend = Bend(jnp.asarray([False]), jnp.asarray([0.3]))
    v = np.linspace(-40.0, 10.0, 501)[:, None]
    z = np.asarray(each(bend.unbent)(v))
    np.testing.assert_allclose(each(bend.bent)(z), v, atol=1e-9)
    weight = np.exp(z[:, 0])  # in its scale
    np.testing.assert_allclose(np.diff(weight[v[:, 0] > 5]), 0.3 * 0.1, rtol=0.01)
    np.testing.assert_allclose(np.diff(np.log(weight[v[:, 0] < -5])), 0.1, rtol=0.01)
    slopes = np.exp(each(bend.log_slope)(v)[1:-1])
    np.testing.assert_allclose(slopes, (z[2:, 0] - z[:-2, 0]) / 0.2, rtol=0.01)


CORRELATED = np.array([[1.0, 0.0, 0.0], [0.4, 0.8, 0.0], [1.8, 0.3, 0.5]]) @ np.diag([1.0, 1.0, 0.7])


def test_shear_keeps_straight_ridges_straight_up_to_a_bound():
    """Coordinates 1 and 2 have two bounds; the center of the latter is nearer to one of them."""
    bend, center = Bend(jnp.asarray([False, True, True]), jnp.zeros(3)), np.array([0.3, 0.1, 0.9])
    shear = Shear.of(bend, center, CORRELATED)
    assert list(shear.order) == [2, 1]
    y = center + np.random.default_rng(0).normal(size=(50, 3)) @ CORRELATED.T
    v = eqx.filter_jit(shear.sheared)(y)
    np.testing.assert_allclose(shear.sheared(y, np), v, atol=1e-12)
    np.testing.assert_allclose(eqx.filter_jit(shear.unsheared)(v), y, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(each(jax.jacfwd(shear.sheared))(y)), 1.0, rtol=1e-12)
    # A line along the regressions on the bounded one: x stays on it, with x that of a linear coordinate.
    cover = CORRELATED @ CORRELATED.T
    slopes = cover[:, 2] / cover[2, 2]
    v = shear.sheared(center + np.linspace(0, 4, 40)[:, None] * slopes, np)
    x = np.column_stack([v[:, 0], straight(v[:, 1], np), straight(v[:, 2], np)])
    assert x[-1, 2] > 1.99
    np.testing.assert_allclose(x[:, :2] - center[:2], (x[:, 2:] - center[2]) * slopes[:2], atol=0.02)


def test_a_center_in_the_bend_itself_shears_nothing():
    bend = Bend(jnp.asarray([False, True, True]), jnp.zeros(3))
    slopes = Shear.of(bend, np.array([0.0, 0.0, 2.5]), CORRELATED).slopes
    assert np.any(slopes[1])
    assert not np.any(slopes[0])


class Ridge(Target):
    """x = straight(v[0]) / 2 is normal about 0.5 with deviation 0.25, cut at its bounds -1 and 1; v[1] is 8 x, to 0.1."""

    def log_density(self, v, lean=False):
        x, slope = jax.jvp(lambda v: straight(v) / 2, (v[0],), (jnp.ones(()),))
        return -0.5 * ((x - 0.5) / 0.25) ** 2 - 0.5 * ((v[1] - 8 * x) / 0.1) ** 2 + jnp.log(slope)

    def slope(self, v):
        return jax.value_and_grad(self.log_density)(v)


@pytest.mark.slow
def test_nuts_follows_a_ridge_into_a_bound(fitted):
    """The tail next to the bound has the probability of the truncated normal, and costs no small steps."""
    bend, start = Bend(jnp.asarray([True, False]), jnp.zeros(2)), jnp.asarray([[0.5, 0.0], [2.0, 0.1]])
    ridge = Ridge(prepare(fitted, noise="iid").target.density, bend, jnp.asarray([1.0, 4.0]), start)
    nuts, drawn, steps = Nuts(warmup=300), [], 0
    for key in jax.random.split(jax.random.key(5), 2):
        warm = nuts.warm(ridge, key)
        q = jnp.asarray(warm["q"])
        for k in range(40):
            chunk = nuts.chunk(ridge, warm, q, jax.random.fold_in(key, k))
            q, steps = jnp.asarray(chunk["q"][-1]), steps + chunk["steps"].sum()
            drawn.append(straight(adapted(ridge, warm).v_of(chunk["q"], np)[:, 0], np) / 2)
            assert not chunk["diverging"].any()
    x = np.concatenate(drawn).reshape(2, -1)
    truth = scipy.stats.truncnorm(-1.5 / 0.25, 0.5 / 0.25, 0.5, 0.25)
    for place in (0.7, 0.9, 0.97):
        inside, share = (x > place).astype(float), truth.sf(place)
        assert abs(inside.mean() - share) < 4 * np.sqrt(share * (1 - share) / effective_size(inside))
    assert effective_size(x) > 0.15 * steps


def test_slope_coordinates_hold_the_slope_between_the_tips_and_have_determinant_one():
    """Of two Bouc-Wen parts, one of which has its c fixed; the slope is that of a simulated steady loop."""
    record = dataclasses.replace(loop()[0], t=0.01 * np.arange(500))
    model = Sum(Series(LogCreep(), hf.BoucWen(c=2.0, mu=0.3, tau=1.5, rho=0.0)), hf.BoucWen())
    problem = Problem(model, [record], fix=["parts.bouc_wen.c"]).with_noise(White())
    density, names = problem.density, problem.space.names
    slopes = SlopeCoordinates.of(density)
    assert slopes is not None
    assert [names[k] for k in (*slopes.c, *slopes.mu)] == ["series.parts.bouc_wen.c", "series.parts.bouc_wen.mu"]
    z = jnp.asarray(np.random.default_rng(0).normal(size=(20, len(names) + 1)))
    w = slopes.of_z(density, z)
    np.testing.assert_allclose(slopes.z_of(density, w), z, atol=1e-12)
    to_z = lambda w: slopes.z_of(density, w)
    np.testing.assert_allclose(jnp.linalg.det(jax.vmap(jax.jacfwd(to_z))(w)), 1.0, rtol=1e-12)
    for tau in (1e-5, 0.01, 0.3, 2.0, 50.0):
        one = hf.BoucWen(c=2.0, mu=0.9, tau=tau, rho=0.0, scheme="exact")
        u = 0.7 * np.sin(np.linspace(0, 2 * np.pi * 40, 40 * 400 + 1))
        y = np.asarray(hf.simulate(one, u)[0])
        tips = (y[-301] - y[-101]) / 1.4
        assert 2.0 * np.exp(float(one.log_secant(jnp.asarray(0.7)))) == pytest.approx(tips, rel=0.02)


@pytest.mark.slow
def test_nuts_goes_along_a_ridge_on_which_only_two_products_are_known():
    """Little saturation shows a = c (1 - mu) and b = mu c tau; over mu c, least squares and priors give the posterior on a grid."""
    phase = np.linspace(0, 4 * np.pi, 200)
    u = np.linspace(0.3, 1, 200) * np.sin(phase)
    truth = hf.BoucWen(c=50.0, mu=0.3, tau=0.01, rho=0.2, scheme="exact")
    y = np.asarray(hf.simulate(truth, u)[0]) + 0.01 * np.random.default_rng(0).normal(size=u.size)
    fit = hf.fit(truth, hf.Record(u=u, y=y), noise="iid", fix=["rho"])
    wide = dict.fromkeys(["c", "tau"], priors.LogNormal(1.0, 3.0))
    made = sample(fit, "nuts", noise="iid", priors=wide, draws=200, warmup=200)
    assert made.status is Status.OK

    def residual(logs, amount):
        a, b = np.exp(logs)
        model = dataclasses.replace(truth, c=a + amount, mu=amount / (a + amount), tau=b / amount)
        r = y - np.asarray(hf.simulate(model, u)[0])
        return (r - r.mean()) / 0.01

    logs, rows = np.log([35.0, 0.15]), []
    for log_amount in np.linspace(8.0, -2.0, 41):
        found = scipy.optimize.least_squares(residual, logs, args=(np.exp(log_amount),), x_scale=[1e-4, 0.1])
        logs, c = found.x, np.exp(found.x[0]) + np.exp(log_amount)
        mu, log_tau = np.exp(log_amount) / c, found.x[1] - log_amount
        prior = -0.5 * (np.log(c) ** 2 + log_tau**2) / 9 + np.log(mu * (1 - mu))
        rows.append((mu, prior - found.cost - 0.5 * np.linalg.slogdet(found.jac.T @ found.jac)[1]))
    mu, log_weight = np.array(rows[::-1]).T
    weight = np.exp(log_weight - log_weight.max())
    below = np.cumsum(weight) - 0.5 * weight
    draws = made.draws[:, :, made.names.index("mu")]
    for share in (0.25, 0.5, 0.75):
        place = np.interp(share, below / weight.sum(), mu)
        inside = (draws < place).astype(float)
        assert abs(inside.mean() - share) < 4 * np.sqrt(share * (1 - share) / effective_size(inside))


def chunks_of(nuts, target, key, count):
    """A chain of this many chunks after a warm-up, each beside what the warm-up left."""
    warm = nuts.warm(target, key)
    q = jnp.asarray(warm["q"])
    for k in range(count):
        chunk = nuts.chunk(target, warm, q, jax.random.fold_in(key, k))
        q = jnp.asarray(chunk["q"][-1])
        yield warm, chunk


def test_step_size_is_tuned_for_the_acceptance_asked_for(fitted):
    target, found = prepare(fitted, noise="iid").target, []
    for goal in (0.65, 0.85):
        nuts, shares = Nuts(target_accept=goal), []
        for key in jax.random.split(jax.random.key(3), 2):
            shares += [chunk["acceptance"].mean() for _, chunk in chunks_of(nuts, target, key, 4)]
        found.append(np.mean(shares))
    np.testing.assert_allclose(found, [0.65, 0.85], atol=0.06)


@pytest.mark.slow
def test_weights_that_replace_each_other_are_sampled():
    """Plays of nearly the same width: their sum is known, its parts are not, and each may be zero."""
    u = np.sin(np.linspace(0, 4 * np.pi, 200)) * np.linspace(0.4, 1.0, 200)
    model = hystfit.models.PrandtlIshlinskii(
        r=jnp.asarray([0.2, 0.21, 0.22, 0.23]), w=jnp.asarray([[0.0, 0.4, 0.0, 0.0]])
    )
    y = np.asarray(hf.simulate(model, u)[0]) + 0.01 * np.random.default_rng(0).normal(size=200)
    drawn = sample(
        hf.fit(model, hf.Record(u=u, y=y), noise="iid"),
        "nuts",
        noise="iid",
        chains=2,
        draws=1200,
        warmup=200,
    )
    # For 1000 gradients, of six seeds: 6.8 to 12 effective draws of the worst weight; 1.3 to 2.7 in logarithmic coordinates, and
    # divergent transitions.
    assert drawn.convergence.bulk.min() > 0.0045 * drawn.stats["steps"].sum()
    # For an acceptance of 0.65, two of six seeds had 1 to 6 divergent transitions of 2400.
    assert not drawn.stats["diverging"].any()


class Kinked(Target):
    """A log density with a kink and a plateau that ends, whose curvature at the center says nothing about their width."""

    def log_density(self, v, lean=False):
        return -1e3 * jnp.abs(v[0]) - jnp.where(jnp.abs(v[1]) < 0.1, 0.0, (jnp.abs(v[1]) - 0.1) * 1e4) - 0.5 * v[2] ** 2


class Given(Target):
    """A target whose density has no parameters but its coordinates v."""

    def log_density_and_z(self, v, lean=False):
        return self.log_density(v, lean), v


class Funnel(Given):
    """Neal's funnel (2003), in which one step size does not fit."""

    def __call__(self, q):
        v, x = q[0], q[1:]
        return -(v**2) / 8 - 0.5 * jnp.sum(x**2) * jnp.exp(-v) - 0.5 * x.size * v

    def log_density(self, v, lean=False):
        return self(self.q_of(v))


class LogGamma(Given):
    """Logarithms of gamma variables of shape 2, of which the second is added to the first."""

    def log_density(self, v, lean=False):
        v = jnp.stack([v[0] - v[1], v[1]])
        return jnp.sum(2 * v - jnp.exp(v))

    def slope(self, v):
        return jax.value_and_grad(self.log_density)(v)


class SkewedWidths(Given):
    """Logarithms of independent gamma variables of shape 4, in units of their curvature at the mode."""

    def log_density(self, v, lean=False):
        return 4 * jnp.sum(v / 2 - jnp.exp(v / 2))


def of_kind(kind: type[Target], fitted: hf.FitResult, lengths: list[float]) -> Target:
    """A target that replaces the density of a fit."""
    real = prepare(fitted, noise="iid").target
    return kind(real.density, real.bend, jnp.zeros(len(lengths)), jnp.diag(jnp.asarray(lengths)))


def test_axes_of_the_mass_matrix_are_as_long_as_the_posterior_is_wide(fitted):
    lengths = np.diag(np.asarray(checked(of_kind(Kinked, fitted, [1e-8, 3.0, 0.9])).factor))
    assert 0.5e-3 / 9 < lengths[0] < 0.5e-3 * 9
    assert 0.03 < lengths[1] < 0.3
    assert lengths[2] == 0.9  # near enough: nothing changes


def test_nuts_adapts_again_where_transitions_diverge(fitted, monkeypatch):
    """Acceptance from draws of the funnel itself; it scatters by 0.13 over seeds, and about half of them diverge at first."""
    funnel, nuts = of_kind(Funnel, fitted, [1.0] * 6), Nuts(warmup=200, target_accept=0.65)
    rng = np.random.default_rng(0)
    v = 2 * rng.normal(size=(4, 1))
    starts = jnp.asarray(np.hstack([v, np.exp(v / 2) * rng.normal(size=(4, 5))]))
    share = lambda warm: np.mean(
        [nuts.chunk(funnel, warm, q, jax.random.key(k))["acceptance"].mean() for k, q in enumerate(starts)]
    )
    seeds = [jax.random.key(seed) for seed in range(16)]
    further = [nuts.warm(funnel, seed) for seed in seeds]
    monkeypatch.setattr("hystfit.sampling.nuts._AGAIN", 0)
    first = [nuts.warm(funnel, seed) for seed in seeds]
    again = [(after, before) for after, before in zip(further, first, strict=True) if after["size"] != before["size"]]
    assert len(again) >= 5
    assert np.mean([share(after) - share(before) for after, before in again]) > 0.05


def independent(target: Target, seed: int, draws: int) -> np.ndarray:
    """Draws v of two chains, end to end."""
    mixture, places = proposals.adapted(target, np.random.default_rng(seed))
    chains, drawn = independence.Independence(chains=2)._chains(target, mixture, places, (seed, 1), None), []
    for chain in chains:
        chain.draw(draws, lambda: None)
        drawn.append(np.concatenate([chunk["z"] for chunk in chain.chunks.parts]))
    return np.concatenate(drawn)


def without_parameters(kind: type[Target], fitted: hf.FitResult, d: int) -> Target:
    """A target of d coordinates that are the parameters themselves."""
    target = of_kind(kind, fitted, [1.0] * d)
    return dataclasses.replace(target, bend=Bend(jnp.zeros(d, bool), jnp.zeros(d)), noise=None, slopes=None)


def test_independence_chains_have_a_skewed_density_as_their_distribution(fitted):
    v = independent(without_parameters(LogGamma, fitted, 2), 2, 2000)
    for x in (v[:, 1], v[:, 0] - v[:, 1]):
        assert effective_size(x.reshape(2, -1)) > 0.5 * len(x)
        for place in (0.05, 0.3, 2.0, 5.0):
            inside, share = (x < np.log(place)).astype(float), scipy.stats.gamma.cdf(place, 2)
            assert abs(inside.mean() - share) < 4 * np.sqrt(share * (1 - share) / effective_size(inside.reshape(2, -1)))


@pytest.mark.parametrize(("d", "seed", "covered"), [(2, 0, True), (4, 2, False), (5, 6, False), (8, 0, False)])
def test_a_mixture_that_covers_a_funnel_has_its_narrow_end_and_others_are_told(fitted, d, seed, covered):
    """v is normal with standard deviation 2, whatever d: a mixture that lacks the narrow end has no small v."""
    target = without_parameters(Funnel, fitted, d)
    rng = np.random.default_rng(seed)
    found = proposals.adapted(target, rng)
    offers = None if found is None else proposals.Batch.of(target, found[0], rng, 8000)
    accepted = offers is not None and independence.covers(offers)
    assert accepted == covered
    if accepted:
        for share in (0.025, 0.16, 0.84, 0.975):
            below = float(offers.weights[offers.q[:, 0] < 2 * scipy.stats.norm.ppf(share)].sum())
            assert below == pytest.approx(share, abs=0.015)  # 0.002 and 0.004 without the narrow end


@pytest.mark.parametrize("seed", [0, 1])
def test_a_mixture_covers_many_skewed_parameters(fitted, seed):
    """Of 1000 first draws in 16 dimensions about one has weight, and a mixture fitted to these alone is none."""
    target, rng = without_parameters(SkewedWidths, fitted, 16), np.random.default_rng(seed)
    found = proposals.adapted(target, rng)
    assert found is not None
    offers = proposals.Batch.of(target, found[0], rng, 8000)
    assert independence.covers(offers)
    gamma = np.exp(offers.q / 2)  # mean 1, variance 1 / 4
    spread = offers.effective**-0.5
    assert np.abs(offers.weights @ gamma - 1).max() < 4 * 0.5 * spread
    assert (
        np.abs(offers.weights @ (gamma - 1) ** 2 - 0.25).max() < 4 * 0.47 * spread
    )  # sd of the square: sqrt(9 / 32 - 1 / 16)


def test_nuts_draws_what_no_mixture_covers(fitted, monkeypatch):
    monkeypatch.setattr(independence, "_COVERED", 1.0)
    made = sample(fitted, noise="iid", draws=50, extend=1, chains=1)
    assert made.sampler == "nuts"
    assert made.stats["steps"].any()
    assert "NUTS draws" in " ".join(note.text for note in made.notes)


def test_settings_of_nuts_choose_nuts(fitted):
    assert sample(fitted, noise="iid", draws=50, extend=1, chains=1, warmup=50).stats["steps"].any()


def test_chains_that_diverge_are_drawn_again_for_a_higher_acceptance(fitted, monkeypatch, tmp_path):
    setup = dataclasses.replace(prepare(fitted, noise="iid"), target=of_kind(Funnel, fitted, [1.0] * 5))
    nuts = Nuts(chains=2, draws=300, warmup=50, extend=1, target_accept=0.15)
    run = lambda folder=None: nuts.run(setup, 0, folder, lambda text, fraction: None)
    again = run(tmp_path)
    acceptance, steps = again.stats["acceptance"].mean(), again.stats["steps"].mean()
    assert has(again.notes, Code.DIVERGENCES)
    np.testing.assert_array_equal(run(tmp_path).z, again.z)  # from the files of all attempts
    monkeypatch.setattr("hystfit.sampling.nuts._AGAIN", 0)
    once = run()
    assert once.stats["diverging"].sum() > again.stats["diverging"].sum()
    assert acceptance > once.stats["acceptance"].mean() + 0.1
    assert steps > once.stats["steps"].mean()


def test_chains_go_on_until_they_have_converged_and_their_first_draws_stay(fitted, tmp_path):
    settings = {"noise": "iid", "chains": 2, "draws": 60, "warmup": 50, "folder": tmp_path}
    longer = sample(fitted, extend=16, **settings)
    assert longer.status is Status.OK
    count = longer.draws.shape[1]
    assert 60 < count < 960
    half = Convergence.of(longer.draws[:, : count // 2])
    assert half.problems(longer.names)  # no longer than necessary
    again = sample(fitted, extend=16, **settings)  # from the files
    np.testing.assert_array_equal(again.draws, longer.draws)


@dataclasses.dataclass(frozen=True)
class Diverging(AbstractSampler):
    """Independent draws about the mode, one of which is said to diverge."""

    name = "diverging"

    def run(self, setup, seed, folder, report):
        q = np.random.default_rng(seed).normal(size=(4, 500, setup.target.center.size))
        z = np.asarray(setup.target.unwhitened(jnp.asarray(q)))
        return Raw(z, np.zeros(z.shape[:2]), {"diverging": np.arange(2000).reshape(4, 500) == 700})


def test_one_divergent_transition_is_a_status_and_names_the_other_samplers(fitted):
    drawn = sample(fitted, Diverging(), noise="iid")
    assert drawn.status is Status.DIVERGING
    assert not drawn.usable
    assert "emcee" in drawn.advice
    assert "nested" in drawn.advice


@pytest.mark.parametrize("noise", ["iid", pytest.param("ou", marks=pytest.mark.slow)])
def test_gradient_is_that_of_differences_and_the_lean_form_agrees(fitted, noise):
    target = prepare(fitted, noise=noise).target
    both = eqx.filter_jit(jax.value_and_grad(lambda q: target(q)))
    value, slope = (lambda q: both(q)[0]), (lambda q: both(q)[1])
    lean = eqx.filter_jit(lambda q: target.log_density(target.center + target.factor @ q, lean=True))
    rng = np.random.default_rng(0)
    for _ in range(3):
        q = jnp.asarray(rng.normal(size=target.center.size))
        steps = 1e-5 * np.eye(q.size)
        want = np.array([(float(value(q + e)) - float(value(q - e))) / 2e-5 for e in steps])
        np.testing.assert_allclose(np.asarray(slope(q)), want, rtol=1e-4, atol=1e-4)
        assert float(lean(q)) == pytest.approx(float(value(q)), rel=1e-10)


def test_least_squares_independence_nuts_and_emcee_agree_on_a_well_determined_problem(fitted, posterior):
    ensemble = sample(fitted, "emcee", noise="iid", walkers=32, draws=2000, seed=1)
    independent = sample(fitted, noise="iid", draws=1000, seed=1)
    assert posterior.usable
    assert ensemble.usable
    assert (independent.usable, independent.sampler) == (True, "independence")
    for name in ("c", "mu", "tau"):
        width = fitted[name].stderr
        # 900 effective draws or so give a standard deviation to 2.5 %.
        assert posterior[name].std() == pytest.approx(width, rel=0.1)
        for drawn in (ensemble, independent):
            assert drawn[name].std() == pytest.approx(posterior[name].std(), rel=0.1)
            assert abs(drawn[name].mean() - posterior[name].mean()) < 0.15 * width
    setup = prepare(fitted, noise="iid")
    at = eqx.filter_jit(lambda z: setup.target.density.log_density(z))
    for drawn in (posterior, ensemble, independent):
        for chain, draw in ((0, 0), (1, 5), (1, -1)):
            z = setup.problem.unconstrained(drawn.draws[chain, draw])
            assert drawn.log_density[chain, draw] == pytest.approx(float(at(jnp.asarray(z))), abs=1e-6)


@pytest.mark.slow
def test_banana_in_two_dimensions_agrees_with_a_grid(fitted):
    record, _ = loop(seed=5)
    u = 0.12 * record.u
    y = np.asarray(hf.simulate(hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5), u)[0])
    y = y + 0.05 * np.random.default_rng(5).normal(size=u.size)
    fixed = {"rho": 0.5, "c": 1.0, "offset": 0.0}
    fit = hf.fit(hf.BoucWen(), hf.Record(u=u, y=y), starts=1, fix=fixed, noise="iid")
    own = {"tau": priors.LogNormal(2.0, 1.0), "noise_white": priors.LogNormal(0.05, 1e-5)}
    setup = prepare(fit, noise="iid", priors=own)
    z, at = setup.target.unwhitened(jnp.zeros(len(setup.names))), [setup.names.index(name) for name in ("mu", "tau")]
    scale = setup.problem.scales.size("1/u")
    axes = [np.linspace(-4, 4, 141), np.log(np.geomspace(0.02, 100.0, 141) / scale)]  # logit of mu, log of tau
    mesh = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    full = np.tile(np.asarray(z), (len(mesh), 1))
    full[:, at] = mesh
    logs = np.asarray(
        eqx.filter_jit(lambda t, p: jax.lax.map(t.log_density, p))(setup.target.density, jnp.asarray(full))
    )
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    x = np.asarray(eqx.filter_jit(lambda z: jax.vmap(setup.target.density.physical)(z))(jnp.asarray(full)))
    skew = []
    for sampler, options in (
        ("independence", {"chains": 2, "draws": 1500}),
        ("nuts", {"chains": 2, "draws": 1500, "warmup": 200}),
        ("emcee", {"walkers": 32, "draws": 3000}),
    ):
        draws = sample(fit, sampler, noise="iid", priors=own, seed=2, **options)
        for k, name in zip(at, ("mu", "tau"), strict=True):
            mean = np.sum(weight * x[:, k])
            spread = np.sqrt(np.sum(weight * (x[:, k] - mean) ** 2))
            skew.append(np.sum(weight * ((x[:, k] - mean) / spread) ** 3))
            assert draws[name].mean() == pytest.approx(mean, abs=0.15 * spread), sampler
            assert draws[name].std() == pytest.approx(spread, rel=0.12), sampler
    assert max(np.abs(skew)) > 0.5  # it is no Gaussian


def test_diagnostics_are_arvizs(posterior):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import arviz

    rng = np.random.default_rng(0)
    walk = np.zeros((4, 400))
    for k in range(1, 400):
        walk[:, k] = 0.9 * walk[:, k - 1] + rng.normal(size=4)
    for draws in (posterior["tau"], walk, walk + np.arange(4)[:, None], rng.standard_t(2, size=(3, 301))):
        assert rhat(draws) == pytest.approx(float(arviz.rhat(draws)), rel=1e-6)
        assert bulk_ess(draws) == pytest.approx(float(arviz.ess(draws)), rel=1e-6)
        assert tail_ess(draws) == pytest.approx(float(arviz.ess(draws, method="tail")), rel=0.02)


def test_chains_apart_and_chains_too_short_are_told():
    rng = np.random.default_rng(0)
    apart = rng.normal(size=(4, 500, 1)) + np.arange(4)[:, None, None]
    found = Convergence.of(apart)
    assert found.rhat[0] > 1.2
    assert has(found.problems(("c",)), Code.CHAINS)
    found = Convergence.of(rng.normal(size=(2, 40, 1)))
    assert found.bulk[0] < 400
    assert has(found.problems(("c",)), Code.CHAINS)
    assert not Convergence.of(rng.normal(size=(4, 1000, 1))).problems(("c",))


def test_chains_are_lengthened_by_what_they_lack():
    more = lambda *sizes: Convergence(np.ones(3), np.array(sizes), np.array([900.0, np.nan, 800.0])).more
    assert more(250.0, np.nan, 500.0) == pytest.approx(1.1 * 400 / 250)
    assert (more(50.0, 300.0, 500.0), more(390.0, 395.0, 500.0)) == (2.0, 1.25)


def test_a_short_run_is_not_called_converged(fitted):
    short = sample(fitted, "nuts", noise="iid", chains=2, draws=50, extend=1, warmup=200)
    assert short.status == "not-converged"
    assert has(short.notes, Code.CHAINS)


def test_saved_and_read_back(posterior, tmp_path):
    posterior.save(tmp_path / "p")
    again = load_posterior(tmp_path / "p")
    np.testing.assert_array_equal(again.draws, posterior.draws)
    np.testing.assert_array_equal(again.log_density, posterior.log_density)
    assert (again.names, again.status, again.notes) == (posterior.names, posterior.status, posterior.notes)
    assert again.to_dict() == posterior.to_dict()
    made = again.provenance
    assert made["fit"]["date"] == posterior.result.provenance["date"] <= made["date"]
    assert (made["seed"], made["records"]) == (posterior.seed, posterior.result.provenance["records"])
    with pytest.raises(DataError, match="holds no posterior"):
        load_posterior(tmp_path)


def test_bands_derived_quantities_and_pictures(posterior, fitted):
    import matplotlib.pyplot as plt

    record, model = loop(seed=9)
    low, _, high = posterior.bands(record, 0.9)
    inside = np.mean((record.y > low) & (record.y < high))
    assert inside == pytest.approx(0.9, abs=0.045)  # three standard deviations of 500 samples, and the fit's own error
    inner = posterior.bands(record, 0.9, kind="credible")
    assert np.all(inner[2] - inner[0] < high - low)
    found = posterior.derived()
    u = np.concatenate(
        [np.linspace(record.u.min(), record.u.max(), 2000), np.linspace(record.u.max(), record.u.min(), 2000)]
    )
    y = np.asarray(hf.simulate(model, np.tile(u, 3))[0])[-4000:]
    area = abs(np.trapezoid(y[:2000], u[:2000]) + np.trapezoid(y[2000:], u[2000:]))
    assert found["loop_area"].mean() == pytest.approx(area, rel=0.03)
    rising, falling = y[:2000], y[2000:][::-1]
    assert found["hysteresis_percent"].mean() == pytest.approx(
        100 * np.abs(falling - rising).max() / np.ptp(y), rel=0.03
    )
    assert 0 < found["hysteresis_percent"].std() < 0.03 * found["hysteresis_percent"].mean()
    with pytest.raises(ParameterError, match="no creep"):
        posterior.derived(["creep_percent_per_decade"])
    figure = posterior.plot("corner")
    titles = [ax.get_title().splitlines()[0] for ax in figure.axes if ax.get_title()]
    assert tuple(titles) == posterior.names
    texts = [text for ax in figure.axes for text in (ax.title, ax.xaxis.label, ax.yaxis.label) if text.get_text()]
    boxes = [text.get_window_extent() for text in [*texts, figure._suptitle]]
    page = figure.bbox.padded(1)
    assert all(page.contains(*box.min) and page.contains(*box.max) for box in boxes)
    assert [a for a, b in itertools.combinations(boxes, 2) if a.overlaps(b)] == []
    plt.close(figure)
    for kind in ("trace", "rank", "bands"):
        plt.close(posterior.plot(kind))


@pytest.mark.parametrize(("count", "shown"), [pytest.param(30, 12, marks=pytest.mark.slow), (3, 5)])
def test_a_corner_plot_of_many_weights_and_few_draws_shows_what_is_legible(posterior, count, shown):
    """corner refuses more parameters than draws, and forty parameters have 1600 panels."""
    import matplotlib.pyplot as plt

    t = np.linspace(0, 4, 300)
    u = 50 + 50 * (1 - 0.2 * t) * np.sin(2 * np.pi * t)
    y = 0.1 * u + 0.02 * np.random.default_rng(0).normal(size=t.size)
    fit = hf.fit("prandtl-ishlinskii:plays=40", hf.Record(u, y, t))
    names = fit.problem.space.names
    weights = fit.problem.space.weights
    assert weights.sum() == 41  # the plays and the slope
    plain = {name for name, weight in zip(names, weights, strict=True) if not weight}
    draws = np.random.default_rng(1).normal(size=(2, count, len(names)))
    many = dataclasses.replace(posterior, result=fit, names=names, units=fit.problem.space.units, draws=draws)
    figure = many.plot("corner")
    assert len(figure.axes) == shown**2
    assert plain <= {ax.get_title().partition("\n")[0] for ax in figure.axes}
    plt.close(figure)


KILLED = """
import json, sys
import hystfit as hf
hf.enable_x64()
sampler, fit, folder, settings = sys.argv[1:]
hf.sample(hf.load_fit(fit), sampler, noise="iid", folder=folder, seed=4, **json.loads(settings))
"""
ENDLESS = {
    "nuts": {"chains": 1, "warmup": 100, "extend": 1, "draws": 200_000},
    "emcee": {"walkers": 16, "check": 50, "draws": 200_000},
}


def kill_in_the_middle(fitted: hf.FitResult, sampler: str, folder: Path, sign: str) -> None:
    """Run a sampler that would not end in a process of its own, and kill it outright once a file appears."""
    fit = fitted.save(folder.with_name("fit"))
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, sampler, str(fit), str(folder), json.dumps(ENDLESS[sampler])]
    )
    until = time.monotonic() + 300
    while not (folder / sign).exists() and time.monotonic() < until:
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert (folder / sign).exists()


@pytest.mark.slow
def test_nuts_killed_outright_goes_on_with_the_draws_of_an_unbroken_run(fitted, tmp_path):
    folder = tmp_path / "run"
    kill_in_the_middle(fitted, "nuts", folder, "nuts-0-00001.npz")
    kept = len(list(folder.glob("nuts-0-0*.npz")))
    (folder / f".nuts-0-{kept:05d}.npz").write_bytes(b"half a file")  # what a kill during a write leaves
    options = {"noise": "iid", "seed": 4, **ENDLESS["nuts"], "draws": 50 * (kept + 2)}
    resumed = sample(fitted, "nuts", folder=folder, **options)
    whole = sample(fitted, "nuts", **options)
    np.testing.assert_array_equal(resumed.draws, whole.draws)
    assert whole.draws.shape == (1, 50 * (kept + 2), 5)


@pytest.mark.slow
def test_emcee_killed_outright_leaves_a_chain_that_goes_on(fitted, tmp_path):
    folder = tmp_path / "run"
    kill_in_the_middle(fitted, "emcee", folder, "emcee-00000.npz")
    steps = lambda: np.concatenate([np.load(file)["chain"] for file in sorted(folder.glob("emcee-*.npz"))])
    kept = steps()
    assert len(kept) >= 50
    posterior = sample(fitted, "emcee", noise="iid", walkers=16, draws=len(kept) + 100, check=50, folder=folder, seed=4)
    after = steps()
    np.testing.assert_array_equal(after[: len(kept)], kept)
    assert len(after) == len(kept) + 100
    assert posterior.draws.shape[0] == 16
    with pytest.raises(DataError, match="another run"):
        sample(fitted, "emcee", noise="iid", walkers=16, draws=100, check=50, folder=folder, seed=5)


@pytest.mark.parametrize("beside", [False, True])
def test_the_weights_of_narrow_stops_lie_within_their_priors(beside):
    """Stops that share the output of a steel evenly have weights of the share over the half width, hundreds of times those of plays."""
    stops = hf.PrandtlIshlinskii.of(12, operator="stop")
    r = np.asarray(stops.r)
    truth = dataclasses.replace(stops, w=(0.5 / r.size / r)[None], b=np.array([0.1]))
    model = hf.Sum(truth, hf.Offset(0.0)) if beside else truth
    u = np.sin(np.arange(900) / 30) * np.linspace(0.2, 1, 900)
    result = hf.fit(model, hf.Record(u=u, y=np.asarray(hf.simulate(model, u)[0])), start="model", starts=1)
    chosen = priors.default_priors(result.problem.space, result.x)
    names, half = [f"w[0,{k}]" for k in range(r.size)], result.problem.scales.y
    widths = np.array([float(chosen[name].sd) for name in names])
    np.testing.assert_allclose(widths, half / r, rtol=1e-6)
    assert np.all(np.asarray(truth.w)[0] < 2 * widths)
    assert np.asarray(truth.w)[0, 0] > 3 * half


def test_the_prior_of_a_play_is_as_wide_as_the_output_whatever_its_width():
    record = hf.Record(u=np.sin(np.arange(300) / 20), y=3 * np.sin(np.arange(300) / 20 - 0.2))
    result = hf.fit("prandtl-ishlinskii:plays=6", record, starts=1)
    chosen = priors.default_priors(result.problem.space, result.x)
    widths = {float(prior.sd) for name, prior in chosen.items() if name.startswith("w[")}
    assert sorted(widths) == pytest.approx([result.problem.scales.y])


def test_an_emcee_run_resumed_is_the_unbroken_one(fitted, tmp_path):
    setup = prepare(fitted, noise="iid")
    quiet = lambda words, part: None
    whole = Ensemble(walkers=16, draws=200, check=50).run(setup, 3, None, quiet)
    Ensemble(walkers=16, draws=100, check=50).run(setup, 3, tmp_path, quiet)
    again = Ensemble(walkers=16, draws=200, check=50).run(setup, 3, tmp_path, quiet)
    np.testing.assert_array_equal(again.z, whole.z)


def test_a_finished_emcee_run_asked_again_is_what_it_was(fitted, tmp_path):
    settings = {"noise": "iid", "walkers": 16, "check": 50, "folder": tmp_path / "run", "seed": 3}
    first = sample(fitted, "emcee", draws=20_000, **settings)
    again = sample(fitted, "emcee", draws=200, **settings)
    assert first.status == again.status == "ok"
    np.testing.assert_array_equal(again.draws, first.draws)


def test_independence_chains_go_on_from_their_files(fitted, tmp_path):
    settings = {"noise": "iid", "chains": 2, "extend": 1, "seed": 3}
    whole = sample(fitted, draws=400, **settings)
    folder = tmp_path / "run"
    first = sample(fitted, draws=200, folder=folder, **settings)
    np.testing.assert_array_equal(first.draws, whole.draws[:, :200])
    kept = sorted(path.name for path in folder.glob("independence-*.npz"))
    assert len(kept) == 1 + 2 * 2
    for name in kept[1:3]:
        (folder / name).write_bytes(b"half a file")
    np.testing.assert_array_equal(sample(fitted, draws=400, folder=folder, **settings).draws, whole.draws)


def test_autocorrelation_time_of_a_long_chain_is_found_on_few_of_its_steps():
    keep = 399 / 401  # an autoregressive chain with an autocorrelation time of (1 + keep) / (1 - keep) = 400 steps
    rng = np.random.default_rng(0)
    push = np.sqrt(1 - keep**2) * rng.normal(size=(40_000, 32, 1))
    push[0] = rng.normal(size=(32, 1))
    chain = scipy.signal.lfilter([1.0], [1.0, -keep], push, axis=0)
    whole, thinned = longest_time(chain), longest_time(chain, 380.0)
    assert thinned == pytest.approx(400, rel=0.1)
    assert thinned == pytest.approx(whole, rel=0.02)
    assert longest_time(chain, 15.0) == whole  # short times take every step
    chain[:, 3] = 0.5
    assert longest_time(chain) == np.inf  # a walker that never moved


def test_emcee_looks_less_often_at_longer_chains(fitted):
    looks = []
    Ensemble(walkers=16, draws=800, check=10).run(
        prepare(fitted, noise="iid"), 3, None, lambda words, part: looks.append(part)
    )
    reached = 800 * np.array(looks)
    assert reached[0] == 10
    assert np.all(np.diff(reached) <= np.maximum(10, reached[:-1] / 20) + 1e-9)
    assert len(reached) < 25 + 20 * np.log(800 / 200) + 10  # ten steps up to 200, then a twentieth of the chain


@pytest.mark.usefixtures("as_users_run")
def test_bad_settings_priors_and_names_are_refused(fitted):
    with pytest.raises(ParameterError, match="sampler must be one of"):
        sample(fitted, "gibbs")
    with pytest.raises(ParameterError, match="settings of nuts"):
        sample(fitted, "nuts", walkers=3)
    with pytest.raises(ParameterError, match="warmup must be a whole number of at least 50, got 1"):
        sample(fitted, "nuts", warmup=1)
    with pytest.raises(ParameterError, match="at least 12 walkers"):
        sample(fitted, "emcee", noise="iid", walkers=8)
    with pytest.raises(ParameterError, match="not a free parameter"):
        sample(fitted, priors={"nu": priors.Normal(0, 1)})
    with pytest.raises(ParameterError, match="flat or has no width"):
        sample(fitted, priors={"tau": priors.Uniform(0.0, np.inf)})
    with pytest.raises(ParameterError, match="outside the prior of tau"):
        sample(fitted, noise="iid", priors={"tau": priors.Uniform(5.0, 6.0)})
    with pytest.raises(ParameterError, match=r"outside the parameter's bounds, 0 to 1"):
        sample(fitted, noise="iid", priors={"mu": priors.Normal(3.0, 0.01)})
    with pytest.raises(ParameterError, match="mean = nan is not a number"):
        sample(fitted, priors={"tau": priors.Normal(np.nan, 1.0)})
    for wrong in (priors.LogitNormal(0.0, 1.0, 0.5, 0.0), priors.LogitNormal(0.0, 1.0, 0.5, np.inf)):
        with pytest.raises(ParameterError, match="flat or has no width"):
            sample(fitted, noise="iid", priors={"mu": wrong})
    with pytest.raises(ParameterError, match="edge = nan is not a number"):
        sample(fitted, priors={"tau": priors.LogNormal(1.0, 1.0, np.nan)})
    with pytest.raises(ParameterError, match="lower limit must be below"):
        sample(fitted, priors={"tau": priors.Uniform(2.0, 1.0)})
    with pytest.raises(ParameterError, match=r"those are: .*noise_white"):
        sample(fitted, noise="iid", priors={"nu": priors.Normal(0, 1)})
    with pytest.raises(ParameterError, match="draws must be a whole number"):
        sample(fitted, draws=10.5)
    with pytest.raises(ParameterError, match="settings of emcee are walkers, draws, check; got live"):
        sample(fitted, "emcee", live=50)


def test_a_prior_that_contradicts_the_data_is_told_and_one_that_they_narrow_is_not(fitted, posterior):
    own = {"tau": priors.LogNormal(1.2, 0.01)}  # of the kind of the default: the sampler is compiled already
    told = sample(fitted, noise="iid", chains=1, draws=100, extend=1, warmup=200, priors=own)
    assert has(told.notes, Code.PRIOR)
    assert not has(posterior.notes, Code.PRIOR), posterior.notes


@pytest.mark.parametrize(
    ("prior", "middle", "told"),
    [
        (priors.HalfNormal(8.0), 1e-6, False),  # where a weight that the data rule out has to lie
        (priors.HalfNormal(8.0), 60.0, True),
        (priors.HalfNormal(8.0, 0.0, -1.0), -1e-6, False),
        (priors.LogNormal(1.0, 3.0), 1e-8, True),
        (priors.Normal(0.0, 1.0), -8.0, True),
        (priors.Uniform(0.0, 1.0), 1e-9, False),
    ],
)
def test_a_value_is_in_the_tail_of_a_prior_where_its_density_falls(prior, middle, told):
    from hystfit.sampling.sample import _in_tail

    assert _in_tail(prior, middle, np.asarray(prior.sample(jax.random.key(0), (4000,)))) == told


def test_width_beside_a_prior_over_a_logarithm_is_that_of_the_logarithm(fitted):
    setup = prepare(fitted, noise="iid")
    at = setup.names.index("noise_white")
    prior = setup.problem.priors[at]
    rng = np.random.default_rng(0)
    draws = np.tile(np.asarray(setup.target.density.physical(setup.target.center)), (2, 500, 1))
    draws *= 1 + 1e-3 * rng.normal(size=draws.shape)
    for spread, told in ((0.1, False), (float(prior.spread), True)):
        draws[:, :, at] = (
            30 * float(prior.median) * np.exp(spread * rng.normal(size=(2, 500)))
        )  # narrow, though far out
        notes = prior_dominated_notes(setup, draws)
        assert any(note.code is Code.PRIOR and "noise_white" in note.text for note in notes) == told, notes


def test_parameters_with_one_prior_share_a_note_and_a_line(fitted, posterior):
    one = priors.LogNormal(2.0, 1.0)
    setup = prepare(fitted, noise="iid", priors={"c": one, "tau": one})
    draws = np.tile(np.asarray(setup.target.density.physical(setup.target.center)), (2, 500, 1))
    for name in ("c", "tau"):
        draws[:, :, setup.names.index(name)] = 2 * np.exp(np.random.default_rng(0).normal(size=(2, 500)))
    (note,) = (note for note in prior_dominated_notes(setup, draws) if "hardly" in note.text)
    assert "c, tau: their posteriors are" in note.text
    text = str(dataclasses.replace(posterior, priors={"tau": "flat", "w[0]": "a", "w[1]": "a", "w[2]": "b", "v": "b"}))
    lines = [line for line in text.splitlines() if line.startswith("prior of")]
    assert lines == ["prior of tau: flat", "prior of w[0] to w[1]: a", "prior of w[2]: b", "prior of v: b"]


def test_draws_of_a_model_that_does_not_describe_the_loop_are_not_called_usable(fitted):
    poor = dataclasses.replace(fitted, status=Status.POOR)
    told = sample(poor, noise="iid", chains=4, draws=400, extend=1)
    assert not told.convergence.problems(told.names)
    assert told.status == "poor-fit"
    assert not told.usable
    assert told.notes[0].code is Code.FIT_STATUS


def test_draws_of_a_model_without_the_creep_of_the_data_are_not_usable():
    """c is far off, and its interval is that of chance only."""
    record, model = loop(sigma=0.002)
    y = record.y + np.asarray(hf.simulate(LogCreep(gamma=(0.06,)), record.u, 0.01)[0]) - record.u
    fit = hf.fit(model, record.replace(y=y), starts=1, fix={"rho": 0.5})
    assert fit.usable
    drawn = sample(fit, noise="iid", chains=4, draws=400, extend=1)
    assert not drawn.convergence.problems(drawn.names)
    assert abs(drawn["c"].mean() - 1.0) > 5 * drawn["c"].std()
    assert drawn.status is Status.INCOMPLETE
    assert has(drawn.notes, Code.INCOMPLETE)


@pytest.mark.parametrize(("time", "slow", "told"), [(100.0, 0.02, True), (20.0, 0.02, False), (100.0, 0.004, False)])
def test_slow_noise_as_long_as_a_good_part_of_the_record_is_drift(fitted, time, slow, told):
    noise = {"noise_white": 0.01, "noise_slow": slow, "noise_time": time}
    setup = Prepared(fitted.problem.with_noise(OrnsteinUhlenbeck()), "ou", ())
    x = np.array([noise.get(name, 1.0) for name in setup.names])
    assert has(drift_notes(setup, np.tile(x, (2, 5, 1)), longest=500), Code.INCOMPLETE) == told


@pytest.mark.parametrize("noise", ["iid", pytest.param("discrepancy", marks=pytest.mark.slow)])
def test_a_simulation_that_breaks_has_no_likelihood(fitted, noise):
    # Residuals at their limit are a constant, and what repeats with input and direction explains a constant.
    setup = prepare(fitted, noise=noise)
    target, density = setup.target, setup.target.density
    far = target.center.at[setup.names.index("offset")].set(1e5)
    if noise == "discrepancy":
        far = far.at[setup.names.index("noise_loop")].set(np.log(1e5))
    for likelihood in (density.log_likelihood, density.log_likelihood_lean):
        assert float(eqx.filter_jit(likelihood)(far)) < -1e8
    if noise == "discrepancy":
        assert float(eqx.filter_jit(density.slope)(far)[0]) == -np.inf


@pytest.mark.slow
def test_a_fit_at_which_the_simulation_breaks_is_not_refused():
    """Beside large noise least squares runs along c tau = const; the posterior is proper, and its mode is sought within the priors."""
    record, _ = loop(sigma=20.0)
    fit = hf.fit(hf.BoucWen(scheme="exact"), record, starts=1, noise="iid")
    far = dataclasses.replace(fit, x=np.array([1e15, 1 - 1e-16, 3e-12, 0.56, fit.x[4]]))
    setup = prepare(far, noise="iid")
    both = eqx.filter_jit(lambda target, q: (target(q), target.physical(q)))
    density, mode = both(setup.target, jnp.zeros(setup.target.center.size))
    assert np.isfinite(density)
    assert np.abs(mode[0]) < 1e6


def test_a_parameter_that_the_data_do_not_move_is_named(fitted, posterior):
    told = sample(fitted, noise="iid", chains=2, draws=900, warmup=200, priors={"tau": priors.LogNormal(2.03, 1e-6)})
    assert has(told.notes, Code.PRIOR)
    assert not has(posterior.notes, Code.PRIOR)
    assert np.log(told["tau"]).std() == pytest.approx(1e-6, rel=0.15)


@pytest.mark.parametrize("words", ["normal(1234,5)", "log-normal(1234,5)", "half-normal(1234)", "uniform(0,1234)"])
def test_priors_that_print_alike_are_told_apart(words):
    one, other = priors.parse(words), priors.parse(words.replace("1234", "1234.1"))
    assert str(one) == str(other)
    assert one.exact() != other.exact()
    assert priors.parse(words).exact() == one.exact()


def test_a_prior_of_the_users_with_arrays_has_an_identity():
    class Table(priors.AbstractPrior):
        heights: np.ndarray
        name: str = "table"

        def log_density(self, x):
            return jnp.log(jnp.interp(x, jnp.linspace(0, 1, len(self.heights)), self.heights))

        def sample(self, key, shape=()):
            return jax.random.uniform(key, shape)

    assert Table(np.array([1.0, 2.0])).exact() == ["Table", [1.0, 2.0], "table"]


def test_a_run_under_another_prior_or_other_settings_is_another_run(fitted, tmp_path):
    small = {"noise": "iid", "walkers": 16, "draws": 50, "check": 50, "folder": tmp_path}
    own = {"c": priors.LogNormal(1.0, 0.5)}  # of the kind of the default: the sampler is compiled already
    first = sample(fitted, "emcee", priors=own, **small)
    again = sample(fitted, "emcee", priors=own, **small)
    np.testing.assert_array_equal(again.draws, first.draws)
    with pytest.raises(DataError, match="another run"):
        sample(fitted, "emcee", priors={"c": priors.LogNormal(1.0001, 0.5)}, **small)
    with pytest.raises(DataError, match="another run"):
        sample(fitted, "emcee", priors=own, **{**small, "check": 25})


@pytest.mark.slow
def test_records_may_be_called_with_slashes(tmp_path):
    first, second = (loop(seed=k)[0].replace(name=f"coil/{k}") for k in range(2))
    both = hf.fit(loop()[1], [first, second], starts=1, fix={"rho": 0.5}, noise="iid")
    made = sample(both, "emcee", noise="iid", walkers=16, draws=50)
    again = load_posterior(made.save(tmp_path / "p"))
    assert "offset@coil/1" in again.names
    np.testing.assert_array_equal(again["offset@coil/1"], made["offset@coil/1"])
    made.to_arviz()


def test_predictions_of_a_model_with_time_need_time(posterior):
    t = np.arange(60) / 100
    u = np.sin(2 * np.pi * t)
    record = hf.Record(
        u=u, y=np.asarray(hf.simulate(hf.models.Lag(tau=0.02), u, 0.01)[0]) + 0.001 * np.cos(40 * t), t=t
    )
    fit = hf.fit(hf.models.Lag(tau=0.02), record, start="model", starts=1, noise="iid")
    names = (*fit.free_names, "noise_white")
    draws = np.tile([*fit.x, 0.001], (1, 5, 1))
    drawn = dataclasses.replace(posterior, result=fit, names=names, units=("",) * len(names), draws=draws)
    assert np.isfinite(drawn.predict(record)).all()
    with pytest.raises(ModelError, match="depends on time"):
        drawn.predict(hf.Record(u=u, y=u))


def test_a_record_that_was_not_fitted_has_the_offset_of_any_fitted_one():
    records = [loop(200, seed)[0] for seed in (0, 1)]
    records[1] = hf.Record(u=records[1].u, y=records[1].y + 1.0, name="second")
    records[0] = hf.Record(u=records[0].u, y=records[0].y, name="first")
    fit = hf.fit(loop()[1], records, starts=1, noise="iid", fix={"rho": 0.5})
    x = np.tile(fit.x, (200, 1))
    middle = lambda name: simulate_draws(fit, hf.Record(u=records[0].u, y=records[0].y, name=name), x, 0)[:, 100]
    assert np.ptp(middle("first")) == 0
    assert middle("second")[0] - middle("first")[0] == pytest.approx(1.0, abs=0.02)
    third = middle("third")
    assert set(third) == {middle("first")[0], middle("second")[0]}
    assert 0.35 < np.mean(third == third.min()) < 0.65  # 200 draws: four standard deviations


def test_bands_under_heavy_tails_have_the_tails_of_students_t(fitted):
    p, dof = len(fitted.free_names), 2.5
    row = np.concatenate([[fitted[n].value for n in fitted.free_names], [0.5, dof]])
    names = (*fitted.free_names, "noise_white", "noise_dof")
    nothing = Convergence(*(np.ones(row.size) for _ in range(3)))
    draws = np.tile(row, (1, 4000, 1))
    drawn = Posterior(
        fitted, "nuts", "student-t", names, ("",) * (p + 2), draws, np.zeros((1, 4000)), {}, nothing, Status.OK, (), {}, 0.0, 0, {}
    )  # fmt: skip
    ahead = hf.Record(u=np.linspace(-1, 1, 30), y=np.zeros(30))
    low, _, high = drawn.bands(ahead, 0.9, count=4000)
    assert np.median(high - low) == pytest.approx(2 * 0.5 * scipy.stats.t.ppf(0.95, dof), rel=0.05)


@pytest.mark.parametrize("kind", ["nuts", "nested"])
def test_a_missing_package_is_named_before_the_posterior_is_prepared(kind, fitted, monkeypatch):
    monkeypatch.setitem(sys.modules, "blackjax", None)
    monkeypatch.setattr("hystfit.sampling.base.prepare", lambda *_, **__: 1 / 0)
    with pytest.raises(MissingExtraError, match=r"hystfit-jax\[bayes\]"):
        sample(fitted, kind)


def test_a_package_that_warns_when_it_is_imported_says_nothing(tmp_path, monkeypatch):
    """As ArviZ does once a day; the tests make warnings errors."""
    (tmp_path / "announcing.py").write_text(
        "import warnings\nwarnings.warn('we change', FutureWarning)\nready = True\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert optional("announcing", "bayes", "a test").ready
