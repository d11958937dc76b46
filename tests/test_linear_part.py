"""Coordinates of linear parameters given the others: against generalized least squares, the density itself, and sampling without them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

import hystfit as hf
from hystfit import priors
from hystfit.inference.noise import White
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.problem import Problem
from hystfit.models import LogCreep, Sum
from hystfit.outcome import Status
from hystfit.sampling.linear_part import LinearPart
from hystfit.sampling.sample import sample
from hystfit.sampling.setup import given_others, prepare
from hystfit.sampling.target import Target, log_densities_and_z

NARROW = {"offset": priors.Normal(0.3, 0.003)}  # about as narrow as the likelihood

density_at = eqx.filter_jit(lambda target, q: target(q))


@pytest.fixture(scope="module")
def fitted() -> hf.FitResult:
    rng, phase = np.random.default_rng(0), np.arange(150) / 150
    u = np.sin(2 * np.pi * 4 * phase) * (0.4 + 0.6 * phase)
    truth = hf.AsymmetricBoucWen(c=2.0, mu=0.5, tau=2.0, rho=0.5, b=(0.1, 0.0), offset=0.3)
    y = np.asarray(hf.simulate(truth, u)[0]) + 0.02 * rng.normal(size=150)
    return hf.fit(truth, hf.Record(u=u, y=y), starts=1, fix={"rho": 0.5, "n": 1.0, "skew": 0.0})


@pytest.fixture(scope="module", params=["ou", pytest.param("discrepancy", marks=pytest.mark.slow)])
def setup(request, fitted):
    return given_others(prepare(fitted, noise=request.param, priors=NARROW), jax.random.key(0))


def with_noise(result: hf.FitResult, name: str) -> tuple[Problem, np.ndarray]:
    """The problem of a fit with typical noise of its size, and the fit and that noise as z."""
    noise = NOISES.find(name).of_size(0.02)
    problem = result.problem.with_noise(noise)
    x = np.concatenate([result.x, problem.noise_space.vector(noise)])
    return problem, problem.unconstrained(x)


def test_parameters_in_which_the_output_is_linear_together_are_found(setup):
    """y = offset + c (u - mu h) + b P(u): c and mu exclude each other."""
    assert setup.target.linear is not None
    names = [setup.names[k] for k in setup.target.linear.places]
    assert names in (["c", "b[0]", "b[1]", "offset"], ["mu", "b[0]", "b[1]", "offset"])


def test_parameters_near_a_bound_and_other_noise_have_their_own_coordinates(fitted):
    plain, z = with_noise(fitted, "iid")
    wide = np.where(np.isin(plain.names[:-1], ["c", "mu"]), 1.0, 1e-6)
    found = LinearPart.of(plain, z, wide)
    assert found is not None
    assert [plain.names[k] for k in found.places] == ["b[0]", "b[1]", "offset"]
    assert LinearPart.of(*with_noise(fitted, "student-t"), np.full(wide.size, 1e-6)) is None


def test_density_is_that_of_all_parameters_times_the_jacobian(setup):
    target = setup.target
    stretched = jax.jit(lambda q: jnp.linalg.slogdet(jax.jacfwd(target.unwhitened)(q))[1])
    of_z, differences = jax.jit(lambda z: target.density.log_density(z)), []
    for q in np.random.default_rng(1).normal(size=(6, len(setup.names))):
        q = jnp.asarray(q)
        differences.append(float(density_at(target, q) - of_z(target.unwhitened(q)) - stretched(q)))
    assert np.ptp(differences) < 1e-8


def several() -> hf.Dataset:
    """Two records without some samples, the second with noise of half the size; one of uneven steps."""
    rng, records = np.random.default_rng(3), []
    for k, t in enumerate((np.arange(120) / 120, np.sort(rng.uniform(size=90)))):
        u = np.sin(2 * np.pi * 4 * t) * (0.4 + 0.6 * t)
        y = np.asarray(hf.simulate(hf.BoucWen(c=2.0, mu=0.5, tau=2.0, rho=0.5, offset=0.3), u)[0])
        y = y + 0.02 / (1 + k) * rng.normal(size=t.size)
        weight = np.where(np.arange(t.size) % 17 == 5, 0.0, (1.0 + k) ** 2)
        records.append(hf.Record(t=t, u=u, y=y, weight=weight, name=str(k)))
    return hf.Dataset(tuple(records))


@pytest.fixture(scope="module")
def fitted_to_several() -> hf.FitResult:
    return hf.fit("bouc-wen", several(), starts=1)


@pytest.mark.parametrize("noise", ["ou", *(pytest.param(name, marks=pytest.mark.slow) for name in ("iid", "ar1"))])
def test_densities_of_many_places_are_those_of_each(fitted_to_several, noise):
    """In one scan for all signals, against whole trajectories and against coordinates computed apart."""
    problem, z = with_noise(fitted_to_several, noise)
    linear = LinearPart.of(problem, z, np.full(len(problem.space), 0.01))
    assert linear is not None
    assert len(linear.places) >= 3  # c and either offset
    target = Target.about(problem.density, jnp.asarray(z))
    target = target.whitened(target.center, 0.05 * jnp.eye(z.size)).given_others(linear)
    assert not target.density.keeps_trajectories
    q = jnp.asarray(np.random.default_rng(4).normal(size=(5, len(target.center))))
    densities, z = log_densities_and_z(target, q)
    np.testing.assert_allclose(densities, jax.jit(lambda q: jax.lax.map(target, q))(q), rtol=1e-9)
    np.testing.assert_allclose(z, target.unwhitened(q), atol=1e-9)


def test_few_places_are_computed_at_once_where_a_step_has_a_loop_of_its_own():
    data = several()
    density = lambda model: Problem(model, data).with_noise(White()).density
    assert not density(hf.BoucWen()).is_heavy
    assert density(hf.JilesAtherton()).is_heavy  # substeps
    assert density(Sum(hf.BoucWen(), LogCreep())).is_heavy  # trajectories of its parts


def test_gradient_is_that_of_the_density(setup):
    q, slope = jnp.asarray(np.random.default_rng(2).normal(size=len(setup.names))), 1e-5
    value = lambda q: float(density_at(setup.target, q))
    want = [(value(q + slope * e) - value(q - slope * e)) / (2 * slope) for e in jnp.eye(q.size)]
    np.testing.assert_allclose(jax.jit(jax.grad(lambda q: setup.target(q)))(q), want, rtol=1e-4, atol=1e-4)


def test_mean_and_covariance_are_those_of_generalized_least_squares(fitted):
    """Given the others and the noise, for the covariance of slow and white noise written out."""
    setup = given_others(prepare(fitted, noise="ou", priors=NARROW), jax.random.key(0))
    target, linear = setup.target, setup.target.linear
    assert linear is not None
    places, names = list(linear.places), setup.names
    v = np.tile(np.asarray(target.v_of(jnp.zeros(len(names)))), (1 + len(places), 1))
    v[:, places] = np.vstack([np.zeros(len(places)), np.eye(len(places))])
    x = setup.physical(np.asarray(target.unwhitened(target.q_of(v, np)))[None])[0]
    mean, root, record = x[0, places], (x[1:, places] - x[0, places]).T, fitted.data[0]
    white, slow, time = (x[0, names.index(f"noise_{part}")] for part in ("white", "slow", "time"))
    lags = np.arange(record.u.size)
    covariance = scipy.linalg.toeplitz(slow**2 * np.exp(-lags / time) + white**2 * (lags == 0))
    predict = lambda x: np.asarray(setup.problem.predict(x[: len(setup.problem.space)])[0])
    columns = np.array([predict(x[0] + unit) - predict(x[0]) for unit in 0.1 * np.eye(len(names))[places]]).T / 0.1
    own = np.asarray(linear.precision) / np.diag(np.asarray(linear.moves)[:, places]) ** 2
    precision = columns.T @ np.linalg.solve(covariance, columns) + np.diag(own)
    z, start = np.zeros(len(setup.problem.space)), x[0].copy()
    z[places] = linear.reference
    start[places] = setup.problem.space.physical(z)[places]
    pull = columns.T @ np.linalg.solve(covariance, record.y - predict(start))
    np.testing.assert_allclose(mean, start[places] + np.linalg.solve(precision, pull), rtol=1e-6)
    np.testing.assert_allclose(root @ root.T @ precision, np.eye(len(places)), atol=1e-5)


@pytest.mark.slow
def test_draws_are_those_of_the_usual_coordinates(fitted, monkeypatch):
    plain = sample(fitted, "nuts", noise="ou", priors=NARROW, draws=300, extend=4)
    monkeypatch.setattr("hystfit.sampling.nuts._LONG", -1)
    made = sample(fitted, "nuts", noise="ou", priors=NARROW, draws=300, extend=4)
    for posterior in (plain, made):
        assert posterior.status is Status.OK
    for k in range(len(plain.names)):
        a, b = (posterior.draws[:, :, k] for posterior in (plain, made))
        size = np.sqrt(1 / plain.convergence.bulk[k] + 1 / made.convergence.bulk[k])
        assert abs(np.median(a) - np.median(b)) < 1.25 * 4 * size * a.std()
        assert b.std() == pytest.approx(a.std(), rel=4 * size)
