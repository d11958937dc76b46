"""What a posterior rests on, against closed forms of a linear model with normal priors, refits without a record, and a wrong model."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

import hystfit as hf
from hystfit import priors
from hystfit.models import PrandtlIshlinskii
from hystfit.outcome import Code
from hystfit.outcome.note import has
from hystfit.results.exchange import smoothed_weights
from hystfit.sampling.posterior import Posterior
from hystfit.sampling.sensitivity import Sensitivity, record_densities, sensitivity

RECORDS, SIGMA = 4, 0.05
SDS = np.array([0.08, 0.2, *3 * [0.4]])  # of the priors of the weight, and of the offsets


def loops(records: int, bend: float = 0.0) -> hf.Dataset:
    rng = np.random.default_rng(0)
    turns = [0.0, 1.0, -1.0, 1.0, -1.0, 0.4, -0.2, 0.0]
    u = np.concatenate([np.linspace(a, b, 25, endpoint=False) for a, b in itertools.pairwise(turns)])
    y = np.asarray(hf.simulate(model(0.4), u)[0]) + bend * u**3
    noise = lambda: SIGMA * rng.normal(size=u.size)
    return hf.Dataset(tuple(hf.Record(u=u, y=y + 0.1 * k + noise(), name=f"loop {k}") for k in range(records)))


def model(weight: float) -> PrandtlIshlinskii:
    return PrandtlIshlinskii(w=[[weight]], r=[0.3], low=-1.0, high=1.0)


PRIORS = {
    "w[0,0]": priors.HalfNormal(SDS[0]),
    **{f"offset@loop {k}": priors.Normal(0.3, SDS[k + 1]) for k in range(RECORDS)},
}


@pytest.fixture(scope="module")
def posterior() -> Posterior:
    return hf.sample(hf.fit(model(0.5), loops(RECORDS)), "weights", noise="iid", priors=PRIORS, draws=500, extend=1)


@pytest.fixture(scope="module")
def found(posterior: Posterior) -> Sensitivity:
    return posterior.sensitivity


def moments(posterior: Posterior, scale: float = 1.0, left_out: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviations of the normal posterior of all weights for noise of known size; `scale` is the prior's weight."""
    problem, x = posterior.result.problem, posterior.result.x
    residual, jacobian = problem.linearize(x)
    on = problem.used.copy()
    if left_out is not None:
        on[left_out] = False
    X, y = jacobian[on], (np.einsum("rtp,p->rt", jacobian, x) - residual)[on]
    sigma = np.median(posterior["noise_white"])
    center = np.where(np.arange(SDS.size) > 0, 0.3, 0.0)
    precision = X.T @ X / sigma**2 + np.diag(scale / SDS**2)
    covariance = np.linalg.inv(precision)
    return covariance @ (X.T @ y / sigma**2 + scale * center / SDS**2), np.sqrt(np.diag(covariance))


def test_contraction_and_shifts_are_those_of_the_normal_posterior(posterior: Posterior, found: Sensitivity) -> None:
    assert posterior.result.free_names == tuple(PRIORS)
    sd = moments(posterior)[1]
    quartiles = np.array(
        [(1.1503 - 0.3186) / 1.349, *RECORDS * [1]]
    )  # of a half-normal: closer together than those of a normal
    half = SDS * quartiles
    np.testing.assert_allclose(found.contraction[: SDS.size], 1 - (sd / half) ** 2, atol=0.02)
    step = 0.01
    slopes = (moments(posterior, 1 + step)[0] - moments(posterior, 1 - step)[0]) / (2 * step)
    np.testing.assert_allclose(found.prior_shift[: SDS.size], np.log(2) * slopes / sd, atol=0.15)
    assert found.prior_shift[0] < -0.3 < 0.3 < found.data_shift[0]  # the prior of the weight is far below the data
    disagree = next(note.text for note in found.notes if note.code is Code.PRIOR)
    assert "w[0,0]" in disagree


def test_influence_is_that_of_a_refit_without_the_record(posterior: Posterior, found: Sensitivity) -> None:
    mean, sd = moments(posterior)
    assert found.pareto.shape == (RECORDS,)
    assert (found.pareto < 0.7).all()
    for k in range(RECORDS):
        expected = (moments(posterior, left_out=k)[0] - mean) / sd
        np.testing.assert_allclose(
            found.influence[k, 0], expected[0], atol=0.15
        )  # three standard errors of importance sampling
    assert found.table().lines()
    assert found.to_dict()["quantities"]["w[0,0]"]["without"]["loop 1"] is not None


def test_the_offset_of_a_record_is_integrated_out_exactly(posterior: Posterior) -> None:
    draws = posterior.draws[0, :3]
    plain, without_offset = record_densities(posterior, draws)
    residual, jacobian = posterior.result.problem.linearize(posterior.result.x)
    n = int(posterior.result.problem.used[0].sum())
    offsets = np.linspace(-3, 3, 24_001)
    for row, one, integrated in zip(draws, plain, without_offset, strict=True):
        x, sigma = row[: SDS.size], row[SDS.size]
        r = (residual + jacobian @ (x - posterior.result.x))[1][:n]
        log_density = lambda r, sigma=sigma: (
            -0.5 * np.sum((r / sigma) ** 2, axis=-1) - r.shape[-1] * np.log(sigma * np.sqrt(2 * np.pi))
        )
        np.testing.assert_allclose(one[1], log_density(r), rtol=1e-9)
        # Moments of r give the density at every offset.
        squares = np.sum(r**2) + 2 * (offsets - x[2]) * r.sum() + n * (offsets - x[2]) ** 2
        at = -0.5 * squares / sigma**2 - n * np.log(sigma * np.sqrt(2 * np.pi))
        prior = -0.5 * ((offsets - 0.3) / SDS[2]) ** 2 - np.log(SDS[2] * np.sqrt(2 * np.pi))
        value = np.log(np.trapezoid(np.exp(at + prior - at.max()), offsets)) + at.max()
        np.testing.assert_allclose(integrated[1], value, atol=0.03)  # quartiles of prior draws give its width


def test_checks_of_the_right_model_pass_and_of_a_wrong_one_do_not(found: Sensitivity) -> None:
    assert found.checks
    assert not any(check.missed for check in found.checks.values())
    assert all(check.lower < check.median < check.upper for check in found.checks.values())
    wrong = hf.sample(
        hf.fit(model(0.5), loops(1, bend=0.5)), "weights", noise="iid", draws=100, extend=1, chains=2
    ).sensitivity
    assert any(check.missed for check in wrong.checks.values())
    assert has(wrong.notes, Code.INCOMPLETE)
    assert wrong.pareto.size == 0  # a single record cannot be left out


def test_smoothed_weights_of_normal_tails_have_the_moments_of_the_target() -> None:
    # From N(0, 1) to N(0.3, 1): log weights 0.3 x.
    x = np.random.default_rng(0).normal(size=20_000)
    weights, shapes = smoothed_weights(np.stack([0.3 * x, 0 * x + 1e-9 * x]))
    np.testing.assert_allclose(weights @ x, [0.3, 0.0], atol=0.03)
    assert (shapes < 0.5).all()


def test_a_weight_that_stays_at_its_bound_has_no_shift(posterior: Posterior, found: Sensitivity) -> None:
    """It tells of nothing, and those beside it are as they were."""
    draws = posterior.draws.copy()
    draws[..., 1] = 0.0
    still = sensitivity(dataclasses.replace(posterior, draws=draws))
    assert np.isnan(still.prior_shift[1])
    np.testing.assert_allclose(still.prior_shift[2], found.prior_shift[2], rtol=1e-6)
