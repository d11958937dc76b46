"""Nested sampling against quadrature, on a posterior with two modes by symmetry; runs that go on; bad input."""

import itertools
import shutil

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import logsumexp

import hystfit as hf
from hystfit import priors
from hystfit.errors import DataError, ParameterError
from hystfit.inference.noise import LoopDiscrepancy
from hystfit.sampling.files import load_posterior
from hystfit.sampling.sample import sample
from hystfit.sampling.setup import prepare

SETTINGS = dict(noise="iid", live=300, seed=5)


@pytest.fixture(scope="module")
def two_modes() -> hf.FitResult:
    """A sum of two equal models with different tau: exchanging them changes nothing, so that there are two equal modes."""
    rng = np.random.default_rng(0)
    phase = np.arange(120) / 120
    u = np.sin(2 * np.pi * 4 * phase) * (0.4 + 0.6 * phase)
    part = lambda tau: hf.BoucWen(c=0.5, mu=0.9, tau=tau, rho=0.4)
    truth = hf.Sum(part(1.0), part(8.0))
    record = hf.Record(u=u, y=np.asarray(hf.simulate(truth, u)[0]) + 0.005 * rng.normal(size=u.size))
    known = [name for name in hf.ParameterSpace.of(truth).names if "tau" not in name]
    return hf.fit(truth, record, starts=1, noise="iid", fix=known)


@pytest.fixture(scope="module")
def run(two_modes, tmp_path_factory):
    folder = tmp_path_factory.mktemp("nested")
    return sample(two_modes, "nested", folder=folder, **SETTINGS), folder


@pytest.mark.slow
def test_evidence_is_that_of_quadrature_over_both_modes(two_modes, run):
    target = prepare(two_modes, noise="iid").target
    edge = np.linspace(-7, 7, 49)
    q = np.array(list(itertools.product(edge, repeat=3)))
    logs = eqx.filter_jit(
        lambda q: jax.lax.map(lambda row: target.density.log_density(target.unwhitened(row)), q, batch_size=500)
    )
    one_mode = logsumexp(np.asarray(logs(jnp.asarray(q)))) + 3 * np.log(edge[1] - edge[0])
    one_mode += np.linalg.slogdet(np.asarray(target.factor))[1]
    found = run[0].evidence
    assert found.error < 0.4
    assert abs(found.log_z - (one_mode + np.log(2))) < 3 * found.error


@pytest.mark.slow
def test_the_evidence_counts_the_part_of_a_prior_outside_the_bounds():
    """c is positive, and five sixths of the mass of its prior lie below zero."""
    u = np.sin(np.linspace(0, 12, 50))
    truth = hf.BoucWen(c=0.5, mu=0.5, tau=3.0, rho=0.5)
    y = np.asarray(hf.simulate(truth, u)[0]) + 0.1 * np.random.default_rng(0).normal(size=u.size)
    known = [name for name in hf.ParameterSpace.of(truth).names if name != "c"]
    fit = hf.fit(truth, hf.Record(u=u, y=y), starts=1, noise="iid", fix=known)
    prior = {"c": priors.Normal(-1.0, 1.0)}
    target = prepare(fit, noise="iid", priors=prior).target
    edge = np.linspace(-8, 8, 81)
    q = jnp.asarray(list(itertools.product(edge, repeat=2)))
    logs = eqx.filter_jit(lambda q: jax.lax.map(lambda z: target.density.log_density(target.unwhitened(z)), q))(q)
    expected = (
        logsumexp(np.asarray(logs)) + 2 * np.log(edge[1] - edge[0]) + np.linalg.slogdet(np.asarray(target.factor))[1]
    )
    found = sample(fit, "nested", noise="iid", priors=prior, live=100, chains=1, seed=1).evidence
    assert 3 * found.error < np.log(6)
    assert abs(found.log_z - expected) < 3 * found.error


@pytest.mark.slow
def test_both_modes_hold_half_of_the_draws(run):
    posterior, _ = run
    first, second = (posterior[name] for name in posterior.names[:2])
    assert "tau" in posterior.names[0]
    assert "tau" in posterior.names[1]
    assert np.mean(first < second) == pytest.approx(0.5, abs=0.2)  # three sd of two runs with 300 points
    apart = np.abs(first - second)
    assert apart.min() > 1.0  # nothing between them


@pytest.mark.slow
def test_it_goes_on_from_what_a_run_left(two_modes, run, tmp_path):
    whole, folder = run
    for file in [*sorted(folder.glob("nested-*"))[:9], folder / "run.json"]:
        shutil.copy(file, tmp_path)
    again = sample(two_modes, "nested", folder=tmp_path, **SETTINGS)
    np.testing.assert_array_equal(again.draws, whole.draws)
    assert again.evidence == whole.evidence
    with pytest.raises(DataError, match="another run"):
        sample(two_modes, "nested", folder=tmp_path, **(SETTINGS | {"live": 350}))


@pytest.mark.slow
def test_the_evidence_is_saved_and_said(run, tmp_path):
    posterior, _ = run
    loaded = load_posterior(posterior.save(tmp_path / "out"))
    assert loaded.evidence == posterior.evidence
    assert f"{posterior.evidence.log_z:.2f}" in str(loaded)
    assert loaded.to_dict()["evidence"]["error"] == posterior.evidence.error


@pytest.mark.parametrize("wrong", [dict(live=20), dict(moves=0), dict(rest=0.0), dict(chains=0), dict(walkers=10)])
def test_settings_that_cannot_be_used_are_refused(two_modes, wrong):
    with pytest.raises(ParameterError, match=next(iter(wrong))):
        sample(two_modes, "nested", **wrong)


def test_priors_that_exclude_the_data_are_refused(two_modes):
    name = two_modes.free_names[0]
    with pytest.raises(ParameterError, match="outside the prior"):
        sample(two_modes, "nested", noise="iid", priors={name: priors.Uniform(100.0, 101.0)})


@pytest.mark.usefixtures("as_users_run")
@pytest.mark.parametrize(("sampler", "suggested"), [("nested", False), ("nuts", True)])
def test_residuals_suggest_no_priors_for_an_evidence(monkeypatch, sampler, suggested):
    class Asked(Exception):
        pass

    def prepare(result, *, noise, priors, by_residuals=True):
        raise Asked(by_residuals)

    for room in ("base", "nuts"):
        monkeypatch.setattr(f"hystfit.sampling.{room}.prepare", prepare)
    with pytest.raises(Asked) as asked:
        sample(None, sampler, noise="discrepancy")
    assert asked.value.args == (suggested,)


def test_without_residuals_the_size_of_model_error_keeps_its_declared_prior():
    assert "noise_loop" in LoopDiscrepancy.default_priors(300, 0.01)
    assert "noise_loop" not in LoopDiscrepancy.default_priors(300, None)
